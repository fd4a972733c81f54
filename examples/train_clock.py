"""Searches for fast gaits of a clock: tripods of constant rate, a grid of two-speed clocks, and CMA-ES on all ten
parameters.

    python examples/train_clock.py                      # some ten minutes on two cores
    python examples/train_clock.py --generations 20 --coarse --out runs/try

All gaits are clocks of `sandgait/HexapodGait-v1` with control="clock", with the same motors, sand, start and measure of
energy. The program writes clocks.json, front.png and evaluation.txt into the output directory.
"""

from __future__ import annotations

import argparse
import itertools
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import numpy.typing as npt
from cmaes import CMA
from evaluate_gait import GAIT, Policy, Score, evaluate, table
from training import provenance

import sandgait

matplotlib.use("Agg")
import matplotlib.pyplot as plt

Values = npt.NDArray[np.float64]

#: Control steps of a trial: a whole episode. Fast tripods leave their direction only after some seconds, so shorter
#: trials would favour fast tripods.
STEPS = 500

#: Commanded speeds [m/s] for which the grid's rewards are compared: the task's range.
COMMANDS = np.linspace(0.1, 0.4, 31)

#: Width [m/s] of the task's tracking term.
TRACKING_WIDTH = 0.1

#: Penalty of a cost of transport above the limit, in m/s per unit: an excess of 0.01 outweighs any gain in speed.
EXCESS = 5.0


#: Number of clocks in a generation of one restart: twice that of Hansen's rule, 4 + 3 ln n, for ten parameters.
POPULATION = 22


@dataclass
class Trial:
    """Results of clocks, with one entry for each clock."""

    #: Mean speed along x [m/s].
    speed: Values
    #: Mechanical work / (weight · distance).
    cost_of_transport: Values
    #: [clocks, commands]: mean reward of a step that clock i would have with the commanded speed COMMANDS[j].
    rewards: Values


def trial(clocks: npt.NDArray[Any], seed: int, address: str | None, options: dict[str, Any]) -> Trial:
    """Runs an episode of each clock [clocks, 10], all from the same start."""
    n = len(clocks)
    env = sandgait.SandgaitVectorEnv(GAIT, n, address, autoreset_mode="SAME_STEP", control="clock", **options)
    env.reset(seed=[seed] * n)
    distance, work, running = np.zeros(n), np.zeros(n), np.ones(n, dtype=np.bool_)
    rewards = np.zeros((n, len(COMMANDS)))
    for _ in range(STEPS):
        _, reward, terminated, _, infos = env.step(clocks)
        running &= ~terminated
        tracking = np.exp(-(((infos["speed"][:, None] - COMMANDS) / TRACKING_WIDTH) ** 2))
        # A clock's action is constant, so it has no cost of smoothness. The change from action 0 in the first step is
        # left out.
        others = reward - infos["reward_tracking"] - infos["reward_smoothness"]
        rewards += np.where(running[:, None], tracking + others[:, None], 0.0)
        distance += infos["x_velocity"] / env.task.control_rate
        work += infos["work"]
    weight = float(infos["weight"][0])
    env.close()
    seconds = STEPS / env.task.control_rate
    distance[~running] = 0.0  # a fall counts as no distance
    with np.errstate(divide="ignore"):
        cost = np.where(distance > 0, work / (weight * np.maximum(distance, 1e-9)), np.inf)
    return Trial(distance / seconds, cost, rewards / STEPS)


def action(frequency: float, duty: float, sweep_deg: float, offset_deg: float) -> list[float]:
    """The action of a clock with the phases of an alternating tripod. The ranges are those of the task's actions."""
    return [frequency / 2.5 - 1, (duty - 0.5) / 0.3, (sweep_deg - 180) / 150, offset_deg / 90, *[0.0] * 6]


def tripods() -> npt.NDArray[np.float64]:
    """Clocks of constant rates from 0.25 to 5 Hz. A clock's rate is constant if its duty factor equals the share of the
    sweep in a turn."""
    return np.array([action(f, 0.5, 180, 0) for f in np.arange(0.25, 5.01, 0.25)])


