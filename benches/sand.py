"""Speed of sand for other simulators, in turns:

- a call of `Sand.wrench` for the nine bodies of gymnasium's Ant-v5, one state: median [µs]
- the same for 256 states of a Go1's 13 bodies, with threads for two processors: median [ms]
- steps per second of Ant-v5 on sand and on its floor, and their ratio

It needs sandgait[mujoco].

usage: python benches/sand.py [--seconds 1] [--rounds 5]
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable
from typing import Any

import gymnasium
import mujoco
import numpy as np

import sandgait
from sandgait.mujoco import add_sand
from sandgait.wrappers import OnSand


def median(call: Callable[[], Any], seconds: float) -> float:
    """Median time of a call [s]."""
    times: list[float] = []
    end = time.perf_counter() + seconds
    while (start := time.perf_counter()) < end:
        call()
        times.append(time.perf_counter() - start)
    return statistics.median(times)


def ant() -> Callable[[], Any]:
    """The ant stands in the sand."""
    env = gymnasium.make("Ant-v5")
    base: Any = env.unwrapped
    model, data = base.model, base.data
    sand = sandgait.Sand("poppy-loose")
    ground = add_sand(model, sand)
    ground.step(data, nstep=200)
    mujoco.mj_forward(model, data)
    index = ground._bodies
    jacobian = np.empty((len(index), 6, model.nv))
    for k, body in enumerate(index):
        mujoco.mj_jacBody(model, data, jacobian[k, :3], jacobian[k, 3:], body)
    speed = jacobian @ data.qvel
    bodies = sandgait.Bodies(ground._shapes)
    place, turn = data.xpos[index].copy(), data.xquat[index].copy()
    linear, angular = speed[:, :3].copy(), speed[:, 3:].copy()
    wet = np.count_nonzero(sand.wrench(bodies, place, turn, linear, angular)[:, 2])
    print(f"Ant-v5: {len(index)} bodies, {wet} of them in the sand")
    out = np.empty((len(index), 6))
    return lambda: sand.wrench(bodies, place, turn, linear, angular, out=out)


def go1(states: int = 256) -> Callable[[], Any]:
    """Boxes, cylinders and balls of a Go1's size: a trunk, and four legs of hip, thigh and calf; feet in sand."""
    sand = sandgait.Sand("poppy-loose")
    shapes: dict[str, Any] = {"trunk": "box:length=0.3762,width=0.0935,height=0.114"}
    places, random = [(0.0, 0.0, 0.28)], np.random.default_rng(0)
    for name, x, y in [("FR", 0.19, -0.05), ("FL", 0.19, 0.05), ("RR", -0.19, -0.05), ("RL", -0.19, 0.05)]:
        shapes[f"{name} hip"] = "cylinder:radius=0.046,width=0.04"
        upright = (0.7071068, 0, 0.7071068, 0)
        shapes[f"{name} thigh"] = ("box:length=0.213,width=0.0245,height=0.034", (0, 0, -0.1065), upright)
        calf = ("box:length=0.213,width=0.016,height=0.016", (0, 0, -0.1065), upright)
        shapes[f"{name} calf"] = [calf, ("sphere:radius=0.02", (0, 0, -0.213), (1, 0, 0, 0))]
        places += [(x, y, 0.28), (x, 1.6 * y, 0.28), (x - 0.05, 1.6 * y, 0.21)]
    bodies = sandgait.Bodies(shapes)
    place = np.tile(np.array(places, np.float32), (states, 1, 1))
    place[..., 2] += random.uniform(-0.01, 0.01, (states, 1)).astype(np.float32)
    turn = np.zeros((states, len(shapes), 4), np.float32)
    turn[..., 0] = 1.0
    speed = random.normal(size=(2, states, len(shapes), 3)).astype(np.float32)
    out = np.empty((states, len(shapes), 6), np.float32)
    wet = np.count_nonzero(sand.wrench(bodies, place, turn, *speed)[..., 2]) / states
    print(f"Go1: {len(shapes)} bodies, {wet:.1f} of them in the sand")
    return lambda: sand.wrench(bodies, place, turn, *speed, out=out)


def steps(env: Any, seconds: float) -> float:
    """Steps per second with random actions. Ends of episodes are included."""
    env.reset(seed=0)
    env.action_space.seed(0)
    actions = [env.action_space.sample() for _ in range(64)]
    count, start = 0, time.perf_counter()
    while (now := time.perf_counter()) < start + seconds:
        _, _, terminated, truncated, _ = env.step(actions[count % 64])
        count += 1
        if terminated or truncated:
            env.reset()
    return count / (now - start)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=1.0, help="for each measurement")
    parser.add_argument("--rounds", type=int, default=5, help="number of turns")
    options = parser.parse_args()
    small, large = ant(), go1()
    on_sand, on_floor = OnSand(gymnasium.make("Ant-v5")), gymnasium.make("Ant-v5")
    rows = []
    for _ in range(options.rounds):
        sandy, plain = steps(on_sand, options.seconds), steps(on_floor, options.seconds)
        rows.append((1e6 * median(small, options.seconds), 1e3 * median(large, options.seconds), sandy, plain))
    one, many, sandy, plain = (statistics.median(column) for column in zip(*rows, strict=True))
    ratio = statistics.median(row[2] / row[3] for row in rows)
    print(f"one Ant: {one:.1f} µs a call; 256 Go1: {many:.2f} ms a call")
    print(f"Ant-v5: {sandy:,.0f} steps/s on sand, {plain:,.0f} on its floor: {ratio:.0%}")


if __name__ == "__main__":
    main()
