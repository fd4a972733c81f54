"""Runs a policy on a robot behind ros2_control, or on a simulated one.

    python examples/deploy_ros2.py POLICY --simulated ROBOT.xml
    python examples/deploy_ros2.py POLICY          # in a sourced ROS 2, with the controllers below running

The node hears `/joint_states` (sensor_msgs/JointState), `/imu` (sensor_msgs/Imu, its quaternion is x, y, z, w), `/odom`
(nav_msgs/Odometry, velocity of the base in its own frame) and `/cmd_vel` (geometry_msgs/Twist). It publishes the
targets in the order of the policy to `/joint_group_position_controller/commands` (std_msgs/Float64MultiArray); the
parameter `joints` of that controller must have the same order. The gains of policy.json belong into the drives. Tests
run the simulated robot with messages that have the same fields; the functions of `rclpy` were never run here."""

from __future__ import annotations

import argparse
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from sandgait_deploy import Controller, Output, Refused

TOPIC = "/joint_group_position_controller/commands"


class Bridge:
    """From messages to readings, and from the controller's output to a message's numbers."""

    def __init__(self, controller: Controller) -> None:
        self.controller = controller
        self.command = (0.0, 0.0, 0.0)
        self._read: dict[str, Any] = {}

    def heard_joints(self, message: Any) -> None:
        stamp = message.header.stamp
        self._read["time"] = stamp.sec + 1e-9 * stamp.nanosec
        # Joints come by name, in any order, perhaps with others that the policy does not know.
        known = self.controller.policy.joints
        for name, row in (("joint_position", message.position), ("joint_velocity", message.velocity)):
            self._read[name] = {joint: x for joint, x in zip(message.name, row, strict=True) if joint in known}
        if len(message.effort) == len(message.name):
            pairs = zip(message.name, message.effort, strict=True)
            self._read["joint_torque"] = {joint: x for joint, x in pairs if joint in known}

    def heard_imu(self, message: Any) -> None:
        def xyz(vector: Any) -> list[float]:
            return [vector.x, vector.y, vector.z]

        q = message.orientation
        self._read["quaternion"] = [q.x, q.y, q.z, q.w]
        self._read["gyroscope"] = xyz(message.angular_velocity)
        self._read["accelerometer"] = xyz(message.linear_acceleration)

    def heard_odometry(self, message: Any) -> None:
        v = message.twist.twist.linear
        self._read["lin_vel"] = [v.x, v.y, v.z]

    def heard_command(self, message: Any) -> None:
        self.command = (message.linear.x, message.linear.y, message.angular.z)

    def tick(self, now: float) -> Output:
        """One control step; the targets are in the order of `output.joints`."""
        return self.controller.step(self._read, self.command, now=now)


def spin(policy: Path, log: Path | None) -> None:
    """The node. It stands up as soon as readings come, and walks while `/cmd_vel` is not zero."""
    import rclpy
    from geometry_msgs.msg import Twist
    from nav_msgs.msg import Odometry
    from rclpy.qos import qos_profile_sensor_data
    from sensor_msgs.msg import Imu, JointState
    from std_msgs.msg import Float64MultiArray

    rclpy.init()
    node = rclpy.create_node("sandgait_policy")
    with Controller(policy, quaternion="xyzw", log=log) as controller:
        bridge = Bridge(controller)
        publisher = node.create_publisher(Float64MultiArray, TOPIC, 1)
        for kind, topic, heard in (
            (JointState, "/joint_states", bridge.heard_joints),
            (Imu, "/imu", bridge.heard_imu),
            (Odometry, "/odom", bridge.heard_odometry),
            (Twist, "/cmd_vel", bridge.heard_command),
        ):
            node.create_subscription(kind, topic, heard, qos_profile_sensor_data)

        def tick() -> None:
            output = bridge.tick(node.get_clock().now().nanoseconds * 1e-9)
            follow(bridge, output)
            if output.targets is not None:
                publisher.publish(Float64MultiArray(data=output.targets.tolist()))
            elif output.reason:
                node.get_logger().error(output.reason)

        node.create_timer(1.0 / controller.policy.rate, tick)
        rclpy.spin(node)


