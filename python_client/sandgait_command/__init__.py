"""The command `sandgait`. It loads only the native module, because importing `sandgait` would load gymnasium and
numpy. `sandgait certify` is written in Python, so it loads the package."""

from __future__ import annotations

import sys
from importlib.machinery import EXTENSION_SUFFIXES, ExtensionFileLoader, ModuleSpec
from os.path import dirname, exists, join
from typing import Any


def main() -> int:
    """Runs the command line of this process and returns its exit code."""
    if sys.argv[1:2] == ["certify"]:
        return _certify(sys.argv[2:])
    return int(_native().main(["sandgait", *sys.argv[1:]]))


def _certify(arguments: list[str]) -> int:
    if "site" not in sys.modules:  # Python was started with -S, without the folder of installed packages
        import site

        site.main()
    try:
        from sandgait.certify.command import main
    except ImportError as error:
        print(f"sandgait: certify: {error}; pip install 'sandgait[deploy]'", file=sys.stderr)
        return 2
    return main(arguments)


def _native() -> Any:
    folder = join(dirname(dirname(__file__)), "sandgait")
    places = [join(folder, "_native" + suffix) for suffix in EXTENSION_SUFFIXES]
    place = next((path for path in places if exists(path)), places[0])
    loader = ExtensionFileLoader("sandgait._native", place)
    module = loader.create_module(ModuleSpec("sandgait._native", loader, origin=place))
    loader.exec_module(module)
    return module
