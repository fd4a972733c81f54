"""How good is a gait? Returns and speeds over seeds that no training saw, for policies and for gaits without any."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

import sandgait

ID = "sandgait/HexapodGait-v0"

#: Training takes small seeds; evaluation starts here.
FIRST_SEED = 1_000_000

Rows = npt.NDArray[np.float32]
#: From observations [num_envs, observation] to actions [num_envs, action].
Policy = Callable[[Rows], npt.NDArray[Any]]


@dataclass
class Score:
    """Of one gait; each array has one entry an episode."""

    name: str
    #: Sum of rewards.
    returns: npt.NDArray[np.float64]
    #: Mean forward speed [m/s].
    speed: npt.NDArray[np.float64]
    #: |mean speed − commanded speed| [m/s].
    error: npt.NDArray[np.float64]
    #: Mechanical power [W].
    power: npt.NDArray[np.float64]
    #: Whether the robot flipped or sank.
    fell: npt.NDArray[np.bool_]


def evaluate(name: str, policy: Policy, seeds: int = 100, address: str | None = None, **options: Any) -> Score:
    """Plays one episode for each of `seeds` unseen seeds."""
    env = sandgait.SandgaitVectorEnv(ID, seeds, address, **options)
    observations, _ = env.reset(seed=FIRST_SEED)
    sums = {key: np.zeros(seeds) for key in ("reward", "steps", "speed", "commanded_speed", "work")}
    fell = np.zeros(seeds, dtype=np.bool_)
    running = np.ones(seeds, dtype=np.bool_)
    while running.any():
        observations, rewards, terminated, truncated, infos = env.step(policy(observations))
        final = infos.get("final_info", {})
        values: dict[str, Any] = {"reward": rewards, "steps": 1.0}
        for key in ("speed", "commanded_speed", "work"):  # a column is 0 where its mask is not set
            values[key] = infos.get(key, 0.0) + final.get(key, 0.0)
        for key, value in values.items():
            sums[key] += np.where(running, value, 0.0)
        fell |= running & terminated
        running &= ~(terminated | truncated)
    env.close()
    steps = sums["steps"]
    speed, commanded = sums["speed"] / steps, sums["commanded_speed"] / steps
    power = sums["work"] / steps * env.task.control_rate
    return Score(name, sums["reward"], speed, np.abs(speed - commanded), power, fell)


def constant_rate(frequency: float) -> Policy:
    """Alternating tripod whose legs turn at one rate [Hz]: episodes begin with the two tripods half a turn apart."""
    return lambda rows: np.full((len(rows), 6), frequency / 5.0)


def random_actions(seed: int = 0) -> Policy:
    """Uniform in the action space, anew in every step."""
    generator = np.random.default_rng(seed)
    return lambda rows: generator.uniform(-1.0, 1.0, (len(rows), 6))


def learnt(model: Any, normalize: Any) -> Policy:
    """A stable-baselines3 model behind the VecNormalize it was trained with, without exploration."""
    return lambda rows: model.predict(normalize.normalize_obs(rows), deterministic=True)[0]


def interval(values: npt.NDArray[Any], digits: int) -> str:
    """Mean and the half width of its 95 % interval."""
    half = 1.96 * np.std(values, ddof=1) / np.sqrt(len(values))
    return f"{np.mean(values):.{digits}f} ± {half:.{digits}f}"


def table(scores: list[Score]) -> str:
    """One line a gait."""
    head = ("gait", "return", "speed [m/s]", "speed error [m/s]", "power [W]", "fell")
    rows = [
        (
            score.name,
            interval(score.returns, 1),
            interval(score.speed, 3),
            interval(score.error, 3),
            interval(score.power, 2),
            f"{100 * score.fell.mean():.0f} %",
        )
        for score in scores
    ]
    widths = [max(len(row[k]) for row in (head, *rows)) for k in range(len(head))]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in (head, *rows)]
    return "\n".join([lines[0], "  ".join("─" * width for width in widths), *lines[1:]])
