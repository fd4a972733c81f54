"""From readings to the observation of a policy."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from .policy import Floats, Policy

Row = npt.NDArray[np.float32]


class Observer:
    """Makes observations from readings; remembers the rows of earlier steps, and the positions of the last one."""

    def __init__(self, policy: Policy) -> None:
        self._policy = policy
        self._width = len(policy.observation) // policy.history
        present = policy.observation[: self._width]
        self._low = np.array([c.low for c in present], np.float32)
        self._high = np.array([c.high for c in present], np.float32)
        self._rows: list[Row] = []
        self._positions: Floats | None = None

    def forget(self) -> None:
        """The next observation is the first one."""
        self._rows, self._positions = [], None

    def remember(self, observation: Row) -> None:
        """Begins in the middle of a walk, whose last observation was this one."""
        self._rows = list(observation.reshape(self._policy.history, self._width)[1:])

    def observe(self, read: Mapping[str, Floats], command: Floats, last_action: Row, seconds: float) -> Row:
        """The observation, f32 [observation]; `seconds`: time since the policy began."""
        policy = self._policy
        phase = 2.0 * math.pi * ((policy.clock_frequency * seconds) % 1.0)
        own = {
            "command": command,
            "last_action": last_action.astype(np.float64),
            "clock": np.array([math.sin(phase), math.cos(phase)]),
        }
        if policy.velocity_by_differences:
            before = read["joint_position"] if self._positions is None else self._positions
            own["joint_velocity"] = (read["joint_position"] - before) * policy.rate
            self._positions = read["joint_position"]
        all = {**read, **own}
        row = np.array(
            [_value(all[c.reading][c.index] - c.subtract, c.part) for c in policy.observation[: self._width]]
        )
        row = np.clip(row.astype(np.float32), self._low, self._high)
        before_rows = self._rows or [row] * (policy.history - 1)
        self._rows = [row, *before_rows][: policy.history - 1]
        return np.concatenate([row, *before_rows])


def _value(number: float, part: str) -> float:
    if part == "value":
        return number
    return math.sin(number) if part == "sine" else math.cos(number)
