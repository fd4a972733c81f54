"""How the robot of a log followed its commands, and how a simulated one follows the same."""

from __future__ import annotations

from collections.abc import Sequence
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


def followed(log: Path, policy: Policy) -> list[tuple[Array, float]]:
    """Each command of the log with the error with which it was followed, |mean velocity − command| / |command|; empty
    if the log lacks commands or the base's velocity."""
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
            error = np.linalg.norm(velocities[steady].mean(axis=0) - command)
            found.append((command, float(error) / max(float(np.linalg.norm(command)), small)))
    return found


def compared(logged: Sequence[tuple[Array, float]], lines: Sequence[dict[str, Any]]) -> tuple[float, float]:
    """Mean error of the log's commands, and of the nearest of the simulated `lines` of `nine_commands`."""
    simulated = np.array([line["command"] for line in lines])
    nearest = [int(np.linalg.norm(simulated - command, axis=1).argmin()) for command, _ in logged]
    return float(np.mean([error for _, error in logged])), float(np.mean([error_of(lines[k]) for k in nearest]))


def error_of(line: dict[str, Any]) -> float:
    """The error of a command; a fall counts as one of 100 %."""
    return 1.0 if line["falls"] > 0 else float(line["error"])
