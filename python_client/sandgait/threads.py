"""The number of simulating threads: a keyword of the first environment, or SANDGAIT_THREADS."""

from __future__ import annotations

import os

from .errors import InvalidRequest


def checked(threads: object, name: str) -> int:
    """A number of threads, also from text."""
    try:
        number = int(str(threads))
    except ValueError:
        number = 0
    if not 1 <= number <= 65_535:
        raise InvalidRequest(f"{name}: {threads!r} is not a whole number in [1, 65535]")
    return number


def wanted() -> int:
    """The default number; 0: one for each processor."""
    chosen = os.environ.get("SANDGAIT_THREADS")
    return checked(chosen, "SANDGAIT_THREADS") if chosen else 0


def agreed(threads: int | None, has: int | None, whose: str) -> int:
    """The number for environments that request `threads`, given that `has` threads run already (None: none yet)."""
    if threads is None:
        return wanted() if has is None else has
    number = checked(threads, "threads")
    if has is not None and has != number:
        words = f"{has} threads" if has else "one thread for each processor"
        raise InvalidRequest(
            f"threads: {threads} asked for, but {whose} has {words} already; give the number to the first "
            "environment, or set SANDGAIT_THREADS"
        )
    return number
