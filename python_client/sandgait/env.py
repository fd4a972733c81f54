"""One environment as a `gymnasium.Env`: a session with one environment."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt

from .arguments import checked
from .attributes import refusal
from .batches import Batch
from .errors import InvalidRequest, OutOfOrder, SandgaitError
from .pickling import Origin, Pickled
from .snapshots import FilePath, read_snapshot, write_snapshot
from .spaces import Actions, box, check_seed, commands, info_columns, privileged
from .vector_env import SandgaitVectorEnv
from .view import RENDER_MODES, SIZE

Observation = npt.NDArray[np.float32]


#: Length of the longest episode that a server supports [control steps] (`MAX_STEPS` in src/env/walking.rs).
LONGEST_EPISODE = 1_000_000


class SandgaitEnv(Pickled, gymnasium.Env[Observation, npt.NDArray[np.float32]]):
    """One environment of `task` in this process, or on the server at `address`.

    For training use `SandgaitVectorEnv`, because a step of sixteen environments takes little longer than a step of one.
    `resume`: continue from a snapshot when the server has ended. `clip_actions`: clip actions to their bounds; by
    default an action outside of its bounds is refused. `threads`: number of simulating threads of this process; only
    the first environment of the process can set it. `isolated`: without an address, use a separate server process, so
    that a crash of the simulation does not end this process. `render_mode`: "rgb_array" makes pictures of `render_size`
    (width, height) [px], "human" shows them in a window. `render_camera`: where the camera stands, see
    `SandgaitVectorEnv`.

    A step that Ctrl-C interrupts is still carried out, and the next call of `step` returns its answer. A pickle or copy
    of an environment that was reset includes its state (module `pickling`).
    """

    metadata: dict[str, Any] = {"render_modes": RENDER_MODES}

    @checked
    def __init__(
        self,
        task: str,
        address: str | None = None,
        render_mode: str | None = None,
        resume: bool = False,
        render_size: tuple[int, int] = SIZE,
        render_camera: Mapping[str, Any] | None = None,
        clip_actions: bool = False,
        threads: int | None = None,
        isolated: bool = False,
        **options: Any,
    ) -> None:
        view = render_mode, render_size, render_camera
        self._begin(Origin(task, 1, address, resume, threads, isolated, options, *view, clip_actions))
        self.render_mode = render_mode
        self.metadata = {**self.metadata, "render_fps": self.task.control_rate}
        self.observation_space = box(self.task.observation)
        self.action_space = box(self.task.action)
        self._actions = Actions(self.action_space, "action", clip_actions)
        self._columns, self.privileged_observation_space = info_columns(self.task.info)
        self._seeded = False
        self._over = False
        #: First observation of the next episode, which the server begins in the step that ends an episode.
        self._next: Observation | None = None
        #: With option `privileged`: the exact values of the sensors for `_next`.
        self._next_privileged: Observation | None = None
        #: The action of a step whose answer was not returned yet, and this answer as soon as it has arrived.
        self._in_flight: npt.NDArray[np.float32] | None = None
        self._batch: Batch | None = None
        #: Attributes of this class. The user may set others.
        self._own = frozenset(self.__dict__) | {"_own"}

    @checked
    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begins an episode. `options`: new values of task options; they hold until another reset changes them.

        The returned info has the keys of a step's info. Its values are 0, because no step has been made yet. With
        option `privileged=True`, `info["privileged"]` has the exact values of all sensors, as in
        `privileged_observation_space`.
        """
        check_seed(seed)
        if self._in_flight is not None:
            with contextlib.suppress(InvalidRequest):
                self._answer()  # if the step ended the episode, the next one has begun already
        super().reset(seed=seed)
        first, self._next, self._over = self._next, None, False
        if first is not None and seed is None and not options:
            self._view.moved(record_ended=False, show_ended=False)
            info: dict[str, Any] = dict.fromkeys(self._columns, 0.0)
            if self._next_privileged is not None:
                info["privileged"] = self._next_privileged
            return first, info
        seeds = None if seed is None else [seed]
        if seed is None and not self._seeded:
            seeds = [int(self.np_random.integers(2**63))]
        self._seeded = True
        self._session.send_reset(seeds, None, options or {})
        batch = self._session.receive()
        self._view.moved(record_ended=False, show_ended=False)
        return batch.observations[0], self._info(batch)

    def step(self, action: npt.ArrayLike) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Makes one control step. `action` is an array [action] of numbers within their bounds."""
        if self._over:
            raise OutOfOrder("step: the episode is over; call reset first")
        row = self._actions.rows(action)
        if self._in_flight is not None:
            if not np.array_equal(self._in_flight, row):
                gymnasium.logger.warn("step: this is the answer of the step that was interrupted, not of this action")
            return self._answer()
        session = self._session
        try:
            self._in_flight, self._batch = row.copy(), None
            self._batch = session.step(row[None])
        except BaseException as error:
            if isinstance(error, SandgaitError) or not session.owes:
                self._in_flight = None
            raise self._actions.explain(error) from None
        return self._answer()

    def _answer(self) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Result of the step in flight. It can be called again after an interrupt at any point."""
        if self._batch is None:
            try:
                self._batch = self._session.receive()
            except SandgaitError as error:
                self._in_flight = None
                raise self._actions.explain(error) from None
        batch = self._batch
        terminated, truncated = bool(batch.terminated[0]), bool(batch.truncated[0])
        over = terminated or truncated
        observation = batch.final_observations[0] if over else batch.observations[0]
        self._view.moved(record_ended=over, show_ended=over)
        info = self._info(batch)
        result = observation, float(batch.rewards[0]), terminated, truncated, info
        if over:
            self._over, self._next = True, batch.observations[0]
            if self.privileged_observation_space is not None:
                self._next_privileged = privileged(batch.infos, self._columns, True)[0]
        self._in_flight, self._batch = None, None
        return result

    def _info(self, batch: Batch) -> dict[str, Any]:
        count = len(self._columns)
        info: dict[str, Any] = dict(zip(self._columns, batch.infos[:count, 0].tolist(), strict=True))
        if self.privileged_observation_space is not None:
            info["privileged"] = privileged(batch.infos, self._columns)[0]
        return info

    def _in_step(self) -> bool:
        return self._in_flight is not None

    def _first_over(self) -> bool:
        return self._over

    def _asked(self) -> dict[str, Any]:
        """Without the limit of `registered`, which no user gave."""
        given = super()._asked()
        if given.get("max_episode_steps") != LONGEST_EPISODE:
            return given
        return {name: value for name, value in given.items() if name != "max_episode_steps"}

    def _require_rest(self, call: str) -> None:
        if self._in_flight is not None:
            raise OutOfOrder(f"{call}: a step was interrupted; call step for its answer, or reset")

    def set_wrapper_attr(self, name: str, value: Any, *, force: bool = True) -> bool:
        """Sets an attribute that the user added. Other names are refused, because the simulation would not change."""
        ours = name in self._own or hasattr(SandgaitEnv, name) or not hasattr(self, name)
        if ours and name != "np_random":
            raise refusal(self.task, name, value)
        return super().set_wrapper_attr(name, value, force=force)

    def render(self) -> npt.NDArray[np.uint8] | None:
        """A picture of the robot's present state, u8 [height, width, 3]. In mode "human" a window shows the picture."""
        if self.render_mode is None:
            raise InvalidRequest('render_mode: none was chosen; make the environment with render_mode="rgb_array"')
        self._require_rest("render")
        if self.render_mode == "human":
            self._view.show(self._over)
            return None
        picture: npt.NDArray[np.uint8] = self._view.pictures([0], self._over)[0]
        return picture

    @checked
    def record(self, path: FilePath) -> None:
        """Records to the file `path`: the state after each reset or step, until `stop_recording` or `close`."""
        self._view.record(path, 0)

    def stop_recording(self) -> None:
        """Completes the recording; see `sandgait.read_recording` and `sandgait replay`."""
        self._view.stop_recording()

    def set_command(self, command: npt.ArrayLike) -> Observation:
        """Replaces the commanded velocity for the rest of the episode. Returns the observation with the new command; if
        a sensor is delayed, the observation shows the command one step later.

        `command` is [3]: forward, to the left [m/s], yaw rate [rad/s]. HexapodGait and its relatives have no command to
        the left, so their second number is 0.
        """
        self._require_rest("set_command")
        if self._over:
            raise OutOfOrder("set_command: the episode is over; call reset first")
        self._session.send_command(commands(command, 1))
        observation: Observation = self._session.receive().observations[0]
        return observation

    @checked
    def save(self, path: FilePath | None = None) -> bytes:
        """Takes a snapshot, for `restore`. With `path` also writes it to a file, completely or not at all."""
        self._require_rest("save")
        if self._over:
            raise OutOfOrder("save: the episode is over; call reset first")
        return write_snapshot(self._session.save(), path)

    @checked
    def restore(self, snapshot: bytes | FilePath) -> Observation:
        """Sets the state to that of a snapshot (bytes or a file), and returns the observation. The environment then
        continues bit-identically."""
        self._session.send_restore(read_snapshot(snapshot), None)
        self._over, self._next, self._seeded, self._in_flight = False, None, True, None
        observation: Observation = self._session.receive().observations[0]
        return observation

    @checked
    def fork(self, n: int) -> SandgaitVectorEnv:
        """`n` new environments in one vector, each with the keywords and in the state of this one. The caller must
        close the vector."""
        snapshot = self.save()
        copies = SandgaitVectorEnv(**self._origin.copies(n))
        try:
            copies.restore(snapshot)
        except BaseException:
            copies.close()
            raise
        return copies

    def close(self) -> None:
        """Ends the session. A second call does nothing."""
        self._close()


def registered(task: str, **options: Any) -> SandgaitEnv:
    """`gymnasium.make` calls this for a task with a time limit.

    gymnasium keeps `max_episode_steps` for its wrapper TimeLimit, which counts the steps. So the environment's own
    limit is set to its maximum.
    """
    return SandgaitEnv(task, **{"max_episode_steps": LONGEST_EPISODE, **options})


#: gymnasium reads the render modes from the entry point's metadata.
registered.metadata = SandgaitEnv.metadata  # type: ignore[attr-defined]
