"""`gymnasium.make`, and gymnasium's own checks."""

from __future__ import annotations

import json
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import sandgait
from conftest import ID, RemoteServer


@pytest.mark.parametrize("options", [{}, {"leg": "C", "medium": "poppy-close", "slope_deg": 5}])
def test_check_env_finds_nothing(options: dict[str, object]) -> None:
    """Warnings are errors here: see pyproject.toml."""
    env = gymnasium.make(ID, **options)
    check_env(env.unwrapped)
    env.close()


@pytest.mark.parametrize(
    ("name", "id"),
    [
        ("HexapodGait", "sandgait/HexapodGait-v1"),
        ("HexapodGait-v1", "sandgait/HexapodGait-v1"),
        ("sandgait/HexapodGait", "sandgait/HexapodGait-v1"),
        ("HexapodLegs", "sandgait/HexapodLegs-v2"),
        ("sandgait/HexapodLegs-v1", "sandgait/HexapodLegs-v1"),
    ],
)
def test_short_names(name: str, id: str, remote: RemoteServer) -> None:
    """The namespace can be left out, and the version, which then is the latest: wherever a task is named."""
    for env in (
        sandgait.SandgaitEnv(name),
        sandgait.SandgaitVectorEnv(name, 2),
        sandgait.SandgaitVectorEnv(name, 2, remote.address),
        sandgait.make_sb3(name, 2).unwrapped.envs,
    ):
        assert env.task.id == id
        env.close()
    assert sandgait.mirror(name) == sandgait.mirror(id)
    scores = [sandgait.evaluate("random", called, seeds=2)["return"] for called in (name, id)]
    assert np.array_equal(*scores)


def test_a_short_name_for_train(tmp_path: Path) -> None:
    done = sandgait.train("sandgait/HexapodGait", timesteps=1, out=tmp_path / "run")
    assert json.loads((done.out / "settings.json").read_text())["task"] == ID


def test_registered_ids_are_the_servers() -> None:
    version, tasks = sandgait.describe()
    assert version
    assert tuple(task.id for task in tasks) == sandgait.TASKS
    assert all(task in gymnasium.registry for task in sandgait.TASKS)


def test_tables_make_the_spaces() -> None:
    env = gymnasium.make(ID).unwrapped
    assert isinstance(env, sandgait.SandgaitEnv)
    task = env.task
    assert env.action_space == gymnasium.spaces.Box(-1.0, 1.0, (6,))
    assert env.observation_space.shape == (41,) == (len(task.observation),)
    assert np.isfinite(env.observation_space.low).all()
    assert np.isfinite(env.observation_space.high).all()
    names = [c.name for c in task.observation]
    assert len(set(names)) == 41
    assert all(c.unit for c in (*task.observation, *task.action, *task.info))
    assert {"leg", "medium", "slope_deg", "command"} <= {o.name for o in task.options if o.at_reset}
    assert {o.name: o.default for o in task.options}["leg"] == "L"
    env.close()


def test_an_episode_ends_by_the_servers_clock_and_the_next_one_waits() -> None:
    env = sandgait.SandgaitEnv(ID, max_episode_steps=20)
    env.reset(seed=7)
    rewards = []
    for k in range(20):
        observation, reward, terminated, truncated, info = env.step(np.full(6, 0.5))
        rewards.append(reward)
        assert truncated is (k == 19)
        assert terminated is False
    assert set(info) == {c.name for c in env.task.info}
    assert reward == pytest.approx(sum(info[c.name] for c in env.task.info[: env.task.reward_terms]), abs=1e-6)
    assert env.observation_space.contains(observation)
    assert observation[33:39] == pytest.approx(np.full(6, 0.5)), "the last row of the old episode, not of the new one"
    with pytest.raises(sandgait.OutOfOrder, match="reset"):
        env.step(np.zeros(6))
    second, _ = env.reset()
    again = sandgait.SandgaitEnv(ID, max_episode_steps=20)
    again.reset(seed=7)
    assert np.array_equal(second, again.reset()[0]), "episode 1 of seed 7, whether or not episode 0 was played out"
    env.close()
    again.close()


def test_gymnasiums_own_time_limit_still_works() -> None:
    env = gymnasium.make(ID, max_episode_steps=3)
    env.reset(seed=0)
    flags = [env.step(env.action_space.sample())[3] for _ in range(3)]
    assert flags == [False, False, True]
    env.reset()
    assert env.step(env.action_space.sample())[3] is False
    env.close()


def test_reset_options_change_the_ground_and_hold() -> None:
    env = gymnasium.make(ID)
    env.reset(seed=0, options={"command": [0.3, 0.3]})
    assert env.step(np.zeros(6, np.float32))[4]["commanded_speed"] == pytest.approx(0.3)
    env.reset()
    assert env.step(np.zeros(6, np.float32))[4]["commanded_speed"] == pytest.approx(0.3)
    env.close()


def test_unseeded_environments_differ() -> None:
    first, second = (gymnasium.make(ID).reset()[0] for _ in range(2))
    assert not np.array_equal(first, second)
    rows, _ = gymnasium.make_vec(ID, num_envs=8).reset()
    assert len(np.unique(rows, axis=0)) == 8


def test_the_info_of_a_reset_has_the_keys_of_a_steps() -> None:
    env = sandgait.SandgaitEnv(ID, max_episode_steps=2)
    for seed in (1, None, None):
        _, info = env.reset(seed=seed)
        for _ in range(2):
            after = env.step(np.zeros(6))[4]
            assert list(info) == list(after)
            assert all(type(info[k]) is type(after[k]) for k in info)
        assert not any(info.values())
    env.close()
