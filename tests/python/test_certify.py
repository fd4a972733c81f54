"""`sandgait certify`: verdicts on a kept policy and on spoiled ones, causes, and wrong use."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from reports import POPPY
from sandgait.certify import Certificate, Line, Outcome, Request, Wiring, certify, page, sheet, walk
from sandgait.certify.causes import joined, of_conditions, of_wiring, wirings
from sandgait.certify.command import main
from sandgait.certify.grid import cases
from sandgait.certify.ground import ground_of
from sandgait.certify.walk import Job, outcome
from sandgait.grounds import stronger
from sandgait.plant import Conditions
from sandgait_deploy import Verification, read_policy

ROOT = Path(__file__).parents[2]
CAT = ROOT / "examples/policies/LeggedVelocity-sandcat"
ROBOT = ROOT / "robots/sandcat.xml"
TURNING = ((0.4, 0.0, 0.0), (0.0, 0.0, 0.8))


def walks(conditions: Conditions, **options: Any) -> Outcome:
    return outcome(Job(str(CAT), str(ROBOT), conditions, TURNING, **options))


def silent(_: str) -> None:
    """No progress."""


@pytest.mark.parametrize("ground", ["rigid", "poppy-close"])
def test_the_kept_policy_walks_in_the_other_engine(ground: str) -> None:
    made = walks(Conditions(ground=ground, latency=0.005))
    assert made.holds, made.words
    assert made.error < 0.25, made.words
    assert 0.1 < made.torque[0] <= 1.0


def test_the_same_conditions_give_the_same_walk() -> None:
    conditions = Conditions(noise=1.0, latency=0.01)
    first, again, other = walks(conditions, seed=1), walks(conditions, seed=1), walks(conditions, seed=2)
    assert first == again
    assert first != other


def test_a_slope_is_felt_by_robot_and_attitude() -> None:
    """Uphill the attitude says so: the robot pitches back, and gravity in the base's frame has a part along −x."""
    from sandgait.certify.walk import make_plant

    plant = make_plant(read_policy(CAT), ROBOT, Conditions(slope_deg=10.0), seed=0)
    plant.reset({})
    read = plant.readings()
    assert read["gravity"][0] == pytest.approx(-0.1736, abs=1e-3)
    assert abs(read["gravity"][1]) < 1e-9
    assert read["accelerometer"] @ read["gravity"] < -9.0 or abs(plant.data.qacc[2]) > 1.0


def test_wrong_wiring_fails_and_is_named() -> None:
    """The robot's gyroscope is reversed; the counterfactual that undoes it names it."""
    job = Job(str(CAT), str(ROBOT), Conditions(), TURNING[1:], wiring=Wiring(reversed=("gyroscope",)))
    made = outcome(job)
    assert not made.holds, made.words
    tried = [w for w in wirings(read_policy(CAT)) if w.name.endswith("reversed")]
    cause = of_wiring(job, tried, silent)
    assert cause is not None
    assert cause.kind == "contract"
    assert "gyroscope reversed" in cause.words


def test_legs_exchanged_twice_are_in_order() -> None:
    exchanged = next(w for w in wirings(read_policy(CAT)) if w.name == "left and right legs exchanged")
    assert not walks(Conditions(), wiring=exchanged).holds
    twice = joined(exchanged, exchanged)
    assert twice.joints == tuple(range(12))


def test_exchanged_joints_do_not_even_start() -> None:
    order = list(range(12))
    order[1], order[2] = 2, 1
    made = walks(Conditions(), wiring=Wiring(joints=tuple(order)))
    assert "check the order of the joints" in made.refused
    assert not made.holds


def test_a_policy_that_was_trained_without_delays_fails_at_80_ms() -> None:
    job = Job(str(CAT), str(ROBOT), Conditions(latency=0.08), TURNING[:1])
    assert not outcome(job).holds
    cause = of_conditions(job, silent)
    assert cause is not None
    assert cause.kind == "physics"
    assert cause.words.startswith("without the latency of 80 ms it walks")


