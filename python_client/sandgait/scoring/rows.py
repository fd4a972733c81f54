"""The rows of the scoreboard: bodies that moved through sand, and the forces that were measured on them.

`data/scoreboard.toml` describes all rows and names the files that have them. A folder of the user has such files, too.
"""

from __future__ import annotations

import csv
import math
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ..arguments import shown
from ..errors import InvalidRequest, unknown
from ..sand import Bodies
from .motion import Array, Motion

#: The folder with the package's own rows.
DATA = Path(__file__).parent / "data"
#: The file that describes the rows of a folder.
DESCRIPTION = "scoreboard.toml"
#: Components of the force, in the order of a wrench.
FORCES = ("Fx", "Fy", "Fz")
#: Half of a shape's height over its origin, by kind: the sum of these sizes times these factors.
_HALF_HEIGHTS = {
    "sphere": {"radius": 1.0},
    "cylinder": {"radius": 1.0},
    "box": {"height": 0.5},
    "capsule": {"radius": 1.0, "height": 0.5},
    "ellipsoid": {"height": 0.5},
}
#: The keys of a `[[group]]`.
_KEYS = "set name sand body thickness rows columns constant keep most course condition every steady"


class Solid(NamedTuple):
    """A part of a body: its kind and sizes, and its place in the body's frame."""

    #: sphere, box, cylinder, capsule, ellipsoid or plate, as `sandgait.Bodies` names them.
    kind: str
    #: Lengths by name [m], for example {"radius": 0.02}. A cylinder with a width has its axis along y.
    sizes: dict[str, float]
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    #: w, x, y, z.
    quaternion: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)

    @property
    def text(self) -> str:
        """The shape's name, as `sandgait.Bodies` takes it."""
        return f"{self.kind}:{','.join(f'{name}={size!r}' for name, size in self.sizes.items())}"


@dataclass(frozen=True)
class Body:
    """A rigid body. Its frame has x along the heading, y across and z up."""

    name: str
    solids: tuple[Solid, ...]
    #: Thickness of solids that are plates [m]; laws for thin plates do not need it.
    thickness: float = 0.0

    @property
    def shapes(self) -> dict[str, list[tuple[str, tuple[float, ...], tuple[float, ...]]]]:
        """The body as `sandgait.Bodies` takes it."""
        return {self.name: [(solid.text, solid.position, solid.quaternion) for solid in self.solids]}

    def plates(self) -> dict[str, npt.NDArray[Any]]:
        """Pieces of the surface in the body's frame: `center` [pieces, 3] in metres, outward `normal` [pieces, 3],
        `area` [pieces] in m², and `thin` [pieces], true where sand acts on both faces."""
        return Bodies(self.shapes).plates(self.name)

    @property
    def lowest(self) -> float:
        """Height of the lowest point over the origin at attitude 0 [m]."""
        heights = []
        for solid in self.solids:
            sizes = _HALF_HEIGHTS.get(solid.kind)
            if sizes is None or solid.quaternion != (1.0, 0.0, 0.0, 0.0):
                raise InvalidRequest(f"body: {self.name!r} has no lowest point here; give z of its origin, not depth")
            if solid.kind == "cylinder" and "height" in solid.sizes:
                sizes = {"height": 0.5}
            heights.append(solid.position[2] - sum(f * solid.sizes[name] for name, f in sizes.items()))
        return min(heights)


@dataclass(frozen=True)
class MeasuredSand:
    """What is known of a sand without the rows that are scored."""

    name: str
    #: Pressure under a plate that is pushed down slowly, over its depth [N/cm³]: the scale of resistive force theory.
    zeta: float
    #: [kg/m³]
    bulk_density: float
    #: The body whose slow push down gave `zeta`.
    push: Body
    #: Friction coefficient of the sand on the bodies.
    friction: float
    #: Diameter of the grains [m]; NaN if it was not documented.
    grain_size: float = math.nan
    #: A sand.toml with coefficients and mechanisms, if there is one.
    toml: Path | None = None


@dataclass(frozen=True)
class Course:
    """One call of `force`: a motion, the measured forces, and the conditions that the intervals draw from."""

    name: str
    motion: Motion
    #: Measured Fx, Fy, Fz on the body [N]: [samples, 3].
    force: Array
    #: Samples with the same condition are drawn together: [samples].
    condition: npt.NDArray[np.str_]


@dataclass(frozen=True)
class Group:
    """Rows of one body in one sand under like conditions; an error is of one group."""

    set: str
    name: str
    body: Body
    sand: MeasuredSand
    courses: tuple[Course, ...]


@dataclass(frozen=True)
class Walker:
    """A robot that walks, and the sand below it."""

    #: A robot of `sandgait.walk`.
    robot: str
    leg: str
    #: A medium of `sandgait media`.
    medium: str


