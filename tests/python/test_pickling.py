"""Environments are pickled and copied: by their arguments before the first reset, with their state after it."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from functools import partial
from typing import Any

import cloudpickle
import gymnasium
import numpy as np
import pytest
from stable_baselines3.common.vec_env import SubprocVecEnv

import sandgait
from conftest import RemoteServer

ID = sandgait.TASKS[0]

COPIES: list[Callable[[Any], Any]] = [lambda env: pickle.loads(pickle.dumps(env)), copy.deepcopy]


def action(k: int) -> np.ndarray:
    return np.sin(0.4 * k + np.arange(6)).astype(np.float32)


@pytest.mark.parametrize("copied", COPIES, ids=["pickle", "deepcopy"])
def test_a_live_environment_and_its_copy_go_on_with_the_same_bits(copied: Callable[[Any], Any]) -> None:
    """This includes ends of episodes, gymnasium's own step counter, options of a reset, and the stream of seeds."""
    env = gymnasium.make(ID, leg="C", max_episode_steps=9)
    env.reset(seed=3, options={"slope_deg": 5.0})
    for k in range(5):
        env.step(action(k))
    other = copied(env)
    env.action_space.seed(1)
    other.action_space.seed(1)
    for k in range(5, 25):
        mine, theirs = env.step(action(k)), other.step(action(k))
        assert np.array_equal(mine[0], theirs[0])
        assert mine[1:] == theirs[1:]
        if mine[2] or mine[3]:
            assert np.array_equal(env.reset()[0], other.reset()[0])
    assert other.unwrapped._session is not env.unwrapped._session
    for made in (env, other):
        made.close()


@pytest.mark.parametrize("copied", COPIES, ids=["pickle", "deepcopy"])
@pytest.mark.parametrize("mode", ["NEXT_STEP", "SAME_STEP"])
def test_a_live_batch_too(copied: Callable[[Any], Any], mode: str) -> None:
    """Copies are made in every state; with NEXT_STEP also between the end of an episode and the begin of the next."""
    env = gymnasium.make_vec(ID, num_envs=3, autoreset_mode=mode, max_episode_steps=4)
    env.reset(seed=3)
    for k in range(10):
        other = copied(env)
        mine, theirs = (e.step(np.tile(action(k), (3, 1))) for e in (env, other))
        for a, b in zip(mine[:4], theirs[:4], strict=True):
            assert np.array_equal(a, b)
        other.close()
    env.close()


def test_an_episode_that_is_over_stays_over() -> None:
    env = sandgait.SandgaitEnv(ID, max_episode_steps=2)
    env.reset(seed=1)
    env.step(action(0))
    env.step(action(1))
    other = copy.deepcopy(env)
    for made in (env, other):
        with pytest.raises(sandgait.OutOfOrder, match="the episode is over"):
            made.step(action(2))
    assert np.array_equal(env.reset()[0], other.reset()[0])
    assert np.array_equal(env.step(action(3))[0], other.step(action(3))[0])


def test_before_the_first_reset_the_arguments_are_enough(remote: RemoteServer) -> None:
    """The copy opens no session before it is used, so it can be made on a machine that cannot reach the server."""
    env = sandgait.SandgaitVectorEnv(ID, 2, remote.address, leg="C", clip_actions=True)
    data = pickle.dumps(env)
    other = pickle.loads(data)
    assert other.task == env.task
    assert np.array_equal(other.reset(seed=1)[0], env.reset(seed=1)[0])
    wild = np.full((2, 6), 3.0)
    assert np.array_equal(other.step(wild)[0], env.step(wild)[0])
    remote.kill()
    with pytest.raises(sandgait.ServerLost):
        pickle.loads(data).reset()


def test_pickling_errors_state_the_reason() -> None:
    env = sandgait.SandgaitVectorEnv(ID, 2)
    env.reset(seed=0)
    env.send(np.zeros((2, 6)))
    with pytest.raises(sandgait.OutOfOrder, match="pickle: a step is in flight"):
        pickle.dumps(env)
    env.recv()
    kept = pickle.loads(pickle.dumps(env))
    kept.close()
    with pytest.raises(sandgait.SandgaitError, match="closed"):
        kept.step(np.zeros((2, 6)))
    env.close()
    with pytest.raises(sandgait.SandgaitError, match="closed"):
        pickle.dumps(env)


def test_a_closure_over_an_environment_is_pickled() -> None:
    """SubprocVecEnv and AsyncVectorEnv pickle such closures."""
    env = sandgait.SandgaitEnv(ID, leg="C")
    make = cloudpickle.loads(cloudpickle.dumps(lambda: env))
    assert np.array_equal(make().reset(seed=2)[0], env.reset(seed=2)[0])


def one(k: int) -> gymnasium.Env:
    return gymnasium.make(ID, threads=1, max_episode_steps=5, command=[0.2 + 0.1 * k] * 2)


def test_sb3s_subprocesses_simulate_on_their_own() -> None:
    env = SubprocVecEnv([partial(one, k) for k in range(2)])
    env.seed(0)
    rows = env.reset()
    assert rows[:, -2] == pytest.approx([0.2, 0.3])
    alone = [gymnasium.make(ID, max_episode_steps=5, command=[0.2 + 0.1 * k] * 2) for k in range(2)]
    for k, single in enumerate(alone):
        assert np.array_equal(single.reset(seed=k)[0], rows[k])
    steps = env.step(np.stack([action(k) for k in range(2)]))[0]
    assert all(np.array_equal(single.step(action(k))[0], steps[k]) for k, single in enumerate(alone))
    env.close()


def test_a_large_relief_is_copied() -> None:
    """The heights of a relief are options, and the largest ones are longer than anything else in a snapshot."""
    side = np.arange(256)
    heights = (0.05 * np.sin(0.1 * side) + 0.03 * np.cos(0.07 * side)[:, None]).tolist()
    relief = {"heights": heights, "spacing": 0.1}
    env = sandgait.SandgaitVectorEnv("sandgait/LeggedVelocity-v1", 2, ground="rigid", relief=relief)
    env.reset(seed=3)
    rows = np.full((2, 12), 0.2, np.float32)
    env.step(rows)
    saved, fork = env.save(), env.fork(2, 0)
    others = [copied(env) for copied in COPIES]
    wanted = env.step(rows)[0]
    for other in others:
        np.testing.assert_array_equal(other.step(rows)[0], wanted)
    np.testing.assert_array_equal(fork.step(rows)[0], np.stack([wanted[0]] * 2))
    env.restore(saved)
    np.testing.assert_array_equal(env.step(rows)[0], wanted)
    for made in (env, fork, *others):
        made.close()
