"""Searches for a leg together with its gait: Optuna chooses the leg, and `sandgait.train` learns a gait for it.

Each trial is a leg of HexapodGait with a knee angle ξ. `sandgait.sweep` simulates walks at one constant rate first,
which takes seconds, and the search begins with the leg that is fastest there. Each leg has several trainings with
different random numbers, because trainings of one leg differ. The value of a trial is the mean return at the end of
the learning curves. The best legs are then compared by their returns on 100 seeds that neither the trainings nor the
choice used.

    python examples/codesign.py --trials 24 --timesteps 3000000
    python examples/codesign.py --grid 25 --timesteps 3000000      (25 legs from -75° to 75° instead of a search)

A stopped study continues with the same command: finished trials are in OUT/study.db. It needs `pip install optuna`.
"""

from __future__ import annotations

import argparse
import statistics
from pathlib import Path

import numpy as np
import optuna

import sandgait

#: Knee angles of the search [°]: those of figure 5 of Li, Zhang & Goldman 2012.
LOW, HIGH = -75.0, 75.0
#: Share of a learning curve whose mean is its end: our choice, enough episodes to average over commands.
END = 0.1
#: Number of legs in the comparison: our choice, because the returns of the best legs often overlap.
COMPARED = 3


def learn(folder: Path, xi: float, seed: int, timesteps: int) -> tuple[float, float]:
    """Trains a gait for the leg with knee angle `xi` [°]. Returns the end of the learning curve, and the return over
    100 seeds that the training did not use."""
    training = sandgait.train(
        "HexapodGait",
        out=folder,
        seed=seed,
        timesteps=timesteps,
        progress=False,
        leg=f"xi={xi:g}",
        command=[0.1, 0.6],
    )
    returns = np.asarray(training.curve["return"])
    assert training.score is not None
    if not len(returns):
        raise SystemExit(f"--timesteps: no episode ends within {timesteps} steps")
    last = returns[-max(1, round(END * len(returns))) :]
    return float(last.mean()), float(training.score["total_reward"]["mean"])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=24, help="number of legs that the search tries (%(default)s)")
    parser.add_argument("--grid", type=int, help="number of legs on an even grid, instead of a search")
    parser.add_argument("--trainings", type=int, default=3, help="number of trainings of each leg (%(default)s)")
    parser.add_argument("--timesteps", type=int, default=3_000_000, help="steps of each training (%(default)s)")
    parser.add_argument("--out", type=Path, default=Path("runs/codesign"), help="folder of the results (%(default)s)")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)

    sampler: optuna.samplers.BaseSampler = optuna.samplers.TPESampler(seed=1)
    if arguments.grid:
        sampler = optuna.samplers.GridSampler({"xi": np.linspace(LOW, HIGH, arguments.grid).tolist()})
    study = optuna.create_study(
        study_name="codesign",
        direction="maximize",
        sampler=sampler,
        storage=f"sqlite:///{arguments.out}/study.db",
        load_if_exists=True,
    )
    if not arguments.grid and not study.trials:
        walks = sandgait.sweep({"xi": np.linspace(LOW, HIGH, 31)})
        study.enqueue_trial({"xi": float(walks.best()["xi"])})

    def objective(trial: optuna.Trial) -> float:
        xi = trial.suggest_float("xi", LOW, HIGH)
        folders = [arguments.out / f"leg{trial.number}-{seed}" for seed in range(arguments.trainings)]
        pairs = [learn(folder, xi, seed, arguments.timesteps) for seed, folder in enumerate(folders)]
        trial.set_user_attr("unseen", [unseen for _, unseen in pairs])
        return statistics.mean(end for end, _ in pairs)

    done = sum(trial.state == optuna.trial.TrialState.COMPLETE for trial in study.trials)
    study.optimize(objective, n_trials=max(0, (arguments.grid or arguments.trials) - done))

    complete = [trial for trial in study.trials if trial.state == optuna.trial.TrialState.COMPLETE]
    complete.sort(key=lambda trial: trial.value or 0.0, reverse=True)
    print("the best legs, with the returns of their trainings over 100 seeds that were used for nothing else:")
    for trial in complete[:COMPARED]:
        unseen = trial.user_attrs["unseen"]
        numbers = ", ".join(f"{value:.1f}" for value in unseen)
        print(f"ξ = {trial.params['xi']:6.2f}°: {statistics.mean(unseen):.1f} ({numbers}), leg{trial.number}-*/")


if __name__ == "__main__":
    main()
