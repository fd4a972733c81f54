"""An evolution strategy on a Ray cluster. It searches for the open-loop gait that follows the commanded speed best.

A gait has nine numbers: the mean speed of each of the six hips, and the amplitude, frequency and phase of a wave. The
waves of the two tripods are half a turn apart. Every node has a server and an evaluator, which runs its part of the
candidates. One message to the server has the actions of a whole episode of all these candidates. All candidates of a
generation have the same start, so their returns differ only because of their gaits.

usage: python examples/ray_es.py [--generations 20] [--population 256] [--ray auto]
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np
import numpy.typing as npt
import ray

import sandgait
import sandgait.ray

ID = "sandgait/HexapodGait-v1"
Array = npt.NDArray[np.float64]

#: Six mean hip speeds; amplitude, frequency [Hz] and phase [rad] of the wave.
START = np.array([0.2] * 6 + [0.1, 1.0, 0.0])

#: Standard deviation of the candidates: our choice, about a tenth of the numbers' range, so that most stay in the
#: range.
SIGMA = np.array([0.1] * 6 + [0.1, 0.3, 0.5])

#: Step of a number's mean, in standard deviations, if the number is fully correlated with the rank: our choice,
#: untuned.
RATE = 4.0

#: Control steps of an episode: 3 s.
STEPS = 150


def actions(gaits: Array, rate: float) -> npt.NDArray[np.float32]:
    """Actions, f32 [STEPS, gaits, 6], of the gaits [gaits, 9]. `rate`: control steps in a second [Hz]."""
    time_ = np.arange(STEPS)[:, None, None] / rate
    amplitude, frequency, phase = (gaits[:, k : k + 1] for k in (6, 7, 8))
    tripod = np.arange(6) % 2
    wave = amplitude * np.sin(2 * np.pi * frequency * time_ + phase + np.pi * tripod)
    return np.clip(gaits[:, :6] + wave, -1.0, 1.0).astype(np.float32)


class Evaluator:
    """Runs candidates on one server."""

    def __init__(self, address: str, share: int) -> None:
        self.env = sandgait.SandgaitVectorEnv(ID, share, address, command=[0.3, 0.3])

    def returns(self, gaits: Array, seed: int) -> Array:
        """Return of an episode of each gait. `seed` determines the start."""
        self.env.reset(seed=[seed] * len(gaits))
        return self.env.rollout(actions(gaits, self.env.task.control_rate)).returns


def evolve(
    servers: sandgait.ray.Servers, generations: int, population: int, seed: int = 0
) -> tuple[Array, list[float]]:
    """The mean gait after `generations`, and the mean return of each generation."""
    shares = np.array_split(np.arange(population), len(servers.addresses))
    remote = ray.remote(Evaluator)
    evaluators: list[Any] = [
        remote.options(num_cpus=0, **servers.on(k)).remote(address, len(shares[k]))
        for k, address in enumerate(servers.addresses)
    ]
    random = np.random.default_rng(seed)
    mean, curve = START.copy(), []
    for generation in range(generations):
        half = random.standard_normal((population // 2, mean.size))
        noise = np.concatenate([half, -half])  # antithetic pairs, so that the return of the mean gait cancels
        gaits = mean + SIGMA * noise
        parts = [e.returns.remote(gaits[part], seed + generation) for e, part in zip(evaluators, shares, strict=True)]
        returns = np.concatenate(ray.get(parts))
        ranks = returns.argsort().argsort() / (population - 1) - 0.5  # ranks do not depend on the scale of the rewards
        correlation = ranks @ noise / population / np.sqrt(np.mean(ranks**2))
        mean = mean + RATE * SIGMA * correlation
        curve.append(float(returns.mean()))
        print(f"generation {generation:3}: mean return {returns.mean():7.2f}, best {returns.max():7.2f}")
    return mean, curve


def main() -> None:
    parser = argparse.ArgumentParser(description=str(__doc__).split("\n\n", maxsplit=1)[0])
    parser.add_argument("--generations", type=int, default=20)
    parser.add_argument("--population", type=int, default=256, help="even number of candidates in a generation")
    parser.add_argument(
        "--ray", default=None, metavar="ADDRESS", help="address of a running cluster; by default this machine"
    )
    arguments = parser.parse_args()
    if arguments.population < 2 or arguments.population % 2:
        parser.error(f"--population: {arguments.population} is no even number from 2 on")
    ray.init(arguments.ray, log_to_driver=False)
    with sandgait.ray.serve() as servers:
        start = time.perf_counter()
        gait, curve = evolve(servers, arguments.generations, arguments.population)
        steps = arguments.generations * arguments.population * STEPS
        seconds = time.perf_counter() - start
    ray.shutdown()
    print(f"{steps} environment steps on {len(servers.nodes)} servers in {seconds:.1f} s")
    print(f"mean return {curve[0]:.1f} at first, {curve[-1]:.1f} at last")
    print("gait:", np.round(gait, 2).tolist())


if __name__ == "__main__":
    main()
