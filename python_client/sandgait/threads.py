"""The number of simulating threads. The first environment's keyword `threads` sets it, or else SANDGAIT_THREADS."""

from __future__ import annotations

import os

from .errors import InvalidRequest


def checked(threads: object, name: str) -> int:
    """Checks a number of threads, which may be a text."""
    try:
        number = int(str(threads))
    except ValueError:
        number = 0
    if not 1 <= number <= 65_535:
        raise InvalidRequest(f"{name}: {threads!r} is not a whole number in [1, 65535]")
    return number


def wanted() -> int:
    """The default number of threads; 0 stands for one thread on each processor."""
    chosen = os.environ.get("SANDGAIT_THREADS")
    return checked(chosen, "SANDGAIT_THREADS") if chosen else 0


def agreed(threads: int | None, has: int | None, whose: str) -> int:
    """The number of threads for environments that request `threads`. `has`: number of running threads; None if no
    thread runs yet."""
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
