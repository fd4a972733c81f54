"""Learning gaits without torch, as the command `sandgait train`."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from . import _native
from .options import with_files
from .snapshots import FilePath
from .studies import Display, ProgressOption
from .tables import Table


@dataclass(frozen=True)
class Training:
    """The results of `train`, and their files."""

    #: Folder of all results; docs/learning.md lists its files.
    out: Path
    #: Steps of all environments together.
    steps: int
    #: Duration of the training with the earlier parts of a resumed one [s].
    seconds: float
    #: The learning curve: columns steps, seconds [s] and return, the mean of episodes that ended since the row before.
    curve: Table
    #: The policy without noise over 100 unseen seeds, as in settings.json; none for tasks without walking.
    score: dict[str, Any] | None
    #: All of it as text.
    summary: str

    @property
    def policy(self) -> Path:
        """The ONNX file, for `evaluate`, `rollout_policy` and any ONNX runtime."""
        return self.out / "policy.onnx"

    @property
    def weights(self) -> Path:
        """Weights and statistics, for :func:`sandgait.export.to_sb3`."""
        return self.out / "policy.safetensors"

    @property
    def recording(self) -> Path:
        """An unseen episode, for `sandgait replay` and `read_recording`."""
        return self.out / "walk.rec"

    def __repr__(self) -> str:
        return f"<Training: {self.steps} steps in {self.seconds:.1f} s, in {self.out}>"


def train(
    task: str = "sandgait/HexapodGait-v1",
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
    """Learns a gait by PPO; writes policy, learning curve, film and score into the folder `out` (none: runs/TASK-fast).

    The training ends after `seconds`, or `timesteps` (without `seconds` there is no limit of time, and the result
    has the same bits each time).
    `hyperparameters`: a file in the format of rl-zoo3, none: the program's own; `settings`: replace values of the
    file.
    `resume`: go on from the last checkpoint in `out`. `start_from`: begin with what another training has learnt, its
    policy.safetensors (same task, observation and actions). `threads`: 0 is one a processor. `address`: simulate on
    that server. `options`: as for `gymnasium.make`.

    Ctrl-C, and an exception of `progress`, end the training at once and leave a checkpoint.
    """
    asked = {
        "task": task,
        "hyperparameters": None if hyperparameters is None else Path(hyperparameters),
        "settings": dict(settings or {}),
        "options": with_files(options),
        "seed": seed,
        "seconds": seconds,
        "timesteps": timesteps,
        "out": None if out is None else Path(out),
        "resume": resume,
        "start_from": None if start_from is None else Path(start_from),
        "checkpoint_every": checkpoint_every,
        "threads": threads,
        "place": _place(address),
    }
    with Display(progress) as told:
        folder, steps, duration, points, score, summary = _native.train(asked, told)
    numbers = np.array(points, dtype=np.float64).reshape(-1, 3)
    columns = dict(zip(("steps", "seconds", "return"), numbers.T, strict=True))
    curve = Table(columns, {"steps": "1", "seconds": "s", "return": "1"})
    return Training(Path(folder), steps, duration, curve, json.loads(score), summary)


def _place(address: str | None) -> _native.Address | None:
    if address is None:
        return None
    from . import client

    return client.place(address)
