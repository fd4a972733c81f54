"""A scoreboard that any simulator of sand can enter: `sandgait.scoreboard`.

`docs/scoreboard.md` explains the rows, the error, and how to add an entry or rows.
"""

from __future__ import annotations

from .board import ENTRIES, Entry, Scoreboard, WalkingEntry, scoreboard
from .motion import Motion, MotionStep
from .rows import Body, Gait, MeasuredSand, Solid, Walker

__all__ = [
    "ENTRIES",
    "Body",
    "Entry",
    "Gait",
    "MeasuredSand",
    "Motion",
    "MotionStep",
    "Scoreboard",
    "Solid",
    "Walker",
    "WalkingEntry",
    "scoreboard",
]
