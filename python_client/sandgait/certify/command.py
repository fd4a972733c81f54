"""The command line of `sandgait certify`."""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from sandgait_deploy import Refused, policy_folder

from ..command_line import CommandParser, check_file, unwritten
from ..errors import SandgaitError
from ..foreign import import_policy, read_description
from .certificate import LATENCY, Request, certify
from .page import page
from .sheet import sheet


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit code 0: deploy; 1: do not deploy, or the page cannot be written after all; 2: policy, robot or an argument
    cannot be used, and nothing is written."""
    given = _parser().parse_args(arguments)
    try:
        with tempfile.TemporaryDirectory() as folder:
            certificate = certify(_request(given, Path(folder)), _Told())
    except (Refused, SandgaitError) as error:
        print(f"sandgait: {error}", file=sys.stderr)
        return 2
    print(sheet(certificate), end="")
    for path, text in ((given.out, page(certificate)), (given.json, certificate.to_json() + "\n")):
        try:
            if path:
                path.write_text(text, encoding="utf-8")
        except OSError as error:
            print(f"sandgait: {unwritten(path, error)}", file=sys.stderr)
            return 1
    return 0 if certificate.deploy else 1


def _parser() -> argparse.ArgumentParser:
    parser = CommandParser(
        "certify",
        "Drives a robot by its policy in MuJoCo, on sand and on hard ground, and says whether it may leave "
        "the simulator. Exit code 0: deploy; 1: do not deploy.",
    )
    parser.add_argument(
        "policy",
        type=Path,
        help="the folder that sandgait train wrote, or its policy.onnx, or the TOML file of a foreign policy",
    )
    parser.add_argument(
        "--robot", type=Path, help="the robot's MJCF or URDF file, for MuJoCo [default: that of the TOML file]"
    )
    parser.add_argument("--ground", help="rigid, a medium or a sand.toml [default: that of the training]")
    parser.add_argument(
        "--latency", type=float, default=LATENCY, metavar="S", help="from a reading to the motors [%(default)s]"
    )
    parser.add_argument(
        "--noise", type=float, default=1.0, metavar="F", help="factor on legged_gym's noise [%(default)s]"
    )
    parser.add_argument(
        "--motors", type=float, default=1.0, metavar="F", help="factor on the motors' torques [%(default)s]"
    )
    parser.add_argument(
        "--payload", type=float, default=0.0, metavar="F", help="part of the robot's mass [%(default)s]"
    )
    parser.add_argument("--quick", action="store_true", help="only the cases that the verdict needs")
    parser.add_argument("--jobs", type=int, metavar="N", help="processes [default: one for each processor]")
    parser.add_argument("--out", type=Path, metavar="PAGE.html", help="write the certificate as a page")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all numbers as JSON")
    return parser


def _request(given: argparse.Namespace, temporary: Path) -> Request:
    """`temporary`: an empty folder, for a foreign policy."""
    for name, value, low, high in (
        ("latency", given.latency, 0.0, 0.5),
        ("noise", given.noise, 0.0, 100.0),
        ("motors", given.motors, 0.01, 10.0),
        ("payload", given.payload, 0.0, 10.0),
        ("jobs", given.jobs or 1, 1, 1024),
    ):
        if not low <= value <= high:
            raise Refused(f"--{name}: {value} is outside [{low:g}, {high:g}]")
    for path in (given.out, given.json):
        if path is not None:
            check_file(path)
    folder, robot = _policy(given, temporary)
    return Request(
        folder=folder,
        robot=robot,
        ground=given.ground,
        latency=given.latency,
        noise=given.noise,
        motor_strength=given.motors,
        payload=given.payload,
        quick=given.quick,
        processes=given.jobs,
        shown=str(given.policy) if _is_foreign(given.policy) else "",
    )


def _is_foreign(policy: Path) -> bool:
    return policy.suffix == ".toml"


def _policy(given: argparse.Namespace, temporary: Path) -> tuple[Path, Path]:
    """The folder of the policy, which for a foreign one is made, and the robot's file."""
    if _is_foreign(given.policy):
        robot: Path = given.robot or read_description(given.policy).robot
        return import_policy(given.policy, temporary), robot
    if given.robot is None:
        raise Refused("--robot: is missing; give the MJCF or URDF with which the policy was trained")
    return policy_folder(given.policy), given.robot


class _Told:
    """A line of progress on a terminal."""

    def __call__(self, stage: str) -> None:
        if sys.stderr.isatty():
            print(f"{stage:<70}", end="\r", file=sys.stderr, flush=True)
