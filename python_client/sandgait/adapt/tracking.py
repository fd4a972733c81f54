"""How the robot of a log followed its commands, and how a simulated one follows the same."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sandgait_deploy import Policy

from .servo import Array, table

#: Time after the beginning of a command that is not counted [s]: as in `sandgait certify`.
_BEGINNING = 1.5

#: Least time of a command that is counted, after its beginning [s]: our choice, some two strides.
_LEAST = 1.0

_COMMAND, _VELOCITY = ("command_x", "command_y", "command_yaw"), ("lin_vel_x", "lin_vel_y", "gyro_z")


@dataclass(frozen=True)
class Followed:
    """A command of a log and the robot's mean velocity: forward, to the left [m/s], yaw [rad/s]."""

    command: Array
    velocity: Array
    #: |command|, but at least a tenth of the policy's greatest command.
    size: float

    @property
    def error(self) -> float:
        """|velocity − command| / |command|"""
        return float(np.linalg.norm(self.velocity - self.command)) / self.size


def followed(log: Path, policy: Policy) -> list[Followed]:
    """Each command of the log, and how it was followed; empty if the log lacks commands or the base's velocity."""
    columns = table(log)
    if any(name not in columns or np.isnan(columns[name]).any() for name in (*_COMMAND, *_VELOCITY, "t")):
        return []
    commands, velocities = (np.array([columns[name] for name in names]).T for names in (_COMMAND, _VELOCITY))
    runs = columns["run"] if "run" in columns else np.zeros(len(commands))
    changes = np.any(commands[1:] != commands[:-1], axis=1) | (runs[1:] != runs[:-1])
    small = 0.1 * float(np.abs(policy.commands).max())
    found = []
    for rows in np.split(np.arange(len(commands)), 1 + np.flatnonzero(changes)):
        time = columns["t"][rows] - columns["t"][rows[0]]
        steady = rows[time >= _BEGINNING]
        if time[-1] >= _BEGINNING + _LEAST:
            command = commands[steady[0]]
            size = max(float(np.linalg.norm(command)), small)
            found.append(Followed(command, velocities[steady].mean(axis=0), size))
    return found


def nearest(lines: Sequence[dict[str, Any]], command: Array) -> dict[str, Any]:
    """The line of `nine_commands` whose command is the nearest."""
    return min(lines, key=lambda line: float(np.linalg.norm(np.array(line["command"]) - command)))


def compared(logged: Sequence[Followed], lines: Sequence[dict[str, Any]]) -> tuple[float, float]:
    """Mean error of the log's commands, and of the nearest of the simulated `lines` of `nine_commands`."""
    simulated = [error_of(nearest(lines, one.command)) for one in logged]
    return float(np.mean([one.error for one in logged])), float(np.mean(simulated))


def error_of(line: dict[str, Any]) -> float:
    """The error of a command; a fall counts as one of 100 %."""
    return 1.0 if line["falls"] > 0 else float(line["error"])
