"""Calls to servers, through the native module.

A `Stream` returns one answer for each request. Module `session` keeps a session when its stream breaks.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from . import _native, server
from ._native import Request, Response
from .batches import Batch, Rollout
from .errors import AccessDenied, InvalidRequest, LimitReached, OutOfOrder, SandgaitError, ServerLost, SessionLost
from .options import keyword_error, with_files
from .remote import Remote
from .spaces import Task
from .user_warnings import warn

#: Version of the protocol of this client. The server refuses other versions.
PROTOCOL = 1

#: Longest wait for a server to confirm that a session is closed [s]: our choice, so that the end of Python is not held
#: up. Without an answer the session ends with its lease.
CLOSE_TIMEOUT = 2.0

#: Name and exception of each of gRPC's status codes.
_CODES: dict[int, tuple[str, type[SandgaitError]]] = {
    1: ("CANCELLED", SessionLost),
    3: ("INVALID_ARGUMENT", InvalidRequest),
    4: ("DEADLINE_EXCEEDED", ServerLost),
    5: ("NOT_FOUND", SessionLost),
    8: ("RESOURCE_EXHAUSTED", LimitReached),
    9: ("FAILED_PRECONDITION", OutOfOrder),
    10: ("ABORTED", SessionLost),
    11: ("OUT_OF_RANGE", InvalidRequest),
    13: ("INTERNAL", SandgaitError),
    14: ("UNAVAILABLE", ServerLost),
}

_NOT_FOUND, _INVALID, _UNAUTHENTICATED = 5, 3, 16


def place(address: str) -> _native.Address:
    """The native module's description of a server."""
    if not re.fullmatch(r"unix:.+|(?!.*://).+:\d{1,5}", address):
        raise InvalidRequest(f'address: {address!r} is neither "host:port" nor "unix:/path"')
    if isinstance(address, Remote):
        return str(address), address.token, address.tls, address.ca, address.cert, address.key
    return address, None, False, None, None, None


def describe(address: str) -> tuple[str, tuple[Task, ...]]:
    """The version of the server at `address`, and the tasks that it offers."""
    try:
        version, protocol, tasks = _native.describe_server(place(address))
    except _native.StatusError as error:
        raise _error(*error.args, address) from None
    if protocol != PROTOCOL:
        raise SandgaitError(f"{address}: the server ({version}) speaks protocol {protocol}, this client {PROTOCOL}")
    return version, tuple(Task.of(task) for task in tasks)


def study(address: str, name: str, words: Sequence[str], files: Mapping[str, Any], told: Any) -> Any:
    """The study `name` with its arguments as words, at `address`; see `study_call`."""
    try:
        return _native.study(place(address), name, words, files, told)
    except _native.StatusError as error:
        raise _error(*error.args, address) from None


class Created(NamedTuple):
    """A new session on a server."""

    session_id: str
    task: Task


def create_session(address: str, task: str, num_envs: int, options: Mapping[str, Any]) -> Created:
    """Reserves environments on the server at `address`. They have no state before their first reset."""
    try:
        session_id, made, lines = _native.create_session(place(address), task, num_envs, with_files(options))
    except _native.StatusError as error:
        code, message = error.args
        # no such task or option: there is no session to lose
        raise _error(_INVALID if code == _NOT_FOUND else code, message, address) from None
    warn(lines)
    return Created(session_id, Task.of(made))


class Stream:
    """One stream to one session. Answers come in the order of the requests."""

    def __init__(self, address: str, session_id: str) -> None:
        self.address = address
        try:
            self._native = _native.Stream(place(address), session_id)
        except _native.StatusError as error:
            raise _error(*error.args, address) from None
        #: Number of the last request that the session has answered.
        self.last_sequence = self._native.last_sequence

    def send(self, request: Request, here: bool = False) -> None:
        """Sends a request without waiting for its answer. `here`: next the caller waits for this answer."""
        self._native.send(request, here)

    def receive(self) -> Response:
        """The next answer. Raises `ServerLost` if the connection broke; the session may still exist."""
        try:
            return self._native.receive()
        except _native.StatusError as error:
            raise _error(*error.args, self.address) from None

    def close(self) -> None:
        """Ends the stream; the session stays for the time of its lease."""
        self._native.close()


def close_session(address: str, session_id: str, timeout: float = CLOSE_TIMEOUT) -> None:
    """Closes a session. Waits up to `timeout` [s] until its server has freed it."""
    with contextlib.suppress(_native.StatusError):
        _native.close_session(place(address), session_id, timeout)


def reset_request(
    seeds: Sequence[int] | None, mask: npt.NDArray[np.bool_] | None, options: Mapping[str, Any]
) -> Request:
    """A reset. `seeds` and `mask` have one entry for each environment. Without seeds the random streams continue."""
    return Request.reset(seeds, None if mask is None else mask.tobytes(), options)


def step_request(actions: npt.NDArray[np.float32], held: npt.NDArray[np.bool_] | None = None) -> Request:
    """A step; `actions` is f32 [num_envs, action]. The server checks the actions' bounds. Environments in `held` keep
    their state."""
    return Request.step(actions, None if held is None else held.tobytes())


def restore_request(snapshot: bytes, sources: npt.NDArray[np.integer[Any]] | None) -> Request:
    """A restore. Environment i gets the state of the snapshot's environment `sources[i]`. Without `sources` it gets
    that of environment i modulo n, if the snapshot has n environments."""
    return Request.restore(snapshot, None if sources is None else sources.astype("<u4").tobytes())


def batch(response: Response) -> Batch:
    """The answer of a reset, step or restore."""
    return Batch._make(response.batch())


def rollout(parts: Sequence[Response], num_envs: int, task: Task) -> Rollout:
    """The answer of a rollout, from all its parts."""
    return Rollout._make(_native.rollout(parts, num_envs, (len(task.observation), len(task.action))))


def failure(response: Response, address: str) -> SandgaitError | None:
    """The error in a response, if it is a refusal."""
    refused = response.failure
    return None if refused is None else _error(*refused, address)


def _error(code: int, message: str, address: str) -> SandgaitError:
    """Converts a status to the exception that tells what the caller can do."""
    if code == _UNAUTHENTICATED:
        if isinstance(address, Remote) and address.token is not None:
            return AccessDenied(f"{address}: the server refuses the token of this sandgait.Remote")
        return AccessDenied(f"{address}: {message}; sandgait.Remote takes it (token or token_file)")
    name, kind = _CODES.get(code, (str(code), None))
    if kind is None:
        return SandgaitError(f"{address}: {message} ({name})")
    if kind is InvalidRequest:
        return keyword_error(message)
    if kind is ServerLost:
        # A server with TLS ends a connection without TLS. The order of packets decides how the client notices it.
        ended = re.search("frame with invalid size|broken pipe|reset by peer", message) and "TLS" not in message
        if ended and not getattr(address, "tls", False) and not address.startswith("unix:"):
            message += "; if it is a server with TLS, sandgait.Remote takes its certificate (ca or tls=True)"
        return ServerLost(f"{address}: the server cannot be reached: {message}{server.last_words(address)}")
    return kind(message)
