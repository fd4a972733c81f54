"""A stub of a scoreboard entry: Genesis' MPM sand. It was never run here, because Genesis was not installed.

    pip install genesis-world sandgait        (a GPU makes it bearable)
    python examples/scoreboard_genesis.py

What is written was read from Genesis' example `coupling/sand_wheel.py` and its pages. Genesis gives no force of its
grains on a rigid body. So the body is heavy, its velocity is set before each step, and the force is its mass times the
velocity that the step has taken from it, without its weight. Torque is not read: it is not scored. Check every name
against your version, and begin with one set: `sets=["drag"]`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

import sandgait
from sandgait.scoring import Body, MeasuredSand, Motion

#: Time step [s], cells in a metre, and the density of the body [kg/m³]: start values. The body must be so heavy that a
#: step changes its velocity by less than a percent, and so light that single precision still sees the change.
DT, CELLS, HEAVY = 1e-3, 128, 2e5
#: Half length of the bed, and its depth [m]: three times the largest body, so that walls do not count.
BED, DEPTH = 0.25, 0.15
GRAVITY = 9.81


class GenesisSand:
    """Genesis' MPM sand with one rigid body."""

    def __init__(self) -> None:
        import genesis

        self.gs = genesis
        genesis.init(precision="32")

    def force(self, body: Body, motion: Motion, sand: MeasuredSand) -> np.ndarray:
        wrench = np.zeros((len(motion), 6))
        for run in motion.runs(DT):
            scene = Scene(self.gs, body, sand)  # fresh sand
            for step in run:
                wrench[step.samples, :3] = scene.move(step)
        return wrench


class Scene:
    def __init__(self, gs: Any, body: Body, sand: MeasuredSand) -> None:
        self.scene = gs.Scene(
            sim_options=gs.options.SimOptions(dt=DT, substeps=10, gravity=(0.0, 0.0, -GRAVITY)),
            mpm_options=gs.options.MPMOptions(
                lower_bound=(-BED, -BED, -DEPTH), upper_bound=(BED, BED, 2 * DEPTH), grid_density=CELLS
            ),
            show_viewer=False,
        )
        if len(body.solids) > 1:
            raise NotImplementedError("write the parts of this body into one URDF or mesh")
        solid, rigid = body.solids[0], gs.materials.Rigid(rho=HEAVY, needs_coup=True, coup_friction=sand.friction)
        size, above, turn = solid.sizes, (0.0, 0.0, DEPTH), (1.0, 0.0, 0.0, 0.0)
        if solid.kind == "sphere":
            morph = gs.morphs.Sphere(radius=size["radius"], pos=above)
        elif solid.kind in ("box", "plate"):
            morph = gs.morphs.Box(size=(size["length"], size["width"], size.get("height", body.thickness)), pos=above)
        else:  # a cylinder along y has a width, one along z a height; Genesis' stand along z
            if "width" in size:
                turn = (0.5**0.5, 0.5**0.5, 0.0, 0.0)
            morph = gs.morphs.Cylinder(radius=size["radius"], height=size.get("width", size.get("height")), pos=above)
        self.turn = np.array(turn)
        self.body = self.scene.add_entity(morph=morph, material=rigid)
        self.scene.add_entity(
            morph=gs.morphs.Box(pos=(0.0, 0.0, -DEPTH / 2), size=(2 * BED, 2 * BED, DEPTH)),
            # The friction angle is a start value: fit it to the push that gave sand.zeta.
            material=gs.materials.MPM.Sand(rho=sand.bulk_density, friction_angle=35.0),
        )
        self.scene.build()

    def move(self, step: Any) -> np.ndarray:
        """The force on the body after a step with a prescribed pose and velocity."""
        self.body.set_pos(step.position - DT * step.velocity)
        self.body.set_quat(quaternion_product(step.quaternion, self.turn))
        before = np.concatenate([step.velocity, step.angular_velocity])
        self.body.set_dofs_velocity(before)
        self.scene.step()
        after = np.asarray(self.body.get_dofs_velocity().cpu(), dtype=np.float64)
        lost = self.body.get_mass() * (after[:3] - before[:3]) / DT
        return np.asarray([lost[0], lost[1], lost[2] + GRAVITY * self.body.get_mass()])


def quaternion_product(first: Any, second: Any) -> np.ndarray:
    """The rotation `second`, then `first`; w, x, y, z."""
    (a, u), (b, v) = (first[0], np.array(first[1:])), (second[0], np.array(second[1:]))
    return np.concatenate([[a * b - u @ v], a * v + b * u + np.cross(u, v)])


if __name__ == "__main__":
    print(sandgait.scoreboard({"genesis": GenesisSand()}, sets=["drag", "plates"]))
