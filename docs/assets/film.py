"""Makes the animation of README and the site: a hexapod with C-legs that walks at 2 Hz. `make film` runs this file."""

from __future__ import annotations

from pathlib import Path

import gymnasium as gym
import numpy as np
from PIL import Image

import sandgait  # noqa: F401  (registers the ids)

OUT = Path(__file__).parents[1] / "images/walk.webp"
#: Control steps until the film begins (0.5 s), of the film (2 s), and from frame to frame (25 frames per second).
SETTLE, FILM, EVERY = 25, 100, 2

env = gym.make("sandgait/HexapodGait-v1", leg="C", render_mode="rgb_array")
env.reset(seed=0)
action = np.full(6, 0.4, dtype=np.float32)  # 2 Hz; action 1 is 5 Hz
frames = []
for step in range(SETTLE + FILM):
    env.step(action)
    if step >= SETTLE and step % EVERY == 0:
        frames.append(Image.fromarray(np.asarray(env.render())))
env.close()
frames[0].save(OUT, save_all=True, append_images=frames[1:], duration=20 * EVERY, loop=0, quality=50, method=6)
print(f"{OUT.name}: {len(frames)} frames, {OUT.stat().st_size // 1024} KiB")
