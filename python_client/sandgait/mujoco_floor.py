"""The floor of a MuJoCo model, which sand replaces: where it is, and how its contacts end."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from .errors import InvalidRequest
from .sand import Sand

try:
    import mujoco
except ImportError as error:
    raise ImportError("mujoco is not installed: pip install 'sandgait[mujoco]'") from error

#: Colour of the sand's surface: our choice.
SAND_COLOUR = (0.76, 0.65, 0.46, 1.0)
#: Differences between floor and sand that count as rounding [m, and radians]: our choice, a tenth of a millimetre.
_ROUNDING = 1e-4

_GEOM = mujoco.mjtGeom


def body_name(model: mujoco.MjModel, body: int) -> str:
    return mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, body) or f"body {body}"


def number_of(model: mujoco.MjModel, kind: mujoco.mjtObj, name: str) -> int:
    number = mujoco.mj_name2id(model, kind, name)
    if number < 0:
        what = "body" if kind == mujoco.mjtObj.mjOBJ_BODY else "geom"
        raise InvalidRequest(f"{what}: the model has none with the name {name!r}")
    return int(number)


def find_floors(model: mujoco.MjModel, data: mujoco.MjData, names: Iterable[str] | None) -> list[int]:
    """The geoms called `names`, or else all planes and height fields that do not move and are not steep."""
    if names is not None:
        if isinstance(names, str):
            raise InvalidRequest("floor: is a name, not a list of names")
        return [number_of(model, mujoco.mjtObj.mjOBJ_GEOM, name) for name in names]
    flat = (int(_GEOM.mjGEOM_PLANE), int(_GEOM.mjGEOM_HFIELD))
    fixed = model.body_weldid[model.geom_bodyid] == 0
    still = [g for g in range(model.ngeom) if int(model.geom_type[g]) in flat and fixed[g]]
    # Steeper planes are walls.
    return [g for g in still if data.geom_xmat[g][8] > 0.7]


def collide(model: mujoco.MjModel, one: int, other: int) -> bool:
    kind, meets = model.geom_contype, model.geom_conaffinity
    return bool(kind[one] & meets[other] or kind[other] & meets[one])


def compare_floors(
    model: mujoco.MjModel, data: mujoco.MjData, floors: list[int], sand: Sand
) -> tuple[list[int], list[str]]:
    """The floors that are planes and the sand's surface, and a note on each floor that is elsewhere.

    Sand with a relief is meant to differ from a plane, so it has no notes, and no plane shows it.
    """
    same: list[int] = []
    notes: list[str] = []
    if sand._is_relief:
        return same, notes
    height, normal = sand.surface(0.0, 0.0)
    slope = float(np.degrees(np.arcsin(-normal[0])))
    there = f"the sand at {height:.4g} m" if normal[2] == 1.0 else f"the sand rises by {slope:.4g}° towards +x"
    for floor in floors:
        name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_GEOM, floor)
        called = f"floor {name!r}" if name else f"floor {floor}"
        if model.geom_type[floor] == _GEOM.mjGEOM_HFIELD:
            notes.append(f"{called} is a height field, {there}; give Sand(relief={{'spacing': …, 'heights': …}})")
        elif model.geom_type[floor] == _GEOM.mjGEOM_PLANE:
            own = data.geom_xmat[floor].reshape(3, 3)[:, 2]
            at = float(own @ data.geom_xpos[floor] / own[2])
            rises = float(np.degrees(np.arctan2(-own[0], own[2])))
            if np.abs(own - normal).max() > _ROUNDING and own[2] < 1.0 - _ROUNDING**2:
                options = f"slope_deg={rises:.4g}" + (f", height={at:.4g}" if abs(at) > _ROUNDING else "")
                hint = (
                    "sand rises towards x only: turn the model" if abs(own[1]) > _ROUNDING else f"give Sand({options})"
                )
                notes.append(f"{called} is inclined by {np.degrees(np.arccos(own[2])):.4g}°, {there}; {hint}")
            elif abs(at - height) > _ROUNDING:
                notes.append(f"{called} is at {at:.4g} m, the sand at {height:.4g} m; give Sand(height={at:.4g})")
            elif normal[2] == 1.0:
                same.append(floor)
    return same, notes


_CONTACTS = ("geom_contype", "geom_conaffinity", "geom_rgba", "geom_matid", "pair_margin")
_OPTIONS = ("integrator", "disableflags", "enableflags")


def saved_options(model: mujoco.MjModel) -> dict[str, Any]:
    """What `replace_floor` and `add_sand` change."""
    saved = {name: getattr(model, name).copy() for name in _CONTACTS}
    return saved | {name: getattr(model.opt, name) for name in _OPTIONS}


def restore_options(model: mujoco.MjModel, saved: dict[str, Any]) -> None:
    for name in _CONTACTS:
        getattr(model, name)[:] = saved[name]
    for name in _OPTIONS:
        setattr(model.opt, name, saved[name])


def replace_floor(model: mujoco.MjModel, floors: list[int], bodies: list[int], same: list[int]) -> bool:
    """Ends the contacts of bodies on sand with the floor. The planes in `same`, which are the sand's surface, show it.

    Returns whether there are such planes.
    """
    on_sand = np.isin(model.body_weldid[model.geom_bodyid], bodies)
    others = [g for g in range(model.ngeom) if not on_sand[g] and g not in floors]
    stand = [[g for g in others if collide(model, g, f)] for f in floors]
    used = int(np.bitwise_or.reduce(model.geom_contype | model.geom_conaffinity, initial=0))
    free = next((bit for bit in range(31) if not used >> bit & 1), None)
    if free is None and any(stand):
        raise InvalidRequest("floor: all 31 bits of contype and conaffinity are in use, none is left for other bodies")
    for floor, standing in zip(floors, stand, strict=True):
        model.geom_contype[floor] = 1 << free if standing and free is not None else 0
        model.geom_conaffinity[floor] = 0
        if free is not None:
            model.geom_conaffinity[standing] |= 1 << free
    for pair in range(model.npair):
        first, second = int(model.pair_geom1[pair]), int(model.pair_geom2[pair])
        if (first in floors and on_sand[second]) or (second in floors and on_sand[first]):
            model.pair_margin[pair] = -1e6  # no two geoms overlap that deeply, so they never touch
    drawn = False
    for floor in floors:
        model.geom_matid[floor] = -1
        shows = floor in same
        model.geom_rgba[floor] = SAND_COLOUR if shows else (0, 0, 0, 0)
        drawn |= shows
    return drawn
