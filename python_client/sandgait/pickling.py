"""Arguments of an environment, and its pickling and copying.

The pickle of an environment has its constructor's arguments and, after the first reset, a snapshot. When the copy is
used for the first time, it opens a session and restores the snapshot. It then continues bit-identically.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from . import notebook
from .attributes import refusal
from .door import describe
from .errors import OutOfOrder, SandgaitError
from .options import task_id
from .shards import Address, Shards, open_shards
from .snapshots import read_snapshot, write_snapshot
from .spaces import Task
from .view import View


@dataclass(frozen=True)
class Origin:
    """The arguments for opening a session and its view."""

    task: str
    num_envs: int
    address: Address
    resume: bool
    threads: int | None
    isolated: bool
    options: dict[str, Any]
    render_mode: str | None
    render_size: tuple[int, int]
    render_camera: Mapping[str, Any] | None
    clip_actions: bool

    def copies(self, num_envs: int) -> dict[str, Any]:
        """The keywords of a `SandgaitVectorEnv` with `num_envs` environments like these. A window stays with the
        original, and there are at most as many servers as environments."""
        own = {field.name: getattr(self, field.name) for field in fields(self) if field.name != "options"}
        address = self.address if self.address is None or isinstance(self.address, str) else self.address[:num_envs]
        mode = None if self.render_mode == "human" else self.render_mode
        return {**own, "num_envs": num_envs, "address": address, "render_mode": mode, **self.options}

    def open(self) -> tuple[Shards, View]:
        shards = open_shards(
            self.address, self.task, self.num_envs, self.options, self.resume, self.threads, self.isolated
        )
        return shards, View.of(shards, self.render_mode, self.render_size, self.render_camera)


class Pickled:
    """An environment whose session is opened when needed."""

    task: Task
    _origin: Origin
    #: None before the session is opened and after it is closed.
    _opened: tuple[Shards, View] | None
    #: Snapshot from which the session starts; None if it starts without a state.
    _kept: bytes | None
    _shut: bool
    #: Have the environments been reset?
    _seeded: Any
    #: Names of the task's options. Setting an attribute of such a name is refused, because it would have no effect.
    _options: frozenset[str] = frozenset()

    def _begin(self, origin: Origin) -> None:
        self._origin = replace(origin, task=task_id(origin.task))
        self._kept, self._shut = None, False
        self._opened = self._origin.open()
        self.task = self._opened[0].task
        self._options = frozenset(o.name for o in self.task.options)

    def __setattr__(self, name: str, value: Any) -> None:
        if name in self._options:
            raise refusal(self.task, name, value)
        super().__setattr__(name, value)

    @property
    def _session(self) -> Shards:
        return (self._opened or self._open())[0]

    @property
    def _view(self) -> View:
        return (self._opened or self._open())[1]

    def _open(self) -> tuple[Shards, View]:
        if self._shut:
            raise SandgaitError("this environment is closed")
        opened = self._origin.open()
        if self._kept is not None:
            try:
                opened[0].send_restore(read_snapshot(self._kept), None)
                opened[0].receive()
            except BaseException:
                opened[0].close()
                raise
        self._opened, self._kept = opened, None
        return opened

    def _close(self) -> None:
        self._shut = True
        if self._opened is not None:
            shards, view = self._opened
            view.close()
            shards.close()

    def _in_step(self) -> bool:
        """Has the answer of a step not been received yet?"""
        raise NotImplementedError

    def _first_over(self) -> bool:
        """Is the first environment's episode over, and is its last state still the present one?"""
        raise NotImplementedError

    def _asked(self) -> dict[str, Any]:
        """The task options that the user gave."""
        return self._origin.options

    def _repr_html_(self) -> str:
        """The first robot as it stands, the task, and the options that differ from their defaults."""
        task = self.task
        defaults = {o.name: o.default for known in describe()[1] if known.id == task.id for o in known.options}
        about = {"environments": self._origin.num_envs, **notebook.differing(self._asked(), defaults)}
        return notebook.title(task.id) + notebook.paragraph(task.summary) + self._picture() + notebook.facts(about)

    def _picture(self) -> str:
        """A picture of the first robot, or why there is none. It opens no session and waits for no step."""
        if self._shut or self._opened is None:
            return notebook.paragraph(
                f"No picture: the environment is {'closed' if self._shut else 'a copy, not used yet'}."
            )
        if self._in_step():
            return notebook.paragraph("No picture: a step is in flight.")
        try:
            pixels = self._view.pictures([0], self._first_over())[0]
        except SandgaitError as error:
            return notebook.paragraph(f"No picture: {error}.")
        return notebook.picture(pixels, f"the robot of {self.task.id}")

    def __getstate__(self) -> dict[str, Any]:
        if self._in_step():
            raise OutOfOrder("pickle: a step is in flight; take its answer first")
        state = {name: value for name, value in self.__dict__.items() if name != "_opened"}
        if self._opened is not None and np.any(self._seeded):
            state["_kept"] = write_snapshot(self._session.save(), None)
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._opened = None
