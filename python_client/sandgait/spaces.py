"""A task's columns, and the gymnasium spaces made from them.

When a session is opened, the server sends the name, unit and bounds of every column.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from .arguments import numbers, shown
from .errors import InvalidRequest


@dataclass(frozen=True)
class Column:
    """A number of an observation, an action or an info row. `unit` is SI, "1" for a dimensionless number."""

    name: str
    unit: str
    low: float
    high: float


@dataclass(frozen=True)
class Option:
    """A keyword of `gymnasium.make`. With `at_reset` it is also an option of `reset(options=...)`."""

    name: str
    summary: str
    default: Any
    at_reset: bool


@dataclass(frozen=True)
class Task:
    """The server's description of a task."""

    id: str
    summary: str
    observation: tuple[Column, ...]
    action: tuple[Column, ...]
    #: First the weighted reward terms, then other figures of a step.
    info: tuple[Column, ...]
    #: Number of reward terms, the first columns of `info`. Their sum is the reward.
    reward_terms: int
    max_episode_steps: int
    #: Control steps in a second of simulated time [Hz].
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
    """A gymnasium Box of float32 [columns] with the columns' bounds."""
    low = np.array([c.low for c in columns], dtype=np.float32)
    high = np.array([c.high for c in columns], dtype=np.float32)
    return cast("spaces.Space[npt.NDArray[np.float32]]", spaces.Box(low, high, dtype=np.float32))


#: Info columns with this prefix are exact values of sensors. As many columns follow that are called `next privileged
#: …`: if an episode ended in the step, they are those of the next episode's first observation.
_PRIVILEGED = "privileged "


def info_columns(
    columns: tuple[Column, ...],
) -> tuple[list[str], spaces.Space[npt.NDArray[np.float32]] | None]:
    """Names of the info columns without the exact values of sensors, which come last, and the space of these values;
    None if there are none."""
    exact = tuple(c for c in columns if c.name.startswith(_PRIVILEGED))
    names = [c.name for c in columns[: len(columns) - 2 * len(exact)]]
    return names, box(exact) if exact else None


def commands(command: npt.ArrayLike, num_envs: int) -> npt.NDArray[np.float32]:
    """Rows [num_envs, 3] of a command [3] or of one for each environment."""
    try:
        rows = np.broadcast_to(numbers("command", command, np.float32), (num_envs, 3))
    except ValueError:
        raise InvalidRequest(f"command: expected numbers [3] or [{num_envs}, 3], got {shown(command)}") from None
    return np.ascontiguousarray(rows)


def check_seed(seed: int | None, name: str = "seed") -> None:
    """Refuses a seed that has no 64 bits."""
    if seed is not None and not 0 <= seed < 2**64:
        raise InvalidRequest(f"{name}: {seed} is outside [0, 2**64)")


def privileged(infos: npt.NDArray[np.float32], names: list[str], ended: Any = False) -> npt.NDArray[np.float32]:
    """Exact values of sensors, float32 [envs, values], from info columns [info, envs] whose first ones are `names`;
    where `ended`, those of the next episode's first observation."""
    present, following = np.split(infos[len(names) :], 2)
    return np.where(ended, following, present).T


class Actions:
    """Prepares actions for sending. `clip`: clip them to their bounds. `name`: name of the actions in errors."""

    def __init__(self, space: spaces.Space[npt.NDArray[np.float32]], name: str, clip: bool) -> None:
        box = cast("spaces.Box", space)
        self._low, self._high, self._name, self._clip = box.low, box.high, name, clip

    def rows(self, actions: npt.ArrayLike) -> npt.NDArray[np.float32]:
        """The caller's `actions` as float32 of the right shape. It is a copy if actions were clipped."""
        rows = numbers(self._name, actions, np.float32)
        if rows.shape != self._low.shape:
            raise InvalidRequest(f"{self._name}: shape {rows.shape}, expected {self._low.shape}")
        return np.clip(rows, self._low, self._high) if self._clip else rows

    def explain(self, error: BaseException) -> BaseException:
        """The refusal of an action beyond its bounds, with the action's name here and the advice `clip_actions=True`.
        Other errors are unchanged."""
        text = str(error)
        if not isinstance(error, InvalidRequest) or not text.startswith("actions["):
            return error
        advice = "" if "nan" in text.lower() else "; clip_actions=True clips"
        own = text if self._name == "actions" else text.replace("actions[0]", self._name, 1)
        return InvalidRequest(own + advice)
