"""A robot in MuJoCo as the program of a real robot sees it: sensors with noise, motors with limits, and delays.

A `Plant` is the independent engine of `sandgait certify`, and the robot of `examples/deploy_*.py`. It knows nothing of
policies: it gives readings by name, and takes targets with gains. Needs `sandgait[mujoco]`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from .errors import InvalidRequest
from .grounds import make_sand
from .mujoco import ModelSand, add_sand
from .user_warnings import warn

try:
    import mujoco
except ImportError as error:
    raise ImportError("mujoco is not installed: pip install 'sandgait[mujoco]'") from error

Array = npt.NDArray[np.float64]

#: Time step [s]: our choice, the period of a usual motor controller.
TIME_STEP = 1e-3

#: Largest errors of readings at noise 1, uniformly distributed: those of legged_gym (Rudin et al. 2022,
#: `legged_robot_config.py`, `noise_scales`), which are wider than most sensors'.
NOISE = {"joint_position": 0.01, "joint_velocity": 1.5, "lin_vel": 0.1, "gyroscope": 0.2, "gravity": 0.05}

#: Name of the plane that is added below a robot without one.
_FLOOR = "sandgait floor"

_SHAPES = mujoco.mjtGeom

#: Inertia of a body that has none [kg·m²]: our choice, that of a ball of 10 g and 16 mm.
_LEAST = 1e-6


@dataclass(frozen=True)
class Conditions:
    """What a robot and its ground are like."""

    #: "rigid", a medium's name, or the text of a sand.toml.
    ground: str = "rigid"
    #: The force law of a medium that is named.
    law: str = "li2013"
    #: Factor on the sand's stress.
    sand_strength: float = 1.0
    slope_deg: float = 0.0
    #: Mass added at the base's centre of mass, as a part of the robot's mass.
    payload: float = 0.0
    #: Factor on the motors' torques and their limits.
    motor_strength: float = 1.0
    #: Time from a reading to the motors' following its target [s].
    latency: float = 0.0
    #: Factor on `NOISE`.
    noise: float = 0.0
    #: Factor on the friction of hard ground.
    friction: float = 1.0


@dataclass(frozen=True)
class Motors:
    """Limits of the driven joints' torques [N·m] and lines of the motors [N·m, rad/s]; infinite if not known."""

    torque_limit: Array
    stall_torque: Array
    no_load_speed: Array


