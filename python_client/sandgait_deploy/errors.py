"""The error of this package."""

from __future__ import annotations


class Refused(ValueError):
    """A policy, a robot's readings or a request that cannot be used. The message is one line and names the remedy."""
