"""The scoreboard: the same rows for every entry, and a table of the errors."""

from __future__ import annotations

import csv
import html
import importlib.util
import io
from collections.abc import Iterable, Mapping
from os import PathLike
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from ..arguments import checked, shown
from ..errors import InvalidRequest, WrongType, unknown
from ..study_call import Display, ProgressOption
from ..tables import Table
from ..user_warnings import warn
from .laws import LAWS, ForceLaw, WalkingLaw
from .motion import Array, Motion
from .rows import (
    DATA,
    FORCES,
    Body,
    Course,
    Gait,
    Group,
    MeasuredSand,
    Rows,
    Walk,
    Walker,
    read,
)
from .scores import Score, score

#: The entry that needs MuJoCo.
_MUJOCO = "mujoco"
#: Entries that the package has: its laws, two of them with sand that remembers, and MuJoCo's own soft contact.
ENTRIES = (*LAWS, "li2013 with memory", "agarwal2023 with memory", _MUJOCO)
#: What the table says of all groups of a set.
ALL = "all"

_STYLE = """\
table { border-collapse: collapse; margin: 1rem 0; } td, th { padding: .2rem .7rem; text-align: right; }
th { border-bottom: 1px solid #999; } td:first-child, th:first-child { text-align: left; }
tr.all { font-weight: 600; }
"""


@runtime_checkable
class Entry(Protocol):
    """What enters the scoreboard: an object with `force`, and, if it can walk, with `walk`."""

    def force(self, body: Body, motion: Motion, sand: MeasuredSand) -> npt.ArrayLike:
        """The sand's wrench on `body` at each sample of `motion`: [samples, 6], force [N] and torque about the body's
        origin [N·m] in the world's axes. Torques were not measured, so they are not scored."""
        ...


@runtime_checkable
class WalkingEntry(Entry, Protocol):
    """An entry that can also walk."""

    def walk(self, robot: Walker, gait: Gait) -> float:
        """Mean forward speed of the robot [m/s]."""
        ...


