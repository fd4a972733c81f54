"""Wrong input: the error names the mistake, nothing changes, and the session goes on."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

import sandgait
from conftest import ID, RemoteServer


def spoiled(index: tuple[int, int], value: float) -> np.ndarray:
    actions = np.zeros((4, 6), np.float32)
    actions[index] = value
    return actions


@pytest.mark.parametrize(
    ("actions", "says"),
    [
        (np.zeros((3, 6)), r"actions: shape \(3, 6\), expected \(4, 6\)"),
        (np.zeros((4, 5)), r"actions: shape \(4, 5\)"),
        (np.zeros(24), r"actions: shape \(24,\)"),
        (0.0, r"actions: shape \(\)"),
        (spoiled((2, 1), np.nan), r"actions\[2\]\[1\].*NaN.*\[-1, 1\]"),
        (spoiled((3, 5), 1.01), r"actions\[3\]\[5\].*1\.01.*\[-1, 1\]"),
        (spoiled((0, 0), -np.inf), r"actions\[0\]\[0\].*inf.*\[-1, 1\]"),
        ([["left"] * 6] * 4, "actions: expected numbers, got .*left"),
        (np.zeros((4, 6), np.complex64), "actions: expected numbers"),
    ],
)
def test_wrong_actions(actions: Any, says: str) -> None:
    """After a refused step, the next steps equal those of an undisturbed run."""
    env, calm = (gymnasium.make_vec(ID, num_envs=4, max_episode_steps=5) for _ in range(2))
    env.reset(seed=0)
    calm.reset(seed=0)
    for k in range(8):
        if k == 3:
            with pytest.raises(ValueError, match=says):
                env.step(actions)
        good = np.full((4, 6), 0.1 * k, np.float32)
        for a, b in zip(env.step(good)[:4], calm.step(good)[:4], strict=True):
            assert np.array_equal(a, b)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"lge": "C"}, "lge.*leg"),
        ({"leg": "Q"}, "Q"),
        ({"leg": 3}, "leg|invalid type"),
        ({"medium": "snow"}, "snow.*poppy-loose"),
        ({"slope_deg": 400}, r"slope_deg: 400 is outside \["),
        ({"slope_deg": float("nan")}, "slope_deg.*NaN"),
        ({"command": [0.1, 9.0]}, r"command\[1\]: 9 is outside"),
        ({"weights": {"glory": 1.0}}, "glory"),
        ({"max_episode_steps": 0}, "max_episode_steps: 0 is outside"),
        ({"leg": object()}, "leg: .*is not a number"),
        ({"render_mode": "ascii"}, "render_mode"),
        ({"num_envs": 0}, "num_envs: 0 is outside"),
        ({"num_envs": -1}, "num_envs: -1 is outside"),
        ({"address": "nowhere"}, "address: 'nowhere' is neither"),
        ({"address": ""}, "address: '' is neither"),
        ({"address": "http://127.0.0.1:50051"}, "address: 'http://127.0.0.1:50051' is neither"),
        ({"address": []}, "address: the list is empty"),
        ({"task": "sandgait/Flying-v0"}, "Flying-v0.*HexapodGait-v1"),
        ({"task": "Flying"}, "Flying.*HexapodGait-v1"),
    ],
)
def test_wrong_options(options: dict[str, Any], says: str) -> None:
    with pytest.raises(ValueError, match=says):
        sandgait.SandgaitVectorEnv(**{"task": ID, "num_envs": 2, **options})


def test_render_mode_of_a_single_environment() -> None:
    with pytest.raises(ValueError, match="render_mode"):
        sandgait.SandgaitEnv(ID, render_mode="ascii")


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"seed": [1, 2, 3]}, "seed: 3 entries for 2"),
        ({"seed": -3}, r"seed: -3 is outside \[0, "),
        ({"seed": [1, -2]}, r"seed\[1\]: -2 is outside"),
        ({"seed": [1, 2**64]}, r"seed\[1\]: 18446744073709551616 is outside"),
        ({"options": {"slpoe_deg": 3}}, "slpoe_deg.*slope_deg"),
        ({"options": {"slope_deg": "steep"}}, "steep"),
        ({"options": {"engine": "lanes"}}, "engine"),
    ],
)
def test_wrong_resets(arguments: dict[str, Any], says: str) -> None:
    env = gymnasium.make_vec(ID, num_envs=2)
    rows, _ = env.reset(seed=0)
    with pytest.raises(ValueError, match=says):
        env.reset(**arguments)
    assert np.array_equal(env.reset(seed=0)[0], rows)


def vector(num_envs: int = 2, **options: Any) -> sandgait.SandgaitVectorEnv:
    env = sandgait.SandgaitVectorEnv(ID, num_envs, **options)
    env.reset(seed=0)
    return env


def single(**options: Any) -> sandgait.SandgaitEnv:
    env = sandgait.SandgaitEnv(ID, **options)
    env.reset(seed=0)
    return env


#: Calls with an argument of a wrong type, and the whole message.
WRONG_TYPES: list[tuple[Callable[[], Any], str]] = [
    (lambda: sandgait.train(timesteps=5e3), "timesteps: expected a whole number or None, got 5000.0"),
    (lambda: sandgait.train(seconds="a"), "seconds: expected a number or None, got 'a'"),
    (lambda: sandgait.train(settings=5), "settings: expected a dictionary of names or None, got 5"),
    (lambda: sandgait.train(resume="x"), "resume: expected True or False, got 'x'"),
    (lambda: sandgait.intrude("L", chord="a"), "chord: expected a number or None, got 'a'"),
    (
        lambda: sandgait.intrude(body="sphere:radius=0.1", rows=5),
        "rows: expected a text or a path or a dictionary of names or None, got 5",
    ),
    (lambda: sandgait.walk("a"), "frequency: expected numbers, got 'a'"),
    (lambda: sandgait.evaluate(5), "policy: expected a text or a path or bytes, got 5"),
    (lambda: sandgait.evaluate("tripod:2", slopes=["a"]), "slopes: expected numbers, got ['a']"),
    (lambda: sandgait.mirror(5), "task: expected a text, got 5"),
    (lambda: sandgait.describe(5), "address: expected a text or None, got 5"),
    (lambda: sandgait.Bodies(5), "bodies: expected a dictionary of names, got 5"),
    (lambda: sandgait.Sand().wrench(5, *[np.zeros((1, 3))] * 4), "bodies: expected sandgait.Bodies, got 5"),
    (lambda: sandgait.Sand(slope_deg="a"), "slope_deg: expected a number, got 'a'"),
    (lambda: sandgait.Remote("127.0.0.1:1", token=5), "token: expected a text or None, got 5"),
    (lambda: gymnasium.make_vec(ID, num_envs="a"), "num_envs: expected a whole number, got 'a'"),
    (lambda: vector(render_size=640), "render_size: expected (a whole number, a whole number), got 640"),
    (lambda: vector(render_size=(64.5, 64)), "render_size: expected (a whole number, a whole number), got (64.5, 64)"),
    (lambda: vector(address=5), "address: expected a text or a list of texts or None, got 5"),
    (lambda: vector(clip_actions="yes"), "clip_actions: expected True or False, got 'yes'"),
    (lambda: single(clip_actions="yes"), "clip_actions: expected True or False, got 'yes'"),
    (lambda: vector(isolated="x"), "isolated: expected True or False, got 'x'"),
    (lambda: vector(resume=1), "resume: expected True or False, got 1"),
    (lambda: vector().reset(options=5), "options: expected a dictionary of names or None, got 5"),
    (lambda: vector().reset(options="abc"), "options: expected a dictionary of names or None, got 'abc'"),
    (lambda: single().reset(options={1: 2}), "options: expected a dictionary of names or None, got {1: 2}"),
    (
        lambda: vector(4).reset(seed="a"),
        "seed: expected a whole number or a list of whole numbers or None, got 'a'",
    ),
    (lambda: single().step(["a"]), "action: expected numbers, got ['a']"),
    (lambda: single().step(np.array([1j])), "action: expected numbers, got array([0.+1.j])"),
    (lambda: vector().rollout("a"), "actions: expected numbers, got 'a'"),
    (lambda: vector().rollout_policy(b"", "a"), "steps: expected a whole number, got 'a'"),
    (lambda: vector().restore(5), "snapshot: expected bytes or a text or a path, got 5"),
    (lambda: vector().fork("a"), "n: expected a whole number, got 'a'"),
]


@pytest.mark.parametrize(("call", "says"), WRONG_TYPES, ids=[says.split(":")[0] for _, says in WRONG_TYPES])
def test_an_argument_of_a_wrong_type(call: Callable[[], Any], says: str) -> None:
    """It is refused before anything is made. The error is what Python raises for wrong types and values, too."""
    with pytest.raises(sandgait.WrongType, match=f"^{re.escape(says)}$") as raised:
        call()
    assert isinstance(raised.value, sandgait.InvalidRequest)
    assert isinstance(raised.value, TypeError)
    assert isinstance(raised.value, ValueError)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: sandgait.train(seed=-1, timesteps=1), "seed: expected a whole number from 0, got -1"),
        (lambda: sandgait.evaluate("tripod:2", seeds=-1), r"seeds: -1 is outside \[2, 100000\]"),
        (lambda: sandgait.evaluate("tripod:2", seeds=2**40), r"seeds: 1099511627776 is outside \[2, 100000\]"),
    ],
)
def test_a_number_that_the_native_module_cannot_convert(call: Callable[[], Any], says: str) -> None:
    with pytest.raises(sandgait.InvalidRequest, match=f"^{says}$"):
        call()


def test_numbers_of_numpy_and_lists_are_accepted() -> None:
    env = vector(np.int64(2), render_size=[np.int32(64), 48], clip_actions=np.True_, render_mode="rgb_array")
    env.reset(seed=np.array([4, 5]), options={"slope_deg": np.float32(3)})
    assert env.render()[0].shape == (48, 64, 3)
    assert sandgait.intrude("L", chord=np.float32(0.08)).Fz.size


def test_an_error_of_the_users_function_stays_as_it_is() -> None:
    def told(share: float, stage: str) -> None:
        raise TypeError("mine")

    with pytest.raises(TypeError, match=r"^mine$"):
        sandgait.walk(2.0, progress=told)


def test_too_many_pixels() -> None:
    env = vector(64, render_mode="rgb_array", render_size=(4096, 4096))
    with pytest.raises(sandgait.InvalidRequest, match=r"^render_size: 64 pictures of 4096 × 4096"):
        env.render()


def test_a_step_before_the_first_reset() -> None:
    env = sandgait.SandgaitVectorEnv(ID, 2)
    with pytest.raises(sandgait.OutOfOrder, match="reset"):
        env.step(np.zeros((2, 6)))
    env.reset(options={"reset_mask": np.array([True, False])})
    with pytest.raises(sandgait.OutOfOrder, match="environment 1"):
        env.step(np.zeros((2, 6)))
    env.reset(options={"reset_mask": np.array([False, True])})
    env.step(np.zeros((2, 6)))


def test_an_oversized_batch() -> None:
    with pytest.raises(sandgait.LimitReached, match="num_envs"):
        sandgait.SandgaitVectorEnv(ID, 2**32 - 1)


def test_a_closed_environment() -> None:
    env = sandgait.SandgaitVectorEnv(ID, 2)
    env.reset()
    env.close()
    with pytest.raises(sandgait.SandgaitError, match="closed"):
        env.step(np.zeros((2, 6)))
    with pytest.raises(sandgait.SandgaitError, match="closed"):
        env.reset()


def test_one_clients_mistakes_do_not_reach_another() -> None:
    """Two sessions make steps in turns; one of them sends a wrong action each time."""
    good, bad, alone = (sandgait.SandgaitVectorEnv(ID, 3) for _ in range(3))
    for env in (good, bad, alone):
        env.reset(seed=1)
    for k in range(10):
        actions = np.full((3, 6), 0.1 * k)
        with pytest.raises(sandgait.InvalidRequest):
            bad.step(actions + 5)
        assert np.array_equal(good.step(actions)[0], alone.step(actions)[0])


def test_sand_is_a_file_of_the_client(tmp_path: Path) -> None:
    names = ("a00", "a10", "b11", "b01", "bm11", "c11", "c01", "cm11", "d10")
    numbers = dict(zip(names, (51e3, 47e3, 53e3, 83e3, 20e3, -26e3, 57e3, 0.0, 25e3), strict=True))
    head = 'name = "x"\nlaw = "li2013"\nbulk_density = 638.0\nsource = "test"\n[coefficients]\n'
    text = head + "".join(f"{name} = {value}\n" for name, value in numbers.items())
    speeds = []
    for drag in (0.0, 4.0):
        file = tmp_path / f"{drag}.toml"
        file.write_text(f"{text}[mechanisms]\ninertial_drag = {drag}\n")
        env = sandgait.SandgaitVectorEnv("sandgait/HexapodGait-v1", 1, sand=str(file), angle_noise=0.0)
        env.reset(seed=0)
        for _ in range(100):
            infos = env.step(np.full((1, 6), 0.8, np.float32))[4]
        speeds.append(float(infos["speed"][0]))
        env.close()
    assert speeds[0] != speeds[1]
    with pytest.raises(ValueError, match="sand"):
        sandgait.SandgaitVectorEnv("sandgait/HexapodGait-v1", 1, sand=str(tmp_path / "nowhere.toml"))
    file = tmp_path / "unfelt.toml"
    file.write_text(f"{text}[mechanisms]\nadded_mass = 1.0\n")
    with pytest.warns(UserWarning, match="added_mass has no effect on a walking robot"):
        sandgait.SandgaitVectorEnv("sandgait/HexapodGait-v1", 1, sand=str(file)).close()


def test_an_unknown_keyword_is_a_type_error_in_pythons_words(remote: RemoteServer) -> None:
    """Libraries such as TorchRL try a keyword, and leave it out after this error."""
    for door in ({}, {"address": remote.address}):
        for make in (gymnasium.make, gymnasium.make_vec):
            with pytest.raises(
                TypeError, match=r"^unexpected keyword argument 'frameskip'; the task's options: "
            ) as raised:
                make(ID, frameskip=1, **door)
            assert isinstance(raised.value, sandgait.UnknownOption)
            assert isinstance(raised.value, sandgait.InvalidRequest)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"slope_deg": "steep"}, 'slope_deg: text "steep", expected a number'),
        ({"slope_deg": 1e308}, "slope_deg: 1e308 is outside [-35, 35]"),
        ({"max_episode_steps": -1}, "max_episode_steps: number `-1`, expected a whole number from 0"),
    ],
)
def test_messages_are_for_people(options: dict[str, Any], says: str) -> None:
    with pytest.raises(sandgait.InvalidRequest) as raised:
        sandgait.SandgaitEnv(ID, **options)
    assert says in str(raised.value)
    assert len(str(raised.value)) < 120


def test_the_range_of_num_envs() -> None:
    for number, kind in ((0, sandgait.InvalidRequest), (65_537, sandgait.LimitReached)):
        with pytest.raises(kind, match=rf"^num_envs: {number} is outside \[1, 65536\]$"):
            sandgait.SandgaitVectorEnv(ID, number)


def test_a_robot_that_cannot_be_read() -> None:
    with pytest.raises(sandgait.InvalidRequest, match=r"no_such_robot\.urdf"):
        gymnasium.make("sandgait/LeggedVelocity-v1", robot="no_such_robot.urdf")


def test_the_version() -> None:
    assert sandgait.__version__ == sandgait.describe()[0]


def test_a_warning_of_a_kind_is_one_at_the_users_line(tmp_path: Path) -> None:
    """A robot whose links all have doubtful inertias gives one warning, at the line that makes the environment."""
    robot = tmp_path / "robot.urdf"
    text = (Path(__file__).parents[2] / "robots" / "sandcat.urdf").read_text()

    def doubtful(tensor: re.Match[str]) -> str:
        """One moment a little above the sum of the others, so that the size stays plausible."""
        values = {name: float(value) for name, value in re.findall(r'(i[xyz]{2})="([^"]*)"', tensor[0])}
        return re.sub(r'izz="[^"]*"', f'izz="{1.1 * (values["ixx"] + values["iyy"])}"', tensor[0])

    robot.write_text(re.sub(r"<inertia [^>]*>", doubtful, text))
    with warnings.catch_warnings(record=True) as shown:
        warnings.simplefilter("always")
        gymnasium.make_vec("sandgait/LeggedVelocity-v1", num_envs=1, robot=robot).close()
    assert len(shown) == 1, [str(w.message) for w in shown]
    assert Path(shown[0].filename) == Path(__file__)
    said = str(shown[0].message)
    # Of a calf and its foot, which are one body, the sum is an inertia that a body can have.
    assert re.fullmatch(
        r"9 bodies: their inertias are replaced by that of a box .* keeps what the file says; "
        r"links FL_calf, .* and 4 more: no body has such an inertia .*; it is used as it is",
        said,
    )


@pytest.mark.parametrize("name", ["hardware", "sand", "robot", "leg"])
def test_a_message_repeats_a_bounded_part(name: str) -> None:
    """The text of a whole file may be given in place of its path or of a name."""
    with pytest.raises(sandgait.InvalidRequest) as refused:
        gymnasium.make(ID, **{name: "action_delay = 1 " * 10_000})
    assert len(str(refused.value)) < 5000, name
