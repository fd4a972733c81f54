"""The log of a Controller: the CSV of a robot's log that `sandgait diagnose` reads, with what the Controller did."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

import numpy as np

from .errors import Refused
from .policy import Floats, Policy

if TYPE_CHECKING:
    from .controller import Output

_QUATERNION = ("quat_w", "quat_x", "quat_y", "quat_z")
_XYZ = {"gyroscope": "gyro", "accelerometer": "acc", "lin_vel": "lin_vel"}
_JOINTS = {"joint_position": "q", "joint_velocity": "qd", "joint_torque": "tau"}


class Log:
    """Writes one row for each step of a walk. Each walk is a run. A reading that is absent is blank."""

    def __init__(self, path: str | Path, policy: Policy) -> None:
        self._policy = policy
        self._runs, self._before = 0, ""
        names = ["run", "t", *_QUATERNION, *(f"{short}_{axis}" for short in _XYZ.values() for axis in "xyz")]
        names += [f"{short}:{joint}" for short in _JOINTS.values() for joint in policy.joints]
        names += ["command_x", "command_y", "command_yaw"]
        driven = [servo.joint for servo in policy.servos]
        names += [f"{kind}:{joint}" for kind in ("target", "action") for joint in driven]
        try:
            self._file: TextIO = open(path, "w", encoding="utf-8")  # noqa: SIM115 - closed by `close`
        except OSError as error:
            raise Refused(f"log: {path}: {error.strerror}; give a path in a folder that exists") from None
        self._file.write(",".join(names) + "\n")

    def row(self, read: dict[str, Floats], command: Floats, targets: Floats | None, output: Output) -> None:
        policy, before = self._policy, self._before
        self._before = output.state
        if output.state != "walking":
            return
        self._runs += before != "walking"
        cells = [f"walk{self._runs}", _text(read["time"][0]), *_cells(read.get("quaternion"), 4)]
        for name in _XYZ:
            cells += _cells(read.get(name), 3)
        for name in _JOINTS:
            cells += _cells(read.get(name), len(policy.joints))
        cells += _cells(command, 3)
        cells += _cells(targets, len(policy.servos)) + _cells(output.action, len(policy.servos))
        self._file.write(",".join(cells) + "\n")

    def close(self) -> None:
        self._file.close()


def _cells(row: Any, size: int) -> list[str]:
    return [""] * size if row is None else [_text(number) for number in row]


def _text(number: float) -> str:
    return str(np.format_float_positional(number, precision=7, unique=True, trim="-"))
