"""The wire: the only file of this package that imports grpc, when the first connection is made.

`study` asks for one study and waits for its answer. A `Stream` takes one message for a batched reset or step and gives
one back; `session` makes a session of streams.

    send ──▶ queue ──▶ grpc's sender thread ──▶ server
    receive ◀────────── next(responses) ◀────── server
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import os
import queue
import re
import subprocess
import threading
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt
from google.protobuf import json_format, struct_pb2

from . import server
from ._proto.sandgait.v1 import sandgait_pb2 as pb
from .errors import InvalidRequest, LimitReached, OutOfOrder, SandgaitError, ServerLost, SessionLost
from .remote import Remote
from .spaces import Column, Option, Task

if TYPE_CHECKING:
    import grpc

#: The wire protocol this client speaks; the server refuses another.
PROTOCOL = 1

#: What both ends of gRPC allow a message by default, and the least we ask for [bytes].
DEFAULT_MESSAGE_BYTES = 4 * 2**20

#: Largest message of a study [bytes]: requests are limited to 64 MiB by the server, results have up to some 100 MiB.
STUDY_BYTES = 512 * 2**20

#: Longest wait for an answer to Describe or CreateSession [s].
CALL_TIMEOUT = 60.0

#: How numbers travel; the native float32 of every machine that we have wheels for.
FLOAT = np.dtype("<f4")

_FORK_SUPPORT = "GRPC_ENABLE_FORK_SUPPORT"

#: Names of grpc's status codes, and what each asks of the caller.
_KINDS: dict[str, type[SandgaitError]] = {
    "INVALID_ARGUMENT": InvalidRequest,
    "OUT_OF_RANGE": InvalidRequest,
    "FAILED_PRECONDITION": OutOfOrder,
    "RESOURCE_EXHAUSTED": LimitReached,
    "NOT_FOUND": SessionLost,
    "ABORTED": SessionLost,
    "UNAVAILABLE": ServerLost,
    "CANCELLED": SessionLost,
    "DEADLINE_EXCEEDED": ServerLost,
    "INTERNAL": SandgaitError,
}


@functools.cache
def _grpc() -> Any:
    """grpc, with support for forks: without it a child forked while a stream is open (gymnasium's AsyncVectorEnv does
    that) hangs or dies in grpc.

    grpc reads the variable with its first channel. It is put back after that, so that the processes this one starts do
    not inherit it. It helps also where grpc was imported, or a channel opened and closed, before.
    """
    before = os.environ.get(_FORK_SUPPORT)
    os.environ.setdefault(_FORK_SUPPORT, "1")
    try:
        import grpc

        grpc.insecure_channel("unix:/").close()
    finally:
        if before is None:
            del os.environ[_FORK_SUPPORT]
    return grpc


@functools.cache
def _codes() -> dict[int, str]:
    """Names of grpc's status codes by number."""
    return {code.value[0]: code.name for code in _grpc().StatusCode}


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
                return call(request, metadata=_metadata(address))
            stream = call(request, metadata=_metadata(address))
            try:
                for message in stream:
                    if message.WhichOneof("event") != "progress":
                        return message
                    told(message.progress.fraction, message.progress.stage)
            finally:
                stream.cancel()
        except _grpc().RpcError as error:
            raise _error(error.code().name, str(error.details()), address) from None
        raise ServerLost(f"{address}: the study ended without a result")


class Created(NamedTuple):
    """A session that a server has made."""

    session_id: str
    task: Task


def create_session(address: str, task: str, num_envs: int, options: Mapping[str, Any]) -> Created:
    """Reserves environments on the server at `address`. They have no state before their first reset."""
    request = pb.CreateSessionRequest(task_id=task, num_envs=num_envs, protocol=PROTOCOL)
    request.options.CopyFrom(struct(with_files(options)))
    with _channel(address, DEFAULT_MESSAGE_BYTES) as channel:
        reply = _call(channel, address, "CreateSession", request, pb.CreateSessionResponse)
    for line in reply.warnings:
        warnings.warn(line, UserWarning, stacklevel=2)
    return Created(reply.session_id, _task(reply.task))


