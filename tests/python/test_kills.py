"""Server or client is killed during a step: no step is lost, and none is made twice.

The tests make sure that a step was in flight: the server is paused after it has used a part of the processor time of a
whole step, and before it has answered.
"""

from __future__ import annotations

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
import numpy.typing as npt
import pytest

import sandgait
from conftest import ID, RemoteServer
from sandgait import client, session

#: Environments of one server. A step takes some 60 ms on its single thread.
ENVS = 10_000

STEPS = 14

#: The episodes end within the steps of the tests. The protocol uses SAME_STEP.
OPTIONS: dict[str, Any] = {"max_episode_steps": 9, "autoreset_mode": "SAME_STEP"}

Row = tuple[npt.NDArray[np.generic], ...]


def actions(n: int, time: int) -> npt.NDArray[np.float32]:
    i, j = np.meshgrid(np.arange(n), np.arange(6), indexing="ij")
    return np.sin((i * 7 + j * 3 + time) * 0.37).astype(np.float32)


def walk(env: sandgait.SandgaitVectorEnv, steps: range) -> list[Row]:
    return [env.step(actions(env.num_envs, t))[:4] for t in steps]


def equal(a: list[Row], b: list[Row]) -> bool:
    return len(a) == len(b) and all(
        np.array_equal(x, y) for p, q in zip(a, b, strict=True) for x, y in zip(p, q, strict=True)
    )


def undisturbed(n: int) -> list[Row]:
    env = sandgait.SandgaitVectorEnv(ID, n, **OPTIONS)
    env.reset(seed=3)
    rows = walk(env, range(STEPS))
    env.close()
    assert any(row[3].any() for row in rows)
    return rows


class Server(RemoteServer):
    """A server with one thread that a test can pause during a step."""

    def __init__(self) -> None:
        super().__init__("127.0.0.1:0", "--threads", "1")

    def processor_time(self) -> float:
        """Processor time of all threads [s], in nanosecond resolution."""
        files = Path(f"/proc/{self.process.pid}/task").glob("*/schedstat")
        return sum(int(file.read_text().split()[0]) for file in files) * 1e-9

    def freeze_in_flight(self, step: Callable[[], object], send: Callable[[], object]) -> None:
        """Pauses the process during the step that `send` requests; `step` makes a whole step, to measure its time."""
        before = self.processor_time()
        step()
        whole = self.processor_time() - before
        before = self.processor_time()
        send()
        deadline = time.monotonic() + 30
        while self.processor_time() - before < 0.2 * whole:
            assert time.monotonic() < deadline, "the server has not begun"
            time.sleep(0.001)
        self.process.send_signal(signal.SIGSTOP)
        time.sleep(0.2)  # whatever it had sent has arrived
        spent = (self.processor_time() - before) / whole
        assert 0.2 <= spent < 0.9, f"{spent:.2f} of a step"


@pytest.mark.parametrize("killed_at", [3, 8], ids=["before its first snapshot", "after it"])
def test_a_server_killed_in_a_step(killed_at: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(session, "SNAPSHOT_EVERY", 5)
    with Server() as first, Server() as second:
        addresses = [first.address, second.address]
        env = sandgait.SandgaitVectorEnv(ID, 2 * ENVS, addresses, resume=True, **OPTIONS)
        env.reset(seed=3)
        rows = walk(env, range(killed_at - 1))
        answer = threading.Thread(target=lambda: rows.append(env.recv()[:4]))

        def send() -> None:
            env.send(actions(env.num_envs, killed_at))
            answer.start()

        first.freeze_in_flight(lambda: rows.extend(walk(env, range(killed_at - 1, killed_at))), send)
        assert answer.is_alive()
        assert len(rows) == killed_at, "the answer has come"
        first.kill()
        answer.join(60)
        rows += walk(env, range(killed_at + 1, STEPS))
        assert env._session.addresses == [second.address] * 2
        assert equal(rows, undisturbed(2 * ENVS))
        env.close()


#: A client that makes a step for each line of input and prints the result.
CLIENT = f"""
import sys, sandgait
from test_kills import OPTIONS, actions
env = sandgait.SandgaitVectorEnv({ID!r}, {ENVS}, sys.argv[1], **OPTIONS)
env.reset(seed=3)
print(env._session._doors[0]._link.session_id, flush=True)
for time, _ in enumerate(sys.stdin):
    env.step(actions({ENVS}, time))
    print("stepped", flush=True)
"""


def test_a_client_killed_in_a_step() -> None:
    """The server finishes the step, and a client that resumes the session gets its answer. Other sessions go on."""
    with Server() as server:
        neighbour = sandgait.SandgaitVectorEnv(ID, 5, server.address, **OPTIONS)
        neighbour.reset(seed=3)
        rows = walk(neighbour, range(4))
        command, pipe = [sys.executable, "-c", CLIENT, server.address], subprocess.PIPE
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
        with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True, bufsize=1, env=environment) as player:
            assert player.stdin is not None
            assert player.stdout is not None
            session_id = player.stdout.readline().strip()

            def step() -> None:
                player.stdin.write("\n")
                assert player.stdout.readline() == "stepped\n"

            for _ in range(5):
                step()
            server.freeze_in_flight(step, lambda: player.stdin.write("\n"))
            player.kill()
            assert player.communicate()[0] == "", "the answer has come"
        server.process.send_signal(signal.SIGCONT)
        rows += walk(neighbour, range(4, STEPS))
        stream = client.Stream(server.address, session_id)
        assert stream.last_sequence == 1 + 7, "a reset, six steps, and the one in flight"
        taken_up = []
        for t in range(6, STEPS):
            request = client.step_request(actions(ENVS, t))
            request.sequence = 2 + t
            stream.send(request)
            taken_up.append(client.batch(stream.receive())[:4])
        assert equal(taken_up, undisturbed(ENVS)[6:])
        assert equal(rows, undisturbed(5))
        stream.close()
        neighbour.close()
