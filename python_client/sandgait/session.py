"""The door over the network: a session that continues after its connection has broken.

Requests are numbered. When a stream breaks, a new stream asks for the number of the last request that the server has
answered, and sends the later requests again. So no request is lost or carried out twice. With `resume=True` a session
also continues after its server has ended: it takes snapshots, stores every request since the last snapshot, and repeats
these requests on another server.
"""

from __future__ import annotations

import contextlib
import os
import time
import weakref
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from . import client, server
from ._native import Request, Response
from .batches import Batch, Rollout
from .client import Stream
from .door import Camera, Held, check_count
from .errors import SandgaitError, ServerLost, SessionLost
from .spaces import Task

#: Time for which a session tries to reach a server again [s], without and with `resume`: our choice. With `resume` a
#: server may start again meanwhile. The lease is 300 s by default.
RETRY = 2.0
RETRY_RESUME = 60.0

#: Number of requests between two snapshots of a session with `resume=True`: our choice. To repeat them takes a few
#: seconds, and more snapshots would slow the steps.
SNAPSHOT_EVERY = 200


#: Part of the error if a connection broke, or the server forgot the session.
_ADVICE = "with resume=True environments continue after a restart of the server"


class _Link:
    """Resources that a finalizer releases when a session ends. A reference to the session would prevent its end."""

    def __init__(self) -> None:
        self.process = os.getpid()
        self.address = ""
        self.session_id = ""
        self.stream: Stream | None = None
        #: Longest wait of `close` for the server [s]. Without an answer by then the session ends with its lease.
        self.patience = client.CLOSE_TIMEOUT

    def drop(self) -> None:
        """Closes a stream that is broken."""
        if self.stream is not None:
            self.stream.close()
            self.stream = None

    def hurry(self, patience: float) -> None:
        self.patience = patience

    def close(self) -> None:
        if os.getpid() != self.process:
            return  # in a forked child, because the session belongs to the parent
        if self.session_id:
            client.close_session(self.address, self.session_id, self.patience)
        self.drop()


