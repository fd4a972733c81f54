"""Walks of a policy in MuJoCo: the Controller of `sandgait.deploy` drives a `Plant`."""

from __future__ import annotations

import copy
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from sandgait_deploy import Controller, Policy, Refused
from sandgait_deploy.controller import CHECKS

from ..plant import Conditions, Motors, Plant

Command = tuple[float, float, float]

#: Duration of a walk, and the time at its start that is not counted [s]: our choice, because a robot walks steadily
#: after a second.
SECONDS, BEGINNING = 4.0, 1.5

#: Mean error up to which a robot counts as following its commands: that of the curriculum of LeggedVelocity, whose
#: level rises up to it (`docs/robots.md`).
FOLLOWS = 0.4

#: Difference of the masses above which a file is of another robot, as a part of the mass: our choice.
_OTHER_MASS = 0.05

#: Longest time in which the robot rises and is checked [s]: our choice, twice what it takes.
_RISES = 4.5


@dataclass(frozen=True)
class Wiring:
    """A wrong connection between robot and policy, for counterfactuals."""

    name: str = ""
    #: For each joint of the policy the joint whose encoder and motor it gets.
    joints: tuple[int, ...] | None = None
    #: Names of readings that are reversed, and of readings that are given in the world's frame.
    reversed: tuple[str, ...] = ()
    turned: tuple[str, ...] = ()


@dataclass(frozen=True)
class Line:
    """How one command was followed: forward, to the left [m/s] and yaw rate [rad/s]."""

    command: Command
    velocity: Command
    #: |velocity − command| / |command|, where 1 rad/s counts as much as 1 m/s.
    error: float
    fell: bool


@dataclass(frozen=True)
class Outcome:
    """The walks under some conditions."""

    conditions: Conditions
    lines: tuple[Line, ...]
    #: Largest torque as a part of its limit, largest speed [rad/s] and rms torque as a part of the limit, each with its
    #: joint.
    torque: tuple[float, str] = (0.0, "")
    speed: tuple[float, str] = (0.0, "")
    load: tuple[float, str] = (0.0, "")
    #: Why nothing was walked; empty otherwise.
    refused: str = ""

    @property
    def error(self) -> float:
        return float(np.mean([line.error for line in self.lines])) if self.lines else float("inf")

    @property
    def worst(self) -> float:
        return max((line.error for line in self.lines), default=float("inf"))

    @property
    def falls(self) -> int:
        return sum(line.fell for line in self.lines)

    @property
    def holds(self) -> bool:
        return not self.refused and self.falls == 0 and self.worst <= FOLLOWS

    @property
    def words(self) -> str:
        if self.refused:
            return f"does not start: {self.refused}"
        fell = f", falls in {self.falls} of {len(self.lines)}" if self.falls else ""
        return f"mean error {100 * self.error:.0f} %, worst {100 * self.worst:.0f} %{fell}"


@dataclass(frozen=True)
class Job:
    """Walks to be made, for a process of its own."""

    folder: str
    robot: str
    conditions: Conditions
    commands: tuple[Command, ...]
    seed: int = 0
    wiring: Wiring = field(default_factory=Wiring)


def all_outcomes(jobs: Sequence[Job], told: Callable[[int, int], None], processes: int | None = None) -> list[Outcome]:
    """The outcomes of all jobs, in their order. `told` is called with the numbers of finished and of all jobs."""
    count = processes or os.cpu_count() or 1
    if count == 1 or len(jobs) == 1:
        return _counted(map(outcome, jobs), len(jobs), told)
    with ProcessPoolExecutor(min(count, len(jobs)), mp_context=get_context("spawn")) as pool:
        return _counted(pool.map(outcome, jobs), len(jobs), told)


def _counted(outcomes: Iterable[Outcome], count: int, told: Callable[[int, int], None]) -> list[Outcome]:
    made = []
    for one in outcomes:
        made.append(one)
        told(len(made), count)
    return made


def make_plant(policy: Policy, robot: str | Path, conditions: Conditions, seed: int) -> Plant:
    """The robot of the file `robot` with the motors of the policy."""
    limits = [[s.torque_limit, s.stall_torque, s.no_load_speed] for s in policy.servos]
    motors = Motors(*np.array(limits).T)
    driven = tuple(servo.joint for servo in policy.servos)
    plant = Plant(robot, driven, policy.joints, motors, conditions, seed)
    mass, own = float(plant.model.body_mass.sum()) / (1.0 + conditions.payload), float(policy.robot["mass"])
    if abs(mass - own) > _OTHER_MASS * own:
        raise Refused(
            f"robot: {robot} weighs {mass:.4g} kg in MuJoCo, the policy's robot {own:.4g} kg: give the same file"
        )
    return plant


