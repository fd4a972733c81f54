"""Parameters that PACE and iit-DLSLab identified, as a hardware.toml. The files are made here, in their formats."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest

import sandgait
from sandgait.identified import hardware_of, main

ARMATURE, DAMPING, FRICTION = [0.01, 0.02, 0.04], [0.2, 0.3, 0.25], [0.3, 0.1, 0.5]
BIAS, DELAY = [0.03, -0.04, 0.0], 4.0


def of_pace(path: Path) -> Path:
    import torch

    torch.save(torch.tensor([*ARMATURE, *DAMPING, *FRICTION, *BIAS, DELAY]), path)
    return path


def of_iit(path: Path, friction: str = "dynamic_friction") -> Path:
    lists = {"armature": ARMATURE, "viscous_friction": DAMPING, friction: FRICTION, "bias": BIAS}
    text = "# Order: a, b, c\n" + "".join(f"{name} = {numbers}\n" for name, numbers in lists.items())
    path.write_text(text + f"delay = {DELAY}\nKp = 20.0\nimport no_such_module\n")  # it is read, not run
    return path


@pytest.mark.parametrize("form", ["pace", "iit", "iit static"])
def test_both_formats_give_the_same_file_which_tasks_take(tmp_path: Path, form: str) -> None:
    if form == "pace":
        file = of_pace(tmp_path / "mean_199.pt")
    else:
        file = of_iit(tmp_path / "found.py", "static_friction" if "static" in form else "dynamic_friction")
    out = tmp_path / "hardware.toml"
    assert main([str(file), "--dt", "0.0025", "--out", str(out)]) == 0
    found = tomllib.loads(out.read_text())
    assert found["action_delay"] == {"value": 0.01, "interval": [0.01, 0.01]}
    assert found["actuator"]["rotor_inertia"] == {"value": pytest.approx(0.07 / 3, rel=1e-5), "interval": [0.01, 0.04]}
    assert found["actuator"]["damping"] == {"value": 0.25, "interval": [0.2, 0.3]}
    assert found["actuator"]["friction"] == {"value": 0.3, "interval": [0.1, 0.5]}
    assert found["sensors"]["joint_position"]["bias"]["value"] == pytest.approx(np.sqrt(0.0025 / 3), rel=1e-5)
    for options in ({"hardware": out}, {"domain_rand": {"hardware": out}}):
        env = sandgait.SandgaitVectorEnv("sandgait/LeggedVelocity-v1", 1, ground="rigid", **options)
        env.reset(seed=0)
        env.step(np.zeros((1, 12), np.float32))
        env.close()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("armature = [0.1]\n", "has no viscous_friction"),
        (
            "armature = [-0.1]\nviscous_friction = [0]\nfriction = [0]\nbias = [0]\ndelay = 0\n",
            "rotor_inertia is negat",
        ),
        ("armature = [1e999]\nviscous_friction = [0]\nfriction = [0]\nbias = [0]\ndelay = 0\n", "not finite"),
        ("a b", "is no Python file"),
    ],
)
def test_wrong_files_are_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, said: str) -> None:
    file = tmp_path / "found.py"
    file.write_text(text)
    assert main([str(file), "--dt", "0.0025", "--out", str(tmp_path / "hardware.toml")]) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ")
    assert error.count("\n") == 1
    assert said in error
    assert not (tmp_path / "hardware.toml").exists()


def test_other_torch_files_and_steps_are_refused(tmp_path: Path) -> None:
    import torch

    torch.save(torch.zeros(12), tmp_path / "other.pt")
    with pytest.raises(ValueError, match=r"has 12 numbers; mean_NNN\.pt of PACE has four for each joint and a delay"):
        hardware_of(tmp_path / "other.pt", 0.0025)
    with pytest.raises(ValueError, match=r"dt: 0\.0 s is outside"):
        hardware_of(of_pace(tmp_path / "mean_001.pt"), 0.0)
    (tmp_path / "broken.pt").write_bytes(b"nothing")
    with pytest.raises(ValueError, match=r"is no mean_NNN\.pt of PACE"):
        hardware_of(tmp_path / "broken.pt", 0.0025)
