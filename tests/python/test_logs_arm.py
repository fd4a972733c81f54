"""Pushes of an arm with a force sensor become a force log: two commands from the recording to the page."""

from __future__ import annotations

import csv
import io
import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import Writer
from rosbags.typesys import Stores, get_typestore

import sandgait
from sandgait import logs, logs_arm

STORE = get_typestore(Stores.ROS2_HUMBLE)
START = 1_760_000_000 * 10**9

#: A slider that lifts a turning wrist with a sensor, 5 cm above a plate.
URDF = """<robot name="arm">
  <link name="base"/><link name="carriage"/><link name="wrist"/><link name="ft"/><link name="plate"/>
  <joint name="along" type="prismatic"><parent link="base"/><child link="carriage"/><axis xyz="1 0 0"/></joint>
  <joint name="lift" type="prismatic"><parent link="carriage"/><child link="wrist"/>
    <origin xyz="0 0 0.5"/><axis xyz="0 0 1"/></joint>
  <joint name="turn" type="revolute"><parent link="wrist"/><child link="ft"/><axis xyz="0 1 0"/></joint>
  <joint name="mount" type="fixed"><parent link="ft"/><child link="plate"/><origin xyz="0 0 -0.05"/></joint>
</robot>"""

EXPERIMENT = """kind = "intrusion"
bulk_density = 1500.0
[sand]
coefficients = "generic"
zeta = 0.3
[shape.disc]
type = "plate"
length = 0.05
width = 0.05
[arm]
urdf = "arm.urdf"
link = "plate"
sensor = "ft"
shape = "disc"
"""

#: Height of the sand in the arm's frame [m], stiffness of the sand [N/m], and what the sensor reads without load.
SURFACE, STIFFNESS, ZERO = 0.1234, 400.0, np.array([0.4, -0.3, -7.5])


