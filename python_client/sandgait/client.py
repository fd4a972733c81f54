"""The wire: the only file of this package that imports grpc.

`study` asks for one study and waits for its answer. One `Session` is one stream: one message out for a batched reset or
step, one message back.

    send ──▶ queue ──▶ grpc's sender thread ──▶ server
    receive ◀────────── next(responses) ◀────── server
"""

from __future__ import annotations

import ctypes
import os
import queue
import re
import threading
import weakref
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

# Without this a child forked while a stream is open (gymnasium's AsyncVectorEnv does that) hangs or dies in grpc.
os.environ.setdefault("GRPC_ENABLE_FORK_SUPPORT", "1")

import grpc
import numpy as np
import numpy.typing as npt
from google.protobuf import json_format, struct_pb2

from . import server
from ._proto.sandgait.v1 import sandgait_pb2 as pb
from .errors import InvalidRequest, LimitReached, OutOfOrder, SandgaitError, ServerLost, SessionLost
from .spaces import Column, Option, Task

#: The wire protocol this client speaks; the server refuses another.
PROTOCOL = 1

#: What both ends of gRPC allow a message by default, and the least we ask for [bytes].
DEFAULT_MESSAGE_BYTES = 4 * 2**20

#: Largest message of a study [bytes]: requests are limited to 64 MiB by the server, results have up to some 100 MiB.
STUDY_BYTES = 512 * 2**20

#: Longest wait for an answer to Describe or CreateSession [s].
CALL_TIMEOUT = 60.0

_CODES = {code.value[0]: code for code in grpc.StatusCode}
_KINDS: dict[grpc.StatusCode, type[SandgaitError]] = {
    grpc.StatusCode.INVALID_ARGUMENT: InvalidRequest,
    grpc.StatusCode.OUT_OF_RANGE: InvalidRequest,
    grpc.StatusCode.FAILED_PRECONDITION: OutOfOrder,
    grpc.StatusCode.RESOURCE_EXHAUSTED: LimitReached,
    grpc.StatusCode.NOT_FOUND: SessionLost,
    grpc.StatusCode.ABORTED: SessionLost,
    grpc.StatusCode.UNAVAILABLE: ServerLost,
    grpc.StatusCode.CANCELLED: SessionLost,
    grpc.StatusCode.DEADLINE_EXCEEDED: ServerLost,
}


class Batch(NamedTuple):
    """All environments after a reset or step; arrays are this batch's own and may be written to."""

    #: f32 [num_envs, observation]; where an episode ended, already the first of the next one.
    observations: npt.NDArray[np.float32]
    #: f32 [num_envs]
    rewards: npt.NDArray[np.float32]
    #: [num_envs]
    terminated: npt.NDArray[np.bool_]
    #: [num_envs]
    truncated: npt.NDArray[np.bool_]
    #: f32 [info, num_envs], one contiguous row a column of the table
    infos: npt.NDArray[np.float32]
    #: [k] environments whose episode ended, ascending
    final_indices: npt.NDArray[np.intp]
    #: f32 [k, observation]
    final_observations: npt.NDArray[np.float32]


def describe(address: str | None = None) -> tuple[str, tuple[Task, ...]]:
    """Version of the server at `address` (none: the embedded one) and the tasks it offers."""
    address = address or server.address()
    with _channel(address, DEFAULT_MESSAGE_BYTES) as channel:
        reply = _call(channel, address, "Describe", pb.DescribeRequest(), pb.DescribeResponse)
    if reply.protocol != PROTOCOL:
        raise SandgaitError(
            f"{address}: the server ({reply.version}) speaks protocol {reply.protocol}, this client {PROTOCOL}"
        )
    return reply.version, tuple(_task(t) for t in reply.tasks)


def study(
    address: str | None,
    name: str,
    request: Any,
    reply: Any,
    told: Callable[[float, str], None] | None = None,
) -> Any:
    """Result of a study at `address` (none: the embedded server); with `told` it is a stream that tells its progress.

    Whatever interrupts the wait, an exception of `told` or Ctrl-C, also stops the study on the server.
    """
    address = address or server.address()
    with _channel(address, STUDY_BYTES) as channel:
        method = f"/sandgait.v1.StudyService/{name}"
        kind = channel.unary_unary if told is None else channel.unary_stream
        call = kind(method, lambda m: m.SerializeToString(), reply.FromString)
        try:
            if told is None:
                return call(request)
            stream = call(request)
            try:
                for message in stream:
                    if message.WhichOneof("event") != "progress":
                        return message
                    told(message.progress.fraction, message.progress.stage)
            finally:
                stream.cancel()
        except grpc.RpcError as error:
            raise _error(error.code(), str(error.details()), address) from None
        raise ServerLost(f"{address}: the study ended without a result")