class Plant:
    """The robot of the MJCF or URDF `file`. `joints`: names of the driven joints, in the order of targets;
    `all_joints`: those of readings."""

    def __init__(
        self,
        file: str | Path,
        joints: tuple[str, ...],
        all_joints: tuple[str, ...],
        motors: Motors,
        conditions: Conditions,
        seed: int = 0,
    ) -> None:
        self.conditions = conditions
        self._limit = conditions.motor_strength * motors.torque_limit
        self._stall, self._fastest = conditions.motor_strength * motors.stall_torque, motors.no_load_speed
        # A motor without a known line has a constant limit: a stall torque that is never reached.
        known = np.isfinite(self._stall) & np.isfinite(self._fastest)
        self._has_line = bool(known.any())
        self._stall, self._fastest = np.where(known, self._stall, 1e30), np.where(known, self._fastest, 1e30)
        self.model = _model(Path(file), conditions)
        model = self.model
        self._joints = [_joint(model, name, Path(file)) for name in joints]
        read = [_joint(model, name, Path(file)) for name in all_joints]
        self._dofs, self._places = model.jnt_dofadr[self._joints], model.jnt_qposadr[self._joints]
        self._read = model.jnt_qposadr[read], model.jnt_dofadr[read]
        self._base = int(model.body_rootid[model.jnt_bodyid[self._joints[0]]])
        self._names = all_joints
        model.body_mass[self._base] += conditions.payload * model.body_mass.sum()
        slope = np.radians(conditions.slope_deg)
        model.opt.gravity[:] = -np.linalg.norm(model.opt.gravity) * np.array([np.sin(slope), 0.0, np.cos(slope)])
        #: Rotation from the surface's frame, which is MuJoCo's world, to the level frame.
        self._tilt = np.array([np.cos(slope / 2), 0.0, -np.sin(slope / 2), 0.0])
        mujoco.mj_setConst(model, mujoco.MjData(model))
        self.data = mujoco.MjData(model)
        self.sand: ModelSand | None = None
        if conditions.ground != "rigid":
            sand = make_sand(conditions.ground, conditions.law, conditions.sand_strength)
            self.sand = add_sand(model, sand, floor=[_FLOOR])
        self._random = np.random.default_rng(seed)
        self._late: list[tuple[float, Array, Array, Array]] = []
        self._now: tuple[Array, ...] = tuple(np.zeros(len(joints)) for _ in range(3))  # no target yet
        #: Torques of the driven joints in the last time step [N·m].
        self.torque = np.zeros(len(joints))
        #: Largest torque as a part of its limit, largest speed [rad/s], and rms torque, since `reset`.
        self.most_torque = np.zeros(len(joints))
        self.most_speed = np.zeros(len(joints))
        self._squares, self._count = np.zeros(len(joints)), 0

    def reset(self, pose: Mapping[str, float]) -> None:
        """The robot at rest in a `pose` [rad] by joints' names, with its lowest point on the ground."""
        data = self.data
        mujoco.mj_resetData(self.model, data)
        places = dict(zip(self._names, self._read[0], strict=True))
        for name, angle in pose.items():
            data.qpos[places[name]] = angle
        data.qpos[3:7] = [1.0, 0.0, 0.0, 0.0]
        mujoco.mj_forward(self.model, data)
        data.qpos[2] -= _lowest(self.model, data)
        mujoco.mj_forward(self.model, data)
        self._late = []
        self._now = tuple(np.zeros(len(self._dofs)) for _ in range(3))  # no target yet
        self.torque = np.zeros(len(self._dofs))
        self.most_torque, self.most_speed = np.zeros(len(self._dofs)), np.zeros(len(self._dofs))
        self._squares, self._count = np.zeros(len(self._dofs)), 0

    @property
    def time(self) -> float:
        """[s]"""
        return float(self.data.time)

    @property
    def velocity(self) -> Array:
        """Velocity forward and to the left [m/s], and yaw rate [rad/s], in the base's frame and without noise."""
        exact = self._exact()
        return np.array([*exact["lin_vel"][:2], exact["gyroscope"][2]])

    @property
    def rms_torque(self) -> Array:
        """Root of the mean square of each torque since `reset` [N·m]; a motor's heat grows with its square."""
        return np.asarray(np.sqrt(self._squares / max(self._count, 1)))

    def readings(self) -> dict[str, Any]:
        """What the robot reports now, by the names of `sandgait.deploy`, with the noise of the conditions."""
        out = self._exact()
        for name, size in NOISE.items():
            if self.conditions.noise and name in out:
                out[name] = out[name] + self.conditions.noise * size * self._random.uniform(-1.0, 1.0, len(out[name]))
        if self.conditions.noise:  # the attitude, turned so that gravity's direction has the error of `gravity`
            angles = self.conditions.noise * NOISE["gravity"] * self._random.uniform(-1.0, 1.0, 2)
            turn = np.array([1.0, angles[0] / 2, angles[1] / 2, 0.0])
            out["quaternion"] = _product(out["quaternion"], turn / np.linalg.norm(turn))
        out["time"] = self.time
        return out

    def drive(
        self, targets: Array | None, stiffness: Array, damping: Array, seconds: float, held: bool = False
    ) -> None:
        """Lets time pass; from `latency` on the motors follow these targets. None: they only damp. `held`: the base
        stays where it is, as in a gantry."""
        goal = np.zeros(len(self._dofs)) if targets is None else np.asarray(targets, np.float64)
        self._late.append((self.time + self.conditions.latency, goal, np.asarray(stiffness), np.asarray(damping)))
        base = self.data.qpos[:7].copy()
        for _ in range(round(seconds / self.model.opt.timestep)):
            self._step()
            if held:
                self.data.qpos[:7], self.data.qvel[:6] = base, 0.0

    def wait(self, seconds: float) -> None:
        """Time passes while the robot hangs or is held."""
        self.data.time += seconds

    def to_world(self, vector: Array) -> Array:
        """A vector of the base's frame in the world's axes."""
        return np.asarray(self.data.xmat[self._base].reshape(3, 3) @ vector)

    def save(self) -> tuple[Any, ...]:
        """The state, for `load`."""
        size = mujoco.mj_stateSize(self.model, mujoco.mjtState.mjSTATE_INTEGRATION)
        state = np.empty(size)
        mujoco.mj_getState(self.model, self.data, state, mujoco.mjtState.mjSTATE_INTEGRATION)
        return state, list(self._late), self._now

    def load(self, saved: tuple[Any, ...]) -> None:
        """Goes back to a state of `save`."""
        state, late, self._now = saved
        self._late = list(late)
        mujoco.mj_setState(self.model, self.data, state, mujoco.mjtState.mjSTATE_INTEGRATION)
        mujoco.mj_forward(self.model, self.data)

    def _step(self) -> None:
        data, dofs = self.data, self._dofs
        while self._late and self._late[0][0] <= data.time + 1e-9:
            _, *now = self._late.pop(0)
            self._now = tuple(now)
        speed = data.qvel[dofs]
        self.torque = self._servos()
        data.qfrc_applied[dofs] = self.torque
        if self.sand is None:
            mujoco.mj_step(self.model, data)
        else:
            self.sand.step(data)
        np.maximum(self.most_torque, np.abs(self.torque), out=self.most_torque)
        np.maximum(self.most_speed, np.abs(speed), out=self.most_speed)
        self._squares += self.torque * self.torque
        self._count += 1

    def _servos(self) -> Array:
        """Torques of the driven joints in the present state [N·m]."""
        target, stiffness, damping = self._now
        position, speed = self.data.qpos[self._places], self.data.qvel[self._dofs]
        wanted = self.conditions.motor_strength * (stiffness * (target - position) - damping * speed)
        most, least = self._limit, -self._limit
        if self._has_line:
            line = np.clip(self._stall * (1.0 - np.abs(speed) / self._fastest), 0.0, self._limit)
            most, least = np.where(speed > 0.0, line, most), np.where(speed < 0.0, -line, least)
        return np.asarray(np.minimum(np.maximum(wanted, least), most))

    def _exact(self) -> dict[str, Any]:
        data = self.data
        applied = data.qfrc_applied.copy()
        applied[self._dofs] = self._servos()  # sampled with the positions, not in the step that led to them
        turn = data.xmat[self._base].reshape(3, 3)
        quaternion = _product(self._tilt, data.qpos[3:7])
        down = np.zeros(3)
        back = np.empty(4)
        mujoco.mju_negQuat(back, quaternion)
        mujoco.mju_rotVecQuat(down, np.array([0.0, 0.0, -1.0]), back)
        return {
            "quaternion": quaternion,
            "gravity": down,
            "lin_vel": turn.T @ data.qvel[:3],
            "gyroscope": data.qvel[3:6].copy(),
            "accelerometer": turn.T @ (data.qacc[:3] - self.model.opt.gravity),
            "joint_position": data.qpos[self._read[0]].copy(),
            "joint_velocity": data.qvel[self._read[1]].copy(),
            "joint_torque": applied[self._read[1]],
        }


