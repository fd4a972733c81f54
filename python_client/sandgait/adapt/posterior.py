"""What a diagnosis says of sand and motors, as options of LeggedVelocity: the best values, and draws from their
intervals."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .servo import Motors

#: Verdicts after which a log says what to change.
TELLING = ("named", "described")

#: A 95 % interval of a normal distribution has this many standard deviations on both sides of its middle together.
_WIDTH = 2.0 * 1.96


@dataclass(frozen=True)
class Draw:
    """One possible world: texts of a sand.toml and of a hardware.toml."""

    sand: str
    hardware: str


@dataclass(frozen=True)
class Posterior:
    """The diagnosis as far as it concerns the policy."""

    verdict: str
    summary: str
    #: Each with id, value, unit and ci95.
    causes: tuple[dict[str, Any], ...]
    best: Draw
    #: What to log next, if the data leave a choice; empty otherwise.
    next: str
    #: The motors' strength from the log's targets and torques; None: the log does not have them.
    motors: Motors | None = None

    @property
    def tells(self) -> bool:
        """Does the log say what differs from the training's world?"""
        if self.motors is not None and self.motors.differ:
            return True
        return self.verdict in TELLING and bool(self.causes or "[[term]]" in self.best.sand)

    def draws(self, count: int, seed: int) -> list[Draw]:
        """Worlds within the intervals of the causes, and of the motors' strength. What the diagnosis found of sensors
        keeps its best values."""
        random = np.random.default_rng(seed)
        return [Draw(self._sand(random), self._hardware(random)) for _ in range(count)]

    def _hardware(self, random: np.random.Generator) -> str:
        found = self.motors
        if found is None or not found.differ:
            return self.best.hardware
        value = float(random.normal(found.strength, (found.interval[1] - found.interval[0]) / _WIDTH))
        return re.sub(r"(?m)^(torque_constant = \{ value = )[^,]*", rf"\g<1>{value!r}", self.best.hardware)

    def _sand(self, random: np.random.Generator) -> str:
        text = self.best.sand
        for cause in self.causes:
            low, high = cause["ci95"]
            value = float(np.clip(random.normal(cause["value"], (high - low) / _WIDTH), low, high))
            # Only mechanisms of the sand stand in the file; others are in hardware.toml.
            text = re.sub(rf"(?m)^{re.escape(cause['id'])} = .*$", f"{cause['id']} = {value!r}", text)
        return text


def posterior(folder: Path, motors: Motors | None = None) -> Posterior:
    """The posterior of the diagnosis in `folder`, and of the motors' strength if the log shows it."""
    report = json.loads((folder / "report.json").read_bytes())
    proposed = report.get("next_experiment")
    words = proposed if isinstance(proposed, str) else (proposed or {}).get("text", "")
    causes = tuple(report["causes"]) if report["verdict"] in TELLING else ()
    hardware = (folder / "hardware.toml").read_text(encoding="utf-8")
    if motors is not None and motors.differ:
        hardware = _with_strength(hardware, motors)
    best = Draw((folder / "sand.toml").read_text(encoding="utf-8"), hardware)
    return Posterior(report["verdict"], report["summary"], causes, best, str(words), motors)


def _with_strength(hardware: str, motors: Motors) -> str:
    """A hardware.toml with the motors' strength as `torque_constant`, unless the diagnosis has found one."""
    if re.search(r"(?m)^torque_constant = ", hardware):
        return hardware
    low, high = motors.interval
    line = f"torque_constant = {{ value = {motors.strength!r}, interval = [{low!r}, {high!r}] }}\n"
    if "[actuator]\n" in hardware:
        return hardware.replace("[actuator]\n", f"[actuator]\n{line}", 1)
    return f"{hardware.rstrip()}\n\n[actuator]\n{line}"
