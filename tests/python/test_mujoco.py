"""Sand in MuJoCo models and in environments of gymnasium and dm_control."""

from __future__ import annotations

import subprocess
import sys
from contextlib import nullcontext
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gymnasium
import mujoco
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import sandgait
from sandgait.errors import InvalidRequest
from sandgait.mujoco import add_sand, sand_of
from sandgait.wrappers import OnSand

GRAVITY = 9.80665
#: Forward speeds of the reference hexapod in loose poppy seeds [m/s], converged at a time step of 1e-5 s, by leg and
#: stride frequency [Hz]. Two programs that share no code agree on them.
SPEEDS = {
    "L": {1: 0.1201, 2: 0.2870, 3: 0.4161, 5: 0.7139},
    "revL": {1: 0.0715, 2: 0.1308, 3: 0.2401, 5: 0.4387},
}


def hexapod(leg: str, dt: float) -> tuple[mujoco.MjModel, dict[str, Any]]:
    """The reference hexapod as an MJCF, and its surfaces in sand: strips on the legs, a face under the belly."""
    chord, bulge = 0.04, {"L": -1.0, "revL": 1.0}[leg]
    corners = np.array([[0, 0, 0], [bulge * chord / 2, 0, -chord / 2], [0, 0, -chord]])
    bodies: dict[str, Any] = {"base": ("face:length=0.15,width=0.06", (0, 0, -0.01), (0, 1, 0, 0))}
    legs, motors = "", ""
    for name, x, y in [
        (f"{side}{place}", x, y)
        for side, s in (("r", -1), ("l", 1))
        for place, x, y in (("f", 0.06, 0.04 * s), ("m", 0.0, 0.045 * s), ("b", -0.06, 0.04 * s))
    ]:
        strips, pieces = "", []
        for a, b in pairwise(corners):
            middle, along = (a + b) / 2, (b - a) / np.linalg.norm(b - a)
            pitch = np.arctan2(-along[2], along[0])
            length = float(np.linalg.norm(b - a))
            turn = (np.cos(pitch / 2), 0, np.sin(pitch / 2), 0)
            pieces.append((f"plate:length={length!r},width=0.01", middle, turn))
            strips += f"""<geom type="box" mass="0.001" size="{length / 2} 0.005 5e-5" contype="0" conaffinity="0"
                pos="{middle[0]} {middle[1]} {middle[2]}" quat="{np.cos(pitch / 2)} 0 {np.sin(pitch / 2)} 0"/>"""
        bodies[name] = pieces
        legs += (
            f'<body name="{name}" pos="{x} {y} 0"><joint name="{name}" axis="0 1 0" armature="2e-6"/>{strips}</body>'
        )
        motors += f'<general joint="{name}" biastype="affine" gainprm="1" biasprm="0 -1 -0.01"/>'
    text = f"""<mujoco><option timestep="{dt}" gravity="0 0 -{GRAVITY}" integrator="implicitfast"/>
        <worldbody><geom type="plane" size="1 1 1"/><body name="base"><freejoint/>
        <geom type="box" size="0.075 0.03 0.015" mass="0.138" contype="0" conaffinity="0"/>{legs}</body></worldbody>
        <actuator>{motors}</actuator></mujoco>"""
    return mujoco.MjModel.from_xml_string(text), bodies


def walk(leg: str, frequency: float, dt: float = 1e-3, **options: Any) -> float:
    """Speed of the hexapod [m/s] in the protocol of `sandgait walk`: hold 0.3 s, ramp 0.2 s, two strides, then four."""
    model, bodies = hexapod(leg, dt)
    sand = sandgait.Sand("poppy-loose", leading_edge_gate=0.2, **options)
    ground = add_sand(model, sand, bodies, plate_size=0.002)
    data = mujoco.MjData(model)
    phase = np.array([0.0, np.pi, 0.0, np.pi, 0.0, np.pi])
    data.qpos[7:] = phase
    data.qpos[2] = 0.04
    start = 0.5 + 2 / frequency
    end = start + 4 / frequency
    at: dict[float, Any] = {}
    for k in range(round(end / dt) + 1):
        time = k * dt
        for mark in (start, end):
            if mark not in at and time >= mark - dt / 2:
                at[mark] = data.qpos[:2].copy()
        ramped, turning = np.clip(time + dt - 0.3, 0, 0.2), max(time + dt - 0.5, 0.0)
        speed = 2 * np.pi * frequency
        data.ctrl[:] = phase + speed * (0.5 * ramped**2 / 0.2 + turning) + 0.01 * speed * ramped / 0.2
        ground.step(data)
    return float(np.sign((at[end] - at[start])[0]) * np.linalg.norm(at[end] - at[start]) / (end - start))