class Session:
    """Environments of one task on one server."""

    def __init__(self, address: str | None, task: str, num_envs: int, options: Mapping[str, Any]) -> None:
        if not 1 <= num_envs < 2**32:
            raise InvalidRequest(f"num_envs: {num_envs} is outside [1, {2**32 - 1}]")
        self.address = address or server.address()
        self.num_envs = num_envs
        self._process = os.getpid()
        request = pb.CreateSessionRequest(task_id=task, num_envs=num_envs, protocol=PROTOCOL)
        request.options.CopyFrom(struct(_with_sand(options)))
        with _channel(self.address, DEFAULT_MESSAGE_BYTES) as channel:
            reply = _call(channel, self.address, "CreateSession", request, pb.CreateSessionResponse)
        self.task = _task(reply.task)
        self._id: str = reply.session_id
        self._broken: str | None = None
        self._sequence = 0
        channel = _channel(self.address, _message_bytes(self.task, num_envs))
        self._requests: queue.SimpleQueue[pb.RunSessionRequest | None] = queue.SimpleQueue()
        self._responses = channel.stream_stream(
            _method("RunSession"), pb.RunSessionRequest.SerializeToString, pb.RunSessionResponse.FromString
        )(iter(self._requests.get, None))
        # The server frees a session that has no stream within 30 s; this message takes the session, no more. Its
        # answer, number 0, is dropped by the first `receive`.
        self._requests.put(pb.RunSessionRequest(session_id=self._id))
        # Runs once: when called, when this object is collected, or when Python ends.
        self.close = weakref.finalize(self, _close, channel, self._requests, self._responses, self._id, self._process)

    def send_reset(
        self,
        seeds: Sequence[int] | None,
        mask: npt.NDArray[np.bool_] | None,
        options: Mapping[str, Any],
    ) -> None:
        """Asks for a reset. `seeds` and `mask` have one entry an environment; without seeds streams go on."""
        request = pb.RunSessionRequest()
        request.reset.SetInParent()
        if seeds is not None:
            for i, seed in enumerate(seeds):
                if not 0 <= seed < 2**64:
                    raise InvalidRequest(f"seed[{i}]: {seed} is outside [0, 2**64)")
            request.reset.seeds.extend(seeds)
        if mask is not None:
            request.reset.mask = mask.astype(np.uint8).tobytes()
        if options:
            request.reset.options.CopyFrom(struct(options))
        self._send(request)

    def send_step(self, actions: npt.NDArray[np.float32]) -> None:
        """Asks for a step; `actions` is f32 [num_envs, action]. Bounds are checked by the server."""
        request = pb.RunSessionRequest()
        request.step.actions = actions.astype("<f4", copy=False).tobytes()
        self._send(request)

    def _send(self, request: pb.RunSessionRequest) -> None:
        self._check_usable()
        self._sequence += 1
        request.session_id = self._id
        request.sequence = self._sequence
        self._requests.put(request)

    def _check_usable(self) -> None:
        if os.getpid() != self._process:
            raise SandgaitError("this environment belongs to the process that made it; make it anew after a fork")
        if not self.close.alive:
            raise SandgaitError("this environment is closed")
        if self._broken is not None:
            raise SessionLost(f"this session has ended ({self._broken}); make the environment anew")

    def receive(self) -> Batch:
        """Answer to what was sent last; answers to earlier requests that nobody waited for are dropped."""
        self._check_usable()
        try:
            response = next(self._responses)
            while response.sequence < self._sequence:
                response = next(self._responses)
        except StopIteration:
            self._broken = "the server closed it"
            raise SessionLost(f"{self.address}: the server closed this session; make the environment anew") from None
        except grpc.RpcError as error:
            self._broken = str(error.details())
            raise _error(error.code(), str(error.details()), self.address) from None
        except BaseException:  # grpc cannot take up a read that was broken off
            self._broken = "a call was interrupted while it waited for the server"
            raise
        if response.HasField("failure"):
            code = _CODES.get(response.failure.code, grpc.StatusCode.UNKNOWN)
            raise _error(code, response.failure.message, self.address)
        return _batch(response.batch, self.task, self.num_envs)


def _close(
    channel: grpc.Channel,
    requests: queue.SimpleQueue[pb.RunSessionRequest | None],
    responses: Any,
    session_id: str,
    process: int,
) -> None:
    """Ends a session, and frees it on the server before this returns, if the server still answers."""
    if os.getpid() != process:
        return  # a forked child: the session is the parent's
    requests.put(None)
    try:
        request = pb.CloseSessionRequest(session_id=session_id)
        _unary(channel, "CloseSession", pb.CloseSessionResponse)(request, timeout=2.0)
    except grpc.RpcError:
        pass  # gone already, which is what was asked for
    responses.cancel()
    channel.close()
    if not threading.main_thread().is_alive():
        # Python is ending. The destructor of grpc's call takes a lock that a thread may hold which Python has stopped
        # for good: it would wait forever. What is never collected has no destructor.
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(responses))


