"""Properties of every task: the checks of both libraries, equal seeds, snapshots."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as sb3_check_env

import sandgait

GAIT = "sandgait/HexapodGait-v1"

#: Every task, with every control mode.
TASKS: list[tuple[str, dict[str, Any]]] = [
    *((task, {}) for task in sandgait.TASKS),
    *((GAIT, {"control": control}) for control in ("hip_target", "torque", "clock")),
    ("sandgait/HexapodLegs-v2", {"turn": [-0.5, 0.5], "slope_deg": 5}),
]

every_task = pytest.mark.parametrize(("task", "options"), TASKS)


@every_task
def test_both_check_envs_find_nothing(task: str, options: dict[str, Any]) -> None:
    """Warnings are errors here: see pyproject.toml."""
    env = gymnasium.make(task, **options)
    check_env(env.unwrapped)
    sb3_check_env(env.unwrapped)
    env.close()


def history(task: str, envs: int, options: dict[str, Any]) -> list[npt.NDArray[np.float32]]:
    """Rows of 60 steps; the same actions in every environment."""
    env = sandgait.SandgaitVectorEnv(task, envs, max_episode_steps=25, **options)
    actions = np.random.default_rng(1).uniform(-1, 1, (60, len(env.task.action))).astype(np.float32)
    rows = [env.reset(seed=3)[0]]
    for action in actions:
        observations, rewards, *_ = env.step(np.tile(action, (envs, 1)))
        rows += [observations, rewards.astype(np.float32)]
    env.close()
    return rows


@every_task
def test_equal_seeds_give_equal_bits(task: str, options: dict[str, Any]) -> None:
    """For one environment and for several, over ends of episodes."""
    first, again, alone = history(task, 3, options), history(task, 3, options), history(task, 1, options)
    for a, b, c in zip(first, again, alone, strict=True):
        assert np.array_equal(a, b)
        assert np.array_equal(a[:1], c)


@every_task
def test_a_snapshot_goes_on_with_the_same_bits(task: str, options: dict[str, Any]) -> None:
    env = sandgait.SandgaitVectorEnv(task, 2, max_episode_steps=20, **options)
    env.reset(seed=5)
    env.action_space.seed(0)
    actions = [env.action_space.sample() for _ in range(40)]
    for action in actions[:10]:
        env.step(action)
    snapshot = env.save()
    first = [env.step(action)[0] for action in actions[10:]]
    env.restore(snapshot)
    again = [env.step(action)[0] for action in actions[10:]]
    assert np.array_equal(first, again)
    env.close()


def test_the_clock_walks_without_a_policy() -> None:
    """Action 0 is the alternating tripod at 2.5 Hz; cost of transport and slip come from `info`."""
    env = sandgait.SandgaitEnv(GAIT, control="clock")
    env.reset(seed=0)
    infos = [env.step(np.zeros(10, np.float32))[4] for _ in range(200)]
    total = {name: sum(info[name] for info in infos) for name in ("work", "x_velocity", "hip_turn")}
    distance = total["x_velocity"] / env.task.control_rate
    assert total["hip_turn"] == pytest.approx(4 * 2.5 * 2 * np.pi, rel=0.02)
    assert 0.2 < distance / 4 < 0.6
    assert 0.0 < 1 - distance / (0.04 * total["hip_turn"]) < 1.0, "slip"
    assert infos[0]["weight"] == pytest.approx(0.15 * 9.80665, rel=1e-5)
    assert 0.1 < total["work"] / (infos[0]["weight"] * distance) < 10.0, "cost of transport"
    env.close()


def test_wrong_options_are_refused_by_name() -> None:
    with pytest.raises(sandgait.InvalidRequest, match='control "magic" is unknown; known: hip_speed'):
        sandgait.SandgaitEnv(GAIT, control="magic")
    with pytest.raises(sandgait.InvalidRequest, match="control: sandgait/HexapodLegs-v1 has no such option"):
        sandgait.SandgaitEnv("sandgait/HexapodLegs-v1", control="clock")
    env = sandgait.SandgaitEnv(GAIT)
    with pytest.raises(sandgait.InvalidRequest, match="rocks: sandgait/HexapodGait-v1 has no such option"):
        env.reset(options={"rocks": {"count": 2}})
    env.close()


def test_a_curriculum_changes_the_difficulty_at_resets() -> None:
    env = sandgait.SandgaitVectorEnv("sandgait/HexapodTerrain-v1", 16, difficulty=0.0)
    actions = np.full((16, 6), 0.4, np.float32)
    for difficulty, spread in ((None, 0.0), (0.5, 5.0), (1.0, 10.0)):
        env.reset(seed=0, options={} if difficulty is None else {"difficulty": difficulty})
        slopes = env.step(actions)[4]["slope_deg"]
        assert np.abs(slopes).max() <= spread + 1e-5
        assert np.ptp(slopes) >= spread
    env.reset(seed=0, options={"difficulty": 1.0, "randomize": {"slope_deg": [3.0, 3.0]}})
    assert env.step(actions)[4]["slope_deg"] == pytest.approx(3.0)
    env.close()


@pytest.mark.parametrize("mode", ["SAME_STEP", "NEXT_STEP"])
def test_options_of_several_resets_are_all_in_force(mode: str) -> None:
    """The rows equal those of environments that were made with these options, over ends of episodes."""
    gait: dict[str, Any] = {"max_episode_steps": 10, "autoreset_mode": mode}
    env = sandgait.SandgaitVectorEnv(GAIT, 2, **gait)
    env.reset(seed=0)
    for options in ({"leg": "C"}, {"slope_deg": 5, "reset_mask": np.array([True, False])}, {"payload": 0.02}):
        env.reset(seed=0, options=options)
    actions = np.full((2, 6), 0.3, np.float32)
    rows = [env.step(actions)[0] for _ in range(35)]
    env.close()
    for index, slope in ((0, 5), (1, 0)):
        made = sandgait.SandgaitVectorEnv(GAIT, 1, leg="C", slope_deg=slope, payload=0.02, **gait)
        made.reset(seed=index)
        assert all(np.array_equal(made.step(actions[:1])[0][0], row[index]) for row in rows)
        made.close()


def test_a_dictionary_given_to_a_reset_changes_its_own_keys_alone() -> None:
    env = sandgait.SandgaitEnv("sandgait/HexapodTerrain-v1", difficulty=0.0, randomize={"turning_point": [0.7, 0.7]})
    env.reset(seed=0, options={"randomize": {"patch_length": [0.2, 0.2]}})
    env.reset(seed=0, options={"slope_deg": 3.0})
    info = env.step(np.zeros(6, np.float32))[4]
    drawn = [info[name] for name in ("difficulty", "turning_point", "patch_length", "slope_deg")]
    assert drawn == pytest.approx([0.0, 0.7, 0.2, 3.0])
    env.close()


@pytest.mark.parametrize(
    ("name", "version"),
    [("HexapodGait", "v1"), ("HexapodLegs", "v2"), ("HexapodRocks", "v1"), ("HexapodTerrain", "v1")],
)
def test_earlier_versions_name_the_present_one(name: str, version: str) -> None:
    old, new = f"sandgait/{name}-v0", f"sandgait/{name}-{version}"
    with pytest.warns(DeprecationWarning, match=version), pytest.raises(gymnasium.error.DeprecatedEnv, match=new):
        gymnasium.make(old)
    with pytest.raises(sandgait.InvalidRequest, match=f'task "{old}" has been replaced by "{new}"; see CHANGELOG'):
        sandgait.SandgaitVectorEnv(old, 1)


def test_a_stroke_returns_its_efficiency() -> None:
    """A circular stroke with a locked knee and a constant hip speed; every figure is computed again from `info`."""
    env = sandgait.SandgaitEnv("sandgait/LegStroke-v0")
    env.reset(seed=0)
    rewards, infos = [], []
    for k in range(50):
        _, reward, terminated, truncated, info = env.step([0.6, 0.0])
        rewards.append(reward)
        infos.append(info)
        assert (terminated, truncated) == (k == 49, False)
    thrust, work = (sum(info[name] for info in infos) for name in ("thrust", "work"))
    efficiency = thrust / env.task.control_rate * 0.2 / work
    assert 0.1 < efficiency < 1.0
    assert infos[-1]["efficiency"] == pytest.approx(efficiency, rel=1e-4)
    missing = max(0.0, 1 - infos[-1]["mean_lift"] / 1.7)
    exit_penalty = sum(info["reward_exit"] for info in infos)
    assert sum(rewards) == pytest.approx(efficiency - 2 * missing + exit_penalty, abs=1e-4)
    with pytest.raises(sandgait.InvalidRequest, match=r"stroke.start: .* begins .* mm in the sand"):
        env.reset(options={"stroke": {"start": [0.0, 0.0]}})
    env.close()