@pytest.mark.parametrize("leg", SPEEDS)
@pytest.mark.parametrize("frequency", [1, 2, 3, 5])
def test_the_reference_hexapod_walks_at_the_reference_speed(leg: str, frequency: int) -> None:
    speed = walk(leg, frequency)
    print(f"{leg} {frequency} Hz: {speed:.4f} m/s, {speed / SPEEDS[leg][frequency] - 1:+.2%}")
    assert speed == pytest.approx(SPEEDS[leg][frequency], rel=0.02)


QUADRUPED = """<mujoco><option timestep="0.002" gravity="0 0 -9.81"/>
    <default><joint armature="0.01" damping="0.5"/><position kp="60"/></default>
    <worldbody><geom name="floor" type="plane" size="9 9 1"/><body name="trunk" pos="0 0 0.33"><freejoint/>
    <geom type="box" size="0.2 0.08 0.05" mass="8"/>{legs}</body></worldbody><actuator>{motors}</actuator></mujoco>"""


def quadruped() -> mujoco.MjModel:
    legs, motors = "", ""
    for k, (x, y) in enumerate([(0.18, 0.1), (0.18, -0.1), (-0.18, 0.1), (-0.18, -0.1)]):
        legs += f"""<body name="thigh{k}" pos="{x} {y} 0"><joint name="hip{k}" axis="0 1 0" ref="0"/>
            <geom type="capsule" fromto="0 0 0 0 0 -0.15" size="0.02" mass="0.5"/>
            <body name="calf{k}" pos="0 0 -0.15"><joint name="knee{k}" axis="0 1 0"/>
            <geom type="capsule" fromto="0 0 0 0 0 -0.15" size="0.012" mass="0.2"/>
            <geom type="sphere" pos="0 0 -0.15" size="0.025" mass="0.05"/></body></body>"""
        motors += f'<position joint="hip{k}"/><position joint="knee{k}"/>'
    return mujoco.MjModel.from_xml_string(QUADRUPED.format(legs=legs, motors=motors))


@pytest.mark.parametrize("dt", [0.001, 0.002, 0.005])
@pytest.mark.parametrize("law", ["li2013", "agarwal2023"])
def test_a_robot_at_rest_stays_at_rest(law: str, dt: float) -> None:
    """It creeps by at most 0.1 mm in 10 s, and the sand then carries its weight."""
    model = quadruped()
    model.opt.timestep = dt
    ground = add_sand(model, sandgait.Sand("poppy-loose", law=law))
    data = mujoco.MjData(model)
    ground.step(data, nstep=round(3.0 / dt))
    before = data.qpos.copy()
    ground.step(data, nstep=round(10.0 / dt))
    creep = np.linalg.norm(data.qpos[:3] - before[:3])
    print(f"{law} {dt}: creep {creep * 1e3:.4f} mm, depth {0.325 - data.qpos[2]:.4f} m")
    assert creep <= 1e-4
    carried = ground.wrenches(data)[:, :3].sum(0)
    assert carried == pytest.approx([0, 0, 9.81 * model.body_mass.sum()], abs=1e-3 * 9.81 * model.body_mass.sum())


def energy(model: mujoco.MjModel, data: mujoco.MjData) -> float:
    """Of the bodies and springs alone, by a second MjData without sand's drag in M."""
    other = mujoco.MjData(model)
    other.qpos[:], other.qvel[:] = data.qpos, data.qvel
    mujoco.mj_kinematics(model, other)
    mujoco.mj_comPos(model, other)
    mujoco.mj_makeM(model, other)
    mujoco.mj_energyPos(model, other)
    momentum = np.empty(model.nv)
    mujoco.mj_mulM(model, other, momentum, other.qvel)
    return float(other.energy[0] + 0.5 * momentum @ other.qvel)