class Scoreboard(Table):
    """Errors of entries in the rows of the scoreboard; one row for each entry and group, and for each set (`all`).

    Columns: entry, set, group, rows, then shares of the measured force, so 1 is 100 %: error (0: exact; 1: as wrong as
    no force), low and high (its 95 % interval; NaN where there is only one condition), error_x, error_y, error_z (its
    parts along the axes; their squares add up), and ratio (1: as strong as measured; 0: no force). `docs/scoreboard.md`
    defines them.
    """

    def __init__(
        self,
        columns: Mapping[str, npt.NDArray[Any]],
        units: Mapping[str, str],
        predictions: Table,
        sets: Mapping[str, Mapping[str, str]],
    ) -> None:
        super().__init__(columns, units)
        #: Every row with its prediction: entry, set, group, course, condition, Fx, Fy, Fz (measured), and
        #: Fx_predicted, Fy_predicted, Fz_predicted [N]. Walks are not in it.
        self.predictions = predictions
        #: Title, source and licence of each set.
        self.sets = {name: dict(about) for name, about in sets.items()}

    def __str__(self) -> str:
        return self.to_markdown()

    def _repr_html_(self) -> str:
        return "".join(self._parts())

    def to_csv(self, path: str | PathLike[str] | None = None) -> str:
        """The table as CSV with all digits; also written to `path`, if there is one."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(self)
        writer.writerows(zip(*(column.tolist() for column in self.values()), strict=True))
        return _written(text.getvalue(), path)

    def to_markdown(self, path: str | PathLike[str] | None = None) -> str:
        """The errors in % with their intervals, a column for each entry; also written to `path`, if there is one."""
        lines = []
        for name, (head, rows) in self._grids().items():
            about = self.sets[name]
            lines += [f"**{about['title']}.** Source: {about['source']}. Licence: {about['licence']}.", ""]
            lines += [f"| {' | '.join(head)} |", "|" + "---|" * len(head)]
            lines += [f"| {' | '.join(row)} |" for row in rows] + [""]
        return _written("\n".join(lines), path)

    def summary(self) -> str:
        """The errors of the sets as Markdown, without their groups."""
        grids = {name: (head, row) for name, (head, rows) in self._grids().items() for row in rows if row[0] == ALL}
        entries = list(dict.fromkeys(entry for head, _ in grids.values() for entry in head[2:]))
        lines = [f"| set | rows | {' | '.join(entries)} |", "|" + "---|" * (2 + len(entries))]
        for name, (head, row) in grids.items():
            cells = dict(zip(head, row, strict=True))
            lines.append(f"| {name} | {' | '.join(cells.get(entry, '') for entry in ('rows', *entries))} |")
        return "\n".join(lines) + "\n"

    def to_html(self, path: str | PathLike[str] | None = None) -> str:
        """The same as one self-contained page; also written to `path`, if there is one."""
        from ..command_line import html_page

        intro = (
            "<h1>Scoreboard</h1><p>Errors in % of the measured force, with 95 % intervals. 0: exact; 100: no force.</p>"
        )
        return _written(html_page("Scoreboard", 80, _STYLE, [intro, *self._parts()]), path)

    def _parts(self) -> list[str]:
        parts = []
        for name, (head, rows) in self._grids().items():
            about = {key: html.escape(text) for key, text in self.sets[name].items()}
            parts.append(f"<h2>{about['title']}</h2><p>{about['source']}. Licence: {about['licence']}.</p><table><tr>")
            parts.append("".join(f"<th>{html.escape(cell)}</th>" for cell in head) + "</tr>")
            for row in rows:
                kind = " class='all'" if row[0] == ALL else ""
                parts.append(f"<tr{kind}>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>")
            parts.append("</table>")
        return parts

    def _grids(self) -> dict[str, tuple[list[str], list[list[str]]]]:
        """For each set the head and the rows of its table."""
        cells: dict[tuple[str, str], dict[str, str]] = {}
        counts: dict[tuple[str, str], int] = {}
        for k, key in enumerate(zip(self["set"].tolist(), self["group"].tolist(), strict=True)):
            error, low, high = (100.0 * float(self[name][k]) for name in ("error", "low", "high"))
            ends = "" if np.isnan(low) else f" [{low:.0f}, {high:.0f}]"
            cells.setdefault(key, {})[str(self["entry"][k])] = f"{error:.0f}{ends}"
            counts[key] = int(self["rows"][k])
        grids = {}
        for name in dict.fromkeys(self["set"].tolist()):
            mine = {group: row for (of, group), row in cells.items() if of == name}
            entries = list(dict.fromkeys(entry for row in mine.values() for entry in row))
            rows = [
                [group, str(counts[name, group]), *map(row.get, entries, [""] * len(entries))]
                for group, row in mine.items()
            ]
            grids[name] = (["group", "rows", *entries], rows)
        return grids


def _written(text: str, path: str | PathLike[str] | None) -> str:
    if path is not None:
        Path(path).write_text(text, encoding="utf-8")
    return text


@checked
def scoreboard(
    entries: Any = (),
    *,
    against: Iterable[str] | None = None,
    rows: str | PathLike[str] | None = None,
    sets: Iterable[str] | None = None,
    progress: ProgressOption = True,
) -> Scoreboard:
    """Scores simulators of sand in the same measured rows, and returns the table of their errors.

    `entries`: an object with `force(body, motion, sand)` and, if it can walk, `walk(robot, gait)`, or a dictionary of
    names and such objects. docs/scoreboard.md has an example. `against`: entries of this package beside them, from
    `sandgait.scoring.ENTRIES`; default: all. `rows`: a folder with a scoreboard.toml in place of the package's rows.
    `sets`: names of the sets to score; default: all. `progress`: shows the progress, or a function that gets it.

    Raises InvalidRequest if an entry has no `force`, or gives a wrench of a wrong shape or one that is not finite. An
    exception of an entry is raised with a note that names its rows.
    """
    chosen = _entries(entries, against)
    known = read(DATA if rows is None else Path(rows))
    wanted = tuple(known.sets if sets is None else sets)
    for name in wanted:
        if name not in known.sets:
            raise unknown("set", name, known.sets)
    if not chosen:
        raise InvalidRequest("entries: there is none; give one, or names in `against`")
    work = _Work(known, wanted, chosen)
    with Display(progress) as told:
        return work.run(told)


def _entries(entries: Any, against: Iterable[str] | None) -> dict[str, Entry]:
    own = _named(entries)
    if against is None:
        against = ENTRIES
        if importlib.util.find_spec(_MUJOCO) is None:
            warn(["entry mujoco is left out, because mujoco is not installed: pip install 'sandgait[mujoco]'"])
            against = tuple(name for name in ENTRIES if name != _MUJOCO)
    for name in (chosen := list(against)):
        if name not in ENTRIES:
            raise unknown("against", name, ENTRIES)
        if name in own:
            raise InvalidRequest(f"entries: {name!r} is an entry of this package; give yours another name")
    return {**own, **{name: _entry_of_package(name) for name in chosen}}


def _named(entries: Any) -> dict[str, Entry]:
    if isinstance(entries, tuple) and not entries:
        return {}
    named = entries if isinstance(entries, Mapping) else {type(entries).__name__: entries}
    for name, entry in named.items():
        if isinstance(entry, type):
            raise WrongType(f"entries: {name!r} is a class; give an object of it, {entry.__name__}()")
        if not callable(getattr(entry, "force", None)):
            raise WrongType(f"entries: {name!r} has no method force(body, motion, sand): {shown(entry)}")
    return {str(name): entry for name, entry in named.items()}


def _entry_of_package(name: str) -> Entry:
    if name == _MUJOCO:
        from .soft_contact import SoftContact

        return SoftContact()
    if name in LAWS:
        return WalkingLaw(name)
    return ForceLaw(name.removesuffix(" with memory"), memory=True)


Pair = tuple[Array, Array, npt.NDArray[Any]]


class _Work:
    """Asks each entry for each group, and makes the table."""

    def __init__(self, known: Rows, sets: tuple[str, ...], entries: Mapping[str, Entry]) -> None:
        self._known, self._entries = known, entries
        self._groups = [group for group in known.groups if group.set in sets]
        self._walks = [walk for walk in known.walks if walk.set in sets]
        self._lines: list[tuple[str, str, str, Score]] = []
        self._predictions: list[tuple[str, Group, Course, Array]] = []

    def run(self, told: Any) -> Scoreboard:
        parts: tuple[Group | Walk, ...] = (*self._groups, *self._walks)
        asked = [(name, part) for name in self._entries for part in parts]
        pairs: dict[tuple[str, str], list[Pair]] = {}
        for k, (name, part) in enumerate(asked):
            told(k / len(asked), f"{name}: {part.set}, {part.name}")
            pair = self._walked(name, part) if isinstance(part, Walk) else self._forces(name, part)
            if pair is not None:
                pairs.setdefault((name, part.set), []).append(pair)
                self._lines.append((name, part.set, part.name, score([pair])))
        for (name, of), listed in pairs.items():
            self._lines.append((name, of, ALL, score(listed)))
        return self._table()

    def _forces(self, name: str, group: Group) -> Pair:
        forces = []
        for course in group.courses:
            force = _asked(name, group, course, self._entries[name])
            self._predictions.append((name, group, course, force))
            forces.append(force)
        measured = np.concatenate([course.force for course in group.courses])
        return np.concatenate(forces), measured, np.concatenate([course.condition for course in group.courses])

    def _walked(self, name: str, walk: Walk) -> Pair | None:
        entry = self._entries[name]
        if not isinstance(entry, WalkingEntry):
            return None
        speeds = []
        for gait in walk.gaits:
            where = f"entry {name!r}: walk of {walk.name} at {gait.frequency:g} Hz"
            speed = _called(where, entry.walk, walk.robot, gait)
            speeds.append(_finite(where, speed, (), "a speed [m/s]"))
        frequencies = np.array([f"{gait.frequency:g}" for gait in walk.gaits])
        return np.array(speeds)[:, None], walk.speed[:, None], frequencies

    def _table(self) -> Scoreboard:
        names, sets, groups, scores = zip(*self._lines, strict=True)
        parts = [(*s.parts, np.nan, np.nan)[:3] for s in scores]
        columns: dict[str, npt.NDArray[Any]] = {
            "entry": np.array(names),
            "set": np.array(sets),
            "group": np.array(groups),
            "rows": np.array([s.rows for s in scores]),
            **{name: np.array([getattr(s, name) for s in scores]) for name in ("error", "low", "high", "ratio")},
            **{f"error_{axis}": np.array([part[k] for part in parts]) for k, axis in enumerate("xyz")},
        }
        units = {name: "" if name in ("entry", "set", "group") else "1" for name in columns}
        return Scoreboard(columns, units, self._predicted(), self._known.sets)

    def _predicted(self) -> Table:
        made: dict[str, list[Any]] = {name: [] for name in ("entry", "set", "group", "course", "condition")}
        measured, predicted = [np.empty((0, 3))], [np.empty((0, 3))]
        for name, group, course, force in self._predictions:
            for column, cell in zip(
                ("entry", "set", "group", "course"), (name, group.set, group.name, course.name), strict=True
            ):
                made[column] += [cell] * len(force)
            made["condition"] += course.condition.tolist()
            measured.append(course.force)
            predicted.append(force)
        columns: dict[str, npt.NDArray[Any]] = {name: np.array(cells, dtype=str) for name, cells in made.items()}
        for ending, parts in (("", measured), ("_predicted", predicted)):
            columns |= {f"{name}{ending}": np.concatenate(parts)[:, k] for k, name in enumerate(FORCES)}
        return Table(columns, {name: "N" if name.startswith("F") else "" for name in columns})


def _asked(name: str, group: Group, course: Course, entry: Entry) -> Array:
    """The entry's force in a course: [samples, 3]."""
    where = f"entry {name!r}: force in set {group.set}, {group.name}"
    wrench = _called(where, entry.force, group.body, course.motion, group.sand)
    wanted = "a wrench for each sample: force and torque"
    return _finite(where, wrench, (len(course.motion), 6), wanted)[:, :3]


def _called(where: str, function: Any, *arguments: Any) -> Any:
    try:
        return function(*arguments)
    except Exception as error:
        error.add_note(where)
        raise


def _finite(where: str, values: Any, shape: tuple[int, ...], wanted: str) -> Array:
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise WrongType(f"{where}: expected {wanted}, {shape}, got {shown(values)}") from None
    if array.shape != shape:
        raise InvalidRequest(f"{where}: has shape {array.shape}, not {shape}: {wanted}")
    if not np.isfinite(array).all():
        first = np.argwhere(~np.isfinite(array))[0].tolist()
        raise InvalidRequest(f"{where}: {array[tuple(first)]} at {first} is not finite")
    return array