def outcome(job: Job) -> Outcome:
    """Makes the walks of a job."""
    controller = Controller(job.folder, joints=None, quaternion="wxyz")
    policy = controller.policy
    plant = make_plant(policy, job.robot, job.conditions, job.seed)
    wires = _Wires(policy, plant, job.wiring)
    try:
        _rise(controller, plant, wires)
    except Refused as error:
        return Outcome(job.conditions, (), refused=str(error))
    if controller.state != "standing":
        return Outcome(job.conditions, (), refused=controller.reason or "it does not stand")
    start = plant.save()
    lines = []
    small = 0.1 * float(np.abs(policy.commands).max())
    for command in job.commands:
        plant.load(start)
        walker = copy.deepcopy(controller)
        walker.walk()
        lines.append(_follow(walker, plant, wires, command, small))
    limits = np.array([servo.torque_limit for servo in policy.servos])
    torque, load = plant.most_torque / limits, plant.rms_torque / limits

    def most(values: Any) -> tuple[float, str]:
        place = int(np.argmax(values))
        return float(values[place]), policy.servos[place].joint

    return Outcome(job.conditions, tuple(lines), most(torque), most(plant.most_speed), most(load))


def record(job: Job, log: Path, seconds: float = 5.0) -> bool:
    """Writes the log of a robot that follows the job's commands one after another, for so many seconds each, as its
    Controller writes it; between two of them it stops and stands. Returns whether it did not fall."""
    with Controller(job.folder, quaternion="wxyz", log=log) as controller:
        policy = controller.policy
        plant = make_plant(policy, job.robot, job.conditions, job.seed)
        wires, period = _Wires(policy, plant, job.wiring), 1.0 / policy.rate
        _rise(controller, plant, wires)
        for command in job.commands:
            if controller.state != "standing":
                return False
            controller.walk()
            for _ in range(round(seconds / period)):
                wires.drive(controller.step(wires.readings(), command, now=plant.time), period)
            controller.stop()
            while controller.state in ("stopping", "rising"):
                wires.drive(controller.step(wires.readings(), now=plant.time), period)
        return controller.state == "standing"


class _Wires:
    """What the controller gets from the plant, and the plant from the controller."""

    def __init__(self, policy: Policy, plant: Plant, wiring: Wiring) -> None:
        self._policy, self._plant, self._wiring = policy, plant, wiring
        self._joints = list(wiring.joints or range(len(policy.joints)))
        driven = policy.driven
        # Place of each driven joint among the plant's, which are the policy's driven joints.
        self._targets = [driven.index(self._joints[place]) for place in driven]

    def readings(self) -> Mapping[str, Any]:
        read = self._plant.readings()
        for name in ("joint_position", "joint_velocity", "joint_torque"):
            read[name] = dict(zip(self._policy.joints, read[name][self._joints], strict=True))
        for name in self._wiring.reversed:
            if name == "gravity":
                read["quaternion"] = read["quaternion"] * [1.0, -1.0, -1.0, 1.0]
            else:
                read[name] = -read[name]
        for name in self._wiring.turned:
            read[name] = self._plant.to_world(read[name])
        return read

    def drive(self, output: Any, seconds: float, held: bool = False) -> None:
        def wired(values: Any) -> Any:
            out = np.empty(len(values))
            out[self._targets] = values
            return out

        targets = None if output.targets is None else wired(output.targets)
        self._plant.drive(targets, wired(output.stiffness), wired(output.damping), seconds, held)


def _rise(controller: Controller, plant: Plant, wires: _Wires) -> None:
    """Held by hand while the readings are checked, then rising to the default pose. A robot on two feet hangs in a
    gantry until it walks, because a stiff pose does not balance it."""
    policy = controller.policy
    period, held = 1.0 / policy.rate, len(policy.robot["feet"] or ()) == 2
    plant.reset({servo.joint: servo.default for servo in policy.servos})
    for _ in range(CHECKS):
        controller.step(wires.readings(), now=plant.time)
        plant.wait(period)
    controller.stand()
    for _ in range(round(_RISES * policy.rate)):
        wires.drive(controller.step(wires.readings(), now=plant.time), period, held)
        if controller.state != "rising":
            return


def _follow(controller: Controller, plant: Plant, wires: _Wires, command: Command, small: float) -> Line:
    period = 1.0 / controller.policy.rate
    first, steps = round(BEGINNING / period), round(SECONDS / period)
    sums = np.zeros(3)
    for step in range(steps):
        output = controller.step(wires.readings(), command, now=plant.time)
        if output.state != "walking":
            return Line(command, (0.0, 0.0, 0.0), 1.0, True)
        wires.drive(output, period)
        if step >= first:
            sums += plant.velocity
    velocity = sums / (steps - first)
    error = float(np.linalg.norm(velocity - command)) / max(float(np.linalg.norm(command)), small)
    return Line(command, tuple(velocity.tolist()), error, False)
