"""The Controller: what it refuses, what it does to the last bit, and its log."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import onnx.reference
import pytest

import sandgait
import sandgait_deploy
from sandgait.certify import walk
from sandgait.plant import Conditions
from sandgait_deploy import Controller, Output, Refused, read_policy
from sandgait_deploy.__main__ import main
from sandgait_deploy.network import Network

ROOT = Path(__file__).parents[2]
POLICIES = ROOT / "examples/policies"
CAT = POLICIES / "LeggedVelocity-sandcat"
LEGGED = sorted(POLICIES.glob("LeggedVelocity-*"))


@pytest.fixture
def cat(tmp_path: Path) -> Path:
    """A copy of a kept policy, to be changed."""
    return Path(shutil.copytree(CAT, tmp_path / "cat"))


def change(folder: Path, **keys: Any) -> Path:
    path = folder / "policy.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **keys}))
    return folder


class Still:
    """Readings of a robot that stands still in its default pose."""

    def __init__(self, controller: Controller, period: float = 0.02) -> None:
        self._policy, self._period, self.time = controller.policy, period, 0.0

    def __call__(self, **changed: Any) -> dict[str, Any]:
        self.time += self._period
        pose = {servo.joint: servo.default for servo in self._policy.servos}
        read = {
            "time": self.time,
            "quaternion": [1.0, 0.0, 0.0, 0.0],
            "gyroscope": np.zeros(3),
            "lin_vel": np.zeros(3),
            "joint_position": pose,
            "joint_velocity": dict.fromkeys(pose, 0.0),
        }
        return {name: value for name, value in {**read, **changed}.items() if value is not None}


def until(controller: Controller, still: Still, state: str) -> Output:
    for _ in range(200):
        output = controller.step(still())
        if output.state == state:
            return output
    raise AssertionError(f"it is {output.state}, not {state}")


def standing(folder: Path = CAT, **options: Any) -> tuple[Controller, Still]:
    controller = Controller(folder, quaternion="wxyz", **options)
    still = Still(controller)
    until(controller, still, "ready")
    controller.stand()
    until(controller, still, "standing")
    return controller, still


@pytest.mark.parametrize("folder", LEGGED, ids=lambda folder: folder.name)
def test_kept_policies_follow_the_schema_and_their_golden_trace(folder: Path) -> None:
    schema = json.loads((Path(sandgait_deploy.__file__).parent / "policy.schema.json").read_text())
    jsonschema.validate(json.loads((folder / "policy.json").read_text()), schema)
    verified = Controller(folder).verify()
    assert [b.name for b in verified.boundaries] == ["observation", "action", "target", "effort"]
    assert verified, str(verified)
    assert verified.boundaries[0].identical, str(verified)


@pytest.mark.parametrize("folder", LEGGED, ids=lambda folder: folder.name)
def test_actions_are_the_simulator_s_to_the_last_bit(folder: Path) -> None:
    """`rollout_policy` computes observations and actions in the simulator."""
    settings = json.loads((folder / "settings.json").read_text())
    env = sandgait.SandgaitVectorEnv(settings["task"], 2, **{**settings["options"], "curriculum": None})
    first, _ = env.reset(seed=3)
    rollout = env.rollout_policy(folder / "policy.onnx", 30, trajectories=True)
    env.close()
    controller = Controller(folder)
    observations = np.concatenate([first[None], rollout.observations[:-1]])
    made = np.array([[controller.act(row) for row in rows] for rows in observations])
    assert np.ptp(made) > 0.5
    assert (made == rollout.actions).all()


def test_the_network_is_the_one_of_the_standard() -> None:
    """Another implementation of ONNX computes the same actions, up to its order of summation."""
    rows = np.random.default_rng(0).normal(size=(20, 48)).astype(np.float32)
    (wanted,) = onnx.reference.ReferenceEvaluator(str(CAT / "policy.onnx")).run(None, {"observation": rows})
    network = Network(CAT / "policy.onnx", 48, 12)
    np.testing.assert_allclose([network.act(row) for row in rows], wanted, atol=1e-5)


def test_it_needs_no_simulator() -> None:
    """The package imports numpy alone."""
    code = (
        "import sys; from sandgait_deploy import Controller; "
        f"assert Controller({str(CAT)!r}).verify(); "
        "print([m for m in ('sandgait', 'gymnasium', 'mujoco', 'onnxruntime') if m in sys.modules])"
    )
    folder = Path(sandgait_deploy.__file__).parents[1]
    done = subprocess.run([sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_joints_come_in_the_robot_s_order() -> None:
    """Arrays are read, and targets given, in the stated order."""
    own = read_policy(CAT).joints
    order = tuple(reversed(own))
    by_name, by_place = Controller(CAT, quaternion="wxyz"), Controller(CAT, quaternion="wxyz", joints=order)
    outputs = []
    for controller in (by_name, by_place):
        still = Still(controller)
        position = {
            joint: float(angle) + 0.01 * k for k, (joint, angle) in enumerate(still()["joint_position"].items())
        }
        speed = {joint: 0.1 * k for k, joint in enumerate(position)}

        def read(
            controller: Controller = controller, still: Still = still, position: Any = position, speed: Any = speed
        ) -> Any:
            if controller is by_name:
                return still(joint_position=position, joint_velocity=speed)
            return still(joint_position=[position[j] for j in order], joint_velocity=[speed[j] for j in order])

        for _ in range(10):
            controller.step(read())
        controller.stand()
        while controller.state != "standing":
            controller.step(read())
        controller.walk()
        outputs.append(controller.step(read(), (0.3, 0.0, 0.1)))
    first, second = outputs
    assert first.joints == own
    assert second.joints == order
    assert first.targets is not None
    assert second.targets is not None
    assert (first.targets == second.targets[::-1]).all()
    assert np.ptp(first.targets) > 0.1


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"lin_vel": None}, "lin_vel: the reading is missing; the policy was trained with the base's velocity"),
        ({"quaternion": None}, "quaternion: the reading is missing"),
        ({"quaternion": [1.0, 0.0, 0.0, 0.5]}, "quaternion: has the length 1.118, not 1"),
        ({"quaternion": [0.0, 1.0, 0.0, 0.0]}, "quaternion as wxyz: the robot is tilted by 180°"),
        ({"quaternion": [0.0, 0.0, 0.0, 1.0]}, "as if the order were that of xyzw"),
        ({"gyroscope": [0.0, float("nan"), 0.0]}, "gyroscope: number 1 is not finite"),
        ({"gyroscope": [0.0, 0.0]}, "gyroscope: has the shape (2,), not (3,)"),
        ({"joint_position": np.zeros(12)}, "joint_position: has no names of joints"),
        ({"joint_position": {"knee": 0.0}}, "is missing or unknown; the joints are "),
        ({"time": None}, "time: the reading is missing"),
    ],
)
def test_wrong_readings_are_refused_before_anything_moves(changed: dict[str, Any], words: str) -> None:
    controller = Controller(CAT, quaternion="wxyz")
    with pytest.raises(Refused) as error:
        controller.step(Still(controller)(**changed))
    assert words in str(error.value)
    assert "\n" not in str(error.value)
    assert controller.state == "checking"
    with pytest.raises(Refused, match="stand: the state is checking"):
        controller.stand()


def test_a_wrong_order_of_joints_is_refused() -> None:
    """A knee cannot be where a hip is, so arrays in another order than the stated one are seen."""
    policy = read_policy(CAT)
    pose = {servo.joint: servo.default for servo in policy.servos}
    by_kind = [policy.joints[3 * leg + k] for k in range(3) for leg in range(4)]
    controller = Controller(CAT, joints=by_kind, quaternion="wxyz")
    right = [pose[joint] for joint in by_kind]
    controller.step(Still(controller)(joint_position=right, joint_velocity=np.zeros(12)))
    controller.reset()
    with pytest.raises(Refused, match=r"outside of its range.*check the order of the joints"):
        controller.step(Still(controller)(joint_position=list(pose.values()), joint_velocity=np.zeros(12)))
    with pytest.raises(Refused, match=r"joints: '.*' must be named once"):
        Controller(CAT, joints=[*by_kind[1:], "tail"])


def test_old_readings_and_a_wrong_rate_are_refused() -> None:
    controller = Controller(CAT, quaternion="wxyz")
    still = Still(controller, period=0.01)
    controller.step(still())
    with pytest.raises(Refused, match=r"readings come at 100\.0 Hz; the policy needs a step at 50 Hz"):
        controller.step(still())
    with pytest.raises(Refused, match="those of the step before"):
        controller.step(still(time=0.01))
    with pytest.raises(Refused, match=r"the readings are 0\.500 s old"):
        controller.step(still(time=0.03), now=0.53)


def test_errors_while_it_moves_stop_the_robot() -> None:
    for changed, words in (({"gyroscope": None}, "gyroscope"), ({"time": 60.0}, "have passed since the last readings")):
        controller, still = standing()
        controller.walk()
        assert controller.step(still(), (0.3, 0.0, 0.0)).state == "walking"
        output = controller.step(still(**changed))
        assert (output.state, output.targets) == ("stopped", None)
        assert words in output.reason
        assert not output.stiffness.any()
        assert (output.damping > 0.0).all()
        assert controller.step(still()).state == "stopped"


def test_a_fall_ends_the_walk() -> None:
    controller, still = standing()
    controller.walk()
    leaning = [np.cos(0.6), np.sin(0.6), 0.0, 0.0]  # 69°
    output = controller.step(still(quaternion=leaning))
    assert (output.state, output.targets, output.reason) == ("fallen", None, "it is tilted by 69°")
    with pytest.raises(Refused, match="walk: the state is fallen"):
        controller.walk()


def test_targets_and_their_change_are_limited(cat: Path) -> None:
    about = json.loads((cat / "policy.json").read_text())
    default = about["targets"][0]["default"]
    about["targets"][0]["range"] = [default - 0.001, default + 0.001]
    controller, still = standing(change(cat, targets=about["targets"]), max_change=0.01)
    controller.walk()
    before = np.array([servo.default for servo in controller.policy.servos])
    for _ in range(5):
        output = controller.step(still(), (0.4, 0.0, 0.5))
        assert output.targets is not None
        assert np.abs(output.targets - before).max() <= 0.01 + 1e-12
        assert abs(output.targets[0] - default) <= 0.001 + 1e-12
        assert output.limited > 0
        before = output.targets


def test_it_rises_slowly_and_stops_if_a_joint_does_not_follow() -> None:
    controller = Controller(CAT, quaternion="wxyz")
    still = Still(controller)
    until(controller, still, "ready")
    controller.stand()
    crouched = {joint: angle + 0.3 for joint, angle in still()["joint_position"].items()}
    first = controller.step(still(joint_position=crouched))
    assert first.targets is not None
    assert np.abs(first.targets - list(crouched.values())).max() < 0.01
    away = {joint: angle + 0.9 for joint, angle in crouched.items()}
    output = controller.step(still(joint_position=away))
    assert output.state == "stopped"
    assert "check order, signs and gains" in output.reason


def test_old_folders_are_refused_and_described(cat: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Version 1 had no `version`; `describe` writes version 2, with the same bytes as are kept."""
    kept = {name: (cat / name).read_bytes() for name in ("policy.json", "golden.csv")}
    about = json.loads(kept["policy.json"])
    del about["version"]
    (cat / "policy.json").write_text(json.dumps(about))
    (cat / "golden.csv").unlink()
    assert main(["verify", str(cat)]) == 2
    said = capsys.readouterr().err
    assert "version 1 lacks limits" in said
    assert "describe" in said
    assert main(["describe", str(cat)]) == 0
    assert main(["verify", str(cat)]) == 0
    assert json.loads((cat / "policy.json").read_bytes()) == json.loads(kept["policy.json"])
    assert change(cat, version=3)
    with pytest.raises(Refused, match="is of version 3, this program reads version 2: update sandgait"):
        Controller(cat)
    with pytest.raises(Refused, match="are no targets of joints"):
        Controller(gait(cat.parent))


