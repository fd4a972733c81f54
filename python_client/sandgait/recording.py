"""Recordings: files with the state of a robot after each control step, which `sandgait replay` shows.

A file is a gzip stream of blocks; `docs/recordings.md` has the format. No server is needed to read a recording.
"""

from __future__ import annotations

import gzip
import json
import math
import struct
import zlib
from collections.abc import Iterator
from os import PathLike
from pathlib import Path
from typing import IO, Any, cast

import numpy as np
import numpy.typing as npt

from . import notebook
from .arguments import checked
from .errors import InvalidRequest, SandgaitError, unknown

FilePath = str | PathLike[str]
Floats = npt.NDArray[np.float32]

_FORMAT, _VERSION = "sandgait recording", 1
_BLOCK = struct.Struct("<4sI")
#: Long parts of a header. A section has such a part only if it differs from that of the section before.
_SAME = ("shapes", "relief")
_AS_BEFORE = "as before"
_FOREIGN = "this is not one of sandgait's recordings"

#: Largest numbers of sections, of bytes of all headers, and of commas and opening brackets in them, each of which is a
#: value at most. Our choice, explained in src/view/recording.rs.
_MOST_SECTIONS, _MOST_HEADERS, _MOST_VALUES = 100_000, 128 << 20, 8_000_000

#: Largest number of blocks: our choice, explained there, too.
_MOST_BLOCKS = 2_000_000

#: Number of bytes that are unpacked at a time: our choice.
_PIECE = 1 << 20

#: Largest unpacked size of a recording [bytes]: our choice, because four hours of a hexapod fit into it, with 300
#: numbers at 50 Hz.
MAX_BYTES = 2**30


class Section:
    """The recorded states of one episode; for example `section["angles"]` is f32 [states, joints]."""

    def __init__(self, header: dict[str, Any], rows: Floats) -> None:
        #: Names, units and shapes of the columns, geometry of the robot, seed and more: see docs/recordings.md.
        self.header = header
        #: f32 [states, all columns]
        self.rows = rows
        self._places: dict[str, tuple[slice, tuple[int, ...]]] = {}
        start = 0
        for column in header["columns"]:
            shape = tuple(column["shape"])
            stop = start + math.prod(shape)
            self._places[column["name"]] = (slice(start, stop), shape)
            start = stop

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns."""
        return tuple(self._places)

    def __getitem__(self, name: str) -> Floats:
        if name not in self._places:
            raise unknown("column", name, self._places)
        place, shape = self._places[name]
        return self.rows[:, place].reshape(len(self.rows), *shape)


class Recording:
    """All sections of a file. For example `recording["position"]` is f32 [states, 3] with the states of all sections,
    in order."""

    def __init__(self, sections: tuple[Section, ...]) -> None:
        self.sections = sections

    def __len__(self) -> int:
        return sum(len(s) for s in self.sections)

    @property
    def header(self) -> dict[str, Any]:
        """Header of the first section."""
        return self.sections[0].header

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns of the first section."""
        return self.sections[0].columns

    def _repr_html_(self) -> str:
        """What the recording holds, its columns, and the way of the robot. The film needs the file."""
        known = ("task", "robot", "medium", "slope_deg", "law", "seed", "sandgait")
        about: dict[str, Any] = {name: self.header[name] for name in known if name in self.header}
        rate = self.header.get("rate")
        length = f", {len(self) / rate:.4g} s" if isinstance(rate, (int, float)) and rate > 0 else ""
        about |= {
            "episodes": len(self.sections),
            "states": f"{len(self)}{length}",
            "columns": ", ".join(map(str, self.columns)),
        }
        return (
            notebook.title("Recording")
            + notebook.facts(about)
            + self._way()
            + notebook.paragraph("The film of its file FILE: sandgait replay FILE --html film.html")
        )

    def _way(self) -> str:
        """The way of the first episode, if it has columns for it."""
        first = self.sections[0]
        shapes = [first[name].shape[1:] if name in first.columns else None for name in ("time", "position")]
        if shapes != [(), (3,)]:
            return notebook.paragraph("No curve: the recording has no times or no positions of a robot.")
        return notebook.curve(first["time"], first["position"][:, 0], "time [s]", "x of the first episode [m]")

    def __getitem__(self, name: str) -> Floats:
        parts = [s[name] for s in self.sections]
        if len({p.shape[1:] for p in parts}) > 1:
            raise InvalidRequest(f"column {name!r} has another shape in each section; take it from .sections")
        return np.concatenate(parts)


