"""Pictures and windows of environments."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import sandgait
from conftest import ID, RemoteServer
from sandgait import server

ACTION = np.full(6, 0.4, dtype=np.float32)


def walked(env: gymnasium.Env, steps: int) -> None:
    env.reset(seed=1)
    for _ in range(steps):
        env.step(ACTION)


def test_pictures_are_what_gymnasium_expects() -> None:
    env = gymnasium.make(ID, render_mode="rgb_array")
    assert env.metadata["render_fps"] == env.unwrapped.task.control_rate
    check_env(env.unwrapped)
    walked(env, 5)
    picture = env.render()
    assert picture.shape == (360, 480, 3)
    assert picture.dtype == np.uint8
    for _ in range(10):
        env.step(ACTION)
    assert np.abs(env.render().astype(int) - picture).mean() > 0.5, "it moves"
    top, bottom = picture[:40].mean(axis=(0, 1)), picture[-40:].mean(axis=(0, 1))
    assert top[2] > bottom[2] + 30, "the sky is above"
    env.close()


def orange(picture: np.ndarray) -> float:
    """Mean column of the base's front, which is painted orange."""
    red, green, blue = (picture[..., k].astype(int) for k in range(3))
    columns = np.nonzero((red - blue > 70) & (red - green > 50) & (green > 50))[1]
    assert columns.size > 20
    return float(columns.mean())


def test_the_front_is_ahead_and_the_robot_is_followed() -> None:
    env = sandgait.SandgaitEnv(ID, render_mode="rgb_array", render_size=(640, 480))
    walked(env, 100)
    before, picture = env.reset(seed=1)[0], env.render()
    assert before.shape == (41,)
    assert orange(picture) > 320
    walked(env, 100)
    assert orange(env.render()) == pytest.approx(orange(picture), abs=40)
    env.close()


def test_an_episode_that_ended_is_shown_to_its_end() -> None:
    env = sandgait.SandgaitEnv(ID, render_mode="rgb_array", max_episode_steps=30)
    walked(env, 30)
    last = env.render()
    env.reset()
    assert np.abs(env.render().astype(int) - last).mean() > 0.5
    env.close()


def test_every_environment_of_a_batch_has_its_picture() -> None:
    env = gymnasium.make_vec(ID, num_envs=3, render_mode="rgb_array", render_size=(160, 120))
    env.reset(seed=1)
    actions = np.stack([ACTION, 0 * ACTION, -ACTION])
    for _ in range(20):
        env.step(actions)
    pictures = env.render()
    assert [p.shape for p in pictures] == [(120, 160, 3)] * 3
    assert (pictures[0] != pictures[1]).any()
    env.unwrapped.send(actions)
    with pytest.raises(sandgait.OutOfOrder, match="in flight"):
        env.unwrapped.render()
    env.unwrapped.recv()
    env.close()


def test_several_servers_show_their_environments(remote: object) -> None:
    addresses = [server.address(), remote.address]  # type: ignore[attr-defined]
    alone = sandgait.SandgaitVectorEnv(ID, 3, render_mode="rgb_array", render_size=(64, 48))
    spread = sandgait.SandgaitVectorEnv(ID, 3, addresses, render_mode="rgb_array", render_size=(64, 48))
    for env in (alone, spread):
        env.reset(seed=4)
        env.step(np.stack([ACTION, 0 * ACTION, -ACTION]))
    assert np.array_equal(alone.render(), spread.render())
    for env in (alone, spread):
        env.close()


def test_wrong_use_is_refused() -> None:
    with pytest.raises(sandgait.InvalidRequest, match='render_mode: "ansi" is unknown; known: rgb_array, human'):
        sandgait.SandgaitEnv(ID, render_mode="ansi")
    with pytest.raises(sandgait.InvalidRequest, match=r"render_size: height 8 is outside \[16, 4096\]"):
        sandgait.SandgaitVectorEnv(ID, 2, render_mode="rgb_array", render_size=(64, 8))
    env = sandgait.SandgaitEnv(ID, render_mode="rgb_array")
    with pytest.raises(sandgait.OutOfOrder, match="before reset"):
        env.render()
    env.close()
    plain = sandgait.SandgaitVectorEnv(ID, 2)
    with pytest.raises(sandgait.InvalidRequest, match="rgb_array"):
        plain.render()
    with pytest.raises(sandgait.InvalidRequest, match=r"index: 2 is outside \[0, 2\)"):
        plain.record("nothing.rec", index=2)
    with pytest.raises(sandgait.SandgaitError, match="cannot be written"):
        plain.record("/nowhere/walk.rec")
    plain.close()


