"""One batch of environments, in this process or divided over several servers. The results are the same in all cases.

A place is this process or one of the servers. It has consecutive environments of the batch. All servers simulate at the
same time.
"""

from __future__ import annotations

import itertools
import threading
import time
import weakref
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from .batches import Batch, Rollout
from .door import Camera, Door, Held, Local
from .errors import InvalidRequest
from .spaces import check_seed

#: The place of environments: None for this process, or the address of one or several servers. In a list None stands for
#: this process, too.
Address = str | Sequence[str | None] | None

#: Longest wait for servers to confirm that sessions are closed [s]: our choice, as for one session.
CLOSE_TIMEOUT = 2.0

#: Longest wait for each remaining door after others have used up that time [s]: our choice, enough for a server that
#: runs.
LEAST_PATIENCE = 0.05

#: Deadline for closing sessions at the end of Python; None before this closing has begun.
_last_call: float | None = None


class Shards:
    """`num_envs` environments, divided evenly over the places. `open_door(k, envs)` opens the session of place k."""

    def __init__(self, places: int, num_envs: int, open_door: Callable[[int, int], Door]) -> None:
        if not 1 <= places <= max(num_envs, 1):
            raise InvalidRequest(f"address: {places} servers are more than the {num_envs} environments")
        self.num_envs = num_envs
        self._doors: list[Door] = []
        cuts = [num_envs * k // places for k in range(places + 1)]
        self._slices = [slice(a, b) for a, b in itertools.pairwise(cuts)]
        held: list[Held] = []
        try:
            for k, part in enumerate(self._slices):
                door = open_door(k, part.stop - part.start)
                self._doors.append(door)
                held.append(door.held)
        except BaseException:
            close_all(held)
            raise
        # It runs once: when it is called, when this object is deleted, or when Python ends. At the end of Python it
        # runs before the finalizers of the doors, because they were made earlier.
        self.close = weakref.finalize(self, close_all, held)
        self.task = self._doors[0].task

    @property
    def addresses(self) -> list[str | None]:
        """Addresses of the servers that have the environments at present; None for this process."""
        return [door.address for door in self._doors]

    def send_reset(
        self, seeds: Sequence[int] | None, mask: npt.NDArray[np.bool_] | None, options: Mapping[str, Any]
    ) -> None:
        """Asks for a reset. `seeds` and `mask` have one entry for each environment. Without seeds the random streams
        continue."""
        for i, seed in enumerate(seeds or ()):
            check_seed(seed, f"seed[{i}]")
        for door, part in zip(self._doors, self._slices, strict=True):
            chosen = None if mask is None else mask[part]
            door.send_reset(None if seeds is None else seeds[part], chosen, options)

    def send_step(self, actions: npt.NDArray[np.float32], held: npt.NDArray[np.bool_] | None = None) -> None:
        """Asks for a step. `actions` is f32 [num_envs, action]; environments in `held` [num_envs] keep their state.
        Each place checks the actions' bounds. With several places this function checks them first; else one place
        might refuse its actions while the others make the step."""
        if len(self._doors) == 1:
            self._doors[0].send_step(actions, held)
            return
        self._check(actions)
        for door, part in zip(self._doors, self._slices, strict=True):
            door.send_step(actions[part], None if held is None else held[part])

    def step(self, actions: npt.NDArray[np.float32], held: npt.NDArray[np.bool_] | None = None) -> Batch:
        """`send_step` and `receive`, in less time: this thread may compute a part of the step. After an interrupt
        `receive` gives the answer."""
        if len(self._doors) == 1:
            return self._doors[0].step(actions, held)
        self.send_step(actions, held)
        return self.receive()

    def send_command(self, commands: npt.NDArray[np.float32]) -> None:
        """Asks for new commands, f32 [num_envs, 3], in the present episodes."""
        for door, part in zip(self._doors, self._slices, strict=True):
            door.send_command(commands[part])

    def _check(self, actions: npt.NDArray[np.float32]) -> None:
        low, high = (np.array([getattr(c, end) for c in self.task.action]) for end in ("low", "high"))
        wrong = np.argwhere(~((low <= actions) & (actions <= high)))  # NaN is refused too
        if wrong.size:
            i, k = wrong[0]
            column = self.task.action[k]
            range_ = f"[{column.low:g}, {column.high:g}]"
            raise InvalidRequest(f"actions[{i}][{k}]: {actions[i, k]:g} ({column.name}) is outside {range_}")

    def receive(self) -> Batch:
        """Answer to the last request."""
        if len(self._doors) == 1:
            return self._doors[0].receive()
        batches: list[Batch] = self._all("receive")
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
        """Is an answer pending, or still kept from the last request?"""
        return any(door.owes for door in self._doors)

    def save(self) -> list[bytes]:
        """A snapshot of all environments, with one part for each place."""
        return [door.save() for door in self._doors]

    def save_with(self, index: int) -> tuple[bytes, int]:
        """A snapshot of the place that has environment `index`, and the environment's number at this place."""
        parts = zip(self._doors, self._slices, strict=True)
        door, part = next((door, part) for door, part in parts if part.start <= index < part.stop)
        return door.save(), index - part.start

    def send_restore(self, snapshots: Sequence[bytes], sources: npt.NDArray[np.integer[Any]] | None) -> None:
        """Environment i gets the state of the snapshot's environment `sources[i]`. Without `sources` it gets that of
        environment i modulo n, if the snapshot has n environments. A snapshot of several places can only be restored
        on the same number of places."""
        if len(snapshots) > 1 and sources is not None:
            raise InvalidRequest(
                f"indices: this snapshot is of {len(snapshots)} servers and can only be restored whole"
            )
        if len(snapshots) not in (1, len(self._doors)):
            raise InvalidRequest(f"snapshot: it is of {len(snapshots)} servers, but this batch has {len(self._doors)}")
        if len(snapshots) == 1 and sources is None and len(self._doors) > 1:
            sources = np.arange(self.num_envs)
        for k, (door, part) in enumerate(zip(self._doors, self._slices, strict=True)):
            door.send_restore(snapshots[k % len(snapshots)], None if sources is None else sources[part])

    def rollout(self, actions: npt.NDArray[np.float32], trajectories: bool) -> Rollout:
        """Runs `actions`, f32 [steps, num_envs, action], from the present states, and then restores these states."""
        expected = (self.num_envs, len(self.task.action))
        if actions.ndim != 3 or actions.shape[1:] != expected or not len(actions):
            raise InvalidRequest(f"actions: shape {actions.shape}, expected [steps, {expected[0]}, {expected[1]}]")
        for door, part in zip(self._doors, self._slices, strict=True):
            door.send_rollout(actions[:, part], trajectories)
        return self._rollout()

    def rollout_policy(self, onnx: bytes, steps: int, trajectories: bool) -> Rollout:
        """Runs a network for `steps` from the present states, and then restores these states."""
        for door in self._doors:
            door.send_policy_rollout(onnx, steps, trajectories)
        return self._rollout()

    def _rollout(self) -> Rollout:
        """Answer to the last rollout."""
        if len(self._doors) == 1:
            return self._doors[0].receive_rollout()  # no copy, because the answer can have megabytes
        parts: list[Rollout] = self._all("receive_rollout")
        ends = [np.concatenate(column) for column in zip(*(p[:4] for p in parts), strict=True)]
        rows = [np.concatenate(column, axis=1) for column in zip(*(p[4:] for p in parts), strict=True)]
        return Rollout(*ends, *rows)

    def render(self, indices: Sequence[int], size: tuple[int, int], ended: bool, camera: Camera) -> bytes:
        """A picture of each environment: u8 [indices, height, width, 3]. `indices` must be in ascending order."""
        parts = zip(self._doors, self._slices, strict=True)
        chosen = [(door, [i - part.start for i in indices if part.start <= i < part.stop]) for door, part in parts]
        return b"".join(door.render(own, size, ended, camera) for door, own in chosen if own)

    def observe(self, index: int, ended: bool) -> tuple[str, bytes]:
        """The present state of environment `index`: header and row, in the format of recordings."""
        parts = zip(self._doors, self._slices, strict=True)
        door, part = next((door, part) for door, part in parts if part.start <= index < part.stop)
        return door.observe(index - part.start, ended)

    def _all(self, receive: str) -> list[Any]:
        """The answers of all doors. A refusal is raised after all have answered, so that all doors are at the same
        step."""
        answers, errors = [], []
        for door in self._doors:
            try:
                answers.append(getattr(door, receive)())
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
    isolated: bool = False,
) -> Shards:
    """Environments on the servers of `address`. Without an address they are in this process or, if `isolated`, on its
    embedded server. `threads`: number of simulating threads of this process or of the embedded server."""
    addresses = [address] if address is None or isinstance(address, str) else list(address)
    if not addresses:
        raise InvalidRequest("address: the list is empty; None stands for this process")
    if threads is not None and None not in addresses:
        raise InvalidRequest("threads: it applies to this process; the server at an address was started with its own")
    if isolated and None not in addresses:
        raise InvalidRequest("isolated: it starts a server, but these environments have an address already")

    def open_door(k: int, envs: int) -> Door:
        if addresses[k] is None and not isolated:
            return Local(task, envs, options, threads)
        from . import server
        from .session import Session

        server.ask_for_threads(threads)
        places = [a for a in (*addresses[k:], *addresses[:k]) if a is not None or isolated]
        return Session(places, task, envs, options, resume)

    return Shards(len(addresses), num_envs, open_door)


def close_all(all: Sequence[Held]) -> None:
    """Closes sessions in parallel, so that the wait for many servers that do not answer is as long as for one.

    At the end of Python no thread can be started. Sessions are then closed one after the other within a common time
    limit.
    """
    if threading.main_thread().is_alive():
        deadline = time.monotonic() + CLOSE_TIMEOUT
        threads = [threading.Thread(target=held.close, daemon=True) for held in all[1:]]
        for thread in threads:
            thread.start()
        for held in all[:1]:
            held.close()
        for thread in threads:
            thread.join(max(0.0, deadline + 1.0 - time.monotonic()))
        return
    global _last_call
    _last_call = _last_call or time.monotonic() + CLOSE_TIMEOUT
    for held in all:
        held.hurry(max(LEAST_PATIENCE, _last_call - time.monotonic()))
        held.close()
