"""Compares the speed of simple programs with sandgait and with others, in turns, each in a process of its own:

- a step of one environment from `gymnasium.make`, and of gymnasium's Ant-v5: median [µs]
- a vector of 8 environments, and EnvPool's Ant-v5 with 8: environment steps per second

It needs sandgait, gymnasium[mujoco] and envpool in one environment.

usage: python benches/single.py [--seconds 1] [--rounds 5]
"""

from __future__ import annotations

import argparse
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np

#: Number of environments of the vector.
SMALL = 8


def single(id: str, seconds: float) -> float:
    """Median time of a step with random actions [µs]. Ends of episodes are included."""
    env = gymnasium.make(id)
    env.reset(seed=0)
    env.action_space.seed(0)
    actions = [env.action_space.sample() for _ in range(64)]
    times: list[float] = []
    end = time.perf_counter() + seconds
    while (start := time.perf_counter()) < end:
        _, _, terminated, truncated, _ = env.step(actions[len(times) % 64])
        times.append(time.perf_counter() - start)
        if terminated or truncated:
            env.reset()
    return 1e6 * statistics.median(times)


def vector(env: Any, seconds: float) -> float:
    """Environment steps per second with random actions."""
    space = env.action_space
    random = np.random.default_rng(0)
    low, high = np.ravel(space.low)[: space.shape[-1]], np.ravel(space.high)[: space.shape[-1]]
    actions = random.uniform(low, high, (64, SMALL, space.shape[-1])).astype(space.dtype)
    env.reset()
    steps, start = 0, time.perf_counter()
    while (now := time.perf_counter()) < start + seconds:
        env.step(actions[steps % 64])
        steps += 1
    return SMALL * steps / (now - start)


def ours(seconds: float) -> float:
    return vector(gymnasium.make_vec("sandgait/HexapodGait-v1", num_envs=SMALL), seconds)


def envpool(seconds: float) -> float:
    import envpool

    return vector(envpool.make("Ant-v5", env_type="gymnasium", num_envs=SMALL), seconds)


MEASURES: dict[str, tuple[Callable[[float], float], str]] = {
    "gymnasium.make sandgait/HexapodGait-v1": (lambda s: single("sandgait/HexapodGait-v1", s), "µs a step"),
    "gymnasium.make Ant-v5": (lambda s: single("Ant-v5", s), "µs a step"),
    f"{SMALL} sandgait/HexapodGait-v1": (ours, "env-steps/s"),
    f"{SMALL} EnvPool Ant-v5": (envpool, "env-steps/s"),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=str(__doc__).split("\n\n", maxsplit=1)[0])
    parser.add_argument("--seconds", type=float, default=1.0)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--only", choices=MEASURES, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.only:
        import sandgait  # noqa: F401 - registers the ids

        print(MEASURES[arguments.only][0](arguments.seconds))
        return
    found: dict[str, list[float]] = {name: [] for name in MEASURES}
    for _ in range(arguments.rounds):
        for name, values in found.items():
            command = [sys.executable, __file__, "--only", name, "--seconds", str(arguments.seconds)]
            run = subprocess.run(command, check=True, capture_output=True, text=True)
            values.append(float(run.stdout.splitlines()[-1]))
    for (name, values), (_, unit) in zip(found.items(), MEASURES.values(), strict=True):
        print(f"{name}: {statistics.median(values):,.0f} {unit} ({min(values):,.0f} to {max(values):,.0f})")
    step, ant, eight, pool = (statistics.median(values) for values in found.values())
    print(f"a step: {step / ant:.2f} of Ant-v5's; {SMALL} environments: {eight / pool:.1f} times EnvPool's")


if __name__ == "__main__":
    main()
