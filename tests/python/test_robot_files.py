"""A robot's file through every door (in this process, in a separate process, over the network) gives equal bits."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

import sandgait
from conftest import RemoteServer
from sandgait import _native

ROOT = Path(__file__).parents[2]
TASK = "sandgait/LeggedVelocity-v1"

#: A body with two legs of one joint; their shape is a mesh in another file.
MESHED = """<robot name="meshed">
  <link name="base">
    <inertial><mass value="2"/><inertia ixx="0.02" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><geometry><box size="0.2 0.1 0.05"/></geometry></collision>
  </link>
  <link name="leg">
    <inertial><origin xyz="0 0 -0.05"/><mass value="0.2"/>
      <inertia ixx="0.0003" iyy="0.0003" izz="0.0003" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><origin xyz="0 0 -0.1"/><geometry><mesh filename="{mesh}"/></geometry></collision>
  </link>
  <joint name="hip" type="revolute">
    <parent link="base"/><child link="leg"/><origin xyz="0.05 0 0"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="5" velocity="20"/>
  </joint>
  <link name="other_leg">
    <inertial><origin xyz="0 0 -0.05"/><mass value="0.2"/>
      <inertia ixx="0.0003" iyy="0.0003" izz="0.0003" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><origin xyz="0 0 -0.1"/><geometry><mesh filename="{mesh}"/></geometry></collision>
  </link>
  <joint name="other_hip" type="revolute">
    <parent link="base"/><child link="other_leg"/><origin xyz="-0.05 0 0"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="5" velocity="20"/>
  </joint>
