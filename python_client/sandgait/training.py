"""Learns gaits without torch, as the command `sandgait train` does, and policies of any other environment."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.vector import VectorEnv

from . import _native, notebook
from .arguments import checked
from .errors import InvalidRequest
from .external import VectorEnvironments, check_vector
from .options import task_id, with_files
from .snapshots import FilePath
from .study_call import Display, ProgressOption
from .tables import Table


@dataclass(frozen=True)
class Training:
    """The results of `train`, and their files."""

    #: Folder of all results; docs/learning.md lists its files.
    out: Path
    #: Number of control steps of all environments together.
    steps: int
    #: Duration of the training [s], including the parts before a resumption.
    seconds: float
    #: The learning curve. Columns: steps, seconds [s], return (the mean over the episodes that ended since the row
    #: before), and each reward term by its name in `info` (its mean over the steps since the row before).
    curve: Table
    #: Evaluation of the policy without noise, as in settings.json: over 100 seeds that the training did not use, or
    #: over nine commands for LeggedVelocity. None for LegStroke and for environments of other packages.
    score: dict[str, Any] | None
    #: The results as text.
    summary: str

    @property
    def policy(self) -> Path:
        """The policy's ONNX file, for `evaluate`, `rollout_policy` and any ONNX runtime."""
        return self.out / "policy.onnx"

    @property
    def weights(self) -> Path:
        """The file with weights and statistics, for :func:`sandgait.export.to_sb3`."""
        return self.out / "policy.safetensors"

    @property
    def recording(self) -> Path:
        """The recording of an episode that the training did not use, for `sandgait replay` and `read_recording`. Other
        packages' environments have none."""
        return self.out / "walk.rec"

    def __repr__(self) -> str:
        return f"<Training: {self.steps} steps in {self.seconds:.1f} s, in {self.out}>"

    def _repr_html_(self) -> str:
        """The learning curve, the results and the score."""
        curve = notebook.curve(self.curve["steps"], self.curve["return"], "environment steps", "return")
        score = {name: value for name, value in (self.score or {}).items() if value is not None}
        about = {"steps": self.steps, "duration [s]": self.seconds, "folder": self.out, **score}
        return notebook.title(self.summary.partition("\n")[0]) + curve + notebook.facts(about)


@checked
def train(
    task: str | VectorEnv[Any, Any, Any] = "sandgait/HexapodGait-v1",
    *,
    out: FilePath | None = None,
    seed: int = 0,
    seconds: float | None = None,
    timesteps: int | None = None,
    hyperparameters: FilePath | None = None,
    settings: Mapping[str, Any] | None = None,
    resume: bool = False,
    start_from: FilePath | None = None,
    checkpoint_every: int = 1_000_000,
    threads: int = 0,
    address: str | None = None,
    progress: ProgressOption = True,
    **options: Any,
) -> Training:
    """Learns a gait by PPO. Writes policy, learning curve, recording and score into the folder `out` (by default
    runs/TASK-fast).

    `task`: the name of a task; or a vector of environments, any gymnasium `VectorEnv` with Box spaces and a bounded
    action space, such as `gymnasium.make_vec("Pendulum-v1", 16)` or a `VectorWrapper` around a task of this package. In
    such a vector PPO learns in the same way, but the policy gets no recording and no score. The environments stay open.
    They cannot be saved, so a training that is resumed begins new episodes.

    The training ends after `seconds` of time or `timesteps` control steps. Without `seconds` there is no limit of time,
    and the result is bit-identical in each run.

    `hyperparameters`: a file in the format of rl-zoo3; by default the program's own values. `settings`: values that
    replace those of the file. `resume`: continue the training in `out`, which must have the same task, options, seed
    and settings; without it a folder with results is refused. `start_from`: the policy.safetensors of another training
    of the same task, observation and actions. This training then starts from its weights. `threads`: number of
    simulating threads; 0 stands for one on each processor. `address`: the server that simulates. `options`: the same as
    for `gymnasium.make`. `address` and `options` are for tasks only.

    Ctrl-C, or an exception that `progress` raises, ends the training at once and leaves a checkpoint.
    """
    vector = None if isinstance(task, str) else VectorEnvironments(check_vector(task))
    if vector is not None and (address is not None or options):
        name = "address" if address is not None else next(iter(options))
        raise InvalidRequest(f"{name}: this is for tasks by name; the environments are made already")
    if vector is not None and resume and progress is True:
        print(f"{vector.name} cannot be saved: the training goes on with new episodes", file=sys.stderr)
    asked = {
        "task": task_id(str(task)) if vector is None else vector.name,
        "hyperparameters": None if hyperparameters is None else Path(hyperparameters),
        "settings": dict(settings or {}),
        "options": with_files(options) if vector is None else vector.identity,
        "seed": seed,
        "seconds": seconds,
        "timesteps": timesteps,
        "out": None if out is None else Path(out),
        "resume": resume,
        "start_from": None if start_from is None else Path(start_from),
        "checkpoint_every": checkpoint_every,
        "threads": threads,
        "place": _place(address),
        "vector": None if vector is None else (vector, vector.num_envs, *vector.bounds),
    }
    with Display(progress) as told:
        folder, steps, duration, points, score, summary = _native.train(asked, told)
    return Training(Path(folder), steps, duration, _curve(points), json.loads(score), summary)


def _curve(points: list[tuple[int, float, float, list[tuple[str, float]]]]) -> Table:
    terms = dict.fromkeys(name for *_, means in points for name, _ in means)
    columns = dict(zip(("steps", "seconds", "return"), np.array([p[:3] for p in points]).reshape(-1, 3).T, strict=True))
    for name in terms:
        columns[name] = np.array([dict(means).get(name, np.nan) for *_, means in points])
    return Table(columns, {"steps": "1", "seconds": "s", "return": "1", **dict.fromkeys(terms, "1")})


def _place(address: str | None) -> _native.Address | None:
    if address is None:
        return None
    from . import client

    return client.place(address)


#: For each column: the index of the column that has its mirrored value, and the sign of that value.
Mirror = tuple[list[int], list[float]]


@checked
def mirror(task: str, **options: Any) -> tuple[Mirror, Mirror]:
    """The left–right mirrors of a task's observations and of its actions: a mirrored row is `signs * row[order]`.

    The mirror of a robot from a file follows from its geometry in the standing pose. If the robot is not symmetric,
    InvalidRequest names the joint. `options`: the same as for `gymnasium.make`.
    """
    return _native.mirror(task_id(task), with_files(options))
