"""Many environments as a stable-baselines3 `VecEnv`."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Sequence
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode

from .arguments import checked
from .attributes import refusal
from .errors import InvalidRequest, UnknownAttribute, unknown
from .shards import Address
from .snapshots import FilePath
from .vector_env import SandgaitVectorEnv

try:
    import torch
    from stable_baselines3.common.vec_env import VecEnv, VecMonitor
except ImportError as error:
    raise ImportError("stable-baselines3 is not installed: pip install 'sandgait[sb3]'") from error

Indices = None | int | Iterable[int]


class EnvironmentView:
    """One environment of a batch, for SB3's calls to single environments: attributes and `reset`.

    Its attributes cannot be set, because that would not change the simulation.
    """

    __slots__ = ("_envs", "_index")

    def __init__(self, envs: SandgaitVectorEnv, index: int) -> None:
        self._envs = envs
        self._index = index

    @property
    def observation_space(self) -> gymnasium.Space[Any]:
        return self._envs.single_observation_space

    @property
    def action_space(self) -> gymnasium.Space[Any]:
        return self._envs.single_action_space

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        value = getattr(self._envs, name, self)
        if value is self:
            raise UnknownAttribute(f"{name}: no attribute of an environment")
        if callable(value):
            raise UnknownAttribute(
                f"{name}: a method of all environments at once; call vec_env.unwrapped.envs.{name}(...)"
            )
        return value

    def has_wrapper_attr(self, name: str) -> bool:
        return hasattr(self, name)

    def get_wrapper_attr(self, name: str) -> Any:
        return getattr(self, name)

    def set_wrapper_attr(self, name: str, value: Any, *, force: bool = True) -> bool:
        raise refusal(self._envs.task, name, value)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[npt.NDArray[np.float32], dict[str, Any]]:
        """Begins a new episode of this environment alone. The answer of a step in flight is dropped."""
        mask = np.zeros(self._envs.num_envs, dtype=np.bool_)
        mask[self._index] = True
        seeds = [seed if chosen else None for chosen in mask]
        observations, _ = self._envs.reset(
            seed=None if seed is None else seeds, options={**(options or {}), "reset_mask": mask}
        )
        return observations[self._index], {c.name: 0.0 for c in self._envs.task.info}


class SandgaitVecEnv(VecEnv):
    """`SandgaitVectorEnv` with stable-baselines3's interface.

    The info dictionary of an environment has entries only if its episode ended: the step's reward terms and figures,
    `terminal_observation` and `TimeLimit.truncated`. `batch` has the info columns of every step.
    """

    def __init__(self, envs: SandgaitVectorEnv) -> None:
        if envs.metadata["autoreset_mode"] is not AutoresetMode.SAME_STEP:
            raise InvalidRequest('autoreset_mode: stable-baselines3 expects "SAME_STEP"')
        self.envs = envs
        self._views = [EnvironmentView(envs, i) for i in range(envs.num_envs)]
        self._names = [c.name for c in envs.task.info]
        #: gymnasium's registration of the task. VecMonitor writes the task's id to its file.
        self.spec = gymnasium.registry.get(envs.task.id)
        super().__init__(envs.num_envs, envs.single_observation_space, envs.single_action_space)

    def reset(self) -> npt.NDArray[np.float32]:
        """Begins new episodes, with the arguments of the last calls of `seed` and `set_options`."""
        groups: list[tuple[dict[str, Any], npt.NDArray[np.bool_]]] = []
        for i, options in enumerate(self._options):
            mask = next((m for o, m in groups if o == options), None)
            if mask is None:
                mask = np.zeros(self.num_envs, dtype=np.bool_)
                groups.append((options, mask))
            mask[i] = True
        seeds = None if self._seeds[0] is None else list(self._seeds)
        for options, mask in groups:
            observations, _ = self.envs.reset(seed=seeds, options={**options, "reset_mask": mask})
        self.reset_infos = [dict.fromkeys(self._names, 0.0) for _ in range(self.num_envs)]
        self._reset_seeds()
        self._reset_options()
        return observations

    def step_async(self, actions: npt.NDArray[np.float32]) -> None:
        self.envs.send(actions)

    def step_wait(
        self,
    ) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32], npt.NDArray[np.bool_], list[dict[str, Any]]]:
        batch = self.batch = self.envs.recv_batch()
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for i, last in zip(batch.final_indices, batch.final_observations, strict=True):  # only those that ended
            infos[i] = dict(zip(self._names, batch.infos[:, i].tolist(), strict=True))
            infos[i]["terminal_observation"] = last
            infos[i]["TimeLimit.truncated"] = bool(batch.truncated[i] and not batch.terminated[i])
        return batch.observations, batch.rewards, batch.terminated | batch.truncated, infos

    def render(self, mode: str | None = None) -> npt.NDArray[np.uint8] | None:
        """All robots in one picture, or in the window of mode "human"."""
        if self.render_mode == "human":
            self.envs.render()
            return None
        return super().render(mode)

    def get_images(self) -> Sequence[npt.NDArray[np.uint8] | None]:
        """A picture of every environment. SB3's `render` puts these pictures side by side."""
        return self.envs.render() or [None] * self.num_envs

    def close(self) -> None:
        self.envs.close()

    def get_attr(self, attr_name: str, indices: Indices = None) -> list[Any]:
        return [getattr(view, attr_name) for view in self._chosen(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Indices = None) -> None:
        """Refuses to set an attribute, because the simulation would not change. The message says what changes it."""
        raise refusal(self.envs.task, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: Indices = None, **kwargs: Any) -> list[Any]:
        return [getattr(view, method_name)(*args, **kwargs) for view in self._chosen(indices)]

    def env_is_wrapped(
        self, wrapper_class: type[gymnasium.Wrapper[Any, Any, Any, Any]], indices: Indices = None
    ) -> list[bool]:
        return [False for _ in self._chosen(indices)]

    def _chosen(self, indices: Indices) -> Sequence[EnvironmentView]:
        return [self._views[i] for i in self._get_indices(indices)]


#: Types of the result of `sandgait.make_sb3`, with and without a monitor.
Environments = SandgaitVecEnv | VecMonitor


#: Variables by which a user chooses the number of torch's threads.
_CHOSEN = ("OMP_NUM_THREADS", "MKL_NUM_THREADS")


def limit_torch(threads: int | None) -> None:
    """Gives torch this number of threads; None: as many as it has. Says on stderr if that changes the number.

    Threads of torch wait for their next work without sleeping. Beside the threads of the environments they take the
    processors from these and from each other; the networks of PPO are so small that one thread is as fast alone.
    """
    if threads is None or any(name in os.environ for name in _CHOSEN) or torch.get_num_threads() <= threads:
        return
    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    print(
        f"sandgait: torch has {threads} thread instead of {before}, because its threads and those of the environments "
        f"slow each other down; make_sb3(…, torch_threads=None) leaves them",
        file=sys.stderr,
    )


@checked
def make(
    task: str,
    num_envs: int,
    address: Address,
    monitor: bool | FilePath,
    info_keywords: tuple[str, ...],
    torch_threads: int | None,
    options: dict[str, Any],
) -> Environments:
    """Implements `sandgait.make_sb3`."""
    if "autoreset_mode" in options:
        raise InvalidRequest("autoreset_mode: stable-baselines3 has a fixed one")
    if torch_threads is not None and torch_threads < 1:
        raise InvalidRequest(f"torch_threads: {torch_threads} is below 1")
    envs = SandgaitVecEnv(SandgaitVectorEnv(task, num_envs, address, autoreset_mode="SAME_STEP", **options))
    if address is None:
        limit_torch(torch_threads)
    if monitor is False:
        return envs
    known = [c.name for c in envs.envs.task.info]
    wrong = [name for name in info_keywords if name not in known]
    if wrong:
        envs.close()
        raise unknown("info_keywords:", wrong[0], known)
    return VecMonitor(envs, None if monitor is True else str(monitor), tuple(info_keywords))
