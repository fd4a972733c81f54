"""The command line of `sandgait adapt`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from sandgait_deploy import Refused, policy_folder

from ..command_line import CommandParser, unwritten
from ..errors import SandgaitError
from .loop import COEFFICIENT_SD, Request, adapt
from .page import page, summary


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit code 0: there is a new policy, and its predicted gain is above 0; 1: nothing changed, keep the old policy,
    or the results cannot be written after all; 2: something cannot be used, and nothing is written."""
    given = _parser().parse_args(arguments)
    folder = policy_folder(given.policy)
    out = given.out or folder.with_name(f"{folder.name}-adapted")
    request = Request(
        log=given.log,
        policy=folder,
        robot=given.robot,
        out=out,
        medium=given.medium,
        coefficient_sd=given.coefficient_sd,
        seconds=given.seconds,
        timesteps=given.timesteps,
        seed=given.seed,
    )
    try:
        adaptation = adapt(request, lambda stage: print(f"sandgait: {stage}", file=sys.stderr))
        (out / "adapt.html").write_text(page(adaptation), encoding="utf-8")
    except OSError as error:
        print(f"sandgait: {unwritten(out, error)}", file=sys.stderr)
        return 1
    except (Refused, SandgaitError) as error:
        print(f"sandgait: {error}", file=sys.stderr)
        return 2
    print("\n".join(summary(adaptation)))
    return 0 if adaptation.adapted else 1


def _parser() -> argparse.ArgumentParser:
    parser = CommandParser(
        "adapt",
        "Trains a policy on over what its robot's log says of sand and motors, if the log can tell, and "
        "predicts the gain.",
    )
    parser.add_argument("log", type=Path, help="the CSV of the Controller, or any robot's log that diagnose reads")
    parser.add_argument("--policy", type=Path, required=True, help="the folder that sandgait train wrote")
    parser.add_argument("--robot", type=Path, required=True, help="the robot's file with which the policy was trained")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder of the results [default: POLICY-adapted]")
    parser.add_argument("--medium", help="the sand that was assumed [default: that of the training]")
    parser.add_argument(
        "--coefficient-sd",
        type=float,
        default=COEFFICIENT_SD,
        metavar="F",
        help="scatter of the assumed sand's coefficients, relative [%(default)s]",
    )
    parser.add_argument("--seconds", type=float, default=300.0, metavar="S", help="of training [%(default)s]")
    parser.add_argument(
        "--timesteps", type=int, metavar="N", help="end the training after this number of steps instead"
    )
    parser.add_argument(
        "--seed", type=int, default=0, metavar="N", help="of the training and of the worlds [%(default)s]"
    )
    return parser
