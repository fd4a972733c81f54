"""Parts of a training: reads hyperparameters, makes environments and callbacks, and resumes a training."""

from __future__ import annotations

import csv
import datetime
import inspect
import re
import shlex
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import yaml
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback, CallbackList, CheckpointCallback
from stable_baselines3.common.utils import FloatSchedule
from stable_baselines3.common.vec_env import VecEnvWrapper, VecNormalize
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn
from symmetry import MirroredPolicy, MirroredStatistics
from tqdm import tqdm

import sandgait
from sandgait.training import Mirror

ALGORITHMS: dict[str, type[BaseAlgorithm]] = {"ppo": PPO, "sac": SAC}

#: Folder with one file for each algorithm, which has one entry for each task.
HYPERPARAMETERS = Path(__file__).parent / "hyperparameters"

#: Keys of an entry that this script uses. The others are arguments of the algorithm.
OWN_KEYS = ("n_envs", "n_timesteps", "seconds", "normalize", "learning_rate", "mirror", "env_kwargs")

CHECKPOINT = re.compile(r"model_(\d+)_steps\.zip")


class BadSettings(ValueError):
    """The hyperparameters do not exist or cannot be read. The message is one line."""


def task_id(name: str) -> str:
    """Id of the latest version of task `name`. `sandgait/` is put before an unknown name or one with a version."""
    return max((task for task in sandgait.TASKS if task.startswith(f"sandgait/{name}-v")), default=f"sandgait/{name}")


def hyperparameters(algorithm: str, task: str, changes: list[str]) -> dict[str, Any]:
    """The task's entry in the algorithm's file, with `changes` (NAME=YAML)."""
    path = HYPERPARAMETERS / f"{algorithm}.yml"
    entries = yaml.safe_load(path.read_text())
    if task not in entries:
        raise BadSettings(f"{path.name} has no settings for {task!r}; it has {', '.join(entries)}")
    settings: dict[str, Any] = dict(entries[task])
    for change in changes:
        name, equals, value = change.partition("=")
        if not equals:
            raise BadSettings(f"--set {change!r}: expected NAME=VALUE")
        settings[name] = yaml.safe_load(value)
    known = {*OWN_KEYS, *inspect.signature(ALGORITHMS[algorithm]).parameters}
    for name in settings:
        if name not in known:
            raise BadSettings(f"--set {name}: {algorithm.upper()} has no such setting")
    learning_rate(settings["learning_rate"])
    return settings


def learning_rate(setting: Any) -> tuple[float, bool]:
    """A learning rate, and whether it falls to zero. `lin_0.001` falls to zero, in rl-zoo3's notation; 0.001 is
    constant."""
    text = str(setting)
    try:
        return float(text.removeprefix("lin_")), text.startswith("lin_")
    except ValueError as error:
        raise BadSettings(f"learning_rate: {setting!r} is neither a number nor lin_NUMBER") from error


def git(*words: str) -> str:
    """Output of git for this repository; empty if there is no repository."""
    command = ["git", "-C", str(Path(__file__).parents[1]), *words]
    return subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()


def provenance() -> dict[str, str]:
    """Command, commit and date, with which a result can be reproduced. Changed files of results do not mark the commit
    as changed."""
    commit = git("rev-parse", "--short", "HEAD") or "unknown"
    changed = git("status", "--porcelain", "--untracked-files=no", "--", ".", ":!examples/policies")
    command = shlex.join(["python", "examples/" + Path(sys.argv[0]).name, *sys.argv[1:]])
    return {"command": command, "commit": commit + ("-dirty" if changed else ""), "date": f"{datetime.date.today()}"}


class Timed(VecEnvWrapper):
    """Measures the time of the environments' steps: simulation, gRPC and client."""

    seconds = 0.0

    def reset(self) -> VecEnvObs:
        return self.venv.reset()

    def step_async(self, actions: npt.NDArray[Any]) -> None:
        start = time.monotonic()
        self.venv.step_async(actions)
        self.seconds += time.monotonic() - start

    def step_wait(self) -> VecEnvStepReturn:
        start = time.monotonic()
        result = self.venv.step_wait()
        self.seconds += time.monotonic() - start
        return result


@dataclass
class Row:
    """A point of the learning curve: environment steps and seconds up to it, and the mean return of the last
    episodes."""

    steps: int
    seconds: float
    mean_return: float


