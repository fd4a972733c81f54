"""The program between a robot's sensors and its motors: it checks readings, runs the policy and limits targets.

```text
 checking ──▶ ready ──stand()──▶ rising ──▶ standing ──walk()──▶ walking
                                   ▲                               │ stop()
                                   └────────── stopping ◀──────────┘
 any state with a tilt beyond the policy's limit ──▶ fallen;  any moving state with bad readings ──▶ stopped
```
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from .errors import Refused
from .log import Log
from .network import Network
from .observer import Observer
from .policy import Floats, Policy, read_policy
from .readings import Readings

#: Steps of readings that are checked before anything may move: our choice, a fifth of a second at 50 Hz.
CHECKS = 10

#: Largest deviation of the time between two readings from the control period, as a part of it: our choice. A policy
#: at 40 instead of 50 Hz is refused; the jitter of a loaded computer is not.
RATE_TOLERANCE = 0.2

#: Greatest age of readings in control periods, and greatest gap between two of them while the robot moves: our choice.
OLDEST, LONGEST_GAP = 1.0, 2.5

#: Time in which the robot goes to its default pose [s]: our choice, slow enough to be stopped by hand.
RISE_SECONDS = 2.0

#: Largest distance of a joint from its target while the robot rises [rad]: our choice, above the distance at which the
#: servos of usual robots give their full torque (0.3 rad for Go1).
MOST_BEHIND = 0.5

#: Time in which the policy brings the robot to a halt, commanded to stand, before it goes to its default pose [s]: our
#: choice, some two strides.
STOP_SECONDS = 1.0

MOVING = ("rising", "standing", "walking", "stopping")


@dataclass(frozen=True)
class Output:
    """What the motors are to do in the next control period. Arrays have one number for each of `joints`."""

    #: checking, ready, rising, standing, walking, stopping, fallen or stopped.
    state: str
    joints: tuple[str, ...]
    #: Target angles [rad]; None: no targets, so the motors only damp (stiffness 0).
    targets: Floats | None
    stiffness: Floats
    damping: Floats
    #: Limits of torques [N·m]; infinite if none is known.
    torque_limit: Floats
    #: The policy's observation and action; None if it did not act.
    observation: npt.NDArray[np.float32] | None
    action: npt.NDArray[np.float32] | None
    #: Why the robot has stopped or fallen; empty otherwise.
    reason: str
    #: Number of targets that a limit has changed.
    limited: int


class Controller:
    """Runs the policy in `folder` on a robot. Before the robot moves, errors raise Refused; while it moves, an error
    stops it: the motors damp, and `Output.reason` says why.

    `joints`: the order of the joints in the robot's arrays; without it readings of joints are dictionaries by name, and
    targets are in the order of the policy. `quaternion`: the order in which the reading "quaternion" comes, "wxyz" or
    "xyzw" (rotation from the base's frame to the level one); without it the reading "gravity" is taken. `log`: a CSV
    file for what was seen and done, which `sandgait diagnose` reads, or the same as MCAP if its name ends in .mcap.
    `runtime`: "numpy", bit-identical to the simulator, or "onnxruntime". `heading_checked`: the robot does face
    backwards. `max_change`: largest change of a target in a step [rad]; by default what training allowed, twice the
    scale of its action.
    """

    def __init__(
        self,
        folder: str | Path,
        *,
        joints: Sequence[str] | None = None,
        quaternion: str | None = None,
        log: str | Path | None = None,
        runtime: str = "numpy",
        heading_checked: bool = False,
        max_change: float | None = None,
    ) -> None:
        self.policy: Policy = read_policy(folder)
        policy = self.policy
        self._readings = Readings(policy, joints, quaternion)
        self._network = Network(policy.network, len(policy.observation), policy.actions, runtime)
        self._observer = Observer(policy)
        self._heading_checked = heading_checked
        driven = [servo.joint for servo in policy.servos]
        robot = driven if joints is None else [joint for joint in joints if joint in driven]
        #: For each output the place of its servo.
        self._order = np.array([driven.index(joint) for joint in robot])
        self.joints = tuple(robot)
        scale = np.array([servo.scale for servo in policy.servos])
        if max_change is not None and not max_change > 0.0:
            raise Refused(f"max_change: {max_change} must be above 0 rad")
        # Joints that are held move to their default position, as fast as the others may.
        most = 2.0 * np.where(scale > 0.0, scale, scale.max())
        self._max_change = most if max_change is None else np.full(len(scale), max_change)
        self._default = np.array([servo.default for servo in policy.servos])
        self._range = np.array([servo.range for servo in policy.servos]).T
        self._log = None if log is None else Log(log, policy)
        self.reset()

    def reset(self) -> None:
        """Back to the first state, in which readings are checked and nothing moves."""
        self.state, self.reason = "checking", ""
        self._checked = 0
        self._last_time: float | None = None
        self._targets: Floats | None = None
        self._from: Floats = self._default
        self._steps = self._halted = 0
        self._last_action = np.zeros(self.policy.actions, np.float32)
        self._observer.forget()

    def stand(self) -> None:
        """Begins to go to the default pose, in 2 s. Raises Refused before the readings have been checked."""
        if self.state != "ready":
            raise Refused(f"stand: the state is {self.state}, not ready; call step until it is, or reset")
        self.state, self._steps = "rising", 0

    def walk(self) -> None:
        """Begins to run the policy. Raises Refused if the robot does not stand."""
        if self.state != "standing":
            raise Refused(f"walk: the state is {self.state}, not standing; call stand, then step until it stands")
        self.state, self._steps = "walking", 0
        self._last_action = np.zeros(self.policy.actions, np.float32)
        self._observer.forget()

    def stop(self) -> None:
        """Ends the walk: the policy halts the robot within 1 s; then it goes to its default pose and stands."""
        if self.state == "walking":
            self.state, self._halted = "stopping", self._steps + round(STOP_SECONDS * self.policy.rate)

    def act(self, observation: npt.NDArray[Any]) -> npt.NDArray[np.float32]:
        """The policy's action for an observation of the simulator, to the last bit as in the simulator."""
        action = self._network.act(observation)
        return np.clip(action, self.policy.action_low, self.policy.action_high)

    def step(
        self, readings: Mapping[str, Any], command: Sequence[float] = (0.0, 0.0, 0.0), now: float | None = None
    ) -> Output:
        """One control step. `readings`: by name, `time` [s] among them; `command`: forward, to the left [m/s], yaw
        [rad/s], clipped to the ranges of the training; `now`: the present time on the clock of `time`, without which
        the readings' age is not checked."""
        if self.state in ("fallen", "stopped"):
            return self._end(self.state, self.reason, None)
        try:
            read = self._readings.read(readings)
            self._check_time(float(read["time"][0]), now)
            if self.state == "checking":
                self._readings.check_pose(read, self._heading_checked)
        except Refused as error:
            if self.state not in MOVING:
                raise
            return self._end("stopped", str(error), None)
        wanted = np.clip(np.asarray(command, np.float64), *self.policy.commands.T)
        if not np.isfinite(wanted).all():
            return self._end("stopped", "command: is not finite", read)
        return self._advance(read, wanted)

    def close(self) -> None:
        """Completes the log."""
        if self._log is not None:
            self._log.close()

    def __enter__(self) -> Controller:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def verify(self) -> Any:
        """Compares this program with the golden trace beside `policy.json`, boundary by boundary: see
        `sandgait_deploy.golden.verify`."""
        from .golden import verify

        return verify(self.policy, self._network)

    def _advance(self, read: dict[str, Floats], command: Floats) -> Output:
        tilt = math.acos(max(-1.0, min(1.0, -float(read["gravity"][2]))))
        if self.state in MOVING and tilt > self.policy.most_tilt:
            return self._end("fallen", f"it is tilted by {math.degrees(tilt):.0f}°", read)
        position = read["joint_position"][self.policy.driven]
        if self.state == "rising" and self._targets is not None:
            behind = np.abs(position - self._targets)
            if behind.max() > MOST_BEHIND:
                joint = self.policy.servos[int(behind.argmax())].joint
                reason = (
                    f"{joint} is {behind.max():.2f} rad away from its target: check order, signs and gains of joints"
                )
                return self._end("stopped", reason, read)
        observation = action = None
        wanted: Floats | None = None
        if self.state == "checking":
            self._checked += 1
            self.state = "ready" if self._checked >= CHECKS else "checking"
        elif self.state == "rising":
            self._from = (position if self._targets is None else self._targets) if self._steps == 0 else self._from
            self._steps += 1
            part = min(1.0, self._steps / (RISE_SECONDS * self.policy.rate))
            wanted = self._from + (self._default - self._from) * (1.0 - math.cos(math.pi * part)) / 2.0
            self.state = "standing" if part == 1.0 else "rising"
        elif self.state == "standing":
            wanted = self._default
        elif self.state in ("walking", "stopping"):
            command = np.zeros(3) if self.state == "stopping" else command
            seconds = self._steps / self.policy.rate
            observation = self._observer.observe(read, command, self._last_action, seconds)
            try:
                action = self.act(observation)
            except Refused as error:
                return self._end("stopped", str(error), read)
            self._last_action, self._steps = action, self._steps + 1
            wanted = self.policy.target(action)
            if self.state == "stopping" and self._steps >= self._halted:
                self.state, self._steps = "rising", 0
        return self._output(read, command, wanted, observation, action)

    def _check_time(self, time: float, now: float | None) -> None:
        period, last = 1.0 / self.policy.rate, self._last_time
        if now is not None and not -period <= now - time <= OLDEST * period:
            raise Refused(f"time: the readings are {now - time:.3f} s old; give new ones in each step, on one clock")
        if last is not None:
            gap = time - last
            moving = self.state in MOVING
            if gap <= 0.0:
                raise Refused("time: the readings are those of the step before; read the sensors in each step")
            if moving and gap > LONGEST_GAP * period:
                raise Refused(f"time: {gap:.3f} s have passed since the last readings, {period:.3f} s are a period")
            if not moving and abs(gap - period) > RATE_TOLERANCE * period:
                rate = self.policy.rate
                raise Refused(f"time: readings come at {1.0 / gap:.1f} Hz; the policy needs a step at {rate:g} Hz")
        self._last_time = time

    def _end(self, state: str, reason: str, read: dict[str, Floats] | None) -> Output:
        self.state, self.reason, self._targets = state, reason, None
        return self._output(read, np.zeros(3), None, None, None)

    def _output(
        self,
        read: dict[str, Floats] | None,
        command: Floats,
        wanted: Floats | None,
        observation: npt.NDArray[np.float32] | None,
        action: npt.NDArray[np.float32] | None,
    ) -> Output:
        policy, order, limited = self.policy, self._order, 0
        if wanted is not None:
            low, high = self._range
            safe = np.clip(wanted, low, high)
            if self._targets is not None:
                safe = np.clip(safe, self._targets - self._max_change, self._targets + self._max_change)
            limited = int(np.count_nonzero(np.abs(safe - wanted) > 1e-9))
        else:
            safe = None
        self._targets = safe
        servos = [policy.servos[k] for k in order]
        stiffness = np.array([servo.stiffness for servo in servos])
        output = Output(
            self.state,
            self.joints,
            None if safe is None else safe[order],
            stiffness if safe is not None else np.zeros(len(order)),
            np.array([servo.damping for servo in servos]),
            np.array([servo.torque_limit for servo in servos]),
            observation,
            action,
            self.reason,
            limited,
        )
        if self._log is not None and read is not None:
            self._log.row(read, command, safe, output)
        return output
