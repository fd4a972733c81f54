"""Makes the film of a quadruped in README and the site: ANYmal C on packed poppy seeds follows commands of arrow keys.
`make film` runs this file, with Chromium."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from page_film import ROOT, film
from PIL import Image, ImageDraw

import sandgait

OUT = ROOT / "docs/images/steered.webp"
FOLDER = ROOT / "examples/policies/LeggedVelocity-anymal_c"
#: Keys that are held and for how many control steps of 20 ms; the first part is not filmed.
KEYS = [("", 50), ("up", 125), ("up left", 150), ("right", 125), ("up", 100)]
#: Forward [m/s] and to the left [rad/s] while a key is held.
FORWARD, TURN = 0.8, 0.7
#: Control steps from frame to frame.
EVERY = 5
#: Places of the keys in the picture: column and row; and the ends of their arrows.
ARROWS = {"left": (0, 1), "down": (1, 1), "up": (1, 0), "right": (2, 1)}
SIDE = 22


def draw_keys(picture: Image.Image, held: list[str]) -> None:
    draw = ImageDraw.Draw(picture)
    left, top = 12, picture.height - 2 * SIDE - 16
    for key, (column, row) in ARROWS.items():
        x, y = left + column * (SIDE + 4), top + row * (SIDE + 4)
        lit = key in held
        draw.rounded_rectangle((x, y, x + SIDE, y + SIDE), 5, fill="#2b6cb0" if lit else "#e2e2e2", outline="#666666")
        turn = {"up": (0, -1), "down": (0, 1), "left": (-1, 0), "right": (1, 0)}[key]
        middle = np.array([x + SIDE / 2, y + SIDE / 2])
        along, across = np.array(turn) * 6, np.array([turn[1], turn[0]]) * 6
        corners = [middle + along, middle - along + across, middle - along - across]
        draw.polygon([tuple(map(float, c)) for c in corners], fill="white" if lit else "#777777")


settings: dict[str, Any] = json.loads((FOLDER / "settings.json").read_text(encoding="utf-8"))
with tempfile.TemporaryDirectory() as folder:
    recording = Path(folder) / "steered.rec"
    options = {**settings["options"], "curriculum": None, "max_episode_steps": 2000}
    env = sandgait.SandgaitVectorEnv(settings["task"], 1, **options)
    env.record(recording)
    env.reset(seed=0)
    times: list[float] = []
    held: list[list[str]] = []
    made = 0
    for keys, steps in KEYS:
        held_now = keys.split()
        yaw = TURN * (("left" in held_now) - ("right" in held_now))
        env.set_command([[FORWARD * ("up" in held_now), 0.0, yaw]])
        walk = env.rollout_policy(FOLDER / "policy.onnx", steps, trajectories=True)
        for actions in walk.actions:
            env.step(np.asarray(actions))
            made += 1
            if keys and made % EVERY == 0:
                times.append(0.02 * made)
                held.append(held_now)
    env.close()
    film(recording, OUT, times, size=(480, 360), draw=lambda picture, k: draw_keys(picture, held[k]))
