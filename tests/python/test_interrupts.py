"""Ctrl-C during a step: the step is still carried out, and the next call gets its answer."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

import sandgait
from conftest import HEARS_CTRL_C

ID = sandgait.TASKS[0]

#: Interrupts every second step with a real signal. The server is paused meanwhile, so its answer has not arrived.
INTERRUPTED = f"""
{HEARS_CTRL_C}
import os, threading, time
import numpy as np
import sandgait
from sandgait import server

LIMIT, STEPS = 7, 60
def action(k):
    return np.sin(0.3 * k + np.arange(6)).astype(np.float32)

def pause(pid):
    os.kill(pid, signal.SIGSTOP)
    os.waitpid(pid, os.WUNTRACED)  # all its threads have stopped

def strike():
    time.sleep(0.02)
    os.kill(os.getpid(), signal.SIGINT)

calm = sandgait.SandgaitEnv({ID!r}, max_episode_steps=LIMIT)
env = sandgait.SandgaitEnv({ID!r}, max_episode_steps=LIMIT, isolated=True)
assert np.array_equal(calm.reset(seed=1)[0], env.reset(seed=1)[0])
struck = ends = 0
for k in range(STEPS):
    expected = calm.step(action(k))
    if k % 2 == 0 or k % LIMIT == LIMIT - 1:
        pause(server._server.process.pid)
        threading.Thread(target=strike).start()
        try:
            env.step(action(k))
        except KeyboardInterrupt:
            struck += 1
        os.kill(server._server.process.pid, signal.SIGCONT)
    answer = env.step(action(k))
    assert np.array_equal(answer[0], expected[0]), k
    assert answer[1:] == expected[1:], k
    if answer[3]:
        ends += 1
        assert np.array_equal(calm.reset()[0], env.reset()[0]), k
assert (struck, ends) == (34, 8), (struck, ends)
"""


def test_no_answer_is_lost_by_ctrl_c() -> None:
    done = subprocess.run([sys.executable, "-c", INTERRUPTED], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr


def break_next_read(env: sandgait.SandgaitEnv | sandgait.SandgaitVectorEnv, shard: int) -> None:
    """Raises KeyboardInterrupt in the next wait for an answer of this shard's server."""
    stream = env._session._doors[shard]._link.stream
    assert stream is not None

    def broken() -> None:
        del stream.receive  # restores the original method for later waits
        raise KeyboardInterrupt

    stream.receive = broken  # type: ignore[method-assign, assignment]


def interrupted(env: sandgait.SandgaitEnv, action: np.ndarray) -> None:
    """Makes a step whose wait is interrupted."""
    break_next_read(env, 0)
    with pytest.raises(KeyboardInterrupt):
        env.step(action)


def test_an_episodes_end_is_told_after_an_interrupt() -> None:
    env = sandgait.SandgaitEnv(ID, max_episode_steps=2, isolated=True)
    env.reset(seed=0)
    action = np.full(6, 0.2, np.float32)
    env.step(action)
    interrupted(env, action)
    for call in (env.save, lambda: env.fork(2)):
        with pytest.raises(sandgait.OutOfOrder, match="a step was interrupted; call step for its answer, or reset"):
            call()
    assert env.step(action)[3], "the end, though the step was interrupted"
    with pytest.raises(sandgait.OutOfOrder, match="the episode is over"):
        env.step(action)
    env.close()


def test_a_reset_after_an_interrupt_begins_the_next_episode() -> None:
    env, calm = (sandgait.SandgaitEnv(ID, max_episode_steps=2, isolated=i) for i in (True, False))
    action = np.full(6, 0.2, np.float32)
    for e in (env, calm):
        e.reset(seed=0)
        e.step(action)
    interrupted(env, action)
    calm.step(action)
    assert np.array_equal(env.reset()[0], calm.reset()[0]), "episode 1, not 2"
    assert np.array_equal(env.step(action)[0], calm.step(action)[0])
    env.close()
    calm.close()


def test_another_action_is_told_that_it_was_not_taken() -> None:
    env, calm = (sandgait.SandgaitEnv(ID, isolated=i) for i in (True, False))
    first, second = np.full(6, 0.2, np.float32), np.full(6, -0.4, np.float32)
    for e in (env, calm):
        e.reset(seed=0)
    interrupted(env, first)
    with pytest.warns(UserWarning, match="the answer of the step that was interrupted"):
        answer = env.step(second)
    assert np.array_equal(answer[0], calm.step(first)[0])
    assert np.array_equal(env.step(second)[0], calm.step(second)[0])
    env.close()
    calm.close()


def test_an_interrupted_batch_over_several_servers_is_taken_up() -> None:
    env = sandgait.SandgaitVectorEnv(ID, 4, [None, None], max_episode_steps=3, isolated=True)
    calm = sandgait.SandgaitVectorEnv(ID, 4, max_episode_steps=3)
    for e in (env, calm):
        e.reset(seed=0)
    for k in range(6):
        actions = np.full((4, 6), 0.1 * k, np.float32)
        env.send(actions)
        break_next_read(env, 1)
        with pytest.raises(KeyboardInterrupt):
            env.recv()
        with pytest.raises(sandgait.OutOfOrder, match="in flight already; call recv first"):
            env.step(actions)
        for a, b in zip(env.recv()[:4], calm.step(actions)[:4], strict=True):
            assert np.array_equal(a, b)
    env.close()
    calm.close()
