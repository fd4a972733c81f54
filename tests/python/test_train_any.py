"""`sandgait.train` with environments of other packages: any gymnasium `VectorEnv` with Box spaces."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Box, Discrete
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv, VectorWrapper
from gymnasium.wrappers import TimeLimit
from onnx.reference import ReferenceEvaluator
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

import sandgait
from conftest import ID
from sandgait.errors import InvalidRequest
from sandgait.external import VectorEnvironments
from sandgait.from_rust import read_policy

#: Small trainings: 64 samples a rollout.
SMALL: dict[str, Any] = {
    "settings": {"n_steps": 16, "batch_size": 32, "n_epochs": 2, "policy_kwargs": {"net_arch": [8]}},
    "progress": False,
}
LOW, HIGH = np.array([[0.3, -5.0]], np.float32), np.array([[0.7, 10.0]], np.float32)


class Counter(gymnasium.Env[Any, Any]):
    """Counts its episodes and their steps. Episode k ends after 2 + k % 3 steps, every second one by truncation."""

    observation_space = Box(-1000.0, 1000.0, (2, 1), np.float64)
    action_space = Box(LOW, HIGH)

    def __init__(self, broken: Callable[[int], Any] | None = None) -> None:
        self.episode, self.count, self.all, self.broken = -1, 0, 0, broken
        self.log: list[tuple[Any, Any]] = []

    def seen(self) -> Any:
        return np.array([[float(self.episode)], [float(self.count)]])

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        self.episode, self.count = self.episode + 1, 0
        return self.seen(), {"reward_of_reset": 1e6}

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        assert action.shape == (1, 2)
        assert self.action_space.contains(action)
        # The learner counts denormal numbers as zero; the environments' code must not.
        assert np.float32(1e-38) * np.float32(0.1) > 0.0
        self.log.append((self.seen().ravel(), action.ravel()))
        self.count, self.all = self.count + 1, self.all + 1
        ends = self.count == 2 + self.episode % 3
        infos = {"reward_count": float(self.count), "reward_action": float(action[0, 1]), "other": 1.0}
        seen = self.seen() if self.broken is None else self.broken(self.all)
        reward = infos["reward_count"] + infos["reward_action"]
        return seen, reward, ends and self.episode % 2 == 0, ends and self.episode % 2 == 1, infos


def counters(mode: AutoresetMode, num_envs: int = 4) -> SyncVectorEnv:
    return SyncVectorEnv([Counter] * num_envs, autoreset_mode=mode)


def rows(folder: Path) -> list[dict[str, str]]:
    with open(folder / "curve.csv", newline="") as file:
        return list(csv.DictReader(file))


def transitions(mode: AutoresetMode) -> tuple[list[list[tuple[float, ...]]], list[tuple[str, float]]]:
    """The first 40 transitions of each environment (observation, action, reward, both flags, next observation), and the
    means of the reward terms."""
    env = VectorEnvironments(counters(mode, 3))
    seen = env.reset(5)
    found: list[list[tuple[float, ...]]] = [[], [], []]
    while min(map(len, found)) < 40:
        actions = np.sin(seen + np.array([0.0, 1.0])).astype(np.float32)  # a function of the observation
        after, rewards, terminated, truncated, skipped, ended, last = env.step(actions)
        following = after.copy()
        following[ended] = last
        for i in np.flatnonzero(skipped == 0):
            row = (*seen[i], *actions[i], rewards[i], terminated[i], truncated[i], *following[i])
            found[i].append(tuple(map(float, row)))
        seen = after
    return [one[:40] for one in found], env.terms()


def test_all_autoreset_modes_give_the_same_transitions() -> None:
    (same, same_terms), (disabled, disabled_terms), (later, later_terms) = (
        transitions(mode) for mode in (AutoresetMode.SAME_STEP, AutoresetMode.DISABLED, AutoresetMode.NEXT_STEP)
    )
    assert same == disabled == later
    assert [row[-2:] for row in same[0][:6]] == [(0, 1), (0, 2), (1, 1), (1, 2), (1, 3), (2, 1)]
    assert [row[5:7] for row in same[0][:5]] == [(0, 0), (1, 0), (0, 0), (0, 0), (0, 1)]
    assert all(row[:2] != after[:2] for row, after in zip(same[0], same[0][1:], strict=False))
    for terms in (same_terms, disabled_terms, later_terms):
        assert {"reward_count", "reward_action"} <= dict(terms).keys()
    assert same_terms[0] == disabled_terms[0]


class Poisoned(VectorWrapper[Any, Any, Any, Any, Any]):
    """In steps that begin an episode, the reward is a large number and a flag is set."""

    def reset(self, **options: Any) -> Any:
        self.waiting = np.zeros(self.num_envs, np.bool_)
        return self.env.reset(**options)

    def step(self, actions: Any) -> Any:
        seen, rewards, terminated, truncated, infos = self.env.step(actions)
        rewards = np.where(self.waiting, self.poison, rewards)
        self.waiting, terminated = terminated | truncated, terminated | self.waiting
        return seen, rewards, terminated, truncated, infos

    poison = 0.0


def test_steps_that_begin_an_episode_are_not_learnt_from(tmp_path: Path) -> None:
    policies = []
    for poison in (0.0, 1e6):
        env = Poisoned(counters(AutoresetMode.NEXT_STEP))
        env.poison = poison
        training = sandgait.train(env, out=tmp_path / str(poison), timesteps=512, **SMALL)
        policies.append(training.policy.read_bytes())
        assert (training.curve["return"] < 100.0).all()
    assert policies[0] == policies[1]


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_reward_terms_are_columns_of_the_curve(tmp_path: Path, mode: AutoresetMode) -> None:
    env = counters(mode)
    training = sandgait.train(env, out=tmp_path, timesteps=512, **SMALL)
    table = rows(tmp_path)
    assert list(table[0])[:4] == ["steps", "seconds", "return", "level"]
    assert {"reward_count", "reward_action"} <= table[0].keys()
    assert "other" not in table[0]
    counts = [float(row["reward_count"]) for row in table]
    np.testing.assert_allclose(training.curve["reward_count"], counts, rtol=1e-6)
    # Episodes have 2, 3 or 4 steps, so the mean of the step's number in them is 1.5, 2 or 2.5.
    assert 1.4 < np.mean(counts) < 2.4
    assert all(-5.0 < float(row["reward_action"]) < 10.0 for row in table)
    events = EventAccumulator(str(tmp_path / "tensorboard"))
    events.Reload()
    assert {"reward/count", "reward/action"} <= set(events.Tags()["scalars"])
    assert len(events.Scalars("reward/count")) == 512 // 64


def test_the_policy_acts_as_in_the_training(tmp_path: Path) -> None:
    """Without noise, learning and normalization, the file's actions are those that the environments got."""
    settings = {**SMALL["settings"], "normalize": False, "learning_rate": 1e-12}
    settings["policy_kwargs"] = {"net_arch": [8], "log_std_init": -20.0}
    env = counters(AutoresetMode.SAME_STEP)
    training = sandgait.train(env, out=tmp_path, timesteps=256, settings=settings, progress=False)
    log = [pair for one in env.envs for pair in one.unwrapped.log]  # type: ignore[attr-defined]
    seen, actions = (np.array(column, np.float32) for column in zip(*log, strict=True))
    (played,) = ReferenceEvaluator(str(training.policy)).run(None, {"observation": seen})
    np.testing.assert_allclose(played, actions, atol=1e-5)
    assert np.ptp(actions, axis=0).min() > 0.001
    about = json.loads((tmp_path / "policy.json").read_text())
    assert [(c["name"], c["low"], c["high"]) for c in about["action"]] == [
        ("action[0]", pytest.approx(0.3), pytest.approx(0.7)),
        ("action[1]", -5.0, 10.0),
    ]
    assert [c["name"] for c in about["observation"]] == ["observation[0]", "observation[1]"]
    assert about["environment"]["observation_space"] == "Box(-1000.0, 1000.0, (2, 1), float64)"


