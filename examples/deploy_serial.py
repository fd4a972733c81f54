"""Runs a policy on a robot behind a serial port, or on a simulated one behind a pseudo-terminal.

    python examples/deploy_serial.py POLICY --simulated ROBOT.xml
    python examples/deploy_serial.py POLICY --port /dev/ttyUSB0

The protocol is a line of text in each direction, fifty times a second. The robot sends `time`, then positions and
speeds of its joints, the quaternion w, x, y, z, the gyroscope and the base's velocity. It gets a target for each joint
and a 1, or a 0 in place of the 1: then its motors only damp. Tests run this with a simulated robot at the other end of
a pseudo-terminal. Not tested here: a real port's speed, and what a cable loses."""

from __future__ import annotations

import argparse
import os
import termios
import threading
import tty
from pathlib import Path
from typing import Any

import numpy as np

from sandgait_deploy import Controller, Refused


class Port:
    """Lines of numbers over a serial port. Set its speed before: `stty -F /dev/ttyUSB0 921600 raw`."""

    def __init__(self, file: int) -> None:
        tty.setraw(file, termios.TCSANOW)  # keeps what has come already
        self._in = os.fdopen(os.dup(file), "r", encoding="ascii", newline="\n")
        self._out = os.fdopen(file, "w", encoding="ascii", newline="\n")

    def read(self) -> np.ndarray[Any, np.dtype[np.float64]] | None:
        """The numbers of the next line; None at the end."""
        line = self._in.readline()
        return np.array(line.split(), np.float64) if line.endswith("\n") else None

    def write(self, numbers: Any) -> None:
        self._out.write(" ".join(f"{x:.7g}" for x in numbers) + "\n")
        self._out.flush()

    def close(self) -> None:
        self._in.close()
        self._out.close()


def run(controller: Controller, port: Port, forward: float, steps: int) -> str:
    """Stands up, walks for some steps, and stands. Returns the last state and its reason."""
    count, walked = len(controller.joints), 0
    while (row := port.read()) is not None:
        time, position, speed, rest = row[0], row[1 : 1 + count], row[1 + count : 1 + 2 * count], row[1 + 2 * count :]
        read = {"time": time, "joint_position": position, "joint_velocity": speed}
        read |= {"quaternion": rest[:4], "gyroscope": rest[4:7], "lin_vel": rest[7:10]}
        output = controller.step(read, (forward, 0.0, 0.0))
        if output.targets is None:
            port.write([*np.zeros(count), 0])
        else:
            port.write([*output.targets, 1])
        walked += output.state == "walking"
        if output.state == "ready":
            controller.stand()
        elif output.state == "standing" and not walked:
            controller.walk()
        elif output.state == "walking" and walked >= steps:
            controller.stop()
        elif output.state in ("standing", "fallen", "stopped"):
            return f"{output.state} {output.reason}".strip()
    return "the port was closed"


def simulated(controller: Controller, file: Path, port: Port) -> tuple[Any, threading.Thread]:
    """A robot in MuJoCo at the other end of the port, and its thread, which ends when the port is closed."""
    from sandgait.certify.walk import make_plant
    from sandgait.plant import Conditions

    policy = controller.policy
    plant = make_plant(policy, file, Conditions(ground=str(policy.trained_with["ground"]), latency=0.005), seed=0)
    plant.reset({servo.joint: servo.default for servo in policy.servos})
    own = {name: np.array([getattr(servo, name) for servo in policy.servos]) for name in ("stiffness", "damping")}

    def robot() -> None:
        hangs = True
        while True:
            read = plant.readings()
            names = ("joint_position", "joint_velocity", "quaternion", "gyroscope", "lin_vel")
            try:
                port.write([read["time"], *np.concatenate([read[name] for name in names])])
                row = port.read()
            except (OSError, ValueError):  # the other end is closed
                return
            if row is None:
                return
            hangs &= row[-1] == 0.0
            if hangs:
                plant.wait(1.0 / policy.rate)
            else:
                driven = row[-1] == 1.0
                stiffness = own["stiffness"] * driven
                plant.drive(row[:-1] if driven else None, stiffness, own["damping"], 1.0 / policy.rate)

    thread = threading.Thread(target=robot, daemon=True)
    thread.start()
    return plant, thread


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("policy", type=Path)
    place = parser.add_mutually_exclusive_group(required=True)
    place.add_argument("--port")
    place.add_argument("--simulated", type=Path, metavar="ROBOT.xml")
    parser.add_argument("--forward", type=float, default=0.4, help="commanded speed [m/s]")
    parser.add_argument("--seconds", type=float, default=3.0)
    parser.add_argument("--log", type=Path)
    given = parser.parse_args()
    try:
        from sandgait_deploy import read_policy

        joints = read_policy(given.policy).joints
        with Controller(given.policy, joints=joints, quaternion="wxyz", log=given.log) as controller:
            plant = thread = None
            if given.simulated:
                near, far = os.openpty()
                plant, thread = simulated(controller, given.simulated, Port(near))
            else:
                far = os.open(given.port, os.O_RDWR | os.O_NOCTTY)
            port = Port(far)
            try:
                print(run(controller, port, given.forward, round(given.seconds * controller.policy.rate)))
            finally:
                port.close()
                if thread is not None:
                    thread.join()  # an interpreter that ends while a thread computes in MuJoCo may crash
            if plant is not None:
                print("it is at x = {:.2f} m, y = {:.2f} m, z = {:.2f} m".format(*np.asarray(plant.data.qpos[:3])))
    except Refused as error:
        raise SystemExit(f"deploy_serial: {error}") from None


if __name__ == "__main__":
    main()