def read_curve(path: Path, until: float = np.inf) -> list[Row]:
    """Reads the learning curve in a file, up to `until` steps."""
    with path.open(newline="") as file:
        rows = [Row(int(r["steps"]), float(r["seconds"]), float(r["return"])) for r in csv.DictReader(file)]
    return [row for row in rows if row.steps <= until]


def done(row: Row, settings: dict[str, Any]) -> float:
    """The finished share of a training at a point of its curve, from 0 to 1: the greater one of the shares of its steps
    and of its time."""
    return min(1.0, max(row.seconds / float(settings["seconds"]), row.steps / int(settings["n_timesteps"])))


class Progress(BaseCallback):
    """Shows the progress, writes the learning curve, sets the learning rate, and ends the training."""

    def __init__(self, timed: Timed, settings: dict[str, Any], path: Path, curve: list[Row]) -> None:
        super().__init__()
        self.timed, self.path, self.curve = timed, path, curve
        self.settings, self.total_steps = settings, int(settings["n_timesteps"])
        self.rate, self.falls = learning_rate(settings["learning_rate"])
        #: Duration of the training with its earlier parts, if it was resumed [s].
        self.seconds = self.first = curve[-1].seconds if curve else 0.0
        #: Share of this training's time that the environments' steps took.
        self.simulation_share = 0.0
        self.returns: list[float] = []

    def _on_training_start(self) -> None:
        self.start = time.monotonic() - self.seconds
        self.file = self.path.open("w", newline="", buffering=1)
        self.writer = csv.writer(self.file)
        self.writer.writerow(("steps", "seconds", "return"))
        self.writer.writerows((r.steps, r.seconds, r.mean_return) for r in self.curve)
        form = "{desc}{percentage:3.0f} %|{bar}| {elapsed} < {remaining}"
        pause = 0.5 if sys.stderr.isatty() else 20.0  # a log file gets a line only every 20 s
        self.bar = tqdm(total=1.0, initial=self.share, desc="training", bar_format=form, mininterval=pause)
        self._set_rate()

    @property
    def share(self) -> float:
        """Finished share of the training, 0 to 1."""
        return done(Row(self.num_timesteps, self.seconds, 0.0), self.settings)

    def _set_rate(self) -> None:
        rate = self.rate * (1.0 - self.share) if self.falls else self.rate
        self.model.lr_schedule = FloatSchedule(rate)

    def _on_step(self) -> bool:
        self.returns += [info["episode"]["r"] for info in self.locals["infos"] if "episode" in info]
        self.seconds = time.monotonic() - self.start
        self.simulation_share = self.timed.seconds / (self.seconds - self.first)
        return self.share < 1.0

    def _on_rollout_end(self) -> None:
        self._set_rate()
        # A rollout of SAC is a single step, so a point of the curve needs several rollouts, with some ended episodes.
        if len(self.returns) >= self.training_env.num_envs / 8:
            row = Row(self.num_timesteps, round(self.seconds, 2), float(np.mean(self.returns)))
            self.returns = []
            self.curve.append(row)
            self.writer.writerow((row.steps, row.seconds, row.mean_return))
            self.bar.set_description(f"{row.steps / 1e6:.2f} M steps, return {row.mean_return:.0f}", refresh=False)
            self.logger.record("time/simulation_share", self.simulation_share)
        self.bar.update(self.share - self.bar.n)

    def _on_training_end(self) -> None:
        self.bar.close()
        self.file.close()


class Checkpoints(CheckpointCallback):
    """Writes policy and normalization at a fixed interval of steps. Only the last replay buffer is kept, because replay
    buffers are large."""

    def _on_step(self) -> bool:
        goes_on = super()._on_step()
        if self.n_calls % self.save_freq == 0:
            last = self._checkpoint_path("replay_buffer_", extension="pkl")
            for path in Path(self.save_path).glob("*_replay_buffer_*.pkl"):
                if str(path) != last:
                    path.unlink()
        return goes_on


