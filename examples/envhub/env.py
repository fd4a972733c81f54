"""sandgait for LeRobot: an EnvHub file. Put it into a repository of the Hugging Face Hub, as it is, as `env.py`.

    from lerobot.envs import make_env

    envs = make_env("USER/REPOSITORY", n_envs=4, trust_remote_code=True)  # after pip install sandgait
    env = envs["sandgait"][0]

The task is LeggedVelocity: a quadruped follows commanded velocities on loose sand. An observation has the robot's
numbers as `agent_pos`, which LeRobot's policies know as `observation.state`. An episode is a success if the robot has
not fallen. The contract is that of LeRobot's page *Loading Environments from the Hub*. Not tested here: the Hub.
"""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt

import sandgait  # noqa: F401 - registers the tasks

TASK = "sandgait/LeggedVelocity-v1"

State = dict[str, npt.NDArray[np.float32]]


class Walk(gym.Wrapper[Any, npt.NDArray[np.float32], Any, npt.NDArray[np.float32]]):
    """One robot, with what LeRobot's evaluation asks of an environment."""

    task = "walk"
    task_description = "follow the commanded velocity on sand without falling"

    def __init__(self, render_mode: str = "rgb_array") -> None:
        # Policies that were not trained here exceed the bounds of actions.
        super().__init__(gym.make(TASK, render_mode=render_mode, clip_actions=True))
        self.observation_space = gym.spaces.Dict({"agent_pos": self.env.observation_space})
        assert self.env.spec is not None
        #: LeRobot asks for it under this name.
        self._max_episode_steps = self.env.spec.max_episode_steps or 1000

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[State, dict[str, Any]]:
        """`options`: LeRobot's own, which no task here has, are left out."""
        observation, info = self.env.reset(seed=seed)
        return {"agent_pos": observation}, {**info, "is_success": False}

    def step(self, action: npt.NDArray[np.float32]) -> tuple[State, Any, bool, bool, dict[str, Any]]:
        observation, reward, terminated, truncated, info = self.env.step(action)
        return {"agent_pos": observation}, reward, terminated, truncated, {**info, "is_success": truncated}


def make_env(
    n_envs: int = 1, use_async_envs: bool = False
) -> dict[str, dict[int, gym.vector.VectorEnv[Any, Any, Any]]]:
    """`n_envs` robots: {suite: {task: environments}}. `use_async_envs`: each in a process of its own."""
    kind = gym.vector.AsyncVectorEnv if use_async_envs else gym.vector.SyncVectorEnv
    # An episode's last figures are in the same step, where LeRobot looks for them.
    envs = kind([Walk] * n_envs, autoreset_mode=gym.vector.AutoresetMode.SAME_STEP)
    return {"sandgait": {0: envs}}
