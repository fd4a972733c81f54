"""What `sandgait adapt` makes of a report: members, their weights, and worlds."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest

from reports import SAND, UNCERTAIN, WEAK, found, row, written
from sandgait.adapt import World, posterior
from sandgait.adapt.servo import Motors
from sandgait_deploy import Refused


def test_a_delay_is_drawn_from_its_control_step(tmp_path: Path) -> None:
    sound = Motors(1.0, (0.98, 1.02), 2, 0.99)
    said = posterior(written(found("noise_floor"), tmp_path / "diagnosis"), sound, (0.02, 0.04))
    assert said.tells
    assert tomllib.loads(said.best.hardware)["action_delay"] == {"value": 0.03, "interval": [0.02, 0.04]}
    drawn = [tomllib.loads(w.hardware)["action_delay"]["value"] for w in said.draws(50, seed=0)]
    assert 0.02 < min(drawn) < 0.024
    assert 0.036 < max(drawn) < 0.04


def test_worlds_are_drawn_from_the_intervals(tmp_path: Path) -> None:
    said = posterior(written(WEAK, tmp_path / "diagnosis"), Motors(0.88, (0.86, 0.9), 1, 0.99))
    worlds = said.draws(40, seed=0)
    assert worlds == said.draws(40, seed=0)
    values = [scale_of(world) for world in worlds]
    assert 0.6 <= min(values) < 0.66
    assert 0.74 < max(values) <= 0.8
    strengths = [float(world.hardware.split("value = ")[1].split(",")[0]) for world in worlds]
    assert np.mean(strengths) == pytest.approx(0.88, abs=0.01)
    assert np.std(strengths) > 0.003


def scale_of(world: World) -> float:
    return float(tomllib.loads(world.sand)["mechanisms"]["scale"])


def test_an_uncertain_diagnosis_is_a_mixture(tmp_path: Path) -> None:
    said = posterior(written(UNCERTAIN, tmp_path / "diagnosis"))
    assert said.members[0].causes[0].id == "scale"
    weights = [m.weight for m in said.members]
    assert sum(weights) == pytest.approx(1.0)
    # Members 1 ± 1 and 1 ± 1 below the best: about 0.5, 0.25 and 0.25; 9 ± 1 below: e^-8.5.
    assert weights[0] == pytest.approx(0.52, abs=0.05)
    assert weights[3] < 0.001
    assert len(said.trained) == 3
    assert said.untrained == ("joint_zero",)
    worlds = said.draws(200, seed=0)
    drag = [tomllib.loads(w.sand)["mechanisms"].get("inertial_drag", 0.0) for w in worlds]
    loads = [w.payload for w in worlds]
    share = dict(zip((m.causes[0].id for m in said.members), weights, strict=True))
    assert np.count_nonzero(drag) == pytest.approx(200 * share["inertial_drag"], abs=1)
    assert np.count_nonzero(loads) == pytest.approx(200 * share["payload"], abs=1)
    # 4 with Δχ² = 64: a standard deviation of 4/8.
    assert np.std([x for x in drag if x]) == pytest.approx(0.5, rel=0.35)
    # A member's world has its own causes alone.
    assert all(scale_of(w) == 0.0 for w, d, p in zip(worlds, drag, loads, strict=True) if d or p)
    assert said.next == "walk at 0.4 m/s; stand (it separates these)"


def test_a_weak_motor_is_that_of_its_member_alone(tmp_path: Path) -> None:
    limit = {"id": "motor_torque_limit", "value": 9.0, "unit": "N·m", "ci95": [8.0, 10.0]}
    sets = [["motor_torque_limit"], ["scale"]]
    tried = [{"ids": ids, "values": [value], "delta_chi2": 40.0} for ids, value in zip(sets, (9.0, -0.3), strict=True)]
    evidence = [row(ids, 0.0, 0.0) for ids in sets]
    report = found("ambiguous", causes=[limit], ambiguity_set=sets, candidates=tried, evidence=evidence)
    folder = written(report, tmp_path / "diagnosis")
    with (folder / "hardware.toml").open("a") as file:
        file.write("torque_limit = { value = 9.0, interval = [8.0, 10.0] }\n")
    said = posterior(folder)
    worlds = {m.causes[0].id: said.world(m, None) for m in said.members}
    assert "torque_limit" in worlds["motor_torque_limit"].hardware
    assert "torque_limit" not in worlds["scale"].hardware
    assert "friction" in worlds["scale"].hardware
    assert scale_of(worlds["scale"]) == -0.3


def test_errors_of_measuring_have_no_world(tmp_path: Path) -> None:
    """As reports of version 4 have them: candidates give no values of such errors, and sets repeat for each channel."""
    report = found(
        "ambiguous",
        causes=[{"id": "origin", "kind": "measurement", "value": 0.001, "unit": "m", "ci95": [0.0005, 0.0015]}],
        ambiguity_set=[["origin"], ["gain", "depth_power"], ["origin"], ["gain"]],
        evidence=[row([], -20.0, 1.0), row(["origin"], 0.0, 0.0), row(["gain"], 0.0, 0.0), row(["origin"], 0.0, 0.0)],
        candidates=[
            {"ids": ["origin"], "values": [], "delta_chi2": 50.0},
            {"ids": ["gain", "depth_power"], "values": [-0.3], "delta_chi2": 50.0},
            {"ids": ["gain"], "values": [], "delta_chi2": 40.0},
        ],
    )
    said = posterior(written(report, tmp_path / "diagnosis"))
    assert [m.weight for m in said.members] == pytest.approx([1 / 3] * 3)
    assert said.untrained == ("origin", "gain")
    assert [m.words for m in said.members] == [
        "origin = 0.001 m (33%)",
        "gain and depth_power = -0.3 (33%)",
        "gain (33%)",
    ]
    powers = [tomllib.loads(said.world(m, None).sand)["mechanisms"].get("depth_power") for m in said.members]
    assert powers == [None, -0.3, None]


def test_a_recalibrated_sand_is_taken_with_its_uncertainty(tmp_path: Path) -> None:
    report = found("recalibrated", recalibration={"factor": 0.7, "ci95": [0.6, 0.8]})
    said = posterior(written(report, tmp_path / "diagnosis"))
    assert said.tells
    assert said.best.sand == SAND
    factors = [(1.0 + scale_of(world)) / 1.7 for world in said.draws(200, seed=0)]
    assert np.log(factors).std() == pytest.approx(np.log(0.8 / 0.6) / 3.92, rel=0.2)


def test_reports_of_other_versions_are_refused(tmp_path: Path) -> None:
    with pytest.raises(Refused, match=r"sandgait.diagnosis.v5, not one of"):
        posterior(written(found("named", version=5), tmp_path / "diagnosis"))
