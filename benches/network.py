"""Measures servers behind a network. Each server has its own network namespace, link and core; the link can have a
delay.

usage: python benches/network.py [--servers 1 2] [--envs 256 4096] [--delays 0 0.5 2] [--seconds 0.5] [--json]

    client ── [relay that holds every byte for a delay] ── veth link ── namespace: sandgait serve, pinned to a core

It needs root for the namespaces. At its end it removes them with their links and servers. The relay replaces `tc
netem`, which some kernels do not have. The relay takes processor time, so compare rows that have a delay with the row
of delay 0. Each round measures all rows of a table.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import json
import multiprocessing
import os
import queue
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from shards import ID, speed

import sandgait
from sandgait import server

#: Network of the range that RFC 2544 reserves for measurements. Server k has address 198.18.k.2, and the near end of
#: its link 198.18.k.1.
NETWORK = "198.18"

PORT = 50051

#: Largest number of bytes that a relay reads at once.
CHUNK = 1 << 20


def ip(*arguments: str) -> None:
    subprocess.run(["ip", *arguments], check=True)


@contextlib.contextmanager
def namespace(k: int) -> Iterator[str]:
    """A network namespace with one link to this process's namespace."""
    name, near, far = f"sandgait-{os.getpid()}-{k}", f"sg{os.getpid()}n{k}", f"sg{os.getpid()}f{k}"
    ip("netns", "add", name)
    try:
        ip("link", "add", near, "type", "veth", "peer", "name", far, "netns", name)
        ip("address", "add", f"{NETWORK}.{k}.1/30", "dev", near)
        ip("link", "set", near, "up")
        ip("-netns", name, "address", "add", f"{NETWORK}.{k}.2/30", "dev", far)
        ip("-netns", name, "link", "set", far, "up")
        yield name
    finally:
        ip("netns", "delete", name)  # this also deletes the link


@contextlib.contextmanager
def serving(k: int, name: str | None) -> Iterator[str]:
    """Starts a server with one thread on core k modulo the number of cores, in namespace `name` if one is given. Yields
    its address."""
    core = sorted(os.sched_getaffinity(0))[k % len(os.sched_getaffinity(0))]
    inside = [] if name is None else ["ip", "netns", "exec", name]
    listen = "127.0.0.1:0" if name is None else f"{NETWORK}.{k}.2:{PORT}"
    command = [*inside, "taskset", "--cpu-list", str(core), *server.command(), "serve", "--listen", listen]
    command += ["--threads", "1", "--insecure", "--exit-on-stdin-close"]
    pipe = subprocess.PIPE
    quiet = {"SANDGAIT_LOG": "error", **os.environ}
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True, env=quiet) as process:
        assert process.stdout is not None
        yield process.stdout.readline().removeprefix("listening on ").strip()


def carry(source: socket.socket, sink: socket.socket, delay: float) -> None:
    """Sends bytes on `delay` seconds after their arrival, in order, until one of the ends closes."""
    held: queue.SimpleQueue[tuple[float, bytes]] = queue.SimpleQueue()

    def deliver() -> None:
        with contextlib.suppress(OSError):
            while (item := held.get())[1]:
                time.sleep(max(0.0, item[0] - time.monotonic()))
                sink.sendall(item[1])
            sink.shutdown(socket.SHUT_WR)

    threading.Thread(target=deliver, daemon=True).start()
    with contextlib.suppress(OSError):
        while data := source.recv(CHUNK):
            held.put((time.monotonic() + delay, data))
    held.put((0.0, b""))


def relay(listener: socket.socket, target: tuple[str, int], delay: float) -> None:
    """Relays every connection to `target`, in both directions, until the process ends."""
    while True:
        near, _ = listener.accept()
        far = socket.create_connection(target)
        for source, sink in ((near, far), (far, near)):
            source.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            threading.Thread(target=carry, args=(source, sink, delay), daemon=True).start()


@contextlib.contextmanager
def delayed(address: str, delay: float) -> Iterator[str]:
    """The address of a relay to `address` that delays every byte by `delay` seconds, in both directions."""
    host, port = address.rsplit(":", 1)
    listener = socket.create_server(("127.0.0.1", 0))
    # The process is spawned, because a fork would copy locks that other threads of this process hold.
    process = multiprocessing.get_context("spawn").Process(
        target=relay, args=(listener, (host, int(port)), delay), daemon=True
    )
    process.start()
    try:
        yield f"127.0.0.1:{listener.getsockname()[1]}"
    finally:
        process.terminate()
        process.join()
        listener.close()


