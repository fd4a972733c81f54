"""One robot on one sand in two engines, ours (`tree`) and MuJoCo with `add_sand`: `make study-engines`.

A small quadruped trots for 0.8 s from the same state with the same targets of its joints. Both engines have errors
that fall with the time step, so their paths must come together. The table has the largest distance of the two bases,
over feet of three shapes, two force laws, and level, sloped and curved ground.
"""

from __future__ import annotations

import itertools
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
import numpy.typing as npt

import sandgait
from sandgait.mujoco import add_sand

Rows = npt.NDArray[np.float64]

MEDIUM = "poppy-close"
#: Shapes of a foot: a ball, a block, and a mesh of eight corners.
FEET = {
    "ball": 'type="sphere" size="0.02"',
    "box": 'type="box" size="0.02 0.015 0.01"',
    "mesh": 'type="mesh" mesh="foot"',
}
LAWS = ("li2013", "agarwal2023")
GROUNDS: dict[str, dict[str, Any]] = {
    "level": {},
    "slope of 10°": {"slope_deg": 10.0},
    "dunes": {"relief": {"seed": 1, "wavelength": 1.5, "slope_deg": 12.0}},
}
#: Time steps [s], which divide the control period.
STEPS = (2e-3, 1e-3, 5e-4, 2.5e-4)
PERIOD = 0.02
#: The servos [N·m/rad, N·m·s/rad, N·m], and the gait: control steps, amplitude [actions], strides [1/s]. Our choice.
STIFFNESS, DAMPING, LIMIT = 15.0, 0.4, 8.0
CONTROLS, AMPLITUDE, STRIDES = 40, 0.7, 2.0
LEGS = {"FL": (0.12, 0.07), "FR": (0.12, -0.07), "RL": (-0.12, 0.07), "RR": (-0.12, -0.07)}


class Case(NamedTuple):
    """What stands on what."""

    foot: str
    law: str
    ground: str

    @classmethod
    def all(cls) -> Iterator[Case]:
        return map(cls._make, itertools.product(FEET, LAWS, GROUNDS))


def robot(foot: str, floor: str = "") -> str:
    """The robot as an MJCF: 2.9 kg, with a hip and a knee in each leg."""
    legs = "".join(
        f"""<body name="{name}_thigh" pos="{x} {y} 0">
        <inertial pos="0 0 -0.05" mass="0.15" diaginertia="2e-4 2e-4 2e-5"/>
        <joint name="{name}_hip" axis="0 1 0" range="-1.5 1.5" damping="0.02" armature="0.002"/>
        <body name="{name}_foot" pos="0 0 -0.1"><inertial pos="0 0 -0.05" mass="0.08" diaginertia="1e-4 1e-4 1e-5"/>
        <joint name="{name}_knee" axis="0 1 0" range="-2 2" damping="0.02" armature="0.002"/>
        <geom {FEET[foot]} mass="0" pos="0 0 -0.1"/></body></body>"""
        for name, (x, y) in LEGS.items()
    )
    servos = "".join(
        f'<position joint="{name}_{joint}" kp="{STIFFNESS}" kv="{DAMPING}" forcerange="{-LIMIT} {LIMIT}"/>'
        for name, joint in itertools.product(LEGS, ("hip", "knee"))
    )
    corners = " ".join(
        f"{x * s} {y * s} {z}" for z, s in ((-0.01, 1.0), (0.02, 0.6)) for x in (-0.02, 0.02) for y in (-0.015, 0.015)
    )
    return f"""<mujoco><compiler angle="radian"/><asset><mesh name="foot" vertex="{corners}"/></asset><worldbody>{floor}
        <body name="base" pos="0 0 0.3"><freejoint/><inertial pos="0 0 0" mass="2" diaginertia="6e-3 1e-2 1.4e-2"/>
        <geom type="box" size="0.13 0.06 0.03" mass="0"/>{legs}</body></worldbody>
        <actuator>{servos}</actuator></mujoco>"""


