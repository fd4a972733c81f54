"""Many environments as one `gymnasium.vector.VectorEnv`. A step of all environments takes one message in each
direction."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from .arguments import checked, numbers
from .attributes import refusal
from .batches import Batch, Rollout
from .errors import InvalidRequest, OutOfOrder, SandgaitError, UnknownAttribute, unknown
from .pickling import Origin, Pickled
from .policies import read_policy
from .shards import Address, Shards
from .snapshots import FilePath, read_snapshot, write_snapshot
from .spaces import Actions, box, check_seed, commands, info_columns, privileged
from .view import RENDER_MODES, SIZE

Observations = npt.NDArray[np.float32]
Flags = npt.NDArray[np.bool_]
Step = tuple[Observations, npt.NDArray[np.float64], Flags, Flags, dict[str, Any]]


@dataclass(slots=True)
class _Turn:
    """The state of the present step."""

    #: The environments whose episode has ended and whose next episode has not begun. With NEXT_STEP their next step
    #: begins it, with DISABLED only a reset does. With SAME_STEP there are no such environments.
    ended: Flags
    in_flight: bool = False
    #: The answer of the step in flight, once it has come.
    batch: Batch | None = None
    #: With DISABLED, while environments in `ended` wait for their reset: the last rows of all environments, and the
    #: rows with which the server has begun the next episodes of those in `ended`.
    lasts: Observations | None = None
    firsts: Observations | None = None
    #: With option `privileged`: the exact sensor values for `firsts`.
    exact: Observations | None = None


class SandgaitVectorEnv(Pickled, VectorEnv[Observations, npt.NDArray[np.float32], npt.NDArray[Any]]):
    """`num_envs` environments of `task` in this process or on the server at `address`. If `address` is a list, the
    environments are divided over its servers.

    `resume`: continue from a snapshot when a server has ended. The environments continue when the server runs again, or
    at the next address of the list.

    `autoreset_mode`: with NEXT_STEP, gymnasium's default, the step that ends an episode returns its last observation.
    The next step ignores that environment's action and returns the first observation of the new episode. With SAME_STEP
    the step that ends an episode returns the first observation of the new one; `infos["final_obs"]` has the last
    observation of the old one, and `infos["final_info"]` its figures. With DISABLED an environment whose episode has
    ended must be reset before the next step: `reset(options={"reset_mask": terminated | truncated})`.

    `clip_actions`: clip actions to their bounds; by default an action outside of its bounds is refused. `threads`:
    number of simulating threads of this process; only the first environment of the process can set it. `isolated`:
    without an address, use a separate server process, so that a crash of the simulation does not end this process.

    `render_mode`: "rgb_array" makes a picture of each environment, of `render_size` (width, height) [px]. "human" shows
    the first four environments in a window. `render_camera` places the camera, for example
    `{"azimuth_deg": 90, "elevation_deg": 20, "distance": 2.0, "follow": False}`: the angles about the vertical from the
    x axis to the camera (0: ahead, 90: on the left) and above the horizon [°], the distance [m], and whether the camera
    looks at the robot or at the world's origin. Entries that are left out have their defaults: the camera is beside the
    robot, at a distance that fits the robot's size, and follows it.

    A pickle or copy of environments that were reset includes their states (module `pickling`).

    If two objects of this class each have half of the environments, and calls of `send` and `recv` alternate between
    them, the learner computes while the other half is simulated.
    """

    metadata: dict[str, Any] = {"render_modes": RENDER_MODES, "autoreset_mode": AutoresetMode.NEXT_STEP}

    @checked
    def __init__(
        self,
        task: str,
        num_envs: int = 1,
        address: Address = None,
        render_mode: str | None = None,
        resume: bool = False,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_size: tuple[int, int] = SIZE,
        render_camera: Mapping[str, Any] | None = None,
        clip_actions: bool = False,
        threads: int | None = None,
        isolated: bool = False,
        **options: Any,
    ) -> None:
        mode = _autoreset(autoreset_mode)
        view = render_mode, render_size, render_camera
        self._begin(Origin(task, num_envs, address, resume, threads, isolated, options, *view, clip_actions))
        self.render_mode = render_mode
        self.num_envs = num_envs
        self.metadata = {**self.metadata, "render_fps": self.task.control_rate, "autoreset_mode": mode}
        self.single_observation_space = box(self.task.observation)
        self.single_action_space = box(self.task.action)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._actions = Actions(self.action_space, "actions", clip_actions)
        self._columns, self.privileged_observation_space = info_columns(self.task.info)
        self._info_names = [*self._columns, *(f"_{name}" for name in self._columns)]
        self._autoreset = mode
        self._seeded = np.zeros(num_envs, dtype=np.bool_)
        self._turn = _Turn(np.zeros(num_envs, dtype=np.bool_))
        self._everybody = np.ones(num_envs, dtype=np.bool_)
        self._nobody = np.zeros(num_envs, dtype=np.bool_)

    @property
    def autoreset_mode(self) -> AutoresetMode:
        """The same as `metadata["autoreset_mode"]`."""
        return self._autoreset

    @checked
    def reset(
        self,
        *,
        seed: int | list[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Observations, dict[str, Any]]:
        """Begins new episodes and drops the answer of a step in flight.

        `seed`: if it is an int s, environment i has the seed s + i. If it is a list, entry i is the seed of environment
        i, and with entry None its random stream continues. `options`: new values of task options, and `reset_mask`,
        bool [num_envs], which says which environments to reset. The returned infos have the columns of a step's infos,
        which are 0, because these environments have not made a step yet. With option `privileged=True`,
        `infos["privileged"]` has the exact values of all sensors, float32 [num_envs, values].
        """
        options = dict(options or {})
        mask = self._mask(options.pop("reset_mask", None))
        seeds = self._seeds(seed, mask)
        goes_on = mask & np.array([s is None for s in seeds])
        anew = mask & ~goes_on
        if self._turn.in_flight:
            with contextlib.suppress(InvalidRequest, OutOfOrder):
                self.recv()  # episodes of environments that are not reset may have ended in this step
        # As in `SandgaitEnv`: an episode that the server has begun already is taken, unless the caller wants another.
        begun = goes_on & self._turn.ended if self._turn.firsts is not None and not options else np.zeros_like(mask)
        goes_on &= ~begun
        batch: Batch | None = None
        if anew.any():
            batch = self._reset([s or 0 for s in seeds], anew, options)
        if goes_on.any():
            batch = self._reset(None, goes_on, options)
        observations = self._after_reset(None if batch is None else batch.observations, mask, begun)
        self._seeded |= mask
        self._turn.ended = self._turn.ended & ~mask
        self._view.moved(record_ended=not begun[self._view.index], show_ended=False)
        count = len(self.task.info)
        columns = np.zeros((count, self.num_envs), np.float32) if batch is None else batch.infos
        infos = self._masked(np.where(mask, columns, np.float32(0.0)), mask)
        if self._turn.exact is not None:
            infos["privileged"][begun] = self._turn.exact[begun]
        return observations, infos

    def _after_reset(self, rows: Observations | None, mask: Flags, begun: Flags) -> Observations:
        """Observations after a reset of `mask`. `rows`: the server's, or None if it was not asked. Environments that
        wait for their reset keep their last observation."""
        turn = self._turn
        if turn.lasts is None or turn.firsts is None:
            assert rows is not None
            return rows
        if rows is None:
            rows = turn.lasts.copy()
        waiting = turn.ended & ~mask
        rows[begun], rows[waiting] = turn.firsts[begun], turn.lasts[waiting]
        if waiting.any():
            turn.lasts = rows.copy()
        else:
            turn.lasts = turn.firsts = None
        return rows

    def _reset(self, seeds: list[int] | None, mask: Flags, options: dict[str, Any]) -> Batch:
        self._session.send_reset(seeds, None if mask.all() else mask, options)
        return self._session.receive()

    def _seeds(self, seed: int | list[int | None] | None, mask: Flags) -> list[int | None]:
        """The seed of each environment, or None if its random stream continues.

        An environment that never had a seed gets a random one, so that environments and runs differ.
        """
        seeds: list[int | None]
        if seed is None:
            seeds = [None] * self.num_envs
        elif isinstance(seed, (int, np.integer)):
            check_seed(seed)
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
        """Makes one control step of every environment. `actions` is [num_envs, action] within the bounds."""
        session, turn, rows, held = self._next_step(actions)
        try:
            turn.in_flight, turn.batch = True, None
            turn.batch = session.step(rows, held)
        except BaseException as error:
            raise self._failed(error) from None
        return self.recv()

    def send(self, actions: npt.ArrayLike) -> None:
        """Starts a step and returns at once; `recv` waits for the result."""
        session, turn, rows, held = self._next_step(actions)
        try:
            turn.in_flight, turn.batch = True, None
            session.send_step(rows, held)
        except BaseException as error:
            raise self._failed(error) from None

    def _next_step(self, actions: npt.ArrayLike) -> tuple[Shards, _Turn, npt.NDArray[np.float32], Flags | None]:
        """Checks that a step may begin now. Returns the session, the turn, the actions, and the environments that do
        not step."""
        turn = self._turn
        if turn.in_flight:
            raise OutOfOrder("send: a step is in flight already; call recv first")
        rows = self._actions.rows(actions)
        held = turn.ended if turn.ended is not self._nobody and turn.ended.any() else None
        if held is not None and self._autoreset is AutoresetMode.DISABLED:
            raise OutOfOrder(
                f"step: environment {held.argmax()} has ended its episode; first reset those that have ended: "
                'reset(options={"reset_mask": terminated | truncated})'
            )
        if held is not None:
            rows = np.where(held[:, None], np.float32(0.0), rows)  # held environments ignore their actions
        return self._session, turn, rows, held

    def _failed(self, error: BaseException) -> BaseException:
        """What to raise after a step has failed or was interrupted."""
        self._turn.in_flight = self._session.owes and not isinstance(error, SandgaitError)
        return self._actions.explain(error)

    def recv_batch(self) -> Batch:
        """The result of `recv` as arrays, always in the mode SAME_STEP and without gymnasium's dictionaries."""
        batch = self._receive()
        self._turn.in_flight, self._turn.batch = False, None
        return batch

    def _receive(self) -> Batch:
        """The answer of the step in flight. The caller marks the step as done, so that after an interrupt at any point
        the answer can be taken again."""
        turn = self._turn
        if not turn.in_flight:
            raise OutOfOrder("recv: no step is in flight; call send first")
        if turn.batch is None:
            try:
                turn.batch = self._session.receive()
            except SandgaitError as error:
                turn.in_flight = False
                raise self._actions.explain(error) from None
        self._view.moved(record_ended=True, show_ended=self._autoreset is not AutoresetMode.SAME_STEP)
        return turn.batch

    def recv(self) -> Step:
        """The result of the step that `send` started; the same as that of `step`."""
        batch = self._receive()
        turn = self._turn
        ended, rows = turn.ended, batch.observations
        lasts = firsts = exact = None
        if self._autoreset is AutoresetMode.SAME_STEP:
            infos = self._infos(batch)
        else:
            infos = self._masked(batch.infos, self._everybody.copy())
            ended = self._nobody
            if batch.final_indices.size:
                ended = batch.terminated | batch.truncated
                if self._autoreset is AutoresetMode.DISABLED:
                    firsts, rows = rows, rows.copy()
                    if self.privileged_observation_space is not None:
                        exact = privileged(batch.infos, self._columns, ended)
                rows[batch.final_indices] = batch.final_observations
                lasts = None if firsts is None else rows.copy()
        result = rows, batch.rewards.astype(np.float64), batch.terminated, batch.truncated, infos
        turn.ended, turn.lasts, turn.firsts, turn.exact = ended, lasts, firsts, exact
        turn.in_flight, turn.batch = False, None
        return result

    def _infos(self, batch: Batch) -> dict[str, Any]:
        """Reward terms and figures as columns [num_envs] with gymnasium's masks, grouped like those of SyncVectorEnv.

        If an environment's episode ended, its values of this step are in `final_info`. The columns then have the values
        of the next episode's reset for it: 0, and the exact values of sensors. The others have 0 in `final_info`.
        """
        columns, ended = batch.infos, batch.final_indices
        if not ended.size:
            return self._masked(columns, self._everybody.copy())
        done = batch.terminated | batch.truncated
        last = np.full(self.num_envs, None, dtype=object)
        for i, row in zip(ended, batch.final_observations, strict=True):  # only those that ended
            last[i] = row
        final = self._masked(np.where(done, columns, np.float32(0.0)), done)
        infos = {"final_obs": last, "_final_obs": done, "final_info": final, "_final_info": done}
        infos |= self._masked(np.where(done, np.float32(0.0), columns), self._everybody.copy())
        if self.privileged_observation_space is not None:
            infos["privileged"] = privileged(columns, self._columns, done)
        return infos

    def _masked(self, columns: npt.NDArray[np.float32], mask: Flags) -> dict[str, Any]:
        """`{name: column, _name: mask}` of every info column; `columns` is [info, num_envs]."""
        infos: dict[str, Any] = dict.fromkeys(self._info_names, mask)
        # A plain loop takes half the time of `update`.
        for name, column in zip(self._columns, columns, strict=False):
            infos[name] = column
        if self.privileged_observation_space is not None:
            infos["privileged"], infos["_privileged"] = privileged(columns, self._columns), mask
        return infos

    def set_command(self, command: npt.ArrayLike) -> Observations:
        """Replaces the commanded velocity for the rest of the present episodes. Returns the observations with the new
        commands; if a sensor is delayed, the observations show them one step later.

        `command` is [3] for all environments or [num_envs, 3]: forward, to the left [m/s], yaw rate [rad/s]. If the
        episode of an environment has ended, its command is that of the next episode, which has already begun.
        """
        self._require_rest("set_command")
        rows = commands(command, self.num_envs)
        self._session.send_command(rows)
        observations = self._session.receive().observations
        if self._turn.firsts is not None:
            self._turn.firsts = observations.copy()
        return observations

    @checked
    def save(self, path: FilePath | None = None) -> bytes:
        """Takes a snapshot of all environments, for `restore`. With `path` also writes it to a file, completely or not
        at all.

        After a restore the environments continue bit-identically, on servers of the same version and instruction
        set.
        """
        self._require_rest("save")
        return write_snapshot(self._session.save(), path)

    @checked
    def restore(self, snapshot: bytes | FilePath, indices: npt.ArrayLike | None = None) -> Observations:
        """Sets environment i to the state of environment `indices[i]` of a snapshot (bytes or a file). Returns the
        observations.

        Without `indices` environment i gets the state of environment i modulo n, if the snapshot has n environments. So
        a snapshot of one environment sets all environments.
        """
        sources = None if indices is None else np.asarray(indices)
        if sources is not None and (sources.shape != (self.num_envs,) or sources.dtype.kind not in "iu"):
            raise InvalidRequest(f"indices: expected whole numbers [{self.num_envs}], got {indices!r}")
        if sources is not None and sources.min() < 0:
            raise InvalidRequest(f"indices: {sources.min()} is below 0")
        self._turn.in_flight, self._turn.lasts, self._turn.firsts = False, None, None
        self._session.send_restore(read_snapshot(snapshot), sources)
        self._seeded[:], self._turn.ended = True, self._nobody
        return self._session.receive().observations

    @checked
    def fork(self, n: int, index: int = 0) -> SandgaitVectorEnv:
        """`n` new environments with the keywords of this one, each in the state of its environment `index`. The caller
        must close them."""
        if not 0 <= index < self.num_envs:
            raise InvalidRequest(f"index: {index} is outside [0, {self.num_envs})")
        self._require_rest("fork")
        snapshot, place = self._session.save_with(index)
        copies = SandgaitVectorEnv(autoreset_mode=self.autoreset_mode, **self._origin.copies(n))
        try:
            copies.restore(write_snapshot([snapshot], None), np.full(n, place))
        except BaseException:
            copies.close()
            raise
        return copies

    @checked
    def rollout(self, actions: npt.ArrayLike, trajectories: bool = False) -> Rollout:
        """Runs sequences of actions [steps, num_envs, action] from the present states, and then restores these states.

        All steps need one message to the server and its answer. Evolution strategies, random shooting and
        model-predictive control can use it. With `trajectories` the result has the observations and rewards of every
        step.
        """
        self._require_rest("rollout")
        return self._session.rollout(numbers("actions", actions, np.float32), trajectories)

    @checked
    def rollout_policy(self, onnx: bytes | FilePath, steps: int, trajectories: bool = False) -> Rollout:
        """Runs a policy for `steps` control steps from the present states, and then restores these states.

        `onnx`: a file that `sandgait.export_onnx` wrote, or its bytes. The policy runs where the environments are, so
        all steps need one message to the server and its answer. With `trajectories` the result has the observations,
        rewards and actions of every step. The rollout of an environment ends early if its episode ends, so `steps` can
        be at most the task's `max_episode_steps`.
        """
        self._require_rest("rollout_policy")
        if not 0 <= steps < 2**32:
            raise InvalidRequest(f"steps: {steps} is outside [1, {self.task.max_episode_steps}]")
        return self._session.rollout_policy(read_policy(onnx), steps, trajectories)

    def _require_rest(self, call: str) -> None:
        """Refuses `call` while a step is in flight, or if an episode has ended and the next one has not begun."""
        if self._turn.in_flight:
            raise OutOfOrder(f"{call}: a step is in flight; call recv first")
        ended = self._turn.ended
        if ended.any():
            raise OutOfOrder(f"{call}: environment {ended.argmax()} has ended its episode; step or reset first")

    def render(self) -> tuple[npt.NDArray[np.uint8], ...] | None:
        """A picture of every robot's present state, each u8 [height, width, 3]. In mode "human" a window shows the
        pictures."""
        if self.render_mode is None:
            raise InvalidRequest('render_mode: none was chosen; make the environments with render_mode="rgb_array"')
        if self._turn.in_flight:
            raise OutOfOrder("render: a step is in flight; call recv first")
        ended = np.flatnonzero(self._turn.ended)
        if self.render_mode == "human":
            self._view.show(bool(ended.size))
            return None
        pictures = self._view.pictures(list(range(self.num_envs)))
        if ended.size:
            pictures[ended] = self._view.pictures(ended.tolist(), ended=True)
        return tuple(pictures)

    @checked
    def record(self, path: FilePath, index: int = 0) -> None:
        """Records environment `index` to the file `path`: its state after each reset or step from now on."""
        self._view.record(path, index)

    def stop_recording(self) -> None:
        """Completes the recording; see `sandgait.read_recording` and `sandgait replay`."""
        self._view.stop_recording()

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """Attribute `name` of each environment, the same as in gymnasium's SyncVectorEnv. Task options are not
        attributes."""
        value = getattr(self, name, self)
        if value is self or callable(value):
            raise UnknownAttribute(f"{name}: no attribute of single environments")
        return (value,) * self.num_envs

    def set_attr(self, name: str, values: Any) -> None:
        """Refuses to set an attribute, because the simulation would not change. The message says what changes it."""
        raise refusal(self.task, name, values)

    def _in_step(self) -> bool:
        return self._turn.in_flight

    def _first_over(self) -> bool:
        return bool(self._turn.ended[0])

    def close_extras(self, **kwargs: Any) -> None:
        """Ends the session and frees the environments' memory."""
        self._close()


def _autoreset(mode: AutoresetMode | str) -> AutoresetMode:
    """The autoreset mode, from a member of the enum or its value."""
    for known in AutoresetMode:
        if mode in (known, known.value, known.name):
            return known
    raise unknown("autoreset_mode:", mode, [m.name for m in AutoresetMode])
