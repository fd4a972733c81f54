"""The examples do what they promise."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def run(*arguments: str, cwd: Path = ROOT) -> str:
    return subprocess.run(
        [sys.executable, *arguments], capture_output=True, text=True, check=True, timeout=300, cwd=cwd
    ).stdout


def test_train_gait_writes_what_it_promises(tmp_path: Path) -> None:
    """A few seconds: the files and the table, not the skill."""
    arguments = ["--seconds", "4", "--envs", "16", "--options", json.dumps({"leg": "C", "max_episode_steps": 100})]
    output = run("examples/train_gait.py", *arguments, "--out", str(tmp_path / "run"))
    written = {path.name for path in (tmp_path / "run").iterdir()}
    assert written == {"policy.zip", "normalize.pkl", "settings.json", "curve.csv", "curve.png", "evaluation.txt"}
    for name in ("learnt (PPO)", "the best rate", "random actions"):
        assert re.search(re.escape(name) + r" .*-?\d+\.\d ± \d+\.\d", output)
    settings = json.loads((tmp_path / "run" / "settings.json").read_text())
    assert settings["options"]["leg"] == "C"
    assert settings["seed"] == 0


@pytest.mark.parametrize(
    ("name", "writes", "says"),
    [
        ("leg_forces", ["leg_forces.png"], r"L +lifts +7\.5 N at +-41°"),
        ("design_sweep", ["design_sweep.png"], r"fastest: ξ = \d+° at [\d.]+ Hz: [\d.]+ cm/s"),
        (
            "diagnose_force_log",
            [f"diagnose_force_log/{file}" for file in ("curves.png", "walks.png", "report.html", "sand.toml")],
            r"inertial_drag: 0\.\d+, 95 % interval",
        ),
    ],
)
def test_a_worked_study_draws_its_figures(name: str, writes: list[str], says: str, tmp_path: Path) -> None:
    """Under half a minute each, every cell, no warning."""
    shutil.copytree(ROOT / "examples/data", tmp_path / "examples/data")
    start = time.monotonic()
    output = subprocess.run(
        [sys.executable, "-W", "error", ROOT / f"examples/{name}.py"],
        capture_output=True,
        text=True,
        check=True,
        timeout=120,
        cwd=tmp_path,
        env={**os.environ, "MPLBACKEND": "Agg"},
    ).stdout
    assert time.monotonic() - start < 30
    assert re.search(says, output), output
    for file in writes:
        assert (tmp_path / "runs" / file).stat().st_size > 500


def test_the_bench_of_the_client_measures() -> None:
    rows = json.loads(run("benches/client.py", "--envs", "8", "--seconds", "0.2", "--json"))
    assert rows[0]["envs"] == 8
    assert rows[0]["env_steps_per_second"] > 0
