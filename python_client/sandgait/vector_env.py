"""Many environments as one `gymnasium.vector.VectorEnv`: a batched step is one message there and one back."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from .client import Batch, Session
from .errors import InvalidRequest, OutOfOrder
from .spaces import box

Observations = npt.NDArray[np.float32]
Flags = npt.NDArray[np.bool_]
Step = tuple[Observations, npt.NDArray[np.float64], Flags, Flags, dict[str, Any]]


class SandgaitVectorEnv(VectorEnv[Observations, npt.NDArray[np.float32], npt.NDArray[Any]]):
    """`num_envs` environments of `task` on the server at `address` (none: the embedded one).

    Autoreset is SAME_STEP: where an episode ended, the observation is already the next episode's first, and the old
    one's last row stands in `infos["final_obs"]` and its figures in `infos["final_info"]`.

    To let the learner and the simulation overlap, split a batch over two of these and alternate `send` and `recv`.
    """

    metadata: dict[str, Any] = {"render_modes": [], "autoreset_mode": AutoresetMode.SAME_STEP}

    def __init__(
        self,
        task: str,
        num_envs: int = 1,
        address: str | None = None,
        render_mode: str | None = None,
        **options: Any,
    ) -> None:
        if render_mode is not None:
            raise InvalidRequest(f"render_mode: {render_mode!r} is not offered; leave it out")
        self._session = Session(address, task, num_envs, options)
        self.num_envs = num_envs
        #: The session's tables: names, units and bounds of every number.
        self.task = self._session.task
        self.metadata = {**self.metadata, "render_fps": self.task.control_rate}
        self.single_observation_space = box(self.task.observation)
        self.single_action_space = box(self.task.action)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._keys = tuple((c.name, f"_{c.name}") for c in self.task.info)
        self._seeded = np.zeros(num_envs, dtype=np.bool_)
        self._in_flight = False

    def reset(
        self,
        *,
        seed: int | list[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Observations, dict[str, Any]]:
        """Begins new episodes and drops a step in flight.

        `seed`: an int s gives environment i the seed s + i; a list gives each its own (None: its stream goes on).
        `options`: task options that may change at a reset, and `reset_mask`, bool [num_envs]: which begin anew.
        """
        options = dict(options or {})
        mask = self._mask(options.pop("reset_mask", None))
        seeds = self._seeds(seed, mask)
        goes_on = mask & np.array([s is None for s in seeds])
        anew = mask & ~goes_on
        self._in_flight = False
        if anew.any():
            batch = self._reset([s or 0 for s in seeds], anew, options)
        if goes_on.any():
            batch = self._reset(None, goes_on, options)
        self._seeded |= mask
        return batch.observations, {}

    def _reset(self, seeds: list[int] | None, mask: Flags, options: dict[str, Any]) -> Batch:
        self._session.send_reset(seeds, None if mask.all() else mask, options)
        return self._session.receive()

    def _seeds(self, seed: int | list[int | None] | None, mask: Flags) -> list[int | None]:
        """One seed an environment, None where the stream goes on.

        An environment that never had a seed gets one drawn, so that no two environments or runs are alike.
        """
        seeds: list[int | None]
        if seed is None:
            seeds = [None] * self.num_envs
        elif isinstance(seed, (int, np.integer)):
            super().reset(seed=int(seed))
            seeds = [int(seed) + i for i in range(self.num_envs)]
        else:
            if len(seed) != self.num_envs:
                raise InvalidRequest(f"seed: {len(seed)} entries for {self.num_envs} environments")
            seeds = [None if s is None else int(s) for s in seed]
        for i in np.flatnonzero(mask & ~self._seeded):
            if seeds[i] is None:
                seeds[i] = int(self.np_random.integers(2**63))
        return seeds

    def _mask(self, mask: Any) -> Flags:
        if mask is None:
            return np.ones(self.num_envs, dtype=np.bool_)
        if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_ or mask.shape != (self.num_envs,):
            raise InvalidRequest(f"reset_mask: expected a numpy array of bool [{self.num_envs}], got {mask!r}")
        if not mask.any():
            raise InvalidRequest("reset_mask: at least one entry must be True")
        return mask

    def step(self, actions: npt.ArrayLike) -> Step:
        """One control step of every environment; `actions` is [num_envs, action] within its bounds."""
        self.send(actions)
        return self.recv()

    def send(self, actions: npt.ArrayLike) -> None:
        """Starts a step and returns at once; `recv` waits for it."""
        if self._in_flight:
            raise OutOfOrder("send: a step is in flight already; call recv first")
        rows = np.asarray(actions, dtype=np.float32)
        if rows.shape != self.action_space.shape:
            raise InvalidRequest(f"actions: shape {rows.shape}, expected {self.action_space.shape}")
        self._session.send_step(rows)
        self._in_flight = True

    def recv_batch(self) -> Batch:
        """`recv` as plain columns, without gymnasium's dictionaries."""
        if not self._in_flight:
            raise OutOfOrder("recv: no step is in flight; call send first")
        self._in_flight = False
        return self._session.receive()

    def recv(self) -> Step:
        """Result of the step that `send` started, as `step` returns it."""
        batch = self.recv_batch()
        infos = self._infos(batch)
        return batch.observations, batch.rewards.astype(np.float64), batch.terminated, batch.truncated, infos

    def _infos(self, batch: Batch) -> dict[str, Any]:
        """Reward terms and figures as columns [num_envs] with gymnasium's masks, as SyncVectorEnv groups them."""
        columns, ended = batch.infos, batch.final_indices
        if not ended.size:
            return self._masked(columns, np.ones(self.num_envs, dtype=np.bool_))
        done = batch.terminated | batch.truncated
        final = np.zeros_like(columns)
        final[:, ended] = columns[:, ended]
        columns[:, ended] = 0.0
        last = np.full(self.num_envs, None, dtype=object)
        for i, row in zip(ended, batch.final_observations, strict=True):  # only those that ended
            last[i] = row
        infos = {"final_obs": last, "_final_obs": done, "final_info": self._masked(final, done), "_final_info": done}
        return infos if done.all() else infos | self._masked(columns, ~done)

    def _masked(self, columns: npt.NDArray[np.float32], mask: Flags) -> dict[str, Any]:
        """`{name: column, _name: mask}` of every info column; `columns` is [info, num_envs]."""
        infos: dict[str, Any] = {}
        for (name, mask_name), column in zip(self._keys, columns, strict=True):
            infos[name], infos[mask_name] = column, mask
        return infos

    def close_extras(self, **kwargs: Any) -> None:
        """Ends the session; the environments' memory is freed on the server."""
        self._session.close()
