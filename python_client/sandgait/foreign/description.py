"""The description of a foreign policy: a TOML file that says how its network is run. docs/foreign_policies.md has the
keys."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sandgait_deploy import Refused

from ..errors import InvalidRequest, unknown

Floats = npt.NDArray[np.float64]

#: Terms of an observation: the reading of `sandgait_deploy` that each is made of. The names are those of the functions
#: of Isaac Lab (`isaaclab.envs.mdp.observations`) and mjlab, and of legged_gym's (`legged_robot.py`,
#: `compute_observations`).
TERMS = {
    "base_lin_vel": "lin_vel",
    "base_ang_vel": "gyroscope",
    "projected_gravity": "gravity",
    "velocity_commands": "command",
    "commands": "command",
    "joint_pos": "joint_position",
    "joint_pos_rel": "joint_position",
    "dof_pos": "joint_position",
    "joint_vel": "joint_velocity",
    "joint_vel_rel": "joint_velocity",
    "dof_vel": "joint_velocity",
    "last_action": "last_action",
    "actions": "last_action",
    "gait_phase": "clock",
}

#: Terms whose positions are not off the default pose.
ABSOLUTE = ("joint_pos",)

#: Parts of a gait's phase: place in the reading `clock`, and sign. A foot half a period later has the negative ones.
PARTS = {"sin": (0, 1.0), "cos": (1, 1.0), "-sin": (0, -1.0), "-cos": (1, -1.0)}

#: Control steps in a second [Hz]: those of LeggedVelocity.
RATE = 50.0

#: Greatest `action_scale` of LeggedVelocity [rad].
MOST_SCALE = 3.0

#: Options of LeggedVelocity that follow from the description.
OWN_OPTIONS = (
    "robot",
    "curriculum",
    "commands",
    "default_joint_angles",
    "stiffness",
    "damping",
    "action_scale",
    "gait_clock",
    "history",
    "sensors",
)

_KEYS = {
    "": ("network", "robot", "source", "control_period", "joints", "action", "observation", "history", "commands",
         "options"),
    "joints": ("names", "default", "kp", "kd"),
    "action": ("scale", "clip"),
    "observation": ("term", "scale", "period", "parts"),
    "history": ("length", "by", "first"),
    "commands": ("lin_vel_x", "lin_vel_y", "ang_vel_yaw"),
}  # fmt: skip


@dataclass(frozen=True)
class Term:
    """A term of the observation."""

    name: str
    #: Factor on each of its numbers.
    scale: Floats
    #: Of a gait's phase: its period [s], and what of it is observed.
    period: float = 0.0
    parts: tuple[str, ...] = ()

    @property
    def reading(self) -> str:
        return TERMS[self.name]


@dataclass(frozen=True)
class Description:
    """What the TOML file says. Arrays of joints are in the order of `joints`, which is the network's."""

    path: Path
    network: Path
    robot: Path
    #: Where the policy comes from, and its licence.
    source: str
    joints: tuple[str, ...]
    default: Floats
    kp: Floats
    kd: Floats
    action_scale: Floats
    #: Bound of the network's outputs before they are scaled; infinite if none is given.
    action_clip: float
    terms: tuple[Term, ...]
    history: int
    #: Is the history of a term in a row, before the next term begins? Otherwise whole observations follow each other.
    by_term: bool
    oldest_first: bool
    commands: dict[str, list[float]] = field(default_factory=dict)
    options: dict[str, Any] = field(default_factory=dict)

    @property
    def width(self) -> int:
        """How many numbers the network's input has."""
        return self.history * sum(len(term.scale) for term in self.terms)


def read_description(path: str | Path) -> Description:
    """The description in the TOML file `path`. Raises Refused with one line that names file, key and remedy."""
    place = Path(path)
    try:
        found = tomllib.loads(place.read_text(encoding="utf-8"))
    except OSError as error:
        raise Refused(f"{place}: cannot be read: {error.strerror}") from None
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise Refused(f"{place}: is no TOML file: {error}") from None
    try:
        return _description(place, found)
    except (Refused, InvalidRequest) as error:
        raise Refused(f"{place}: {error}") from None


