"""Evaluates policies and gaits without learning: returns and speeds over seeds that no training uses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

import sandgait

GAIT = "sandgait/HexapodGait-v1"

#: Training uses small seeds; the seeds of an evaluation start here.
FIRST_SEED = 1_000_000

#: A robot with a lower speed [m/s] counts as standing: a tenth of the slowest command.
LEAST_SPEED = 0.01

Rows = npt.NDArray[np.float32]
Values = npt.NDArray[np.float64]
#: From observations [num_envs, observation] to actions [num_envs, action].
Policy = Callable[[Rows], npt.NDArray[Any]]


@dataclass
class Score:
    """Results of one gait; each array has one entry for each episode."""

    name: str
    #: Sum of rewards.
    returns: Values
    #: Mean speed along x, uphill [m/s].
    speed: Values
    #: Commanded forward speed [m/s].
    commanded: Values
    #: Mechanical power [W].
    power: Values
    #: Mechanical work / (weight · distance); NaN if the robot stands or the task has no figure for the weight.
    cost_of_transport: Values
    #: Did the robot overturn or sink?
    fell: npt.NDArray[np.bool_]

    @property
    def error(self) -> Values:
        """|mean speed − commanded speed| [m/s]."""
        return np.abs(self.speed - self.commanded)

    @property
    def relative_error(self) -> Values:
        """|mean speed − commanded speed| / |commanded speed|."""
        with np.errstate(divide="ignore"):
            return self.error / np.abs(self.commanded)

    def summary(self) -> dict[str, Any]:
        """Means, and the half width of the return's 95 % interval."""
        names = ("speed", "relative_error", "power", "cost_of_transport")
        figures = {name: float(getattr(self, name).mean()) for name in names}
        mean, half = float(self.returns.mean()), half_width(self.returns)
        figures = {name: value for name, value in figures.items() if np.isfinite(value)}
        return {"episodes": len(self.returns), "return": mean, "return_95": half, **figures}


def evaluate(
    name: str, policy: Policy, task: str = GAIT, address: str | None = None, seeds: int = 100, **options: Any
) -> Score:
    """Runs one episode for each of `seeds` seeds that no training uses."""
    env = sandgait.SandgaitVectorEnv(task, seeds, address, **options)
    observations, _ = env.reset(seed=FIRST_SEED)
    # A robot of LeggedVelocity turns, so its speed is measured along its base. Its command has three parts.
    turns = "command_lin_vel_x" in [column.name for column in env.task.info]
    moved, wanted = ("speed", "command_lin_vel_x") if turns else ("x_velocity", "commanded_speed")
    sums = {key: np.zeros(seeds) for key in ("reward", "steps", moved, wanted, "work")}
    fell = np.zeros(seeds, dtype=np.bool_)
    running = np.ones(seeds, dtype=np.bool_)
    while running.any():
        observations, rewards, terminated, truncated, infos = env.step(policy(observations))
        values: dict[str, Any] = {**infos, "reward": rewards, "steps": 1.0}
        for key in sums:
            sums[key] += np.where(running, values[key], 0.0)
        fell |= running & terminated
        running &= ~(terminated | truncated)
    env.close()
    steps = sums["steps"]
    speed, power = sums[moved] / steps, sums["work"] / steps * env.task.control_rate
    moving = np.where(speed > LEAST_SPEED, speed, np.nan)
    cost = power / (infos.get("weight", np.nan) * moving)
    return Score(name, sums["reward"], speed, sums[wanted] / steps, power, cost, fell)


def constant_rate(frequency: float) -> Policy:
    """An alternating tripod whose legs turn at a constant rate [Hz]. Episodes begin with the two tripods half a turn
    apart."""
    return lambda rows: np.full((len(rows), 6), frequency / 5.0)


def random_actions(width: int, seed: int = 0) -> Policy:
    """Draws uniform actions in every step."""
    generator = np.random.default_rng(seed)
    return lambda rows: generator.uniform(-1.0, 1.0, (len(rows), width))


def learnt(model: Any, normalize: Any) -> Policy:
    """The policy of a stable-baselines3 model without exploration, with the VecNormalize of its training."""
    return lambda rows: model.predict(normalize.normalize_obs(rows), deterministic=True)[0]


def best_tripod(address: str | None = None, **options: Any) -> Score:
    """The tripod whose constant rate has the highest return. Rates are at most the motors' 5 Hz."""
    options = {**options, "control": "hip_speed"}
    tripods = [
        evaluate(f"tripod at {f:.2f} Hz, the best rate", constant_rate(f), GAIT, address, **options)
        for f in np.arange(0.25, 5.01, 0.25)
    ]
    return max(tripods, key=lambda s: float(s.returns.mean()))


def compare(task: str, address: str | None = None, **options: Any) -> list[Score]:
    """Evaluates gaits without learning, with the motors and the seeds of the learnt gait's evaluation."""
    env = sandgait.SandgaitVectorEnv(task, 1, address, **options)
    width = len(env.task.action)
    env.close()
    tripod = [best_tripod(address, **options)] if task == GAIT else []
    return [*tripod, evaluate("random actions", random_actions(width), task, address, **options)]


def half_width(values: npt.NDArray[Any]) -> float:
    """Half width of the 95 % interval of the mean."""
    return float(1.96 * np.std(values, ddof=1) / np.sqrt(len(values)))


def interval(values: npt.NDArray[Any], digits: int) -> str:
    """Mean and the half width of its 95 % interval."""
    return f"{np.mean(values):.{digits}f} ± {half_width(values):.{digits}f}"


def table(scores: list[Score]) -> str:
    """A table with one line for each gait."""
    head = ("gait", "return", "speed [m/s]", "speed error [m/s]", "error [%]", "power [W]", "cost of transport", "fell")
    rows = [
        (
            score.name,
            interval(score.returns, 1),
            interval(score.speed, 3),
            interval(score.error, 3),
            interval(100 * score.relative_error, 1),
            interval(score.power, 2),
            interval(score.cost_of_transport, 2),
            f"{100 * score.fell.mean():.0f} %",
        )
        for score in scores
    ]
    widths = [max(len(row[k]) for row in (head, *rows)) for k in range(len(head))]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in (head, *rows)]
    return "\n".join([lines[0], "  ".join("─" * width for width in widths), *lines[1:]])
