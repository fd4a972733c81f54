"""Pushes of an arm with a force sensor as a force log: the plate's motion follows from the joints' angles and the URDF.

The table `[arm]` of the experiment file says what a recording does not contain: `urdf`, `link` (a plate whose origin is
its centre and whose x axis lies along its length), `sensor` (the link in whose axes the wrench is given; `link` if it
is absent), `shape` (a table `[shape.NAME]`), and `surface`, the height of the sand in the arm's frame [m]. Without
`surface` each push has its own: where its force, drawn back along a line, is 0.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import numpy.typing as npt

from .errors import InvalidRequest
from .user_warnings import warn

Numbers = npt.NDArray[np.float64]

#: Half of the time over which speeds are taken [s]: our choice, above the noise of encoders and far below a push.
HALF = 0.02
#: The arm rests below this share of its usual speed: our choice, as for force logs (src/diagnose/motion.rs).
REST = 0.05
#: Shortest path of a push [m]: our choice; shorter moves are corrections of the arm.
SHORTEST = 0.005
#: Samples of a push before contact whose mean is the sensor's zero, and fewest of them: our choices.
ZERO, FEWEST = 200, 10
#: A push has contact where its force exceeds its noise by this factor, and this share of its largest force, for the
#: samples in HOLDS: our choices.
NOISE, SHARE, HOLDS = 6.0, 0.02, 5
#: Rows that are kept of a push: our choice, twice as many as a diagnosis needs; and rows before its contact.
ROWS, BEFORE = 120, 5
#: Pushes are repetitions if angles differ by less than this [rad], speeds by this share and depths by this [m]: our
#: choices, the accuracy with which arms repeat a motion under load.
SAME_ANGLE, SAME_SPEED, SAME_DEPTH = 0.05, 0.15, 0.003
#: Columns of the force log.
MOTION, LOADS = ("t", "x", "z", "vx", "vz"), ("Fx", "Fz", "Ty")
COLUMNS = ("trial", "condition", "rep", "kind", "shape", "plate_beta", "plate_gamma", *MOTION, *LOADS)
#: Keys of [arm].
KEYS = ("urdf", "link", "sensor", "shape", "surface")


@dataclass
class Motion:
    """Positions and orientations of a link: one for each row."""

    place: Numbers
    turn: Numbers


@dataclass
class Push:
    """One push in its plane of motion: rows of t, x, z, vx, vz, Fx, Fz, Ty."""

    rows: Numbers
    beta: float
    gamma: float
    speed: float
    surface: float | None


def force_log(table: bytes, tables: Mapping[str, Any], folder: Path) -> bytes:
    """The force log of a recording's table, by the table `[arm]` of an experiment. An error is one line."""
    arm = tables["arm"]
    if not isinstance(arm, Mapping):
        raise InvalidRequest("arm: must be a table [arm]")
    unknown = [key for key in arm if key not in KEYS]
    if unknown:
        raise InvalidRequest(f"arm: {unknown[0]!r} is unknown; known: {', '.join(KEYS)}")
    for key in ("urdf", "link", "shape"):
        if not isinstance(arm.get(key), str):
            raise InvalidRequest(f"arm.{key}: is missing")
    columns = _columns(table)
    if "force_x" not in columns:
        raise InvalidRequest(
            "arm: the recording has an IMU; name the topic of the force sensor as wrench under [topics]"
        )
    robot = Chain.read(folder / arm["urdf"])
    plate = robot.motion(arm["link"], columns)
    sensor = robot.motion(str(arm.get("sensor", arm["link"])), columns)
    pushes = _pushes(columns, plate, sensor, arm.get("surface"))
    if not pushes:
        raise InvalidRequest("arm: no push is found: the force never rises while the plate moves down or forward")
    return _written(pushes, arm["shape"])


def _columns(table: bytes) -> dict[str, Numbers]:
    text = table.decode()
    header = next(csv.reader(io.StringIO(text)))
    values = np.loadtxt(io.StringIO(text), delimiter=",", skiprows=1, ndmin=2)
    return dict(zip(header, values.T, strict=True))


