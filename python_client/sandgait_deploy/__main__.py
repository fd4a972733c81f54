"""`python -m sandgait_deploy verify FOLDER` and `describe FOLDER`."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from .controller import Controller
from .errors import Refused


def main(arguments: list[str] | None = None) -> int:
    """Exit code 0; 1 if a boundary of the golden trace does not hold; 2 with one line if something is refused."""
    parser = argparse.ArgumentParser(prog="python -m sandgait_deploy", description="Checks and describes policies.")
    actions = parser.add_subparsers(dest="action", required=True)
    verify = actions.add_parser("verify", help="compare this program with the golden trace in the policy's folder")
    verify.add_argument("folder", type=Path)
    verify.add_argument("--runtime", default="numpy", help="numpy or onnxruntime")
    describe = actions.add_parser("describe", help="write policy.json and golden.csv again; needs the package sandgait")
    describe.add_argument("folder", type=Path)
    given = parser.parse_args(arguments)
    try:
        if given.action == "describe":
            print(_describe(given.folder))
            return 0
        verified = Controller(given.folder, runtime=given.runtime).verify()
    except Refused as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(verified)
    return 0 if verified else 1


def _describe(folder: Path) -> str:
    try:
        from sandgait.deploy import describe
    except ImportError:
        raise Refused("describe: the package sandgait is not installed: pip install sandgait, on the machine that "
                      "trained the policy") from None  # fmt: skip
    return describe(folder)


if __name__ == "__main__":
    sys.exit(main())
