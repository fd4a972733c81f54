"""Policies on robots: the package `sandgait_deploy`, and what needs the simulator: `describe`."""

from __future__ import annotations

import json
from pathlib import Path

from sandgait_deploy import (
    Boundary,
    Column,
    Controller,
    Output,
    Policy,
    Refused,
    Servo,
    Verification,
    policy_folder,
    read_policy,
    verify,
)

from . import _native
from .errors import SandgaitError
from .options import with_files
from .policies import trained

__all__ = [
    "Boundary",
    "Column",
    "Controller",
    "Output",
    "Policy",
    "Refused",
    "Servo",
    "Verification",
    "describe",
    "policy_folder",
    "read_policy",
    "verify",
]


def describe(folder: str | Path) -> str:
    """Writes `policy.json` and, for a task whose actions are targets of joints, `golden.csv` into the folder of a
    policy. They follow from `policy.onnx` and `settings.json`, so folders of older versions get them, too. Returns a
    sentence."""
    place = Path(folder)
    settings = place / "settings.json"
    if not settings.is_file():
        raise Refused(f"{settings}: there is no such file; describe a folder that `sandgait train` wrote")
    try:
        onnx = (place / "policy.onnx").read_bytes()
        task, options = trained(settings)
        about, trace = _native.describe_policy(task, with_files(options), onnx)
    except OSError as error:
        raise Refused(f"{place / 'policy.onnx'}: cannot be read: {error.strerror}") from None
    except (SandgaitError, _native.StatusError) as error:
        raise Refused(f"{place}: {error}") from None
    (place / "policy.json").write_text(about, encoding="utf-8")
    if trace is None:
        return f"{place}: policy.json of {json.loads(about)['task']}, whose actions are no targets of joints"
    (place / "golden.csv").write_text(trace, encoding="utf-8")
    return f"{place}: policy.json and golden.csv"