def _model(file: Path, conditions: Conditions) -> mujoco.MjModel:
    """The robot of `file` above a plane, without the file's actuators, with a free base."""
    try:
        spec = mujoco.MjSpec.from_file(str(file))
        if file.suffix == ".urdf":
            _weigh_as_urdf(spec)
        return _compiled(spec, conditions)
    except (ValueError, OSError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InvalidRequest(f"robot: {file}: MuJoCo cannot read it: {reason}; give an MJCF or URDF file") from None


def _compiled(spec: mujoco.MjSpec, conditions: Conditions) -> mujoco.MjModel:
    for geom in list(spec.worldbody.geoms):
        if geom.type in (_SHAPES.mjGEOM_PLANE, _SHAPES.mjGEOM_HFIELD):
            spec.delete(geom)
    spec.worldbody.add_geom(name=_FLOOR, type=_SHAPES.mjGEOM_PLANE, size=[0.0, 0.0, 1.0])
    for base in spec.worldbody.bodies:
        if not any(joint.type == mujoco.mjtJoint.mjJNT_FREE for joint in base.joints):
            base.add_freejoint()
    spec.compiler.fusestatic = False  # a URDF's base would become a part of the world
    spec.compiler.balanceinertia = True  # URDFs have cameras with impossible inertias
    mended = [body.name for body in spec.bodies if _mend_inertia(body)]
    if mended:
        warn([f"robot: the inertia of {', '.join(mended)} is not possible; it is set to {_LEAST} kg·m²"])
    spec.option.timestep = TIME_STEP
    model = spec.compile()
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)
    model.geom_friction[:, 0] *= conditions.friction
    return model


