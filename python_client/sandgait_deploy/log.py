"""The log of a Controller: the CSV of a robot's log that `sandgait diagnose` reads, with what the Controller did; or
the same rows as MCAP, one JSON message for each."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

import numpy as np

from .errors import Refused
from .policy import Floats, Policy

if TYPE_CHECKING:
    from .controller import Output

_QUATERNION = ("quat_w", "quat_x", "quat_y", "quat_z")
_XYZ = {"gyroscope": "gyro", "accelerometer": "acc", "lin_vel": "lin_vel"}
_JOINTS = {"joint_position": "q", "joint_velocity": "qd", "joint_torque": "tau"}

#: Topic of a log's messages in MCAP, and their schema, by which `sandgait.logs` knows them.
TOPIC, SCHEMA = "/sandgait/walk", "sandgait.Walk"

#: Size of a chunk of MCAP [bytes]: our choice, about a second of a quadruped, which is lost if the program crashes.
_CHUNK = 1 << 16


class Log:
    """Writes one row for each step of a walk. Each walk is a run. A reading that is absent is blank."""

    def __init__(self, path: str | Path, policy: Policy) -> None:
        self._policy = policy
        self._runs, self._before = 0, ""
        names = ["run", "t", *_QUATERNION, *(f"{short}_{axis}" for short in _XYZ.values() for axis in "xyz")]
        names += [f"{short}:{joint}" for short in _JOINTS.values() for joint in policy.joints]
        names += ["command_x", "command_y", "command_yaw"]
        driven = [servo.joint for servo in policy.servos]
        names += [f"target:{joint}" for joint in driven]
        names += [f"action:{joint}" for joint in driven[: policy.actions]]
        try:
            self._rows: _Csv | _Mcap = (_Mcap if Path(path).suffix == ".mcap" else _Csv)(Path(path), names)
        except OSError as error:
            raise Refused(f"log: {path}: {error.strerror}; give a path in a folder that exists") from None

    def row(self, read: dict[str, Floats], command: Floats, targets: Floats | None, output: Output) -> None:
        policy, before = self._policy, self._before
        self._before = output.state
        if output.state != "walking":
            return
        self._runs += before != "walking"
        cells = [f"walk{self._runs}", _text(read["time"][0]), *_cells(read.get("quaternion"), 4)]
        for name in _XYZ:
            cells += _cells(read.get(name), 3)
        for name in _JOINTS:
            cells += _cells(read.get(name), len(policy.joints))
        cells += _cells(command, 3)
        cells += _cells(targets, len(policy.servos)) + _cells(output.action, policy.actions)
        self._rows.write(cells)

    def close(self) -> None:
        self._rows.close()


class _Csv:
    def __init__(self, path: Path, names: list[str]) -> None:
        self._file: TextIO = path.open("w", encoding="utf-8")
        self.write(names)

    def write(self, cells: list[str]) -> None:
        self._file.write(",".join(cells) + "\n")

    def close(self) -> None:
        self._file.close()


class _Mcap:
    """Messages in JSON: an object for each group of columns, such as `q` with a number for each joint."""

    def __init__(self, path: Path, names: list[str]) -> None:
        try:
            from mcap.writer import Writer
        except ImportError:
            raise Refused("log: mcap is not installed: pip install mcap, or give a path that ends in .csv") from None
        self._places = [_place(name) for name in names]
        self._file = path.open("wb")
        self._writer: Any = Writer(self._file, chunk_size=_CHUNK)
        self._writer.start(library="sandgait")
        schema = self._writer.register_schema(SCHEMA, "jsonschema", json.dumps(_schema(self._places)).encode())
        self._channel = self._writer.register_channel(TOPIC, "json", schema)
        self._count = 0

    def write(self, cells: list[str]) -> None:
        message: dict[str, Any] = {}
        for (group, name), cell in zip(self._places, cells, strict=True):
            if cell:
                (message.setdefault(group, {}) if group else message)[name] = cell if name == "run" else float(cell)
        time = round(1e9 * message["t"])
        self._writer.add_message(self._channel, time, json.dumps(message).encode(), time, self._count)
        self._count += 1

    def close(self) -> None:
        self._writer.finish()
        self._file.close()


def _place(column: str) -> tuple[str, str]:
    """Group and name of a column: `q:FL_hip` is `FL_hip` in `q`, `gyro_x` is `x` in `gyro`."""
    for mark in ":_":
        if mark in column:
            group, _, name = column.partition(mark) if mark == ":" else column.rpartition(mark)
            return group, name
    return "", column


def _schema(places: list[tuple[str, str]]) -> dict[str, Any]:
    number, groups = {"type": "number"}, dict.fromkeys(group for group, _ in places if group)
    properties: dict[str, Any] = {"run": {"type": "string"}, "t": number}
    for group in groups:
        own = {name: number for of, name in places if of == group}
        properties[group] = {"type": "object", "properties": own}
    return {"type": "object", "properties": properties}


def _cells(row: Any, size: int) -> list[str]:
    return [""] * size if row is None else [_text(number) for number in row]


def _text(number: float) -> str:
    return str(np.format_float_positional(number, precision=7, unique=True, trim="-"))
