"""Environments in this process: memory of arrays, Ctrl-C during every wait, threads, forks, and the end of Python."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sandgait
from conftest import HEARS_CTRL_C, ID

ROCKS = "sandgait/HexapodRocks-v1"


def action(n: int, k: int) -> np.ndarray:
    return np.sin(0.3 * k + np.arange(6 * n)).astype(np.float32).reshape(n, 6)


def test_arrays_are_the_callers_own() -> None:
    env = sandgait.SandgaitVectorEnv(ID, 40, autoreset_mode="SAME_STEP", max_episode_steps=3)
    env.reset(seed=0)
    kept = []
    for k in range(8):
        env.send(action(40, k))
        batch = env.recv_batch()
        kept.append([(array, array.copy()) for array in batch])
        for array in batch:
            assert array.flags.owndata
            assert array.flags.writeable
            assert array.flags.c_contiguous
    assert all(np.array_equal(array, copy) for batch in kept for array, copy in batch), "later steps wrote into them"
    for array, _ in kept[0]:
        array.fill(1)
    env.step(action(40, 9))


def test_actions_may_have_any_memory_layout() -> None:
    env, calm = (sandgait.SandgaitVectorEnv(ID, 5) for _ in range(2))
    for e in (env, calm):
        e.reset(seed=0)
    rows = action(5, 1)
    for other in (np.asfortranarray(rows), np.repeat(rows, 2, axis=0)[::2], rows.astype(np.float64), rows.tolist()):
        assert np.array_equal(env.step(other)[0], calm.step(rows)[0])


def rollout(env: sandgait.SandgaitVectorEnv, steps: int) -> None:
    env.rollout(np.zeros((steps, env.num_envs, 6), np.float32))


#: Calls that take long, each with its setup; a test interrupts the call.
WAITS = {
    "step": ("envs(20_000).reset(seed=0)", "for _ in range(1000): env.step(zeros)"),
    "rollout": ("envs(2_000).reset(seed=0)", "env.rollout(np.zeros((2000, 2000, 6), np.float32))"),
    "making": ("", "sandgait.SandgaitVectorEnv('sandgait/HexapodRocks-v1', 8_000)"),
    "sweep": ("", "sandgait.sweep({'xi': np.arange(-75, 75, 0.5), 'frequency': np.linspace(1, 4, 300)})"),
    "pictures": (
        "envs(300).reset(seed=0)",
        "env._session.render(list(range(100)), (500, 500), False, (None, None, None, True))",
    ),
}

PROGRAM = f"""
{HEARS_CTRL_C}
import os, threading, time, sys
import numpy as np
import sandgait
env = None
zeros = np.zeros((20_000, 6), np.float32)
def envs(n):
    global env
    env = sandgait.SandgaitVectorEnv({ID!r}, n)
    return env
SETUP
at = []
def strike():
    time.sleep(0.3)
    at.append(time.perf_counter())
    os.kill(os.getpid(), signal.SIGINT)
began = time.perf_counter()
threading.Thread(target=strike).start()
try:
    CALL
    print("not interrupted")
except KeyboardInterrupt:
    print(time.perf_counter() - at[0], at[0] - began)
