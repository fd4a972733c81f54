"""Searches for the stroke of one leg with the most thrust for its work: the best circular stroke, and its improvement
by CMA-ES.

    python examples/train_stroke.py                     # some minutes on two cores
    python examples/train_stroke.py --generations 20 --out runs/try

In a circular stroke the knee angle is constant, and the hip turns at a constant speed. A grid search finds the best
knee angle, start angle of the hip, and speed. CMA-ES starts from the best circular stroke. It searches both start
angles, and the speeds of both joints at ten times of the stroke; between these times the speeds are linear. Strokes are
compared by the task's return: the efficiency minus the penalty for missing lift. The program writes strokes.json,
strokes.png and evaluation.txt into the output directory.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import numpy.typing as npt
from cmaes import CMA
from training import provenance

import sandgait

matplotlib.use("Agg")
import matplotlib.pyplot as plt

TASK = "sandgait/LegStroke-v0"

Values = npt.NDArray[np.float64]

#: Number of times in a stroke at which CMA-ES chooses the speeds of both joints.
KNOTS = 10

#: Start angles of the hip for circular strokes [rad]: those at which the leg is outside of the sand, and that of the
#: task.
HIPS = np.arange(-3.0, 3.01, 0.25)

#: Hip speeds of circular strokes, as actions: up to one turn in a second, in both directions.
SPEEDS = np.linspace(-1.0, 1.0, 81)


#: Number of strokes in a generation: twice that of Hansen's rule, 4 + 3 ln n, for 22 parameters.
POPULATION = 26

#: Hip and knee angle at the task's own start [rad], and the greatest distance of CMA-ES's starts from it [rad].
START, REACH = np.array([-1.75, 0.0]), np.array([1.25, 1.5])

#: Value of a stroke that begins in the sand. Every return is greater.
REFUSED = -4.0


@dataclass
class Stroke:
    """One stroke and its result."""

    name: str
    #: Hip and knee angle [rad] at the start.
    start: list[float]
    #: [steps, 2]: speeds of hip and knee, in turns per second.
    actions: Values
    #: The task's return, which is the efficiency if no lift is missing.
    score: float


def circular(knees: Values, options: dict[str, Any]) -> Stroke:
    """The best of all circular strokes on a grid."""
    env = sandgait.SandgaitVectorEnv(TASK, len(SPEEDS), **options)
    steps = env.task.max_episode_steps
    rows = np.zeros((steps, len(SPEEDS), 2))
    rows[:, :, 0] = SPEEDS
    best = Stroke("none", [], rows[:, 0], -np.inf)
    tried = 0
    for knee in knees:
        for hip in HIPS:
            stroke = {**options.get("stroke", {}), "start": [float(hip), float(knee)]}
            try:
                env.reset(seed=0, options={"stroke": stroke})
            except sandgait.InvalidRequest:
                continue  # the stroke begins in the sand
            returns = env.rollout(rows).returns
            tried += len(SPEEDS)
            i = int(np.argmax(returns))
            if returns[i] > best.score:
                best = Stroke("best circular stroke", [float(hip), float(knee)], rows[:, i], float(returns[i]))
    env.close()
    print(f"{tried} circular strokes tried", flush=True)
    return best


def speeds(knots: Values, steps: int) -> Values:
    """Actions [steps, n, 2], linear between the knots [n, 2 · KNOTS]."""
    times, ends = np.linspace(0.0, 1.0, steps), np.linspace(0.0, 1.0, KNOTS)
    tracks = [[np.interp(times, ends, row[j * KNOTS :][:KNOTS]) for j in range(2)] for row in knots]
    return np.array(tracks).transpose(2, 0, 1)


def begin(env: sandgait.SandgaitVectorEnv, starts: Values, options: dict[str, Any]) -> npt.NDArray[np.bool_]:
    """Resets every environment to its own start angles. Returns which starts are refused because the leg would be in
    the sand."""
    refused = np.zeros(env.num_envs, dtype=np.bool_)
    for i, start in enumerate(starts):
        mask = np.arange(env.num_envs) == i
        stroke = {**options.get("stroke", {}), "start": start.tolist()}
        try:
            env.reset(seed=[0] * env.num_envs, options={"stroke": stroke, "reset_mask": mask})
        except sandgait.InvalidRequest:
            refused[i] = True
    return refused


def evolved(first: Stroke, arguments: argparse.Namespace, options: dict[str, Any]) -> Stroke:
    """The best stroke of several restarts of CMA-ES, which start from `first` and also search the start angles."""
    env = sandgait.SandgaitVectorEnv(TASK, POPULATION, **options)
    steps = env.task.max_episode_steps
    env.reset(seed=0)
    best = Stroke("none", [], np.zeros((steps, 2)), -np.inf)
    point = [np.repeat(first.actions[0], KNOTS), (np.array(first.start) - START) / REACH]
    for restart in range(arguments.restarts):
        search = CMA(
            np.clip(np.concatenate(point), -1.0, 1.0),
            0.2,
            bounds=np.array([[-1.0, 1.0]] * (2 * KNOTS + 2)),
            seed=arguments.seed + restart,
            population_size=POPULATION,
        )
        top = -np.inf
        for _ in range(arguments.generations):
            points = np.array([search.ask() for _ in range(POPULATION)])
            starts = START + points[:, -2:] * REACH
            refused = begin(env, starts, options)
            rows = speeds(points[:, :-2], steps)
            returns = np.where(refused, REFUSED, env.rollout(rows).returns)
            search.tell([(point, -float(value)) for point, value in zip(points, returns, strict=True)])
            i = int(np.argmax(returns))
            top = max(top, float(returns[i]))
            if returns[i] > best.score:
                best = Stroke("CMA-ES", starts[i].tolist(), rows[:, i], float(returns[i]))
        print(f"CMA-ES, seed {arguments.seed + restart}: {top:.3f}", flush=True)
    env.close()
    return best


def play(stroke: Stroke, options: dict[str, Any]) -> dict[str, Values]:
    """Runs a stroke. Returns angles [rad], thrust and lift [N] of each step, and the stroke's return."""
    given = {**options, "stroke": {**options.get("stroke", {}), "start": stroke.start}}
    env = sandgait.SandgaitVectorEnv(TASK, 1, **given)
    rows, _ = env.reset(seed=0)
    names = ("thrust", "lift", "work", "efficiency", "mean_lift")
    track: dict[str, list[Any]] = {name: [] for name in ("hip", "knee", "reward", *names)}
    for action in stroke.actions:
        track["hip"].append(np.arctan2(rows[0, 0], rows[0, 2]))
        track["knee"].append(np.arctan2(rows[0, 1], rows[0, 3]))
        rows, reward, _, _, infos = env.step(action[None])
        track["reward"].append(reward[0])
        for name in names:
            track[name].append(infos[name][0])
    env.close()
    return {name: np.array(column) for name, column in track.items()}


