"""A stub of a scoreboard entry: Newton's implicit MPM. It was never run here, because Newton was not installed.

    pip install newton sandgait        (a GPU makes it bearable)
    python examples/scoreboard_newton.py

What is written was read from Newton's example `mpm_twoway_coupling` (newton-physics/newton, commit 044c41c): the body
is a collider whose pose and velocity are set, and the wrench is the sum of the impulses that the solver puts on it.
Check every name against your version, and begin with one set: `sets=["drag"]`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

import sandgait
from sandgait.scoring import Body, MeasuredSand, Motion

#: A voxel [m] and a time step [s]: start values, smaller ones until the wrench no longer changes.
VOXEL, DT = 0.005, 0.002
#: Half length of the bed, and its depth [m]: three times the largest body, so that walls do not count.
BED, DEPTH = 0.25, 0.15


class NewtonSand:
    """Newton's SolverImplicitMPM with one collider."""

    def force(self, body: Body, motion: Motion, sand: MeasuredSand) -> np.ndarray:
        wrench = np.zeros((len(motion), 6))
        for run in motion.runs(DT):
            scene = Scene(body, sand)  # fresh sand
            for step in run:
                now = scene.move(step)
                wrench[step.samples] = now
        return wrench


class Scene:
    def __init__(self, body: Body, sand: MeasuredSand) -> None:
        import newton
        import warp as wp
        from newton.solvers import SolverImplicitMPM

        self.wp = wp
        rigid = newton.ModelBuilder()
        number = rigid.add_body(mass=1.0)
        for solid in body.solids:
            w, x, y, z = solid.quaternion  # Newton's quaternions have w last
            at, size = wp.transform(wp.vec3(*solid.position), wp.quat(x, y, z, w)), solid.sizes
            if solid.kind == "sphere":
                rigid.add_shape_sphere(number, xform=at, radius=size["radius"])
            elif solid.kind in ("box", "plate"):
                height = size.get("height", body.thickness)
                rigid.add_shape_box(number, xform=at, hx=size["length"] / 2, hy=size["width"] / 2, hz=height / 2)
            else:  # a cylinder along y has a width, one along z a height; Newton's stand along z
                if "width" in size:
                    at = at * wp.transform(wp.vec3(0.0), wp.quat_from_axis_angle(wp.vec3(1.0, 0.0, 0.0), np.pi / 2))
                half = size.get("width", size.get("height", 0.0)) / 2
                rigid.add_shape_cylinder(number, xform=at, radius=size["radius"], half_height=half)
        grains = newton.ModelBuilder()
        SolverImplicitMPM.register_custom_attributes(grains)
        cells = np.ceil(3 * np.array([2 * BED, 2 * BED, DEPTH]) / VOXEL).astype(int)
        cell = np.array([2 * BED, 2 * BED, DEPTH]) / cells
        grains.add_particle_grid(
            pos=wp.vec3(-BED, -BED, -DEPTH),
            rot=wp.quat_identity(),
            vel=wp.vec3(0.0),
            **dict(zip(("dim_x", "dim_y", "dim_z"), cells.tolist(), strict=True)),
            **dict(zip(("cell_x", "cell_y", "cell_z"), cell.tolist(), strict=True)),
            mass=float(cell.prod() * sand.bulk_density),
            jitter=float(cell.max()),
            radius_mean=float(cell.max() / 2),
            custom_attributes={"mpm:friction": 0.7},  # tan 35°: fit it to the push that gave sand.zeta
        )
        self.rigid, self.grains = rigid.finalize(), grains.finalize()
        options = SolverImplicitMPM.Config()
        options.voxel_size = VOXEL
        self.solver = SolverImplicitMPM(self.grains, options)
        self.solver.setup_collider(model=self.rigid)
        self.state, poses = self.grains.state(), self.rigid.state()
        for name in ("body_q", "body_qd", "body_f"):
            setattr(self.state, name, wp.empty_like(getattr(poses, name)))

    def move(self, step: Any) -> np.ndarray:
        """The wrench on the body after a step with a prescribed pose and velocity."""
        w, x, y, z = step.quaternion
        self.state.body_q.assign([[*step.position, x, y, z, w]])
        self.state.body_qd.assign([[*step.velocity, *step.angular_velocity]])
        self.solver.step(self.state, self.state, contacts=None, control=None, dt=DT)
        impulses, places, numbers = self.solver.collect_collider_impulses(self.state)
        mine = numbers.numpy() == 0
        force = impulses.numpy()[mine] / DT
        torque = np.cross(places.numpy()[mine] - step.position, force)
        return np.concatenate([force.sum(axis=0), torque.sum(axis=0)])


if __name__ == "__main__":
    print(sandgait.scoreboard({"newton": NewtonSand()}, sets=["drag", "plates"]))
