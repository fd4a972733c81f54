"""One batch of environments over several servers: the same interface as a `Session`, and the same numbers.

Environments are numbered through; server k has a run of them. Every server simulates while the others do.
"""

from __future__ import annotations

import itertools
import weakref
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from . import client, server
from .client import Batch
from .errors import InvalidRequest
from .session import Held, Rollout, Session, close_all

#: Where environments are simulated: one server, several, or the embedded one.
Address = str | Sequence[str] | None


class Shards:
    """`num_envs` environments, spread evenly over `addresses`.

    With `resume` the environments of a server that died go on at the others.
    """

    def __init__(
        self,
        addresses: Sequence[str | None],
        task: str,
        num_envs: int,
        options: Mapping[str, Any],
        resume: bool = False,
    ) -> None:
        if not 1 <= len(addresses) <= max(num_envs, 1):
            raise InvalidRequest(f"address: {len(addresses)} servers for {num_envs} environments")
        self.num_envs = num_envs
        self._sessions: list[Session] = []
        cuts = [num_envs * k // len(addresses) for k in range(len(addresses) + 1)]
        self._slices = [slice(a, b) for a, b in itertools.pairwise(cuts)]
        held: list[Held] = []
        try:
            for k, part in enumerate(self._slices):
                places = [*addresses[k:], *addresses[:k]]
                session = Session(places, task, part.stop - part.start, options, resume)
                self._sessions.append(session)
                held.append(session.held)
        except BaseException:
            close_all(held)
            raise
        # Runs once: when called, when this object is collected, or when Python ends; before those of the sessions,
        # which were made earlier.
        self.close = weakref.finalize(self, close_all, held)
        self.task = self._sessions[0].task
        self.options = dict(options)

    @property
    def addresses(self) -> list[str]:
        """Of the servers that have the environments now."""
        return [s.address for s in self._sessions]

    def send_reset(
        self, seeds: Sequence[int] | None, mask: npt.NDArray[np.bool_] | None, options: Mapping[str, Any]
    ) -> None:
        """Asks for a reset. `seeds` and `mask` have one entry an environment; without seeds streams go on."""
        for session, part in zip(self._sessions, self._slices, strict=True):
            chosen = None if mask is None else mask[part]
            session.send(client.reset_request(None if seeds is None else seeds[part], chosen, options))

    def send_step(self, actions: npt.NDArray[np.float32], held: npt.NDArray[np.bool_] | None = None) -> None:
        """Asks for a step; `actions` is f32 [num_envs, action], `held` [num_envs] says which environments stay as they
        are. Bounds are checked by the server, and here if one server's refusal would leave the others a step ahead."""
        if len(self._sessions) > 1:
            self._check(actions)
        for session, part in zip(self._sessions, self._slices, strict=True):
            session.send(client.step_request(actions[part], None if held is None else held[part]))

    def _check(self, actions: npt.NDArray[np.float32]) -> None:
        low, high = (np.array([getattr(c, end) for c in self.task.action]) for end in ("low", "high"))
        wrong = np.argwhere(~((low <= actions) & (actions <= high)))  # not a number is wrong too
        if wrong.size:
            i, k = wrong[0]
            column = self.task.action[k]
            range_ = f"[{column.low:g}, {column.high:g}]"
            raise InvalidRequest(f"actions[{i}][{k}]: {actions[i, k]:g} ({column.name}) is outside {range_}")

    def receive(self) -> Batch:
        """Answer to what was sent last."""
        if len(self._sessions) == 1:
            return self._sessions[0].receive()
        batches: list[Batch] = self._all(Session.receive)
        indices = [b.final_indices + part.start for b, part in zip(batches, self._slices, strict=True)]
        return Batch(
            observations=np.concatenate([b.observations for b in batches]),
            rewards=np.concatenate([b.rewards for b in batches]),
            terminated=np.concatenate([b.terminated for b in batches]),
            truncated=np.concatenate([b.truncated for b in batches]),
            infos=np.concatenate([b.infos for b in batches], axis=1),
            final_indices=np.concatenate(indices),
            final_observations=np.concatenate([b.final_observations for b in batches]),
        )

    @property
    def owes(self) -> bool:
        """Is there an answer that nobody has taken, or that may be taken again?"""
        return any(s.owes for s in self._sessions)

    def save(self) -> list[bytes]:
        """All environments as data, one snapshot a server."""
        return [s.save() for s in self._sessions]

    def send_restore(self, snapshots: Sequence[bytes], sources: npt.NDArray[np.integer[Any]] | None) -> None:
        """Environments go on as saved ones; see `Session`. Several snapshots need as many servers as saved them."""
        if len(snapshots) not in (1, len(self._sessions)) or (len(snapshots) > 1 and sources is not None):
            raise InvalidRequest(f"snapshot: of {len(snapshots)} servers, for {len(self._sessions)}")
        if len(snapshots) == 1 and sources is None and len(self._sessions) > 1:
            sources = np.arange(self.num_envs)
        for k, (session, part) in enumerate(zip(self._sessions, self._slices, strict=True)):
            snapshot = snapshots[k % len(snapshots)]
            session.send(client.restore_request(snapshot, None if sources is None else sources[part]))

    def rollout(self, actions: npt.NDArray[np.float32], trajectories: bool) -> Rollout:
        """Runs `actions`, f32 [steps, num_envs, action], from where the environments are, and puts them back."""
        expected = (self.num_envs, len(self.task.action))
        if actions.ndim != 3 or actions.shape[1:] != expected or not len(actions):
            raise InvalidRequest(f"actions: shape {actions.shape}, expected [steps, {expected[0]}, {expected[1]}]")
        for session, part in zip(self._sessions, self._slices, strict=True):
            session.send(client.rollout_request(actions[:, part], trajectories))
        return self._rollout()

    def rollout_policy(self, onnx: bytes, steps: int, trajectories: bool) -> Rollout:
        """Runs a network for `steps` and puts the environments back."""
        for session in self._sessions:
            session.send(client.policy_rollout_request(onnx, steps, trajectories))
        return self._rollout()

    def _rollout(self) -> Rollout:
        """Answer to the rollout that was sent last."""
        if len(self._sessions) == 1:
            return self._sessions[0].receive_rollout()  # megabytes: no copy to join one part
        parts: list[Rollout] = self._all(Session.receive_rollout)
        ends = [np.concatenate(column) for column in zip(*(p[:4] for p in parts), strict=True)]
        rows = [np.concatenate(column, axis=1) for column in zip(*(p[4:] for p in parts), strict=True)]
        return Rollout(*ends, *rows)

    def render(self, indices: Sequence[int], width: int, height: int, ended: bool) -> bytes:
        """A picture of each environment: u8 [indices, height, width, 3]. `indices` ascend."""
        parts = zip(self._sessions, self._slices, strict=True)
        chosen = [(s, [i - part.start for i in indices if part.start <= i < part.stop]) for s, part in parts]
        return b"".join(session.render(own, width, height, ended) for session, own in chosen if own)

    def observe(self, index: int, ended: bool) -> tuple[str, bytes]:
        """Header and row of environment `index`'s moment, as recordings hold them."""
        parts = zip(self._sessions, self._slices, strict=True)
        session, part = next((s, part) for s, part in parts if part.start <= index < part.stop)
        return session.observe(index - part.start, ended)

    def _all(self, receive: Callable[[Session], Any]) -> list[Any]:
        """Every session's answer. A refusal of one is raised when all have answered, so that none lags behind."""
        answers, errors = [], []
        for session in self._sessions:
            try:
                answers.append(receive(session))
            except InvalidRequest as error:
                errors.append(error)
        if errors:
            raise errors[0]
        return answers


def open_shards(
    address: Address,
    task: str,
    num_envs: int,
    options: Mapping[str, Any],
    resume: bool,
    threads: int | None = None,
) -> Shards:
    """Environments at `address`, which may be several. `threads`: of the embedded server."""
    addresses = [address] if address is None or isinstance(address, str) else list(address)
    if threads is not None and None not in addresses:
        raise InvalidRequest("threads: of the embedded server; one that has an address was started with its own")
    server.ask_for_threads(threads)
    return Shards(addresses, task, num_envs, options, resume)
