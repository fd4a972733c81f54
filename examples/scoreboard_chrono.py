"""A stub of a scoreboard entry: Chrono's SCM terrain. It was never run here, because PyChrono was not installed.

    conda install -c projectchrono pychrono; pip install sandgait
    python examples/scoreboard_chrono.py

What is written was read from the pages of Chrono's API (`SCMTerrain::SetSoilParameters`, `GetContactForceBody`). SCM
computes pressure and shear under a body from its sinkage; it has no forces on upright faces, so expect little drag on
an upright plate. Check every name against your version, and begin with one set: `sets=["wheels"]`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

import sandgait
from sandgait.scoring import Body, MeasuredSand, Motion

#: A cell of the terrain [m] and a time step [s]: start values, smaller ones until the wrench no longer changes.
CELL, DT = 0.002, 0.001


class ChronoSand:
    """SCM with Bekker's exponent 1, so that the pressure under a plate is ζ times its depth, as in the calibration."""

    def force(self, body: Body, motion: Motion, sand: MeasuredSand) -> np.ndarray:
        wrench = np.zeros((len(motion), 6))
        for run in motion.runs(DT, above=0.05):
            scene = Scene(body, sand)  # fresh sand
            for step in run:
                wrench[step.samples] = scene.move(step)
        return wrench


class Scene:
    def __init__(self, body: Body, sand: MeasuredSand) -> None:
        import pychrono as chrono
        import pychrono.vehicle as veh

        self.chrono = chrono
        self.system = chrono.ChSystemSMC()
        self.system.SetCollisionSystemType(chrono.ChCollisionSystem.Type_BULLET)
        material = chrono.ChContactMaterialSMC()
        self.body = chrono.ChBody()
        self.body.SetFixed(True)  # its pose is set in each step
        self.body.EnableCollision(True)
        for solid in body.solids:
            frame = chrono.ChFramed(chrono.ChVector3d(*solid.position), chrono.ChQuaterniond(*solid.quaternion))
            size = solid.sizes
            if solid.kind == "sphere":
                shape: Any = chrono.ChCollisionShapeSphere(material, size["radius"])
            elif solid.kind in ("box", "plate"):
                height = size.get("height", body.thickness)
                shape = chrono.ChCollisionShapeBox(material, size["length"], size["width"], height)
            else:  # a cylinder along y has a width, one along z a height; Chrono's stand along z
                if "width" in size:
                    frame = frame * chrono.ChFramed(chrono.ChVector3d(0, 0, 0), chrono.QuatFromAngleX(math.pi / 2))
                shape = chrono.ChCollisionShapeCylinder(material, size["radius"], size.get("width", size.get("height")))
            self.body.AddCollisionShape(shape, frame)
        self.system.AddBody(self.body)
        self.terrain = veh.SCMTerrain(self.system)
        self.terrain.SetSoilParameters(
            1e6 * sand.zeta,  # Bekker K_phi [Pa/m]: ζ in N/cm³
            0.0,  # Bekker K_c
            1.0,  # Bekker n
            0.0,  # cohesion [Pa]
            math.degrees(math.atan(sand.friction)),  # friction [°]
            0.01,  # Janosi shear [m]: the order of a few grains; fit it
            1e8,  # elastic stiffness [Pa/m], above K_phi
            3e4,  # damping [Pa·s/m]
        )
        self.terrain.Initialize(1.0, 0.5, CELL)

    def move(self, step: Any) -> np.ndarray:
        """The wrench on the body after a step with a prescribed pose and velocity."""
        chrono = self.chrono
        self.body.SetPos(chrono.ChVector3d(*step.position))
        self.body.SetRot(chrono.ChQuaterniond(*step.quaternion))
        self.body.SetPosDt(chrono.ChVector3d(*step.velocity))
        self.body.SetAngVelParent(chrono.ChVector3d(*step.angular_velocity))
        self.terrain.Synchronize(self.system.GetChTime())
        self.terrain.Advance(DT)
        self.system.DoStepDynamics(DT)
        force, torque = chrono.ChVector3d(), chrono.ChVector3d()
        self.terrain.GetContactForceBody(
            self.body, force, torque
        )  # torque about the centre of mass, which is the origin
        return np.array([force.x, force.y, force.z, torque.x, torque.y, torque.z])


if __name__ == "__main__":
    print(sandgait.scoreboard({"chrono": ChronoSand()}, sets=["wheels", "discs"]))
