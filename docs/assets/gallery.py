"""Makes the picture of all robots that have a name, and of the kept robots from files, on packed poppy seeds.
`make gallery` runs this file; it needs the packages of `pip install 'sandgait[robots]'`."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

import sandgait
from sandgait import server

ROOT = Path(__file__).parents[2]
#: Robots from files, of which examples/policies has a policy.
KEPT = {"PhantomX": "LeggedVelocity-phantomx", "Unitree H1": "LeggedVelocity-h1"}
#: Pictures in a row, the width of each [px], and the control steps of 20 ms for which a robot has stood.
ROW, WIDTH, STOOD = 5, 320, 10


def picture(task: str, **options: Any) -> Image.Image:
    env = sandgait.SandgaitVectorEnv(task, 1, render_mode="rgb_array", **options)
    env.reset(seed=0)
    still = np.zeros(env.action_space.shape, dtype=np.float32)
    for _ in range(STOOD):
        env.step(still)
    pictures = env.render()
    assert pictures is not None
    whole = Image.fromarray(np.asarray(pictures[0]))
    env.close()
    # Without the line of text.
    whole = whole.crop((0, 24, whole.width, whole.height))
    return whole.resize((WIDTH, round(WIDTH * whole.height / whole.width)), Image.Resampling.LANCZOS)


def legged(robot: str) -> Image.Image:
    calm = {"curriculum": None, "domain_rand": None}
    return picture("sandgait/LeggedVelocity-v1", robot=robot, ground="poppy-close", **calm)


def robots() -> dict[str, Image.Image]:
    """Pictures by the names of robots."""
    made = {"hexapod": picture("sandgait/HexapodLegs-v2", medium="poppy-close")}
    for name, policy in KEPT.items():
        settings = json.loads((ROOT / "examples/policies" / policy / "settings.json").read_text(encoding="utf-8"))
        made[name] = legged(settings["options"]["robot"])
    listed = subprocess.run([*server.command(), "robots", "--json"], check=True, capture_output=True, text=True)
    for robot in json.loads(listed.stdout):
        made[robot["name"]] = legged(robot["name"])
    return made


def main() -> None:
    made = robots()
    height = max(one.height for one in made.values())
    rows = -(-len(made) // ROW)
    sheet = Image.new("RGB", (ROW * WIDTH, rows * height), "white")
    draw, letters = ImageDraw.Draw(sheet), ImageFont.load_default(18)
    for place, (name, one) in enumerate(made.items()):
        corner = (place % ROW * WIDTH, place // ROW * height)
        sheet.paste(one, corner)
        draw.text((corner[0] + 8, corner[1] + 6), name, fill="#333333", font=letters)
    out = ROOT / "docs/images/gallery.webp"
    sheet.save(out, quality=60, method=6)
    print(f"{out.name}: {len(made)} robots, {out.stat().st_size // 1024} KiB")


if __name__ == "__main__":
    main()
