"""The embedded server: Python starts it, and it ends with Python, however Python ends."""

from __future__ import annotations

import hashlib
import multiprocessing
import os
import signal
import stat
import subprocess
import sys
import time
from pathlib import Path

import gymnasium
import numpy as np
import pytest

import sandgait
from conftest import HEARS_CTRL_C, ID
from sandgait import server

PLAY = f"""
import hashlib, sys, numpy, sandgait
from sandgait import server
env = sandgait.SandgaitVectorEnv({ID!r}, 20, max_episode_steps=30, isolated=True)
rows = [env.reset(seed=11)[0]]
for k in range(100):
    rows += env.step(numpy.sin(numpy.arange(120) + k).reshape(20, 6))[:4]
print(hashlib.sha256(b"".join(r.tobytes() for r in rows)).hexdigest(), flush=True)
print(server._server.process.pid, server._server.path, flush=True)
"""


def start(code: str) -> tuple[subprocess.Popen[str], str, int, Path]:
    """Runs `PLAY` and then `code` in a new Python: process, hash of all results, the server's pid and socket."""
    process = subprocess.Popen([sys.executable, "-c", PLAY + code], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    digest = process.stdout.readline().strip()
    pid, path = process.stdout.readline().split()
    return process, digest, int(pid), Path(path)


def assert_gone(pid: int, path: Path) -> None:
    deadline = time.monotonic() + 6
    while time.monotonic() < deadline:
        try:
            if Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] == "Z":
                break  # ended; its new parent has not fetched it yet
            os.kill(pid, 0)
        except (FileNotFoundError, ProcessLookupError):
            break
        time.sleep(0.01)
    else:
        pytest.fail(f"the server {pid} outlived its Python by 6 s")
    assert not path.exists(), "the server removes its socket"


@pytest.mark.parametrize(
    "end",
    [
        "env.close()",
        "",
        "raise SystemExit(3)",
        "raise RuntimeError('a crash')",
        "import os, signal; os.kill(os.getpid(), signal.SIGKILL)",
        "import os, signal; os.kill(os.getpid(), signal.SIGSEGV)",
        "import os; os._exit(1)",
        "import os, signal; env.send(numpy.zeros((20, 6))); os.kill(os.getpid(), signal.SIGKILL)",
        "import os, time\nif os.fork() == 0: time.sleep(20)\nos.kill(os.getpid(), 9)",
    ],
    ids=[
        "closed",
        "left open",
        "exit",
        "exception",
        "SIGKILL",
        "SIGSEGV",
        "_exit",
        "SIGKILL in a step",
        "child lives on",
    ],
)
def test_the_server_ends_with_python(end: str) -> None:
    process, _, pid, path = start(end)
    process.wait(10)
    assert_gone(pid, path)
    assert process.stdout is not None
    process.stdout.close()


def test_ctrl_c_does_not_end_the_server() -> None:
    """A terminal sends SIGINT to all processes in the foreground; the server must go on until Python has ended."""
    code = f"{HEARS_CTRL_C}\nimport time\ntry: time.sleep(60)\n"
    code += "except KeyboardInterrupt: env.step(numpy.zeros((20, 6))); print('done')"
    process = subprocess.Popen(
        [sys.executable, "-c", PLAY + code], stdout=subprocess.PIPE, text=True, start_new_session=True
    )
    assert process.stdout is not None
    process.stdout.readline()
    process.stdout.readline()
    time.sleep(0.2)
    os.killpg(process.pid, signal.SIGINT)
    assert process.communicate(timeout=10)[0] == "done\n"
    assert process.returncode == 0


def test_an_interrupted_step_is_neither_lost_nor_done_twice() -> None:
    """grpc cannot continue a read that was interrupted, but the session keeps the answer for the next call."""
    code = """
import signal, os
pid = server._server.process.pid
calm = sandgait.SandgaitVectorEnv(env.task.id, 20, max_episode_steps=30)
env.reset(seed=5)
calm.reset(seed=5)
action = lambda k: numpy.sin(numpy.arange(120) * 0.1 * k).reshape(20, 6)
def same(ours, theirs): return all((a == b).all() for a, b in zip(ours[:4], theirs[:4]))
def interrupt(*_): raise KeyboardInterrupt
signal.signal(signal.SIGALRM, interrupt)
os.kill(pid, signal.SIGSTOP)
os.waitpid(pid, os.WUNTRACED)  # all its threads have stopped, so the step cannot be answered
signal.setitimer(signal.ITIMER_REAL, 0.5)
try:
    env.step(action(1))
    print("not interrupted")
except KeyboardInterrupt:
    os.kill(pid, signal.SIGCONT)
try:
    env.step(action(2))
    print("stepped while a step was in flight")
except sandgait.OutOfOrder:
    print(same(env.recv(), calm.step(action(1))))
print(*[same(env.step(action(k)), calm.step(action(k))) for k in range(2, 6)])
"""
    process, *_ = start(code)
    assert process.communicate(timeout=60)[0].split() == ["True"] * 5
    assert process.returncode == 0


