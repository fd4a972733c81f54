"""Policies that the server runs: networks as ONNX files, and gaits without a network."""

from __future__ import annotations

from collections.abc import Iterable
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
    task: str = "sandgait/HexapodGait-v1",
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
    `options`: the same as for `gymnasium.make`. `sandgait evaluate` computes the same.
    """
    network = isinstance(policy, (bytes, PathLike)) or policy.endswith(".onnx")
    name = "policy.onnx" if isinstance(policy, bytes) else str(policy)
    request = {
        "task_id": task_id(task),
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


def _with_clock(gait: str) -> str:
    """Replaces a clock's file by its numbers, because the server may be on another machine."""
    kind, _, rest = gait.partition(":")
    if kind != "clock" or not rest.endswith(".json"):
        return gait
    return "clock:" + read_policy(rest).decode(errors="replace").strip().removeprefix("[").removesuffix("]")
