"""Makes the pictures of the pages on force laws, motion, studies, memory and robots' files, for `make film`."""

from __future__ import annotations

import subprocess
import tempfile
from pathlib import Path
from typing import Any

import gymnasium as gym
import matplotlib.pyplot as plt
import numpy as np
from page_film import ROOT
from PIL import Image

import sandgait
from sandgait import server

IMAGES = ROOT / "docs/images"
#: Control steps until the picture of the prints, and the hips' speed in them.
STEPS, SPEED = 110, 0.5
#: Attack and intrusion angles of the maps of stress, from −90° to 90°.
ANGLES = np.linspace(-np.pi / 2, np.pi / 2, 61)


def stresses() -> None:
    """α_x and α_z of `li2013` over attack and intrusion angle."""
    with tempfile.TemporaryDirectory() as folder:
        rows = Path(folder) / "angles.csv"
        beta, gamma = (angles.ravel() for angles in np.meshgrid(ANGLES, ANGLES))
        np.savetxt(rows, np.stack([beta, gamma], axis=1), delimiter=",", header="beta,gamma", comments="")
        command = [*server.command(), "stress", "--medium", "poppy-loose", "--input", str(rows)]
        text = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    table = np.loadtxt(text.splitlines(), delimiter=",", skiprows=1)
    figure, both = plt.subplots(1, 2, figsize=(7.2, 3.0), layout="constrained", sharey=True)
    for axes, column, name in zip(both, (2, 3), ("α_x", "α_z"), strict=True):
        values = table[:, column].reshape(len(ANGLES), len(ANGLES)) / 1e6
        map_ = axes.pcolormesh(np.degrees(ANGLES), np.degrees(ANGLES), values, cmap="RdBu_r", vmin=-0.26, vmax=0.26)
        axes.set_xlabel("attack angle β [°]")
        axes.set_title(f"{name} [N/cm³]", fontsize=10)
    both[0].set_ylabel("intrusion angle γ [°]")
    figure.colorbar(map_, ax=both)
    figure.savefig(IMAGES / "stress.png", dpi=100)


def leg_forces() -> None:
    """Forces on legs that rotate through sand."""
    figure, axes = plt.subplots(figsize=(6.4, 3.0), layout="constrained")
    for leg in ("L", "revL"):
        sandgait.intrude(leg).plot(axes, label=leg)
    figure.savefig(IMAGES / "leg_forces.png", dpi=100)


def sweep() -> None:
    """Speed over knee angle and stride frequency."""
    designs = sandgait.sweep({"xi": range(-75, 76, 15), "frequency": [1, 2, 3, 4]})
    figure, axes = plt.subplots(figsize=(6.4, 3.0), layout="constrained")
    designs.plot("speed", axes=axes)
    figure.savefig(IMAGES / "sweep.png", dpi=100)


def prints() -> None:
    """Prints that a hexapod leaves in sand that remembers."""
    camera = {"azimuth_deg": 140, "elevation_deg": 28, "distance": 0.55}
    look: dict[str, Any] = {"render_mode": "rgb_array", "render_size": (960, 540), "render_camera": camera}
    env = gym.make("sandgait/HexapodGait-v1", memory=True, command=[0.4, 0.4], **look)
    env.reset(seed=1)
    for _ in range(STEPS):
        env.step(np.full(6, SPEED, np.float32))
    Image.fromarray(np.asarray(env.render())).save(IMAGES / "prints.jpg", quality=80)
    env.close()


def plates() -> None:
    """A quadruped with the plates on which sand acts."""
    with tempfile.TemporaryDirectory() as folder:
        picture = Path(folder) / "plates.png"
        robot = str(ROOT / "robots/sandcat.xml")
        subprocess.run([*server.command(), "robot", robot, "--picture", str(picture)], check=True, capture_output=True)
        Image.open(picture).convert("RGB").crop((100, 130, 860, 670)).save(IMAGES / "plates.jpg", quality=80)


if __name__ == "__main__":
    for make in (stresses, leg_forces, sweep, prints, plates):
        make()
