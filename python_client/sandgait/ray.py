"""A server on every node of a Ray cluster: environments spread over many machines.

    with sandgait.ray.serve() as servers:
        env = sandgait.SandgaitVectorEnv(id, 4096, address=servers.addresses)

Every server listens on its node's address in the cluster, with TLS and a token. `serve` draws the token, each server
makes its own certificate, and Ray sends both to the clients. So only users of the cluster can use its servers.
"""

from __future__ import annotations

import contextlib
import secrets
import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from . import server
from .arguments import checked
from .errors import InvalidRequest, ServerLost
from .remote import Remote

try:
    import ray
    from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy
except ImportError as error:
    raise ImportError("ray is not installed: pip install 'sandgait[ray]'") from error

#: Longest wait for all servers to start [s]: our choice. It is long, because a cluster may have to start Python on each
#: node first.
START_TIMEOUT = 60.0


class _Server:
    """An actor that owns a server process. When the actor ends, the server's standard input closes, and the server
    ends."""

    def __init__(self, threads: int, token: str) -> None:
        listen = f"{ray.util.get_node_ip_address()}:0"
        #: Directory that only this user can enter, for the token and the certificate. It is removed after the server
        #: has reported its address, because the server then needs no file in it any more.
        self._directory = tempfile.TemporaryDirectory()
        token_file, self._certificate = (Path(self._directory.name) / name for name in ("token", "certificate"))
        token_file.touch(0o600)
        token_file.write_text(token)
        command = [*server.command(), "serve", "--listen", listen, "--threads", str(threads)]
        security = [
            "--exit-on-stdin-close",
            "--token-file",
            str(token_file),
            "--tls-self-signed",
            str(self._certificate),
        ]
        self._process = subprocess.Popen(command + security, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def address(self) -> tuple[str, bytes]:
        """The server's address and certificate. Both are empty if it could not start; the actor's log says why."""
        assert self._process.stdout is not None
        address = self._process.stdout.readline().removeprefix("listening on ").strip()
        certificate = self._certificate.read_bytes() if address else b""
        self._directory.cleanup()
        return address, certificate

    def stop(self) -> None:
        """Ends the server. A step in progress is completed first."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait()


@dataclass
class Servers:
    """Servers on the nodes of a cluster, one on each. They end when `close` is called or this object is deleted."""

    #: Addresses of all servers with their credentials. All or some of them can be the argument `address` of an
    #: environment.
    addresses: list[Remote]
    #: Ray's id of each server's node. With it a client can be placed on the same node.
    nodes: list[str]
    #: Number of threads of each server.
    threads: list[int]
    _actors: list[Any]

    def on(self, k: int) -> dict[str, Any]:
        """Ray options that place a task or actor on the node of server `k`."""
        return {"scheduling_strategy": NodeAffinitySchedulingStrategy(self.nodes[k], soft=False)}

    def close(self) -> None:
        """Ends all servers. Sessions on them are lost."""
        with contextlib.suppress(ray.exceptions.RayError):  # the node or the cluster may have ended already
            ray.get([actor.stop.remote() for actor in self._actors], timeout=server.STOP_TIMEOUT)
        for actor in self._actors:
            ray.kill(actor)
        self._actors.clear()

    def __enter__(self) -> Servers:
        return self

    def __exit__(self, *_: Any) -> None:
        self.close()


@checked
def serve(nodes: Sequence[str] | None = None, threads: int | None = None, num_cpus: float = 0.0) -> Servers:
    """Starts one server on each of `nodes` and waits until all have started.

    `nodes`: Ray's ids of nodes; by default all nodes with processors. `threads`: number of threads of each server; by
    default the number of processors that Ray counts on the node. `num_cpus`: number of processors that Ray reserves for
    each server; with 0 clients can have all processors, because they wait while their server computes. Ray must be
    initialized, and this package must be installed on every node.
    """
    if threads is not None and not 1 <= threads <= 65_535:
        raise InvalidRequest(f"threads: {threads} is outside [1, 65535]")
    cpus = {n["NodeID"]: int(n["Resources"].get("CPU", 0)) for n in ray.nodes() if n["Alive"]}
    chosen = [node for node, count in cpus.items() if count > 0] if nodes is None else list(nodes)
    for k, node in enumerate(chosen):
        if node not in cpus:
            raise InvalidRequest(f"nodes[{k}]: {node!r} is no node of this cluster that is alive")
    if not chosen:
        raise InvalidRequest("nodes: there is none to serve on")
    counts = [threads or max(cpus[node], 1) for node in chosen]
    servers = Servers([], chosen, counts, [])
    remote, token = ray.remote(_Server), secrets.token_hex(32)
    for k, count in enumerate(counts):
        servers._actors.append(remote.options(num_cpus=num_cpus, **servers.on(k)).remote(count, token))
    try:
        started = ray.get([a.address.remote() for a in servers._actors], timeout=START_TIMEOUT)
    except ray.exceptions.RayError as error:
        servers.close()
        raise ServerLost(f"the servers could not start: {error}") from error
    for (address, certificate), node in zip(started, chosen, strict=True):
        if not address:
            servers.close()
            raise ServerLost(f"the server on node {node} could not start; its log says why")
        servers.addresses.append(Remote(address, ca=certificate, token=token))
    return servers