def follow(bridge: Bridge, output: Output) -> None:
    """Stands up when it may, walks while it is commanded to, and stands otherwise."""
    moving = any(bridge.command)
    if output.state == "ready":
        bridge.controller.stand()
    elif output.state == "standing" and moving:
        bridge.controller.walk()
    elif output.state == "walking" and not moving:
        bridge.controller.stop()


def simulate(policy: Path, file: Path, log: Path | None, seconds: float) -> None:
    """The same bridge with messages of a robot in MuJoCo."""
    from sandgait.certify.walk import make_plant
    from sandgait.plant import Conditions

    with Controller(policy, quaternion="xyzw", log=log) as controller:
        bridge, own = Bridge(controller), controller.policy
        plant = make_plant(own, file, Conditions(ground=str(own.trained_with["ground"]), latency=0.005), seed=0)
        plant.reset({servo.joint: servo.default for servo in own.servos})
        period, output = 1.0 / own.rate, None
        walked = False
        while output is None or output.state not in ("fallen", "stopped"):
            _publish(bridge, plant.readings(), list(reversed(own.joints)), own.joints)
            walking = plant.time < seconds
            bridge.heard_command(_twist(0.5 * own.commands[0, 1] if walking else 0.0))
            output = bridge.tick(plant.time)
            follow(bridge, output)
            walked |= output.state == "walking"
            if output.state in ("checking", "ready"):
                plant.wait(period)
            else:
                plant.drive(output.targets, output.stiffness, output.damping, period)
            if walked and output.state == "standing":
                break
        print(output.state, output.reason)
        print("it is at x = {:.2f} m, y = {:.2f} m, z = {:.2f} m".format(*np.asarray(plant.data.qpos[:3])))


def _publish(bridge: Bridge, read: dict[str, Any], names: list[str], order: tuple[str, ...]) -> None:
    def xyz(row: Any) -> Any:
        return SimpleNamespace(x=row[0], y=row[1], z=row[2])

    place = [order.index(name) for name in names]
    stamp = SimpleNamespace(sec=int(read["time"]), nanosec=round(1e9 * (read["time"] % 1.0)))
    joints = {key: read[f"joint_{key}"][place] for key in ("position", "velocity")}
    effort = read["joint_torque"][place]
    bridge.heard_joints(SimpleNamespace(header=SimpleNamespace(stamp=stamp), name=names, effort=effort, **joints))
    w, x, y, z = read["quaternion"]
    orientation = SimpleNamespace(x=x, y=y, z=z, w=w)
    motion = {"angular_velocity": xyz(read["gyroscope"]), "linear_acceleration": xyz(read["accelerometer"])}
    bridge.heard_imu(SimpleNamespace(orientation=orientation, **motion))
    twist = SimpleNamespace(twist=SimpleNamespace(linear=xyz(read["lin_vel"])))
    bridge.heard_odometry(SimpleNamespace(twist=twist))


def _twist(forward: float) -> Any:
    return SimpleNamespace(linear=SimpleNamespace(x=forward, y=0.0), angular=SimpleNamespace(z=0.0))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("policy", type=Path)
    parser.add_argument("--simulated", type=Path, metavar="ROBOT.xml")
    parser.add_argument("--seconds", type=float, default=6.0, help="end of the simulated walk")
    parser.add_argument("--log", type=Path)
    given = parser.parse_args()
    try:
        if given.simulated:
            simulate(given.policy, given.simulated, given.log, given.seconds)
        else:
            spin(given.policy, given.log)
    except Refused as error:
        raise SystemExit(f"deploy_ros2: {error}") from None


if __name__ == "__main__":
    main()