def test_record_video(tmp_path: Path) -> None:
    env = gymnasium.make(ID, render_mode="rgb_array", max_episode_steps=25)
    env = gymnasium.wrappers.RecordVideo(env, str(tmp_path / "videos"), episode_trigger=lambda _: True)
    env.reset(seed=1)
    over = False
    while not over:
        _, _, terminated, truncated, _ = env.step(ACTION)
        over = terminated or truncated
    env.close()
    (video,) = (tmp_path / "videos").glob("*.mp4")
    assert video.stat().st_size > 2000


def test_vec_video_recorder(tmp_path: Path) -> None:
    from stable_baselines3.common.vec_env import VecVideoRecorder

    env = sandgait.make_sb3(ID, 4, render_mode="rgb_array", render_size=(160, 120))
    recorder = VecVideoRecorder(
        env, str(tmp_path / "videos"), record_video_trigger=lambda step: step == 0, video_length=20
    )
    recorder.reset()
    for _ in range(25):
        recorder.step(np.stack([ACTION] * 4))
    assert recorder.render().shape == (240, 320, 3)
    recorder.close()
    (video,) = (tmp_path / "videos").glob("*.mp4")
    assert video.stat().st_size > 2000


HUMAN = f"""
import numpy as np, gymnasium, pygame, sandgait
env = gymnasium.make("{ID}", render_mode="human")
env.reset(seed=1)
for _ in range(5):
    env.step(np.full(6, 0.4, dtype=np.float32))
surface = pygame.display.get_surface()
assert surface.get_size() == (480, 360), surface
shown = pygame.surfarray.array3d(surface).swapaxes(0, 1)
other = gymnasium.make("{ID}", render_mode="rgb_array")
other.reset(seed=1)
for _ in range(5):
    other.step(np.full(6, 0.4, dtype=np.float32))
assert (shown == other.render()).all()
env.close()
assert not pygame.display.get_init()
"""


def run_with_window(code: str, driver: str) -> None:
    places = {"PYTHONPATH": str(Path(sandgait.__file__).parents[1])}
    environment = {**os.environ, **places, "SDL_VIDEODRIVER": driver}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, f"{done.returncode}: {done.stderr}"


def test_a_window_shows_the_same_pictures() -> None:
    run_with_window(HUMAN, "dummy")


#: With the first optimizer, torch imports triton if it is installed.
WATCHED_TRAINING = f"""
import gymnasium, sandgait
env = gymnasium.make("{ID}", render_mode="human")
env.reset(seed=1)
import torch
torch.optim.Adam([torch.zeros(1, requires_grad=True)])
loaded = open("/proc/self/maps").read()
assert "libGL" not in loaded and "libEGL" not in loaded, "SDL has loaded OpenGL for a picture"
env.close()
"""


def test_a_process_with_a_window_can_train() -> None:
    """Mesa's OpenGL and torch's triton each contain an LLVM. If both are loaded, the process crashes.

    This driver opens a window without a display, and loads OpenGL if Mesa is installed.
    """
    run_with_window(WATCHED_TRAINING, "offscreen")


def test_without_pygame_a_window_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(sandgait.SandgaitError, match=r"pip install 'sandgait\[human\]'"):
        sandgait.SandgaitEnv(ID, render_mode="human")


LEGGED = "sandgait/LeggedVelocity-v1"
SANDCAT = Path(__file__).parents[2] / "robots" / "sandcat.urdf"