"""


@pytest.mark.parametrize("what", WAITS)
def test_ctrl_c_interrupts_every_wait(what: str) -> None:
    """Each call takes seconds; after the interrupt it ends in a small part of the time that it had run."""
    setup, call = WAITS[what]
    code = PROGRAM.replace("SETUP", setup).replace("CALL", call)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    heard, before = map(float, done.stdout.split())
    assert heard < before, f"{heard:.3f} s; 0.1 s at most on an idle machine"


def test_an_interrupted_rollout_ends_and_has_changed_nothing() -> None:
    env, calm = (sandgait.SandgaitVectorEnv(ID, 200) for _ in range(2))
    for e in (env, calm):
        e.reset(seed=0)
        e.step(action(200, 0))
    before = signal.signal(signal.SIGALRM, lambda *_: (_ for _ in ()).throw(TimeoutError()))
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.1)
        with pytest.raises(TimeoutError):
            rollout(env, 20_000)
    finally:
        signal.signal(signal.SIGALRM, before)
    for k in range(3):
        assert np.array_equal(env.step(action(200, k))[0], calm.step(action(200, k))[0])


def test_two_threads_two_environments() -> None:
    """Two threads simulate at the same time, because a waiting thread does not hold Python's lock."""
    envs = [sandgait.SandgaitVectorEnv(ID, 33) for _ in range(3)]
    for env in envs:
        env.reset(seed=1)
    rows: dict[int, list[np.ndarray]] = {}

    def run(i: int) -> None:
        rows[i] = [envs[i].step(action(33, k))[0] for k in range(50)]

    threads = [threading.Thread(target=run, args=(i,)) for i in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    run(2)
    assert all(np.array_equal(a, b) for i in range(2) for a, b in zip(rows[i], rows[2], strict=True))


def test_threads_that_share_an_environment_wait_for_each_other() -> None:
    env = sandgait.SandgaitVectorEnv(ID, 20)
    env.reset(seed=0)
    errors: list[BaseException] = []

    def look() -> None:
        try:
            for _ in range(30):
                env._session.render([0], (32, 32), False, (None, None, None, True))
        except BaseException as error:
            errors.append(error)

    threads = [threading.Thread(target=look) for _ in range(3)]
    for thread in threads:
        thread.start()
    for k in range(200):
        env.step(action(20, k))
    for thread in threads:
        thread.join()
    assert not errors


def in_child(env: sandgait.SandgaitVectorEnv, answers: multiprocessing.Queue[Any]) -> None:
    calls = (env.recv, lambda: env.step(action(3_000, 0)), env.reset)
    answers.put([str(type(error_of(call))) for call in calls])
    answers.put(env._session.owes)
    with sandgait_env(33) as own:
        answers.put(own.step(action(33, 1))[0].tobytes())


def sandgait_env(n: int) -> Any:
    import contextlib

    env = sandgait.SandgaitVectorEnv(ID, n)
    env.reset(seed=5)
    return contextlib.closing(env)


def error_of(call: Callable[[], object]) -> BaseException | None:
    try:
        call()
    except sandgait.SandgaitError as error:
        return error
    return None


def test_a_fork_in_the_middle_of_a_step() -> None:
    """The parent forks while its threads are busy; the child must not wait for locks that these threads hold."""
    env = sandgait.SandgaitVectorEnv(ID, 3_000)
    env.reset(seed=0)
    with sandgait_env(33) as calm:
        expected = calm.step(action(33, 1))[0].tobytes()
    answers: multiprocessing.Queue[Any] = multiprocessing.get_context("fork").Queue()
    for k in range(5):
        env.send(action(3_000, k))
        child = multiprocessing.get_context("fork").Process(target=in_child, args=(env, answers))
        child.start()
        assert answers.get(timeout=30) == [str(sandgait.SandgaitError)] * 3
        assert answers.get(timeout=30) is False, "in the child nothing is asked of the parent's threads"
        assert answers.get(timeout=30) == expected
        child.join(10)
        assert child.exitcode == 0
        env.recv()


@pytest.mark.parametrize(
    "end", ["", "env.close()", "raise SystemExit(3)", "raise RuntimeError", "os._exit(3)", "del env", "gc.collect()"]
)
def test_python_ends_while_a_step_is_in_flight(end: str) -> None:
    code = f"""
import gc, os, numpy as np, sandgait
env = sandgait.SandgaitVectorEnv({ID!r}, 5_000)
env.reset(seed=0)
env.send(np.zeros((5_000, 6)))
print("sent", flush=True)
{end}
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.stdout == "sent\n"
    assert done.returncode == {"raise SystemExit(3)": 3, "os._exit(3)": 3, "raise RuntimeError": 1}.get(end, 0)


def test_memory_is_freed_with_the_environment() -> None:
    """Creates 4,000 environments of some 12 KB 20 times. Memory for only one batch of 50 MB is in use at a time."""
    code = f"""
import gc, resource, numpy as np, sandgait
def use():
    env = sandgait.SandgaitVectorEnv({ID!r}, 4_000)
    env.reset(seed=0)
    env.step(np.zeros((4_000, 6)))
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
first = use()
for _ in range(20):
    last = use()
print(first, last)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=True)
    first, last = map(int, done.stdout.split())
    assert last < 1.5 * first


def test_the_command_needs_neither_gymnasium_nor_numpy(tmp_path: Path) -> None:
    """The command also ends at Ctrl-C like any program."""
    from sandgait import server

    program = [sys.executable, "-I", "-S", str(Path(sandgait.__file__).parents[1] / "sandgait_command/__main__.py")]
    version = subprocess.run([*program, "--version"], capture_output=True, text=True, check=True).stdout
    assert version == subprocess.run([*server.command(), "--version"], capture_output=True, text=True).stdout
    assert version.split()[1] == sandgait.describe()[0]
    wrong = subprocess.run([*program, "walk", "--legs=Q"], capture_output=True, text=True)
    assert wrong.returncode == 2
    assert len(wrong.stderr.splitlines()) == 1
    long = subprocess.Popen([*program, "bench", "--seconds=20"], stdout=subprocess.DEVNULL)
    began = time.perf_counter()
    time.sleep(0.5)
    os.kill(long.pid, signal.SIGINT)
    assert long.wait(20) == -signal.SIGINT
    assert time.perf_counter() - began < 20