</robot>"""

#: A pyramid of 3 cm with outward faces.
PYRAMID = """v 0 0 -0.03
v 0.02 0 0
v -0.01 0.0173 0
v -0.01 -0.0173 0
f 2 3 4
f 1 3 2
f 1 4 3
f 1 2 4
"""


@pytest.fixture
def meshed(tmp_path: Path) -> Path:
    (tmp_path / "foot.obj").write_text(PYRAMID)
    path = tmp_path / "meshed.urdf"
    path.write_text(MESHED.format(mesh="foot.obj"))
    return path


def walk(robot: Path, **keywords: Any) -> list[Any]:
    """Results of 30 steps of three robots. They begin partly in the sand, so that there are forces."""
    env = sandgait.SandgaitVectorEnv(TASK, 3, robot=robot, max_episode_steps=20, **keywords)
    said: list[Any] = [env.single_action_space.shape]
    said.append(env.reset(seed=5)[0])
    width = env.single_action_space.shape[0]
    for t in range(30):
        action = np.sin(0.3 * t + np.arange(3 * width).reshape(3, width)).astype(np.float32)
        observation, reward, terminated, truncated, info = env.step(action)
        said += [observation, reward, terminated, truncated, info["feet_in_contact"]]
    env.close()
    return said


@pytest.mark.parametrize("name", ["sandcat.urdf", "sandcat.xml", "meshed"])
@pytest.mark.filterwarnings("ignore:.*left out")
def test_a_robot_file_works_through_every_door(name: str, meshed: Path, remote: RemoteServer) -> None:
    robot = meshed if name == "meshed" else ROOT / "robots" / name
    here = walk(robot)
    assert np.isfinite(here[1]).all()
    assert max(float(np.max(touches)) for touches in here[6::5]) >= 1, "no foot ever touched the ground"
    for door in ({"isolated": True}, {"address": remote.address}):
        for ours, theirs in zip(here, walk(robot, **door), strict=True):
            np.testing.assert_array_equal(ours, theirs)


def test_gymnasium_takes_a_file_by_its_path(meshed: Path) -> None:
    for robot in (str(meshed), meshed):
        env = gymnasium.make(TASK, robot=robot)
        assert env.action_space.shape == (2,)
        env.reset(seed=0)
        assert np.isfinite(env.step(np.zeros(2, np.float32))[0]).all()
        env.close()


@pytest.mark.parametrize(
    ("mesh", "said"),
    [
        ("absent.obj", "absent.obj"),
        ("../../outside.obj", "outside.obj"),
        ("/etc/passwd", "passwd"),
    ],
)
def test_an_unreadable_mesh_gives_one_clear_line(mesh: str, said: str, meshed: Path, remote: RemoteServer) -> None:
    folder = meshed.parent / "robot" / "urdf"
    folder.mkdir(parents=True)
    (meshed.parent / "robot" / "package.xml").touch()
    shutil.move(meshed.parent / "foot.obj", meshed.parent / "outside.obj")
    meshed = folder / "meshed.urdf"
    meshed.write_text(MESHED.format(mesh=mesh))
    for door in ({}, {"address": remote.address}):
        with pytest.raises(sandgait.SandgaitError, match=said) as error:
            sandgait.SandgaitVectorEnv(TASK, 2, robot=meshed, **door)
        assert "\n" not in str(error.value)


def test_a_mesh_may_lie_beside_the_folder_of_the_robot(meshed: Path) -> None:
    folder = meshed.parent / "urdf"
    folder.mkdir()
    beside = folder / "meshed.urdf"
    beside.write_text(MESHED.format(mesh="../foot.obj"))
    for one, other in zip(walk(beside), walk(meshed), strict=True):
        np.testing.assert_array_equal(one, other)


def test_wrong_files_give_one_clear_line(tmp_path: Path, remote: RemoteServer) -> None:
    for name, text in [
        ("cut.urdf", "<robot name='a'><link name='b'>"),
        ("bomb.xml", "<!DOCTYPE a [<!ENTITY b 'bb'><!ENTITY c '&b;&b;'>]><mujoco>&c;</mujoco>"),
        ("empty.xml", ""),
    ]:
        path = tmp_path / name
        path.write_text(text)
        for door in ({}, {"address": remote.address}):
            with pytest.raises(sandgait.SandgaitError) as error:
                sandgait.SandgaitVectorEnv(TASK, 2, robot=path, **door)
            assert "\n" not in str(error.value)
            assert name in str(error.value)
    for door in ({}, {"address": remote.address}):
        with pytest.raises((sandgait.SandgaitError, OSError), match=r"nowhere\.urdf"):
            sandgait.SandgaitVectorEnv(TASK, 2, robot=tmp_path / "nowhere.urdf", **door)


def test_a_packed_file_is_a_robot(tmp_path: Path, remote: RemoteServer) -> None:
    packed = tmp_path / "cat.json"
    packed.write_text(_native.pack_robot(str(ROOT / "robots" / "sandcat.xml"), [], [], "plausible")[0])
    plain = walk(ROOT / "robots" / "sandcat.xml")
    for door in ({}, {"address": remote.address}):
        for ours, theirs in zip(plain, walk(packed, **door), strict=True):
            np.testing.assert_array_equal(ours, theirs)


def test_a_name_lays_pose_and_gains_over_a_file() -> None:
    """The built-in robot is its file with our numbers for it."""
    named = walk(Path(f"sandcat={ROOT / 'robots' / 'sandcat.urdf'}"))
    built_in = walk(Path("sandcat"))
    for ours, theirs in zip(named[:2], built_in[:2], strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_check_robot() -> None:
    sheet = sandgait.check_robot(ROOT / "robots" / "sandcat.xml", ground="poppy-loose")
    assert sheet["stands"]
    assert [ground["ground"] for ground in sheet["grounds"]] == ["rigid", "poppy-loose"]
    for ground in sheet["grounds"]:
        assert sum(foot["load"] for foot in ground["feet"]) == pytest.approx(ground["weight"], rel=0.05)
    with pytest.raises(sandgait.InvalidRequest, match="lava"):
        sandgait.check_robot(ROOT / "robots" / "sandcat.xml", ground="lava")


def test_packages_that_the_user_allows(tmp_path: Path) -> None:
    """Meshes of another package are read if an option names its folder."""
    (tmp_path / "bot").mkdir()
    (tmp_path / "bot" / "package.xml").write_text("<package><name>bot</name></package>")
    (tmp_path / "shells").mkdir()
    (tmp_path / "shells" / "trunk.obj").write_text(
        "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    )
    text = (ROOT / "robots" / "sandcat.urdf").read_text()
    text = text.replace('<box size="0.36 0.16 0.08"/>', '<mesh filename="package://shells/trunk.obj"/>')
    path = tmp_path / "bot" / "cat.urdf"
    path.write_text(text)
    with pytest.raises(sandgait.InvalidRequest, match="packages"):
        sandgait.SandgaitVectorEnv(TASK, 2, robot=path)
    for allowed in (tmp_path, [str(tmp_path / "shells")]):
        sandgait.SandgaitVectorEnv(TASK, 2, robot=path, packages=allowed).close()
    with pytest.raises(sandgait.InvalidRequest, match="no folder"):
        sandgait.SandgaitVectorEnv(TASK, 2, robot=path, packages=tmp_path / "absent")


def test_what_is_no_legged_robot_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "pendulum.urdf"
    text = MESHED.format(mesh="foot.obj")
    path.write_text(text[: text.index('<link name="other_leg">')] + "</robot>")
    (tmp_path / "foot.obj").write_text(PYRAMID)
    with pytest.raises(sandgait.InvalidRequest, match="looked for two branches") as error:
        sandgait.SandgaitVectorEnv(TASK, 2, robot=path)
    assert "\n" not in str(error.value)
