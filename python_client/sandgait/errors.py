"""Exceptions, distinguished by what the caller can do."""

from __future__ import annotations


class SandgaitError(Exception):
    """Base of every error this package raises on purpose."""


class InvalidRequest(SandgaitError, ValueError):
    """A value is wrong; the message names the field, the index and the range. The session goes on."""


class UnknownAttribute(SandgaitError, AttributeError):
    """An attribute that does not exist, or that would change nothing; the message says what to use instead."""


class OutOfOrder(SandgaitError):
    """A call that the present state does not allow, such as a step before any reset. The session goes on."""


class LimitReached(SandgaitError):
    """A limit of environments, sessions or memory was reached."""


class ServerLost(SandgaitError, ConnectionError):
    """The server cannot be reached, or has ended. Make the environment again once it is back."""


class SessionLost(SandgaitError):
    """The server runs, but this session has ended. Make the environment again."""