class Session:
    """Environments of one task on one server.

    `addresses`: servers in order of preference. Servers after the first are used only with `resume`. None stands for
    the embedded server of this process.
    """

    def __init__(
        self,
        addresses: Sequence[str | None],
        task: str,
        num_envs: int,
        options: Mapping[str, Any],
        resume: bool = False,
    ) -> None:
        check_count(num_envs)
        self.num_envs = num_envs
        self.options = dict(options)
        self._addresses = list(addresses)
        self._resume = resume
        self._broken: str | None = None
        self._sequence = 0
        #: Requests without an answer, with their numbers, in order.
        self._unanswered: list[Request] = []
        #: The last answer, kept until the next request, so that a caller that was interrupted can take it again.
        self._last: Response | None = None
        #: The last snapshot (empty if there is none), and the requests that were carried out after it.
        self._snapshot = b""
        self._since: list[Request] = []
        self._link = _Link()
        # It runs once: when it is called, when this object is deleted, or when Python ends.
        self.close = weakref.finalize(self, self._link.close)
        self.task = self._create(self._addresses[0], task)

    @property
    def held(self) -> Held:
        """An object that closes this session without keeping it alive."""
        return Held(self.close, self._link.hurry)

    @property
    def address(self) -> str:
        """Address of the server that has the session."""
        return self._link.address

    def _create(self, address: str | None, task: str) -> Task:
        address = server.address() if address is None else address
        created = client.create_session(address, task, self.num_envs, self.options)
        self._link.address, self._link.session_id = address, created.session_id
        self._link.stream = Stream(address, created.session_id)
        return created.task

    def send(self, request: Request, here: bool = False) -> None:
        """Sends a request without waiting for its answer. With `resume` it sometimes takes a snapshot first.

        `here`: next the caller waits for this answer."""
        self._check_usable()
        if self._resume and len(self._since) >= SNAPSHOT_EVERY and request.changes:
            self.save()
        if self._link.stream is None:
            self._reconnect(None)
        self._last = None
        request.sequence = self._sequence = self._sequence + 1
        self._unanswered.append(request)
        try:
            assert self._link.stream is not None
            self._link.stream.send(request, here)
        except BaseException:  # the request may have been sent or not; the next stream sends it again
            self._link.drop()
            raise

    @property
    def owes(self) -> bool:
        """Is an answer pending, or still kept from the last request?"""
        return bool(self._unanswered) or self._last is not None

    def send_reset(
        self, seeds: Sequence[int] | None, mask: npt.NDArray[np.bool_] | None, options: Mapping[str, Any]
    ) -> None:
        self.send(client.reset_request(seeds, mask, options))

    def send_step(self, actions: npt.NDArray[np.float32], held: npt.NDArray[np.bool_] | None) -> None:
        self.send(client.step_request(actions, held))

    def step(self, actions: npt.NDArray[np.float32], held: npt.NDArray[np.bool_] | None) -> Batch:
        self.send(client.step_request(actions, held), here=True)
        return self.receive()

    def send_command(self, commands: npt.NDArray[np.float32]) -> None:
        self.send(Request.set_command(commands))

    def send_restore(self, snapshot: bytes, sources: npt.NDArray[np.integer[Any]] | None) -> None:
        self.send(client.restore_request(snapshot, sources))

    def send_rollout(self, actions: npt.NDArray[np.float32], trajectories: bool) -> None:
        self.send(Request.rollout(actions, trajectories))

    def send_policy_rollout(self, onnx: bytes, steps: int, trajectories: bool) -> None:
        self.send(Request.policy_rollout(onnx, steps, trajectories))

    def receive(self) -> Batch:
        """Answer to the last reset or step. Drops earlier answers that were not received."""
        return client.batch(self._receive())

    def save(self) -> bytes:
        """A snapshot of all environments, for `restore`."""
        self.send(Request.save())
        snapshot = self._receive().snapshot
        self._snapshot, self._since, self._last = snapshot, [], None
        return snapshot

    def render(self, indices: Sequence[int], size: tuple[int, int], ended: bool, camera: Camera) -> bytes:
        """A picture of each environment: u8 [indices, height, width, 3]."""
        self.send(Request.render(list(indices), size, ended, camera))
        return self._receive().pixels

    def observe(self, index: int, ended: bool) -> tuple[str, bytes]:
        """The present state of environment `index`: header and row, in the format of recordings."""
        self.send(Request.observe(index, ended))
        return self._receive().observation

    def receive_rollout(self) -> Rollout:
        """Answer to the last rollout."""
        parts = [self._receive()]
        while parts[-1].is_part:
            parts.append(self._receive())
            if parts[-1].first_step == 0:  # the stream broke, and the rollout starts again
                del parts[:-1]
        return client.rollout(parts, self.num_envs, self.task)

    def _check_usable(self) -> None:
        if os.getpid() != self._link.process:
            raise SandgaitError("this environment belongs to the process that made it; make it anew after a fork")
        if not self.close.alive:
            raise SandgaitError("this environment is closed")
        if self._broken is not None:
            raise SessionLost(f"this session has ended ({self._broken}); make the environment anew")

    def _receive(self) -> Response:
        self._check_usable()
        while True:
            if self._last is not None:
                return self._answered(self._last)
            try:
                if self._link.stream is None:
                    self._reconnect(None)
                assert self._link.stream is not None
                response = self._link.stream.receive()
                if response.sequence >= self._sequence and not response.is_part:
                    self._last = response
            except ServerLost as error:
                self._link.drop()
                self._reconnect(error)
                continue
            except SandgaitError as error:
                self._broken = str(error)
                raise
            if response.sequence >= self._sequence and self._last is None:
                return response  # it is the first part of a rollout, so the answer is not complete

    def _answered(self, response: Response) -> Response:
        error = client.failure(response, self.address)
        answered, self._unanswered = self._unanswered, []
        if self._resume and error is None:
            self._since += [request for request in answered if request.changes]
        if error is not None:
            raise error
        return response

    def _reconnect(self, reason: ServerLost | None) -> None:
        """Attaches to the session again, or makes it again on another server. Raises the error if both fail."""
        deadline = time.monotonic() + (RETRY_RESUME if self._resume else RETRY)
        error: SandgaitError | None = reason
        pause = 0.01
        while True:
            if not server.is_dead(self._link.address):
                try:
                    return self._attach()
                except ServerLost as lost:
                    error = error or lost
                except SessionLost as lost:  # the server runs, but it has no such session
                    if not self._resume:
                        error = SessionLost(f"{self.address}: {lost}; {_ADVICE}")
                        break
                    error = error or lost
            elif not self._resume:
                break
            if self._resume and self._rebuild():
                return
            if time.monotonic() > deadline:
                break
            time.sleep(pause)
            pause = min(2 * pause, 1.0)
        error = error or ServerLost(f"{self.address}: the server cannot be reached")
        advice = "" if self._resume or _ADVICE in str(error) else f"; {_ADVICE}"
        self._broken = f"the connection broke: {error}{advice}"
        raise error

    def _attach(self) -> None:
        """Opens a new stream to the session, and sends the requests without an answer again."""
        stream = Stream(self._link.address, self._link.session_id)
        first = self._unanswered[0].sequence if self._unanswered else self._sequence + 1
        if stream.last_sequence < first - 1:
            # a server that was killed goes on with the sessions that it saved when it was last told to end
            stream.close()
            raise SessionLost(f"the server has an older state of the session: request {stream.last_sequence}")
        self._link.stream = stream
        for request in self._unanswered:
            if request.sequence >= stream.last_sequence:
                stream.send(request)

    def _rebuild(self) -> bool:
        """Makes the session again on the first server that accepts it, restores the last snapshot, and repeats all
        requests after it."""
        for address in self._addresses:
            with contextlib.suppress(ServerLost, SessionLost):
                self._create(address, self.task.id)
                self._play_again()
                return True
            self._link.drop()
        return False

    def _play_again(self) -> None:
        stream = self._link.stream
        assert stream is not None
        past = ([client.restore_request(self._snapshot, None)] if self._snapshot else []) + self._since
        for number, request in enumerate(past + self._unanswered, start=1):
            request.sequence = number
        self._sequence = len(past) + len(self._unanswered)
        for request in past:  # one by one, so that few requests wait in this process's memory
            stream.send(request)
            error = client.failure(stream.receive(), self.address)
            if error is not None:
                raise SandgaitError(f"the session cannot be made anew: {error}")
        for request in self._unanswered:
            stream.send(request)