class Chain:
    """The joints of a URDF file."""

    def __init__(self, joints: dict[str, ElementTree.Element]) -> None:
        self.joints = joints

    @classmethod
    def read(cls, path: Path) -> Chain:
        try:
            root = ElementTree.fromstring(path.read_bytes())
        except (OSError, ElementTree.ParseError) as error:
            raise InvalidRequest(f"{path}: {error}") from None
        links = {link.get("name", "") for link in root.iter("link")}
        joints = {}
        for joint in root.iter("joint"):
            child = joint.find("child")
            if child is not None and child.get("link") in links:
                joints[child.get("link", "")] = joint
        if not joints:
            raise InvalidRequest(f"{path}: no URDF with joints")
        return cls(joints)

    def motion(self, link: str, columns: dict[str, Numbers]) -> Motion:
        """Position and orientation of a link in the frame of the root."""
        count = len(columns["t"])
        place, turn = np.zeros((count, 3)), np.tile(np.eye(3), (count, 1, 1))
        above: list[ElementTree.Element] = []
        while link in self.joints:
            joint = self.joints[link]
            if joint in above:
                raise InvalidRequest(f"arm: link {link!r} is its own parent")
            above.append(joint)
            parent = joint.find("parent")
            link = parent.get("link", "") if parent is not None else ""
        if not above:
            raise InvalidRequest(f"arm: link {link!r} is unknown; known: {', '.join(list(self.joints)[:20])}")
        for joint in reversed(above):
            origin, axis = joint.find("origin"), joint.find("axis")
            place = place + turn @ _three(origin, "xyz", (0, 0, 0))
            turn = turn @ _rpy(_three(origin, "rpy", (0, 0, 0)))
            along = _three(axis, "xyz", (1, 0, 0))
            along = along / max(float(np.linalg.norm(along)), 1e-12)
            kind, name = joint.get("type"), joint.get("name", "")
            if kind == "fixed":
                continue
            if f"q:{name}" not in columns:
                there = [column[2:] for column in columns if column.startswith("q:")]
                raise InvalidRequest(f"arm: the recording has no joint {name!r}; it has {', '.join(there[:20])}")
            q = columns[f"q:{name}"]
            if kind == "prismatic":
                place = place + (turn @ along) * q[:, None]
            else:
                turn = turn @ _about(along, q)
        return Motion(place, turn)


def _three(element: ElementTree.Element | None, name: str, usual: tuple[float, ...]) -> Numbers:
    text = None if element is None else element.get(name)
    try:
        values = np.array([float(word) for word in text.split()] if text else usual, dtype=float)
    except ValueError:
        values = np.zeros(0)
    if values.shape != (3,) or not np.isfinite(values).all():
        raise InvalidRequest(f"arm: {name}={text!r} in the URDF: three numbers are needed")
    return values


