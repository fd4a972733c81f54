"""MuJoCo's own soft contact as an entry: a body pushed into a soft plane. Needs `sandgait[mujoco]`.

MuJoCo's inverse dynamics gives the contact force at each sample's pose and velocity without an acceleration. The
contact is a spring over its depth without damping, with dry friction. Its one number, the stiffness, is fitted to the
push that also gives the scale ζ of the laws: ζ · area over depth. MuJoCo does not know how large a body's area is.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import InvalidRequest
from .motion import Array, Motion
from .rows import Body, MeasuredSand, Solid

try:
    import mujoco
except ImportError as error:
    raise ImportError("mujoco is not installed: pip install 'sandgait[mujoco]'") from error

#: Impedance of the contact. It is constant, so the force is proportional to the depth; its value cancels in the fit.
_IMPEDANCE = 0.5
#: Damping of the friction [1/s] and `impratio`: our choice. In a prescribed motion MuJoCo adds the damping of
#: friction to the normal force. With these it adds 3 % of 9 N at 1 m/s and 0.3 % at 0.1 m/s. From 1 mm/s on friction is
#: dry.
_FRICTION_DAMPING, _IMPRATIO = 0.1, 1e4
#: Stiffness before the fit [1/s²], and the depth at which the fit compares forces [m]: our choice, because the force is
#: proportional to both, but for a disc's upper rim.
_FIRST, _AT = 1e4, 0.01
#: Least cosine between the normal of a face that is pushed and straight down.
_FLAT = 0.99
#: 1 N/cm³ in N/m³.
_PER_M3 = 1e6


class SoftContact:
    """MuJoCo's soft contact, with one stiffness for all bodies in a sand."""

    def force(self, body: Body, motion: Motion, sand: MeasuredSand) -> Array:
        model = _model(body, _stiffness(sand), sand.friction)
        return _wrenches(model, motion)


def _stiffness(sand: MeasuredSand) -> float:
    """The contact's stiffness at which the sand's own push has a pressure of ζ times its depth."""
    zero, level = np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0, 0.0]])
    plates = sand.push.plates()
    area = plates["area"][plates["normal"][:, 2] < -_FLAT].sum()
    at = Motion(np.zeros(1), np.array([[0.0, 0.0, -_AT - sand.push.lowest]]), level, zero, zero, True)
    felt = _wrenches(_model(sand.push, _FIRST, sand.friction), at)[0, 2]
    return float(_FIRST * sand.zeta * _PER_M3 * area * _AT / felt)


def _model(body: Body, stiffness: float, friction: float) -> Any:
    """A free body of 1 kg over a plane at z = 0."""
    spec = mujoco.MjSpec()
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = _IMPRATIO
    spec.option.disableflags = mujoco.mjtDisableBit.mjDSBL_GRAVITY
    spec.worldbody.add_geom(name="plane", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1, 1, 1], contype=0, conaffinity=0)
    moving = spec.worldbody.add_body(mass=1.0, inertia=[1.0, 1.0, 1.0], explicitinertial=True)
    moving.add_freejoint()
    for k, solid in enumerate(body.solids):
        kind, size, turn = _geom(body, solid)
        quaternion = _product(solid.quaternion, turn)
        moving.add_geom(
            name=f"solid{k}", type=kind, size=size, pos=solid.position, quat=quaternion, contype=0, conaffinity=0
        )
        spec.add_pair(
            geomname1="plane",
            geomname2=f"solid{k}",
            condim=3,
            friction=[friction, friction, 0, 0, 0],
            solref=[-stiffness, 0.0],
            solreffriction=[0.0, -_FRICTION_DAMPING],
            solimp=[_IMPEDANCE, _IMPEDANCE, 1e-3, 0.5, 2],
        )
    return spec.compile()


def _geom(body: Body, solid: Solid) -> tuple[Any, list[float], tuple[float, ...]]:
    """MuJoCo's shape, its sizes, and a turn into its frame, in which cylinders stand along z."""
    kinds, sizes, upright = mujoco.mjtGeom, solid.sizes, (1.0, 0.0, 0.0, 0.0)
    if solid.kind == "sphere":
        return kinds.mjGEOM_SPHERE, [sizes["radius"], 0, 0], upright
    if solid.kind == "cylinder":
        lying = "width" in sizes
        half = sizes["width" if lying else "height"] / 2
        return kinds.mjGEOM_CYLINDER, [sizes["radius"], half, 0], (0.5**0.5, 0.5**0.5, 0.0, 0.0) if lying else upright
    if solid.kind in ("box", "plate"):
        height = sizes.get("height", body.thickness)
        return kinds.mjGEOM_BOX, [sizes["length"] / 2, sizes["width"] / 2, height / 2], upright
    raise InvalidRequest(f"mujoco: a {solid.kind} of {body.name!r} is none of sphere, cylinder, box and plate")


def _product(first: tuple[float, ...], second: tuple[float, ...]) -> Array:
    result = np.zeros(4)
    mujoco.mju_mulQuat(result, np.array(first, float), np.array(second, float))
    return result


def _wrenches(model: Any, motion: Motion) -> Array:
    data = mujoco.MjData(model)
    wrench, axes = np.zeros((len(motion), 6)), motion.rotation
    for k in range(len(motion)):
        data.qpos[:] = [*motion.position[k], *motion.quaternion[k]]
        # MuJoCo's angular velocity of a free body is in the body's axes, and so is its torque.
        data.qvel[:] = [*motion.velocity[k], *(axes[k].T @ motion.angular_velocity[k])]
        data.qacc[:] = 0.0
        mujoco.mj_inverse(model, data)
        wrench[k] = [*data.qfrc_constraint[:3], *(axes[k] @ data.qfrc_constraint[3:])]
    return wrench
