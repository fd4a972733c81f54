"""Environments of other packages, as `sandgait.train` steps them: any gymnasium `VectorEnv` with Box spaces.

A step has the same form for all three autoreset modes. A transition that ends an episode has the last observation of
that episode. With NEXT_STEP the step after it ignores the action and begins the next episode; such a step is no
transition, and `step` marks it as skipped.
"""

from __future__ import annotations

import json
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv, VectorWrapper

from .errors import InvalidRequest
from .vector_env import SandgaitVectorEnv

Array = npt.NDArray[Any]


class VectorEnvironments:
    """All environments of a training. Actions are within ±1; −1 and 1 stand for the ends of the action space."""

    def __init__(self, env: VectorEnv[Any, Any, Any]) -> None:
        self.env, self.num_envs = env, env.num_envs
        self._mode = _autoreset_mode(env)
        self._space = _box(env, "observation")
        space = _box(env, "action")
        if not np.issubdtype(space.dtype, np.floating):
            raise InvalidRequest(f"env: its action space has numbers of type {space.dtype}, not floating-point ones")
        low, high = space.low.astype(np.float64), space.high.astype(np.float64)
        # Older environments state the largest float32 as a bound if there is none.
        if not (np.maximum(-low, high) < np.finfo(np.float32).max).all():
            raise InvalidRequest("env: its action space has no bounds; give it some, to which actions are scaled")
        self._center, self._half, self._low, self._high = 0.5 * (low + high), 0.5 * (high - low), low, high
        self._waiting = np.zeros(self.num_envs, np.bool_)
        self._sums: dict[str, float] = {}
        self._transitions = 0
        #: What identifies the environments, so that a training goes on with the same ones.
        self.name, self.identity = _identity(env)
        self.bounds = [
            np.stack([s.low.ravel(), s.high.ravel()], axis=1).astype(np.float64).tolist() for s in (self._space, space)
        ]

    def reset(self, seed: int) -> Array:
        """The first observations, float32 [num_envs, observation]."""
        # Some environments take seeds of 32 bits only, and environment i gets the seed plus i.
        seed = int(np.random.SeedSequence(seed).generate_state(1)[0]) >> 1
        self._waiting[:] = False
        return self._rows("reset", self.env.reset(seed=seed)[0])

    def step(self, actions: Array) -> tuple[Array, ...]:
        """Makes a step with actions float32 [num_envs, action].

        Returns observations and rewards (float32), the flags terminated, truncated and skipped (uint8), the indices of
        the environments whose episode ended (uint32), and their last observations (float32).
        """
        skipped = self._waiting
        scaled = self._center + self._half * actions.reshape(-1, *self._center.shape)
        scaled = np.clip(scaled, self._low, self._high).astype(self.env.single_action_space.dtype)
        observations, rewards, terminated, truncated, infos = self.env.step(scaled)
        rows, rewards = self._rows("step", observations), self._numbers("rewards", rewards)
        flags = [self._flags(name, given) & ~skipped for name, given in _named(terminated, truncated)]
        ended = flags[0] | flags[1]
        last = rows[ended]
        if self._mode is AutoresetMode.SAME_STEP:
            last = self._final(infos, ended)
        elif self._mode is AutoresetMode.NEXT_STEP:
            self._waiting = ended
        self._note(infos, skipped, ended)
        if self._mode is AutoresetMode.DISABLED and ended.any():
            firsts, _ = self.env.reset(options={"reset_mask": ended.copy()})
            rows[ended] = self._rows("reset", firsts)[ended]
        bits = (flag.view(np.uint8) for flag in (*flags, skipped))
        return rows, rewards, *bits, np.flatnonzero(ended).astype(np.uint32), last

    def terms(self) -> list[tuple[str, float]]:
        """Each reward term in `infos`, and its mean over all transitions since the call before."""
        means = [(name, total / max(self._transitions, 1)) for name, total in self._sums.items()]
        self._sums, self._transitions = {}, 0
        return means

    def _note(self, infos: dict[str, Any], skipped: Array, ended: Array) -> None:
        """Adds the reward terms of a step: columns of numbers whose names begin with "reward"."""
        self._transitions += int((~skipped).sum())
        # With SAME_STEP `final_info` may have the values of an episode's last step, and `infos` those of the reset.
        finals = infos.get("final_info") if self._mode is AutoresetMode.SAME_STEP and ended.any() else None
        finals = finals if isinstance(finals, dict) else {}
        for name in dict.fromkeys([*infos, *finals]):
            if not (isinstance(name, str) and name.startswith("reward")):
                continue
            column, final = (self._column(source.get(name)) for source in (infos, finals))
            if final is not None:
                column = np.where(ended, final, 0.0 if column is None else column)
            if column is not None:
                column_name = " ".join(name.split()).replace(",", ";")  # a cell of a CSV
                self._sums[column_name] = self._sums.get(column_name, 0.0) + float(column[~skipped].sum())

    def _column(self, given: Any) -> Array | None:
        """`given` as numbers [num_envs]; None if it is something else."""
        column = np.asarray(given)
        return column if column.shape == (self.num_envs,) and column.dtype.kind in "fiub" else None

    def _final(self, infos: dict[str, Any], ended: Array) -> Array:
        last = np.zeros((int(ended.sum()), self._space.low.size), np.float32)
        finals = infos.get("final_obs")
        for row, i in zip(last, np.flatnonzero(ended), strict=True):
            if finals is None or finals[i] is None:
                raise InvalidRequest(
                    f'env: the episode of environment {i} has ended, but infos["final_obs"], which autoreset mode '
                    "SAME_STEP promises, does not have its last observation"
                )
            row[:] = self._finite(f'infos["final_obs"][{i}]', np.asarray(finals[i]), self._space.shape).ravel()
        return last

    def _rows(self, call: str, observations: Any) -> Array:
        """Observations as float32 [num_envs, observation], copied, because environments may reuse theirs."""
        shape = (self.num_envs, *self._space.shape)
        return self._finite(f"{call}'s observations", np.asarray(observations), shape).reshape(self.num_envs, -1)

    def _numbers(self, what: str, given: Any) -> Array:
        return self._finite(f"step's {what}", np.asarray(given), (self.num_envs,))

    def _flags(self, what: str, given: Any) -> npt.NDArray[np.bool_]:
        return np.array(_shaped(f"step's {what}", np.asarray(given), (self.num_envs,)), np.bool_)

    def _finite(self, what: str, given: Array, shape: tuple[int, ...]) -> Array:
        if given.dtype.kind not in "fiub":
            raise InvalidRequest(f"env: {what} are of type {given.dtype}, not numbers")
        with np.errstate(over="ignore"):
            numbers = np.array(_shaped(what, given, shape), np.float32)
        finite = np.isfinite(numbers)
        if not finite.all():
            at = np.unravel_index(int(np.argmin(finite)), shape)
            index = "".join(f"[{i}]" for i in at)
            raise InvalidRequest(f"env: {what}{index} is {given[at]}, not a finite number")
        return numbers


