"""What `sandgait adapt` reads in a log by itself: motors, delays, and how commands were followed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sandgait.adapt import Request, loop
from sandgait.adapt.command import main
from sandgait.adapt.servo import action_delay, motors
from sandgait.adapt.tracking import compared, followed
from sandgait.certify.walk import Job, record
from sandgait.plant import NOISE, Conditions
from sandgait_deploy import read_policy

ROOT = Path(__file__).parents[2]
CAT = ROOT / "examples/policies/LeggedVelocity-sandcat"
ROBOT = ROOT / "robots/sandcat.xml"


def log_of(path: Path, strength: float, steps: int, noise: float = 0.0) -> Path:
    """A log of joints that swing about their targets, whose torques are `strength` times the law's, with noise. Their
    readings have `noise` times that of legged_gym."""
    policy, random = read_policy(CAT), np.random.default_rng(0)
    joints = [servo.joint for servo in policy.servos]
    t = np.arange(500) / policy.rate
    phase = np.arange(len(joints))
    target = 0.1 * np.sin(9.0 * t[:, None] + phase) + 0.05 * random.normal(size=(500, len(joints)))
    q = 0.1 * np.sin(9.0 * t[:, None] + phase - 0.3)
    qd = 0.9 * np.cos(9.0 * t[:, None] + phase - 0.3)
    old = np.concatenate([target[:1]] * steps + [target[:-steps]])
    tau = strength * policy.torque(old, q, qd) + 0.1 * random.normal(size=q.shape)
    q = q + noise * NOISE["joint_position"] * random.uniform(-1.0, 1.0, q.shape)
    qd = qd + noise * NOISE["joint_velocity"] * random.uniform(-1.0, 1.0, q.shape)
    names = ["run", "t", *(f"{kind}:{joint}" for kind in ("target", "q", "qd", "tau") for joint in joints)]
    rows = np.column_stack([t, target, q, qd, tau])
    lines = [",".join(names), *("walk1," + ",".join(map(str, row)) for row in rows)]
    path.write_text("\n".join(lines))
    return path


@pytest.mark.parametrize(("strength", "steps", "noise"), [(1.0, 1, 0.0), (0.88, 1, 0.0), (1.1, 2, 0.0), (1.0, 1, 0.5)])
def test_the_motors_strength_follows_from_targets_and_torques(
    tmp_path: Path, strength: float, steps: int, noise: float
) -> None:
    fitted = motors(log_of(tmp_path / "walk.csv", strength, steps, noise), read_policy(CAT))
    assert fitted is not None
    assert fitted.interval[0] <= strength <= fitted.interval[1]
    assert fitted.interval[1] - fitted.interval[0] < 0.06
    assert fitted.steps == steps
    assert fitted.differ == (strength != 1.0)


@pytest.mark.parametrize(("strength", "noise"), [(1.0, 1.0), (0.75, 0.1)])
def test_a_plant_s_motors_are_found(tmp_path: Path, strength: float, noise: float) -> None:
    """A robot in MuJoCo, on hard ground: its log names weak motors, and sound ones not even with noisy sensors."""
    conditions = Conditions(motor_strength=strength, noise=noise, latency=0.005)
    log = tmp_path / "walk.csv"
    assert record(Job(str(CAT), str(ROBOT), conditions, ((0.4, 0.0, 0.0),), seed=1), log, seconds=6.5)
    request = Request(log, CAT, ROBOT, tmp_path / "out", medium="rigid")
    found = loop._look(request, read_policy(CAT), "rigid", lambda _: None)
    assert found.motors is not None
    assert found.motors.interval[0] <= strength <= found.motors.interval[1]
    assert found.tells == (strength != 1.0)
    assert found.delay is None


def test_hard_ground_needs_no_diagnosis(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The whole command, on a log whose motors are sound."""
    log = log_of(tmp_path / "walk.csv", 1.0, 1)
    out = tmp_path / "out"
    assert main([str(log), "--policy", str(CAT), "--robot", str(ROBOT), "--medium", "rigid", "--out", str(out)]) == 1
    assert capsys.readouterr().out.splitlines()[-1].startswith("NOTHING CHANGED: the motors give the torque")
    assert [path.name for path in out.iterdir()] == ["adapt.html"]


def test_torques_of_other_servos_say_nothing(tmp_path: Path) -> None:
    path = log_of(tmp_path / "walk.csv", 1.0, 1)
    rows = [line.split(",") for line in path.read_text().splitlines()]
    random = np.random.default_rng(1)
    for row in rows[1:]:
        row[-12:] = [str(x) for x in random.normal(size=12)]
    path.write_text("\n".join(map(",".join, rows)))
    assert motors(path, read_policy(CAT)) is None
    assert motors(CAT / "curve.csv", read_policy(CAT)) is None


def test_a_log_says_how_its_commands_were_followed(tmp_path: Path) -> None:
    """Two commands of 4 s in a run, whose first 1.5 s do not count, and one that is too short."""
    names = (
        "run",
        "t",
        *(f"{what}_{axis}" for what in ("command", "lin_vel") for axis in "xy"),
        "command_yaw",
        "gyro_z",
    )
    rows = [",".join(names)]
    for k in range(450):
        forward, yaw = (0.4, 0.0) if k < 200 else (0.0, 0.8) if k < 400 else (0.4, 0.4)
        late = k % 200 >= 75
        velocity = (0.3 if k < 200 else 0.0) if late else -1.0
        rows.append(f"walk1,{0.02 * k},{forward},0,{velocity},0,{yaw},{yaw}")
    log = tmp_path / "walk.csv"
    log.write_text("\n".join(rows))
    logged = followed(log, read_policy(CAT))
    assert [one.error for one in logged] == pytest.approx([0.25, 0.0])
    assert [list(one.velocity) for one in logged] == [pytest.approx(v) for v in ([0.3, 0, 0], [0, 0, 0.8])]
    lines = [{"command": c, "error": e, "falls": f} for c, e, f in (([0.5, 0, 0], 0.2, 0), ([0, 0, 0.7], 0.1, 0.5))]
    assert compared(logged, lines) == pytest.approx((0.125, (0.2 + 1.0) / 2))
    assert followed(CAT / "curve.csv", read_policy(CAT)) == []


def test_a_delay_is_known_to_a_control_step(tmp_path: Path) -> None:
    policy = read_policy(CAT)
    assert action_delay(motors(log_of(tmp_path / "walk.csv", 1.0, 2), policy), policy) == (0.02, 0.04)
    assert action_delay(motors(log_of(tmp_path / "walk.csv", 1.0, 1), policy), policy) is None
