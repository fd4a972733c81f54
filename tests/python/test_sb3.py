"""`sandgait.make_sb3` behaves as stable-baselines3 expects; its own DummyVecEnv is the reference."""

from __future__ import annotations

import itertools
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from stable_baselines3 import PPO
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv, VecMonitor, VecNormalize, is_vecenv_wrapped

import sandgait
from conftest import ID
from sandgait import sb3


def test_check_env_finds_nothing() -> None:
    """Warnings are errors here: see pyproject.toml."""
    env = sandgait.SandgaitEnv(ID)
    check_env(env)
    env.close()


def one() -> sandgait.SandgaitEnv:
    return sandgait.SandgaitEnv(ID, max_episode_steps=7)


def test_steps_are_dummyvecenvs() -> None:
    ours, theirs = sandgait.make_sb3(ID, 3, monitor=False, max_episode_steps=7), DummyVecEnv([one] * 3)
    assert isinstance(ours, VecEnv)
    assert ours.seed(4) == theirs.seed(4) == [4, 5, 6]
    assert np.array_equal(ours.reset(), theirs.reset())
    assert ours.reset_infos == theirs.reset_infos
    ours.action_space.seed(0)
    for step in range(1, 16):
        actions = np.stack([ours.action_space.sample() for _ in range(3)])
        mine, reference = ours.step(actions), theirs.step(actions)
        for a, b in zip(mine[:3], reference[:3], strict=True):
            assert a.dtype == b.dtype
            assert np.array_equal(a, b)
        assert all(d == (step % 7 == 0) for d in mine[2])
        for a, b, done in zip(mine[3], reference[3], mine[2], strict=True):
            assert set(a) == (set(b) if done else set())
            assert all(np.array_equal(a[key], b[key]) for key in a)
        if mine[2].all():
            assert mine[3][0]["TimeLimit.truncated"] is True
    ours.close()


def test_termination_is_no_time_limit() -> None:
    """If an episode terminates in its last possible step, it does not count as truncated, so SB3 must not bootstrap."""
    patterns = np.array(list(itertools.product([-1.0, 0.0, 1.0], repeat=6)), dtype=np.float32)
    steep = {"medium": "poppy-close", "slope_deg": 30.0, "torque_limit": 5.0}
    env = sandgait.make_sb3(ID, len(patterns), max_episode_steps=60, **steep)
    env.seed(0)
    env.reset()
    seen = set()
    for _ in range(60):
        for info in filter(None, env.step(patterns)[3]):
            fell = info["flipped"] == 1.0 or info["buried"] == 1.0
            assert info["TimeLimit.truncated"] is not fell
            seen.add(fell)
    assert seen == {True, False}


def test_seeds_and_options_count_for_one_reset() -> None:
    env = sandgait.make_sb3(ID, 2)
    env.seed(1)
    first = env.reset()
    assert not np.array_equal(first, env.reset())
    env.seed(1)
    env.set_options([{"command": [0.2, 0.2]}, {"command": [0.3, 0.3]}])
    assert env.reset()[:, -2] == pytest.approx([0.2, 0.3])
    env.set_options({"command": [0.4, 0.4]})
    assert env.reset()[:, -2] == pytest.approx([0.4, 0.4])


def test_attributes_and_methods_of_single_environments() -> None:
    env = sandgait.make_sb3(ID, 3)
    assert env.get_attr("render_mode") == [None] * 3
    assert env.get_attr("task", indices=1)[0].id == ID
    assert env.get_attr("action_space", indices=[0, 2]) == [env.action_space] * 2
    assert not env.has_attr("stage")
    assert env.has_attr("task")
    with pytest.raises(AttributeError, match="nothing"):
        env.env_method("nothing")
    rows = env.reset()
    (row, info), *others = env.env_method("reset", seed=3, indices=1)
    assert info == dict.fromkeys((c.name for c in env.get_attr("task")[0].info), 0.0)
    assert others == []
    assert not np.array_equal(row, rows[1])
    assert env.env_method("get_wrapper_attr", "num_envs", indices=0) == [3]
    assert env.env_is_wrapped(Monitor) == [False] * 3
    env.close()
    env.close()


def test_ppo_learns_a_little_and_is_saved(tmp_path: Any) -> None:
    """One update only; examples/train.py shows that a robot learns to walk."""
    env = VecNormalize(sandgait.make_sb3(ID, 8, max_episode_steps=50))
    model = PPO("MlpPolicy", env, n_steps=64, batch_size=512, n_epochs=1, seed=0, device="cpu")
    model.learn(1024)
    assert len(model.ep_info_buffer or ()) == 16
    model.save(tmp_path / "policy")
    env.save(str(tmp_path / "normalize.pkl"))
    evaluation = VecNormalize.load(str(tmp_path / "normalize.pkl"), sandgait.make_sb3(ID, 2))
    evaluation.training = False
    mean, _ = evaluate_policy(PPO.load(tmp_path / "policy", device="cpu"), evaluation, n_eval_episodes=2)
    assert np.isfinite(mean)


def test_a_missing_stable_baselines3_is_explained() -> None:
    code = f"import sys; sys.modules['stable_baselines3'] = None\nimport sandgait\nsandgait.make_sb3({ID!r}, 2)"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert result.returncode != 0
    assert "pip install 'sandgait[sb3]'" in result.stderr


def test_the_package_itself_does_not_import_torch() -> None:
    code = "import sys, sandgait; sys.exit('torch' in sys.modules or 'stable_baselines3' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], timeout=60, check=False).returncode == 0


def test_make_sb3_is_monitored(tmp_path: Path) -> None:
    """The monitor gives `ep_rew_mean`; with a path it also writes the episodes."""
    path = tmp_path / "runs.monitor.csv"
    env = sandgait.make_sb3(ID, 2, monitor=path, info_keywords=("speed",), max_episode_steps=5)
    assert is_vecenv_wrapped(env, VecMonitor)
    model = PPO("MlpPolicy", env, n_steps=16, batch_size=32, n_epochs=1, device="cpu").learn(32)
    assert model.ep_info_buffer is not None
    assert [e["l"] for e in model.ep_info_buffer] == [5] * 6
    env.close()
    head, columns, *rows = path.read_text().splitlines()
    assert ID in head
    assert columns == "r,l,t,speed"
    assert len(rows) == 6
    plain = sandgait.make_sb3(ID, 2, monitor=False)
    assert not is_vecenv_wrapped(plain, VecMonitor)
    plain.close()
    said = r'info_keywords: "sped" is unknown; did you mean "speed"\? known: .*speed'
    with pytest.raises(sandgait.InvalidRequest, match=said):
        sandgait.make_sb3(ID, 2, info_keywords=("sped",))
    with pytest.raises(sandgait.InvalidRequest, match="autoreset_mode: stable-baselines3"):
        sandgait.make_sb3(ID, 2, autoreset_mode="NEXT_STEP")
    with pytest.raises(sandgait.InvalidRequest, match="SAME_STEP"):
        sb3.SandgaitVecEnv(sandgait.SandgaitVectorEnv(ID, 2))
