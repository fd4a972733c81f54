"""Train a hexapod to walk on sand with PPO or SAC, and compare it with gaits without learning.

    python examples/train.py                                   # HexapodGait with PPO, five minutes on two cores
    python examples/train.py --task HexapodLegs --seconds 300 --out runs/legs
    python examples/train.py --algorithm sac --set gamma=0.97 --set batch_size=256
    python examples/train.py --resume                          # continues from the last checkpoint in --out
    python examples/train.py --options '{"slope_deg": 10}' --start-from runs/HexapodGait-ppo --out runs/slope
    python examples/train.py --task LeggedVelocity --options '{"robot": "go1.xml", "ground": "poppy-close"}'
    tensorboard --logdir runs

Hyperparameters are in examples/hyperparameters/: one file for each algorithm, with one entry for each task. The program
writes policy.zip, policy.onnx, normalize.pkl, settings.json, curve.csv, curve.png, evaluation.txt, checkpoints/,
videos/ and tensorboard/ into the output directory.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import torch
from evaluate_gait import Score, compare, evaluate, learnt, table
from training import (
    ALGORITHMS,
    BadSettings,
    Row,
    hyperparameters,
    last_checkpoint,
    other_training,
    prepare,
    provenance,
    task_id,
)
from video import Video

import sandgait

matplotlib.use("Agg")
import matplotlib.pyplot as plt


def draw(algorithm: str, curve: list[Row], scores: list[Score], path: Path) -> None:
    """Draws the learning curve, and the returns of the other gaits as lines."""
    figure, axes = plt.subplots(figsize=(7, 4.2), layout="constrained")
    steps = np.array([row.steps for row in curve])
    returns = [row.mean_return for row in curve]
    axes.plot(steps / 1e6, returns, color="C0", label=f"{algorithm.upper()} while it explores")
    for number, score in enumerate(scores):
        axes.axhline(score.returns.mean(), color=f"C{number}", linestyle="--", linewidth=1, label=score.name)
    axes.set_xlabel(f"environment steps [millions], {curve[-1].seconds:.0f} s in all")
    axes.set_ylabel("mean return of an episode")
    axes.legend(loc="lower right")
    axes.grid(alpha=0.3)
    figure.savefig(path, dpi=150)


def write_settings(out: Path, settings: dict[str, Any]) -> None:
    (out / "settings.json").write_text(json.dumps(settings, indent=2) + "\n")


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=str(__doc__).split("\n\n", maxsplit=1)[0])
    parser.add_argument("--task", default="HexapodGait", help="name of the task (%(default)s)")
    parser.add_argument("--algorithm", choices=ALGORITHMS, default="ppo", help="algorithm (%(default)s)")
    parser.add_argument(
        "--seconds", type=float, help="longest duration of the training [s]; by default that of the settings"
    )
    parser.add_argument("--steps", type=int, help="largest number of control steps; by default that of the settings")
    parser.add_argument("--envs", type=int, help="number of environments; by default that of the settings")
    parser.add_argument(
        "--set", action="append", default=[], metavar="NAME=VALUE", help="replaces the value of a setting"
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of the policy and of the environments (%(default)s)")
    parser.add_argument("--out", type=Path, help="output directory (runs/TASK-ALGORITHM)")
    parser.add_argument(
        "--resume", action="store_true", help="continue from the last checkpoint in the output directory"
    )
    parser.add_argument(
        "--start-from", type=Path, metavar="DIR", help="start with the policy in another training's output directory"
    )
    parser.add_argument(
        "--checkpoint-every",
        type=int,
        default=1_000_000,
        metavar="STEPS",
        help="steps between two checkpoints (%(default)s)",
    )
    parser.add_argument(
        "--video-every", type=int, default=1_000_000, metavar="STEPS", help="steps between films; 0: none (%(default)s)"
    )
    parser.add_argument(
        "--address", help="host:port or unix:/path of a running server; by default this process simulates"
    )
    parser.add_argument("--options", type=json.loads, default={}, help='task options as JSON: \'{"leg": "C"}\'')
    arguments = parser.parse_args()
    changes = {"seconds": arguments.seconds, "n_timesteps": arguments.steps, "n_envs": arguments.envs}
    given = [f"{name}={value}" for name, value in changes.items() if value is not None]
    arguments.id = task_id(arguments.task)
    arguments.out = arguments.out or Path("runs") / f"{arguments.task}-{arguments.algorithm}"
    try:
        arguments.settings = hyperparameters(arguments.algorithm, arguments.id, arguments.set + given)
        arguments.options = {**arguments.settings.get("env_kwargs", {}), **arguments.options}
        arguments.checkpoint = last_checkpoint(arguments.out) if arguments.resume else None
        if arguments.start_from is not None:
            if arguments.resume:
                raise BadSettings("--start-from: --resume goes on from the training's own checkpoint")
            arguments.start_from = other_training(arguments.start_from)
    except BadSettings as error:
        parser.error(str(error))
    return arguments


def main() -> None:
    arguments = parse()
    out, settings = arguments.out, arguments.settings
    out.mkdir(parents=True, exist_ok=True)
    about = {name: getattr(arguments, name) for name in ("task", "algorithm", "seed", "options", "address")}
    made_by = {**provenance(), **about, "hyperparameters": settings}
    write_settings(out, made_by)
    torch.set_num_threads(1)  # such small networks are slower on several threads
    training = prepare(
        arguments.algorithm,
        arguments.id,
        settings,
        out,
        arguments.seed,
        arguments.address,
        arguments.options,
        arguments.checkpoint,
        arguments.start_from,
    )
    if arguments.video_every:
        films = Video(arguments.video_every, out / "videos", arguments.id, arguments.address, arguments.options)
        training.callbacks.append(films)
    training.run(arguments.checkpoint_every, out)
    progress = training.progress
    training.model.save(out / "policy.zip")
    training.normalized.save(str(out / "normalize.pkl"))
    sandgait.export_onnx(training.model, out / "policy.onnx", training.normalized)
    name = f"learnt ({arguments.algorithm.upper()})"
    policy = learnt(training.model, training.normalized)
    scores = [evaluate(name, policy, arguments.id, arguments.address, **arguments.options)]
    scores += compare(arguments.id, arguments.address, **arguments.options)
    write_settings(out, {**made_by, "steps": training.model.num_timesteps, "score": scores[0].summary()})
    text = table(scores)
    (out / "evaluation.txt").write_text(text + "\n")
    draw(arguments.algorithm, progress.curve, scores, out / "curve.png")
    print(
        f"\n{training.model.num_timesteps:,} steps in {progress.seconds:.0f} s; 100 unseen episodes each:\n\n{text}\n"
    )
    print(f"The simulation took {100 * progress.simulation_share:.0f} % of the training's time.")
    print(f"Everything is in {out}/, the learning curve in curve.png.")


if __name__ == "__main__":
    main()