@pytest.mark.parametrize("seed", range(5))
def test_sand_creates_no_energy(seed: int) -> None:
    """A limp robot is thrown at the sand: in no step its energy grows more than by the error of free flight."""
    model = quadruped()
    model.actuator_gainprm[:] = model.actuator_biasprm[:] = 0.0
    model.dof_damping[:] = 0.0
    ground = add_sand(model, sandgait.Sand("poppy-loose", law="agarwal2023"))
    flight = quadruped()
    flight.actuator_gainprm[:] = flight.actuator_biasprm[:] = 0.0
    flight.dof_damping[:] = 0.0
    flight.geom_contype[0] = flight.geom_conaffinity[0] = 0
    random = np.random.default_rng(seed)
    data, free = mujoco.MjData(model), mujoco.MjData(flight)
    data.qpos[2] = 0.5
    data.qvel[:] = random.normal(size=model.nv) * ([1.0] * 3 + [3.0] * 3 + [3.0] * 8)
    first = energy(model, data)
    worst = 0.0
    for _ in range(1000):
        free.qpos[:], free.qvel[:] = data.qpos, data.qvel
        before = energy(model, data)
        ground.step(data)
        mujoco.mj_step(flight, free)
        gained, own = energy(model, data) - before, energy(flight, free) - before
        # What the sand adds beyond the integrator's own error in the same step without sand.
        worst = max(worst, gained - max(own, 0.0))
    speed = np.abs(data.qvel).max()
    print(f"seed {seed}: of {first:.2f} J at most {worst:.1e} J added in a step, {speed:.1e} at the end")
    assert worst <= 1e-4 * abs(first)
    assert not any(w.number for w in data.warning)


def test_a_ball_that_floats_alone_is_carried() -> None:
    """MuJoCo keeps only a diagonal inertia for such a body; see `JointSand::dominant`."""
    text = """<mujoco><option timestep="0.002"/><worldbody><geom type="plane" size="1 1 1"/>
        <body name="ball" pos="0 0 0.2"><freejoint/><geom type="sphere" size="0.05" density="900"/></body>
        </worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(text)
    ground = add_sand(model, sandgait.Sand())
    data = mujoco.MjData(model)
    data.qvel[:] = [0.5, 0, -1, 0, 20, 3]
    ground.step(data, nstep=2000)
    before = data.qpos.copy()
    ground.step(data, nstep=5000)
    assert np.linalg.norm(data.qpos - before) < 1e-4
    assert ground.wrenches(data)[0, 2] == pytest.approx(9.81 * model.body_mass[1], rel=1e-3)
    assert 0.0 < before[2] < 0.05


def test_the_same_force_as_the_sand_itself() -> None:
    """Without the drag's part, the wrench in a step is that of `Sand.wrench` at its beginning, for solids of several
    geoms, one of them in a welded body."""
    text = """<mujoco><option timestep="0.002"/><worldbody><geom type="plane" size="1 1 1"/>
        <body name="a" pos="0 0 0.03" euler="20 30 5"><freejoint/><geom type="box" size="0.1 0.05 0.03" pos="0.02 0 0"/>
        <body name="b" pos="0.1 0 0" euler="0 0 40"><geom type="capsule" size="0.02 0.05" euler="0 90 0"/>
        <body name="c" pos="0.1 0 0"><joint axis="0 1 0"/>
        <geom type="ellipsoid" size="0.05 0.03 0.02"/></body></body></body>
        </worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(text)
    sand = sandgait.Sand(law="agarwal2023")
    ground = add_sand(model, sand, plate_size=0.01)
    assert ground.names == ("a", "c")
    data = mujoco.MjData(model)
    data.qvel[:] = [0.3, -0.1, -0.5, 1.0, 2.0, -1.0, 3.0]
    ground.step(data)
    turn = np.empty(4)
    mujoco.mju_euler2Quat(turn, np.radians([0, 0, 40]), "xyz")
    lie = np.empty(4)
    mujoco.mju_euler2Quat(lie, np.radians([0, 90, 0]), "xyz")
    both = np.empty(4)
    mujoco.mju_mulQuat(both, turn, lie)
    bodies = sandgait.Bodies(
        {
            "a": [
                ("box:length=0.2,width=0.1,height=0.06", (0.02, 0, 0), (1, 0, 0, 0)),
                ("capsule:radius=0.02,height=0.1", (0.1, 0, 0), both),
            ],
            "c": "ellipsoid:length=0.1,width=0.06,height=0.04",
        },
        plate_size=0.01,
    )
    index = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name) for name in bodies.names]
    speed = np.empty((2, 6))
    jacobian = np.empty((6, model.nv))
    start = np.array([0.3, -0.1, -0.5, 1.0, 2.0, -1.0, 3.0])
    for k, body in enumerate(index):
        mujoco.mj_jacBody(model, data, jacobian[:3], jacobian[3:], body)
        speed[k] = jacobian @ start
    expected = sand.wrench(bodies, data.xpos[index], data.xquat[index], speed[:, :3], speed[:, 3:])
    data.qacc[:] = 0.0
    assert np.abs(ground.wrenches(data) - expected).max() <= 1e-6 * np.abs(expected).max()