def _named(terminated: Any, truncated: Any) -> list[tuple[str, Any]]:
    return [("terminated", terminated), ("truncated", truncated)]


def _shaped(what: str, given: Array, shape: tuple[int, ...]) -> Array:
    if given.shape != shape:
        raise InvalidRequest(f"env: {what} have the shape {given.shape}, not {shape}")
    return given


def check_vector(env: Any) -> VectorEnv[Any, Any, Any]:
    """Refuses what is no vector of environments."""
    if isinstance(env, VectorEnv):
        return env
    if isinstance(env, gymnasium.Env):
        name = type(env.unwrapped).__name__
        make = f"gymnasium.vector.SyncVectorEnv([lambda: {name}(…)] * 8)"
        if env.spec:
            make = f"gymnasium.make_vec({env.spec.id!r}, num_envs=8)"
        raise InvalidRequest(f"env: {name} is a single environment; train takes a vector, such as {make}")
    raise InvalidRequest(f"env: {type(env).__name__} is neither the name of a task nor a gymnasium VectorEnv")


def _autoreset_mode(env: VectorEnv[Any, Any, Any]) -> AutoresetMode:
    mode = (env.metadata or {}).get("autoreset_mode")
    try:
        return AutoresetMode(mode)
    except ValueError:
        raise InvalidRequest(
            f'env: metadata["autoreset_mode"] is {mode!r}, not NEXT_STEP, SAME_STEP or DISABLED of '
            "gymnasium.vector.AutoresetMode; without it, the ends of episodes cannot be understood"
        ) from None


def _box(env: VectorEnv[Any, Any, Any], kind: str) -> Box:
    space = getattr(env, f"single_{kind}_space")
    if not isinstance(space, Box):
        raise InvalidRequest(f"env: its {kind} space is {_line(space)}; train takes Box spaces only")
    if space.low.size == 0:
        raise InvalidRequest(f"env: its {kind} space {_line(space)} has no numbers")
    return space


def _identity(env: VectorEnv[Any, Any, Any]) -> tuple[str, dict[str, str]]:
    """The name of the environments, with the vector wrappers around them, and what else identifies them."""
    wrappers, inner = [], env
    while isinstance(inner, VectorWrapper):
        wrappers.append(type(inner).__name__)
        inner = inner.env
    single: Any = inner.envs[0] if isinstance(inner, SyncVectorEnv) else inner
    within = []
    if isinstance(inner, SandgaitVectorEnv):
        name, keywords = inner.task.id, inner._origin.options
    elif (spec := inner.spec or single.spec) is not None:
        name, keywords = spec.id, spec.kwargs
    else:
        name, keywords = type(single.unwrapped).__name__, {}
    while inner.spec is None and isinstance(single, gymnasium.Wrapper):
        within.append(type(single).__name__)
        single = single.env
    for wrapper in reversed(wrappers):
        name = f"{wrapper}({name})"
    identity = {f"{kind}_space": _line(getattr(env, f"single_{kind}_space")) for kind in ("observation", "action")}
    for key, value in keywords.items():
        if key not in ("num_envs", "vectorization_mode"):  # `make_vec` adds them
            identity[str(key)] = json.dumps(value, default=lambda part: type(part).__name__, skipkeys=True)
    return name, {**identity, "wrappers": " ".join(within)}


def _line(value: object) -> str:
    return " ".join(str(value).split())
