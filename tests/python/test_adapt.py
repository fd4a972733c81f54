"""`sandgait adapt`: what a log says of motors, when it changes nothing, and what a training gets."""

from __future__ import annotations

import json
import shutil
import tomllib
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from reports import LISTS, SAND, UNCERTAIN, WEAK, found, written
from sandgait import _native
from sandgait.adapt import Gain, Request, World, adapt, loop, page, posterior, summary
from sandgait.adapt import command as adapt_command
from sandgait.adapt.command import main
from sandgait.adapt.servo import Motors
from sandgait.adapt.tracking import Followed
from sandgait.certify.ground import ground_of
from sandgait.training import train
from sandgait_deploy import Controller, Refused, read_policy

ROOT = Path(__file__).parents[2]
CAT = ROOT / "examples/policies/LeggedVelocity-sandcat"
ROBOT = ROOT / "robots/sandcat.xml"


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
        asked["out"].mkdir()
        return SimpleNamespace()

    def lines(folder: Path, world: World, _: Any) -> list[dict[str, Any]]:
        key = "old" if folder.name == "cat" else "new"
        error = errors["trained"] if world == World() else errors[key]
        velocity = [0.4 * (1.0 - error), 0.0, 0.0]
        return [{"command": [0.4, 0.0, 0.0], "velocity": velocity, "error": error, "falls": 0.0}]

    monkeypatch.setattr(loop, "diagnose", lambda _request, _medium, place: written(report, place / "diagnosis"))
    monkeypatch.setattr(loop, "train", train)
    monkeypatch.setattr(loop, "_lines", lines)
    return trained


def robot_walks(speed: float) -> Followed:
    """A robot that is commanded to walk at 0.4 m/s."""
    return Followed(np.array([0.4, 0.0, 0.0]), np.array([speed, 0.0, 0.0]), 0.4)


def samples(weights: Path) -> float:
    """Number of observations in the statistics of a safetensors file."""
    content = weights.read_bytes()
    size = int.from_bytes(content[:8], "little")
    first, last = json.loads(content[8 : 8 + size])["observations.count"]["data_offsets"]
    return float(np.frombuffer(content[8 + size + first : 8 + size + last])[0])


def test_a_policy_is_trained_on_in_both_worlds(tmp_path: Path) -> None:
    """Real trainings of two updates: networks of the policy's size, from its state, into a folder that is whole."""
    small = {"n_envs": 8, "n_steps": 32, "batch_size": 128, "policy_kwargs": {"net_arch": {"pi": [16], "vf": [16]}}}
    cat, out = tmp_path / "cat", tmp_path / "out"
    train("sandgait/LeggedVelocity-v1", out=cat, timesteps=512, settings=small, progress=False, robot=str(ROBOT))
    report = found("ambiguous", **{name: UNCERTAIN[name][:3] for name in UNCERTAIN if name in LISTS})
    report["ambiguity_set"] = UNCERTAIN["ambiguity_set"][:2]
    (tmp_path / "d").mkdir()
    said = posterior(written(report, tmp_path / "d" / "diagnosis"), Motors(0.75, (0.73, 0.77), 1, 0.99))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(loop, "ROUNDS", 1)
        out.mkdir()
        new = loop._train(Request(tmp_path / "log.csv", cat, ROBOT, out, timesteps=1024), said, lambda _: None)
    assert sorted(path.name for path in out.iterdir()) == ["policy"]
    policy = read_policy(new)
    assert policy.trained_with["domain_rand"]["hardware"] == said.best.hardware
    settings = json.loads((new / "settings.json").read_text())
    assert settings["options"]["sand"] == said.best.sand
    assert settings["hyperparameters"]["policy_kwargs"]["net_arch"] == {"pi": [16], "vf": [16]}
    assert Controller(new).verify()
    # It went on from the policy's statistics: 512 steps, then those of both stages.
    counts = [samples(folder / "policy.safetensors") for folder in (cat, new)]
    assert counts[1] - counts[0] >= 1024 - 256
    # certify takes the sand of the last stage.
    assert ground_of(policy, None).conditions().ground == said.best.sand


