"""The golden trace: one walk of the simulator, by which a program that runs the policy is checked.

`golden.csv` beside `policy.json` has a row for each control step: readings, observation, action, targets and the
torques that the servos' law demands. A program is right if at each boundary it turns the left side of the row into the
right side. This module checks this package; ten lines in any other language do the same with the same file."""

from __future__ import annotations

import csv
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .errors import Refused
from .network import Network
from .observer import Observer
from .policy import Floats, Policy
from .readings import gravity

#: Largest difference at each boundary. Observations: rounding to 32 bits of numbers up to 100. Actions: our choice,
#: some ten units in the last place of 1, which other orders of summation need. Targets, torques: the action's, times
#: scale and stiffness, and rounding.
TOLERANCES = {"observation": 1e-5, "action": 1e-5, "target": 1e-5, "effort": 1e-2}


@dataclass(frozen=True)
class Boundary:
    """The comparison of one boundary over all rows of the trace."""

    name: str
    #: Largest difference, and the column and row where it is.
    worst: float
    column: str
    row: int
    tolerance: float
    #: Are all numbers equal to the last bit?
    identical: bool

    @property
    def holds(self) -> bool:
        return self.worst <= self.tolerance

    def __str__(self) -> str:
        if self.identical:
            return f"{self.name}: equal to the last bit"
        verdict = "within" if self.holds else "BEYOND"
        return (
            f"{self.name}: differs by {self.worst:.3g} in {self.column}, row {self.row} ({verdict} {self.tolerance:g})"
        )


@dataclass(frozen=True)
class Verification:
    """The result of `verify`. It is true if every boundary holds."""

    boundaries: tuple[Boundary, ...]

    def __bool__(self) -> bool:
        return all(boundary.holds for boundary in self.boundaries)

    def __str__(self) -> str:
        return "\n".join(map(str, self.boundaries))


def verify(policy: Policy, network: Network) -> Verification:
    """Compares this package's observations, actions, targets and torques with those of the golden trace."""
    trace = read_trace(policy)
    rows = len(trace["t"])
    wanted = {name: _block(trace, name, policy) for name in ("observation", "action", "target", "effort")}
    made: dict[str, list[npt.NDArray[np.floating]]] = {name: [] for name in wanted}
    observer = Observer(policy)
    observation, action = wanted["observation"].astype(np.float32), wanted["action"].astype(np.float32)
    positions = np.array([trace[f"q:{joint}"] for joint in policy.joints]).T
    for k in range(rows):
        read, command = _readings(policy, trace, k, observation[k])
        seen = observation[0]  # what was before the first row is not in the trace
        if k > 0:
            observer.remember(observation[k - 1], positions[k - 1])
            seen = observer.observe(read, command, action[k - 1], float(trace["t"][k]))
        made["observation"].append(seen)
        made["action"].append(np.clip(network.act(observation[k]), policy.action_low, policy.action_high))
        made["target"].append(policy.target(action[k]).astype(np.float32))
        driven = policy.driven
        torque = policy.torque(
            policy.target(action[k]), read["joint_position"][driven], trace_joints(trace, "qd", policy, k)
        )
        made["effort"].append(torque.astype(np.float32))
    return Verification(tuple(_boundary(name, np.array(made[name]), wanted[name], policy) for name in wanted))


def read_trace(policy: Policy) -> dict[str, Floats]:
    """The columns of `golden.csv` by name."""
    path = policy.folder / "golden.csv"
    try:
        with path.open(encoding="utf-8", newline="") as file:
            names, *rows = list(csv.reader(file))
        table = np.array(rows, np.float64).reshape(len(rows), len(names))
    except FileNotFoundError:
        raise Refused(
            f"{path}: there is no golden trace; make it: python -m sandgait_deploy describe {policy.folder}"
        ) from None
    except (OSError, ValueError) as error:
        raise Refused(f"{path}: is no golden trace ({error}); python -m sandgait_deploy describe writes it") from None
    return dict(zip(names, table.T, strict=True))


def trace_joints(trace: dict[str, Floats], kind: str, policy: Policy, row: int) -> Floats:
    """Values of the driven joints in a row of the trace."""
    return np.array([trace[f"{kind}:{servo.joint}"][row] for servo in policy.servos])


def _readings(
    policy: Policy, trace: dict[str, Floats], k: int, observation: npt.NDArray[np.float32]
) -> tuple[dict[str, Floats], Floats]:
    def row(*names: str) -> Floats:
        return np.array([trace[name][k] for name in names])

    read = {
        "gravity": gravity(row("quat_w", "quat_x", "quat_y", "quat_z")),
        "lin_vel": row("lin_vel_x", "lin_vel_y", "lin_vel_z"),
        "gyroscope": row("gyro_x", "gyro_y", "gyro_z"),
        "joint_position": row(*(f"q:{joint}" for joint in policy.joints)),
        "joint_velocity": row(*(f"qd:{joint}" for joint in policy.joints)),
        "joint_torque": row(*(f"tau:{joint}" for joint in policy.joints)),
    }
    # Readings of other sensors are in the observation itself.
    width = len(policy.observation) // policy.history
    for reading in {c.reading for c in policy.observation} - set(read) - {"command", "last_action", "clock"}:
        places = [i for i, c in enumerate(policy.observation[:width]) if c.reading == reading]
        read[reading] = observation[places].astype(np.float64)
    return read, row("command_x", "command_y", "command_yaw")


def _names(name: str, policy: Policy) -> list[str]:
    if name in ("target", "effort"):
        return [f"{name}:{servo.joint}" for servo in policy.servos]
    count = len(policy.observation) if name == "observation" else policy.actions
    return [f"{'obs' if name == 'observation' else name}:{k}" for k in range(count)]


def _block(trace: dict[str, Floats], name: str, policy: Policy) -> Floats:
    missing = [column for column in _names(name, policy) if column not in trace]
    if missing:
        raise Refused(f"{policy.folder / 'golden.csv'}: has no column {missing[0]!r}; it belongs to another policy: "
                      f"python -m sandgait_deploy describe {policy.folder}")  # fmt: skip
    return np.array([trace[column] for column in _names(name, policy)]).T


def _boundary(name: str, made: npt.NDArray[np.floating], wanted: Floats, policy: Policy) -> Boundary:
    difference = np.abs(made.astype(np.float64) - wanted)
    row, place = np.unravel_index(int(np.argmax(difference)), difference.shape)
    identical = bool((made.astype(np.float32) == wanted.astype(np.float32)).all())
    columns = {"observation": [c.name for c in policy.observation]}.get(name) or _names(name, policy)
    return Boundary(name, float(difference.max()), columns[place], int(row), TOLERANCES[name], identical)
