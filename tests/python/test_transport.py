"""The connection: Unix and TCP sockets, large messages, latency, other clients. Each test is for a past fault."""

from __future__ import annotations

import os
import statistics
import time
from pathlib import Path

import gymnasium
import numpy as np
import pytest

import sandgait
from conftest import ID, RemoteServer
from sandgait import client


def play(address: str | None, steps: int = 20) -> list[np.ndarray]:
    env = gymnasium.make_vec(ID, num_envs=3, address=address, isolated=address is None)
    rows = [env.reset(seed=0)[0]] + [env.step(np.full((3, 6), 0.2))[0] for _ in range(steps)]
    env.close()
    return rows


def test_remote_servers_give_the_embedded_ones_numbers(remote: RemoteServer, tmp_path: Path) -> None:
    """Over a Unix socket a default grpc client fails (RST_STREAM 1): its authority is the percent-encoded path."""
    expected = play(None)
    assert np.array_equal(play(remote.address), expected)
    with RemoteServer(f"unix:{tmp_path}/a socket") as local:
        assert local.address.startswith("unix:")
        assert np.array_equal(play(local.address), expected)


def test_tcp_does_not_wait_for_more_to_send(remote: RemoteServer) -> None:
    """With Nagle's algorithm, small calls take 44 ms, many times as long as on a Unix socket."""
    over = {
        address: gymnasium.make_vec(ID, num_envs=2, address=address, isolated=address is None)
        for address in (remote.address, None)
    }
    steps: dict[str | None, list[float]] = {address: [] for address in over}
    for env in over.values():
        env.reset(seed=0)
    for _ in range(50):
        for address, env in over.items():
            start = time.perf_counter()
            env.step(np.zeros((2, 6)))
            steps[address].append(time.perf_counter() - start)
    tcp, unix = (statistics.median(times) for times in steps.values())
    assert tcp < 8 * unix, "0.5 and 0.4 ms on an idle machine"
    for env in over.values():
        env.close()


@pytest.mark.parametrize("over", ["unix", "tcp"])
def test_messages_beyond_4_mib(over: str, remote: RemoteServer) -> None:
    """16,384 environments have observations of 2.5 MiB, and twice as much in a step in which all episodes end."""
    address = None if over == "unix" else remote.address
    env = sandgait.SandgaitVectorEnv(
        ID, 16_384, address, isolated=address is None, autoreset_mode="SAME_STEP", max_episode_steps=2
    )
    rows, _ = env.reset(seed=0)
    assert rows.shape == (16_384, 41)
    actions = np.zeros((16_384, 6), np.float32)
    env.step(actions)
    _, _, terminated, truncated, infos = env.step(actions)
    assert (terminated | truncated).all()
    assert infos["_final_obs"].all()
    task = env.task
    assert 4 * 16_384 * (2 * len(task.observation) + len(task.info)) > 4 << 20
    env.close()


def test_a_proxy_of_the_environment_is_not_used(remote: RemoteServer, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("http_proxy", "https_proxy", "grpc_proxy"):
        monkeypatch.setenv(name, "http://127.0.0.1:9")
    monkeypatch.delenv("no_proxy", raising=False)
    assert sandgait.describe(remote.address)[1]


def test_two_clients_of_one_server(remote: RemoteServer) -> None:
    first, second = (gymnasium.make_vec(ID, num_envs=3, address=remote.address) for _ in range(2))
    first.reset(seed=0)
    second.reset(seed=0)
    for k in range(20):
        actions = np.full((3, 6), 0.05 * k)
        assert np.array_equal(first.step(actions)[0], second.step(actions)[0])
    first.close()
    second.step(actions)
    second.close()


def test_no_server_there() -> None:
    with pytest.raises(sandgait.ServerLost, match=r"127\.0\.0\.1:9.*cannot be reached"):
        gymnasium.make(ID, address="127.0.0.1:9")
    with pytest.raises(ConnectionError, match="nothing-here"):
        gymnasium.make(ID, address=f"unix:/tmp/nothing-here-{os.getpid()}")


def test_a_server_that_goes_away(remote: RemoteServer) -> None:
    env = gymnasium.make_vec(ID, num_envs=3, address=remote.address)
    env.reset()
    remote.kill()
    with pytest.raises(sandgait.ServerLost, match=remote.address):
        env.step(np.zeros((3, 6)))
    with pytest.raises(sandgait.SessionLost, match="make the environment anew"):
        env.step(np.zeros((3, 6)))
    env.close()


def test_two_clients_on_one_session(remote: RemoteServer) -> None:
    """The newest stream has the session. The other client gets an error and does not take the session back."""
    env = sandgait.SandgaitVectorEnv(ID, 3, remote.address)
    env.reset()
    second = client.Stream(remote.address, env._session._doors[0]._link.session_id)
    assert second.last_sequence == 1
    with pytest.raises(sandgait.SessionLost, match="another stream has taken the session"):
        env.step(np.zeros((3, 6)))
    env.close()


def test_a_session_ends_when_it_is_closed_by_name(remote: RemoteServer) -> None:
    env = sandgait.SandgaitVectorEnv(ID, 3, remote.address)
    env.reset()
    client.close_session(remote.address, env._session._doors[0]._link.session_id)
    with pytest.raises(sandgait.SessionLost, match="the session was closed"):
        env.step(np.zeros((3, 6)))
    env.close()