@pytest.fixture(autouse=True)
def _logs_of_mujoco(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """MuJoCo writes its warnings to MUJOCO_LOG.TXT in the working directory."""
    monkeypatch.chdir(tmp_path)


IDS = ["Ant-v5", "HalfCheetah-v5", "Hopper-v5", "Walker2d-v5", "Humanoid-v5"]


def roll(id: str, seed: int, steps: int = 1000) -> Any:
    env = OnSand(gymnasium.make(id), medium="poppy-loose")
    env.action_space.seed(seed)
    rows = [env.reset(seed=seed)[0]]
    warned = 0
    for _ in range(steps):
        observation, reward, terminated, truncated, _ = env.step(env.action_space.sample())
        rows.append(np.append(observation, reward))
        warned += sum(int(w.number) for w in env.unwrapped.data.warning)
        if terminated or truncated:
            env.reset()
    env.close()
    return np.concatenate(rows), warned


@pytest.mark.parametrize("id", IDS)
def test_environments_of_gymnasium(id: str) -> None:
    rows, warned = roll(id, 1)
    assert np.isfinite(rows).all()
    assert warned == 0
    assert np.array_equal(rows, roll(id, 1)[0])
    assert not np.array_equal(rows, roll(id, 2)[0])


@pytest.mark.parametrize("id", IDS)
@pytest.mark.filterwarnings("ignore:.*different from the unwrapped version:UserWarning")
@pytest.mark.filterwarnings("ignore:.*A Box observation space m:UserWarning")
def test_gymnasium_checks_the_environments(id: str) -> None:
    env = OnSand(gymnasium.make(id, disable_env_checker=True).unwrapped)
    check_env(env, skip_render_check=True)
    env.close()


def test_feet_feel_the_sand() -> None:
    """The contact forces of the observation carry the robot, and the floor itself does not."""
    env = OnSand(gymnasium.make("Ant-v5"), medium="poppy-close")
    env.reset(seed=0)
    base: Any = env.unwrapped
    carried = []
    for _ in range(400):
        env.step(np.zeros(8))
        carried.append(base.data.cfrc_ext[:, 5].sum())
    assert base.data.ncon == 0
    assert np.mean(carried[200:]) == pytest.approx(9.81 * base.model.body_mass.sum(), rel=0.02)
    assert base.data.qpos[2] < 0.75
    env.close()


def test_removed_sand_leaves_the_model_as_it_was() -> None:
    plain, model = quadruped(), quadruped()
    model.opt.integrator = plain.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    ground = add_sand(model, sandgait.Sand())
    assert sand_of(model) is ground
    with pytest.raises(InvalidRequest, match="has sand already"):
        add_sand(model, sandgait.Sand())
    ground.remove()
    assert sand_of(model) is None
    one, other = mujoco.MjData(plain), mujoco.MjData(model)
    mujoco.mj_step(plain, one, nstep=500)
    mujoco.mj_step(model, other, nstep=500)
    assert np.array_equal(one.qpos, other.qpos)


def test_other_bodies_stay_on_the_floor() -> None:
    text = """<mujoco><worldbody><geom name="floor" type="plane" size="1 1 1"/>
        <body name="sunk" pos="0 0 0.1"><freejoint/><geom type="box" size="0.05 0.05 0.05" density="3000"/></body>
        <body name="held" pos="1 0 0.1"><freejoint/><geom type="box" size="0.05 0.05 0.05" density="3000"/></body>
        </worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(text)
    ground = add_sand(model, sandgait.Sand(), ["sunk"])
    data = mujoco.MjData(model)
    ground.step(data, nstep=2000)
    assert data.qpos[2] < 0.045
    assert data.qpos[9] == pytest.approx(0.05, abs=1e-3)


def test_a_press_may_be_repeated() -> None:
    """At one position M has the drag of one press only, and `forward` gives the accelerations of `step`."""
    model = quadruped()
    ground = add_sand(model, sandgait.Sand())
    data = mujoco.MjData(model)
    ground.step(data, nstep=300)
    ground.forward(data)
    once, expected = data.M.copy(), data.qacc.copy()
    data.qfrc_passive[:] = 0.0
    ground.press(data)
    assert np.array_equal(once, data.M)
    ground.step(data)
    assert np.array_equal(expected, data.qacc)


class DmPhysics:
    """The part of dm_control's Physics that `OnSand` uses: dm_control itself does not run with MuJoCo 4."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self.model, self.data = SimpleNamespace(ptr=model), SimpleNamespace(ptr=mujoco.MjData(model))
        mujoco.mj_step1(model, self.data.ptr)

    def check_invalid_state(self) -> Any:
        return nullcontext()


def test_an_environment_of_dm_control() -> None:
    """Its steps are those of `step`, and end with the new positions, as dm_control's."""
    env = SimpleNamespace(physics=DmPhysics(quadruped()))
    assert OnSand(env, medium="poppy-close") is env
    physics: Any = env.physics
    for _ in range(100):
        physics.step(5)
    model = quadruped()
    ground = add_sand(model, sandgait.Sand("poppy-close"))
    data = mujoco.MjData(model)
    ground.step(data, 500)
    assert np.array_equal(physics.data.ptr.qpos, data.qpos)
    mujoco.mj_kinematics(model, data)
    assert np.array_equal(physics.data.ptr.xpos, data.xpos)


@pytest.mark.parametrize(
    "options", [{}, {"slope_deg": 10.0}, {"relief": {"seed": 1, "wavelength": 2, "slope_deg": 10}}]
)
def test_surface_and_forces_are_drawn(options: dict[str, Any]) -> None:
    model = quadruped()
    ground = add_sand(model, sandgait.Sand(**options))
    data = mujoco.MjData(model)
    ground.step(data, nstep=500)
    scene = mujoco.MjvScene(model, maxgeom=2000)
    mujoco.mjv_updateScene(model, data, mujoco.MjvOption(), None, mujoco.MjvCamera(), 7, scene)
    before = scene.ngeom
    ground.draw(scene, data, forces=False)
    surface = scene.ngeom - before
    assert (surface == 0) == (not options)
    ground.draw(scene, data)
    arrows = [g for g in scene.geoms[before : scene.ngeom] if g.type == mujoco.mjtGeom.mjGEOM_ARROW]
    assert len(arrows) >= 3


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("model", sandgait.Sand()), "model: is str, not mujoco.MjModel"),
        ((None, "poppy-loose"), "sand: is str, not sandgait.Sand"),
        ((None, sandgait.Sand(), ["foot"]), "body: the model has none with the name 'foot'"),
        ((None, sandgait.Sand(), "trunk"), "bodies: expected a list of texts or a dictionary of names or None"),
        ((None, sandgait.Sand(), {"trunk": "cone:radius=1"}), "cone"),
        ((None, sandgait.Sand(leading_edge_gate=0.2)), "leading_edge_gate: other than 0.02 needs"),
    ],
)
def test_wrong_use(arguments: Any, message: str) -> None:
    model, *others = arguments
    with pytest.raises(InvalidRequest) as refused:
        add_sand(quadruped() if model is None else model, *others)
    assert message in str(refused.value)


