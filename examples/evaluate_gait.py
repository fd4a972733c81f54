"""How good is a gait? Returns and speeds over seeds that no training uses, for policies and for gaits without
learning."""

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

#: Below this [m/s] a robot stands: a tenth of the slowest command.
LEAST_SPEED = 0.01

Rows = npt.NDArray[np.float32]
Values = npt.NDArray[np.float64]
#: From observations [num_envs, observation] to actions [num_envs, action].
Policy = Callable[[Rows], npt.NDArray[Any]]


@dataclass
class Score:
    """Results of one gait; each array has one entry an episode."""

    name: str
    #: Sum of rewards.
    returns: Values
    #: Mean speed along x, uphill [m/s].
    speed: Values
    #: Commanded forward speed [m/s].
    commanded: Values
    #: Mechanical power [W].
    power: Values
    #: Mechanical work / (weight · distance); NaN where the robot stands or the task does not tell the weight.
    cost_of_transport: Values
    #: Whether the robot flipped or sank.
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
    """Plays one episode for each of `seeds` unseen seeds."""
    env = sandgait.SandgaitVectorEnv(task, seeds, address, **options)
    observations, _ = env.reset(seed=FIRST_SEED)
    # LeggedVelocity turns, so its speed is that along the base, and its command has three parts.
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
    """Alternating tripod whose legs turn at one rate [Hz]: episodes begin with the two tripods half a turn apart."""
    return lambda rows: np.full((len(rows), 6), frequency / 5.0)


def random_actions(width: int, seed: int = 0) -> Policy:
    """Uniform in the action space, anew in every step."""
    generator = np.random.default_rng(seed)
    return lambda rows: generator.uniform(-1.0, 1.0, (len(rows), width))


def learnt(model: Any, normalize: Any) -> Policy:
    """A stable-baselines3 model with the VecNormalize of its training, without exploration."""
    return lambda rows: model.predict(normalize.normalize_obs(rows), deterministic=True)[0]


def best_tripod(address: str | None = None, **options: Any) -> Score:
    """The constant rate with the highest return, up to the motors' 5 Hz."""
    options = {**options, "control": "hip_speed"}
    tripods = [
        evaluate(f"tripod at {f:.2f} Hz, the best rate", constant_rate(f), GAIT, address, **options)
        for f in np.arange(0.25, 5.01, 0.25)
    ]
    return max(tripods, key=lambda s: float(s.returns.mean()))


def compare(task: str, address: str | None = None, **options: Any) -> list[Score]:
    """Gaits without learning, with the same motors and the same unseen seeds as a learnt gait."""
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
    """One line a gait."""
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