class FirstHip(VectorWrapper[Any, Any, Any, Any, Any]):
    """Rewards the first number of the action."""

    def step(self, actions: Any) -> Any:
        seen, _, terminated, truncated, infos = self.env.step(actions)
        return seen, np.asarray(actions)[:, 0].astype(np.float64), terminated, truncated, infos


def test_a_wrapper_changes_what_is_learnt(tmp_path: Path) -> None:
    env = FirstHip(gymnasium.make_vec(ID, num_envs=16, max_episode_steps=20))
    settings = {"learning_rate": 3e-3, "n_steps": 21, "policy_kwargs": {"net_arch": [16]}}
    training = sandgait.train(env, out=tmp_path, timesteps=20_000, settings=settings, progress=False)
    returns = training.curve["return"]
    assert abs(returns[0]) < 5.0
    assert returns[-1] > 10.0
    assert training.score is None
    assert "reward_tracking" in training.curve
    about = json.loads((tmp_path / "settings.json").read_text())
    assert (about["task"], about["options"]["max_episode_steps"]) == (f"FirstHip({ID})", "20")
    env.close()
    changed = FirstHip(gymnasium.make_vec(ID, num_envs=16, max_episode_steps=30))
    with pytest.raises(sandgait.SandgaitError, match='its max_episode_steps is "20", not "30"'):
        sandgait.train(changed, out=tmp_path, settings=settings, resume=True, progress=False)
    changed.close()


