"""Entries of this package: its resistive force laws, and the walks that it computes with them."""

from __future__ import annotations

import re
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from .. import study_functions as studies
from ..sand import Bodies, Sand
from .motion import Array, Motion
from .rows import Body, Gait, MeasuredSand, Walker

#: The laws, by the names that every command takes.
LAWS = ("li2013", "agarwal2023", "penetration-drag-1d")
#: Shapes of `sandgait.intrude`, with their sizes.
_INTRUDE = {("box", "height", "length", "width"), ("cylinder", "radius", "width"), ("sphere", "radius")}

#: How the program regularises the law on its own legs (Regularization::DEFAULT in src/sand/contact.rs).
_THIN: dict[str, Any] = {"leading_edge_gate": 0.2, "rest_speed": 1e-5}


class ForceLaw:
    """A resistive force law, calibrated with the scale ζ of the sand.

    A body that keeps its attitude is computed as `sandgait validate` and `sandgait intrude` compute it. Bodies that
    turn, and shapes that `intrude` does not have, are computed by `Sand.wrench`. With `memory` the sand remembers what
    has moved it, but only under bodies of the first kind.
    """

    def __init__(self, law: str, memory: bool = False) -> None:
        self.law = law
        self.memory = memory

    def force(self, body: Body, motion: Motion, sand: MeasuredSand) -> Array:
        with tempfile.TemporaryDirectory() as folder:
            made: dict[str, Any] = {"medium": f"zeta={sand.zeta!r}", "law": self.law}
            if sand.toml is not None:
                path = Path(folder) / "sand.toml"
                text = sand.toml.read_text(encoding="utf-8")
                path.write_text(re.sub('(?m)^law = ".*"$', f'law = "{self.law}"', text), encoding="utf-8")
                made = {"sand": path}
            if _intrudes(body, motion):
                return self._intruded(body, motion, made)
            return _wrench(body, motion, made)

    def _intruded(self, body: Body, motion: Motion, made: dict[str, Any]) -> Array:
        depth = -(motion.position[:, 2] + body.lowest)
        names = ("vx", "vy", "vz", "wx", "wy", "wz")
        rows = dict(zip(names, np.concatenate([motion.velocity, motion.angular_velocity], axis=1).T, strict=True))
        remembers = self.memory and not motion.steady
        if remembers:
            x, y, _ = motion.position.T
            rows |= {"t": motion.t, "x": x, "y": y}
        rows["depth"] = depth
        done = studies.intrude(body=body.solids[0].text, rows=rows, memory=remembers, progress=False, **made)
        return np.concatenate([done.force, done.torque], axis=1)


class WalkingLaw(ForceLaw):
    """A law without memory, whose walks are those of `sandgait walk`."""

    def walk(self, robot: Walker, gait: Gait) -> float:
        done = studies.walk(
            gait.frequency, leg=robot.leg, robot=robot.robot, medium=robot.medium, law=self.law, progress=False
        )
        return float(done.speed[0])


def _intrudes(body: Body, motion: Motion) -> bool:
    """Can `sandgait intrude` compute this?"""
    first = body.solids[0]
    known = (first.kind, *sorted(first.sizes)) in _INTRUDE and len(body.solids) == 1
    return known and bool((motion.quaternion == (1.0, 0.0, 0.0, 0.0)).all())


def _wrench(body: Body, motion: Motion, made: dict[str, Any]) -> Array:
    thin = _THIN if all(solid.kind == "plate" for solid in body.solids) else {}
    sand = Sand.from_toml(made["sand"], **thin) if "sand" in made else Sand(made["medium"], law=made["law"], **thin)
    parts = (motion.position, motion.quaternion, motion.velocity, motion.angular_velocity)
    arrays = [np.ascontiguousarray(part[:, None]) for part in parts]
    wrench: Array = sand.wrench(Bodies(body.shapes), *arrays, travel=motion.velocity)[:, 0]
    return wrench
