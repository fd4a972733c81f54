"""Servers that require TLS, client certificates and a token."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from datetime import UTC, datetime
from pathlib import Path

import gymnasium
import numpy as np
import pytest
import trustme

import sandgait
from conftest import ID, RemoteServer

TOKEN = "the-token-that-nobody-may-show"


class Pki:
    """Files with certificate authorities, certificates and a token, made for this run."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self.ours, self.another = trustme.CA(organization_name="ours"), trustme.CA(organization_name="another")
        self.ours.cert_pem.write_to_path(str(directory / "ca"))
        self.another.cert_pem.write_to_path(str(directory / "another"))
        (directory / "token").write_text(TOKEN + "\n")
        (directory / "token").chmod(0o600)
        self.issue("server", self.ours)
        self.issue("client", self.ours)
        self.issue("stranger", self.another)
        self.issue("expired", self.ours, datetime(2021, 1, 1, tzinfo=UTC))

    def issue(self, name: str, authority: trustme.CA, end: datetime | None = None) -> None:
        begin = None if end is None else datetime(2020, 1, 1, tzinfo=UTC)
        made = authority.issue_cert("localhost", "127.0.0.1", not_before=begin, not_after=end)
        made.cert_chain_pems[0].write_to_path(str(self.directory / f"{name}.cert"))
        made.private_key_pem.write_to_path(str(self.directory / f"{name}.key"))

    def file(self, name: str) -> str:
        return str(self.directory / name)


@pytest.fixture
def pki(tmp_path: Path) -> Pki:
    return Pki(tmp_path)


@pytest.fixture
def start(pki: Pki) -> Iterator[Callable[..., str]]:
    """Starts a server with TLS and the token; returns its address."""
    with ExitStack() as servers:

        def start(certificate: str = "server", *more: str) -> str:
            tls = ("--tls-cert", pki.file(f"{certificate}.cert"), "--tls-key", pki.file(f"{certificate}.key"))
            server = RemoteServer("127.0.0.1:0", *tls, "--token-file", pki.file("token"), *more)
            return servers.enter_context(server).address

        yield start


def play(address: str | list[str] | None) -> np.ndarray:
    env = gymnasium.make_vec(ID, num_envs=4, address=address)
    env.reset(seed=3)
    rows = [env.step(np.full((4, 6), 0.1 * k, np.float32))[0] for k in range(5)]
    env.close()
    return np.stack(rows)


def test_a_remote_replaces_an_address_everywhere(pki: Pki, start: Callable[..., str]) -> None:
    clients = ("--client-ca", pki.file("ca"))
    credentials = {
        "ca": pki.file("ca"),
        "cert": pki.file("client.cert"),
        "key": pki.file("client.key"),
        "token_file": pki.file("token"),
    }
    one, other = (sandgait.Remote(start("server", *clients), **credentials) for _ in range(2))
    expected = play(None)
    assert np.array_equal(play(one), expected)
    assert np.array_equal(play([one, other]), expected), "spread over two servers"
    assert np.array_equal(play(pickle.loads(pickle.dumps(one))), expected)
    assert np.array_equal(play(copy.deepcopy(one)), expected)
    assert sandgait.describe(one)[0] == sandgait.describe()[0]
    assert np.array_equal(sandgait.intrude("L", address=one).Fz, sandgait.intrude("L").Fz)
    env = gymnasium.make(ID, address=one)
    env.reset(seed=0)
    env.close()


def test_refused_clients_get_the_reason(pki: Pki, start: Callable[..., str]) -> None:
    """No error message contains the token."""
    ca, cert, key = pki.file("ca"), pki.file("client.cert"), pki.file("client.key")
    address, mutual, expired = start(), start("server", "--client-ca", ca), start("expired")
    witness = gymnasium.make_vec(ID, num_envs=2, address=sandgait.Remote(address, ca=ca, token=TOKEN))
    calm = gymnasium.make_vec(ID, num_envs=2)
    for env in (witness, calm):
        env.reset(seed=1)
    with RemoteServer("127.0.0.1:0") as plain:
        cases = [
            (sandgait.Remote(address, ca=ca), r"bearer token; sandgait\.Remote takes it"),
            (sandgait.Remote(address, ca=ca, token="wrong"), "the server refuses the token of this sandgait"),
            (address, r"cannot be reached: .*a server with TLS"),
            (sandgait.Remote(address, ca=pki.file("another"), token=TOKEN), "invalid peer certificate: UnknownIssuer"),
            (sandgait.Remote(expired, ca=ca, token=TOKEN), "invalid peer certificate: .*expired"),
            (sandgait.Remote(plain.address, ca=ca, token=TOKEN), "corrupt message"),
            (sandgait.Remote(mutual, ca=ca, token=TOKEN), "cannot be reached"),
            (
                sandgait.Remote(
                    mutual, ca=ca, token=TOKEN, cert=pki.file("stranger.cert"), key=pki.file("stranger.key")
                ),
                "cannot be reached",
            ),
        ]
        for remote, says in cases:
            with pytest.raises(sandgait.SandgaitError, match=says) as error:
                sandgait.describe(remote)
            assert isinstance(error.value, sandgait.AccessDenied if "token" in says else sandgait.ServerLost)
            assert TOKEN not in str(error.value)
            actions = np.full((2, 6), 0.3, np.float32)
            assert np.array_equal(witness.step(actions)[0], calm.step(actions)[0])
    assert sandgait.describe(sandgait.Remote(mutual, ca=ca, token=TOKEN, cert=cert, key=key))


