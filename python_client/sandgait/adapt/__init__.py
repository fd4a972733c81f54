"""`sandgait adapt`: from a robot's log to a better policy, if the log can tell. `docs/deploy.md` explains the page."""

from __future__ import annotations

from .loop import Adaptation, Gain, Request, adapt
from .page import page, summary
from .posterior import Draw, Posterior, posterior

__all__ = ["Adaptation", "Draw", "Gain", "Posterior", "Request", "adapt", "page", "posterior", "summary"]
