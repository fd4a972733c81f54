"""What a diagnosis and the motors' torques say of the robot's world, as options of LeggedVelocity: the most probable
world, and draws from the posterior.

The posterior is a mixture. Its members are the explanations that the data cannot tell apart; each has a weight, and
values with standard deviations. Reports of the versions 3 and 4 are read.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sandgait_deploy import Refused

from ..grounds import stronger, with_mechanisms
from .servo import Motors

#: A 95 % interval of a normal distribution has this many standard deviations on each side of its middle.
HALF = 1.96

#: Draws of the differences in predictive density for the weights of members: our choice; weights then err by some 1 %.
_DRAWS = 2000

#: Least weight of a member that is trained for: our choice, because a world in which the robot spends less than a
#: twentieth of its training teaches nothing.
LEAST_WEIGHT = 0.05

_SCHEMAS = ("sandgait.diagnosis.v3", "sandgait.diagnosis.v4")


@dataclass(frozen=True)
class World:
    """One possible world: what differs from that of the training."""

    #: Text of a sand.toml; empty: the training's sand.
    sand: str = ""
    #: Text of a hardware.toml; empty: the training's motors and sensors.
    hardware: str = ""
    #: Payload at the base's centre [kg].
    payload: float = 0.0

    def options(self, learnt: Mapping[str, Any]) -> dict[str, Any]:
        """Options of this world, for a policy whose training had the options `learnt`."""
        return {
            "sand": self.sand or learnt.get("sand") or "",
            "hardware": self.hardware or learnt.get("hardware") or "",
            "payload": float(learnt.get("payload") or 0.0) + self.payload,
        }


@dataclass(frozen=True)
class Cause:
    """A cause of the misfit with its 95 % interval. The unit is that of the report; "" if it gives no value, as for
    errors of measuring."""

    id: str
    value: float
    interval: tuple[float, float]
    unit: str

    @property
    def words(self) -> str:
        if not self.unit:
            return self.id
        return f"{self.id} = {self.value:.3g}{'' if self.unit == '1' else ' ' + self.unit}"

    def drawn(self, random: np.random.Generator) -> float:
        """A value within the 95 % interval that has the sign of the best one."""
        low, high = self.interval
        value = float(np.clip(random.normal(self.value, (high - low) / (2.0 * HALF)), low, high))
        return max(value, 0.0) if self.value > 0.0 else min(value, 0.0)


@dataclass(frozen=True)
class Member:
    """One explanation, with its probability among the members."""

    causes: tuple[Cause, ...]
    weight: float

    @property
    def words(self) -> str:
        return f"{' and '.join(c.words for c in self.causes)} ({self.weight:.0%})"


@dataclass(frozen=True)
class Posterior:
    """The diagnosis as far as it concerns the policy."""

    verdict: str
    summary: str
    #: The explanations, the most probable first; empty if the log does not say what differs in the sand.
    members: tuple[Member, ...]
    #: Text of the sand.toml of the diagnosis, without the causes of the first member; empty: the training's sand.
    sand: str
    #: Text of the hardware.toml of the diagnosis.
    hardware: str
    #: What to log next, if the data leave a choice; empty otherwise.
    next: str
    #: Relative standard deviation of the sand's stress beside the causes: that of a recalibration.
    stress_sd: float = 0.0
    #: The motors' strength from the log's targets and torques; None: the log does not have them.
    motors: Motors | None = None
    #: Ends of the time from an action to the motors [s], if it is above that of the training.
    delay: tuple[float, float] | None = None

    @property
    def tells(self) -> bool:
        """Does the log say what differs from the training's world?"""
        weak = self.motors is not None and self.motors.differ
        return bool(self.members or self.sand or self.delay) or weak

    @property
    def untrained(self) -> tuple[str, ...]:
        """Causes for which a simulated robot has no option, such as an error of a joint's zero."""
        ids = dict.fromkeys(c.id for m in self.trained for c in m.causes)
        return tuple(id for id in ids if id not in (*MECHANISMS, "payload", "motor_torque_limit"))

    @property
    def best(self) -> World:
        """The most probable world."""
        return self.world(self.members[0] if self.members else None, None)

    @property
    def trained(self) -> tuple[Member, ...]:
        """The members for which a policy is trained."""
        return tuple(m for m in self.members if m.weight >= LEAST_WEIGHT) or self.members[:1]

    def draws(self, count: int, seed: int) -> list[World]:
        """Worlds of the posterior: members by their weights, values within their intervals. What the diagnosis found
        of sensors keeps its best values."""
        random = np.random.default_rng(seed)
        weights = [m.weight for m in self.members]
        # Stratified: the numbers of draws of each member differ from weight · count by less than one.
        places = np.searchsorted(np.cumsum(weights), (np.arange(count) + random.uniform()) / count)
        chosen = [self.members[min(int(k), len(weights) - 1)] if weights else None for k in places]
        return [self.world(member, random) for member in chosen]

    def world(self, member: Member | None, random: np.random.Generator | None) -> World:
        """A member's world, with its best values, or with `random` ones."""
        causes = {} if member is None else {c.id: c.drawn(random) if random else c.value for c in member.causes}
        payload = causes.pop("payload", 0.0)
        limit = causes.pop("motor_torque_limit", 0.0)
        sand = self.sand
        if random is not None and sand and self.stress_sd:
            sand = stronger(sand, float(np.exp(random.normal(0.0, self.stress_sd))))
        felt = {id: value for id, value in causes.items() if id in MECHANISMS}
        return World(with_mechanisms(sand, felt) if felt else sand, self._hardware(limit, random), payload)

    def _hardware(self, limit: float, random: np.random.Generator | None) -> str:
        text = self.hardware
        if limit and "torque_limit" not in text:
            text = _with_quantity(text, "torque_limit", limit, (limit, limit))
        if not limit and any(c.id == "motor_torque_limit" for m in self.members for c in m.causes):
            text = re.sub(r"(?m)^torque_limit = .*\n?", "", text)  # the limit of another member
        found = self.motors
        # A torque constant of the diagnosis describes the same effect of the motors.
        if found is not None and found.differ and "torque_constant" not in text:
            half = (found.interval[1] - found.interval[0]) / 2.0
            value = found.strength if random is None else float(random.normal(found.strength, half / HALF))
            low, high = (found.interval[0], found.interval[1]) if random is None else (value, value)
            text = _with_quantity(text, "torque_constant", value, (low, high))
        if self.delay is not None:
            low, high = self.delay if random is None else (float(random.uniform(*self.delay)),) * 2
            text = f"action_delay = {{ value = {(low + high) / 2.0!r}, interval = [{low!r}, {high!r}] }}\n{text}"
        return text if "interval" in text else ""


