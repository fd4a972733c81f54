"""`sandgait.train`: trainings from Python, as on the command line."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest

import sandgait
from conftest import HEARS_CTRL_C, ID, RemoteServer
from sandgait.errors import InvalidRequest, SandgaitError, ServerLost

SMALL: dict[str, Any] = {
    "settings": {"n_envs": 16, "n_steps": 8, "batch_size": 64, "n_epochs": 2, "policy_kwargs": {"net_arch": [16]}},
    "max_episode_steps": 30,
    "progress": False,
}


def test_a_training_writes_its_files(tmp_path: Path) -> None:
    told: list[tuple[float, str]] = []
    heard = {**SMALL, "progress": lambda share, stage: told.append((share, stage))}
    training = sandgait.train(ID, out=tmp_path, timesteps=2048, seed=1, **heard)
    assert training.steps == 2048
    assert training.seconds > 0.0
    assert training.curve["steps"][-1] <= 2048
    assert len(training.curve["return"]) == len((tmp_path / "curve.csv").read_text().splitlines()) - 1 > 3
    assert training.score is not None
    assert training.score == json.loads((tmp_path / "settings.json").read_text())["score"]
    shares = [share for share, _ in told]
    assert shares == sorted(shares)
    assert any("steps" in stage for _, stage in told)
    evaluation = sandgait.evaluate(training.policy, ID, seeds=8, progress=False, max_episode_steps=30)
    assert np.isfinite(evaluation.speed).all()
    assert sandgait.read_recording(training.recording)
    assert training.summary == (tmp_path / "evaluation.txt").read_text()


class Enough(Exception):
    pass


def test_an_exception_ends_a_training_which_resumes_with_the_same_bits(tmp_path: Path) -> None:
    last = 0.0
    updates = 0

    def told(share: float, stage: str) -> None:
        nonlocal last, updates
        updates += share > last
        last = share
        if updates == 4:
            raise Enough

    sandgait.train(ID, out=tmp_path / "whole", timesteps=2048, **SMALL)
    with pytest.raises(Enough) as raised:
        sandgait.train(ID, out=tmp_path / "parts", timesteps=2048, **{**SMALL, "progress": told})
    assert "go on with --resume" in raised.value.__notes__[0]
    (kept,) = (tmp_path / "parts" / "checkpoints").glob("*.safetensors")
    assert int(kept.stem) >= 4 * 128
    training = sandgait.train(ID, out=tmp_path / "parts", timesteps=2048, resume=True, **SMALL)
    assert training.policy.read_bytes() == (tmp_path / "whole" / "policy.onnx").read_bytes()


def test_a_training_starts_from_what_another_has_learnt(tmp_path: Path) -> None:
    small = {**SMALL, "settings": {**SMALL["settings"], "learning_rate": 1e-12}}
    first = sandgait.train(ID, out=tmp_path / "first", timesteps=256, **SMALL)
    start = first.out / "policy.safetensors"
    second = sandgait.train(ID, out=tmp_path / "second", timesteps=256, start_from=start, **small)
    assert second.steps == 256
    before, after = (
        [np.asarray(onnx.numpy_helper.to_array(w)) for w in onnx.load(t.policy).graph.initializer]
        for t in (first, second)
    )
    assert len(before) == len(after)
    weights = [(a, b) for a, b in zip(before, after, strict=True) if a.ndim == 2]
    assert weights
    assert all(np.allclose(a, b, atol=1e-6) for a, b in weights)
    with pytest.raises(sandgait.SandgaitError, match="start_from"):
        sandgait.train(ID, out=tmp_path / "second", timesteps=512, start_from=start, resume=True, **small)
    with pytest.raises((sandgait.SandgaitError, OSError), match=r"nowhere\.safetensors"):
        sandgait.train(ID, out=tmp_path / "third", timesteps=256, start_from="nowhere.safetensors", **small)
    assert not (tmp_path / "third").exists()


#: Sends Ctrl-C during a long update. Prints the time of an update, and the time from the signal to the exception.
INTERRUPTED = f"""
{HEARS_CTRL_C}
import os, sys, threading, time
import sandgait

times = []
def told(share, stage):
    if not times or share > times[-1][0]:
        times.append((share, time.perf_counter()))
        if len(times) == 3:
            threading.Thread(target=strike).start()

def strike():
    global struck
    time.sleep(0.3 * (times[2][1] - times[1][1]))
    struck = time.perf_counter()
    os.kill(os.getpid(), 2)

settings = {{"n_envs": 64, "n_steps": 512, "batch_size": 1024, "n_epochs": 30}}
try:
    sandgait.train({ID!r}, out=sys.argv[1], timesteps=10**9, settings=settings, progress=told)
except KeyboardInterrupt as error:
    print(times[2][1] - times[1][1], time.perf_counter() - struck, error.__notes__[0], sep="|")
"""


def test_ctrl_c_interrupts_an_update_and_leaves_a_checkpoint(tmp_path: Path) -> None:
    command = [sys.executable, "-c", INTERRUPTED, str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    update, stop, note = done.stdout.split("|")
    assert float(stop) < 0.4 * float(update), done.stdout
    (kept,) = (tmp_path / "checkpoints").glob("*.safetensors")
    assert str(tmp_path / "policy.onnx") in note
    assert "--resume" in note
    assert int(kept.stem) % (64 * 512) == 0


def test_wrong_settings_are_refused_and_write_nothing(tmp_path: Path) -> None:
    out = tmp_path / "out"
    wrong: list[tuple[dict[str, Any], str]] = [
        ({"settings": {"gama": 0.9}}, 'setting "gama" is unknown'),
        ({"settings": {"n_envs": 0}}, "n_envs: 0 is outside"),
        ({"settings": {"n_envs": 2, "n_steps": 2}}, "batch_size: 1024 is more than"),
        ({"threads": 5000}, "threads: 5000 is outside"),
        ({"checkpoint_every": 0}, "checkpoint_every: 0 is outside"),
        ({"seconds": float("nan")}, "seconds: NaN is outside"),
        ({"seconds": float("inf")}, "seconds: inf is outside"),
        ({"leg": "Q"}, "leg"),
        ({"address": "nowhere"}, "neither"),
    ]
    for given, words in wrong:
        with pytest.raises(InvalidRequest, match=words):
            sandgait.train(out=out, progress=False, timesteps=4096, **given)
    with pytest.raises(SandgaitError, match=r"task .* has been replaced by"):
        sandgait.train("sandgait/HexapodGait-v0", out=out, progress=False)
    with pytest.raises(SandgaitError, match="no checkpoint"):
        sandgait.train(out=out, progress=False, resume=True)
    with pytest.raises(ServerLost, match="cannot be reached"):
        sandgait.train(out=out, progress=False, address="127.0.0.1:1")
    assert not out.exists()


def test_environments_on_a_server_are_the_same(tmp_path: Path, remote: RemoteServer) -> None:
    here = sandgait.train(ID, out=tmp_path / "here", timesteps=1024, **SMALL)
    away = sandgait.train(ID, out=tmp_path / "away", timesteps=1024, address=remote.address, **SMALL)
    assert here.policy.read_bytes() == away.policy.read_bytes()
    columns = [name for name in here.curve if name != "seconds"]
    assert columns[:2] == ["steps", "return"]
    assert len([name for name in columns if name.startswith("reward_")]) == 7
    for name in columns:
        assert here.curve[name].tolist() == away.curve[name].tolist(), name
