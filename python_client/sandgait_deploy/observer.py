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
        self._subtracted = np.zeros(len(policy.joints))
        for column in present:
            if column.reading == "joint_position":
                self._subtracted[column.index] = column.subtract
        self._rows: list[Row] = []
        self._positions: Floats | None = None

    def forget(self) -> None:
        """The next observation is the first one."""
        self._rows, self._positions = [], None

    def remember(self, observation: Row, positions: Floats) -> None:
        """Begins in the middle of a walk, whose last observation and positions of joints were these."""
        rows = observation.reshape(self._policy.history, self._width)
        self._rows, self._positions = list(rows[: self._policy.history - 1]), self._offsets(positions)

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
            offsets = self._offsets(read["joint_position"])
            before = offsets if self._positions is None else self._positions
            own["joint_velocity"] = (offsets - before) / (1.0 / policy.rate)
            self._positions = offsets
        all = {**read, **own}
        row = np.array(
            [_value(all[c.reading][c.index] - c.subtract, c.part) for c in policy.observation[: self._width]]
        )
        row = np.clip(row.astype(np.float32), self._low, self._high)
        before_rows = self._rows or [row] * (policy.history - 1)
        self._rows = [row, *before_rows][: policy.history - 1]
        return np.concatenate([row, *before_rows])

    def _offsets(self, positions: Floats) -> Floats:
        """Positions as the simulator keeps them for differences: off the default pose, in 32 bits."""
        return (positions - self._subtracted).astype(np.float32).astype(np.float64)


def _value(number: float, part: str) -> float:
    if part == "value":
        return number
    return math.sin(number) if part == "sine" else math.cos(number)
