"""Train a hexapod to walk on sand with PPO, and compare it with gaits that need no learning.

    python examples/train_gait.py                        # five minutes on two cores
    python examples/train_gait.py --seconds 60 --out runs/try
    python examples/train_gait.py --address lab:50051    # simulate on another machine

Written to the output directory: policy.zip, normalize.pkl, settings.json, curve.csv, curve.png, evaluation.txt.
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
import time
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import torch
from evaluate_gait import Score, constant_rate, evaluate, learnt, random_actions, table
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize
from tqdm import tqdm

import sandgait

matplotlib.use("Agg")
import matplotlib.pyplot as plt

ID = "sandgait/HexapodGait-v0"

#: Found by trying: a horizon of some strides (gamma), wide exploration at first, many updates of few steps each.
#: Minibatches below 512 cost PPO more time than they teach.
PPO_SETTINGS: dict[str, Any] = {
    "n_steps": 32,
    "batch_size": 1024,
    "n_epochs": 6,
    "gamma": 0.95,
    "gae_lambda": 0.95,
    "policy_kwargs": {"log_std_init": 0.0, "net_arch": [64, 64]},
}

#: At the beginning; it falls to zero.
LEARNING_RATE = 1e-3


class Decay:
    """Learning rate that falls to zero as `share` of the training goes from 0 to 1."""

    def __init__(self, rate: float) -> None:
        self.rate, self.share = rate, 0.0

    def __call__(self, _remaining: float) -> float:
        return self.rate * (1.0 - self.share)


class Progress(BaseCallback):
    """Progress bar, learning curve, learning rate, and the end when time is up."""

    def __init__(self, seconds: float, steps: int, rate: Decay) -> None:
        super().__init__()
        self.seconds, self.steps, self.rate = seconds, steps, rate
        #: Environment steps, seconds, mean return of the episodes that ended during the last batch of steps.
        self.curve: list[tuple[int, float, float]] = []
        self.returns: list[float] = []

    def _on_training_start(self) -> None:
        self.start = time.monotonic()
        form = "{desc}{percentage:3.0f} %|{bar}| {elapsed} < {remaining}"
        pause = 0.5 if sys.stderr.isatty() else 20.0  # a log file wants few lines
        self.bar = tqdm(total=1.0, desc="training", bar_format=form, mininterval=pause)

    def _on_step(self) -> bool:
        self.returns += [info["episode"]["r"] for info in self.locals["infos"] if "episode" in info]
        return time.monotonic() - self.start < self.seconds

    def _on_rollout_end(self) -> None:
        seconds = time.monotonic() - self.start
        if self.returns:
            self.curve.append((self.num_timesteps, seconds, float(np.mean(self.returns))))
            self.returns = []
            text = f"{self.num_timesteps / 1e6:.2f} M steps, return {self.curve[-1][2]:.0f}"
            self.bar.set_description(text, refresh=False)
        self.rate.share = min(1.0, max(seconds / self.seconds, self.num_timesteps / self.steps))
        self.bar.update(self.rate.share - self.bar.n)

    def _on_training_end(self) -> None:
        self.bar.close()


def train(arguments: argparse.Namespace, options: dict[str, Any]) -> tuple[PPO, VecNormalize, Progress]:
    """PPO for as long as the arguments allow."""
    env = VecMonitor(sandgait.make_sb3(ID, arguments.envs, arguments.address, **options))
    normalized = VecNormalize(env, gamma=PPO_SETTINGS["gamma"])
    rate = Decay(LEARNING_RATE)
    model = PPO("MlpPolicy", normalized, learning_rate=rate, seed=arguments.seed, device="cpu", **PPO_SETTINGS)
    progress = Progress(arguments.seconds, arguments.steps, rate)
    model.learn(arguments.steps, callback=progress)
    normalized.training = False
    return model, normalized, progress


def compare(model: PPO, normalized: VecNormalize, address: str | None, options: dict[str, Any]) -> list[Score]:
    """The learnt gait, the best of all constant rates at the same motors, and no skill at all; same unseen seeds."""

    def score(name: str, policy: Any) -> Score:
        return evaluate(name, policy, address=address, **options)

    tripods = [score(f"tripod at {f:.2f} Hz, the best rate", constant_rate(f)) for f in np.arange(0.25, 5.01, 0.25)]
    best = max(tripods, key=lambda s: float(s.returns.mean()))
    return [score("learnt (PPO)", learnt(model, normalized)), best, score("random actions", random_actions())]


def draw(curve: list[tuple[int, float, float]], scores: list[Score], path: Path) -> None:
    """Learning curve with the other gaits' returns as lines."""
    steps, seconds, returns = np.array(curve).T
    figure, axes = plt.subplots(figsize=(7, 4.2), layout="constrained")
    axes.plot(steps / 1e6, returns, color="C0", label="PPO while it explores")
    for number, score in enumerate(scores):
        axes.axhline(score.returns.mean(), color=f"C{number}", linestyle="--", linewidth=1, label=score.name)
    axes.set_xlabel(f"environment steps [millions], {seconds[-1]:.0f} s in all")
    axes.set_ylabel("return of a 10 s episode")
    axes.legend(loc="lower right")
    axes.grid(alpha=0.3)
    figure.savefig(path, dpi=150)


def save(out: Path, model: PPO, normalized: VecNormalize, curve: list[tuple[int, float, float]], settings: Any) -> None:
    model.save(out / "policy.zip")
    normalized.save(str(out / "normalize.pkl"))
    (out / "settings.json").write_text(json.dumps(settings, indent=2) + "\n")
    with (out / "curve.csv").open("w", newline="") as file:
        csv.writer(file).writerows([("steps", "seconds", "return"), *curve])


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=str(__doc__).split("\n\n", maxsplit=1)[0])
    parser.add_argument("--seconds", type=float, default=240.0, help="training ends after this time (%(default)s)")
    parser.add_argument("--steps", type=int, default=10_000_000, help="or after this many steps (%(default)s)")
    parser.add_argument("--envs", type=int, default=128, help="environments side by side (%(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="of the policy and of the environments (%(default)s)")
    parser.add_argument("--out", type=Path, default=Path("runs/gait"), help="output directory (%(default)s)")
    parser.add_argument("--address", help="host:port or unix:/path of a running server; none: one is started")
    parser.add_argument("--options", type=json.loads, default={}, help='task options as JSON: \'{"leg": "C"}\'')
    return parser.parse_args()


def main() -> None:
    arguments = parse()
    arguments.out.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)  # networks this small are slower on several
    model, normalized, progress = train(arguments, arguments.options)
    settings = {
        "task": ID,
        **vars(arguments),
        "out": str(arguments.out),
        "learning_rate": LEARNING_RATE,
        "ppo": PPO_SETTINGS,
    }
    save(arguments.out, model, normalized, progress.curve, settings)
    scores = compare(model, normalized, arguments.address, arguments.options)
    text = table(scores)
    (arguments.out / "evaluation.txt").write_text(text + "\n")
    draw(progress.curve, scores, arguments.out / "curve.png")
    print(f"\n{model.num_timesteps:,} steps in {progress.curve[-1][1]:.0f} s; 100 unseen episodes each:\n\n{text}\n")
    print(f"Everything is in {arguments.out}/, the learning curve in curve.png.")


if __name__ == "__main__":
    main()
