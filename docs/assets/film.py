"""Makes the animation of README and the site: a hexapod follows a commanded speed with the learnt policy of
examples/policies. `make film` runs this file."""

from __future__ import annotations

from pathlib import Path

import gymnasium as gym
import numpy as np
from PIL import Image

import sandgait  # noqa: F401  (registers the ids)

OUT = Path(__file__).parents[1] / "images/walk.webp"
#: Control steps until the film begins (0.5 s), of the film (2 s), and from frame to frame (25 frames per second).
SETTLE, FILM, EVERY = 25, 100, 2

POLICY = Path(__file__).parents[2] / "examples/policies/HexapodGait-ppo/policy.onnx"

env = gym.make_vec(
    "sandgait/HexapodGait-v1", num_envs=1, command=[0.3, 0.3], render_mode="rgb_array", autoreset_mode="DISABLED"
)
env.reset(seed=0)
walk = env.unwrapped.rollout_policy(POLICY, SETTLE + FILM, trajectories=True)  # type: ignore[attr-defined]
frames = []
for step, actions in enumerate(walk.actions):
    env.step(actions)
    if step >= SETTLE and step % EVERY == 0:
        pictures = env.render()
        assert pictures is not None
        frames.append(Image.fromarray(np.asarray(pictures[0])))
env.close()
frames[0].save(OUT, save_all=True, append_images=frames[1:], duration=20 * EVERY, loop=0, quality=50, method=6)
print(f"{OUT.name}: {len(frames)} frames, {OUT.stat().st_size // 1024} KiB")
