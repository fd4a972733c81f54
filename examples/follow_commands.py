"""Measures how well a robot follows commanded velocities: a table with one line for each command, for a policy of
LeggedVelocity.

    python examples/follow_commands.py runs/go1/policy.onnx --options '{"robot": "go1.xml", "ground": "rigid"}'

Episodes have no randomization: no pushes, nominal sand and nominal masses. The command stays the same for an episode.
Speeds are in the base's frame, and are means over the robots and the last four of six seconds.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

import sandgait

#: Commands: forward and sideways speed [m/s] and yaw rate [rad/s]. They use half or nearly all of the training's range,
#: one component alone or several together.
COMMANDS = (
    (0.5, 0.0, 0.0),
    (0.9, 0.0, 0.0),
    (-0.5, 0.0, 0.0),
    (0.0, 0.4, 0.0),
    (0.0, -0.4, 0.0),
    (0.0, 0.0, 0.8),
    (0.0, 0.0, -0.8),
    (0.6, 0.0, 0.6),
    (0.6, 0.3, 0.0),
)

#: Number of robots for each command, duration [s], and the time at the start that is not counted [s].
ROBOTS, SECONDS, BEGINNING = 16, 6.0, 2.0

#: Training uses small seeds; the seeds of an evaluation start here.
FIRST_SEED = 1_000_000


@dataclass
class Line:
    """A command, the mean velocity [m/s, m/s, rad/s], and the share of robots that fell."""

    command: tuple[float, float, float]
    speed: npt.NDArray[np.float64]
    fell: float

    @property
    def error(self) -> float:
        """|velocity − command| / |command|. Yaw rates have the same weight as in legged_gym's rewards."""
        command = np.array(self.command)
        return float(np.linalg.norm(self.speed - command) / np.linalg.norm(command))


def follow(onnx: Path, command: tuple[float, float, float], options: Mapping[str, Any]) -> Line:
    """Runs episodes with the constant `command`, and measures the robots' velocities."""
    names = ("lin_vel_x", "lin_vel_y", "ang_vel_yaw")
    calm = {"push_interval": 0.0, "max_push_vel_xy": 0.0, "friction_range": [1.0, 1.0], "sand_range": [1.0, 1.0]}
    calm |= {"added_mass_range": [0.0, 0.0], "motor_strength_range": [1.0, 1.0]}
    held = {"commands": {n: [v, v] for n, v in zip(names, command, strict=True)}, "domain_rand": calm}
    env = sandgait.SandgaitVectorEnv("sandgait/LeggedVelocity-v0", ROBOTS, **{**options, **held})
    env.reset(seed=FIRST_SEED)
    rate = env.task.control_rate
    rollout = env.rollout_policy(onnx, round(SECONDS * rate), trajectories=True)
    columns = [column.name for column in env.task.observation]
    env.close()
    chosen = [columns.index(name) for name in ("base_lin_vel x", "base_lin_vel y", "base_ang_vel z")]
    rows = rollout.observations[round(BEGINNING * rate) :, :, :][..., chosen]
    fell = rollout.terminated.astype(bool)
    standing = rows[:, ~fell] if not fell.all() else rows
    return Line(command, standing.mean(axis=(0, 1)).astype(np.float64), float(fell.mean()))


def table(lines: list[Line]) -> str:
    """A table with one line for each command, and a line with the mean error."""
    text = ["forward  sideways  yaw (commanded)    forward  sideways    yaw   error   fell"]
    for line in lines:
        (a, b, c), (x, y, w) = line.command, line.speed
        text.append(f"{a:7.2f} {b:9.2f} {c:4.1f} {x:22.2f} {y:9.2f} {w:6.2f} {line.error:6.0%} {line.fell:6.0%}")
    text.append(f"mean error {np.mean([line.error for line in lines]):.0%}")
    return "\n".join(text)


def main() -> None:
    parser = argparse.ArgumentParser(description=str(__doc__).split("\n\n", maxsplit=1)[0])
    parser.add_argument("policy", type=Path, help="policy.onnx of `sandgait train` or of sandgait.export_onnx")
    parser.add_argument("--options", type=json.loads, default={}, help="the options of the policy's training, as JSON")
    arguments = parser.parse_args()
    print(table([follow(arguments.policy, command, arguments.options) for command in COMMANDS]))


if __name__ == "__main__":
    main()
