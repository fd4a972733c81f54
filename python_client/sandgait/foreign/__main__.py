"""`python -m sandgait.foreign DESCRIPTION.toml --out FOLDER`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from sandgait_deploy import Refused

from . import import_policy


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit code 0; 2 with one line if description, network or robot cannot be used, and nothing is written."""
    parser = argparse.ArgumentParser(
        prog="python -m sandgait.foreign", description="Makes a policy of LeggedVelocity from a foreign one."
    )
    parser.add_argument("description", type=Path, help="the TOML file that describes it")
    parser.add_argument("--out", type=Path, required=True, metavar="FOLDER", help="a new folder for the policy")
    given = parser.parse_args(arguments)
    try:
        print(f"{import_policy(given.description, given.out)}: policy.onnx, policy.json, settings.json, golden.csv")
    except Refused as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
