"""Sensors, delays and privileged values, in this process and on a server."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

import sandgait
from conftest import ID, RemoteServer

SENSORS = {
    "gyroscope": {"noise_density": 0.01, "bias": 0.1, "delay": 0.04},
    "joint_position": {"quantization": 0.01, "delay": 0.02},
    "accelerometer": {},
    "without": ["lin_vel"],
}
OPTIONS: dict[str, Any] = {"sensors": SENSORS, "history": 2, "privileged": True, "action_delay": [0.01, 0.05]}


def run(envs: Any, steps: int = 40) -> list[Any]:
    rows, infos = envs.reset(seed=3)
    found = [(rows, infos["privileged"])]
    shape = envs.action_space.shape
    for time in range(steps):
        actions = np.sin(np.arange(shape[-1]) + 0.3 * time).astype(np.float32)
        rows, _, _, _, infos = envs.step(np.broadcast_to(actions, shape))
        found.append((rows, infos["privileged"]))
    return found


def test_a_server_senses_the_same(remote: RemoteServer) -> None:
    local = sandgait.SandgaitVectorEnv(ID, 5, max_episode_steps=25, **OPTIONS)
    far = sandgait.SandgaitVectorEnv(ID, 5, max_episode_steps=25, address=remote.address, **OPTIONS)
    for (rows, exact), (other, also) in zip(run(local), run(far), strict=True):
        np.testing.assert_array_equal(rows, other)
        np.testing.assert_array_equal(exact, also)
    local.close()
    far.close()


def test_privileged_values_are_the_exact_observation() -> None:
    exact = sandgait.SandgaitVectorEnv(ID, 3)
    spoilt = sandgait.SandgaitVectorEnv(ID, 3, sensors={"gravity": {"noise_density": 0.1}}, privileged=True)
    space = spoilt.privileged_observation_space
    assert space is not None
    assert space.shape == exact.single_observation_space.shape
    assert exact.privileged_observation_space is None
    rows, _ = exact.reset(seed=3)
    for time, (seen, privileged) in enumerate(run(spoilt)):
        if time:
            actions = np.sin(np.arange(exact.single_action_space.shape[0]) + 0.3 * (time - 1)).astype(np.float32)
            rows = exact.step(np.broadcast_to(actions, exact.action_space.shape))[0]
        np.testing.assert_array_equal(privileged, rows)
        assert (seen[:, :3] != rows[:, :3]).any()
        np.testing.assert_array_equal(seen[:, 3:], rows[:, 3:])


def test_single_environments_follow_the_interface() -> None:
    env = gymnasium.make(f"sandgait/{ID}" if "/" not in ID else ID, **OPTIONS)
    check_env(env.unwrapped, skip_render_check=True)
    _, info = env.reset(seed=1)
    space = env.unwrapped.privileged_observation_space  # type: ignore[attr-defined]
    assert info["privileged"] in space
    for _ in range(3):
        info = env.step(env.action_space.sample())[4]
        assert info["privileged"] in space
    env.close()


def test_an_episode_that_ends_keeps_its_last_exact_values() -> None:
    envs = sandgait.SandgaitVectorEnv(
        ID, 2, max_episode_steps=5, privileged=True, autoreset_mode=AutoresetMode.SAME_STEP
    )
    envs.reset(seed=0)
    for _ in range(5):
        _, _, _, truncated, infos = envs.step(envs.action_space.sample())
    assert truncated.all()
    np.testing.assert_array_equal(infos["final_info"]["privileged"][0], infos["final_obs"][0])
    envs.close()


def test_the_first_observation_after_an_end_has_its_exact_values() -> None:
    for mode in AutoresetMode:
        envs = sandgait.SandgaitVectorEnv(ID, 3, max_episode_steps=4, privileged=True, autoreset_mode=mode)
        rows, infos = envs.reset(seed=0)
        for _ in range(10):
            np.testing.assert_array_equal(infos["privileged"], rows)
            rows, _, terminated, truncated, infos = envs.step(envs.action_space.sample())
            ended = terminated | truncated
            if mode is AutoresetMode.DISABLED and ended.any():
                np.testing.assert_array_equal(infos["privileged"], rows)
                rows, infos = envs.reset(options={"reset_mask": ended})
        envs.close()


def test_exact_values_do_not_change_the_episodes_of_a_single_environment() -> None:
    plain, told = gymnasium.make(ID, max_episode_steps=3), gymnasium.make(ID, max_episode_steps=3, privileged=True)
    (first, _), (second, info) = plain.reset(seed=5), told.reset(seed=5)
    for _ in range(3):
        np.testing.assert_array_equal(first, second)
        np.testing.assert_array_equal(info["privileged"], second)
        for _ in range(3):
            for env in (plain, told):
                env.step(np.zeros_like(env.action_space.sample()))
        (first, _), (second, info) = plain.reset(), told.reset()


HARDWARE = """source = "a test"
action_delay = { value = 0.02, interval = [0.0, 0.05] }

[actuator]
torque_limit = { value = 0.03, interval = [0.02, 0.04] }

[sensors.gyroscope]
delay = { value = 0.02, interval = [0.0, 0.05] }
"""


def test_a_hardware_file_is_an_option(remote: RemoteServer, tmp_path: Path) -> None:
    file = tmp_path / "hardware.toml"
    file.write_text(HARDWARE)
    said = {
        "action_delay": [0.02, 0.02],
        "actuator": {"torque_limit": 0.03},
        "sensors": {"gyroscope": {"delay": 0.02}},
    }
    kinds: list[dict[str, Any]] = [{"hardware": file}, said, {"domain_rand": {"hardware": str(file)}}]
    found = []
    for options in kinds:
        local = sandgait.SandgaitVectorEnv(ID, 3, privileged=True, **options)
        far = sandgait.SandgaitVectorEnv(ID, 3, privileged=True, address=remote.address, **options)
        here, there = (np.stack([row for row, _ in run(envs)]) for envs in (local, far))
        np.testing.assert_array_equal(here, there)
        found.append(here)
        local.close()
        far.close()
    np.testing.assert_array_equal(found[0], found[1])
    assert (found[2] != found[0]).any()
    with pytest.raises(sandgait.InvalidRequest, match=r"hardware: .*nowhere\.toml"):
        sandgait.SandgaitVectorEnv(ID, 1, hardware="nowhere.toml")
    file.write_text("[actuator]\npower = { value = 1.0, interval = [0.0, 2.0] }\n")
    with pytest.raises(sandgait.InvalidRequest, match=r"actuator\.power"):
        sandgait.SandgaitVectorEnv(ID, 1, hardware=file)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"sensors": "noisy"}, "sensors"),
        ({"sensors": {"gyroscope": {"delay": 9}}}, "sensors.gyroscope.delay: 9 is outside"),
        ({"actuator": {"stall_torque": -1}}, "actuator.stall_torque"),
        ({"history": 0}, "history"),
    ],
)
def test_wrong_options_are_named(options: dict[str, Any], said: str) -> None:
    with pytest.raises(sandgait.InvalidRequest, match=said):
        sandgait.SandgaitVectorEnv(ID, 1, **options)
