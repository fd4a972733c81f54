"""`policy.json`: how a policy is run. `policy.schema.json` beside this file is the schema."""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from .errors import Refused

Floats = npt.NDArray[np.float64]

#: The version of `policy.json` that this package reads.
VERSION = 2

#: Readings that a Controller makes by itself; all others come from the robot.
OWN_READINGS = ("command", "last_action", "clock")

#: Readings that have one number for each joint.
JOINT_READINGS = ("joint_position", "joint_velocity", "joint_torque")


@dataclass(frozen=True)
class Column:
    """One number of the observation: clip(part(reading[index] − subtract), low, high)."""

    name: str
    unit: str
    low: float
    high: float
    #: The reading that the number comes from, and its place in it.
    reading: str
    index: int
    subtract: float
    #: "value", or the "sine" or "cosine" of the value.
    part: str
    #: Age of the number in control steps.
    steps_before: int


@dataclass(frozen=True)
class Servo:
    """What drives a joint: target = default + scale · action; torque = stiffness · (target − position) − damping ·
    velocity, within ± torque_limit. Units: rad, N·m/rad, N·m·s/rad, N·m, rad/s (m and N for sliding joints)."""

    joint: str
    default: float
    scale: float
    stiffness: float
    damping: float
    #: Infinite if it is not known; the same holds for the motor's line, `stall_torque` and `no_load_speed`.
    torque_limit: float
    stall_torque: float
    no_load_speed: float
    #: Lowest and highest position; ± infinity if the joint has no stops.
    range: tuple[float, float]
    #: Time in which the servo's reference follows its target [s]; 0: at once.
    target_time: float


@dataclass(frozen=True)
class Policy:
    """A policy's folder: all that `policy.json` says."""

    folder: Path
    task: str
    #: Control steps in a second [Hz], and steps of the servos' law in a second in the training [Hz].
    rate: float
    servo_rate: float
    #: Observations in a row of the observation.
    history: int
    #: Names of all joints, in the order of readings.
    joints: tuple[str, ...]
    observation: tuple[Column, ...]
    action_low: npt.NDArray[np.float32]
    action_high: npt.NDArray[np.float32]
    #: One for each number of the action, then those of joints that are held, whose scale is 0.
    servos: tuple[Servo, ...]
    #: Ranges of commands forward, to the left [m/s] and yaw [rad/s]: [3, 2].
    commands: Floats
    #: Frequency of the clock in the observation [Hz]; 0: it has none.
    clock_frequency: float
    velocity_by_differences: bool
    #: Angle between the base's downward axis and gravity at which the robot has fallen [rad].
    most_tilt: float
    #: Delays, sensors, motors and ground of the training.
    trained_with: dict[str, Any]
    #: Name, mass [kg], standing height and length of legs [m], feet.
    robot: dict[str, Any]
    network: Path
    #: Does `policy.onnx` have the checksum in `policy.json`?
    network_is_described: bool

    @property
    def readings(self) -> tuple[str, ...]:
        """Names of the readings that the robot must supply, in the order of the observation."""
        names = dict.fromkeys(c.reading for c in self.observation if c.reading not in OWN_READINGS)
        if self.velocity_by_differences:
            names.pop("joint_velocity", None)
        return tuple(names)

    def size(self, reading: str) -> int:
        """How many numbers a reading has."""
        if reading in JOINT_READINGS:
            return len(self.joints)
        return 1 + max(c.index for c in self.observation if c.reading == reading)

    @property
    def actions(self) -> int:
        """Length of the action."""
        return len(self.action_low)

    @property
    def driven(self) -> list[int]:
        """For each servo the place of its joint in `joints`."""
        return [self.joints.index(servo.joint) for servo in self.servos]

    def target(self, action: npt.NDArray[Any]) -> Floats:
        """Target of each driven joint [rad]; for joints that are held, the default position."""
        targets, scale = self._servos("default"), self._servos("scale")
        clipped = np.clip(np.asarray(action, np.float32), self.action_low, self.action_high)
        targets[: len(clipped)] += scale[: len(clipped)] * clipped.astype(np.float64)
        return targets

    def torque(self, target: Floats, position: Floats, velocity: Floats) -> Floats:
        """Torque of each driven joint by the servos' law [N·m], from the joints' targets, positions and velocities."""
        wanted = self._servos("stiffness") * (target - position) - self._servos("damping") * velocity
        limit = self._servos("torque_limit")
        return np.asarray(np.clip(wanted, -limit, limit))

    def _servos(self, name: str) -> Floats:
        return np.array([getattr(servo, name) for servo in self.servos])


def policy_folder(path: str | Path) -> Path:
    """The folder of a policy, which may be given by a file in it: policy.onnx or policy.json."""
    place = Path(path)
    return place.parent if place.suffix in (".onnx", ".json") else place


