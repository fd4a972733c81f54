"""`sandgait adapt`: from a robot's log to a better policy, if the log can tell. `docs/certify.md` explains the page."""

from __future__ import annotations

from .loop import Adaptation, Gain, Request, adapt
from .page import page, summary
from .posterior import Cause, Member, Posterior, World, posterior

__all__ = [
    "Adaptation",
    "Cause",
    "Gain",
    "Member",
    "Posterior",
    "Request",
    "World",
    "adapt",
    "page",
    "posterior",
    "summary",
]
