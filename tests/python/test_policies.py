"""The policies that are kept in examples/policies play as well as it stands beside them."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
POLICIES = ROOT / "examples/policies"
sys.path.insert(0, str(ROOT / "examples"))

import evaluate_gait  # noqa: E402

KEPT = sorted(path.parent for path in POLICIES.glob("*/policy.onnx"))


def test_there_are_some_and_they_are_small() -> None:
    assert KEPT
    assert sum(path.stat().st_size for path in POLICIES.rglob("*")) < 2_000_000


@pytest.mark.parametrize("folder", KEPT, ids=lambda path: path.name)
def test_a_kept_policy_plays_as_recorded(folder: Path) -> None:
    """The same unseen seeds, so that only another instruction set's rounding may make a difference."""
    settings: dict[str, Any] = json.loads((folder / "settings.json").read_text())
    recorded = settings["score"]
    score = evaluate_gait.evaluate(
        folder.name,
        evaluate_gait.from_onnx(folder / "policy.onnx"),
        f"sandgait/{settings['task']}-v0",
        seeds=recorded["episodes"],
        **settings["options"],
    )
    assert abs(score.returns.mean() - recorded["return"]) < recorded["return_95"]
    assert abs(score.relative_error.mean() - recorded["relative_error"]) < 0.02
    for name in ("command", "commit", "date"):
        assert settings[name]
    assert "/tmp" not in json.dumps(settings)


def test_the_legs_follow_speed_commands_within_15_percent() -> None:
    folders = [folder for folder in KEPT if folder.name.startswith("HexapodLegs")]
    assert folders
    for folder in folders:
        assert json.loads((folder / "settings.json").read_text())["score"]["relative_error"] < 0.15


def test_clocks_walk_as_recorded() -> None:
    """Speeds and costs of the clocks that the search found, and what is said about them."""
    kept = json.loads((POLICIES / "HexapodGait-clock" / "clocks.json").read_text())
    names = list(kept["scores"])
    for name in names:
        recorded = kept["scores"][name]
        clock = np.array(kept["clocks"][name])
        policy = (lambda rows, clock=clock: np.repeat(clock, len(rows), axis=0)) if len(clock) == 1 else None
        if policy is None:
            continue
        score = evaluate_gait.evaluate(name, policy, seeds=16, control="clock", **kept["options"])
        assert abs(score.speed.mean() - recorded["speed"]) < 0.005