def actions() -> npt.NDArray[np.float32]:
    """A trot: legs of a diagonal swing together."""
    time = np.arange(CONTROLS) * PERIOD
    phase = np.repeat([0.0, np.pi, np.pi, 0.0], 2)
    swing = np.sin(2.0 * np.pi * STRIDES * time[:, None] + phase)
    return np.asarray(AMPLITUDE * np.clip(time / 0.2, 0.0, 1.0)[:, None] * swing, np.float32)


def ours(case: Case, dt: float, folder: Path) -> sandgait.Recording:
    """The walk in LeggedVelocity."""
    file, recording = folder / "robot.xml", folder / "walk.rec"
    file.write_text(robot(case.foot))
    own = {"domain_rand": None, "curriculum": None, "angle_noise": 0.0, "self_contact": False}
    options = {"robot": str(file), "ground": MEDIUM, "law": case.law, "dt": dt, **own, **GROUNDS[case.ground]}
    env = sandgait.SandgaitEnv("sandgait/LeggedVelocity-v1", **options)
    env.reset(seed=0)
    env.record(recording)
    for action in actions():
        env.step(action)
    env.stop_recording()
    env.close()
    return sandgait.read_recording(recording)


def theirs(case: Case, dt: float, walk: Any) -> Rows:
    """Positions of the base in MuJoCo [m], from the first row of `walk` on with the targets of its other rows."""
    model = mujoco.MjModel.from_xml_string(robot(case.foot, '<geom name="floor" type="plane" size="9 9 1"/>'))
    model.opt.timestep = dt
    # The servos are computed below, with the targets of our engine.
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)
    # A slope is a tilt of gravity, as in our recordings.
    model.opt.gravity[:] = walk.header["gravity"]
    relief = GROUNDS[case.ground].get("relief")
    sand = add_sand(model, sandgait.Sand(MEDIUM, law=case.law, relief=relief), floor=["floor"])
    data = mujoco.MjData(model)
    joints = [model.joint(name) for name in walk.header["joints"]]
    places, dofs = [j.qposadr[0] for j in joints], [j.dofadr[0] for j in joints]
    data.qpos[:3], data.qpos[3:7], data.qpos[places] = (walk[n][0] for n in ("position", "orientation", "angles"))
    mujoco.mj_forward(model, data)
    turn = data.body("base").xmat.reshape(3, 3)
    data.qvel[:3], data.qvel[dofs] = walk["velocity"][0], walk["rates"][0]
    data.qvel[3:6] = turn.T @ walk["angular_velocity"][0]
    path = [data.qpos[:3].copy()]
    for targets in walk["references"][1:]:
        for _ in range(round(PERIOD / dt)):
            torque = STIFFNESS * (targets - data.qpos[places]) - DAMPING * data.qvel[dofs]
            data.qfrc_applied[dofs] = np.clip(torque, -LIMIT, LIMIT)
            sand.step(data)
        path.append(data.qpos[:3].copy())
    return np.array(path)


def distance(case: Case, dt: float, folder: Path) -> tuple[float, float]:
    """Largest distance of the bases in the two engines, and the length of the way in ours [mm]."""
    walk = ours(case, dt, folder).sections[0]
    own = np.asarray(walk["position"], np.float64)
    apart = np.linalg.norm(theirs(case, dt, walk) - own, axis=1).max()
    return 1e3 * float(apart), 1e3 * float(np.linalg.norm(own[-1] - own[0]))


def main() -> None:
    steps = " | ".join(f"{1e3 * dt:g} ms" for dt in STEPS)
    print(f"| foot | law | ground | way [mm] | {steps} |\n|{'---|' * (4 + len(STEPS))}")
    with tempfile.TemporaryDirectory() as folder:
        for case in Case.all():
            rows = [distance(case, dt, Path(folder)) for dt in STEPS]
            apart = " | ".join(f"{row[0]:.1f}" for row in rows)
            print(f"| {' | '.join(case)} | {rows[-1][1]:.0f} | {apart} |", flush=True)


if __name__ == "__main__":
    main()