class Stream:
    """One stream to one session. Answers come in the order of the requests."""

    def __init__(self, address: str, session_id: str) -> None:
        self.address = address
        self._channel = _channel(address, -1)
        self._requests: queue.SimpleQueue[pb.RunSessionRequest | None] = queue.SimpleQueue()
        self._responses = self._channel.stream_stream(
            _method("RunSession"), pb.RunSessionRequest.SerializeToString, pb.RunSessionResponse.FromString
        )(iter(self._requests.get, None), metadata=_metadata(address))
        first = pb.RunSessionRequest(session_id=session_id)
        first.attach.SetInParent()
        self._requests.put(first)
        #: Number of the last request that the session has carried out or refused.
        self.last_sequence: int = self.receive().attached.last_sequence

    def send(self, request: pb.RunSessionRequest) -> None:
        """Sends without waiting."""
        self._requests.put(request)

    def receive(self) -> pb.RunSessionResponse:
        """The next answer. `ServerLost` if the connection broke: the session may still be there."""
        try:
            response: pb.RunSessionResponse = next(self._responses)
            return response
        except StopIteration:
            raise SessionLost(f"{self.address}: the server closed this session; make the environment anew") from None
        except _grpc().RpcError as error:
            code = error.code().name
            if code in ("INTERNAL", "UNKNOWN"):
                code = "UNAVAILABLE"  # how grpc reports a connection that was cut in mid-message
            raise _error(code, str(error.details()), self.address) from None

    def abandon(self) -> None:
        """Leaves a read that was broken off, by Ctrl-C for example.

        The exception may have struck while a lock of grpc's was held, and then whoever asks for that lock waits
        forever: nothing of this stream is called or collected again.
        """
        self._requests.put(None)
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(self))

    def close(self) -> None:
        """Ends the stream; the session stays for the time of its lease."""
        self._requests.put(None)
        self._responses.cancel()
        self._channel.close()
        if not threading.main_thread().is_alive():
            # Python is ending. The destructor of grpc's call takes a lock that a thread may hold which Python has
            # stopped for good: it would wait forever. What is never collected has no destructor.
            ctypes.pythonapi.Py_IncRef(ctypes.py_object(self._responses))


def close_session(address: str, session_id: str, timeout: float = 2.0) -> None:
    """Frees a session before this returns, if its server answers within `timeout` [s]."""
    with _channel(address, DEFAULT_MESSAGE_BYTES) as channel, contextlib.suppress(_grpc().RpcError):
        request = pb.CloseSessionRequest(session_id=session_id)
        _unary(channel, "CloseSession", pb.CloseSessionResponse)(request, timeout=timeout, metadata=_metadata(address))


def reset_request(
    seeds: Sequence[int] | None, mask: npt.NDArray[np.bool_] | None, options: Mapping[str, Any]
) -> pb.RunSessionRequest:
    """A reset. `seeds` and `mask` have one entry an environment; without seeds streams go on."""
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
    return request


def step_request(actions: npt.NDArray[np.float32], held: npt.NDArray[np.bool_] | None = None) -> pb.RunSessionRequest:
    """A step; `actions` is f32 [num_envs, action]. Bounds are checked by the server. `held`: who stays as it is."""
    request = pb.RunSessionRequest()
    request.step.actions = actions.astype(FLOAT, copy=False).tobytes()
    if held is not None:
        request.step.held = held.astype(np.uint8).tobytes()
    return request


def save_request() -> pb.RunSessionRequest:
    """Asks for all environments as data."""
    return pb.RunSessionRequest(save=pb.Save())


def restore_request(snapshot: bytes, sources: npt.NDArray[np.integer[Any]] | None) -> pb.RunSessionRequest:
    """Environment i becomes number `sources[i]` of the snapshot; without sources, number i modulo theirs."""
    chosen = b"" if sources is None else sources.astype("<u4").tobytes()
    return pb.RunSessionRequest(restore=pb.Restore(snapshot=snapshot, sources=chosen))


def rollout_request(actions: npt.NDArray[np.float32], trajectories: bool) -> pb.RunSessionRequest:
    """Runs `actions`, f32 [steps, num_envs, action], from where the environments are, and puts them back."""
    data = actions.astype("<f4", copy=False).tobytes()
    return pb.RunSessionRequest(rollout=pb.Rollout(actions=data, trajectories=trajectories))


def policy_rollout_request(onnx: bytes, steps: int, trajectories: bool) -> pb.RunSessionRequest:
    """Runs a network for `steps` from where the environments are, and puts them back."""
    return pb.RunSessionRequest(policy_rollout=pb.PolicyRollout(onnx=onnx, steps=steps, trajectories=trajectories))


def render_request(indices: Sequence[int], width: int, height: int, ended: bool) -> pb.RunSessionRequest:
    """Asks for a picture of each environment; `ended`: of an episode that has just ended, its last moment."""
    return pb.RunSessionRequest(render=pb.Render(indices=indices, width=width, height=height, ended=ended))


def observe_request(index: int, ended: bool) -> pb.RunSessionRequest:
    """Asks for the moment of one environment, as recordings hold it."""
    return pb.RunSessionRequest(observe=pb.Observe(index=index, ended=ended))


