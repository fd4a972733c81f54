"""sandgait: reinforcement-learning environments of legged robots on sand.

`import sandgait` registers the environments with gymnasium:

    gymnasium.make("sandgait/HexapodGait-v1", leg="C", medium="poppy-close", slope_deg=5)
    gymnasium.make_vec("sandgait/HexapodGait-v1", num_envs=256)
    sandgait.make_sb3("sandgait/HexapodGait-v1", num_envs=32)

Studies need no environment. They are the functions of the commands with the same names:

    sandgait.intrude("L", medium="poppy-close").plot()
    sandgait.walk([1, 2, 3], leg="C").speed
    sandgait.sweep({"xi": range(-75, 76, 5), "frequency": [1, 2, 3, 4]}).plot()
    sandgait.diagnose("force.csv", "experiment.toml").summary
    sandgait.evaluate("tripod:2", slopes=[0, 10]).to_frame()

Sand for other simulators:

    sandgait.Sand("poppy-loose").wrench(sandgait.Bodies({"foot": "sphere:radius=0.02"}), position, ...)

Any simulator of sand beside ours, in the same measured rows:

    sandgait.scoreboard({"mine": entry}).to_html("scoreboard.html")

Learning a gait takes a minute, without torch:

    sandgait.train("sandgait/HexapodGait-v1", seconds=60).policy

By default this process computes everything. With `address="host:port"` or `"unix:/path"` a running server computes
it. A `sandgait.Remote` is the address of a server that requires TLS or a token.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

import gymnasium

from . import study_functions
from ._native import __version__
from .diagnosis import Diagnosis
from .door import describe
from .env import SandgaitEnv
from .errors import (
    AccessDenied,
    InvalidRequest,
    LimitReached,
    OutOfOrder,
    SandgaitError,
    ServerLost,
    SessionLost,
    UnknownAttribute,
    UnknownOption,
    WrongType,
)
from .recording import Recording, Section, read_recording
from .remote import Remote
from .results import Evaluation, Intrusion, Sweep, Trials, Walks
from .robots import check_robot
from .sand import Bodies, Sand, implicit_wrench
from .scoring import Scoreboard, scoreboard
from .spaces import Column, Option, Task
from .study_functions import *  # noqa: F403 - every study is a function of this package
from .tables import Table
from .training import Training, mirror, train
from .vector_env import SandgaitVectorEnv

if TYPE_CHECKING:
    from pathlib import Path

    from .sb3 import Environments
    from .shards import Address
    from .snapshots import FilePath

__all__ = [
    "TASKS",
    "AccessDenied",
    "Bodies",
    "Column",
    "Diagnosis",
    "Evaluation",
    "Intrusion",
    "InvalidRequest",
    "LimitReached",
    "Option",
    "OutOfOrder",
    "Recording",
    "Remote",
    "Sand",
    "SandgaitEnv",
    "SandgaitError",
    "SandgaitVectorEnv",
    "Scoreboard",
    "Section",
    "ServerLost",
    "SessionLost",
    "Sweep",
    "Table",
    "Task",
    "Training",
    "Trials",
    "UnknownAttribute",
    "UnknownOption",
    "Walks",
    "WrongType",
    "__version__",
    "check_robot",
    "describe",
    "export_onnx",
    "implicit_wrench",
    "make_sb3",
    "mirror",
    "read_recording",
    "scoreboard",
    "train",
]
__all__ += study_functions.__all__

TASKS = (
    "sandgait/HexapodGait-v1",
    "sandgait/HexapodLegs-v1",
    "sandgait/HexapodLegs-v2",
    "sandgait/HexapodRocks-v1",
    "sandgait/HexapodTerrain-v1",
    "sandgait/LegStroke-v0",
    "sandgait/LeggedVelocity-v1",
)
"""Ids of the tasks that this version registers. A later version of a task comes after an earlier one."""


#: Modules for other packages. They are imported when they are first used, because those packages may not be installed.
_LAZY = ("adapt", "certify", "deploy", "export", "logs", "mujoco", "plant", "ray", "sb3", "wrappers")


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        return importlib.import_module(f".{name}", __name__)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *_LAZY})


def make_sb3(
    id: str,
    num_envs: int,
    address: Address = None,
    *,
    monitor: bool | FilePath = True,
    info_keywords: tuple[str, ...] = (),
    torch_threads: int | None = 1,
    **options: Any,
) -> Environments:
    """`num_envs` environments of task `id` as a stable-baselines3 `VecEnv`; `options` as for `gymnasium.make_vec`.

    A `VecMonitor` wraps them, from which stable-baselines3 takes `ep_rew_mean`. If `monitor` is a path, the VecMonitor
    also writes every episode to that file, with the info columns `info_keywords`. With `monitor=False` there is no
    VecMonitor.

    `torch_threads`: environments in this process give torch this number of threads, unless OMP_NUM_THREADS or
    MKL_NUM_THREADS is set; None leaves torch's number. With more threads torch and the environments slow each other
    down: a training that takes a second takes half a minute.
    """
    from .sb3 import make

    return make(id, num_envs, address, monitor, info_keywords, torch_threads, options)


def export_onnx(model: Any, path: FilePath, normalize: Any = None) -> Path:
    """Writes the deterministic policy of a stable-baselines3 `model` (PPO, A2C, SAC, TD3, DDPG) to an ONNX file.

    `normalize`: the VecNormalize of the model's training; its statistics and its clipping become part of the network.
    `rollout_policy`, `evaluate` and `sandgait evaluate` read the file. Returns the file's path. Needs `sandgait[sb3]`.
    """
    from .export import export_onnx

    return export_onnx(model, path, normalize)


#: Control steps until gymnasium truncates an episode. A test compares these numbers with the server's. LegStroke has no
#: limit here, because one episode is one stroke and ends with it.
_TIME_LIMITS = {_id: 500 for _id in TASKS if "/Hexapod" in _id} | {"sandgait/LeggedVelocity-v1": 1000}

for _id in TASKS:
    gymnasium.register(
        _id,
        entry_point="sandgait.env:registered" if _id in _TIME_LIMITS else "sandgait.env:SandgaitEnv",
        vector_entry_point="sandgait.vector_env:SandgaitVectorEnv",
        max_episode_steps=_TIME_LIMITS.get(_id),
        kwargs={"task": _id},
    )