def test_wrong_environments() -> None:
    with pytest.raises(InvalidRequest, match="no MuJoCo model"):
        OnSand(gymnasium.make("CartPole-v1"))
    with pytest.raises(InvalidRequest, match="no environment of gymnasium or dm_control"):
        OnSand(object())


def test_implicit_wrenches_carry_a_robot() -> None:
    """In a simulator that takes external forces alone, the robot stands, too, as high as with `add_sand`."""
    model, other = quadruped(), quadruped()
    sand = sandgait.Sand(law="agarwal2023")
    ground = add_sand(model, sand)
    data, free = mujoco.MjData(model), mujoco.MjData(other)
    other.geom_contype[0] = other.geom_conaffinity[0] = 0
    for m in (model, other):
        m.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
        m.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_EULERDAMP
    shapes = {"trunk": "box:length=0.4,width=0.16,height=0.1"}
    for k in range(4):
        shapes[f"thigh{k}"] = ("capsule:radius=0.02,height=0.15", (0, 0, -0.075), (1, 0, 0, 0))
        foot = ("sphere:radius=0.025", (0, 0, -0.15), (1, 0, 0, 0))
        shapes[f"calf{k}"] = [("capsule:radius=0.012,height=0.15", (0, 0, -0.075), (1, 0, 0, 0)), foot]
    bodies = sandgait.Bodies(shapes)
    index = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name) for name in bodies.names]
    assert ground.names == tuple(sorted(bodies.names, key=lambda n: index[bodies.names.index(n)]))
    jacobian, mass = np.empty((len(index), 6, model.nv)), np.empty((model.nv, model.nv))
    for _ in range(1500):
        ground.step(data)
        mujoco.mj_forward(other, free)
        for k, body in enumerate(index):
            mujoco.mj_jacBody(other, free, jacobian[k, :3], jacobian[k, 3:], body)
        mujoco.mj_fullM(other, free, mass)
        speed = jacobian @ free.qvel
        f, drag = sand.wrench(bodies, free.xpos[index], free.xquat[index], speed[:, :3], speed[:, 3:], drag=True)
        wrench = sandgait.implicit_wrench(f, drag, jacobian, mass, free.qfrc_smooth, 0.002)
        free.qfrc_applied[:] = np.einsum("bin,bi->n", jacobian, wrench)
        mujoco.mj_step(other, free)
        free.qfrc_applied[:] = 0.0
    assert free.qpos[2] == pytest.approx(data.qpos[2], abs=2e-3)
    assert wrench[:, 2].sum() == pytest.approx(9.81 * model.body_mass.sum(), rel=0.02)


