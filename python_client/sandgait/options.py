"""Keywords of tasks, as they leave this process."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from .errors import InvalidRequest


def with_sand(options: Mapping[str, Any]) -> Mapping[str, Any]:
    """The option `sand` is the path of a sand.toml here and its text where environments are made."""
    if "sand" not in options:
        return options
    try:
        return {**options, "sand": Path(options["sand"]).read_text(encoding="utf-8")}
    except (OSError, TypeError, UnicodeDecodeError) as error:
        raise InvalidRequest(f"sand: {options['sand']!r} cannot be read as a file: {error}") from error
