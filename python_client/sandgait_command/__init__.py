"""The command `sandgait`. It loads only the native module, because importing `sandgait` would load gymnasium and
numpy. The commands `certify` and `adapt` are written in Python, so they load the package."""

from __future__ import annotations

import sys
from importlib import import_module
from importlib.machinery import EXTENSION_SUFFIXES, ExtensionFileLoader, ModuleSpec
from os.path import dirname, exists, join
from typing import Any

#: Commands that are packages of `sandgait`.
_IN_PYTHON = ("certify", "adapt")


def main() -> int:
    """Runs the command line of this process and returns its exit code."""
    if sys.argv[1:2] and sys.argv[1] in _IN_PYTHON:
        return _in_python(sys.argv[1], sys.argv[2:])
    return int(_native().main(["sandgait", *sys.argv[1:]]))


def _in_python(command: str, arguments: list[str]) -> int:
    if "site" not in sys.modules:  # Python was started with -S, without the folder of installed packages
        import_module("site").main()
    try:
        module = import_module(f"sandgait.{command}.command")
    except ImportError as error:
        print(f"sandgait: {command}: {error}; pip install 'sandgait[deploy]'", file=sys.stderr)
        return 2
    return int(module.main(arguments))


def _native() -> Any:
    folder = join(dirname(dirname(__file__)), "sandgait")
    places = [join(folder, "_native" + suffix) for suffix in EXTENSION_SUFFIXES]
    place = next((path for path in places if exists(path)), places[0])
    loader = ExtensionFileLoader("sandgait._native", place)
    module = loader.create_module(ModuleSpec("sandgait._native", loader, origin=place))
    loader.exec_module(module)
    return module
