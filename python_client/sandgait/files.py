"""Files of users, read within bounds."""

from __future__ import annotations

import os
from pathlib import Path

#: Largest text or key [bytes], as in the native module; its `src/base/files.rs` says why.
MOST_TEXT = 8 << 20


def read_within(path: str | os.PathLike[str], most: int = MOST_TEXT) -> bytes:
    """The content of a file or pipe of at most `most` bytes. Raises OSError with its reason in `strerror`."""
    with Path(path).open("rb") as file:
        content = file.read(most + 1)
    if len(content) > most:
        raise OSError(0, f"it has more than the {most >> 20} MiB that are read")
    return content
