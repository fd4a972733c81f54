"""`sandgait adapt`: what a log says of motors, when it changes nothing, and what a training gets."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from sandgait import _native
from sandgait.adapt import Gain, Request, adapt, loop, page, posterior, summary
from sandgait.adapt.command import main
from sandgait.adapt.servo import Motors, motors
from sandgait_deploy import Refused, read_policy

ROOT = Path(__file__).parents[2]
CAT = ROOT / "examples/policies/LeggedVelocity-sandcat"
ROBOT = ROOT / "robots/sandcat.xml"
SAND = """name = "poppy-close"
law = "li2013"
bulk_density = 680.0
source = "a test"

[coefficients]
a00 = 94000.0
a10 = 92000.0
b11 = 92000.0
b01 = 151000.0
bm11 = 35000.0
c11 = -39000.0
c01 = 86000.0
cm11 = 18000.0
d10 = 46000.0

[mechanisms]
scale = 0.7
"""
HARDWARE = 'source = "a test"\n'


WEAK = {
    "verdict": "named",
    "summary": "it is named",
    "causes": [{"id": "scale", "value": 0.7, "unit": "1", "ci95": [0.6, 0.8]}],
    "next_experiment": None,
}


def found(verdict: str) -> dict[str, Any]:
    """The report of a diagnosis that names no cause."""
    return {"verdict": verdict, "summary": f"it is {verdict}", "causes": [], "next_experiment": None}


def written(report: dict[str, Any], out: Path) -> Path:
    """The folder of a finished diagnosis."""
    out.mkdir()
    (out / "report.json").write_text(json.dumps(report))
    (out / "sand.toml").write_text(SAND)
    (out / "hardware.toml").write_text(HARDWARE)
    return out


@pytest.fixture
def asked(tmp_path: Path) -> Request:
    """A copy of a kept policy that has a file of weights."""
    folder = Path(shutil.copytree(CAT, tmp_path / "cat"))
    (folder / "policy.safetensors").write_bytes(b"weights")
    log = tmp_path / "walk.csv"
    log.write_text("t\n0\n")
    return Request(log, folder, ROBOT, tmp_path / "out", timesteps=1)


def stub(monkeypatch: pytest.MonkeyPatch, report: dict[str, Any], errors: dict[str, float]) -> list[dict[str, Any]]:
    """Replaces diagnosis, training and evaluation; returns what the training was asked."""
    trained: list[dict[str, Any]] = []

    def train(task: str, **asked: Any) -> SimpleNamespace:
        trained.append({"task": task, **asked})
        return SimpleNamespace()

    def error(folder: Path, draw: Any) -> float:
        key = "old" if folder.name == "cat" else "new"
        return errors[key] if draw is not None else errors["trained"]

    monkeypatch.setattr(loop, "diagnose", lambda _request, _medium, place: written(report, place / "diagnosis"))
    monkeypatch.setattr(loop, "train", train)
    monkeypatch.setattr(loop, "_error", error)
    return trained


def log_of(path: Path, strength: float, steps: int) -> Path:
    """A log of joints that swing about their targets, whose torques are `strength` times the law's, with noise."""
    policy, random = read_policy(CAT), np.random.default_rng(0)
    joints = [servo.joint for servo in policy.servos]
    t = np.arange(500) / policy.rate
    phase = np.arange(len(joints))
    target = 0.1 * np.sin(9.0 * t[:, None] + phase) + 0.05 * random.normal(size=(500, len(joints)))
    q = 0.1 * np.sin(9.0 * t[:, None] + phase - 0.3)
    qd = 0.9 * np.cos(9.0 * t[:, None] + phase - 0.3)
    old = np.concatenate([target[:1]] * steps + [target[:-steps]])
    tau = strength * policy.torque(old, q, qd) + 0.1 * random.normal(size=q.shape)
    names = ["run", "t", *(f"{kind}:{joint}" for kind in ("target", "q", "qd", "tau") for joint in joints)]
    rows = np.column_stack([t, target, q, qd, tau])
    lines = [",".join(names), *("walk1," + ",".join(map(str, row)) for row in rows)]
    path.write_text("\n".join(lines))
    return path


@pytest.mark.parametrize(("strength", "steps"), [(1.0, 1), (0.88, 1), (1.1, 2)])
def test_the_motors_strength_follows_from_targets_and_torques(tmp_path: Path, strength: float, steps: int) -> None:
    fitted = motors(log_of(tmp_path / "walk.csv", strength, steps), read_policy(CAT))
    assert fitted is not None
    assert fitted.interval[0] <= strength <= fitted.interval[1]
    assert fitted.interval[1] - fitted.interval[0] < 0.06
    assert fitted.steps == steps
    assert fitted.differ == (strength != 1.0)