def gait(folder: Path) -> Path:
    made = Path(shutil.copytree(POLICIES / "HexapodGait-ppo", folder / "gait"))
    assert main(["describe", str(made)]) == 0
    return made


def test_a_swapped_network_or_trace_is_found(cat: Path) -> None:
    shutil.copy(POLICIES / "LeggedVelocity-go1" / "policy.onnx", cat / "policy.onnx")
    with pytest.raises(Refused, match="is not the network that it describes"):
        Controller(cat)


@pytest.mark.parametrize("boundary", ["observation", "action", "target", "effort"])
def test_verify_names_the_boundary_that_is_wrong(cat: Path, boundary: str) -> None:
    about = json.loads((cat / "policy.json").read_text())
    if boundary == "observation":  # two joints exchanged
        columns = about["observation"]
        first, second = (k for k, c in enumerate(columns) if c["reading"] == "joint_position" and c["index"] in (0, 1))
        columns[first]["index"], columns[second]["index"] = 1, 0
    elif boundary == "action":
        about["action"][0]["high"] = -0.9
    elif boundary == "target":
        about["targets"][3]["scale"] *= 1.01
    else:
        about["targets"][3]["stiffness"] *= 1.01
    verified = Controller(change(cat, **about)).verify()
    assert not verified
    wrong = [b.name for b in verified.boundaries if not b.holds]
    assert wrong[0] == boundary, str(verified)