@dataclass(frozen=True)
class Gait:
    """An alternating tripod."""

    #: Turns of the hips in a second [Hz].
    frequency: float


@dataclass(frozen=True)
class Walk:
    """Walks of one robot, with their measured speeds."""

    set: str
    name: str
    robot: Walker
    gaits: tuple[Gait, ...]
    #: [gaits], m/s.
    speed: Array


@dataclass(frozen=True)
class Rows:
    """All rows of a folder, with the title, source and licence of each set."""

    groups: tuple[Group, ...]
    walks: tuple[Walk, ...]
    sets: dict[str, dict[str, str]]


def read(folder: Path = DATA) -> Rows:
    """The rows of a folder. Raises InvalidRequest if its description or a file is wrong."""
    path = folder / DESCRIPTION
    try:
        text = tomllib.loads(path.read_text(encoding="utf-8"))
        sands = {key: _sand(folder, table) for key, table in text["sand"].items()}
        sets = text["set"]
        groups = tuple(_group(folder, table, sands) for table in text.get("group", ()))
        walks = tuple(_walk(folder, table) for table in text.get("walk", ()))
    except KeyError as error:
        raise InvalidRequest(f"{path}: no {error.args[0]!r}") from None
    except (OSError, TypeError, ValueError) as error:
        raise error if isinstance(error, InvalidRequest) else InvalidRequest(f"{path}: {error}") from None
    parts: tuple[Group | Walk, ...] = (*groups, *walks)
    for one in parts:
        if one.set not in sets or not {"title", "source", "licence"} <= set(sets[one.set]):
            raise InvalidRequest(f"{path}: set.{one.set} has no title, source and licence")
    return Rows(groups, walks, sets)


def _sand(folder: Path, table: Mapping[str, Any]) -> MeasuredSand:
    known = tomllib.loads((folder / table["calibration"]).read_text(encoding="utf-8"))
    known = {**known, **known["sand"]}
    return MeasuredSand(
        name=table["name"],
        zeta=float(known["zeta"]),
        bulk_density=float(known["bulk_density"]),
        push=Body("push", solids(table["push"])),
        friction=float(table["friction"]),
        grain_size=float(table.get("grain_size", math.nan)),
        toml=folder / table["toml"] if "toml" in table else None,
    )


def solids(text: str) -> tuple[Solid, ...]:
    """The parts of a body from the name of its shape: one of `sandgait.Bodies`, or a leg of two pieces."""
    kind, _, rest = text.partition(":")
    try:
        sizes = {name: float(value) for name, value in (part.split("=") for part in rest.split(","))}
    except ValueError:
        raise InvalidRequest(f"body: {text!r} is no shape such as sphere:radius=0.02") from None
    return _leg(**sizes) if kind == "leg" else (Solid(kind, sizes),)


def _leg(xi_deg: float, chord: float, width: float) -> tuple[Solid, ...]:
    """Two straight pieces from hip to knee to tip. The knee is on the circle that has hip-tip as its diameter
    (src/sand/shape.rs)."""
    xi = math.radians(xi_deg)
    corners = [(0.0, 0.0), (math.cos(xi) * math.sin(xi), -(math.cos(xi) ** 2)), (0.0, -1.0)]
    pieces = []
    for (x0, z0), (x1, z1) in pairwise(corners):
        length, half = chord * math.hypot(x1 - x0, z1 - z0), 0.5 * math.atan2(z0 - z1, x1 - x0)
        middle = (chord * (x0 + x1) / 2, 0.0, chord * (z0 + z1) / 2)
        pieces.append(
            Solid("plate", {"length": length, "width": width}, middle, (math.cos(half), 0, math.sin(half), 0))
        )
    return tuple(pieces)


Columns = dict[str, list[str]]


def _table(path: Path) -> Columns:
    with path.open(encoding="utf-8", newline="") as file:
        lines = list(csv.reader(line for line in file if not line.startswith("#")))
    return {name: [line[k] for line in lines[1:]] for k, name in enumerate(lines[0])}


def _group(folder: Path, table: Mapping[str, Any], sands: Mapping[str, MeasuredSand]) -> Group:
    for key in table:
        if key not in _KEYS.split():
            raise unknown(f"{DESCRIPTION}: key", key, _KEYS.split())
    if table["sand"] not in sands:
        raise unknown(f"{DESCRIPTION}: sand", table["sand"], sands)
    path = folder / table["rows"]
    columns = _table(path)
    reader = _Reader(path, columns, table, Body(table["name"], solids(table["body"]), table.get("thickness", 0.0)))
    courses = tuple(reader.courses())
    if not courses:
        raise InvalidRequest(f"{path}: no row is left for group {table['name']!r}")
    if not any(course.force.any() for course in courses):
        raise InvalidRequest(f"{path}: every force of group {table['name']!r} is 0, and an error is a share of it")
    return Group(table["set"], table["name"], reader.body, sands[table["sand"]], courses)


