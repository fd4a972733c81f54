"""The policies in examples/policies reach the results that are recorded beside them."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import sandgait
from sandgait import server

ROOT = Path(__file__).parents[2]
POLICIES = ROOT / "examples/policies"
sys.path.insert(0, str(ROOT / "examples"))

import evaluate_gait  # noqa: E402
import train_clock  # noqa: E402
import training  # noqa: E402


def kept(name: str) -> list[Path]:
    return sorted(POLICIES.glob(f"*/{name}"))


def test_every_folder_is_replayed_and_all_are_small() -> None:
    known = {path.parent for name in ("policy.onnx", "clocks.json", "strokes.json") for path in kept(name)}
    assert known == {path for path in POLICIES.iterdir() if path.is_dir()} != set()
    sizes = {folder.name: sum(path.stat().st_size for path in folder.iterdir()) for folder in known}
    assert max(sizes.values()) < 450_000, sizes


def test_policies_play_as_recorded() -> None:
    """The server evaluates them on the recorded seeds, so the results differ by rounding only."""
    for path in kept("policy.onnx"):
        settings: dict[str, Any] = json.loads((path.parent / "settings.json").read_text())
        assert settings["command"]
        assert settings["commit"]
        recorded, task = settings["score"], training.task_id(settings["task"])
        if "lines" in recorded:
            follows_commands_as_recorded(path, recorded)
            continue
        made = sandgait.evaluate(path, task, seeds=recorded["episodes"], progress=False, **settings["options"])
        assert abs(made["return"][0] - recorded["return"]) < recorded["return_95"], path
        assert abs(made.speed[0] - recorded["speed"]) < 0.01, path


def follows_commands_as_recorded(path: Path, recorded: dict[str, Any]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "made.json"
        subprocess.run([*server.command(), "evaluate", path, "--commands", "--json", file], check=True)
        made = json.loads(file.read_text())
    assert made["falls"] == recorded["falls"] == 0.0, path
    assert abs(made["mean_error"] - recorded["mean_error"]) < 0.01, path
    assert abs(made["worst_error"] - recorded["worst_error"]) < 0.03, path


def test_clocks_walk_as_recorded() -> None:
    for path in kept("clocks.json"):
        made = json.loads(path.read_text())
        for name, recorded in made["scores"].items():
            policy = train_clock.policy(np.array(made["clocks"][name]))
            options = {**made["options"], "control": "clock"}
            score = evaluate_gait.evaluate(name, policy, seeds=recorded["episodes"], **options)
            assert abs(score.returns.mean() - recorded["return"]) < max(recorded["return_95"], 0.5), name
            assert abs(score.speed.mean() - recorded["speed"]) < 0.005, name


def test_strokes_push_as_recorded() -> None:
    for path in kept("strokes.json"):
        made = json.loads(path.read_text())
        for stroke in made["strokes"]:
            given = {**made["options"], "stroke": {**made["options"].get("stroke", {}), "start": stroke["start"]}}
            env = sandgait.SandgaitVectorEnv("sandgait/LegStroke-v0", 1, **given)
            env.reset(seed=0)
            actions = np.array(stroke["actions"])[:, None]
            assert abs(float(env.rollout(actions).returns[0]) - stroke["score"]) < 0.005, stroke["name"]
            env.close()
