"""The strength of the motors, from a Controller's log: it has the targets, so the torque that the servos demanded is
known, and a motor that gives less than its drive believes shows it.

The log must have measured torques. The torque at the time of a reading follows the target of an earlier step:
τ = s (kp (target − q) − kd q̇) = s d. s is fitted over the samples in which the demanded torque d is within the limit;
its interval comes from blocks of a second, whose slopes are independent.

Readings q and q̇ have noise, and least squares of τ on a noisy d would find s too small: by 5 % with legged_gym's noise.
So s is fitted with an instrument (Wright 1928): s = Σ z τ / Σ z d, where z is the torque that the same targets demand
at the readings of the step before, whose noise is another.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from sandgait_deploy import Policy

Array = npt.NDArray[np.float64]

#: Steps between the target and the torque that are tried: our choice, up to 80 ms at 50 Hz.
DELAYS = range(1, 5)

#: Fewest blocks, and the least share of the torques' variance that the law must explain: our choices; below them the
#: torques are not those of these servos.
_BLOCKS, _EXPLAINED = 5, 0.8

#: Standard deviation of what all samples share: our choice. In MuJoCo a torque that is read 1 ms before the position
#: gives a slope that is 1 to 2 % too large.
_SYSTEMATIC = 0.01


@dataclass(frozen=True)
class Motors:
    """Factor of the motors' torques on the demanded ones, with its 95 % interval, and the age of the targets."""

    strength: float
    interval: tuple[float, float]
    #: In control steps: 1 stands for any latency of less than a step.
    steps: int
    #: Share of the torques' variance that the law explains.
    explained: float

    @property
    def differ(self) -> bool:
        """Does the interval exclude 1?"""
        return not self.interval[0] <= 1.0 <= self.interval[1]


def motors(log: Path, policy: Policy) -> Motors | None:
    """The motors' strength; None if the log has no targets and torques, or the servos' law does not explain these."""
    columns = table(log)
    joints = [servo.joint for servo in policy.servos]
    needed = [f"{kind}:{joint}" for kind in ("target", "q", "qd", "tau") for joint in joints]
    if any(name not in columns or np.isnan(columns[name]).any() for name in needed):
        return None
    target, position, velocity, torque = (
        np.array([columns[f"{kind}:{joint}"] for joint in joints]).T for kind in ("target", "q", "qd", "tau")
    )
    runs = columns["run"] if "run" in columns else np.zeros(len(torque))
    fits = [_fit(policy, _delayed(target, runs, steps), position, velocity, torque, steps) for steps in DELAYS]
    best = max(fits, key=lambda fit: fit.explained if fit else -np.inf)
    return best if best is not None and best.explained >= _EXPLAINED else None


def action_delay(found: Motors | None, policy: Policy) -> tuple[float, float] | None:
    """Ends of the time from an action to the motors [s]; None if it is not above that of the training. A log with a row
    for each control step does not show which part of a step it is, so not any delay of less than a step."""
    if found is None or found.steps == 1:
        return None
    low, high = (found.steps - 1) / policy.rate, found.steps / policy.rate
    return None if policy.trained_with["action_delay"][1] >= high else (low, high)


def _fit(policy: Policy, target: Array, position: Array, velocity: Array, torque: Array, steps: int) -> Motors | None:
    kp = np.array([servo.stiffness for servo in policy.servos])
    kd = np.array([servo.damping for servo in policy.servos])
    limit = np.array([servo.torque_limit for servo in policy.servos])
    demanded = kp * (target - position) - kd * velocity
    before = np.full_like(demanded, np.nan)
    before[1:] = kp * (target[1:] - position[:-1]) - kd * velocity[:-1]
    within = np.isfinite(demanded) & np.isfinite(before) & (np.abs(demanded) < 0.9 * limit)
    block = np.arange(len(torque)) // max(1, round(policy.rate))
    slopes = []
    for number in np.unique(block):
        chosen = within & (block == number)[:, None]
        if chosen.sum() >= 10 * len(kp):
            slopes.append(float((before[chosen] @ torque[chosen]) / (before[chosen] @ demanded[chosen])))
    if len(slopes) < _BLOCKS:
        return None
    strength = float(np.mean(slopes))
    half = 1.96 * float(np.hypot(np.std(slopes, ddof=1) / len(slopes) ** 0.5, _SYSTEMATIC))
    rest = torque[within] - strength * demanded[within]
    explained = 1.0 - float(rest.var() / torque[within].var())
    return Motors(strength, (strength - half, strength + half), steps, explained)


def _delayed(target: Array, runs: Array, steps: int) -> Array:
    """The target of so many steps earlier in the same run; NaN where there is none."""
    out = np.full_like(target, np.nan)
    out[steps:] = target[:-steps]
    out[steps:][runs[steps:] != runs[:-steps]] = np.nan
    return out


def table(log: Path) -> dict[str, Array]:
    """Columns by name; runs are numbered in their order, and blank cells are NaN. Empty if it is no CSV of numbers."""
    try:
        with log.open(encoding="utf-8", newline="") as file:
            names, *rows = list(csv.reader(file))
        columns = dict(zip(names, zip(*rows, strict=True), strict=True))
    except (OSError, ValueError):
        return {}
    known: dict[str, float] = {}
    runs = [known.setdefault(name, float(len(known))) for name in columns.pop("run", ())]
    found = {} if not runs else {"run": np.array(runs)}
    for name, column in columns.items():
        try:
            found[name] = np.array([float(x) if x else np.nan for x in column])
        except ValueError:  # a column of words
            continue
    return found
