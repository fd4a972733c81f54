"""Runs a policy of `sandgait train` on a robot. Needs numpy, and no simulator.

    from sandgait_deploy import Controller

    controller = Controller("runs/go1", joints=ORDER_OF_THE_ROBOT, quaternion="wxyz", log="walk.csv")
    print(controller.verify())                      # equal to the golden trace of the training?
    output = controller.step(readings)              # ten times: the readings are checked, nothing moves
    controller.stand()                              # then step until output.state is "standing"
    controller.walk()
    output = controller.step(readings, command=(0.5, 0.0, 0.0))

`sandgait.deploy` is the same module. The folder `sandgait_deploy` can be copied to a robot as it is.
"""

from __future__ import annotations

from .controller import Controller, Output
from .errors import Refused
from .golden import Boundary, Verification, verify
from .policy import Column, Policy, Servo, policy_folder, read_policy

__all__ = [
    "Boundary",
    "Column",
    "Controller",
    "Output",
    "Policy",
    "Refused",
    "Servo",
    "Verification",
    "policy_folder",
    "read_policy",
    "verify",
]