class _Reader:
    """Makes the courses of a group from the columns of its file."""

    def __init__(self, path: Path, columns: Columns, table: Mapping[str, Any], body: Body) -> None:
        self.path, self.columns, self.table, self.body = path, columns, table, body

    def courses(self) -> Iterator[Course]:
        rows = np.arange(len(next(iter(self.columns.values()))))
        for name, wanted in self.table.get("keep", {}).items():
            column = self._column(name)
            rows = rows[[(column[k] if isinstance(wanted, str) else float(column[k])) == wanted for k in rows]]
        for name, most in self.table.get("most", {}).items():
            rows = rows[[abs(float(self._column(name)[k])) <= most for k in rows]]
        keys = [" ".join(self._column(name)[k] for name in self.table.get("course", ())) for k in rows]
        for key in dict.fromkeys(keys):
            mine = rows[[k == key for k in keys]][:: self.table.get("every", 1)]
            force = np.stack([self._quantity(name, mine) for name in FORCES], axis=1)
            yield Course(key, self._motion(mine), force, self._conditions(mine, key))

    def _column(self, name: str) -> list[str]:
        if name not in self.columns:
            raise InvalidRequest(f"{self.path}: there is no column {name!r}")
        return self.columns[name]

    def _has(self, name: str) -> bool:
        named = self.table.get("columns", {}).get(name, name)
        return name in self.table.get("constant", {}) or named.lstrip("-") in self.columns

    def _quantity(self, name: str, rows: npt.NDArray[Any]) -> Array:
        """A quantity of the protocol: a constant, a column, or 0 if the file has none."""
        if name in self.table.get("constant", {}):
            return np.full(len(rows), float(self.table["constant"][name]))
        named = self.table.get("columns", {}).get(name, name)
        if not self._has(name):
            if named not in ("", name):
                self._column(named)  # it was named, so its absence is an error
            return np.zeros(len(rows))
        column = self._column(named.lstrip("-"))
        try:
            values = np.array([float(column[k]) for k in rows])
        except ValueError:
            raise InvalidRequest(f"{self.path}: column {named!r} has a cell that is no number") from None
        if not np.isfinite(values).all():
            raise InvalidRequest(f"{self.path}: column {named!r} has a number that is not finite")
        return -values if named.startswith("-") else values

    def _motion(self, rows: npt.NDArray[Any]) -> Motion:
        of = {name: self._quantity(name, rows) for name in ("t", "x", "y", "z", "vx", "vy", "vz", "wx", "wy", "wz")}
        if self._has("depth"):
            of["z"] = -self._quantity("depth", rows) - self.body.lowest
        half = self._quantity("pitch", rows) / 2
        zero = np.zeros(len(rows))
        position = np.stack([of["x"], of["y"], of["z"]], axis=1)
        velocity = np.stack([of["vx"], of["vy"], of["vz"]], axis=1)
        steady = bool(self.table.get("steady", False))
        t = of["t"] if self._has("t") or steady else _times(position, velocity)
        attitude = np.stack([np.cos(half), zero, np.sin(half), zero], axis=1)
        return Motion(t, position, attitude, velocity, np.stack([of["wx"], of["wy"], of["wz"]], axis=1), steady)

    def _conditions(self, rows: npt.NDArray[Any], course: str) -> npt.NDArray[np.str_]:
        steps = self.table.get("condition")
        if steps is None:
            return np.full(len(rows), course)
        nearest = [np.rint(self._quantity(name, rows) / step).astype(int) for name, step in steps.items()]
        return np.array([" ".join(map(str, key)) for key in zip(*nearest, strict=True)])


def _times(position: Array, velocity: Array) -> Array:
    """Times of a course from its places and speeds."""
    ways, speeds = np.linalg.norm(np.diff(position, axis=0), axis=1), np.linalg.norm(velocity, axis=1)
    if not speeds.all():
        raise InvalidRequest(f"rows: a course needs times t, or speeds that are not 0, got {shown(velocity[0])}")
    return np.concatenate([[0.0], np.cumsum(ways / speeds[1:])])


def _walk(folder: Path, table: Mapping[str, Any]) -> Walk:
    columns = _table(folder / table["rows"])
    mine = [k for k, leg in enumerate(columns["leg"]) if leg == table["leg"]]
    gaits = tuple(Gait(float(columns["frequency"][k])) for k in mine)
    speed = np.array([float(columns["speed"][k]) for k in mine])
    return Walk("walks", table["name"], Walker(table["robot"], table["leg"], table["medium"]), gaits, speed)
