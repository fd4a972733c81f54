"""Makes the films of steered robots in README and the site: ANYmal C and PhantomX on packed seeds, and H1 on hard
ground, follow arrow keys. `make film` runs this file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw

import sandgait

ROOT = Path(__file__).parents[2]
#: The film, the policy, and the speeds forward [m/s] and to the left [rad/s] while a key is held.
FILMS = {
    "steered.webp": ("LeggedVelocity-anymal_c", 0.8, 0.7),
    "steered_hexapod.webp": ("LeggedVelocity-phantomx", 0.24, 0.58),
    "steered_biped.webp": ("LeggedVelocity-h1", 1.0, 0.5),
}
#: Keys that are held and for how many control steps of 20 ms; the first part is not filmed.
KEYS = [("", 50), ("up", 125), ("up left", 150), ("right", 125), ("up", 100)]
#: Control steps from frame to frame, and the picture's width [px].
EVERY, WIDTH = 5, 480
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


def film(out: Path, folder: Path, forward: float, turn: float) -> None:
    settings: dict[str, Any] = json.loads((folder / "settings.json").read_text(encoding="utf-8"))
    env = sandgait.SandgaitVectorEnv(
        settings["task"],
        1,
        render_mode="rgb_array",
        **{**settings["options"], "curriculum": None, "max_episode_steps": 2000},
    )
    env.reset(seed=0)
    frames: list[Image.Image] = []
    made = 0
    for keys, steps in KEYS:
        held = keys.split()
        yaw = turn * (("left" in held) - ("right" in held))
        env.set_command([[forward * ("up" in held), 0.0, yaw]])
        walk = env.rollout_policy(folder / "policy.onnx", steps, trajectories=True)
        for actions in walk.actions:
            env.step(actions)
            made += 1
            if keys and made % EVERY == 0:
                pictures = env.render()
                assert pictures is not None
                picture = Image.fromarray(np.asarray(pictures[0]))
                height = round(WIDTH * picture.height / picture.width)
                picture = picture.resize((WIDTH, height), Image.Resampling.LANCZOS)
                draw_keys(picture, held)
                frames.append(picture)
    env.close()
    frames[0].save(out, save_all=True, append_images=frames[1:], duration=20 * EVERY, loop=0, quality=35, method=6)
    print(f"{out.name}: {len(frames)} frames, {out.stat().st_size // 1024} KiB")


for name, (policy, forward, turn) in FILMS.items():
    film(ROOT / "docs/images" / name, ROOT / "examples/policies" / policy, forward, turn)
