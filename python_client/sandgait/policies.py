"""Policies that the server runs: networks as ONNX files, and gaits without a network."""

from __future__ import annotations

from collections.abc import Iterable
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from .door import study
from .errors import InvalidRequest
from .options import with_files
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
    """Evaluation of a gait; one row a medium and slope. Undefined values are NaN.

    Columns: medium, slope_deg [°], rate [Hz] of a tripod whose rate was searched, episodes; return, speed [m/s],
    speed_error [m/s], cost_of_transport, slip and falls, each with the ends `_low` and `_high` of its 95 % interval;
    diverged. `docs/evaluate.md` defines them.
    """

    @property
    def speed(self) -> Numbers:
        """Mean forward speed [m/s]."""
        return self["speed"]

    @property
    def cost_of_transport(self) -> Numbers:
        """Work of all episodes over weight times distance; NaN where the robot does not go forward."""
        return self["cost_of_transport"]


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
    """Plays one episode for each of `seeds` unseen seeds (from 1,000,000 on) on each of `media` and `slopes` [°].

    `policy`: an ONNX file that `sandgait.export_onnx` wrote, or its bytes; or "tripod:HZ", "tripod" (the best rate,
    searched on other seeds), "clock:N,N,…" or "clock:FILE.json" (one action of `control="clock"`, held), "standing",
    "random".
    `options`: as for `gymnasium.make`. `sandgait evaluate` computes the same.
    """
    network = isinstance(policy, (bytes, PathLike)) or policy.endswith(".onnx")
    name = "policy.onnx" if isinstance(policy, bytes) else str(policy)
    request = {
        "task_id": task,
        "onnx": (name, read_policy(policy)) if network else None,
        "gait": None if network else _with_clock(name),
        "options": with_files(options),
        "seeds": seeds,
        "media": list(media),
        "slopes": np.asarray(list(slopes), float).tolist(),
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
