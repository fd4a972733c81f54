"""gymnasium's vector wrappers around our environments, and the same around its own SyncVectorEnv as the reference."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv
from gymnasium.wrappers import vector

import sandgait

ID = sandgait.TASKS[0]

#: Number of steps; more than one episode ends within them.
STEPS = 9


def halved(rows: np.ndarray) -> np.ndarray:
    return rows / 2


WRAPPERS: dict[str, Callable[[VectorEnv], VectorEnv]] = {
    "VectorizeTransformObservation": lambda env: vector.VectorizeTransformObservation(
        env, gymnasium.wrappers.TransformObservation, func=halved, observation_space=env.single_observation_space
    ),
    "VectorizeTransformAction": lambda env: vector.VectorizeTransformAction(
        env, gymnasium.wrappers.TransformAction, func=halved, action_space=env.single_action_space
    ),
    "VectorizeTransformReward": lambda env: vector.VectorizeTransformReward(
        env, gymnasium.wrappers.TransformReward, func=lambda reward: reward / 2
    ),
    "DictInfoToList": vector.DictInfoToList,
    "TransformObservation": lambda env: vector.TransformObservation(env, halved, env.observation_space),
    "FlattenObservation": vector.FlattenObservation,
    "ReshapeObservation": lambda env: vector.ReshapeObservation(env, (41, 1)),
    "RescaleObservation": lambda env: vector.RescaleObservation(env, np.float32(-1), np.float32(1)),
    "DtypeObservation": lambda env: vector.DtypeObservation(env, np.float32),
    "NormalizeObservation": vector.NormalizeObservation,
    "TransformAction": lambda env: vector.TransformAction(env, halved, env.action_space),
    "ClipAction": vector.ClipAction,
    "RescaleAction": lambda env: vector.RescaleAction(env, np.float32(-2), np.float32(2)),
    "TransformReward": lambda env: vector.TransformReward(env, lambda reward: reward / 2),
    "ClipReward": lambda env: vector.ClipReward(env, -0.1, 0.1),
    "NormalizeReward": vector.NormalizeReward,
    "RecordEpisodeStatistics": vector.RecordEpisodeStatistics,
}

#: Wrappers for observations that are images or dictionaries.
OTHER_OBSERVATIONS = {"FilterObservation", "GrayscaleObservation", "ResizeObservation"}

#: Wrappers that import packages that this project does not: array-api-compat, jax, OpenCV.
OTHER_PACKAGES = {"ArrayConversion", "JaxToNumpy", "JaxToTorch", "NumpyToTorch", "HumanRendering"}


def test_no_wrapper_is_left_out() -> None:
    assert {*WRAPPERS, *OTHER_OBSERVATIONS, *OTHER_PACKAGES, "RecordVideo"} == set(vector.__all__)


def same(ours: Any, theirs: Any) -> bool:
    """Whether values are equal. Keys whose mask is empty may be missing in `theirs`."""
    if isinstance(theirs, dict):
        return all(same(ours[key], theirs[key]) for key in theirs if key not in ("t", "_t"))
    if isinstance(theirs, (list, tuple)):
        return len(ours) == len(theirs) and all(map(same, ours, theirs))
    return np.array_equal(np.asarray(ours), np.asarray(theirs))


@pytest.mark.parametrize("name", WRAPPERS)
def test_wrappers_give_the_same_as_around_gymnasiums_own(name: str) -> None:
    """Values are compared after ends of episodes, too, with infos. NEXT_STEP is the default of make_vec."""
    ours = WRAPPERS[name](gymnasium.make_vec(ID, num_envs=3, max_episode_steps=4))
    theirs = WRAPPERS[name](SyncVectorEnv([lambda: sandgait.SandgaitEnv(ID, max_episode_steps=4)] * 3))
    assert ours.metadata["autoreset_mode"] is theirs.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    assert same(ours.reset(seed=1)[0], theirs.reset(seed=1)[0])
    space = theirs.action_space
    assert isinstance(space, spaces.Box)
    random, ended = np.random.default_rng(0), 0
    for _ in range(STEPS):
        actions = random.uniform(-1, 1, space.shape).astype(np.float32)
        mine, reference = ours.step(actions.copy()), theirs.step(actions.copy())  # some wrappers write into them
        for a, b in zip(mine[:4], reference[:4], strict=True):
            assert same(a, b)
        assert same(mine[4], reference[4])
        ended += int(np.asarray(reference[3]).sum())
    assert ended == 6
    ours.close()
    theirs.close()


def test_pictures_through_wrappers(tmp_path: Path) -> None:
    size = {"render_mode": "rgb_array", "render_size": (64, 48)}
    env = vector.RecordVideo(gymnasium.make_vec(ID, num_envs=2, **size), str(tmp_path / "videos"), video_length=3)
    env.reset(seed=1)
    for _ in range(4):
        env.step(env.action_space.sample())
    env.close()
    assert list((tmp_path / "videos").glob("*.mp4"))


def test_next_step_is_the_default_and_same_step_an_option() -> None:
    env = gymnasium.make_vec(ID, num_envs=2, autoreset_mode="SAME_STEP", max_episode_steps=2)
    assert env.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    env.reset(seed=1)
    env.step(env.action_space.sample())
    assert "final_obs" in env.step(env.action_space.sample())[4]
    copies = env.unwrapped.fork(2)
    assert copies.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    copies.close()
    env.close()


BEYOND = np.array([2.0, -3.0, np.inf, -np.inf, 1.0, 0.5], np.float32)


def test_actions_are_clipped_if_asked_for() -> None:
    inside = np.clip(BEYOND, -1, 1)
    one, reference = (gymnasium.make(ID, clip_actions=clip) for clip in (True, False))
    first = [env.reset(seed=2)[0] for env in (one, reference)]
    assert np.array_equal(*first)
    assert np.array_equal(one.step(BEYOND)[0], reference.step(inside)[0])
    many = gymnasium.make_vec(ID, num_envs=2, clip_actions=True)
    plain = sandgait.SandgaitVectorEnv(ID, 2)
    for env in (many, plain):
        env.reset(seed=2)
    kept = np.stack([BEYOND, BEYOND])
    assert np.array_equal(many.step(kept)[0], plain.step(np.clip(kept, -1, 1))[0])
    assert np.array_equal(kept, [BEYOND, BEYOND]), "the caller's array is the caller's"
    with pytest.raises(sandgait.InvalidRequest, match="NaN") as told:
        many.step(np.full((2, 6), np.nan))
    assert "clip_actions" not in str(told.value)
    for env in (one, reference, many, plain):
        env.close()


def test_the_error_of_a_refused_action_mentions_clipping() -> None:
    words = r"^actions\[0\]\[0\]: 2 .* is outside \[-1, 1\]; clip_actions=True clips"
    for address in (None, [None, None]):
        many = sandgait.SandgaitVectorEnv(ID, 2, address)
        many.reset(seed=0)
        with pytest.raises(sandgait.InvalidRequest, match=words):
            many.step(np.stack([BEYOND, BEYOND]))
        many.step(np.zeros((2, 6)))
        many.close()
    one = gymnasium.make(ID)
    one.reset(seed=0)
    with pytest.raises(sandgait.InvalidRequest, match=words.replace(r"actions\[0\]", "action")):
        one.step(BEYOND)
    with pytest.raises(sandgait.InvalidRequest, match=r"^action\[0\]: NaN"):
        one.step(np.full(6, np.nan, np.float32))
    one.step(np.zeros(6, np.float32))
    one.close()


@pytest.mark.parametrize("task", [task for task in sandgait.TASKS if "/Hexapod" in task])
def test_the_registered_time_limit_is_the_servers(task: str) -> None:
    spec = gymnasium.spec(task)
    told = {t.id: t.max_episode_steps for t in sandgait.describe()[1]}
    assert spec.max_episode_steps == told[task]


def test_max_episode_steps_limits_the_episode() -> None:
    """In `make` gymnasium counts the steps, in `make_vec` the server; both allow more than the task's own 500 steps."""
    standing = np.zeros(6, np.float32)
    for limit in (510, 3):
        one = gymnasium.make(ID, max_episode_steps=limit)
        assert one.spec is not None
        assert one.spec.max_episode_steps == limit
        one.reset(seed=0)
        flags = [one.step(standing)[2:4] for _ in range(limit)]
        assert flags == [(False, False)] * (limit - 1) + [(False, True)]
        one.close()
        many = gymnasium.make_vec(ID, num_envs=2, max_episode_steps=limit)
        many.reset(seed=0)
        for k in range(limit):
            truncated = many.step(np.zeros((2, 6), np.float32))[3]
            assert truncated.all() == truncated.any() == (k == limit - 1)
        many.close()


def test_an_episode_truncated_by_gymnasium_equals_the_servers() -> None:
    """The bits are equal, also in the next episode."""
    counted, own = gymnasium.make(ID, max_episode_steps=7), sandgait.SandgaitEnv(ID, max_episode_steps=7)
    assert np.array_equal(counted.reset(seed=5)[0], own.reset(seed=5)[0])
    for k in range(20):
        mine, reference = (env.step(np.full(6, 0.3, np.float32)) for env in (counted, own))
        assert np.array_equal(mine[0], reference[0])
        assert mine[1:] == reference[1:]
        if k % 7 == 6:
            assert mine[3]
            assert np.array_equal(counted.reset()[0], own.reset()[0])
    counted.close()
    own.close()
