"""A step of `gymnasium.make`, as every tutorial writes it, beside gymnasium's own Ant-v5: median [µs].

Both take turns, each in a process of its own. Needs sandgait and gymnasium[mujoco] in one environment.

usage: python benches/single.py [--seconds 1] [--rounds 5]
"""

from __future__ import annotations

import argparse
import statistics
import subprocess
import sys
import time

import gymnasium

IDS = ("sandgait/HexapodGait-v1", "Ant-v5")


def measure(id: str, seconds: float) -> float:
    """Median of a step with random actions; episodes end and begin."""
    if id.startswith("sandgait"):
        import sandgait  # noqa: F401 - registers the ids
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


def main() -> None:
    parser = argparse.ArgumentParser(description=str(__doc__).split("\n\n", maxsplit=1)[0])
    parser.add_argument("--seconds", type=float, default=1.0)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--only", choices=IDS, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.only:
        print(measure(arguments.only, arguments.seconds))
        return
    found: dict[str, list[float]] = {id: [] for id in IDS}
    for _ in range(arguments.rounds):
        for id, times in found.items():
            command = [sys.executable, __file__, "--only", id, "--seconds", str(arguments.seconds)]
            run = subprocess.run(command, check=True, capture_output=True, text=True)
            times.append(float(run.stdout.splitlines()[-1]))
    ours, theirs = (statistics.median(times) for times in found.values())
    for id, times in found.items():
        print(f"{id}: {statistics.median(times):.0f} µs ({min(times):.0f} to {max(times):.0f})")
    print(f"ratio {ours / theirs:.2f}")


if __name__ == "__main__":
    main()