def test_pendulum_is_learnt(tmp_path: Path) -> None:
    """A random policy has some -1290. After 100,000 steps with the default settings the last point of each of twelve
    trainings, seeds 0 to 11, was between -266 and -125."""
    env = gymnasium.make_vec("Pendulum-v1", num_envs=16)
    returns = sandgait.train(env, out=tmp_path, timesteps=100_000, seed=1, progress=False).curve["return"]
    assert returns[0] < -900.0
    assert returns[-3:].mean() > -400.0


def test_a_training_goes_on_with_new_episodes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    given = {**SMALL, "settings": {**SMALL["settings"], "learning_rate": 3e-3}}

    def run(timesteps: int, **more: Any) -> sandgait.Training:
        env = counters(AutoresetMode.SAME_STEP)
        return sandgait.train(env, out=tmp_path, timesteps=timesteps, **{**given, **more})

    about, before = read_policy(run(2048).weights)
    lines = rows(tmp_path)
    resumed = run(2048 + 64, resume=True, progress=True)
    assert "Counter cannot be saved" in capsys.readouterr().err
    assert "new episodes began at the resumption: Counter cannot be saved" in resumed.summary
    assert resumed.steps == 2048 + 64
    assert rows(tmp_path)[:-1] == lines
    again, after = read_policy(resumed.weights)
    # An update has two epochs of two minibatches, and a step of Adam moves a weight by some 0.003.
    assert int(again["adam_steps"]) == int(about["adam_steps"]) + 4
    assert 1e-4 < np.abs(after["actor.0.weights"] - before["actor.0.weights"]).max() < 0.02
    assert (after["observations.count"] > before["observations.count"]).all()
    for more, words in (
        ({"seed": 1}, "its seed is 0, not 1"),
        ({"settings": {**given["settings"], "gamma": 0.5}}, "its gamma is 0.99, not 0.5"),
    ):
        with pytest.raises(sandgait.SandgaitError, match=words):
            run(512, resume=True, **more)
    with pytest.raises(sandgait.SandgaitError, match=r"its task is Counter, not FirstHip\(Counter\)"):
        sandgait.train(FirstHip(counters(AutoresetMode.SAME_STEP)), out=tmp_path, resume=True, **given)
    limited = SyncVectorEnv([lambda: TimeLimit(Counter(), 9)] * 4, autoreset_mode=AutoresetMode.SAME_STEP)
    with pytest.raises(sandgait.SandgaitError, match='its wrappers is "", not "TimeLimit"'):
        sandgait.train(limited, out=tmp_path, resume=True, **given)
    with pytest.raises(sandgait.SandgaitError, match="its n_envs is 4, not 5"):
        sandgait.train(counters(AutoresetMode.SAME_STEP, 5), out=tmp_path, resume=True, **given)
    with pytest.raises(sandgait.SandgaitError, match="results of another training"):
        run(512)


def test_what_an_environment_raises_comes_out_and_leaves_a_checkpoint(tmp_path: Path) -> None:
    def broken(count: int) -> Any:
        if count == 100:
            raise ZeroDivisionError("on purpose")
        return np.zeros((2, 1))

    env = SyncVectorEnv([lambda: Counter(broken)] * 4)
    with pytest.raises(ZeroDivisionError, match="on purpose") as raised:
        sandgait.train(env, out=tmp_path, timesteps=10_000, **SMALL)
    assert "go on with --resume" in raised.value.__notes__[0]
    assert list((tmp_path / "checkpoints").glob("*.safetensors"))


