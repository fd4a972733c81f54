"""Policies that the server runs: networks as ONNX files, and gaits without a network."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from .arguments import checked, numbers
from .door import study
from .errors import InvalidRequest
from .options import task_id, with_files
from .snapshots import FilePath
from .studies import Display, ProgressOption, columns
from .tables import Numbers, Table
from .user_warnings import warn


def read_policy(onnx: bytes | FilePath) -> bytes:
    """The bytes of an ONNX file. The server checks its contents."""
    if isinstance(onnx, bytes):
        return onnx
    try:
        return Path(onnx).read_bytes()
    except (OSError, TypeError) as error:
        raise InvalidRequest(f"policy: {onnx!r} cannot be read as a file: {error}") from error


class Evaluation(Table):
    """Evaluation of a gait; one row for each medium and slope. Undefined values are NaN.

    Columns: medium, slope_deg [°], rate [Hz] (only for "tripod": the best rate found), episodes, return, speed [m/s],
    speed_error [m/s], cost_of_transport, slip, falls and diverged. For each column X from return to falls, X_low and
    X_high are the ends of its 95 % interval. `docs/evaluate.md` defines the columns.
    """

    @property
    def speed(self) -> Numbers:
        """Mean forward speed [m/s]."""
        return self["speed"]

    @property
    def cost_of_transport(self) -> Numbers:
        """Work of all episodes / (weight · distance); NaN if the robot does not walk forward."""
        return self["cost_of_transport"]


@checked
def evaluate(
    policy: bytes | FilePath,
    task: str | None = None,
    *,
    seeds: int = 100,
    media: Iterable[str] = (),
    slopes: Iterable[float] = (),
    address: str | None = None,
    progress: ProgressOption = True,
    **options: Any,
) -> Evaluation:
    """Runs `seeds` episodes on each combination of `media` and `slopes` [°]. Their seeds count up from 1,000,000, so no
    training has used them.

    `policy`: an ONNX file that `sandgait.export_onnx` wrote, or its bytes; or a gait without a file: "tripod:HZ",
    "tripod" (with the best rate, searched with other seeds), "clock:N,N,…" or "clock:FILE.json" (a constant action of
    `control="clock"`), "standing" or "random".
    `options`: the same as for `gymnasium.make`. Task and options are those in settings.json beside the policy's file,
    where `task` and `options` say nothing; without such a file the task is HexapodGait. `sandgait evaluate` computes
    the same.
    """
    network = isinstance(policy, (bytes, PathLike)) or policy.endswith(".onnx")
    name = "policy.onnx" if isinstance(policy, bytes) else str(policy)
    beside = None if isinstance(policy, bytes) or not network else Path(policy).with_name("settings.json")
    task, options = trained(beside, task, options)
    request = {
        "task_id": task,
        "onnx": (name, read_policy(policy)) if network else None,
        "gait": None if network else _with_clock(name),
        "options": with_files(options),
        "seeds": seeds,
        "media": list(media),
        "slopes": numbers("slopes", list(slopes), np.float64).tolist(),
    }
    with Display(progress) as told:
        reply = study(address, "Evaluate", request, told)
    return Evaluation(*columns(reply))


def trained(settings: Path | None, task: str | None, options: dict[str, Any]) -> tuple[str, dict[str, Any]]:
    """Task and options of the training that left the file `settings`, with the given ones in their place. In a
    dictionary only the given keys change. The options of a training in another task than `task` do not count."""
    given = None if task is None else task_id(task)
    try:
        found = {} if settings is None else json.loads(settings.read_bytes())
        own, learnt = task_id(found["task"]) if found else None, dict(found.get("options") or {})
    except FileNotFoundError:
        own, learnt = None, {}
    except (OSError, ValueError, TypeError, KeyError, AttributeError) as error:
        raise InvalidRequest(f"{settings}: no settings of a training: {error!r}") from error
    if given is not None and own is not None and own != given:
        warn([f"the policy was trained in {own}: its options are not those of {given}"])
    if own is None or given not in (None, own):
        return given or "sandgait/HexapodGait-v1", options
    for name, value in options.items():
        old = learnt.get(name)
        learnt[name] = {**old, **value} if isinstance(old, dict) and isinstance(value, Mapping) else value
    return own, learnt


def _with_clock(gait: str) -> str:
    """Replaces a clock's file by its numbers, because the server may be on another machine."""
    kind, _, rest = gait.partition(":")
    if kind != "clock" or not rest.endswith(".json"):
        return gait
    return "clock:" + read_policy(rest).decode(errors="replace").strip().removeprefix("[").removesuffix("]")