def table(strokes: list[Stroke], tracks: list[dict[str, Values]]) -> str:
    lines = ["stroke                 return  efficiency  mean lift [N]  mean thrust [N]  work [J]  start [rad]"]
    for stroke, track in zip(strokes, tracks, strict=True):
        figures = [track["reward"].sum(), track["efficiency"][-1], track["mean_lift"][-1], track["thrust"].mean()]
        text = "  ".join(f"{x:.3f}" for x in [*figures, track["work"].sum()])
        lines.append(f"{stroke.name:21}  {text}  [{stroke.start[0]:.2f}, {stroke.start[1]:.2f}]")
    return "\n".join([*lines, f"gain: {100 * (strokes[1].score / strokes[0].score - 1):.0f} %"])


def draw(strokes: list[Stroke], tracks: list[dict[str, Values]], path: Path) -> None:
    figure, axes = plt.subplots(2, 1, figsize=(7, 6), layout="constrained", sharex=True)
    time = np.arange(len(strokes[0].actions)) / len(strokes[0].actions)
    for number, (stroke, track) in enumerate(zip(strokes, tracks, strict=True)):
        for name, line in (("hip", "-"), ("knee", "--")):
            label = f"{stroke.name}, {name}"
            axes[0].plot(time, np.degrees(np.unwrap(track[name])), line, color=f"C{number}", label=label)
        axes[1].plot(time, track["thrust"], "-", color=f"C{number}", label=f"{stroke.name}, thrust")
        axes[1].plot(time, track["lift"], "--", color=f"C{number}", label=f"{stroke.name}, lift")
    axes[0].set(ylabel="angle [°]")
    axes[1].set(xlabel="share of the stroke", ylabel="force of the sand [N]")
    for part in axes:
        part.legend(fontsize="small")
        part.grid(alpha=0.3)
    figure.savefig(path, dpi=120)


def main() -> None:
    parser = argparse.ArgumentParser(description=str(__doc__).split("\n\n", maxsplit=1)[0])
    parser.add_argument(
        "--generations", type=int, default=400, help="generations of each restart of CMA-ES (%(default)s)"
    )
    parser.add_argument("--restarts", type=int, default=3, help="restarts of CMA-ES (%(default)s)")
    parser.add_argument(
        "--knees", type=int, default=15, help="number of knee angles of the circular strokes (%(default)s)"
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of CMA-ES (%(default)s)")
    parser.add_argument("--out", type=Path, default=Path("runs/stroke"), help="output directory (%(default)s)")
    parser.add_argument("--options", type=json.loads, default={}, help='task options as JSON: \'{"medium": "…"}\'')
    arguments = parser.parse_args()
    out, options = arguments.out, arguments.options
    out.mkdir(parents=True, exist_ok=True)
    made_by = {**provenance(), "seed": arguments.seed, "options": options}
    best = circular(np.linspace(-2.1, 2.1, arguments.knees), options)
    strokes = [best, evolved(best, arguments, options)]
    tracks = [play(stroke, options) for stroke in strokes]
    text = table(strokes, tracks)
    kept = [{"name": s.name, "start": s.start, "score": s.score, "actions": s.actions.tolist()} for s in strokes]
    (out / "strokes.json").write_text(json.dumps({**made_by, "strokes": kept}) + "\n")
    (out / "evaluation.txt").write_text(text + "\n")
    draw(strokes, tracks, out / "strokes.png")
    print(f"\n{text}\n\nEverything is in {out}/.")


if __name__ == "__main__":
    main()
