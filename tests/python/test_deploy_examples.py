"""The examples of a robot's program, each with a simulated robot."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
CAT = ROOT / "examples/policies/LeggedVelocity-sandcat"
ROBOT = ROOT / "robots/sandcat.xml"


@pytest.mark.parametrize("name", ["unitree", "ros2", "serial"])
def test_the_simulated_robot_walks(name: str, tmp_path: Path) -> None:
    """It is asked for some 0.4 m/s during three to four seconds."""
    log = tmp_path / "walk.csv"
    script = ROOT / "examples" / f"deploy_{name}.py"
    command = [sys.executable, str(script), str(CAT), "--simulated", str(ROBOT), "--log", str(log)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    assert "standing" in done.stdout
    place = re.search(r"x = (-?[\d.]+) m, y = (-?[\d.]+) m", done.stdout)
    assert place, done.stdout
    assert float(place[1]) > 0.6, done.stdout
    rows = log.read_text().splitlines()
    assert any(row.startswith("walk1,") for row in rows)


@pytest.mark.parametrize("name", ["unitree", "ros2", "serial"])
def test_a_folder_without_a_policy_is_refused_in_one_line(name: str, tmp_path: Path) -> None:
    script = ROOT / "examples" / f"deploy_{name}.py"
    command = [sys.executable, str(script), str(tmp_path), "--simulated", str(ROBOT)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1
    assert "there is no such file" in done.stderr
