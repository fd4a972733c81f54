"""What a new user types in Python."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import gymnasium
import numpy as np
import pytest

import sandgait

ROOT = Path(__file__).parents[2]
GAIT = "sandgait/HexapodGait-v1"


def test_submodules_need_no_import() -> None:
    code = "import sandgait; print(sandgait.export.__name__, 'wrappers' in dir(sandgait)); sandgait.wrapper"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stdout == "sandgait.export True\n"
    # Python itself may add a suggestion.
    said = "AttributeError: module 'sandgait' has no attribute 'wrapper'"
    assert done.stderr.splitlines()[-1] in (said, f"{said}. Did you mean: 'wrappers'?")


def test_a_number_stands_for_a_range() -> None:
    env = gymnasium.make(GAIT, command=0.3, action_delay=0.02)
    env.reset(seed=0)
    options = {option.name: option.default for option in env.unwrapped.task.options}
    assert options["command"] == [0.3, 0.3]
    assert options["action_delay"] == [0.02, 0.02]
    env.reset(options={"command": 0.2})
    env.close()
    with pytest.raises(sandgait.InvalidRequest, match=r"rocks"):
        gymnasium.make("sandgait/HexapodRocks-v1", rocks={"field": 2.0})


@pytest.mark.parametrize(
    ("call", "meant"),
    [
        (lambda: gymnasium.make(GAIT, mediun="poppy-close"), "did you mean 'medium'"),
        (lambda: gymnasium.make(GAIT, medium="popy-close"), 'did you mean "poppy-close"'),
        (lambda: sandgait.SandgaitEnv(GAIT, render_mode="rgb-array"), 'did you mean "rgb_array"'),
        (lambda: sandgait.sweep({"xi": [0, 1]}, measure="sped"), 'did you mean "speed"'),
        (lambda: sandgait.evaluate("standin", seeds=2), 'did you mean "standing"'),
        (lambda: sandgait.train("HexapodGate", timesteps=10), 'did you mean "sandgait/HexapodGait-v1"'),
    ],
)
def test_typing_errors_get_a_suggestion(call: object, meant: str) -> None:
    with pytest.raises(sandgait.InvalidRequest) as refused:
        call()  # type: ignore[operator]
    assert meant in str(refused.value)


def test_a_policy_s_folder_has_its_task_and_options(tmp_path: Path) -> None:
    kept = ROOT / "examples/policies/HexapodTerrain-ppo"
    for name in ("policy.onnx", "settings.json"):
        shutil.copy(kept / name, tmp_path)
    policy = tmp_path / "policy.onnx"
    short = {"seeds": 2, "max_episode_steps": 20, "progress": False}
    alone = sandgait.evaluate(policy, **short)
    named = sandgait.evaluate(policy, "HexapodTerrain", **short)
    assert np.array_equal(alone["return"], named["return"])
    settings = json.loads((tmp_path / "settings.json").read_text())
    settings["options"]["slope_deg"] = 5
    (tmp_path / "settings.json").write_text(json.dumps(settings))
    assert sandgait.evaluate(policy, **short)["slope_deg"][0] == 5
    assert sandgait.evaluate(policy, slope_deg=2, **short)["slope_deg"][0] == 2
    (tmp_path / "settings.json").write_text("[]")
    with pytest.raises(sandgait.InvalidRequest, match=r"settings\.json: it has no task"):
        sandgait.evaluate(policy, **short)


def test_make_sb3_gives_torch_one_thread() -> None:
    pytest.importorskip("stable_baselines3")
    code = """
import os, sys, torch, sandgait
torch.set_num_threads(2)
sandgait.make_sb3("HexapodGait", 2, torch_threads=None).close()
assert torch.get_num_threads() == 2
os.environ["OMP_NUM_THREADS"] = "2"
sandgait.make_sb3("HexapodGait", 2).close()
assert torch.get_num_threads() == 2
del os.environ["OMP_NUM_THREADS"]
for _ in range(2):
    sandgait.make_sb3("HexapodGait", 2).close()
    assert torch.get_num_threads() == 1
"""
    env = {name: value for name, value in os.environ.items() if name not in ("OMP_NUM_THREADS", "MKL_NUM_THREADS")}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, env=env)
    assert done.returncode == 0, done.stderr
    said = [line for line in done.stderr.splitlines() if line.startswith("sandgait: ")]
    assert len(said) == 1
    assert "torch has 1 thread instead of 2" in said[0]
    assert "torch_threads=None" in said[0]
