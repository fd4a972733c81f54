"""The log that a Controller of `sandgait.deploy` writes as MCAP, as one table. `logs_reader.py` loads this file."""

from __future__ import annotations

import json
from collections.abc import Iterator
from itertools import chain
from typing import Any

#: Name of its messages' schema (`sandgait_deploy.log`).
SCHEMA = "sandgait.Walk"

#: Topic, type, encoding, time [ns] and bytes of a message.
Message = tuple[str, str, str, int, bytes]


def split(messages: Iterator[Message]) -> tuple[bool, Iterator[Message]]:
    """Are these messages of a Controller? And the messages."""
    first = next(messages, None)
    if first is None:
        return False, messages
    return first[1] == SCHEMA, chain([first], messages)


def table(messages: Iterator[Message], bound: Any) -> dict[str, list[Any]]:
    """Columns with one row for each message; `bound`: is called with the numbers of columns and of values."""
    columns: dict[str, list[Any]] = {}
    rows = 0
    for _, kind, _, _, data in messages:
        if kind != SCHEMA:
            continue
        row = dict(_flat(json.loads(data)))
        columns |= {name: [None] * rows for name in row if name not in columns}
        for name, values in columns.items():
            values.append(row.get(name))
        rows += 1
        bound(len(columns), rows * len(columns))
    return columns


#: Groups of columns with a value for each joint; others have the axes of a vector.
_JOINTS = ("q", "qd", "tau", "target", "action")


def _flat(message: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    for name, value in message.items():
        if isinstance(value, dict):
            mark = ":" if name in _JOINTS else "_"
            yield from ((f"{name}{mark}{part}", number) for part, number in value.items())
        else:
            yield name, value