def test_a_remote_keeps_its_secret() -> None:
    remote = sandgait.Remote("127.0.0.1:1", token=TOKEN)
    assert (str(remote), repr(remote), f"{remote}") == ("127.0.0.1:1", "'127.0.0.1:1'", "127.0.0.1:1")


def test_wrong_remotes_are_refused(tmp_path: Path) -> None:
    (tmp_path / "empty").write_text("\n")
    file = str(tmp_path / "empty")
    cases: list[tuple[str, dict[str, str | bool], str]] = [
        (
            "sand.lab:1",
            {"token": TOKEN},
            r"token: it would be sent to sand\.lab:1 without encryption; add ca or tls=True",
        ),
        ("10.0.0.1:1", {"token": TOKEN}, "without encryption"),
        ("sand.lab:1", {"token": TOKEN, "token_file": file}, "token: token_file is given too"),
        ("sand.lab:1", {"token": "with blanks", "tls": True}, "token: empty, or with characters"),
        ("sand.lab:1", {"token_file": file, "tls": True}, "token: empty"),
        ("sand.lab:1", {"token_file": "/nowhere"}, "token_file: '/nowhere' cannot be read: No such file"),
        ("sand.lab:1", {"ca": "/nowhere"}, "ca: '/nowhere' cannot be read"),
        ("sand.lab:1", {"cert": file}, "cert, key: one is given without the other"),
        ("unix:/tmp/x", {"tls": True}, "is a Unix socket, which has no TLS"),
    ]
    for address, keywords, says in cases:
        with pytest.raises(sandgait.InvalidRequest, match=says) as error:
            sandgait.Remote(address, **keywords)  # type: ignore[arg-type]
        assert TOKEN not in str(error.value)
    for address in ("unix:/tmp/x", "localhost:1", "[::1]:1", "127.0.0.1:1"):
        assert sandgait.Remote(address, token=TOKEN) == address


def test_a_restarted_server_is_found_again(tmp_path: Path) -> None:
    """With --state-dir a client goes on by itself after its server was stopped and started again."""
    address = f"unix:{tmp_path}/sock"
    calm = gymnasium.make_vec(ID, num_envs=3)
    state = ("--state-dir", str(tmp_path / "state"))
    actions = np.full((3, 6), 0.3, np.float32)
    with RemoteServer(address, *state) as first:
        env = gymnasium.make_vec(ID, num_envs=3, address=address)
        env.reset(seed=5)
        calm.reset(seed=5)
        assert np.array_equal(env.step(actions)[0], calm.step(actions)[0])
        first.process.terminate()
        assert first.process.wait(5) == 0
    with RemoteServer(address, *state):
        for _ in range(3):
            assert np.array_equal(env.step(actions)[0], calm.step(actions)[0])
        env.close()


@pytest.mark.parametrize("resume", [False, True])
def test_an_older_session_is_not_continued(tmp_path: Path, resume: bool) -> None:
    """A killed server is started again with the sessions that it saved when it was last told to end. A client whose
    session is older than its last step says so, or makes it anew."""
    address, actions = f"unix:{tmp_path}/sock", np.full((3, 6), 0.3, np.float32)
    state = ("--state-dir", str(tmp_path / "state"))
    with RemoteServer(address, *state) as first:
        env = sandgait.SandgaitVectorEnv(ID, 3, address=address, resume=resume)
        env.reset(seed=5)
        first.process.terminate()
        assert first.process.wait(5) == 0
    with RemoteServer(address, *state) as second:
        rows = [env.step(actions)[0]]
        second.kill()
    calm = sandgait.SandgaitVectorEnv(ID, 3)
    calm.reset(seed=5)
    with RemoteServer(address, *state):
        if resume:
            rows += [env.step(actions)[0] for _ in range(3)]
            assert all(np.array_equal(row, calm.step(actions)[0]) for row in rows)
        else:
            with pytest.raises(sandgait.SessionLost, match="an older state of the session: request 1"):
                env.step(actions)
        env.close()
    calm.close()
