"""`examples/envhub/env.py` keeps the contract of LeRobot's EnvHub: what its documentation says, and what its evaluation
calls (lerobot 0.6, `lerobot/envs/utils.py`, `lerobot/scripts/lerobot_eval.py`)."""

from __future__ import annotations

import importlib.util
import inspect
from pathlib import Path
from types import ModuleType

import gymnasium as gym
import numpy as np
import pytest

ENV = Path(__file__).parents[2] / "examples/envhub/env.py"


@pytest.fixture(scope="module")
def hub() -> ModuleType:
    """The module as LeRobot loads it: from the file alone, under another name."""
    spec = importlib.util.spec_from_file_location("hub_env_user_repository", ENV)
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_make_env_has_the_documented_arguments_and_result(hub: ModuleType) -> None:
    arguments = inspect.signature(hub.make_env).parameters
    assert {name: one.default for name, one in arguments.items()} == {"n_envs": 1, "use_async_envs": False}
    made = hub.make_env(n_envs=2, use_async_envs=False)
    (suite,) = made.values()
    env = suite[0]
    assert isinstance(env, gym.vector.VectorEnv)
    assert env.num_envs == 2
    env.close()


def test_what_the_evaluation_calls_is_there(hub: ModuleType) -> None:
    env = hub.make_env(n_envs=2)["sandgait"][0]
    observation, _ = env.reset(seed=[3, 4], options={"lerobot_new_rollout": True})
    assert observation["agent_pos"].dtype == np.float32
    assert observation["agent_pos"].shape[0] == 2
    assert env.call("_max_episode_steps")[0] == 1000
    assert all(isinstance(text, str) for name in ("task", "task_description") for text in env.call(name))
    assert env.unwrapped.metadata.get("render_fps", 30) > 0
    assert env.envs[0].render().dtype == np.uint8
    success = None
    for _ in range(1000):  # actions beyond their bounds, as a policy of another place may give them
        _, reward, terminated, truncated, info = env.step(np.full((2, 12), 1.5, np.float32))
        assert np.isfinite(reward).all()
        if (terminated | truncated).any():
            success = info["final_info"]["is_success"]
            break
    assert success is not None
    assert (success[terminated] == False).all()  # noqa: E712 - an array
    env.close()


def test_each_environment_can_be_a_process(hub: ModuleType) -> None:
    env = hub.make_env(n_envs=2, use_async_envs=True)["sandgait"][0]
    assert isinstance(env, gym.vector.AsyncVectorEnv)
    first, _ = env.reset(seed=[1, 1])
    assert (first["agent_pos"][0] == first["agent_pos"][1]).all()
    env.close()