#: A box, and a leg that is seen as a mesh alone: a pyramid of 20 cm.
MESHED = """<robot name="meshed">
  <link name="base">
    <inertial><mass value="2"/><inertia ixx="0.02" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual><geometry><box size="0.2 0.1 0.05"/></geometry></visual>
    <collision><geometry><box size="0.2 0.1 0.05"/></geometry></collision>
  </link>
  <link name="leg">
    <inertial><origin xyz="0 0 -0.05"/><mass value="0.2"/>
      <inertia ixx="0.0003" iyy="0.0003" izz="0.0003" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual><origin xyz="0 0 -0.05"/><geometry><mesh filename="{mesh}"/></geometry></visual>
    <collision><origin xyz="0 0 -0.1"/><geometry><sphere radius="0.02"/></geometry></collision>
  </link>
  <link name="other">
    <inertial><origin xyz="0 0 -0.05"/><mass value="0.2"/>
      <inertia ixx="0.0003" iyy="0.0003" izz="0.0003" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><origin xyz="0 0 -0.1"/><geometry><sphere radius="0.02"/></geometry></collision>
  </link>
  <joint name="hip" type="revolute">
    <parent link="base"/><child link="leg"/><axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="5" velocity="20"/>
  </joint>
  <joint name="other_hip" type="revolute">
    <parent link="base"/><child link="other"/><axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="5" velocity="20"/>
  </joint>
</robot>"""
PYRAMID = "v 0 0 0.2\nv 0.1 0 0\nv -0.05 0.087 0\nv -0.05 -0.087 0\nf 2 4 3\nf 1 2 3\nf 1 4 2\nf 1 3 4\n"


def robot_pixels(picture: np.ndarray) -> int:
    """Number of pixels of the robot: they are bluish, sand is yellow, and the sky is brighter."""
    red, green, blue = (picture[..., k].astype(int) for k in range(3))
    return int(((blue - red > 5) & (green < 190)).sum())


def pictured(**options: Any) -> np.ndarray:
    env = sandgait.SandgaitEnv(LEGGED, render_mode="rgb_array", domain_rand=None, angle_noise=0.0, **options)
    env.reset(seed=1)
    picture = env.render()
    env.close()
    assert isinstance(picture, np.ndarray)
    return picture


@pytest.mark.filterwarnings("ignore:.*left out")
def test_meshes_are_seen(tmp_path: Path) -> None:
    """In pictures and recordings; a robot whose visual mesh is broken is shown without it, with a warning."""
    (tmp_path / "leg.obj").write_text(PYRAMID)
    robot = tmp_path / "meshed.urdf"
    robot.write_text(MESHED.format(mesh="leg.obj"))
    env = sandgait.SandgaitEnv(LEGGED, robot=robot)
    env.record(tmp_path / "meshed.rec")
    env.reset(seed=1)
    env.close()
    shapes = sandgait.read_recording(tmp_path / "meshed.rec").header["shapes"]
    (leg,) = (s for s in shapes["shapes"] if s["body"] == 1)
    mesh = shapes["meshes"][leg["form"]["mesh"]]
    assert sorted(mesh["corners"]) == [[-0.05, -0.087, 0], [-0.05, 0.087, 0], [0, 0, 0.2], [0.1, 0, 0]]
    assert len(mesh["faces"]) == 4
    with_mesh = robot_pixels(pictured(robot=robot, ground="rigid"))
    (tmp_path / "leg.obj").write_text("v 0 0 0\n")
    with pytest.warns(UserWarning, match=r"leg\.obj.*without its visual meshes"):
        without = robot_pixels(pictured(robot=robot, ground="rigid"))
    assert without > 5000
    assert with_mesh > 1.2 * without


def test_a_robot_on_high_ground_is_seen_as_on_level_ground() -> None:
    level = robot_pixels(pictured(robot=SANDCAT, ground="rigid"))
    high = pictured(robot=SANDCAT, ground="rigid", relief={"heights": [[3.0] * 4] * 4, "spacing": 1.0})
    assert level > 2000
    assert robot_pixels(high) == pytest.approx(level, rel=0.05)


def grey_share(picture: np.ndarray) -> float:
    """Share of the pixels with the colour of hard ground; the robot is bluish, and sand is yellow."""
    red, green, blue = (picture[..., k].astype(int) for k in range(3))
    return float(((abs(red - blue) < 4) & (abs(red - green) < 4) & (red < 200)).mean())


def test_hard_ground_is_grey() -> None:
    sand, mixed, hard = (grey_share(pictured(robot=SANDCAT, ground=g)) for g in ("poppy-loose", "mixed", "rigid"))
    assert sand < 0.01
    assert 0.15 < mixed < 0.6
    assert hard > 0.75
    dunes = pictured(robot=SANDCAT, ground="mixed", relief={"seed": 3, "wavelength": 1.5, "slope_deg": 10})
    assert 0.03 < grey_share(dunes) < 0.6


