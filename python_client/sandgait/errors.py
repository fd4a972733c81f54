"""Exceptions. Each class stands for errors after which the caller can do the same."""

from __future__ import annotations

#: Longest message: that of the native module (src/base/error.rs). A message may repeat a text that was given as a name.
LONGEST = 4300


class SandgaitError(Exception):
    """Base class of this package's exceptions."""

    def __init__(self, *args: object) -> None:
        super().__init__(*(shortened(arg, LONGEST) if isinstance(arg, str) else arg for arg in args))


class InvalidRequest(SandgaitError, ValueError):
    """A value is wrong. The message names the field, the index and the range. The session continues."""


class WrongType(InvalidRequest, TypeError):
    """An argument has a wrong type. The message names the argument, what was expected, and what was given."""


class UnknownOption(InvalidRequest, TypeError):
    """An environment was to be made with a keyword that the task does not have. Some libraries try a keyword of their
    own and leave it out after Python's usual `TypeError`."""


class AccessDenied(SandgaitError, PermissionError):
    """The server asks for a token that this client did not give, or refuses the one that it gave."""


class UnknownAttribute(SandgaitError, AttributeError):
    """The attribute does not exist, or setting it would change nothing. The message says what to use instead."""


class OutOfOrder(SandgaitError):
    """The present state does not allow the call, for example a step before the first reset. The session continues."""


class LimitReached(SandgaitError):
    """A limit of environments, sessions or memory was reached."""


class ServerLost(SandgaitError, ConnectionError):
    """The server cannot be reached, or has ended. Make the environment again when the server runs again."""


class SessionLost(SandgaitError):
    """The server runs, but this session has ended. Make the environment again."""


def shortened(text: str, most: int) -> str:
    """`text`, cut off after `most` characters."""
    return text if len(text) <= most else text[:most] + "…"