def _about(axis: Numbers, angle: Numbers) -> Numbers:
    """Rotations about an axis (Rodrigues)."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    sin, cos = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
    return np.asarray(np.eye(3) + sin * cross + (1 - cos) * (cross @ cross))


def _rpy(angles: Numbers) -> Numbers:
    turns = [_about(np.eye(3)[k], angles[k : k + 1])[0] for k in range(3)]
    return np.asarray(turns[2] @ turns[1] @ turns[0])


def _velocity(t: Numbers, place: Numbers) -> Numbers:
    reach = max(1, round(HALF / max(float(np.median(np.diff(t))), 1e-6)))
    at = np.arange(len(t))
    before, after = np.maximum(at - reach, 0), np.minimum(at + reach, len(t) - 1)
    return np.asarray((place[after] - place[before]) / (t[after] - t[before])[:, None])


def _moves(t: Numbers, place: Numbers, velocity: Numbers) -> list[tuple[int, int]]:
    """First and last row of each move in one direction."""
    speed = np.linalg.norm(velocity, axis=1)
    usual = float(np.percentile(speed, 95))
    moving = speed > max(REST * usual, 1e-5)
    moves: list[tuple[int, int]] = []
    begin: int | None = None
    for i in range(len(t) + 1):
        turned = begin is not None and i < len(t) and velocity[i] @ (place[i] - place[begin]) < 0
        if begin is not None and (i == len(t) or not moving[i] or turned):
            if np.linalg.norm(place[i - 1] - place[begin]) >= SHORTEST:
                moves.append((begin, i - 1))
            begin = None
        if begin is None and i < len(t) and moving[i]:
            begin = i
    return moves


def _pushes(columns: dict[str, Numbers], plate: Motion, sensor: Motion, surface: float | None) -> list[Push]:
    t = columns["t"]
    force, torque = (np.stack([columns[f"{kind}_{axis}"] for axis in "xyz"], axis=1) for kind in ("force", "torque"))
    velocity = _velocity(t, plate.place)
    pushes: list[Push] = []
    zero: tuple[Numbers, Numbers] | None = None
    height = surface
    idle = up = end = 0
    for first, last in _moves(t, plate.place, velocity):
        start, end = max(end, first - ZERO), last
        if plate.place[last, 2] - plate.place[first, 2] > SHORTEST:
            up += 1
            continue
        contact = first
        # A push that begins in the sand has the zero of the one before.
        if height is None or zero is None or plate.place[first, 2] > height - SAME_DEPTH:
            found, zero = _contact(force, torque, (start, first, last))
            if found is None:
                idle += 1
                continue
            contact = found
        rows = np.arange(max(first, contact - BEFORE), last + 1)
        loads = (force[rows] - zero[0], torque[rows] - zero[1])
        push = _in_plane(t[rows], Motion(plate.place[rows], plate.turn[rows]), velocity[rows], sensor, rows, loads)
        if surface is None:
            height = _surface(push) or height
        if height is None:
            idle += 1
            continue
        push.surface = height
        push.rows[:, 2] -= height
        pushes.append(push)
    heights = [push.surface for push in pushes if push.surface is not None]
    notes = [f"{len(pushes)} pushes are cut out; {idle} moves without contact and {up} moves up are left out"]
    if surface is None and heights:
        low, high = min(heights), max(heights)
        notes.append(f"the surface is found from the forces, at heights of {low:.4f} to {high:.4f} m")
    warn([f"arm: {text}" for text in notes])
    return pushes


def _contact(force: Numbers, torque: Numbers, rows: tuple[int, int, int]) -> tuple[int | None, tuple[Numbers, Numbers]]:
    """The row of first contact in a move from `first` to `last`, and the sensor's zero before it. `start` begins the
    rest before the move; the arm is not in the sand there."""
    start, first, last = rows
    free = slice(start, max(first, min(start + FEWEST, last)))
    mean, noise = force[free].mean(axis=0), force[free].std(axis=0)
    off = np.linalg.norm(force[first : last + 1] - mean, axis=1)
    limit = max(NOISE * float(np.linalg.norm(noise)), SHARE * float(off.max()))
    held = np.convolve(off > limit, np.ones(HOLDS), "valid") >= HOLDS
    if off.max() < 2 * limit or not held.any():
        return None, (mean, torque[free].mean(axis=0))
    contact = first + int(np.argmax(held))
    before = slice(max(start, contact - ZERO), contact) if contact - start >= FEWEST else free
    return contact, (force[before].mean(axis=0), torque[before].mean(axis=0))


def _in_plane(
    t: Numbers, plate: Motion, velocity: Numbers, sensor: Motion, rows: Any, loads: tuple[Numbers, Numbers]
) -> Push:
    """Motion and loads in the vertical plane of the push."""
    way = plate.place[-1] - plate.place[0]
    along = plate.turn[0][:, 0]  # the plate's length
    flat = np.array([way[0], way[1], 0.0])
    if np.linalg.norm(flat) < 0.2 * np.linalg.norm(way):
        flat = np.array([along[0], along[1], 0.0])
    if np.linalg.norm(flat) < 1e-6:
        flat = np.array([1.0, 0.0, 0.0])
    forward, up = flat / np.linalg.norm(flat), np.array([0.0, 0.0, 1.0])
    left = np.cross(up, forward)
    if abs(along @ left) > 0.3:
        warn(["arm: the plate's length is not in the plane of motion: is it the x axis of its link?"])
    beta = float(np.arctan2(along @ up, along @ forward))
    beta = (beta + np.pi / 2) % np.pi - np.pi / 2  # both ends of a plate are alike
    turn = sensor.turn[rows]
    force = np.einsum("nij,nj->ni", turn, loads[0])
    torque = np.einsum("nij,nj->ni", turn, loads[1])
    torque += np.cross(sensor.place[rows] - plate.place, force)
    place = plate.place - plate.place[0]
    columns = [t - t[0], place @ forward, plate.place[:, 2], velocity @ forward, velocity[:, 2]]
    columns += [force @ forward, force[:, 2], -(torque @ left)]
    gamma = float(np.arctan2(-way[2], way @ forward))
    speed = float(np.linalg.norm(way) / (t[-1] - t[0]))
    return Push(np.stack(columns, axis=1), beta, gamma, speed, None)


def _surface(push: Push) -> float | None:
    """The height at which the force of a push from above begins, drawn back along a line."""
    z, force = push.rows[:, 2], np.hypot(push.rows[:, 5], push.rows[:, 6])
    if z[0] - z[-1] < SHORTEST:
        return None
    low, high = SHARE * force.max(), 0.3 * force.max()
    chosen = (force > low) & (force < high)
    if chosen.sum() < 3:
        return float(z[min(BEFORE, len(z) - 1)])
    slope, at_zero = np.polyfit(z[chosen], force[chosen], 1)
    height = -at_zero / slope if slope < 0 else z[chosen][0]
    return float(np.clip(height, z[chosen].min(), z[0]))


def _written(pushes: list[Push], shape: str) -> bytes:
    """The force log as CSV."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(COLUMNS)
    kinds: list[tuple[Push, int]] = []
    for number, push in enumerate(pushes):
        depth = push.rows[0, 2]
        known = [
            k
            for k, (other, _) in enumerate(kinds)
            if abs(push.beta - other.beta) < SAME_ANGLE
            and abs(push.gamma - other.gamma) < SAME_ANGLE
            and abs(np.log(push.speed / other.speed)) < SAME_SPEED
            and (depth > -SAME_DEPTH or abs(depth - other.rows[0, 2]) < SAME_DEPTH)
        ]
        if known:
            kind = known[0]
            kinds[kind] = (kinds[kind][0], kinds[kind][1] + 1)
        else:
            kind = len(kinds)
            kinds.append((push, 1))
        head = [number + 1, kind + 1, kinds[kind][1], "plate", shape, f"{push.beta:.4f}", f"{push.gamma:.4f}"]
        for row in push.rows[:: -(-len(push.rows) // ROWS)]:
            writer.writerow([*head, *(f"{value:.6g}" for value in row)])
    return out.getvalue().encode()
