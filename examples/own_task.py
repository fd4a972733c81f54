"""A task of your own in numpy: observations, rewards and ends of episodes from the columns of a sandgait environment.

    python examples/own_task.py

`Climb` rewards the height that a hexapod gains, minus the cost of its work. The policy observes the direction of
gravity and the hips, but not the robot's speed. An episode ends when the robot tilts too far. HexapodGait does the
simulation. This file computes everything else, for all environments together.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

import sandgait

#: The policy observes those columns of HexapodGait whose names begin with these words.
SEEN = ("gravity direction", "sine of hip angle", "cosine of hip angle", "hip speed", "previous action")

#: Cost of one joule of the hips' work [J]; tilt that ends an episode [rad]; cost of such an end [J].
WORK_PRICE, LARGEST_TILT, FALL_PRICE = 0.2, 1.0, 5.0


class Climb(VectorEnv[Any, Any, Any]):
    """Rewards the gain of height minus the cost of the work, on a slope of 10°."""

    metadata = {"autoreset_mode": AutoresetMode.SAME_STEP}

    def __init__(self, num_envs: int, **options: Any) -> None:
        self.slope = np.radians(options.setdefault("slope_deg", 10.0))
        self.simulation = sandgait.SandgaitVectorEnv("sandgait/HexapodGait-v1", num_envs, **options)
        task, self.num_envs = self.simulation.task, num_envs
        self.info = {column.name: i for i, column in enumerate(task.info)}
        seen = [i for i, column in enumerate(task.observation) if column.name.startswith(SEEN)]
        names = [column.name for column in task.observation]
        self.seen, self.up = np.array(seen), names.index("gravity direction, body frame, z")
        low, high = (np.array([getattr(task.observation[i], end) for i in seen], np.float32) for end in ("low", "high"))
        self.single_observation_space, self.single_action_space = Box(low, high), self.simulation.single_action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = self.simulation.action_space
        self.period = 1.0 / task.control_rate

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begins episodes; returns their first observations."""
        observations, _ = self.simulation.reset(seed=seed, options=options)
        return observations[:, self.seen], {}

    def step(self, actions: npt.NDArray[np.float32]) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Makes one control step of all environments."""
        self.simulation.send(actions)
        batch = self.simulation.recv_batch()
        # Each row of `infos` is one figure of all environments. If an episode has ended in this step, the row of
        # `observations` is the first of the next episode, and `final_observations` has the last of the old one.
        last = batch.observations.copy()
        last[batch.final_indices] = batch.final_observations
        fell = np.arccos(np.clip(-last[:, self.up], -1.0, 1.0)) > LARGEST_TILT
        gained = batch.infos[self.info["x_velocity"]] * self.period * np.sin(self.slope)
        height = batch.infos[self.info["weight"]] * gained
        rewards = height - WORK_PRICE * batch.infos[self.info["work"]] - FALL_PRICE * fell
        ended = batch.terminated | batch.truncated
        infos: dict[str, Any] = {"height_work": height}
        if (fell & ~ended).any():
            # This task ends these episodes, but the simulation would continue them. So they are reset here.
            mask = fell & ~ended
            observations, _ = self.simulation.reset(options={"reset_mask": mask})
            batch.observations[mask] = observations[mask]
        if (fell | ended).any():
            infos |= {"final_obs": last[:, self.seen], "_final_obs": fell | ended}
        terminated = batch.terminated | fell
        return batch.observations[:, self.seen], rewards, terminated, batch.truncated & ~terminated, infos

    def close_extras(self, **_: Any) -> None:
        """Closes the simulation and frees its memory."""
        self.simulation.close()


def main() -> None:
    """Runs random actions around those of a forward tripod, and prints their returns."""
    env = Climb(64)
    generator = np.random.default_rng(0)
    env.reset(seed=0)
    returns, falls = np.zeros(env.num_envs), 0
    for _ in range(200):
        actions = generator.uniform(0.0, 1.0, env.action_space.shape).astype(np.float32)
        _, rewards, terminated, _, _ = env.step(actions)
        returns += rewards
        falls += int(terminated.sum())
    print(f"{env.num_envs} robots, 4 s: {returns.mean():.2f} J a robot, {falls} falls")
    env.close()


if __name__ == "__main__":
    main()