def space(observation: Any = None, action: Any = None, **changes: Any) -> VectorEnv[Any, Any, Any]:
    env = counters(AutoresetMode.NEXT_STEP)
    env.single_observation_space = observation or env.single_observation_space
    env.single_action_space = action or env.single_action_space
    vars(env).update(changes)
    return env


def test_wrong_uses_are_refused_in_a_line(tmp_path: Path) -> None:
    def giving(value: Any) -> VectorEnv[Any, Any, Any]:
        return SyncVectorEnv([lambda: Counter(lambda count: value if count == 3 else np.zeros((2, 1)))] * 2)

    nan = np.array([[0.0], [np.nan]])
    wrong: list[tuple[Any, dict[str, Any], str]] = [
        (
            gymnasium.make("Pendulum-v1"),
            {},
            r"PendulumEnv is a single environment; .*make_vec\('Pendulum-v1', num_envs=8\)",
        ),
        (Counter(), {}, r"Counter is a single environment; .*SyncVectorEnv\(\[lambda: Counter"),
        (7, {}, "int is neither the name of a task nor a gymnasium VectorEnv"),
        (gymnasium.make_vec("CartPole-v1", num_envs=2), {}, r"action space is Discrete\(2\)"),
        (space(observation=Discrete(3)), {}, r"observation space is Discrete\(3\)"),
        (space(action=Box(-np.inf, np.inf, (2,))), {}, "action space has no bounds"),
        (space(action=Box(-1, 1, (2,), np.int64)), {}, "numbers of type int64"),
        (space(observation=Box(-1, 1, (0,))), {}, "has no numbers"),
        (space(metadata={}), {}, r'metadata\["autoreset_mode"\] is None'),
        (space(), {"address": "127.0.0.1:1"}, "address: this is for tasks by name"),
        (space(), {"leg": "C"}, "leg: this is for tasks by name"),
        (space(), {"settings": {"n_envs": 5}}, "n_envs: 5 is not the environment's num_envs, 4"),
        (space(), {"settings": {"mirror": True}}, "mirror: left and right"),
        (space(), {"settings": {"env_kwargs": {"a": 1}}}, "env_kwargs: the environments are made already"),
        (space(), {"settings": {"gama": 1}}, 'setting "gama" is unknown'),
        (space(), {"settings": {"batch_size": 10**6}}, "batch_size: 1000000 is more than"),
        (space(), {"resume": True}, "no checkpoint"),
    ]
    for env, given, words in wrong:
        with pytest.raises(sandgait.SandgaitError, match=words) as raised:
            sandgait.train(env, out=tmp_path / "out", **{"progress": False, **given})
        assert "\n" not in str(raised.value)
        assert not (tmp_path / "out").exists(), words
    with pytest.raises(InvalidRequest, match=r"env: step's observations\[0\]\[1\]\[0\] is nan, not a finite number"):
        sandgait.train(giving(nan), out=tmp_path / "nan", timesteps=100, progress=False)
    seen, column = np.zeros((4, 2, 1)), np.zeros(4)
    shape = r"have the shape \({}\), not \({}\)"
    for method, result, words in (
        ("step", (seen[..., 0], column, column, column, {}), "observations " + shape.format("4, 2", "4, 2, 1")),
        ("step", (seen, column[1:], column, column, {}), "rewards " + shape.format("3,", "4,")),
        ("step", (seen, column, column, column[:, None], {}), "truncated " + shape.format("4, 1", "4,")),
        ("step", (seen, column + np.inf, column, column, {}), r"step's rewards\[0\] is inf"),
        ("reset", (np.full((4, 2, 1), None), {}), "reset's observations are of type object, not numbers"),
    ):
        env = space()
        setattr(env, method, lambda *_, result=result, **__: result)
        with pytest.raises(InvalidRequest, match=words):
            sandgait.train(env, out=tmp_path / words[:9], timesteps=100, progress=False)


def test_the_default_settings_suit_the_number_of_environments(tmp_path: Path) -> None:
    env = counters(AutoresetMode.SAME_STEP, 300)
    sandgait.train(env, out=tmp_path, timesteps=4800, settings={"n_envs": 300}, progress=False)
    used = json.loads((tmp_path / "settings.json").read_text())["hyperparameters"]
    assert (used["n_envs"], used["n_steps"], used["batch_size"]) == (300, 16, 150)
