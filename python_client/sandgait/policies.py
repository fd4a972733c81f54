"""Policies as files."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from .errors import InvalidRequest
from .files import read_within
from .options import task_id
from .snapshots import FilePath


def read_policy(onnx: bytes | FilePath) -> bytes:
    """The bytes of an ONNX file, or of that in the folder of a training. The server checks its contents."""
    if isinstance(onnx, bytes):
        return onnx
    try:
        path = Path(onnx)
        return read_within(path / "policy.onnx" if path.is_dir() else path)
    except (OSError, TypeError) as error:
        raise InvalidRequest(f"policy: {onnx!r} cannot be read as a file: {error}") from error


def trained(settings: Path) -> tuple[str, dict[str, Any]]:
    """Task and options of the training that left the file `settings`."""
    try:
        found = json.loads(settings.read_bytes())
        return task_id(found["task"]), dict(found.get("options") or {})
    except (OSError, ValueError, TypeError, KeyError, AttributeError) as error:
        raise InvalidRequest(f"{settings}: no settings of a training: {error!r}") from error
