"""Makes films of a gait as GIFs, each of one episode: on request, or at regular steps of a training."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from evaluate_gait import FIRST_SEED, Policy, learnt
from PIL import Image
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecNormalize

import sandgait

#: Control steps from one picture to the next: 25 pictures in a second with 50 control steps.
STRIDE = 2


def film(policy: Policy, path: Path, task: str, address: str | None = None, **options: Any) -> None:
    """Runs one episode and writes its pictures as a GIF."""
    env = sandgait.SandgaitEnv(task, address, render_mode="rgb_array", **options)
    observation, _ = env.reset(seed=FIRST_SEED)
    pictures, step, over = [], 0, False
    while not over:
        observation, _, terminated, truncated, _ = env.step(policy(observation[None])[0])
        step, over = step + 1, terminated or truncated
        if step % STRIDE == 0:
            pictures.append(Image.fromarray(np.asarray(env.render())))
    env.close()
    milliseconds = round(1000 * STRIDE / env.task.control_rate)
    pictures[0].save(path, save_all=True, append_images=pictures[1:], duration=milliseconds, loop=0)


class Video(BaseCallback):
    """Makes films of the present policy, without exploration, at regular steps of a training."""

    def __init__(self, every: int, folder: Path, task: str, address: str | None, options: dict[str, Any]) -> None:
        super().__init__()
        self.every, self.folder, self.task, self.address, self.options = every, folder, task, address, options

    def _on_training_start(self) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        self.next = self.num_timesteps + self.every

    def _on_step(self) -> bool:
        if self.num_timesteps >= self.next:
            self.next += self.every
            normalized = self.training_env
            assert isinstance(normalized, VecNormalize)
            path = self.folder / f"{self.num_timesteps}_steps.gif"
            film(learnt(self.model, normalized), path, self.task, self.address, **self.options)
        return True