def grid(coarse: bool) -> npt.NDArray[np.float64]:
    """Two-speed clocks with all combinations of frequency, duty factor, sweep and offset, and with the tripod's
    phases."""
    step = 2 if coarse else 1
    frequencies = np.arange(0.5, 5.01, 0.25)[::step]
    duties = np.linspace(0.2, 0.8, 7)[::step]
    sweeps = [30, 45, 60, 90, 120, 150, 180, 225, 270][::step]
    offsets = [-60, -40, -20, 0, 20, 40, 60][::step]
    return np.array([action(*row) for row in itertools.product(frequencies, duties, sweeps, offsets)])


def policy(clocks: Values) -> Policy:
    """A policy of clocks. `clocks` has one clock, or one for each entry of COMMANDS. Then a row gets the clock of the
    entry that is nearest to the row's commanded speed, its last column but one."""
    if len(clocks) == 1:
        return lambda rows: np.repeat(clocks, len(rows), axis=0)
    return lambda rows: clocks[np.abs(rows[:, -2:-1] - COMMANDS).argmin(axis=1)]


def evolve(limit: float, arguments: argparse.Namespace) -> tuple[Values, list[str]]:
    """Searches all ten parameters with CMA-ES for the fastest clock with a cost of transport up to `limit`. Returns
    this clock, and a line on each restart.

    The speed has many local maxima over the phases, so the restarts begin at the best of many random clocks near the
    greatest frequency.
    """
    address, options, restarts = arguments.address, arguments.options, arguments.restarts
    generator = np.random.default_rng(arguments.seed)
    random = generator.uniform(-1.0, 1.0, (arguments.random, 10))
    random[:, 0] = generator.uniform(0.8, 1.0, len(random))  # 4.5 to 5 Hz
    random[:, 1:4] = 0.0  # constant rate: near the motors' limit stance and swing can hardly differ
    starts = random[np.argsort(costs(in_parts(random, address, options), limit))[:restarts]]
    searches = [
        CMA(start, 0.2, bounds=np.array([[-1.0, 1.0]] * 10), seed=arguments.seed + i + 1, population_size=POPULATION)
        for i, start in enumerate(starts)
    ]
    for generation in range(arguments.generations):
        rows = np.array([[search.ask() for _ in range(POPULATION)] for search in searches])
        # All clocks of a generation have the same start, and each generation has a new start. So no clock is the best
        # because of its start.
        played = trial(rows.reshape(-1, 10), 1 + generation, address, options)
        values = costs(played, limit).reshape(restarts, POPULATION)
        for search, clocks, cost in zip(searches, rows, values, strict=True):
            search.tell([(clock, float(c)) for clock, c in zip(clocks, cost, strict=True)])
    # The result of a restart is the mean of its last generation, evaluated at a start that no generation had.
    means = np.array([search.mean for search in searches])
    last = trial(means, 0, address, options)
    pairs = zip(last.speed, last.cost_of_transport, strict=True)
    log = [f"CMA-ES, restart {i}: {v:.3f} m/s at a cost of transport of {c:.3f}" for i, (v, c) in enumerate(pairs)]
    return means[np.argmin(costs(last, limit))], log


def costs(played: Trial, limit: float) -> Values:
    """The objective that CMA-ES minimizes: minus the speed, plus a penalty for a cost of transport above the limit."""
    return EXCESS * np.maximum(0.0, np.minimum(played.cost_of_transport, 10.0) - limit) - played.speed


def in_parts(clocks: Values, address: str | None, options: dict[str, Any]) -> Trial:
    """Runs `trial` for many clocks, a thousand at a time."""
    parts = [trial(clocks[i : i + 1000], 0, address, options) for i in range(0, len(clocks), 1000)]
    columns = ("speed", "cost_of_transport", "rewards")
    return Trial(*(np.concatenate([getattr(part, name) for part in parts]) for name in columns))


def fastest(played: Trial, limit: float = np.inf) -> int:
    """The fastest clock whose cost of transport is no higher than `limit`."""
    return int(np.argmax(np.where(played.cost_of_transport <= limit, played.speed, -np.inf)))


def judge(clocks: dict[str, Values], address: str | None, options: dict[str, Any]) -> list[Score]:
    """Evaluates clocks over episodes with seeds that the search did not use."""
    options = {**options, "control": "clock"}
    return [evaluate(name, policy(rows), GAIT, address, **options) for name, rows in clocks.items()]