def _channel(address: str, message_bytes: int) -> grpc.Channel:
    """A connection of its own to `address`, `host:port` or `unix:/path`."""
    if not re.fullmatch(r"unix:.+|.+:\d{1,5}", address):
        raise InvalidRequest(f'address: {address!r} is neither "host:port" nor "unix:/path"')
    options: list[tuple[str, Any]] = [
        ("grpc.max_send_message_length", message_bytes),
        ("grpc.max_receive_message_length", message_bytes),
        ("grpc.use_local_subchannel_pool", 1),
        ("grpc.enable_http_proxy", 0),  # a proxy from the environment would sit in every step
        ("grpc.keepalive_time_ms", 20_000),  # notices a host that vanished
        ("grpc.keepalive_timeout_ms", 20_000),
        ("grpc.http2.max_pings_without_data", 0),
    ]
    if address.startswith("unix:"):
        # The default authority is the percent-encoded path, which HTTP/2 servers refuse (RST_STREAM error 1).
        options.append(("grpc.default_authority", "localhost"))
    return grpc.insecure_channel(address, options=options)


def _method(name: str) -> str:
    return f"/sandgait.v1.EnvironmentService/{name}"


def _unary(channel: grpc.Channel, name: str, reply: Any) -> Any:
    return channel.unary_unary(_method(name), lambda m: m.SerializeToString(), reply.FromString)


def _call(channel: grpc.Channel, address: str, name: str, request: Any, reply: Any) -> Any:
    try:
        return _unary(channel, name, reply)(request, timeout=CALL_TIMEOUT)
    except grpc.RpcError as error:
        code = error.code()
        if name == "CreateSession" and code == grpc.StatusCode.NOT_FOUND:
            code = grpc.StatusCode.INVALID_ARGUMENT  # a task or option of that name: there is no session to lose
        raise _error(code, str(error.details()), address) from None


def _error(code: grpc.StatusCode, message: str, address: str) -> SandgaitError:
    """A status as the exception that says what the caller can do."""
    kind = _KINDS.get(code)
    if kind is None:
        return SandgaitError(f"{address}: {message} ({code.name})")
    if kind is ServerLost:
        return ServerLost(f"{address}: the server cannot be reached: {message}{server.last_words(address)}")
    return kind(message)


def _message_bytes(task: Task, num_envs: int) -> int:
    """Upper bound of one message of this session: every column of every environment, each episode ending."""
    floats = 2 * len(task.observation) + len(task.info) + len(task.action) + 1
    return max(DEFAULT_MESSAGE_BYTES, num_envs * (4 * floats + 16) + 2**16)


def _with_sand(options: Mapping[str, Any]) -> Mapping[str, Any]:
    """The option `sand` is the path of a sand.toml here and its text on the wire: the server may be elsewhere."""
    if "sand" not in options:
        return options
    try:
        return {**options, "sand": Path(options["sand"]).read_text(encoding="utf-8")}
    except (OSError, TypeError, UnicodeDecodeError) as error:
        raise InvalidRequest(f"sand: {options['sand']!r} cannot be read as a file: {error}") from error


def struct(options: Mapping[str, Any]) -> struct_pb2.Struct:
    """Keywords as the wire carries them; numpy numbers and arrays, tuples, lists and dicts are taken."""
    message = struct_pb2.Struct()
    for name, value in options.items():
        try:
            message.update({name: _plain(value)})
        except (ValueError, TypeError) as error:
            raise InvalidRequest(f"{name}: {value!r} is not a number, text, truth value, list or dict") from error
    return message


def _plain(value: Any) -> Any:
    if isinstance(value, (np.generic, np.ndarray)):
        return value.tolist()
    if isinstance(value, Mapping):
        return {key: _plain(v) for key, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    return value


def _task(task: pb.Task) -> Task:
    def columns(rows: Any) -> tuple[Column, ...]:
        return tuple(Column(c.name, c.unit, c.low, c.high) for c in rows)

    options = (Option(o.name, o.summary, json_format.MessageToDict(o.default_value), o.at_reset) for o in task.options)
    return Task(
        id=task.id,
        summary=task.summary,
        observation=columns(task.observation),
        action=columns(task.action),
        info=columns(task.info),
        reward_terms=task.reward_terms,
        max_episode_steps=task.max_episode_steps,
        control_rate=task.control_rate,
        options=tuple(options),
    )


def _batch(batch: pb.Batch, task: Task, num_envs: int) -> Batch:
    def rows(data: bytes, width: int) -> npt.NDArray[np.float32]:
        return np.frombuffer(data, "<f4").reshape(-1, width)

    return Batch(
        observations=rows(batch.observations, len(task.observation)).astype(np.float32),
        rewards=np.frombuffer(batch.rewards, "<f4").astype(np.float32),
        terminated=np.frombuffer(batch.terminated, np.uint8).astype(np.bool_),
        truncated=np.frombuffer(batch.truncated, np.uint8).astype(np.bool_),
        infos=rows(batch.infos, len(task.info)).T.astype(np.float32, order="C"),
        final_indices=np.frombuffer(batch.final_indices, "<u4").astype(np.intp),
        final_observations=rows(batch.final_observations, len(task.observation)).astype(np.float32),
    )