@dataclass
class Training:
    """A model with its environments, ready to learn."""

    model: BaseAlgorithm
    normalized: VecNormalize
    progress: Progress
    #: Other callbacks than those for progress and checkpoints.
    callbacks: list[BaseCallback]

    def run(self, checkpoint_every: int, out: Path) -> None:
        """Learns until the limit of steps or time. Writes regular checkpoints of policy, normalization and replay
        buffer."""
        every = max(1, checkpoint_every // self.normalized.num_envs)
        where = str(out / "checkpoints")
        checkpoints = Checkpoints(every, where, "model", save_replay_buffer=True, save_vecnormalize=True)
        callbacks = CallbackList([self.progress, checkpoints, *self.callbacks])
        left = max(0, self.progress.total_steps - self.model.num_timesteps)
        self.model.learn(left, callback=callbacks, reset_num_timesteps=False, log_interval=10, tb_log_name="log")
        self.normalized.training = False


def steps_of(checkpoint: Path) -> int:
    found = CHECKPOINT.fullmatch(checkpoint.name)
    return int(found[1]) if found else -1


def last_checkpoint(out: Path) -> Path:
    """The newest `model_STEPS_steps.zip` of a training."""
    found = [path for path in (out / "checkpoints").glob("*.zip") if steps_of(path) >= 0]
    if not found:
        raise BadSettings(f"--resume: no checkpoint in {out / 'checkpoints'}")
    return max(found, key=steps_of)


def other_training(folder: Path) -> Path:
    """Checks that `folder` has the files of a training from which another training can start."""
    for name in ("policy.zip", "normalize.pkl"):
        if not (folder / name).is_file():
            raise BadSettings(f"--start-from: no {name} in {folder}")
    return folder


def create(
    kind: type[BaseAlgorithm],
    env: VecNormalize,
    settings: dict[str, Any],
    seed: int,
    log: Path,
    mirrors: tuple[Mirror, Mirror] | None,
) -> BaseAlgorithm:
    """A new model of the algorithm `kind` with these hyperparameters. `mirrors`: of observations and actions."""
    rest = {name: value for name, value in settings.items() if name not in OWN_KEYS}
    if mirrors is not None:
        rest["policy"] = MirroredPolicy
        both = dict(zip(("observation", "action"), mirrors, strict=True))
        rest["policy_kwargs"] = {**settings.get("policy_kwargs", {}), **both}
    rate, _ = learning_rate(settings["learning_rate"])
    return kind(env=env, learning_rate=rate, seed=seed, device="cpu", tensorboard_log=str(log), **rest)


def prepare(
    algorithm: str,
    task: str,
    settings: dict[str, Any],
    out: Path,
    seed: int,
    address: str | None,
    options: dict[str, Any],
    checkpoint: Path | None,
    start_from: Path | None = None,
) -> Training:
    """Makes a new training, or continues the one in `out` from a checkpoint. A new training starts with the policy in
    `start_from`, if this is given."""
    curve = [] if checkpoint is None else read_curve(out / "curve.csv", until=steps_of(checkpoint))
    timed = Timed(sandgait.make_sb3(task, int(settings["n_envs"]), address, **options))
    mirrors = sandgait.mirror(task, **options) if settings.get("mirror") else None
    kind = ALGORITHMS[algorithm]
    if checkpoint is None:
        flag = bool(settings["normalize"])
        normalized = VecNormalize(timed, norm_obs=flag, norm_reward=flag, gamma=settings["gamma"])
        if start_from is not None:
            normalized = VecNormalize.load(str(start_from / "normalize.pkl"), timed)
            normalized.training = True
        model = create(kind, normalized, settings, seed, out / "tensorboard", mirrors)
        if start_from is not None:
            model.set_parameters(str(start_from / "policy.zip"), device="cpu")
    else:
        steps = steps_of(checkpoint)
        normalized = VecNormalize.load(str(checkpoint.with_name(f"model_vecnormalize_{steps}_steps.pkl")), timed)
        model = kind.load(checkpoint, env=normalized, device="cpu")
        if isinstance(model, SAC):
            model.load_replay_buffer(checkpoint.with_name(f"model_replay_buffer_{steps}_steps.pkl"))
        normalized.seed(seed + steps)  # so that episodes differ from those before the checkpoint
    progress = Progress(timed, settings, out / "curve.csv", curve)
    callbacks: list[BaseCallback] = []
    if mirrors is not None and settings["normalize"]:
        callbacks.append(MirroredStatistics(mirrors[0]))
    return Training(model, normalized, progress, callbacks)
