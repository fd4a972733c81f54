"""Warnings of the simulation, shown at the user's own line."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Sequence

import gymnasium

#: Number of notes that a warning shows: our choice, so that the warning can be read at a glance.
SHOWN = 3

#: Folders whose code calls this package on behalf of the user.
_LIBRARIES = tuple(os.path.dirname(os.path.abspath(file)) + os.sep for file in (__file__, gymnasium.__file__))


def warn(notes: Sequence[str], where: str = "") -> None:
    """Shows all `notes` as one `UserWarning` at the line of the user's program that has called this package. `where`:
    where to find the notes that are left out of a long warning."""
    if not notes:
        return
    text = "; ".join(notes[:SHOWN])
    if len(notes) > SHOWN:
        text += f"; and {len(notes) - SHOWN} more" + (f": {where}" if where else "")
    warnings.warn(text, UserWarning, stacklevel=_level())


def _level() -> int:
    """The `stacklevel` that stands for the first caller of `warn` outside of this package and gymnasium."""
    level, frame = 1, sys._getframe(1)
    while frame.f_back is not None and os.path.abspath(frame.f_code.co_filename).startswith(_LIBRARIES):
        level, frame = level + 1, frame.f_back
    return level