def test_equal_seeds_give_equal_bits_in_every_process_and_for_any_number_of_threads() -> None:
    digests = set()
    for threads in ("1", "2", "5"):
        code = PLAY.replace("20, max", "20, sys.argv[1], max").replace(", isolated=True", "")
        with subprocess.Popen(
            [*server.command(), "serve", "--listen", "127.0.0.1:0", "--threads", threads, "--exit-on-stdin-close"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        ) as other:
            assert other.stdout is not None
            address = other.stdout.readline().split()[-1]
            code = code.split("print(server")[0]
            run = subprocess.run([sys.executable, "-c", code, address], capture_output=True, text=True, check=True)
            digests.add(run.stdout.strip())
            other.kill()
    process, digest, _, _ = start("")
    process.communicate(timeout=10)
    assert digests == {digest}


def test_a_killed_server_is_named_and_the_next_environment_starts_another() -> None:
    env = gymnasium.make_vec(ID, num_envs=2, isolated=True)
    env.reset()
    embedded = server._server
    assert embedded is not None
    embedded.process.kill()
    with pytest.raises(sandgait.ServerLost, match="exit code -9"):
        env.step(np.zeros((2, 6)))
    another = gymnasium.make_vec(ID, num_envs=2, isolated=True)
    another.reset()
    assert server._server is not embedded
    env.close()
    another.close()


def test_the_socket_is_this_users_alone_and_the_start_is_quick() -> None:
    starts, pythons = [], []
    for _ in range(5):
        begun = time.perf_counter()
        embedded = server.EmbeddedServer()
        starts.append(time.perf_counter() - begun)
        try:
            assert stat.S_IMODE(os.stat(Path(embedded.path).parent).st_mode) == 0o700
            assert stat.S_IMODE(os.stat(embedded.path).st_mode) == 0o600
        finally:
            embedded.stop()
        begun = time.perf_counter()
        subprocess.run([sys.executable, "-c", ""], check=True)
        pythons.append(time.perf_counter() - begun)
    assert min(starts) < 5 * min(pythons), "0.02 s each on an idle machine"


def test_a_directory_that_others_can_enter_is_refused(
    tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    parent = tmp_path_factory.mktemp("t")
    monkeypatch.setattr("tempfile.tempdir", str(parent))
    (parent / f"sandgait-{os.getuid()}").mkdir(mode=0o755)
    with pytest.raises(sandgait.SandgaitError, match="only this user"):
        server.EmbeddedServer()


def test_a_binary_that_is_not_there_or_cannot_serve(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SANDGAIT_BINARY", "/nowhere/sandgait")
    with pytest.raises(sandgait.SandgaitError, match="SANDGAIT_BINARY"):
        server.EmbeddedServer()
    monkeypatch.setenv("SANDGAIT_BINARY", sys.executable)
    with pytest.raises(sandgait.ServerLost, match=r"could not start.*exit code 2"):
        server.EmbeddedServer()


def forked(env: sandgait.SandgaitVectorEnv, answers: multiprocessing.Queue[str], isolated: bool) -> None:
    """In a forked child, the parent's environment gives an error that says so, and a new environment works."""
    try:
        env.step(np.zeros((2, 6)))
    except sandgait.SandgaitError as error:
        answers.put(str(error))
    env.close()
    own = sandgait.SandgaitVectorEnv(ID, 2, isolated=isolated)
    answers.put(hashlib.sha256(own.reset(seed=0)[0].tobytes()).hexdigest())


@pytest.mark.parametrize("isolated", [False, True])
def test_a_forked_child_makes_its_own(isolated: bool) -> None:
    env = sandgait.SandgaitVectorEnv(ID, 2, isolated=isolated)
    first = env.reset(seed=0)[0]
    context = multiprocessing.get_context("fork")
    answers: multiprocessing.Queue[str] = context.Queue()
    for _ in range(3):
        child = context.Process(target=forked, args=(env, answers, isolated))
        child.start()
        assert "belongs to the process that made it" in answers.get(timeout=20)
        assert answers.get(timeout=20) == hashlib.sha256(first.tobytes()).hexdigest()
        child.join(10)
        assert child.exitcode == 0
    env.step(np.zeros((2, 6)))


@pytest.mark.parametrize("isolated", [False, True])
def test_gymnasiums_asyncvectorenv_forks_while_a_session_is_open(isolated: bool) -> None:
    ours = gymnasium.make_vec(ID, num_envs=2, isolated=isolated)
    rows, _ = ours.reset(seed=0)
    theirs = gymnasium.make_vec(ID, num_envs=2, vectorization_mode="async", isolated=isolated)
    assert np.array_equal(theirs.reset(seed=0)[0], rows)
    actions = np.full((2, 6), 0.4, np.float32)
    assert np.array_equal(theirs.step(actions)[0], ours.step(actions)[0])
    theirs.close()
    ours.close()
