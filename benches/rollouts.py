"""Measures rollouts of 150 steps with clients in Rust and Python, and compares them with steps in this process; in
environment steps per second.

usage: taskset -c 0 python benches/rollouts.py [--envs 16 64 256 1024] [--seconds 1]
"""

from __future__ import annotations

import argparse
import json
import subprocess
import time

import numpy as np

import sandgait
from sandgait import server

ID = "sandgait/HexapodGait-v1"
STEPS = 150


def rust(envs: int, through: str, seconds: float) -> float:
    """Speed of `sandgait bench` with one thread: the median of five repeats, which take `seconds` together."""
    options = ["--envs", str(envs), "--threads", "1", "--repeats", "5", "--seconds", str(seconds / 5), "--json"]
    command = [*server.command(), "bench", "--through", through, *options]
    result = subprocess.run(command, capture_output=True, text=True, check=True)
    return float(json.loads(result.stdout)["env_steps_per_second"])


def python(envs: int, trajectories: bool, seconds: float) -> float:
    """Speed of rollouts on a separate server: the median over single rollouts."""
    env = sandgait.SandgaitVectorEnv(ID, envs)
    env.reset(seed=0)
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (STEPS, envs, 6)).astype(np.float32)
    times = []
    end = time.perf_counter() + seconds
    while not times or time.perf_counter() < end:
        start = time.perf_counter()
        env.rollout(actions, trajectories)
        times.append(time.perf_counter() - start)
    env.close()
    return STEPS * envs / float(np.median(times))


def main() -> None:
    parser = argparse.ArgumentParser(description=str(__doc__).split("\n\n", maxsplit=1)[0])
    parser.add_argument("--envs", type=int, nargs="+", default=[16, 64, 256, 1024])
    parser.add_argument("--seconds", type=float, default=1.0, help="duration of one measurement [s]")
    parser.add_argument("--python-only", action="store_true", help="leave out rollouts with the client in Rust")
    arguments = parser.parse_args()
    print("envs  in process   rust: returns, trajectories   python: returns, trajectories")
    for envs in arguments.envs:
        whole = rust(envs, "process", arguments.seconds)
        ways = [] if arguments.python_only else ["rollouts", "trajectories"]
        rates = [rust(envs, way, arguments.seconds) for way in ways]
        rates += [python(envs, trajectories, arguments.seconds) for trajectories in (False, True)]
        print(f"{envs:4} {whole:11.0f}  ", "  ".join(f"{rate:.0f} ({rate / whole:.1%})" for rate in rates))


if __name__ == "__main__":
    main()
