"""What a robot reports in a control step, checked and in the order of the policy."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from .errors import Refused
from .policy import JOINT_READINGS, Floats, Policy

#: Orders of a quaternion's numbers.
ORDERS = ("wxyz", "xyzw")

#: Largest deviation of a quaternion's length from 1: our choice; drivers send 32-bit numbers, whose error is 1e-7.
_LENGTH = 1e-3

#: How far a joint may be beyond its range [rad]: our choice, because a joint rests on its stop, and encoders have
#: errors of zero.
_BEYOND = 0.1

#: Cosine of the angle below which a heading counts as exactly backwards: our choice, 10°.
_BACKWARDS = math.cos(math.radians(5.0))

#: Tilt below which a robot counts as upright at rest [rad]: our choice; robots are started on level ground.
_UPRIGHT = 0.5

#: Numbers of other readings by their name; the rest has as many as the observation uses.
SIZES = {"quaternion": 4, "gravity": 3, "gyroscope": 3, "lin_vel": 3, "accelerometer": 3}


class Readings:
    """Turns the readings of a robot, by name, into arrays in the order of the policy."""

    def __init__(self, policy: Policy, joints: Sequence[str] | None, order: str | None) -> None:
        self._policy = policy
        self._places = None if joints is None else _places(policy, list(joints))
        self._order = order
        if order is not None and order not in ORDERS:
            raise Refused(f"quaternion: {order!r} is none of {', '.join(ORDERS)}")
        attitude = "gravity" if order is None else "quaternion"
        # Falls are seen in the attitude, and targets begin at the positions, also if the policy observes neither.
        needed = (*policy.readings, "gravity", "joint_position")
        #: Names of what `read` needs besides the time.
        self.names = tuple(dict.fromkeys(attitude if name == "gravity" else name for name in needed))

    def read(self, readings: Mapping[str, Any]) -> dict[str, Floats]:
        """The readings as arrays; `gravity` from the quaternion. Raises Refused and names what is wrong."""
        missing = [name for name in (*self.names, "time") if readings.get(name) is None]
        if missing:
            self._refuse_missing(missing[0], readings)
        out = {"time": np.array([_number("time", readings["time"])])}
        present = [name for name in ("joint_torque", "accelerometer", "joint_velocity") if name in readings]
        for name in dict.fromkeys((*self.names, *present)):
            if name in JOINT_READINGS:
                out[name] = self._joints(name, readings[name])
            elif name == "quaternion":
                out[name] = self._quaternion(readings[name])
                out["gravity"] = gravity(out[name])
            else:
                size = SIZES.get(name) or self._policy.size(name)
                out[name] = _row(name, readings[name], size)
        if "gravity" in self.names and abs(np.linalg.norm(out["gravity"]) - 1.0) > _LENGTH:
            raise Refused(f"gravity: has the length {np.linalg.norm(out['gravity']):.4g}; divide it by its length")
        return out

    def check_pose(self, read: Mapping[str, Floats], heading_checked: bool) -> None:
        """What can be seen of a robot at rest: joints within their ranges, and an attitude that is upright."""
        for place, servo in zip(self._policy.driven, self._policy.servos, strict=True):
            position = float(read["joint_position"][place])
            low, high = servo.range
            if not low - _BEYOND <= position <= high + _BEYOND:
                raise Refused(
                    f"joint_position: {servo.joint} is at {position:.3f}, outside of its range, {low:.3f} to "
                    f"{high:.3f}; check the order of the joints, their zeros, signs and unit (rad)"
                )
        tilt = float(np.arccos(np.clip(-read["gravity"][2], -1.0, 1.0)))
        if tilt > _UPRIGHT:
            what = f"quaternion as {self._order}" if "quaternion" in read else "gravity"
            raise Refused(
                f"{what}: the robot is tilted by {math.degrees(tilt):.0f}°; put it upright, or check the quaternion's "
                f"order ({' or '.join(ORDERS)}) and direction (base to world)"
            )
        if "quaternion" in read and not heading_checked and abs(float(read["quaternion"][3])) > _BACKWARDS:
            raise Refused(
                f"quaternion as {self._order}: the heading is 180°, as if the order were that of "
                f"{next(o for o in ORDERS if o != self._order)} and the heading 0; turn the robot, or give "
                "heading_checked=True if it does face backwards"
            )

    def _refuse_missing(self, name: str, readings: Mapping[str, Any]) -> None:
        hint = f"give {', '.join(self.names)} and time"
        if name == "gravity" and "quaternion" in readings:
            hint = "say in which order the quaternion comes: Controller(…, quaternion='wxyz') or 'xyzw'"
        if name == "lin_vel":
            hint = (
                "the policy was trained with the base's velocity, which an estimator must give; or train without it: "
                """--option 'sensors={"without": ["lin_vel"]}'"""
            )
        raise Refused(f"{name}: the reading is missing; {hint}")

    def _joints(self, name: str, value: Any) -> Floats:
        joints = self._policy.joints
        if isinstance(value, Mapping):
            wrong = [joint for joint in joints if joint not in value] or [j for j in value if j not in joints]
            if wrong:
                raise Refused(f"{name}: {wrong[0]!r} is missing or unknown; the joints are {', '.join(joints)}")
            return _row(name, [value[joint] for joint in joints], len(joints))
        if self._places is None:
            raise Refused(
                f"{name}: has no names of joints; give a dictionary, or the order of your arrays: "
                f"Controller(…, joints=[{joints[0]!r}, …])"
            )
        return _row(name, value, len(joints))[self._places]

    def _quaternion(self, value: Any) -> Floats:
        row = _row("quaternion", value, 4)
        length = float(np.linalg.norm(row))
        if abs(length - 1.0) > _LENGTH:
            raise Refused(f"quaternion: has the length {length:.4g}, not 1; give the rotation from base to world")
        return row if self._order == "wxyz" else row[[3, 0, 1, 2]]


def gravity(quaternion: Floats) -> Floats:
    """Direction of gravity in the base's frame, for the rotation w, x, y, z from the base's frame to the level one."""
    w, x, y, z = quaternion
    return np.array([-(2.0 * (x * z - w * y)), -(2.0 * (y * z + w * x)), -(1.0 - 2.0 * (x * x + y * y))])


def _places(policy: Policy, joints: list[str]) -> npt.NDArray[np.int64]:
    """For each joint of the policy its place in the robot's arrays."""
    wrong = [joint for joint in policy.joints if joints.count(joint) != 1] or [
        joint for joint in joints if joint not in policy.joints
    ]
    if wrong:
        raise Refused(
            f"joints: {wrong[0]!r} must be named once, and no others; the policy's are {', '.join(policy.joints)}"
        )
    return np.array([joints.index(joint) for joint in policy.joints])


def _number(name: str, value: Any) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise Refused(f"{name}: {value!r} is no number") from None
    if not math.isfinite(number):
        raise Refused(f"{name}: is {number}; a sensor that fails must be left out")
    return number


def _row(name: str, value: Any, size: int) -> Floats:
    try:
        row = np.asarray(value, np.float64)
    except (TypeError, ValueError):
        raise Refused(f"{name}: are no numbers") from None
    if row.shape != (size,):
        raise Refused(f"{name}: has the shape {row.shape}, not ({size},)")
    if not np.isfinite(row).all():
        raise Refused(f"{name}: number {int(np.argmin(np.isfinite(row)))} is not finite; leave the step out")
    return row
