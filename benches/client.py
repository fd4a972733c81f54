"""Measures the speed of `step` calls from Python and compares it with `sandgait bench`. The environments are in this
process or, with `--isolated`, on a server at a Unix socket.

`own` is the time of a step call minus the time of the simulation.

usage: python benches/client.py [--envs 1 32 256 4096] [--seconds 2] [--isolated] [--json]
"""

from __future__ import annotations

import argparse
import json
import subprocess
import time
from typing import Any

import numpy as np

import sandgait
from sandgait import server

ID = "sandgait/HexapodGait-v1"


def in_process(envs: int, threads: int) -> float:
    """Environment steps per second of `sandgait bench`, without gRPC and Python."""
    command = [
        *server.command(),
        "bench",
        "--envs",
        str(envs),
        "--threads",
        str(threads),
        "--repeats",
        "5",
        "--json",
    ]
    result = subprocess.run(command, capture_output=True, text=True, check=True)
    return float(json.loads(result.stdout)["env_steps_per_second"])


def through_python(envs: int, seconds: float, isolated: bool) -> dict[str, float]:
    """Environment steps per second, and the time of a step call [µs], with random actions. Ends of episodes are
    included."""
    env = sandgait.SandgaitVectorEnv(ID, envs, isolated=isolated)
    env.reset(seed=0)
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (64, envs, 6)).astype(np.float32)
    times: list[float] = []
    end = time.perf_counter() + seconds
    while (start := time.perf_counter()) < end:
        env.step(actions[len(times) % 64])
        times.append(time.perf_counter() - start)
    env.close()
    median, high = np.percentile(times, [50, 99])
    rate = envs * len(times) / sum(times)
    return {"envs": envs, "p50_us": 1e6 * median, "p99_us": 1e6 * high, "env_steps_per_second": rate}


def main() -> None:
    parser = argparse.ArgumentParser(description=str(__doc__).split("\n\n", maxsplit=1)[0])
    parser.add_argument("--envs", type=int, nargs="+", default=[1, 32, 256, 4096])
    parser.add_argument("--seconds", type=float, default=2.0, help="duration of one measurement [s]")
    parser.add_argument("--isolated", action="store_true", help="use a separate server process")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    rows: list[dict[str, Any]] = []
    for envs in arguments.envs:
        row: dict[str, Any] = through_python(envs, arguments.seconds, arguments.isolated)
        row["in_process"] = in_process(envs, threads=0)
        row["share"] = row["env_steps_per_second"] / row["in_process"]
        row["own_us"] = row["p50_us"] - 1e6 * envs / row["in_process"]
        rows.append(row)
    if arguments.json:
        print(json.dumps(rows))
        return
    columns = ["envs", "p50_us", "p99_us", "own_us", "env_steps_per_second", "in_process"]
    print("  ".join([*columns, "share"]))
    for row in rows:
        print("  ".join(f"{row[c]:>{len(c)}.0f}" for c in columns), f"{row['share']:>6.0%}")


if __name__ == "__main__":
    main()