def test_torques_of_other_servos_say_nothing(tmp_path: Path) -> None:
    path = log_of(tmp_path / "walk.csv", 1.0, 1)
    rows = [line.split(",") for line in path.read_text().splitlines()]
    random = np.random.default_rng(1)
    for row in rows[1:]:
        row[-12:] = [str(x) for x in random.normal(size=12)]
    path.write_text("\n".join(map(",".join, rows)))
    assert motors(path, read_policy(CAT)) is None
    assert motors(CAT / "curve.csv", read_policy(CAT)) is None


@pytest.mark.parametrize("verdict", ["noise_floor", "ambiguous", "insufficient_data", "none_of_these"])
def test_a_log_that_cannot_tell_changes_nothing(asked: Request, monkeypatch: pytest.MonkeyPatch, verdict: str) -> None:
    trained = stub(monkeypatch, found(verdict), {})
    made = adapt(asked)
    assert not made.adapted
    assert not trained
    assert not (asked.out / "policy").exists()
    assert summary(made)[-1].startswith("NOTHING CHANGED: the log ")
    assert "<h1>NOTHING CHANGED" in page(made)


def test_where_nothing_is_to_gain_nothing_is_trained(asked: Request, monkeypatch: pytest.MonkeyPatch) -> None:
    trained = stub(monkeypatch, WEAK, {"trained": 0.05, "old": 0.06})
    made = adapt(asked)
    assert made.reason.startswith("nothing to gain: ")
    assert not trained


def test_the_policy_is_trained_on_in_the_log_s_world(asked: Request, monkeypatch: pytest.MonkeyPatch) -> None:
    trained = stub(monkeypatch, WEAK, {"trained": 0.05, "old": 0.3, "new": 0.1})
    weak = Motors(0.88, (0.86, 0.9), 1, 0.99)
    monkeypatch.setattr(loop, "motors", lambda *_: weak)
    made = adapt(asked)
    assert made.adapted
    assert made.gain is not None
    assert made.gain.mean == pytest.approx(0.2)
    (request,) = trained
    assert request["start_from"] == asked.policy / "policy.safetensors"
    assert Path(request["sand"]).read_text() == SAND
    drawn = Path(request["domain_rand"]["hardware"]).read_text()
    assert "torque_constant = { value = 0.88, interval = [0.86, 0.9] }" in drawn
    assert request["curriculum"]["level"] == 1.0
    assert "ADAPTED: " in summary(made)[-1]
    assert "<td>scale</td>" in page(made)
    # The simulator takes these options.
    options = json.loads((CAT / "settings.json").read_text())["options"]
    world = {"sand": SAND, "hardware": drawn, "domain_rand": {"hardware": drawn}}
    about, _ = _native.describe_policy(
        "sandgait/LeggedVelocity-v1", {**options, **world}, (CAT / "policy.onnx").read_bytes()
    )
    assert json.loads(about)["trained_with"]["hardware"] == drawn


def test_a_training_that_did_not_help_is_said(asked: Request, monkeypatch: pytest.MonkeyPatch) -> None:
    stub(monkeypatch, WEAK, {"trained": 0.05, "old": 0.3, "new": 0.3})
    made = adapt(asked)
    assert summary(made)[-1].startswith("KEEP THE OLD POLICY: the training did not help")


def test_worlds_are_drawn_from_the_intervals(tmp_path: Path) -> None:
    said = posterior(written(WEAK, tmp_path / "diagnosis"), Motors(0.88, (0.86, 0.9), 1, 0.99))
    worlds = said.draws(40, seed=0)
    assert worlds == said.draws(40, seed=0)
    values = [float(world.sand.split("scale = ")[1]) for world in worlds]
    assert 0.6 <= min(values) < 0.66
    assert 0.74 < max(values) <= 0.8
    strengths = [float(world.hardware.split("value = ")[1].split(",")[0]) for world in worlds]
    assert np.mean(strengths) == pytest.approx(0.88, abs=0.01)
    assert np.std(strengths) > 0.003


def test_the_interval_of_the_gain_is_student_s() -> None:
    gain = Gain((0.3,) * 8, (0.1, 0.2, 0.1, 0.2, 0.1, 0.2, 0.1, 0.2))
    low, high = gain.interval
    assert gain.mean == pytest.approx(0.15)
    assert high - low == pytest.approx(2 * 2.365 * np.std([0.1, 0.2] * 4, ddof=1) / 8**0.5)


def test_wrong_use_is_refused_and_writes_nothing(
    asked: Request, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    robot = ["--robot", str(ROBOT), "--out", str(tmp_path / "out")]
    kept = main([str(asked.log), "--policy", str(CAT), *robot])
    assert kept == 2
    assert "policy.safetensors: there is no such file" in capsys.readouterr().err
    assert main([str(asked.log), "--policy", str(asked.policy), *robot, "--medium", "rigid"]) == 2
    assert "say on which sand the robot walked" in capsys.readouterr().err
    assert main([str(asked.log), "--policy", str(asked.policy), *robot]) == 2
    assert "walk.csv" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine.txt").write_text("")
    with pytest.raises(Refused, match="is not empty"):
        adapt(asked)