def recording(path: Path, tilt: float = 0.0) -> None:
    """Six pushes down at two speeds, each with a rest, a way up and a move in the air, at 200 Hz."""
    types = STORE.types
    stamp, header = types["builtin_interfaces/msg/Time"], types["std_msgs/msg/Header"]
    joint_type, vector = types["sensor_msgs/msg/JointState"], types["geometry_msgs/msg/Vector3"]
    wrench_type, stamped = types["geometry_msgs/msg/Wrench"], types["geometry_msgs/msg/WrenchStamped"]
    rng, heights, places = np.random.default_rng(1), [], []
    along = 0.0
    for push in range(6):
        speed = (0.02, 0.06)[push % 2]
        free = SURFACE + 0.03
        way = [free] * 60 + list(np.arange(free, SURFACE - 0.03, -speed / 200)) + [SURFACE - 0.03] * 40
        way += list(np.arange(SURFACE - 0.03, free, 0.05 / 200)) + [free] * 20
        heights += way + [free] * 100
        places += [along] * len(way) + list(np.linspace(along, along + 0.05, 100))
        along += 0.05
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()

        def channel(topic: str, kind: str) -> int:
            return writer.register_channel(topic, "cdr", writer.register_schema(kind, "ros2msg", b""))

        joints = channel("/joint_states", "sensor_msgs/msg/JointState")
        sensor = channel("/wrench", "geometry_msgs/msg/WrenchStamped")
        for k, (height, place) in enumerate(zip(heights, places, strict=True)):
            ns = START + k * 5_000_000
            top = header(stamp(ns // 10**9, ns % 10**9), "base")
            arm = (height + 0.05 * math.cos(tilt) - 0.5, place + 0.05 * math.sin(tilt))
            q = np.array([arm[1], arm[0], tilt])
            down = height < heights[k - 1] if k else False
            push_up = STIFFNESS * max(SURFACE - height, 0.0) * (1.0 if down or height == heights[k - 1] else 0.1)
            # The sensor turns with the plate: the load in its own axes, and its moment about it.
            up = np.array([-math.sin(tilt), 0.0, math.cos(tilt)])
            force = push_up * up + ZERO + rng.normal(0.0, 0.02, 3)
            torque = np.cross([0.0, 0.0, -0.05], push_up * up)
            message = joint_type(top, ["along", "lift", "turn"], q, np.zeros(0), np.zeros(0))
            load = stamped(top, wrench_type(vector(*force), vector(*torque)))
            for where, kind, content in (
                (joints, "sensor_msgs/msg/JointState", message),
                (sensor, "geometry_msgs/msg/WrenchStamped", load),
            ):
                writer.add_message(where, ns, STORE.serialize_cdr(content, kind).tobytes(), ns)
        writer.finish()


def cut(folder: Path, experiment: str = EXPERIMENT) -> list[dict[str, str]]:
    (folder / "push.toml").write_text(experiment)
    command = [sys.executable, "-m", "sandgait.logs", "push.mcap", "--experiment", "push.toml", "--out", "push.csv"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode:
        assert done.returncode == 2
        assert len(done.stderr.splitlines()) == 1
        raise sandgait.InvalidRequest(done.stderr)
    return list(csv.DictReader(io.StringIO((folder / "push.csv").read_text())))


@pytest.mark.parametrize("tilt", [0.0, 0.3])
def test_pushes_are_cut_out_of_a_recording(tmp_path: Path, tilt: float) -> None:
    (tmp_path / "arm.urdf").write_text(URDF)
    recording(tmp_path / "push.mcap", tilt)
    rows = cut(tmp_path)
    assert {row["trial"] for row in rows} == {"1", "2", "3", "4", "5", "6"}
    assert [{row["condition"] for row in rows if row["trial"] == trial} for trial in "1234"] == [{"1"}, {"2"}] * 2
    numbers: dict[str, Any] = {name: np.array([float(row[name]) for row in rows]) for name in logs_arm.COLUMNS[5:]}
    assert np.abs(numbers["plate_beta"] + tilt).max() < 1e-3  # the joint turns the plate's front down
    assert np.abs(numbers["plate_gamma"] - np.pi / 2).max() < 1e-3
    assert numbers["z"].min() == pytest.approx(-0.03, abs=1e-3)
    want = STIFFNESS * np.maximum(-numbers["z"], 0.0)
    # The surface is known within a millimetre, which is 0.4 N here.
    assert np.abs(numbers["Fz"] - want).max() < 0.6
    assert np.abs(numbers["Fx"]).max() < 0.2
    assert np.abs(numbers["Ty"]).max() < 0.02  # about the plate's centre, 5 cm below the sensor
    first = [row for row in rows if row["trial"] == "1"]
    assert float(first[40]["vz"]) == pytest.approx(-0.02, rel=0.05)
    stated = cut(tmp_path, EXPERIMENT + f"surface = {SURFACE}\n")
    deepest = min(float(row["z"]) for row in stated)
    assert deepest == pytest.approx(-0.03, abs=1e-4)


def test_two_commands_lead_to_the_page(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(URDF)
    recording(tmp_path / "push.mcap")
    (tmp_path / "push.toml").write_text(EXPERIMENT)
    with pytest.warns(UserWarning, match="6 pushes are cut out"):
        found = sandgait.diagnose(tmp_path / "push.mcap", tmp_path / "push.toml", progress=False)
    assert found.report["check"]["design"]["conditions"] == 2
    assert found.report["check"]["design"]["repetitions"] == 3


def test_errors_of_an_arm_are_one_line(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(URDF)
    recording(tmp_path / "push.mcap")
    for experiment, words in (
        (EXPERIMENT.replace('link = "plate"', 'link = "hand"'), "link 'hand' is unknown; known: carriage, wrist"),
        (EXPERIMENT.replace("arm.urdf", "none.urdf"), "none.urdf"),
        (EXPERIMENT.replace('shape = "disc"', ""), "arm.shape: is missing"),
        (EXPERIMENT + "hand = 1\n", "'hand' is unknown; known: urdf, link"),
        (EXPERIMENT + "surface = 9.0\nx = [", "Invalid"),
    ):
        with pytest.raises(sandgait.InvalidRequest, match=words):
            cut(tmp_path, experiment)
    (tmp_path / "arm.urdf").write_text(URDF.replace('name="lift"', 'name="hoist"'))
    with pytest.raises(sandgait.InvalidRequest, match="no joint 'hoist'; it has along, lift, turn"):
        cut(tmp_path)
    assert logs.kind(tmp_path / "push.mcap") == "mcap"
