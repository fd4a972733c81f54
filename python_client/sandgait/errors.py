"""What can go wrong, by what the caller can do about it."""

from __future__ import annotations


class SandgaitError(Exception):
    """Base of every error this package raises on purpose."""


class InvalidRequest(SandgaitError, ValueError):
    """A value is wrong; the message names the field, the index and the range. The session goes on."""


class UnknownAttribute(SandgaitError, AttributeError):
    """An attribute that is not there, or that would change nothing; the message says what to use instead."""


class OutOfOrder(SandgaitError):
    """A call that the present state does not allow, such as a step before any reset. The session goes on."""


class LimitReached(SandgaitError):
    """The server refuses to give more: environments, sessions or memory."""


class ServerLost(SandgaitError, ConnectionError):
    """The server cannot be reached, or went away. Make the environment anew once it is back."""


class SessionLost(SandgaitError):
    """The server is there, but this session has ended. Make the environment anew."""
