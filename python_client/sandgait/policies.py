"""Policies as files."""

from __future__ import annotations

from pathlib import Path

from .errors import InvalidRequest
from .snapshots import FilePath


def read_policy(onnx: bytes | FilePath) -> bytes:
    """The bytes of an ONNX file. The server checks its contents."""
    if isinstance(onnx, bytes):
        return onnx
    try:
        return Path(onnx).read_bytes()
    except (OSError, TypeError) as error:
        raise InvalidRequest(f"policy: {onnx!r} cannot be read as a file: {error}") from error
