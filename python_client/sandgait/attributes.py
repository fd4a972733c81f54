"""Refuses to set attributes of environments, because the simulation would not change.

A task option can change at a reset, or it is fixed when the environment is made.
"""

from __future__ import annotations

from typing import Any

from .errors import UnknownAttribute
from .spaces import Task

#: Keywords of the client itself, given when an environment is made.
KEYWORDS = frozenset(
    (
        "address",
        "autoreset_mode",
        "clip_actions",
        "isolated",
        "num_envs",
        "render_camera",
        "render_mode",
        "render_size",
        "resume",
        "threads",
    )
)


def refusal(task: Task, name: str, value: Any) -> UnknownAttribute:
    """The error that says why attribute `name` cannot be set, and what to do instead."""
    option = next((o for o in task.options if o.name == name), None)
    if option is not None and option.at_reset:
        return UnknownAttribute(
            f"{name}: as an attribute it would not reach the simulation; use reset(options={{{name!r}: {value!r}}}), "
            f"with stable-baselines3 set_options({{{name!r}: {value!r}}}) before reset()"
        )
    if option is not None or name in KEYWORDS:
        return UnknownAttribute(
            f"{name}: fixed when the environment is made; give it to gymnasium.make, gymnasium.make_vec or "
            f"sandgait.make_sb3: {name}={value!r}"
        )
    known = ", ".join(o.name for o in task.options if o.at_reset)
    return UnknownAttribute(f"{name}: the simulation has no option of this name; reset(options=...) takes {known}")