def draw(tripod: Trial, searched: Trial, evolved: Score, path: Path) -> None:
    """Draws the speed over the cost of transport."""
    figure, axes = plt.subplots(figsize=(7, 4.2), layout="constrained")
    axes.plot(searched.cost_of_transport, searched.speed, ".", color="C7", markersize=2, label="two-speed clocks, grid")
    axes.plot(tripod.cost_of_transport, tripod.speed, "o-", color="C0", label="tripods of constant rate, 0.25 to 5 Hz")
    axes.plot(evolved.cost_of_transport.mean(), evolved.speed.mean(), "*", color="C3", markersize=14, label="CMA-ES")
    axes.set(xlim=(0.4, 1.6), ylim=(0.0, None), xlabel="cost of transport", ylabel="speed [m/s]")
    axes.legend(loc="lower right")
    axes.grid(alpha=0.3)
    figure.savefig(path, dpi=150)


def save(out: Path, clocks: dict[str, Values], scores: list[Score], made_by: dict[str, Any]) -> None:
    """Writes the clocks and their scores. A clock is one action, or one for each entry of COMMANDS."""
    chosen = {name: rows.tolist() for name, rows in clocks.items()}
    summaries = {score.name: score.summary() for score in scores}
    made = {**made_by, "commands": COMMANDS.tolist(), "clocks": chosen, "scores": summaries}
    (out / "clocks.json").write_text(json.dumps(made, indent=1) + "\n")


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=str(__doc__).split("\n\n", maxsplit=1)[0])
    parser.add_argument(
        "--generations", type=int, default=70, help="generations of each restart of CMA-ES (%(default)s)"
    )
    parser.add_argument("--restarts", type=int, default=12, help="restarts of CMA-ES (%(default)s)")
    parser.add_argument(
        "--random",
        type=int,
        default=3000,
        help="random clocks to choose the starts from (%(default)s)",
    )
    parser.add_argument("--coarse", action="store_true", help="use a tenth of the grid")
    parser.add_argument("--seed", type=int, default=0, help="seed of CMA-ES (%(default)s)")
    parser.add_argument("--out", type=Path, default=Path("runs/clock"), help="output directory (%(default)s)")
    parser.add_argument(
        "--address", help="host:port or unix:/path of a running server; by default this process simulates"
    )
    parser.add_argument("--options", type=json.loads, default={}, help='task options as JSON: \'{"leg": "C"}\'')
    return parser.parse_args()


def main() -> None:
    arguments = parse()
    out, address, options = arguments.out, arguments.address, arguments.options
    out.mkdir(parents=True, exist_ok=True)
    made_by = {**provenance(), "seed": arguments.seed, "options": options}
    rates, two_speed = tripods(), grid(arguments.coarse)
    tripod, searched = in_parts(rates, address, options), in_parts(two_speed, address, options)
    print(f"{len(rates)} tripods and {len(two_speed)} two-speed clocks tried", flush=True)
    limit = float(tripod.cost_of_transport[fastest(tripod)])
    evolved, log = evolve(limit, arguments)
    clocks = {
        "fastest tripod": rates[fastest(tripod)][None],
        "fastest two-speed clock, same cost": two_speed[fastest(searched, limit)][None],
        "CMA-ES, same cost": evolved[None],
        "one tripod of the best return": rates[tripod.rewards.mean(axis=1).argmax()][None],
        "one two-speed clock of the best return": two_speed[searched.rewards.mean(axis=1).argmax()][None],
        "the best tripod for each command": rates[tripod.rewards.argmax(axis=0)],
        "the best two-speed clock for each command": two_speed[searched.rewards.argmax(axis=0)],
    }
    clocks = {name: rows.round(4) for name, rows in clocks.items()}  # rounded like the numbers in clocks.json
    scores = judge(clocks, address, options)
    text = "\n".join([table(scores), "", *log])
    (out / "evaluation.txt").write_text(text + "\n")
    save(out, clocks, scores, made_by)
    draw(tripod, searched, scores[2], out / "front.png")
    print(f"\n{text}\n\nEverything is in {out}/.")


if __name__ == "__main__":
    main()