def _description(place: Path, found: dict[str, Any]) -> Description:
    _known("", found)
    joints, action, history = (_table(found, name) for name in ("joints", "action", "history"))
    names = _texts(_needed(joints, "joints.names"), "joints.names")
    if not names or len(set(names)) != len(names):
        raise Refused("joints.names: must name each joint once, in the network's order")
    period = _number(found.get("control_period", 1.0 / RATE), "control_period")
    if abs(period * RATE - 1.0) > 1e-6:
        raise Refused(f"control_period: {period:g} s; LeggedVelocity acts every {1.0 / RATE:g} s, others are not run")
    options = _table(found, "options")
    wrong = [name for name in OWN_OPTIONS if name in options]
    if wrong:
        raise Refused(f"options: {wrong[0]} follows from the other keys; leave it out")
    count = len(names)
    return Description(
        path=place,
        network=_file(place, _needed(found, "network")),
        robot=_file(place, _needed(found, "robot")),
        source=str(found.get("source", "")),
        joints=names,
        default=_row(_needed(joints, "joints.default"), count, "joints.default"),
        kp=_row(_needed(joints, "joints.kp"), count, "joints.kp"),
        kd=_row(_needed(joints, "joints.kd"), count, "joints.kd"),
        action_scale=_positive(_row(_needed(action, "action.scale"), count, "action.scale"), "action.scale"),
        action_clip=float(_positive(_number(action.get("clip", math.inf), "action.clip"), "action.clip")),
        terms=_terms(found.get("observation"), count),
        history=_length(history.get("length", 1)),
        by_term=_one_of(history.get("by", "term"), "history.by", ("term", "step")) == "term",
        oldest_first=_one_of(history.get("first", "oldest"), "history.first", ("oldest", "newest")) == "oldest",
        commands={name: _range(value, f"commands.{name}") for name, value in _table(found, "commands").items()},
        options=options,
    )


def _terms(found: Any, joints: int) -> tuple[Term, ...]:
    if not isinstance(found, list) or not found or not all(isinstance(one, dict) for one in found):
        raise Refused("observation: give a table [[observation]] for each term, in the network's order")
    terms = tuple(_term(one, joints) for one in found)
    if len({term.period for term in terms if term.period}) > 1:
        raise Refused("observation: gait_phase has two periods; one clock is run")
    return terms


def _term(one: Mapping[str, Any], joints: int) -> Term:
    _known("observation", one)
    name = str(_needed(one, "observation.term"))
    if name not in TERMS:
        raise unknown("observation.term:", name, TERMS)
    if TERMS[name] != "clock":
        for key in ("period", "parts"):
            if key in one:
                raise Refused(f"observation.{key}: belongs to gait_phase, not to {name}")
        width = joints if TERMS[name] in ("joint_position", "joint_velocity", "last_action") else 3
        return Term(name, _row(one.get("scale", 1.0), width, f"the scale of {name}"))
    period = _number(_needed(one, "observation.period"), "observation.period")
    given = one.get("parts", ["sin", "cos"])
    parts = tuple(_one_of(part, "observation.parts", tuple(PARTS)) for part in _texts(given, "observation.parts"))
    return Term(name, _row(one.get("scale", 1.0), len(parts), f"the scale of {name}"),
                float(_positive(period, "observation.period")), parts)  # fmt: skip


def _known(table: str, found: Mapping[str, Any]) -> None:
    for key in found:
        if key not in _KEYS[table]:
            raise unknown(f"{table}:" if table else "key", key, _KEYS[table])


def _table(found: Mapping[str, Any], name: str) -> dict[str, Any]:
    table = found.get(name, {})
    if not isinstance(table, dict):
        raise Refused(f"{name}: must be a table [{name}]")
    if name in _KEYS:
        _known(name, table)
    return table


def _needed(found: Mapping[str, Any], name: str) -> Any:
    key = name.rpartition(".")[2]
    if key not in found:
        raise Refused(f"{name}: is missing")
    return found[key]


def _file(place: Path, name: Any) -> Path:
    """A file that the description names, relative to its own folder."""
    path = place.parent / str(name)
    if not path.is_file():
        raise Refused(f"{name}: there is no such file beside the description")
    return path


def _texts(value: Any, name: str) -> tuple[str, ...]:
    if not isinstance(value, list) or not all(isinstance(text, str) for text in value):
        raise Refused(f"{name}: is no list of texts")
    return tuple(value)


def _number(value: Any, name: str) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or math.isnan(value):
        raise Refused(f"{name}: {value!r} is no number")
    return float(value)


def _row(value: Any, count: int, name: str) -> Floats:
    """One number for all, or a list of one for each."""
    numbers = [value] * count if not isinstance(value, list) else value
    if len(numbers) != count:
        raise Refused(f"{name}: has {len(numbers)} numbers, {count} are needed")
    row = np.array([_number(number, name) for number in numbers])
    if not np.isfinite(row).all():
        raise Refused(f"{name}: is not finite")
    return row


def _positive(value: Any, name: str) -> Any:
    if not np.all(np.asarray(value) > 0.0):
        raise Refused(f"{name}: must be above 0")
    return value


def _length(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value < 1:
        raise Refused(f"history.length: {value!r} is no whole number from 1 on")
    return value


def _one_of(value: Any, name: str, known: tuple[str, ...]) -> str:
    if value not in known:
        raise Refused(f"{name}: {value!r} is none of {', '.join(known)}")
    return str(value)


def _range(value: Any, name: str) -> list[float]:
    row = _row(value, 2, name).tolist() if isinstance(value, list) else []
    if len(row) != 2 or row[0] > row[1]:
        raise Refused(f"{name}: {value!r} is no range [low, high]")
    return row