def read_policy(folder: str | Path) -> Policy:
    """The policy in `folder`, which `sandgait train` wrote.

    Raises Refused if there is none, if it is of another version, or if its actions drive no joints.
    """
    path = policy_folder(folder) / "policy.json"
    try:
        about = json.loads(path.read_bytes())
    except FileNotFoundError:
        hint = (
            "give the folder that `sandgait train` wrote, or make the file: python -m sandgait_deploy describe FOLDER"
        )
        raise Refused(f"{path}: there is no such file; {hint}") from None
    except (OSError, ValueError) as error:
        raise Refused(f"{path}: cannot be read: {error}") from None
    _check_version(path, about)
    try:
        return _policy(path, about)
    except (KeyError, TypeError, ValueError, IndexError) as error:
        if isinstance(error, Refused):
            raise
        raise Refused(f"{path}: does not follow policy.schema.json: {error!r}; write it again with "
                      f"python -m sandgait_deploy describe {path.parent}") from None  # fmt: skip


def _check_version(path: Path, about: Any) -> None:
    if not isinstance(about, dict):
        raise Refused(f"{path}: is no description of a policy")
    version = about.get("version", 1)
    if version == VERSION:
        return
    if version == 1:
        reason = "version 1 lacks limits, readings and delays"
        raise Refused(f"{path}: {reason}; add them: python -m sandgait_deploy describe {path.parent}")
    raise Refused(f"{path}: is of version {version!r}, this program reads version {VERSION}: update sandgait")


def _policy(path: Path, about: dict[str, Any]) -> Policy:
    if "targets" not in about:
        raise Refused(f"{path}: the actions of {about['task']} are no targets of joints; only policies of "
                      "LeggedVelocity run on a robot")  # fmt: skip
    columns = tuple(_column(c) for c in about["observation"])
    network = path.with_name(about["network"])
    try:
        digest = hashlib.sha256(network.read_bytes()).hexdigest()
    except OSError as error:
        raise Refused(f"{network}: cannot be read: {error.strerror}; copy it beside policy.json") from None
    policy = Policy(
        folder=path.parent,
        task=str(about["task"]),
        rate=float(about["rate"]),
        servo_rate=float(about["servo_rate"]),
        history=int(about["history"]),
        joints=tuple(map(str, about["joints"])),
        observation=columns,
        action_low=np.array([c["low"] for c in about["action"]], np.float32),
        action_high=np.array([c["high"] for c in about["action"]], np.float32),
        servos=tuple(_servo(s) for s in [*about["targets"], *about.get("held", [])]),
        commands=np.array(about["commands"], np.float64).reshape(3, 2),
        clock_frequency=float(about["clock_frequency"] or 0.0),
        velocity_by_differences=bool(about["velocity_by_differences"]),
        most_tilt=float(about["most_tilt"]),
        trained_with=dict(about["trained_with"]),
        robot=dict(about["robot"]),
        network=network,
        network_is_described=digest == about["network_sha256"],
    )
    _check(path, policy, len(about["targets"]))
    return policy


def _check(path: Path, policy: Policy, targets: int) -> None:
    """What a schema cannot say."""
    reason = None
    unknown = [servo.joint for servo in policy.servos if servo.joint not in policy.joints]
    if unknown:
        reason = f"target {unknown[0]!r} is none of the joints"
    elif targets != policy.actions:
        reason = f"{targets} targets and {policy.actions} actions"
    elif any(not c.reading for c in policy.observation):
        reason = f"observation {next(c.name for c in policy.observation if not c.reading)!r} has no reading"
    elif not policy.network_is_described:
        reason = f"{policy.network.name} is not the network that it describes (network_sha256)"
    if reason:
        raise Refused(f"{path}: {reason}; write it again: python -m sandgait_deploy describe {policy.folder}")


def _column(c: dict[str, Any]) -> Column:
    low = -math.inf if c["low"] is None else float(c["low"])
    high = math.inf if c["high"] is None else float(c["high"])
    return Column(
        str(c["name"]),
        str(c["unit"]),
        low,
        high,
        str(c["reading"]),
        int(c["index"]),
        float(c["subtract"]),
        str(c["part"]),
        int(c["steps_before"]),
    )


def _servo(s: dict[str, Any]) -> Servo:
    def known(name: str, otherwise: float) -> float:
        return otherwise if s[name] is None else float(s[name])

    low, high = s["range"] or (-math.inf, math.inf)
    return Servo(
        joint=str(s["joint"]),
        default=float(s["default"]),
        scale=float(s["scale"]),
        stiffness=float(s["stiffness"]),
        damping=float(s["damping"]),
        torque_limit=known("torque_limit", math.inf),
        stall_torque=known("stall_torque", math.inf),
        no_load_speed=known("no_load_speed", math.inf),
        range=(float(low), float(high)),
        target_time=known("target_time", 0.0),
    )