def test_the_log_is_one_that_diagnose_reads(tmp_path: Path) -> None:
    path = tmp_path / "walk.csv"
    controller, still = standing(log=path)
    controller.walk()
    controller.step(still(), (0.3, 0.0, 0.0))
    controller.close()
    names, *rows = (line.split(",") for line in path.read_text().splitlines())
    assert names[:6] == ["run", "t", "quat_w", "quat_x", "quat_y", "quat_z"]
    assert {f"q:{joint}" for joint in controller.policy.joints} < set(names)
    assert {len(row) for row in rows} == {len(names)}
    assert [row[0] for row in rows] == ["walk1"]
    assert rows[0][names.index("acc_x")] == ""


def test_a_new_training_leaves_all_that_a_robot_needs(tmp_path: Path) -> None:
    """With a history, a clock and other sensors than the kept policies have."""
    settings = {"n_envs": 4, "n_steps": 32, "batch_size": 64, "n_epochs": 1, "policy_kwargs": {"net_arch": [8]}}
    options = {
        "ground": "rigid",
        "history": 2,
        "gait_clock": 1.5,
        "sensors": {"without": ["lin_vel"], "velocity_by_differences": True, "joint_torque": {"noise_density": 0.1}},
        "action_delay": [0.0, 0.03],
    }
    training = sandgait.train(
        "LeggedVelocity", out=tmp_path / "cat", timesteps=256, settings=settings, progress=False, **options
    )
    controller = Controller(training.out, quaternion="wxyz")
    policy = controller.policy
    assert policy.readings == ("gyroscope", "gravity", "joint_position", "joint_torque")
    assert (policy.history, policy.clock_frequency, policy.velocity_by_differences) == (2, 1.5, True)
    assert policy.trained_with["action_delay"] == [0.0, 0.03]
    verified = controller.verify()
    assert verified, str(verified)


