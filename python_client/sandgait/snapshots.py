"""Joins the snapshots of one or several servers to one piece of bytes, and writes and reads it as a file."""

from __future__ import annotations

import contextlib
import os
import struct
import tempfile
from collections.abc import Sequence
from os import PathLike
from pathlib import Path

from .errors import InvalidRequest, SandgaitError

FilePath = str | PathLike[str]

#: The first bytes. Then follow the number of snapshots, the length of each [bytes] (all u64 little-endian), and the
#: snapshots.
_MAGIC = b"sandgait snapshots\n"


def write_snapshot(snapshots: Sequence[bytes], path: FilePath | None) -> bytes:
    """Joins `snapshots` to one piece of bytes, and writes it to a file if one is named. The file is written under
    another name and then renamed, so that it is never incomplete."""
    lengths = struct.pack(f"<{1 + len(snapshots)}Q", len(snapshots), *map(len, snapshots))
    data = _MAGIC + lengths + b"".join(snapshots)
    if path is None:
        return data
    target = Path(path)
    try:
        handle, name = tempfile.mkstemp(prefix=target.name, dir=target.parent)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            os.replace(name, target)
        except BaseException:
            with contextlib.suppress(OSError):
                os.unlink(name)
            raise
    except OSError as error:
        raise SandgaitError(f"{target}: the snapshot cannot be written: {error.strerror}") from error
    return data


def read_snapshot(snapshot: bytes | FilePath) -> list[bytes]:
    """The inverse of `write_snapshot`: reads its bytes or its file. The server checks each snapshot's content."""
    if not isinstance(snapshot, bytes):
        try:
            with Path(snapshot).open("rb") as file:
                start = file.read(len(_MAGIC))
                # The rest of another file, as a device without an end, is not read.
                snapshot = start + file.read() if start == _MAGIC else start
        except OSError as error:
            raise InvalidRequest(f"snapshot: {snapshot!r} cannot be read: {error.strerror}") from error
    if not snapshot.startswith(_MAGIC):
        raise InvalidRequest("snapshot: this is not one of sandgait's snapshots")
    at = len(_MAGIC)
    try:
        (count,) = struct.unpack_from("<Q", snapshot, at)
        lengths = struct.unpack_from(f"<{min(count, 2**16)}Q", snapshot, at + 8)
    except struct.error as error:
        raise InvalidRequest("snapshot: it is cut off") from error
    at += 8 + 8 * count
    parts = []
    for length in lengths:
        parts.append(snapshot[at : at + length])
        at += length
    if at != len(snapshot):
        raise InvalidRequest("snapshot: it is cut off or has something after its end")
    return parts