def _weigh_as_urdf(spec: mujoco.MjSpec) -> None:
    """A URDF's link without an `inertial` has no mass; MuJoCo would weigh its shapes."""
    for body in spec.bodies:
        if not body.explicitinertial:
            for geom in body.geoms:
                geom.density = 0.0


def _mend_inertia(body: mujoco.MjsBody) -> bool:
    """Gives a body whose inertia has no positive eigenvalues, as URDFs have it for sensors, a small one."""
    xx, yy, zz, xy, xz, yz = body.fullinertia
    if not np.isfinite(xx) or np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]).min() > 0.0:
        return False
    body.fullinertia = [_LEAST, _LEAST, _LEAST, 0.0, 0.0, 0.0]
    return True


def _joint(model: mujoco.MjModel, name: str, file: Path) -> int:
    number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name)
    if number < 0:
        raise InvalidRequest(f"robot: {file} has no joint {name!r}; give the file with which the policy was trained")
    return int(number)


def _lowest(model: mujoco.MjModel, data: mujoco.MjData) -> float:
    """Height of the lowest point of the shapes that touch the floor [m]."""
    floor = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, _FLOOR)
    collides = model.geom_contype | model.geom_conaffinity
    touching = [g for g in range(model.ngeom) if g != floor and model.geom_bodyid[g] and collides[g]]
    heights = [_lowest_of(model, data, g) for g in touching]
    if not heights:
        raise InvalidRequest("robot: no shape of it collides; give a description with collision shapes")
    return min(heights)


def _lowest_of(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> float:
    """Height of a shape's lowest point [m]; of a shape that is no sphere, capsule or mesh, that of its box."""
    z, row = float(data.geom_xpos[geom][2]), data.geom_xmat[geom].reshape(3, 3)[2]
    size, kind = model.geom_size[geom], _SHAPES(model.geom_type[geom])
    if kind == _SHAPES.mjGEOM_SPHERE:
        return z - float(size[0])
    if kind == _SHAPES.mjGEOM_CAPSULE:
        return z - float(size[0] + abs(row[2]) * size[1])
    if kind == _SHAPES.mjGEOM_MESH:
        mesh = model.geom_dataid[geom]
        vertices = model.mesh_vert[model.mesh_vertadr[mesh] :][: model.mesh_vertnum[mesh]]
        return z + float((vertices @ row).min())
    half = model.geom_aabb[geom][3:]
    return z + float(row @ model.geom_aabb[geom][:3] - np.abs(row) @ half)


def _product(a: Array, b: Array) -> Array:
    out = np.empty(4)
    mujoco.mju_mulQuat(out, np.asarray(a), np.asarray(b))
    return out
