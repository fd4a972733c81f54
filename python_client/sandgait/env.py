"""One environment as a `gymnasium.Env`: a session of one."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt

from .errors import InvalidRequest, OutOfOrder
from .shards import open_shards
from .snapshots import FilePath, read_snapshot, write_snapshot
from .spaces import box
from .vector_env import SandgaitVectorEnv
from .view import RENDER_MODES, SIZE, View

Observation = npt.NDArray[np.float32]


class SandgaitEnv(gymnasium.Env[Observation, npt.NDArray[np.float32]]):
    """One environment of `task` on the server at `address` (none: the embedded one).

    For training take `SandgaitVectorEnv`: a step here costs a message there and back as well. `resume`: outlive a
    server that dies, by snapshots. `render_mode`: "rgb_array" for pictures of `render_size` (width, height), "human"
    for the same in a window.
    """

    metadata: dict[str, Any] = {"render_modes": RENDER_MODES}

    def __init__(
        self,
        task: str,
        address: str | None = None,
        render_mode: str | None = None,
        resume: bool = False,
        render_size: tuple[int, int] = SIZE,
        **options: Any,
    ) -> None:
        self._address = address
        self._session = open_shards(address, task, 1, options, resume)
        self.render_mode = render_mode
        self._view = View.of(self._session, render_mode, render_size)
        #: The session's tables: names, units and bounds of every number.
        self.task = self._session.task
        self.metadata = {**self.metadata, "render_fps": self.task.control_rate}
        self.observation_space = box(self.task.observation)
        self.action_space = box(self.task.action)
        self._seeded = False
        self._over = False
        #: First row of the next episode: the server has begun it in the step that ended the last one.
        self._next: Observation | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begins an episode. `options`: task options that may change at a reset; they hold from then on."""
        super().reset(seed=seed)
        first, self._next, self._over = self._next, None, False
        if first is not None and seed is None and not options:
            self._view.moved(record_ended=False, show_ended=False)
            return first, {}
        seeds = None if seed is None else [seed]
        if seed is None and not self._seeded:
            seeds = [int(self.np_random.integers(2**63))]
        self._seeded = True
        self._session.send_reset(seeds, None, options or {})
        observation: Observation = self._session.receive().observations[0]
        self._view.moved(record_ended=False, show_ended=False)
        return observation, {}

    def step(self, action: npt.ArrayLike) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """One control step; `action` is [action] within its bounds."""
        if self._over:
            raise OutOfOrder("step: the episode is over; call reset first")
        row = np.asarray(action, dtype=np.float32)
        if row.shape != self.action_space.shape:
            raise InvalidRequest(f"action: shape {row.shape}, expected {self.action_space.shape}")
        self._session.send_step(row[None])
        batch = self._session.receive()
        observation = batch.observations[0]
        terminated, truncated = bool(batch.terminated[0]), bool(batch.truncated[0])
        if terminated or truncated:
            self._over, self._next = True, observation
            observation = batch.final_observations[0]
        self._view.moved(record_ended=self._over, show_ended=self._over)
        info = dict(zip((c.name for c in self.task.info), batch.infos[:, 0].tolist(), strict=True))
        return observation, float(batch.rewards[0]), terminated, truncated, info

    def render(self) -> npt.NDArray[np.uint8] | None:
        """The robot as it is now: u8 [height, width, 3]; in mode "human" it is shown instead."""
        if self.render_mode is None:
            raise InvalidRequest('render_mode: none was chosen; make the environment with render_mode="rgb_array"')
        if self.render_mode == "human":
            self._view.show(self._over)
            return None
        picture: npt.NDArray[np.uint8] = self._view.pictures([0], self._over)[0]
        return picture

    def record(self, path: FilePath) -> None:
        """Writes every moment from the next reset or step on to the file `path`, until `stop_recording` or `close`."""
        self._view.record(path, 0)

    def stop_recording(self) -> None:
        """Completes the recording; see `sandgait.read_recording` and `sandgait replay`."""
        self._view.stop_recording()

    def save(self, path: FilePath | None = None) -> bytes:
        """The environment as it is, for `restore`; also written to the file `path`, whole or not at all."""
        if self._over:
            raise OutOfOrder("save: the episode is over; call reset first")
        return write_snapshot(self._session.save(), path)

    def restore(self, snapshot: bytes | FilePath) -> Observation:
        """Goes on from a snapshot (bytes or a file), with the same bits; gives the observation."""
        self._session.send_restore(read_snapshot(snapshot), None)
        self._over, self._next, self._seeded = False, None, True
        observation: Observation = self._session.receive().observations[0]
        return observation

    def fork(self, n: int) -> SandgaitVectorEnv:
        """`n` environments as one batch, each in the state of this one; close it when done."""
        snapshot = self.save()
        copies = SandgaitVectorEnv(self.task.id, n, self._address, **self._session.options)
        try:
            copies.restore(snapshot)
        except BaseException:
            copies.close()
            raise
        return copies

    def close(self) -> None:
        """Ends the session; calling it again does nothing."""
        self._view.close()
        self._session.close()
