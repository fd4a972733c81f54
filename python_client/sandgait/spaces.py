"""A task's tables, and gymnasium spaces made from them.

The server sends the tables when a session is opened: names, units and bounds of every number.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from .errors import InvalidRequest


@dataclass(frozen=True)
class Column:
    """One number of a row; `unit` is SI, "1" where dimensionless."""

    name: str
    unit: str
    low: float
    high: float


@dataclass(frozen=True)
class Option:
    """One keyword of `gymnasium.make`; with `at_reset` also of `reset(options=...)`."""

    name: str
    summary: str
    default: Any
    at_reset: bool


@dataclass(frozen=True)
class Task:
    """A task's description by the server."""

    id: str
    summary: str
    observation: tuple[Column, ...]
    action: tuple[Column, ...]
    #: Weighted reward terms first, then other figures of a step.
    info: tuple[Column, ...]
    #: How many leading columns of `info` are reward terms; the reward is their sum.
    reward_terms: int
    max_episode_steps: int
    #: Control steps a second of simulated time [Hz].
    control_rate: float
    options: tuple[Option, ...]

    @classmethod
    def of(cls, fields: Any) -> Task:
        """A task from its fields in order, with columns and options as tuples."""
        id, summary, observation, action, info, terms, steps, rate, options = fields
        observation, action, info = (tuple(Column(*c) for c in table) for table in (observation, action, info))
        options = tuple(Option(*option) for option in options)
        return cls(id, summary, observation, action, info, terms, steps, rate, options)


def box(columns: tuple[Column, ...]) -> spaces.Space[npt.NDArray[np.float32]]:
    """Box of float32 [len(columns)] with each column's own bounds."""
    low = np.array([c.low for c in columns], dtype=np.float32)
    high = np.array([c.high for c in columns], dtype=np.float32)
    return cast("spaces.Space[npt.NDArray[np.float32]]", spaces.Box(low, high, dtype=np.float32))


class Actions:
    """Prepares actions for sending. Errors use `name` for them; with `clip` they are clipped to their bounds."""

    def __init__(self, space: spaces.Space[npt.NDArray[np.float32]], name: str, clip: bool) -> None:
        box = cast("spaces.Box", space)
        self._low, self._high, self._name, self._clip = box.low, box.high, name, clip

    def rows(self, actions: npt.ArrayLike) -> npt.NDArray[np.float32]:
        """The caller's `actions` as float32 of the right shape; a copy if it was clipped."""
        rows = np.asarray(actions, dtype=np.float32)
        if rows.shape != self._low.shape:
            raise InvalidRequest(f"{self._name}: shape {rows.shape}, expected {self._low.shape}")
        return np.clip(rows, self._low, self._high) if self._clip else rows

    def explain(self, error: BaseException) -> BaseException:
        """Adds a remedy to the refusal of an action beyond its bounds; other errors are unchanged."""
        text = str(error)
        if not isinstance(error, InvalidRequest) or not text.startswith("actions[") or "NaN" in text or "nan" in text:
            return error
        return InvalidRequest(f"{text}; clip_actions=True clips")