def test_a_whole_certificate(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Short walks on hard ground, so that it takes seconds."""
    monkeypatch.setattr(walk, "SECONDS", 2.0)
    monkeypatch.setattr(walk, "BEGINNING", 1.0)
    made, numbers = tmp_path / "page.html", tmp_path / "all.json"
    arguments = [str(CAT), "--robot", str(ROBOT), "--quick", "--ground", "rigid", "--jobs", "1"]
    code = main([*arguments, "--out", str(made), "--json", str(numbers)])
    said = capsys.readouterr().out
    all = json.loads(numbers.read_text())
    assert code == (0 if all["deploy"] else 1)
    assert said.splitlines()[-1].startswith("DEPLOY: " if all["deploy"] else "DO NOT DEPLOY: ")
    assert len(all["mujoco"]["rigid"]["lines"]) == len(all["simulator"]["rigid"]) == 9
    assert f"<h1 class='{'yes' if all['deploy'] else 'no'}'>" in made.read_text()


def test_a_spoiled_folder_is_not_deployed(tmp_path: Path) -> None:
    """Two joints of policy.json exchanged: the golden trace says at which boundary."""
    folder = Path(shutil.copytree(CAT, tmp_path / "cat"))
    about = json.loads((folder / "policy.json").read_text())
    for column in about["observation"]:
        if column["reading"] == "joint_velocity" and column["index"] in (0, 3):
            column["index"] = 3 - column["index"]
    (folder / "policy.json").write_text(json.dumps(about))
    certificate = certify(Request(folder, ROBOT, ground="rigid", quick=True))
    assert not certificate.deploy
    assert certificate.cause is not None
    assert certificate.cause.kind == "contract"
    assert "boundary observation" in certificate.cause.words
    assert "DO NOT DEPLOY" in sheet(certificate).splitlines()[-1]
    assert "<h1 class='no'>" in page(certificate)


@pytest.mark.parametrize(
    ("ground", "first", "varies"),
    [
        ("dunes", "note: the ground (--ground, dunes) is flat poppy-loose here, without its dunes", "sand's strength"),
        ("mixed", "without its slabs of hard ground", "sand's strength"),
        ("mu=0.5,rho=1500", "sandgait/LeggedVelocity-v1, sandcat", "sand's strength"),
        ("rigid", "sandgait/LeggedVelocity-v1, sandcat", "friction of the ground"),
    ],
)
def test_the_first_line_says_what_stands_in(ground: str, first: str, varies: str) -> None:
    """And on every sand its strength is varied, never the friction of hard ground in its place."""
    policy = read_policy(CAT)
    made = ground_of(policy, ground)
    failed = Verification(())
    certificate = Certificate(
        policy, Request(CAT, ROBOT), made, failed, {}, {}, Outcome(made.conditions(), ()), (), None, ("no walk",)
    )
    assert first in sheet(certificate).splitlines()[0]
    assert not made.note or made.note in page(certificate)
    tried = cases(policy, made.conditions(), quick=False)
    assert {c.what for c in tried} & {"sand's strength", "friction of the ground"} == {varies}
    if ground != "rigid":
        factors = sorted(c.conditions.sand_strength for c in tried if c.what == varies)
        assert factors[-1] / factors[0] == pytest.approx(18.0)


def test_the_sand_of_a_training_is_that_of_its_file(tmp_path: Path) -> None:
    """As after `sandgait adapt`, which trains in a diagnosed sand."""
    folder = Path(shutil.copytree(CAT, tmp_path / "cat"))
    settings = json.loads((folder / "settings.json").read_text())
    text = stronger(POPPY, 0.7)
    settings["options"]["sand"] = text
    (folder / "settings.json").write_text(json.dumps(settings))
    made = ground_of(read_policy(folder), None)
    assert (made.name, made.conditions().ground) == ("poppy-close", text)
    assert made.options()["sand"] == text
    assert ground_of(read_policy(folder), "glass-beads").options()["sand"] == ""


def test_words_of_an_outcome() -> None:
    fell = Outcome(Conditions(), (Line((0.4, 0.0, 0.0), (0.0, 0.0, 0.0), 1.0, True),))
    assert (fell.words, fell.holds) == ("mean error 100 %, worst 100 %, falls in 1 of 1", False)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([str(CAT)], "--robot"),
        ([str(CAT), "--robot", "no.xml"], "robot: no.xml is no file"),
        ([str(CAT), "--robot", str(ROBOT), "--ground", "popy"], "poppy-loose"),
        ([str(CAT), "--robot", str(ROBOT), "--latency", "9"], "--latency: 9.0 is outside [0, 0.5]"),
        (["nowhere", "--robot", str(ROBOT)], "there is no such file"),
        ([str(CAT), "--robot", str(ROBOT), "--out", "nowhere/page.html"], "its folder does not exist"),
        ([str(CAT), "--robot", str(ROBOT), "--out", str(ROOT)], "cannot be written: Is a directory"),
        ([str(CAT), "--robot", str(ROBOT), "--json", "/proc/numbers.json"], "/proc/numbers.json: cannot be written"),
        ([str(CAT), "--robot", str(ROBOT), "--ground", "no.toml"], "no.toml cannot be read"),
        ([str(CAT), "--robot", str(ROBOT), "--ground", "zeta=30"], "with 4.24 times the stress"),
        ([str(CAT), "--robot", str(CAT / "curve.csv")], "MuJoCo cannot read it"),
    ],
)
def test_wrong_use_is_one_line_and_code_2(arguments: list[str], words: str) -> None:
    """Through the command that pip installs."""
    run = "import sys; from sandgait_command import main; sys.exit(main())"
    done = subprocess.run(
        [sys.executable, "-c", run, "certify", *arguments], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.count("\n") == 1, done.stderr
    assert words in done.stderr