def test_joints_that_no_action_moves_are_held(tmp_path: Path) -> None:
    """A robot with an arm whose training moves its legs alone."""
    arm = (
        '<body name="arm" pos="0.1 0 0.05"><joint name="shoulder" range="-1 1"/><geom size="0.03" mass="0.2"/></body>'
        '<body name="FL_hip" '
    )
    robot = tmp_path / "armed.xml"
    text = (ROOT / "robots/sandcat.xml").read_text()
    servo = '<actuator><position name="shoulder" joint="shoulder"/>'
    text = re.sub(r"<keyframe>.*?</keyframe>", "", text, flags=re.DOTALL)  # it lacks the shoulder
    robot.write_text(text.replace('<body name="FL_hip" ', arm).replace("<actuator>", servo))
    settings = {"n_envs": 4, "n_steps": 32, "batch_size": 64, "n_epochs": 1, "policy_kwargs": {"net_arch": [8]}}
    training = sandgait.train(
        "LeggedVelocity",
        out=tmp_path / "armed",
        timesteps=256,
        settings=settings,
        progress=False,
        robot=str(robot),
        ground="rigid",
        action_delay=[0.0, 0.0],
    )
    log = tmp_path / "walk.csv"
    controller, still = standing(training.out, log=log)
    policy = controller.policy
    assert (len(policy.joints), len(policy.servos), len(policy.action_low)) == (13, 13, 12)
    assert policy.servos[-1].joint == "shoulder"
    assert controller.verify(), str(controller.verify())
    controller.walk()
    output = controller.step(still(), (0.1, 0.0, 0.0))
    assert output.targets is not None
    assert output.targets[controller.joints.index("shoulder")] == policy.servos[-1].default
    controller.close()
    names = log.read_text().splitlines()[0].split(",")
    assert ("target:shoulder" in names, "action:shoulder" in names) == (True, False)
    job = walk.Job(str(training.out), str(robot), Conditions(ground="rigid"), ((0.1, 0.0, 0.0),))
    assert not walk.outcome(job).refused
