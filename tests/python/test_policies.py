"""Policies that the server runs: equal to SB3's actions, to single steps, and to the output of `sandgait evaluate`."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from stable_baselines3 import DQN, PPO, SAC
from stable_baselines3.common.vec_env import VecNormalize

import sandgait
from conftest import ID
from sandgait import server

STEPS = 120


def untrained(kind: Any) -> tuple[Any, VecNormalize]:
    """A network with random weights and with observation statistics of some steps."""
    env = VecNormalize(sandgait.make_sb3(ID, 4), clip_obs=4.0)
    arguments = {"buffer_size": 100} if kind is SAC else {}
    model = kind("MlpPolicy", env, seed=1, device="cpu", **arguments)
    env.seed(0)
    env.reset()
    for _ in range(30):
        env.step(np.random.default_rng(0).uniform(-1, 1, (4, 6)))
    env.training = False
    with torch.no_grad():
        for weights in model.policy.parameters():
            # Sums in every layer are of order 1, as in trained networks. Larger sums have errors above 1e-5 in f32.
            weights.copy_(torch.randn_like(weights) * (1.5 / weights.shape[-1] ** 0.5 if weights.ndim > 1 else 0.3))
    return model, env


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    model, normalize = untrained(PPO)
    path = sandgait.export_onnx(model, tmp_path_factory.mktemp("policies") / "ppo.onnx", normalize)
    normalize.close()
    return path


@pytest.mark.parametrize("kind", [PPO, SAC])
def test_the_servers_actions_are_sb3s(kind: Any, tmp_path: Path) -> None:
    """The actions agree over whole episodes; rollouts and single steps have the same bits."""
    model, normalize = untrained(kind)
    path = sandgait.export_onnx(model, tmp_path / "policy.onnx", normalize)
    assert path == tmp_path / "policy.onnx"
    env = sandgait.SandgaitVectorEnv(ID, 20, autoreset_mode="SAME_STEP", max_episode_steps=STEPS)
    rows, _ = env.reset(seed=5)
    rollout = env.rollout_policy(path, STEPS, trajectories=True)
    assert rollout.actions.shape == (STEPS, 20, 6)
    assert (rollout.lengths == STEPS).mean() > 0.5
    worst, returns = 0.0, np.zeros(20)
    for k in range(STEPS):
        running = k < rollout.lengths
        expected = model.predict(normalize.normalize_obs(rows), deterministic=True)[0]
        worst = max(worst, float(np.abs(expected - rollout.actions[k])[running].max()))
        rows, rewards, terminated, truncated, infos = env.step(rollout.actions[k])
        returns += np.where(running, rewards, 0.0)
        last = np.array([infos["final_obs"][i] if terminated[i] | truncated[i] else rows[i] for i in range(20)])
        assert np.array_equal(last[running], rollout.observations[k][running])
        assert np.array_equal(rewards[running].astype(np.float32), rollout.rewards[k][running])
    assert worst < 1e-5
    assert returns == pytest.approx(rollout.returns)
    env.close()
    normalize.close()


def test_a_rollout_changes_nothing_and_several_servers_give_the_same(exported: Path, remote: Any) -> None:
    env = sandgait.SandgaitVectorEnv(ID, 20)
    spread = sandgait.SandgaitVectorEnv(ID, 20, [server.address(), remote.address])
    for each in (env, spread):
        each.reset(seed=2)
    one, other = (each.rollout_policy(exported.read_bytes(), 30, trajectories=True) for each in (env, spread))
    assert all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))
    again = env.rollout_policy(exported, 30)
    assert np.array_equal(one.returns, again.returns)
    assert again.actions.size == 0
    for each in (env, spread):
        each.close()


def test_wrong_policies_are_refused(exported: Path, tmp_path: Path) -> None:
    env = sandgait.SandgaitVectorEnv(ID, 2)
    env.reset(seed=0)
    with pytest.raises(sandgait.InvalidRequest, match=r"steps: 501 is outside \[1, 500\]"):
        env.rollout_policy(exported, 501)
    with pytest.raises(sandgait.InvalidRequest, match="policy: this is no ONNX file"):
        env.rollout_policy(b"nothing", 5)
    with pytest.raises(sandgait.InvalidRequest, match=r"missing\.onnx"):
        env.rollout_policy("missing.onnx", 5)
    assert env.step(np.zeros((2, 6)))[0].shape == (2, 41)
    env.close()
    legs = sandgait.SandgaitVectorEnv("sandgait/HexapodLegs-v1", 1)
    legs.reset(seed=0)
    with pytest.raises(sandgait.InvalidRequest, match="41 numbers a row, this task has 83"):
        legs.rollout_policy(exported, 5)
    legs.close()


def test_only_policies_of_continuous_actions_are_exported(tmp_path: Path) -> None:
    with pytest.raises(sandgait.InvalidRequest, match="DQNPolicy is no policy of PPO"):
        sandgait.export_onnx(DQN("MlpPolicy", "CartPole-v1", buffer_size=10, device="cpu"), tmp_path / "x.onnx")
    assert not (tmp_path / "x.onnx").exists()


@pytest.mark.parametrize("gait", ["tripod:2", "tripod", "policy"])
def test_an_evaluation_is_the_command_lines(gait: str, exported: Path, tmp_path: Path) -> None:
    policy = str(exported) if gait == "policy" else gait
    options = {"max_episode_steps": 60, "leg": "C"}
    told: list[float] = []
    table = sandgait.evaluate(policy, seeds=8, slopes=[0, 5], progress=lambda done, _: told.append(done), **options)
    report = tmp_path / "report.json"
    arguments = ["--seeds", "8", "--slopes", "0,5", "--options", json.dumps(options), "--json", str(report)]
    subprocess.run([*server.command(), "evaluate", policy, *arguments], check=True, capture_output=True)
    rows = json.loads(report.read_text())["results"]
    assert [row["slope_deg"] for row in rows] == [0.0, 5.0]
    assert set(rows[0]) == set(table)
    for name in table:
        for value, row in zip(table[name], rows, strict=True):
            assert value == row[name] or (row[name] is None and np.isnan(value))
    assert table.units["speed"] == "m/s"
    assert told == sorted(told)
    assert table.to_frame().shape == (2, len(table))


def test_wrong_evaluations_are_refused(tmp_path: Path) -> None:
    with pytest.raises(sandgait.InvalidRequest, match='policy "crawl" is unknown'):
        sandgait.evaluate("crawl")
    with pytest.raises(sandgait.InvalidRequest, match=r"no-such\.onnx"):
        sandgait.evaluate("no-such.onnx")
    with pytest.raises(sandgait.InvalidRequest, match="seeds: 1 is outside"):
        sandgait.evaluate("random", seeds=1)