def failure(response: pb.RunSessionResponse, address: str) -> SandgaitError | None:
    """The error that a response stands for, if it is a refusal."""
    if not response.HasField("failure"):
        return None
    code = _codes().get(response.failure.code, "UNKNOWN")
    return _error(code, response.failure.message, address)


def _channel(address: str, message_bytes: int) -> grpc.Channel:
    """A connection of its own to `address`, `host:port` or `unix:/path`."""
    if not re.fullmatch(r"unix:.+|.+:\d{1,5}", address):
        raise InvalidRequest(f'address: {address!r} is neither "host:port" nor "unix:/path"')
    grpc = _grpc()
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
    if isinstance(address, Remote) and address.tls:
        credentials = grpc.ssl_channel_credentials(address.ca, address.key, address.cert)
        return grpc.secure_channel(address, credentials, options=options)
    return grpc.insecure_channel(address, options=options)


def _metadata(address: str) -> tuple[tuple[str, str], ...]:
    """What every call to `address` says."""
    token = address.token if isinstance(address, Remote) else None
    return () if token is None else (("authorization", f"Bearer {token}"),)


def _method(name: str) -> str:
    return f"/sandgait.v1.EnvironmentService/{name}"


def _unary(channel: grpc.Channel, name: str, reply: Any) -> Any:
    return channel.unary_unary(_method(name), lambda m: m.SerializeToString(), reply.FromString)


def _call(channel: grpc.Channel, address: str, name: str, request: Any, reply: Any) -> Any:
    try:
        return _unary(channel, name, reply)(request, timeout=CALL_TIMEOUT, metadata=_metadata(address))
    except _grpc().RpcError as error:
        code = error.code().name
        if name == "CreateSession" and code == "NOT_FOUND":
            code = "INVALID_ARGUMENT"  # a task or option of that name: there is no session to lose
        raise _error(code, str(error.details()), address) from None


def _error(code: str, message: str, address: str) -> SandgaitError:
    """A status as the exception that says what the caller can do."""
    if code == "UNAUTHENTICATED":
        return SandgaitError(f"{address}: {message}; sandgait.Remote takes it (token or token_file)")
    kind = _KINDS.get(code)
    if kind is None:
        return SandgaitError(f"{address}: {message} ({code})")
    if kind is ServerLost:
        return ServerLost(f"{address}: the server cannot be reached: {message}{server.last_words(address)}")
    return kind(message)


def with_files(options: Mapping[str, Any]) -> Mapping[str, Any]:
    """Options that are paths here are texts on the wire, for a server elsewhere: a sand.toml, a URDF or an MJCF."""
    texts = {}
    if "sand" in options:
        try:
            texts["sand"] = Path(options["sand"]).read_text(encoding="utf-8")
        except (OSError, TypeError, UnicodeDecodeError) as error:
            raise InvalidRequest(f"sand: {options['sand']!r} cannot be read as a file: {error}") from error
    robot = options.get("robot")
    if isinstance(robot, (str, Path)) and Path(robot).suffix in _ROBOT_FILES:
        texts["robot"] = _packed(Path(robot))
    return {**options, **texts}


#: Endings of files that hold a robot.
_ROBOT_FILES = (".urdf", ".xml", ".mjcf")


def _packed(path: Path) -> str:
    """A robot with its meshes cut into plates, by this machine's own program: what a server takes."""
    command = [server.find_binary(), "robot", str(path), "--pack"]
    done = subprocess.run(command, capture_output=True, encoding="utf-8", check=False)
    if done.returncode != 0:
        raise InvalidRequest(f"robot: {done.stderr.strip().removeprefix('sandgait: ')}")
    return done.stdout.strip()


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


def batch(batch: pb.Batch, task: Task) -> Batch:
    """The columns of a message as arrays: one copy of each, and one call of numpy where one will do.

    After a wait for the simulation every instruction here is cold: a call costs three times what it costs in a loop.
    """
    wide = len(task.observation)
    indices, last = np.empty(0, np.intp), np.empty((0, wide), np.float32)
    if batch.final_indices:
        indices = np.frombuffer(batch.final_indices, "<u4").astype(np.intp)
        last = np.frombuffer(bytearray(batch.final_observations), FLOAT).reshape(-1, wide)
    infos = np.frombuffer(batch.infos, FLOAT).reshape(-1, len(task.info))
    return Batch(
        observations=np.frombuffer(bytearray(batch.observations), FLOAT).reshape(-1, wide),
        rewards=np.frombuffer(bytearray(batch.rewards), FLOAT),
        terminated=np.frombuffer(bytearray(batch.terminated), np.bool_),
        truncated=np.frombuffer(bytearray(batch.truncated), np.bool_),
        infos=infos.T.copy(),
        final_indices=indices,
        final_observations=last,
    )
