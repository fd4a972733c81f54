"""Runs a policy on a Unitree robot (Go1, Go2, A2) through unitree_sdk2_python, or on a simulated one.

    python examples/deploy_unitree.py POLICY --simulated ROBOT.xml     # MuJoCo in place of the robot
    python examples/deploy_unitree.py POLICY --interface enp3s0        # the robot, hanging in its gantry

Tests run the simulated robot, whose messages have the fields of `LowState_` and `LowCmd_`. The class `Robot` below was
never run here: it needs a robot. The SDK gives no velocity of the base in low-level mode, so on a robot the policy must
be trained without it (`--option 'sensors={"without": ["lin_vel"]}'`); with another policy the Controller refuses to
start."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Protocol

import numpy as np

from sandgait_deploy import Controller, Output, Refused

#: Order of the motors in LowState_ and LowCmd_ of Go1, Go2 and A2: legs, and joints of each leg.
LEGS = ("FR", "FL", "RR", "RL")
JOINTS = tuple(f"{leg}_{joint}_joint" for leg in LEGS for joint in ("hip", "thigh", "calf"))

#: A motor that is driven (`mode` of MotorCmd_ in unitree_sdk2's examples).
SERVO = 0x01


class Link(Protocol):
    """What the loop needs of a robot, real or simulated."""

    def state(self) -> Any: ...

    def send(self, output: Output) -> None: ...

    def now(self) -> float: ...

    def wait(self, seconds: float) -> None: ...


def readings(state: Any, joints: tuple[str, ...]) -> dict[str, Any]:
    """The readings by name, from a `LowState_`."""
    motors, imu = state.motor_state[: len(joints)], state.imu_state
    read = {
        "time": state.time,
        "joint_position": [motor.q for motor in motors],
        "joint_velocity": [motor.dq for motor in motors],
        "joint_torque": [motor.tau_est for motor in motors],
        "quaternion": imu.quaternion,  # w, x, y, z
        "gyroscope": imu.gyroscope,
        "accelerometer": imu.accelerometer,
    }
    velocity = getattr(state, "velocity", None)  # of an estimator; unitree's low level has none
    return read if velocity is None else {**read, "lin_vel": velocity}


class Robot:
    """A Unitree robot at the low level. Switch its own controller off first (`MotionSwitcherClient`)."""

    def __init__(self, interface: str) -> None:
        from unitree_sdk2py.core.channel import ChannelFactoryInitialize, ChannelPublisher, ChannelSubscriber
        from unitree_sdk2py.idl.default import unitree_go_msg_dds__LowCmd_
        from unitree_sdk2py.idl.unitree_go.msg.dds_ import LowCmd_, LowState_
        from unitree_sdk2py.utils.crc import CRC

        ChannelFactoryInitialize(0, interface)
        self._crc, self._command, self._state = CRC(), unitree_go_msg_dds__LowCmd_(), None
        self._command.head[0], self._command.head[1], self._command.level_flag = 0xFE, 0xEF, 0xFF
        self._publisher = ChannelPublisher("rt/lowcmd", LowCmd_)
        self._publisher.Init()
        subscriber = ChannelSubscriber("rt/lowstate", LowState_)
        subscriber.Init(self._heard, 10)

    def _heard(self, message: Any) -> None:
        message.time = time.monotonic()
        self._state = message

    def state(self) -> Any:
        while self._state is None:
            time.sleep(0.001)
        return self._state

    def send(self, output: Output) -> None:
        for k in range(len(output.joints)):
            motor = self._command.motor_cmd[k]
            motor.mode, motor.dq, motor.tau = SERVO, 0.0, 0.0
            motor.q = 0.0 if output.targets is None else float(output.targets[k])
            motor.kp, motor.kd = float(output.stiffness[k]), float(output.damping[k])
        self._command.crc = self._crc.Crc(self._command)
        self._publisher.Write(self._command)

    def now(self) -> float:
        return time.monotonic()

    def wait(self, seconds: float) -> None:
        time.sleep(seconds)


class Simulated:
    """The same messages from a robot in MuJoCo, whose joints are in the order `joints`."""

    def __init__(self, controller: Controller, file: Path, joints: tuple[str, ...]) -> None:
        from sandgait.certify.walk import make_plant
        from sandgait.plant import Conditions

        policy = controller.policy
        self.plant = make_plant(
            policy, file, Conditions(ground=str(policy.trained_with["ground"]), latency=0.005), seed=0
        )
        self.plant.reset({servo.joint: servo.default for servo in policy.servos})
        self._controller, self._driven = controller, [servo.joint for servo in policy.servos]
        self._order = [policy.joints.index(joint) for joint in joints]

    def state(self) -> Any:
        read = self.plant.readings()
        rows = zip(
            *(read[name][self._order] for name in ("joint_position", "joint_velocity", "joint_torque")), strict=True
        )
        imu = SimpleNamespace(**{name: read[name] for name in ("quaternion", "gyroscope", "accelerometer")})
        motors = [SimpleNamespace(q=q, dq=dq, tau_est=tau) for q, dq, tau in rows]
        return SimpleNamespace(time=self.plant.time, motor_state=motors, imu_state=imu, velocity=read["lin_vel"])

    def send(self, output: Output) -> None:
        if self._controller.state in ("checking", "ready"):
            self.plant.wait(1.0 / self._controller.policy.rate)  # it hangs in its gantry
            return
        place = [output.joints.index(joint) for joint in self._driven]
        targets = None if output.targets is None else output.targets[place]
        self.plant.drive(targets, output.stiffness[place], output.damping[place], 1.0 / self._controller.policy.rate)

    def now(self) -> float:
        return self.plant.time

    def wait(self, seconds: float) -> None:
        """Time has passed in `send`."""


def run(
    controller: Controller, link: Link, joints: tuple[str, ...], command: tuple[float, float, float], seconds: float
) -> None:
    """Checks, stands up, walks for some seconds, stops and stands. Ends at once if the controller stops the robot."""
    period, end = 1.0 / controller.policy.rate, None
    next_time = link.now()
    while True:
        output = controller.step(readings(link.state(), joints), command, now=link.now())
        link.send(output)
        if output.state == "ready":
            controller.stand()
        elif output.state == "standing" and end is None:
            controller.walk()
            end = link.now() + seconds
        elif output.state == "walking" and end is not None and link.now() >= end:
            controller.stop()
        elif output.state in ("standing", "fallen", "stopped"):
            print(output.state, output.reason)
            return
        next_time += period
        link.wait(max(0.0, next_time - link.now()))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("policy", type=Path)
    place = parser.add_mutually_exclusive_group(required=True)
    place.add_argument("--interface", help="network interface of the robot")
    place.add_argument("--simulated", type=Path, metavar="ROBOT.xml")
    parser.add_argument("--command", type=float, nargs=3, default=(0.4, 0.0, 0.0), metavar=("FORWARD", "LEFT", "YAW"))
    parser.add_argument("--seconds", type=float, default=4.0)
    parser.add_argument("--log", type=Path)
    given = parser.parse_args()
    try:
        from sandgait_deploy import read_policy

        own = read_policy(given.policy).joints
        # A simulated robot may have other names: its motors come in the reverse order of the policy's.
        joints = JOINTS if set(JOINTS) == set(own) else tuple(reversed(own))
        with Controller(given.policy, joints=joints, quaternion="wxyz", log=given.log) as controller:
            print(controller.verify())
            link: Link = Simulated(controller, given.simulated, joints) if given.simulated else Robot(given.interface)
            run(controller, link, joints, tuple(given.command), given.seconds)
            if isinstance(link, Simulated):
                place = link.plant.data.qpos[:3]
                print("it is at x = {:.2f} m, y = {:.2f} m, z = {:.2f} m".format(*np.asarray(place)))
    except Refused as error:
        raise SystemExit(f"deploy_unitree: {error}") from None


if __name__ == "__main__":
    main()
