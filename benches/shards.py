"""Compares the same batch on one server with one thread, on two such servers, and on one server with two threads.

usage: python benches/shards.py [--envs 256 4096] [--seconds 0.5] [--rounds 5] [--json]

Each round measures all three, so other work of the machine affects all of them. Compare the ratios of each round.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import subprocess
import time
from collections.abc import Iterator

import numpy as np

import sandgait
from sandgait import server

ID = "sandgait/HexapodGait-v1"

#: Number of threads of each server, for each setup.
SETUPS = {"one server, 1 thread": [1], "two servers, 1 thread each": [1, 1], "one server, 2 threads": [2]}


@contextlib.contextmanager
def serving(threads: int) -> Iterator[str]:
    """Starts a server; yields its address."""
    command = [*server.command(), "serve", "--listen", "127.0.0.1:0", "--threads", str(threads)]
    pipe = subprocess.PIPE
    with subprocess.Popen([*command, "--exit-on-stdin-close"], stdin=pipe, stdout=pipe, text=True) as process:
        assert process.stdout is not None
        yield process.stdout.readline().removeprefix("listening on ").strip()


def speed(env: sandgait.SandgaitVectorEnv, seconds: float) -> float:
    """Environment steps per second."""
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (16, env.num_envs, 6)).astype(np.float32)
    steps, start = 0, time.perf_counter()
    while (elapsed := time.perf_counter() - start) < seconds:
        env.step(actions[steps % 16])
        steps += 1
    return env.num_envs * steps / elapsed


def measure(envs: int, seconds: float, rounds: int) -> dict[str, list[float]]:
    """Speeds of each setup, one for each round."""
    speeds: dict[str, list[float]] = {name: [] for name in SETUPS}
    with contextlib.ExitStack() as stack:
        batches = {}
        for name, threads in SETUPS.items():
            addresses = [stack.enter_context(serving(count)) for count in threads]
            batches[name] = sandgait.SandgaitVectorEnv(ID, envs, addresses)
            stack.callback(batches[name].close)
            batches[name].reset(seed=0)
        for _ in range(rounds):
            for name, batch in batches.items():
                speeds[name].append(speed(batch, seconds))
    return speeds


def main() -> None:
    parser = argparse.ArgumentParser(description=str(__doc__).split("\n\n", maxsplit=1)[0])
    parser.add_argument("--envs", type=int, nargs="+", default=[256, 4096])
    parser.add_argument("--seconds", type=float, default=0.5, help="duration of one measurement [s]")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    results = {envs: measure(envs, arguments.seconds, arguments.rounds) for envs in arguments.envs}
    if arguments.json:
        print(json.dumps(results))
        return
    for envs, speeds in results.items():
        (_, base), *_ = speeds.items()
        for name, values in speeds.items():
            ratios = np.divide(values, base)
            middle, worst, best = np.median(values), min(values), max(values)
            print(
                f"{envs:6} envs, {name:27} {middle:9.0f} env-steps/s ({worst:.0f} to {best:.0f}); "
                f"ratio {np.median(ratios):.2f} ({min(ratios):.2f} to {max(ratios):.2f})"
            )


if __name__ == "__main__":
    main()