@checked
def read_recording(path: FilePath, max_bytes: int = MAX_BYTES) -> Recording:
    """The recording in the file `path` as numpy arrays. A file that unpacks to more than `max_bytes` is refused."""
    sections: list[Section] = []
    try:
        with gzip.open(path) as stream:
            for head, rows in _blocks(cast("IO[bytes]", stream), path, max_bytes):
                section = _section(head, rows, path)
                for part in _SAME:
                    if section.header.get(part) == _AS_BEFORE:
                        section.header[part] = sections[-1].header.get(part) if sections else None
                sections.append(section)
    except (EOFError, _CutOff):
        raise InvalidRequest(f"{path}: the recording is cut off") from None
    except (OSError, zlib.error) as error:
        reason = getattr(error, "strerror", None) or _FOREIGN
        raise InvalidRequest(f"{path}: {reason}") from None
    if not sections:
        raise InvalidRequest(f"{path}: the recording is empty")
    return Recording(tuple(sections))


class _CutOff(Exception):
    """The stream ends within a block."""


def _blocks(stream: IO[bytes], path: FilePath, left: int) -> Iterator[tuple[bytes, bytearray]]:
    """Header and rows of each section. Unpacks at most `left` bytes, even if a block states a greater length."""
    header: bytes | None = None
    rows = bytearray()
    sections, blocks, headers, values = 0, 0, _MOST_HEADERS, _MOST_VALUES
    while start := stream.read(_BLOCK.size):
        blocks += 1
        if blocks > _MOST_BLOCKS:
            raise InvalidRequest(f"{path}: it has more than {_MOST_BLOCKS} blocks")
        if len(start) < _BLOCK.size:
            raise _CutOff
        kind, length = _BLOCK.unpack(start)
        if kind != b"HEAD" and (kind != b"ROWS" or header is None):
            raise InvalidRequest(f"{path}: {_FOREIGN}")
        left -= _BLOCK.size + length
        if left < 0:
            raise InvalidRequest(f"{path}: it unpacks to more than max_bytes; take a larger one if you trust the file")
        if kind == b"ROWS":
            _extend(rows, stream, length)
            continue
        if header is not None:
            yield header, rows
        content = bytearray()
        _extend(content, stream, min(length, headers + 1))
        sections, headers = sections + 1, headers - length
        values -= sum(content.count(mark) for mark in (b",", b"[", b"{"))
        if sections > _MOST_SECTIONS:
            raise InvalidRequest(f"{path}: it has more than {_MOST_SECTIONS} sections")
        if headers < 0 or values < 0:
            reason = f"its headers have more than {_MOST_HEADERS} bytes or {_MOST_VALUES} values"
            raise InvalidRequest(f"{path}: {reason}")
        header, rows = bytes(content), bytearray()
    if header is not None:
        yield header, rows


def _extend(content: bytearray, stream: IO[bytes], length: int) -> None:
    """Adds the next `length` bytes of the stream, in pieces, so that a length that is not there takes no memory."""
    while length > 0:
        piece = stream.read(min(length, _PIECE))
        if not piece:
            raise _CutOff
        content += piece
        length -= len(piece)


def _section(head: bytes, rows: bytearray, path: FilePath) -> Section:
    try:
        header = json.loads(head)
        version = header.get("format"), header.get("version")
        if version != (_FORMAT, _VERSION):
            raise InvalidRequest(f"{path}: this is no recording of version {_VERSION}")
        width = sum(math.prod(c["shape"]) for c in header["columns"])
        table = np.frombuffer(rows, "<f4").reshape(-1, width).astype(np.float32, copy=False)
        return Section(header, table)
    except InvalidRequest:
        raise
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError, OverflowError):
        raise InvalidRequest(f"{path}: {_FOREIGN}") from None


class Recorder:
    """Writes a recording from the states that the server sends."""

    def __init__(self, path: FilePath) -> None:
        self._path = Path(path)
        try:
            self._file = gzip.GzipFile(self._path, "wb")
        except OSError as error:
            raise SandgaitError(f"{path}: the recording cannot be written: {error.strerror}") from error
        self._header = ""
        self._same: dict[str, Any] = {}

    def add(self, header: str, row: bytes) -> None:
        """Adds a state. If its header differs from the last one, a new section begins."""
        if header != self._header:
            self._header = header
            self._write(b"HEAD", self._shortened(header).encode())
        self._write(b"ROWS", row)

    def _shortened(self, header: str) -> str:
        """The header without the parts that are equal in the section before."""
        whole = json.loads(header)
        before, self._same = self._same, {part: whole[part] for part in _SAME if part in whole}
        same = [part for part, value in self._same.items() if before.get(part) == value]
        return json.dumps({**whole, **dict.fromkeys(same, _AS_BEFORE)}, ensure_ascii=False) if same else header

    def _write(self, kind: bytes, content: bytes) -> None:
        try:
            self._file.write(_BLOCK.pack(kind, len(content)) + content)
        except OSError as error:
            raise SandgaitError(f"{self._path}: the recording cannot be written: {error.strerror}") from error

    def close(self) -> None:
        """Completes the file. Before that the file cannot be read."""
        self._file.close()