#: Causes of a robot's log that are mechanisms of a sand.toml and act on a walking robot (src/sand/mechanism.rs).
MECHANISMS = (
    "inertial_drag",
    "concave_fill",
    "depth_power",
    "cohesion",
    "scale",
    "slope",
    "rate_log",
    "friction_clip",
)


def posterior(folder: Path, motors: Motors | None = None, delay: tuple[float, float] | None = None) -> Posterior:
    """The posterior of the diagnosis in `folder`, and of the motors' strength and delay if the log shows them."""
    report = json.loads((folder / "report.json").read_bytes())
    if report.get("schema") not in _SCHEMAS:
        raise Refused(f"{folder}: its report is a {report.get('schema')}, not one of {', '.join(_SCHEMAS)}")
    verdict, sand = report["verdict"], ""
    members = _members(report) if verdict in ("named", "ambiguous") else ()
    if members or verdict in ("described", "recalibrated"):
        sand = (folder / "sand.toml").read_text(encoding="utf-8")
    written = [c["id"] for c in report["causes"] if c["id"] in MECHANISMS] if members else []
    if written:  # each member adds its own causes
        sand = with_mechanisms(sand, dict.fromkeys(written, 0.0))
    # A model that does not explain the log tells nothing about the robot's hardware.
    hardware = 'source = "sandgait adapt"\n'
    if verdict not in ("none_of_these", "insufficient_data"):
        hardware = (folder / "hardware.toml").read_text(encoding="utf-8")
    stress = _stress_sd(report) if verdict == "recalibrated" else 0.0
    return Posterior(verdict, report["summary"], members, sand, hardware, next_log(report), stress, motors, delay)


