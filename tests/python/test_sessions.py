"""Sessions survive lost connections, and with `resume` lost servers. Snapshots, forks, several servers, rollouts."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import gymnasium
import numpy as np
import numpy.typing as npt
import pytest

import sandgait
from conftest import ID, RemoteServer
from sandgait import server, session

Rows = npt.NDArray[np.float32]


def actions(n: int, time: int) -> Rows:
    i, j = np.meshgrid(np.arange(n), np.arange(6), indexing="ij")
    return np.sin((i * 7 + j * 3 + time) * 0.37).astype(np.float32)


def walk(env: sandgait.SandgaitVectorEnv, steps: range) -> list[tuple[npt.NDArray[np.generic], ...]]:
    return [env.step(actions(env.num_envs, t))[:4] for t in steps]


def equal(a: list[tuple[npt.NDArray[np.generic], ...]], b: list[tuple[npt.NDArray[np.generic], ...]]) -> bool:
    return len(a) == len(b) and all(
        np.array_equal(x, y) for p, q in zip(a, b, strict=True) for x, y in zip(p, q, strict=True)
    )


@pytest.fixture(scope="module")
def undisturbed() -> list[tuple[npt.NDArray[np.generic], ...]]:
    """60 steps of 5 environments over ends of episodes."""
    env = sandgait.SandgaitVectorEnv(ID, 5, max_episode_steps=17)
    env.reset(seed=3)
    rows = walk(env, range(60))
    env.close()
    return rows


class Proxy:
    """A connection to a server that a test can cut."""

    def __init__(self, target: str) -> None:
        host, port = target.rsplit(":", 1)
        self._target = (host, int(port))
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.address = f"127.0.0.1:{self._listener.getsockname()[1]}"
        self._open: list[socket.socket] = []
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        while True:
            try:
                near, _ = self._listener.accept()
            except OSError:
                return
            try:
                far = socket.create_connection(self._target)
            except OSError:  # the server has ended
                near.close()
                continue
            self._open += [near, far]
            for a, b in ((near, far), (far, near)):
                threading.Thread(target=self._carry, args=(a, b), daemon=True).start()

    @staticmethod
    def _carry(source: socket.socket, sink: socket.socket) -> None:
        try:
            while data := source.recv(65536):
                sink.sendall(data)
        except OSError:
            pass

    def cut(self) -> None:
        ends, self._open = self._open, []
        for end in ends:
            with contextlib.suppress(OSError):  # gone already
                end.shutdown(socket.SHUT_RDWR)
            end.close()


@pytest.fixture
def proxy(remote: RemoteServer) -> Iterator[Proxy]:
    proxy = Proxy(remote.address)
    yield proxy
    proxy.cut()


def test_a_cut_connection_neither_loses_nor_repeats_a_step(
    proxy: Proxy, undisturbed: list[tuple[npt.NDArray[np.generic], ...]]
) -> None:
    env = sandgait.SandgaitVectorEnv(ID, 5, address=proxy.address, max_episode_steps=17)
    env.reset(seed=3)
    rows = []
    for t in range(60):
        if t % 7 == 2:
            proxy.cut()  # between steps
        env.send(actions(5, t))
        if t % 5 == 1:
            time.sleep(0.0005 * (t % 4))
            proxy.cut()  # somewhere within one
        rows.append(env.recv()[:4])
    assert equal(rows, undisturbed)
    env.close()


def test_an_interrupted_wait_can_be_taken_up(undisturbed: list[tuple[npt.NDArray[np.generic], ...]]) -> None:
    env = sandgait.SandgaitVectorEnv(ID, 5, max_episode_steps=17, isolated=True)
    env.reset(seed=3)
    rows = walk(env, range(3))
    env.send(actions(5, 3))
    stream = env._session._doors[0]._link.stream
    assert stream is not None

    def interrupted() -> None:
        del stream.receive  # restores the original method for later waits
        raise KeyboardInterrupt

    stream.receive = interrupted  # type: ignore[method-assign, assignment]
    with pytest.raises(KeyboardInterrupt):
        env.recv()
    rows.append(env.recv()[:4])
    rows += walk(env, range(4, 60))
    assert equal(rows, undisturbed)
    env.close()


def test_resume_outlives_the_embedded_server(
    undisturbed: list[tuple[npt.NDArray[np.generic], ...]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(session, "SNAPSHOT_EVERY", 10)
    env = sandgait.SandgaitVectorEnv(ID, 5, resume=True, isolated=True, max_episode_steps=17)
    env.reset(seed=3)
    rows = []
    for t in range(60):
        env.send(actions(5, t))
        if t in (4, 31, 32):
            assert server._server is not None
            os.kill(server._server.process.pid, signal.SIGKILL)
        rows.append(env.recv()[:4])
    assert equal(rows, undisturbed)
    env.close()


def test_resume_goes_on_elsewhere(
    remote: RemoteServer, undisturbed: list[tuple[npt.NDArray[np.generic], ...]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(session, "SNAPSHOT_EVERY", 10)
    with RemoteServer("127.0.0.1:0") as other:
        env = sandgait.SandgaitVectorEnv(
            ID, 5, address=[remote.address, other.address], resume=True, max_episode_steps=17
        )
        env.reset(seed=3)
        rows = walk(env, range(25))
        assert env._session.addresses == [remote.address, other.address]
        env.send(actions(5, 25))
        remote.kill()
        rows.append(env.recv()[:4])
        rows += walk(env, range(26, 60))
        assert env._session.addresses == [other.address, other.address]
        assert equal(rows, undisturbed)
        env.close()


def test_without_resume_a_dead_server_is_an_error_with_its_address(remote: RemoteServer) -> None:
    env = sandgait.SandgaitVectorEnv(ID, 4, address=[None, remote.address])
    env.reset(seed=0)
    remote.kill()
    with pytest.raises(sandgait.ServerLost, match=remote.address):
        walk(env, range(2))
    broke = (
        "the connection broke: .*; with resume=True environments continue after a restart.*make the environment anew"
    )
    with pytest.raises(sandgait.SessionLost, match=broke):
        env.reset()
    env.close()


def test_without_resume_a_server_that_was_started_again_does_not_know_the_session() -> None:
    with RemoteServer("127.0.0.1:0") as first:
        env = sandgait.SandgaitVectorEnv(ID, 2, first.address)
        env.reset(seed=0)
        first.kill()
    with RemoteServer(first.address):
        advice = "with resume=True environments continue after a restart of the server"
        unknown = f'session ".*" is unknown; known: sessions that have not ended; {advice}'
        with pytest.raises(sandgait.SessionLost, match=f"^{first.address}: {unknown}$"):
            walk(env, range(1))
        with pytest.raises(sandgait.SessionLost, match=rf"^this session has ended \(the connection broke: .*{unknown}"):
            walk(env, range(1))
        env.close()


def test_several_servers_give_the_numbers_of_one(
    remote: RemoteServer, undisturbed: list[tuple[npt.NDArray[np.generic], ...]]
) -> None:
    env = sandgait.SandgaitVectorEnv(ID, 5, address=[None, remote.address, None], max_episode_steps=17)
    env.reset(seed=3)
    assert equal(walk(env, range(60)), undisturbed)
    with pytest.raises(sandgait.InvalidRequest, match=r"actions\["):
        env.step(np.full((5, 6), 2.0))
    env.reset(seed=3)
    assert equal(walk(env, range(60)), undisturbed)
    mask = np.array([False, True, True, False, True])
    env.reset(seed=[0, 1, 2, 3, 4], options={"reset_mask": mask})
    snapshot = env.save()
    ahead = walk(env, range(20))
    env.restore(snapshot)
    assert equal(walk(env, range(20)), ahead)
    env.close()
    with pytest.raises(sandgait.InvalidRequest, match="3 servers are more than the 2 environments"):
        sandgait.SandgaitVectorEnv(ID, 2, address=[None, None, None])


def test_save_restore_and_fork(tmp_path: Path) -> None:
    env = gymnasium.make(ID)
    env.reset(seed=1)
    raw = env.unwrapped
    assert isinstance(raw, sandgait.SandgaitEnv)
    for t in range(5):
        env.step(actions(1, t)[0])
    snapshot = raw.save(tmp_path / "snapshot")
    assert (tmp_path / "snapshot").read_bytes() == snapshot
    ahead = [env.step(actions(1, t)[0])[0] for t in range(5, 10)]
    raw.restore(tmp_path / "snapshot")
    assert np.array_equal(ahead, [env.step(actions(1, t)[0])[0] for t in range(5, 10)])
    raw.restore(snapshot)
    copies = raw.fork(3)
    rows = [copies.step(np.repeat(actions(1, t), 3, axis=0))[0] for t in range(5, 10)]
    assert all(np.array_equal(row, [one] * 3) for row, one in zip(rows, ahead, strict=True))
    second = copies.fork(2, index=1)
    assert second.num_envs == 2
    for made in (copies, second):
        made.close()
    env.close()


def test_wrong_snapshots(tmp_path: Path) -> None:
    env = sandgait.SandgaitVectorEnv(ID, 2)
    with pytest.raises(sandgait.OutOfOrder, match="save before reset"):
        env.save()
    env.reset(seed=0)
    snapshot = env.save()
    for wrong, words in [
        (b"", "not one of sandgait's"),
        (snapshot[:25], "cut off"),
        (snapshot[:-1], "cut off"),
        (snapshot + b"x", "something after"),
        (snapshot[:-1] + bytes([snapshot[-1] ^ 1]), "checksum"),
        (tmp_path / "absent", "absent.*cannot be read"),
    ]:
        with pytest.raises(sandgait.InvalidRequest, match=words):
            env.restore(wrong)
    for indices in ([0], [0, 2], [0, -1], [0.5, 1.0]):
        with pytest.raises(sandgait.InvalidRequest, match=r"indices|sources"):
            env.restore(snapshot, indices)
    with pytest.raises(sandgait.SandgaitError, match="cannot be written"):
        env.save(tmp_path / "no such folder" / "file")
    env.step(actions(2, 0))
    env.close()


def test_a_full_disk_leaves_no_half_snapshot() -> None:
    full = Path("/dev/full")
    if not full.exists():
        pytest.skip("this system has no /dev/full")
    env = sandgait.SandgaitVectorEnv(ID, 2)
    env.reset(seed=0)
    before = set(os.listdir("/dev/shm")) if os.path.isdir("/dev/shm") else set()
    # A file that cannot grow: the limit of this process, as a full disk sets it.
    import resource

    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    old = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, hard))
    try:
        with pytest.raises(sandgait.SandgaitError, match="cannot be written"):
            env.save("/dev/shm/sandgait-snapshot")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, old)
    assert set(os.listdir("/dev/shm")) == before
    env.step(actions(2, 0))
    env.close()


def test_rollouts(remote: RemoteServer) -> None:
    for address in (None, [None, remote.address]):
        env = sandgait.SandgaitVectorEnv(ID, 5, address=address, autoreset_mode="SAME_STEP", max_episode_steps=17)
        env.reset(seed=3)
        plan = np.stack([actions(5, t) for t in range(40)])
        rolled = env.rollout(plan, trajectories=True)
        returns = env.rollout(plan)
        assert np.array_equal(rolled.returns, returns.returns)
        assert returns.observations.shape == (0, 5, 41)
        assert (rolled.lengths == 17).all()
        assert rolled.truncated.all()
        assert not rolled.terminated.any()
        rewards = np.zeros(5)
        for t in range(17):
            rows, reward, _, _, infos = env.step(plan[t])
            rewards += reward
            last = np.stack(infos["final_obs"]) if "final_obs" in infos else rows
            assert np.array_equal(rolled.observations[t], last)
        assert np.allclose(rolled.returns, rewards, rtol=1e-12)
        assert not rolled.observations[17:].any()
        with pytest.raises(sandgait.InvalidRequest, match="shape"):
            env.rollout(plan[:, :4])
        env.close()
