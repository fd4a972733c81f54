"""Threads of the simulation, effects of importing the package, systems without Unix sockets, and closing."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import sandgait
from conftest import RemoteServer

ID = sandgait.TASKS[0]


def run(code: str, **environment: str) -> subprocess.CompletedProcess[str]:
    places = {"PYTHONPATH": str(Path(sandgait.__file__).parents[1])}
    return subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, **places, **environment},
        capture_output=True,
        text=True,
        timeout=120,
    )


TOLD = f"""
import os, time, sandgait
from sandgait import server
isolated = %s
def threads():
    if isolated:
        return open(f"/proc/{{server._server.process.pid}}/cmdline").read().split("\\0")[-2]
    counts = []
    for _ in range(50):  # the thread that made the environment may still be ending
        counts.append(len(os.listdir("/proc/self/task")) - before)
        time.sleep(0.01)
    return min(counts)
before = len(os.listdir("/proc/self/task"))
first = sandgait.SandgaitEnv({ID!r}, isolated=isolated%s)
print(threads())
sandgait.SandgaitVectorEnv({ID!r}, 2, isolated=isolated).reset()
try:
    sandgait.SandgaitEnv({ID!r}, isolated=isolated, threads=7)
except sandgait.InvalidRequest as error:
    print(error)
"""


@pytest.mark.parametrize(
    ("keyword", "variable", "threads", "says"),
    [
        ("", "", "0", "has one thread for each processor already"),
        (", threads=2", "", "2", "has 2 threads already"),
        ("", "3", "3", "has 3 threads already"),
        (", threads=2", "3", "2", "has 2 threads already"),
    ],
)
@pytest.mark.parametrize("isolated", [False, True])
def test_the_first_number_of_threads_stays(
    keyword: str, variable: str, threads: str, says: str, isolated: bool
) -> None:
    done = run(TOLD % (isolated, keyword), SANDGAIT_THREADS=variable)
    assert done.returncode == 0, done.stderr
    number, error = done.stdout.splitlines()
    assert number == (threads if isolated or threads != "0" else str(len(os.sched_getaffinity(0))))
    assert error.startswith("threads: 7 asked for")
    assert says in error


@pytest.mark.parametrize("threads", [0, -1, 65_536])
def test_wrong_numbers_of_threads(threads: int) -> None:
    with pytest.raises(sandgait.InvalidRequest, match=r"threads: .* is not a whole number in \[1, 65535\]"):
        sandgait.SandgaitEnv(ID, threads=threads)


@pytest.mark.parametrize("threads", ["many", 1.5])
def test_threads_that_are_no_number(threads: object) -> None:
    with pytest.raises(sandgait.WrongType, match=r"^threads: expected a whole number or None, got "):
        sandgait.SandgaitEnv(ID, threads=threads)  # type: ignore[arg-type]


def test_threads_belong_to_this_process(remote: RemoteServer) -> None:
    with pytest.raises(sandgait.InvalidRequest, match="threads: it applies to this process"):
        sandgait.make_sb3(ID, 2, remote.address, threads=2)
    done = run(f"import sandgait; sandgait.SandgaitEnv({ID!r})", SANDGAIT_THREADS="few")
    assert "SANDGAIT_THREADS: 'few' is not a whole number" in done.stderr


IMPORTED = """
import os, sys
import gymnasium
already, environment = set(sys.modules), dict(os.environ)
before = len(os.listdir("/proc/self/task"))
import sandgait
assert len(os.listdir("/proc/self/task")) == before, "importing starts threads"
assert not {"grpc", "google.protobuf", "subprocess"} & (set(sys.modules) - already)
sandgait.describe()
assert dict(os.environ) == environment
"""


def test_importing_does_not_change_the_process() -> None:
    done = run(IMPORTED)
    assert done.returncode == 0, done.stderr


#: Removes what Windows does not have, before the package is imported.
WINDOWS = f"""
import os, signal, socket, sys
import gymnasium, numpy, subprocess, tempfile, multiprocessing, pathlib, ctypes
for module, names in ((os, ("register_at_fork", "getuid", "fork")), (socket, ("AF_UNIX",)), (signal, ("SIGKILL",))):
    for name in names:
        delattr(module, name)
for name in ("fcntl", "pwd", "grp", "resource", "termios"):
    sys.modules[name] = None
import sandgait
env = sandgait.SandgaitVectorEnv({ID!r}, 2, sys.argv[1])
env.reset(seed=0)
env.step(numpy.zeros((2, 6)))
env.close()
sandgait.SandgaitEnv({ID!r}).reset()
try:
    sandgait.SandgaitEnv({ID!r}, isolated=True)
except sandgait.SandgaitError as error:
    print(error)
"""


def test_without_unix_sockets_or_forks(remote: RemoteServer) -> None:
    done = subprocess.run(
        [sys.executable, "-c", WINDOWS, remote.address],
        env={**os.environ, "PYTHONPATH": str(Path(sandgait.__file__).parents[1])},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    assert "this system has no Unix sockets" in done.stdout


def seconds_to_close(address: str, servers: int, process: subprocess.Popen[str]) -> float:
    env = sandgait.SandgaitVectorEnv(ID, servers, [address] * servers)
    process.send_signal(signal.SIGSTOP)
    start = time.monotonic()
    env.close()
    took = time.monotonic() - start
    process.send_signal(signal.SIGCONT)
    return took


def test_many_dead_servers_are_closed_in_the_time_of_one(remote: RemoteServer) -> None:
    """A paused server accepts connections and never answers."""
    one = seconds_to_close(remote.address, 1, remote.process)
    assert one > 1, "it is waited for"
    assert seconds_to_close(remote.address, 16, remote.process) < 3 * one


AT_THE_END = f"""
import os, signal, sys, time
import sandgait
env = sandgait.SandgaitVectorEnv({ID!r}, int(sys.argv[3]), [sys.argv[1]] * int(sys.argv[3]))
os.kill(int(sys.argv[2]), signal.SIGSTOP)
print(time.monotonic(), flush=True)
"""


def test_dead_servers_do_not_hold_up_the_end_of_python(remote: RemoteServer) -> None:
    def seconds(servers: int) -> float:
        arguments = [remote.address, str(remote.process.pid), str(servers)]
        done = subprocess.run(
            [sys.executable, "-c", AT_THE_END, *arguments],
            env={**os.environ, "PYTHONPATH": str(Path(sandgait.__file__).parents[1])},
            capture_output=True,
            text=True,
            timeout=300,
        )
        end = time.monotonic()
        remote.process.send_signal(signal.SIGCONT)
        assert done.returncode == 0, done.stderr
        return end - float(done.stdout)

    one = seconds(1)
    assert seconds(16) < 3 * one