@pytest.mark.parametrize("module", ["mujoco", "wrappers"])
def test_without_mujoco_an_error_says_how_to_install_it(module: str) -> None:
    program = f"import sys; sys.modules['mujoco'] = None; import sandgait.{module}"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    last = done.stderr.strip().splitlines()[-1]
    assert last == "ImportError: mujoco is not installed: pip install 'sandgait[mujoco]'"


BALL = '<body name="ball" pos="0 0 0.1"><freejoint/><geom type="sphere" size="0.05"/></body>'


def world(*parts: str) -> mujoco.MjModel:
    asset = '<asset><hfield name="hills" nrow="8" ncol="8" size="1 1 0.1 0.1"/></asset>'
    return mujoco.MjModel.from_xml_string(f"<mujoco>{asset}<worldbody>{''.join(parts)}</worldbody></mujoco>")


def test_mocap_bodies_are_not_on_sand() -> None:
    """Sand cannot push a body that a program moves."""
    hand = '<body name="hand" mocap="true" pos="1 0 0.1"><geom type="sphere" size="0.05"/></body>'
    model = world('<geom type="plane" size="1 1 1"/>', hand, BALL)
    assert add_sand(model, sandgait.Sand()).names == ("ball",)
    for bodies in (["hand"], {"hand": "sphere:radius=0.05"}):
        with pytest.raises(InvalidRequest, match="hand is a mocap body"):
            add_sand(world('<geom type="plane" size="1 1 1"/>', hand, BALL), sandgait.Sand(), bodies)


@pytest.mark.parametrize(
    ("floor", "options", "message"),
    [
        ('type="plane" size="1 1 1" pos="0 0 -0.325"', {}, r"'f' is at -0.325 m, the sand at 0 m; .*height=-0.325\)"),
        ('type="plane" size="1 1 1"', {"height": 0.1}, r"'f' is at 0 m, the sand at 0.1 m; give Sand\(height=0\)"),
        ('type="plane" size="1 1 1" euler="0 -20 0"', {}, r"'f' is inclined by 20°, .*give Sand\(slope_deg=20\)"),
        ('type="plane" size="1 1 1" euler="20 0 0"', {}, "'f' is inclined by 20°.*: turn the model"),
        ('type="hfield" hfield="hills"', {}, "'f' is a height field, the sand at 0 m; give Sand.relief="),
        ('type="plane" size="1 1 1" pos="0 0 -0.325"', {"height": -0.325}, None),
        ('type="plane" size="1 1 1" euler="0 -20 0"', {"slope_deg": 20.0}, None),
        ('type="plane" size="1 1 1" pos="0 0 1"', {"relief": {"seed": 1, "wavelength": 2, "slope_deg": 10}}, None),
    ],
)
def test_a_floor_that_is_not_where_the_sand_is(floor: str, options: dict[str, Any], message: str | None) -> None:
    model = world(f'<geom name="f" {floor}/>', BALL)
    with nullcontext() if message is None else pytest.warns(UserWarning, match=message):
        ground = add_sand(model, sandgait.Sand(**options))
    # A plane shows the sand's surface only where the surface is.
    assert (model.geom_rgba[0][3] > 0) == (options == {"height": -0.325})
    ground.remove()