class Whole:
    """One batch over all servers: every step waits for the slowest answer."""

    def __init__(self, envs: int, addresses: list[str]) -> None:
        self.batch = sandgait.SandgaitVectorEnv(ID, envs, addresses)
        self.batch.reset(seed=0)

    def speed(self, seconds: float) -> float:
        return speed(self.batch, seconds)

    def close(self) -> None:
        self.batch.close()


class Halves:
    """Two batches, each with half of the environments. While one is in transit or simulated, the rows of the other are
    read."""

    def __init__(self, envs: int, addresses: list[str]) -> None:
        self.halves = [sandgait.SandgaitVectorEnv(ID, envs // 2, addresses) for _ in range(2)]
        for k, half in enumerate(self.halves):
            half.reset(seed=k * envs // 2)

    def speed(self, seconds: float) -> float:
        """Environment steps per second."""
        count = self.halves[0].num_envs
        actions = np.random.default_rng(0).uniform(-1.0, 1.0, (16, count, 6)).astype(np.float32)
        for half in self.halves:
            half.send(actions[-1])
        steps, start = 0, time.perf_counter()
        while (elapsed := time.perf_counter() - start) < seconds:
            half = self.halves[steps % 2]
            half.recv()
            half.send(actions[steps % 16])
            steps += 1
        for half in self.halves:
            half.recv()
        return count * steps / elapsed

    def close(self) -> None:
        for half in self.halves:
            half.close()


KINDS: tuple[type[Whole] | type[Halves], ...] = (Whole, Halves)


def places(stack: contextlib.ExitStack, servers: int, delays: list[float]) -> dict[str, list[str]]:
    """Addresses of `servers` servers for each way to reach them."""
    near = [stack.enter_context(serving(k, None)) for k in range(servers)]
    far = [stack.enter_context(serving(k, stack.enter_context(namespace(k)))) for k in range(servers)]
    ways = {"loopback": near, "link": far}
    for delay in delays:
        ways[f"link + {delay:g} ms"] = [stack.enter_context(delayed(a, delay * 1e-3)) for a in far]
    return ways


def round_trip(addresses: list[str]) -> float:
    """Median time of a step with one environment on each server [s]."""
    batch = sandgait.SandgaitVectorEnv(ID, len(addresses), addresses)
    batch.reset(seed=0)
    times = []
    for _ in range(200):
        start = time.perf_counter()
        batch.step(np.zeros((len(addresses), 6), np.float32))
        times.append(time.perf_counter() - start)
    batch.close()
    return float(np.median(times))


class Row(NamedTuple):
    """Results of one setup: way to the servers, number of environments, kind of batch."""

    servers: int
    envs: int
    way: str
    batch: str
    #: Time of a step with one environment on each server [s].
    round_trip: float
    #: Environment steps per second, one figure for each round.
    speeds: list[float]


def measure(servers: int, all_envs: list[int], delays: list[float], seconds: float, rounds: int) -> Iterator[Row]:
    """A row for each number of environments, way to the servers and kind of batch."""
    with contextlib.ExitStack() as stack:
        ways = places(stack, servers, delays)
        trips = {way: round_trip(addresses) for way, addresses in ways.items()}
        for envs in all_envs:
            cases = list(itertools.product(ways, KINDS))
            batches = [kind(envs, ways[way]) for way, kind in cases]
            table = [[batch.speed(seconds) for batch in batches] for _ in range(rounds)]
            for batch in batches:
                batch.close()
            for k, (way, kind) in enumerate(cases):
                yield Row(servers, envs, way, kind.__name__.lower(), trips[way], [of_round[k] for of_round in table])


def main() -> None:
    parser = argparse.ArgumentParser(description=str(__doc__).split("\n\n", maxsplit=1)[0])
    parser.add_argument("--servers", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--envs", type=int, nargs="+", default=[256, 4096])
    parser.add_argument(
        "--delays", type=float, nargs="*", default=[0.0, 0.5, 2.0], help="delays of the link in each direction [ms]"
    )
    parser.add_argument("--seconds", type=float, default=0.5, help="duration of one measurement [s]")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    if os.geteuid() != 0:
        parser.error("network namespaces need root")
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # so that namespaces and servers are removed
    how = (arguments.envs, arguments.delays, arguments.seconds, arguments.rounds)
    rows = [row for servers in arguments.servers for row in measure(servers, *how)]
    if arguments.json:
        print(json.dumps([row._asdict() for row in rows]))
        return
    for row in rows:
        print(
            f"{row.servers} servers, {row.envs:5} envs, {row.way:13} {row.batch:6} {np.median(row.speeds):8.0f} "
            f"env-steps/s ({min(row.speeds):.0f} to {max(row.speeds):.0f}); "
            f"one environment a server: {1e3 * row.round_trip:.2f} ms a step"
        )


if __name__ == "__main__":
    main()