def _members(report: Mapping[str, Any]) -> tuple[Member, ...]:
    """The explanations of the report's ambiguity set, the most probable first."""
    sets = list(dict.fromkeys(tuple(ids) for ids in report["ambiguity_set"]))  # one for each channel, perhaps
    rows = [_evidence(report, set(ids)) for ids in sets]
    weights = _weights([row["difference"] for row in rows], [row["standard_error"] for row in rows])
    members = [Member(_causes(report, ids), w) for ids, w in zip(sets, weights, strict=True)]
    return tuple(sorted(members, key=lambda member: -member.weight))


def _evidence(report: Mapping[str, Any], ids: set[str]) -> Mapping[str, Any]:
    """The row of evidence of an explanation; an explanation without a row counts as the best."""
    rows = (row for row in report["evidence"] if set(row["ids"]) == ids and not row["terms"])
    return next(rows, {"difference": 0.0, "standard_error": 0.0})


def _weights(differences: list[float], errors: list[float]) -> list[float]:
    """Probabilities of models from their log predictive densities: pseudo-Bayesian model averaging, with the densities'
    scatter over conditions (Yao, Vehtari, Simpson & Gelman 2018, Bayesian Analysis 13:917, section 3.4, there by a
    bootstrap; here the differences are normal)."""
    random = np.random.default_rng(0)
    density = np.array(differences) + np.array(errors) * random.normal(size=(_DRAWS, len(differences)))
    parts = np.exp(density - density.max(axis=1, keepdims=True))
    return [float(w) for w in (parts / parts.sum(axis=1, keepdims=True)).mean(axis=0)]


def _causes(report: Mapping[str, Any], ids: Sequence[str]) -> tuple[Cause, ...]:
    """Values of an explanation. The report gives intervals of the best one only; for others the standard deviation is
    that at which the value would have the candidate's Δχ² (Wald). Candidates have the values of mechanisms, which are
    the last of the ids, and none of errors of measuring."""
    best = {c["id"]: c for c in report["causes"]}
    if set(ids) == set(best):
        return tuple(Cause(id, best[id]["value"], tuple(best[id]["ci95"]), best[id]["unit"]) for id in ids)
    tried = next((c for c in report["candidates"] if set(c["ids"]) == set(ids)), None)
    if tried is None:
        raise Refused(f"the diagnosis gives no values for {' and '.join(ids)}, which it cannot tell from {list(best)}")
    spread = HALF * max(abs(tried["delta_chi2"]), 1.0) ** -0.5
    units = {limit["id"]: limit["unit"] for limit in report["upper_limits"]}
    count = len(tried["ids"]) - len(tried["values"])
    return (
        *(Cause(id, 0.0, (0.0, 0.0), "") for id in tried["ids"][:count]),
        *(
            Cause(id, value, (value - spread * abs(value), value + spread * abs(value)), units.get(id, "1"))
            for id, value in zip(tried["ids"][count:], tried["values"], strict=True)
        ),
    )


def _stress_sd(report: Mapping[str, Any]) -> float:
    low, high = report["recalibration"]["ci95"]
    return float(np.log(high / low) / (2.0 * HALF))


def next_log(report: Mapping[str, Any]) -> str:
    """What to log next, in words; empty if the report proposes nothing."""
    proposed = report.get("next_experiment")
    if not proposed or not proposed.get("conditions"):
        return ""
    walks = "; ".join(dict.fromkeys(str(one["condition"]) for one in proposed["conditions"]))
    return f"{walks} ({proposed['why']})"


def _with_quantity(text: str, name: str, value: float, interval: tuple[float, float]) -> str:
    """The hardware.toml `text` with this value of the quantity `name` of the motors."""
    line = f"{name} = {{ value = {value!r}, interval = [{interval[0]!r}, {interval[1]!r}] }}\n"
    own = re.compile(rf"(?m)^{name} = .*\n?")
    if own.search(text):
        return own.sub(line, text)
    if "[actuator]\n" in text:
        return text.replace("[actuator]\n", f"[actuator]\n{line}", 1)
    return f"{text.rstrip()}\n\n[actuator]\n{line}"