@pytest.mark.parametrize("version", [3, 4])
@pytest.mark.parametrize("verdict", ["noise_floor", "insufficient_data", "none_of_these"])
def test_a_log_that_cannot_tell_changes_nothing(
    asked: Request, monkeypatch: pytest.MonkeyPatch, verdict: str, version: int
) -> None:
    trained = stub(monkeypatch, found(verdict, version, written="proxy"), {})
    made = adapt(asked)
    assert not made.adapted
    assert not trained
    assert not (asked.out / "policy").exists()
    assert summary(made)[-1].startswith("NOTHING CHANGED: the log ")
    assert ("log next: walks with at least three commands" in made.reason) == (verdict != "noise_floor")
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
    assert tomllib.loads(request["sand"]) == tomllib.loads(SAND)
    drawn = request["domain_rand"]["hardware"]
    assert request["settings"]["policy_kwargs"]["net_arch"] == {"pi": [128, 128], "vf": [128, 128]}
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


def test_an_uncertain_diagnosis_is_trained_in_rounds(asked: Request, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = replace(asked, timesteps=9000)
    trained = stub(monkeypatch, UNCERTAIN, {"trained": 0.05, "old": 0.3, "new": 0.1})
    made = adapt(asked)
    assert made.adapted
    assert len(trained) == 3 * loop.ROUNDS
    assert [t["start_from"].parent for t in trained] == [asked.policy, *(t["out"] for t in trained[:-1])]
    assert sum(t["timesteps"] for t in trained) == pytest.approx(9000, abs=9)
    last = tomllib.loads(trained[-1]["sand"])["mechanisms"]
    assert last["scale"] == 0.7
    assert {t["payload"] > 0.0 for t in trained} == {True, False}
    assert (asked.out / "policy").is_dir()
    assert "the log cannot tell these apart: scale = 0.7 (5" in summary(made)[1]
    assert "inertial_drag" in page(made)


def test_a_proxy_of_the_sand_is_not_trained_for(asked: Request, monkeypatch: pytest.MonkeyPatch) -> None:
    """If no cause is named, weak motors are adapted to in the training's sand."""
    trained = stub(monkeypatch, found("none_of_these", written="proxy"), {"trained": 0.05, "old": 0.3, "new": 0.1})
    monkeypatch.setattr(loop, "motors", lambda *_: Motors(0.75, (0.73, 0.77), 1, 0.99))
    assert adapt(asked).adapted
    assert [t["sand"] for t in trained] == [""]
    # Nor for motors and sensors of a model that does not explain the log.
    assert "friction" not in trained[0]["domain_rand"]["hardware"]


def test_the_interval_of_the_gain_is_that_of_one_robot() -> None:
    errors = (0.3,) * 8, (0.1, 0.2, 0.1, 0.2, 0.1, 0.2, 0.1, 0.2)
    gain = Gain(*errors)
    half = 2.365 * np.std([0.1, 0.2] * 4, ddof=1) * (9 / 8) ** 0.5
    assert gain.mean == pytest.approx(0.15)
    assert gain.interval == pytest.approx((0.15 - half, 0.15 + half))
    # The robot's errors are half, or twice, those of the simulated one; a loss has the same interval, reflected.
    for ratio in (0.5, 2.0):
        assert Gain(*errors, ratio).interval == pytest.approx((0.075 - half, 0.3 + half))
        assert Gain(*reversed(errors), ratio).interval == pytest.approx((-0.3 - half, -0.075 + half))


def test_a_gain_counts_if_it_is_sure_and_no_world_loses_much() -> None:
    before = (0.5, 0.5, 0.47, 0.41, 0.66, 0.5, 0.53, 0.6)
    better = (0.45, 0.44, 0.44, 0.42, 0.47, 0.44, 0.45, 0.46)
    assert Gain(before, better).doubt == ""
    assert "is within its error" in Gain(before, before).doubt
    assert "is within its error" in Gain((0.3, 0.3, 0.3, 0.3) * 2, (0.2, 0.4, 0.2, 0.38) * 2).doubt
    harmed = (0.2,) * 7 + (0.66,)
    assert "in one of the worlds the error rises by 6.0%" in Gain(before, harmed).doubt


def test_what_joints_and_imu_do_not_show_is_said(asked: Request, monkeypatch: pytest.MonkeyPatch) -> None:
    stub(monkeypatch, found("noise_floor"), {"trained": 0.02, "old": 0.02})
    monkeypatch.setattr(loop, "followed", lambda *_: [robot_walks(0.28)])
    made = adapt(asked)
    assert "error of 30.0%, the simulated one with 2.0%, so something differs" in made.reason
    assert "log next: no walk, but pushes of a plate" in made.reason


def test_walks_say_what_the_log_does_not(asked: Request, monkeypatch: pytest.MonkeyPatch) -> None:
    """A robot with a payload on hard ground or sand, whose walks only a payload makes."""
    stub(monkeypatch, found("none_of_these"), {})

    def lines(folder: Path, world: World, _: Any) -> list[dict[str, Any]]:
        error = 0.02 + (0.1 if folder.name == "cat" else 0.02) * world.payload
        velocity = [0.4 * (1.0 - error), 0.0, 0.0]
        return [{"command": [0.4, 0.0, 0.0], "velocity": velocity, "error": error, "falls": 0.0}]

    monkeypatch.setattr(loop, "_lines", lines)
    monkeypatch.setattr(loop, "followed", lambda *_: [robot_walks(0.4 * (1.0 - 0.42))] * 3)
    made = adapt(asked)
    assert made.adapted
    ((cause,),) = (member.causes for member in made.found.members)
    assert cause.id == "payload"
    assert cause.interval[0] < 4.0 < cause.interval[1]
    assert "The walks are those of a simulated robot with a payload of" in summary(made)[0]
    # A sand without a table of coefficients is said.
    made = adapt(replace(asked, medium="zeta=0.3", out=asked.out.parent / "other"))
    assert "other sands were not tried, because zeta=0.3 is no table" in summary(made)[0]


def test_the_weights_are_needed_only_for_training(asked: Request, monkeypatch: pytest.MonkeyPatch) -> None:
    (asked.policy / "policy.safetensors").unlink()
    trained = stub(monkeypatch, WEAK, {"trained": 0.05, "old": 0.3})
    made = adapt(asked)
    assert not trained
    assert "policy.safetensors is missing" in summary(made)[-1]
    assert summary(made)[-1].startswith("NOTHING CHANGED: there is something to gain, but ")


def test_a_place_that_cannot_be_written_is_refused_before_the_work(
    asked: Request, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("")
    arguments = [str(asked.log), "--policy", str(asked.policy), "--robot", str(ROBOT)]
    for place in (tmp_path / "file", tmp_path / "file" / "below", Path("/proc/nowhere")):
        assert main([*arguments, "--out", str(place)]) == 2
        said = capsys.readouterr()
        assert (said.out, said.err.count("\n")) == ("", 1)
        assert f"{place}" in said.err
        assert "cannot be written" in said.err
    # What fails afterwards is one line, too.
    stub(monkeypatch, found("noise_floor"), {})
    monkeypatch.setattr(adapt_command, "page", lambda _: (tmp_path / "file" / "no").write_text(""))
    assert main([*arguments, "--out", str(tmp_path / "out")]) == 1
    assert capsys.readouterr().err.splitlines()[-1].endswith("cannot be written: Not a directory")


def test_wrong_use_is_refused_and_writes_nothing(
    asked: Request, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    robot = ["--robot", str(ROBOT), "--out", str(tmp_path / "out")]
    assert main([str(asked.log), "--policy", str(asked.policy), *robot, "--medium", "dunes"]) == 2
    assert "say on which sand the robot walked" in capsys.readouterr().err
    assert main([str(asked.log), "--policy", str(asked.policy), *robot]) == 2
    assert "walk.csv" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine.txt").write_text("")
    with pytest.raises(Refused, match="is not empty"):
        adapt(asked)