def arrows(picture: np.ndarray) -> int:
    """Pixels in the red of arrows."""
    red, green, blue = (picture[..., k].astype(int) for k in range(3))
    return int(((red > 180) & (green < 60) & (blue < 90)).sum())


@pytest.mark.parametrize("ground", ["poppy-loose", "mixed", "dunes"])
def test_forces_on_a_robot_from_a_file_carry_it(tmp_path: Path, ground: str) -> None:
    options: dict[str, Any] = {"domain_rand": None, "angle_noise": 0.0, "render_mode": "rgb_array"}
    env = sandgait.SandgaitEnv(LEGGED, robot=SANDCAT, ground=ground, **options)
    env.record(tmp_path / "cat.rec")
    env.reset(seed=1)
    pictures = [env.render()]
    for _ in range(200):
        env.step(np.zeros(12, np.float32))
    pictures.append(env.render())
    env.close()
    cat = sandgait.read_recording(tmp_path / "cat.rec")
    names = [cat.header["bodies"][body]["name"] for body in cat.header["touching"]]
    assert cat["ground_forces"].shape == cat["ground_points"].shape == (201, len(names), 3)
    weight = cat.header["mass"] * 9.81
    assert cat["ground_forces"][-1].sum(axis=0) == pytest.approx([0, 0, weight], abs=0.03 * weight)
    for name, force, point in zip(names, cat["ground_forces"][-1], cat["ground_points"][-1], strict=True):
        if name.endswith("_calf"):
            assert force[2] > 0.1 * weight
            assert np.linalg.norm(point - cat["position"][-1]) < 0.4
        else:
            assert (force == 0).all()
    assert not cat["ground_forces"][0].any(), "it begins above the ground"
    assert [arrows(picture) > 100 for picture in pictures] == [False, True]
    slabs = {"center": [0, 0], "size": [0.8, 0.8], "every": [1.6, 1.6], "depth": 0, "grip": 1}
    assert cat.header.get("hard") == ([slabs] if ground == "mixed" else None)


def test_the_camera_stands_where_it_is_told(remote: RemoteServer) -> None:
    """From the left, forward is to the left; from further away the robot is smaller. Servers draw the same pictures."""
    size: dict[str, Any] = {"render_mode": "rgb_array", "render_size": (320, 240), "leg": "C"}

    def picture(steps: int = 0, **options: Any) -> np.ndarray:
        env = sandgait.SandgaitVectorEnv(ID, 2, **size, **options)
        env.reset(seed=1)
        for _ in range(steps):
            env.step(np.stack([ACTION, ACTION]))
        shown = env.render()
        env.close()
        assert shown is not None
        return shown[0]

    assert orange(picture()) > 160
    assert orange(picture(render_camera={"azimuth_deg": 60})) < 160
    views = [picture(render_camera={"distance": d})[40:] for d in (0.3, 0.6, 1.2)]  # without the caption
    dark = [np.mean(view.sum(axis=2) < 300) for view in views]
    assert dark[0] > 3 * dark[1] > 9 * dark[2] > 0
    fixed = {"azimuth_deg": -60, "elevation_deg": 25, "distance": 0.5, "follow": False}
    assert orange(picture(20, render_camera=fixed)) > orange(picture(render_camera=fixed)) + 20
    assert np.array_equal(picture(render_camera=fixed), picture(render_camera=fixed, address=remote.address))


@pytest.mark.parametrize(
    ("camera", "says"),
    [
        (
            {"azimuth": 3},
            'render_camera: "azimuth" is unknown; did you mean "azimuth_deg"? '
            "known: azimuth_deg, elevation_deg, distance, follow",
        ),
        ({"elevation_deg": 90}, "render_camera.elevation_deg: 90 is outside [1, 89]"),
        ({"distance": float("nan")}, "render_camera.distance: NaN is outside [0.01, 1000]"),
        ({"distance": "far"}, "render_camera: distance 'far' is not a number"),
        ({"follow": 1}, "render_camera: follow 1 is not True or False"),
        ("left", "render_camera: expected a dictionary of names or None, got 'left'"),
    ],
)
def test_a_wrong_camera_is_refused(camera: Any, says: str) -> None:
    with pytest.raises(sandgait.InvalidRequest) as raised:
        sandgait.SandgaitEnv(ID, render_mode="rgb_array", render_camera=camera)
    assert str(raised.value) == says
