"""Makes the animation of README and the site: a hexapod follows a commanded speed with the learnt policy of
examples/policies. `make film` runs this file, with Chromium."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from page_film import ROOT, film

import sandgait

OUT = ROOT / "docs/images/walk.webp"
#: Control steps until the film begins (0.5 s), of the film (2 s), and from frame to frame (25 frames per second).
SETTLE, FILM, EVERY = 25, 100, 2

POLICY = ROOT / "examples/policies/HexapodGait-ppo/policy.onnx"

with tempfile.TemporaryDirectory() as folder:
    recording = Path(folder) / "walk.rec"
    env = sandgait.SandgaitVectorEnv("sandgait/HexapodGait-v1", 1, command=[0.3, 0.3], autoreset_mode="DISABLED")
    env.record(recording)
    env.reset(seed=0)
    walk = env.rollout_policy(POLICY, SETTLE + FILM, trajectories=True)
    for actions in walk.actions:
        env.step(np.asarray(actions))
    env.close()
    film(recording, OUT, [0.02 * step for step in range(SETTLE, SETTLE + FILM, EVERY)])
