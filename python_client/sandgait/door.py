"""The interface to environments in this process or over the network.

`Door` is the common interface. `Local` implements it for this process, `session.Session` for the network.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from . import _native
from .arguments import checked
from .batches import Batch, Rollout
from .errors import InvalidRequest, LimitReached
from .options import keyword_error, with_files
from .spaces import Task
from .threads import agreed
from .user_warnings import warn

#: Azimuth and elevation of a camera [°], its distance [m], and whether it follows the robot. None: the default.
Camera = tuple[float | None, float | None, float | None, bool]


class Held(NamedTuple):
    """Closes a session when no other object refers to it any more."""

    close: Callable[[], object]
    #: Sets the longest duration of `close` [s].
    hurry: Callable[[float], None]


class Door(Protocol):
    """Environments of one task, in this process or on one server. The caller must receive each request's answer."""

    num_envs: int
    task: Task

    @property
    def address(self) -> str | None:
        """Address of the server that has the environments; None if they are in this process."""

    @property
    def held(self) -> Held:
        """An object that closes this door without keeping it alive."""

    @property
    def owes(self) -> bool:
        """Is an answer pending, or still kept from the last request?"""

    def send_reset(
        self, seeds: Sequence[int] | None, mask: npt.NDArray[np.bool_] | None, options: Mapping[str, Any]
    ) -> None: ...

    def send_step(self, actions: npt.NDArray[np.float32], held: npt.NDArray[np.bool_] | None) -> None: ...

    def step(self, actions: npt.NDArray[np.float32], held: npt.NDArray[np.bool_] | None) -> Batch:
        """`send_step` and `receive`. After an interrupt `receive` gives the answer."""

    def send_command(self, commands: npt.NDArray[np.float32]) -> None: ...

    def send_restore(self, snapshot: bytes, sources: npt.NDArray[np.integer[Any]] | None) -> None: ...

    def receive(self) -> Batch: ...

    def send_rollout(self, actions: npt.NDArray[np.float32], trajectories: bool) -> None: ...

    def send_policy_rollout(self, onnx: bytes, steps: int, trajectories: bool) -> None: ...

    def receive_rollout(self) -> Rollout: ...

    def save(self) -> bytes: ...

    def render(self, indices: Sequence[int], size: tuple[int, int], ended: bool, camera: Camera) -> bytes: ...

    def observe(self, index: int, ended: bool) -> tuple[str, bytes]: ...


def check_count(num_envs: int) -> None:
    """Refuses a number of environments that no process or server accepts. Servers have a limit of their own."""
    if not 1 <= num_envs <= _native.MOST_ENVIRONMENTS:
        kind = InvalidRequest if num_envs < 1 else LimitReached
        raise kind(f"num_envs: {num_envs} is outside [1, {_native.MOST_ENVIRONMENTS}]")


class Local:
    """Environments in this process."""

    address = None

    def __init__(self, task: str, num_envs: int, options: Mapping[str, Any], threads: int | None) -> None:
        check_count(num_envs)
        number = agreed(threads, _native.threads(), "this process")
        self.num_envs = num_envs
        try:
            self._native = _native.Local(task, num_envs, with_files(options), number)
        except InvalidRequest as error:
            raise keyword_error(str(error)) from None
        warn(self._native.warnings)
        self.task = Task.of(self._native.task)

    @property
    def held(self) -> Held:
        return Held(self._native.close, lambda _: None)

    @property
    def owes(self) -> bool:
        return self._native.owes

    def send_reset(
        self, seeds: Sequence[int] | None, mask: npt.NDArray[np.bool_] | None, options: Mapping[str, Any]
    ) -> None:
        self._native.send_reset(seeds, None if mask is None else mask.tobytes(), options)

    def send_step(self, actions: npt.NDArray[np.float32], held: npt.NDArray[np.bool_] | None) -> None:
        self._native.send_step(actions, None if held is None else held.tobytes())

    def step(self, actions: npt.NDArray[np.float32], held: npt.NDArray[np.bool_] | None) -> Batch:
        return Batch._make(self._native.step(actions, None if held is None else held.tobytes()))

    def send_command(self, commands: npt.NDArray[np.float32]) -> None:
        self._native.send_command(commands)

    def send_restore(self, snapshot: bytes, sources: npt.NDArray[np.integer[Any]] | None) -> None:
        self._native.send_restore(snapshot, None if sources is None else sources.astype(np.uint32).tobytes())

    def receive(self) -> Batch:
        return Batch._make(self._native.receive())

    def send_rollout(self, actions: npt.NDArray[np.float32], trajectories: bool) -> None:
        self._native.send_rollout(actions, trajectories)

    def send_policy_rollout(self, onnx: bytes, steps: int, trajectories: bool) -> None:
        self._native.send_policy_rollout(onnx, steps, trajectories)

    def receive_rollout(self) -> Rollout:
        return Rollout._make(self._native.receive_rollout())

    def save(self) -> bytes:
        return self._native.save()

    def render(self, indices: Sequence[int], size: tuple[int, int], ended: bool, camera: Camera) -> bytes:
        return self._native.render(list(indices), size, ended, camera)

    def observe(self, index: int, ended: bool) -> tuple[str, bytes]:
        return self._native.observe(index, ended)


@checked
def describe(address: str | None = None) -> tuple[str, tuple[Task, ...]]:
    """The version and the tasks of the server at `address`; without an address, those of this package."""
    if address is None:
        version, tasks = _native.describe()
        return version, tuple(Task.of(task) for task in tasks)
    from . import client

    return client.describe(address)
