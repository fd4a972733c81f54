"""Draws the learning curves of several seeds: their mean, and the band between the worst and the best.

    python examples/train_curves.py runs/gait-0 runs/gait-1 runs/gait-2 --out curve.png

Each run is an output directory of train.py, or a curve.csv.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib
import numpy as np
from training import read_curve

matplotlib.use("Agg")
import matplotlib.pyplot as plt

#: Number of points on the common axis of steps.
POINTS = 200


def draw(paths: list[Path], path: Path, title: str) -> None:
    """Draws the returns over the steps, up to the end of the shortest run."""
    curves = [read_curve(p / "curve.csv" if p.is_dir() else p) for p in paths]
    last = min(curve[-1].steps for curve in curves)
    steps = np.linspace(max(curve[0].steps for curve in curves), last, POINTS)
    returns = np.array([np.interp(steps, [r.steps for r in c], [r.mean_return for r in c]) for c in curves])
    figure, axes = plt.subplots(figsize=(7, 4.2), layout="constrained")
    if len(curves) > 1:
        axes.fill_between(steps / 1e6, returns.min(axis=0), returns.max(axis=0), alpha=0.25, label="worst to best seed")
    mean = f"mean of {len(curves)} seeds" if len(curves) > 1 else "one seed"
    axes.plot(steps / 1e6, returns.mean(axis=0), label=mean)
    axes.set(title=title, xlabel="environment steps [millions]", ylabel="return of an episode while it explores")
    axes.legend(loc="lower right")
    axes.grid(alpha=0.3)
    figure.savefig(path, dpi=120)


def main() -> None:
    parser = argparse.ArgumentParser(description=str(__doc__).split("\n\n", maxsplit=1)[0])
    parser.add_argument("runs", type=Path, nargs="+", help="output directories of train.py, or files curve.csv")
    parser.add_argument("--out", type=Path, default=Path("curve.png"), help="file of the picture (%(default)s)")
    parser.add_argument("--title", default="", help="title of the picture")
    arguments = parser.parse_args()
    draw(arguments.runs, arguments.out, arguments.title)


if __name__ == "__main__":
    main()
