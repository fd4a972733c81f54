"""A foot of 1 kg falls on sand in Drake and stays. Drake gets the sand's force at the end of each step
(`sandgait.implicit_wrench`), so the step can be 2 ms long. Needs the package `drake`; docs/wrench.md has the arrays.
"""

from __future__ import annotations

import numpy as np
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ExternallyAppliedSpatialForce, MultibodyPlant
from pydrake.multibody.tree import JacobianWrtVariable, SpatialInertia
from pydrake.systems.analysis import Simulator

import sandgait

dt = 2e-3
plant = MultibodyPlant(dt)
foot = plant.AddRigidBody("foot", SpatialInertia.SolidSphereWithMass(1.0, 0.03))
plant.Finalize()
simulator = Simulator(plant)
context = simulator.get_mutable_context()
plant.SetFreeBodyPose(context, foot, RigidTransform([0, 0, 0.1]))
sand, bodies = sandgait.Sand("poppy-loose"), sandgait.Bodies({"foot": "sphere:radius=0.03"})
world, port = plant.world_frame(), plant.get_applied_spatial_force_input_port()
push = ExternallyAppliedSpatialForce()
push.body_index = foot.index()
for k in range(1000):
    pose = plant.EvalBodyPoseInWorld(context, foot)
    moves = plant.EvalBodySpatialVelocityInWorld(context, foot)
    state = [pose.translation(), pose.rotation().ToQuaternion().wxyz(), moves.translational(), moves.rotational()]
    f, drag = sand.wrench(bodies, *(np.array(x)[None] for x in state), drag=True)
    velocities = JacobianWrtVariable.kV
    j = plant.CalcJacobianSpatialVelocity(context, velocities, foot.body_frame(), [0, 0, 0], world, world)
    force = plant.CalcGravityGeneralizedForces(context) - plant.CalcBiasTerm(context)
    w = sandgait.implicit_wrench(
        f, drag, np.concatenate([j[3:], j[:3]])[None], plant.CalcMassMatrix(context), force, dt
    )
    push.F_Bq_W = SpatialForce(tau=w[0, 3:], f=w[0, :3])
    port.FixValue(context, Value[list[ExternallyAppliedSpatialForce]]([push]))
    simulator.AdvanceTo((k + 1) * dt)
if abs(w[0, 2] - 9.81) > 0.01:
    raise SystemExit(f"the sand carries {w[0, 2]:.2f} N of 9.81 N")
print(f"the sand carries {w[0, 2]:.2f} N")
