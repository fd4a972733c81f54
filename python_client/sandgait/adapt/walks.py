"""What the walks of a log say of the robot's world where joints and IMU do not.

If a robot follows its commands worse than the simulated one, the policy walks in simulated worlds with other sand or a
payload. A world is as probable as its mean velocities are like the robot's. A policy whose walks do not depend on the
sand says nothing about it, and then there is nothing to gain either.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .posterior import HALF, Cause, Member, Posterior, World
from .servo import Array
from .tracking import Followed, nearest

#: Standard deviation of a mean velocity that a right world would leave, as a part of the command: our choice, the
#: largest difference between errors of a policy here and in MuJoCo in the same world (docs/deploy_results.md).
_SCATTER = 0.05

#: Factors on the sand's stress, and payloads as parts of the robot's mass: our choice. Pushes of a robot's leg into
#: dunes differ by a factor of 18 from the 10th to the 90th percentile; the mechanism `scale` has 0.1 as its least.
_STRENGTHS = np.geomspace(0.1, 10.0, 17)
_PAYLOADS = np.linspace(0.0, 0.5, 9)

#: What an explanation must do to be believed: lower χ² by this much, three standard deviations, and leave at most this
#: part of the rms difference of velocities. Our choices.
_BETTER, _LEFT = 9.0, 0.5

#: Least share of an explanation among all: our choice.
_LEAST = 0.01


@dataclass(frozen=True)
class _Scan:
    """The values of one cause with the χ² of their worlds."""

    id: str
    unit: str
    values: Array
    #: Values in which the posterior is about normal.
    scale: Array
    chi2: Array

    @property
    def evidence(self) -> float:
        """Logarithm of the mean likelihood over the values, which are equally probable."""
        least = float(self.chi2.min())
        return float(np.log(np.mean(np.exp((least - self.chi2) / 2.0)))) - least / 2.0

    def cause(self) -> Cause:
        """The cause with the mean of its posterior and its 95 % interval; steps of the values are added to its sd."""
        weights = np.exp((self.chi2.min() - self.chi2) / 2.0)
        weights /= weights.sum()
        mean = float(weights @ self.scale)
        step = float(self.scale[1] - self.scale[0])
        sd = float(np.sqrt(weights @ (self.scale - mean) ** 2 + step**2 / 12.0))
        ends = np.interp([mean, mean - HALF * sd, mean + HALF * sd], self.scale, self.values)
        return Cause(self.id, float(ends[0]), (float(ends[1]), float(ends[2])), self.unit)


def explained(
    found: Posterior,
    logged: Sequence[Followed],
    base: str,
    mass: float,
    lines: Callable[[World], list[dict[str, Any]]],
) -> Posterior | None:
    """`found` with the explanations of the walks; None: no sand and no payload explains them. `base`: text of the
    training's sand.toml, empty on hard ground; `mass`: of the robot [kg]; `lines`: the nine commands in a world."""
    # A recalibration that does not explain the walks is left out.
    plain = replace(found, sand=base, stress_sd=0.0)

    def chi2(cause: Cause) -> float:
        world = plain.world(Member((cause,), 1.0), None)
        return float(np.sum(_differences(logged, lines(world)) ** 2)) / _SCATTER**2

    scans = [_scan("payload", "kg", _PAYLOADS * mass, _PAYLOADS, chi2)]
    if base:
        scans.append(_scan("scale", "1", _STRENGTHS - 1.0, np.log(_STRENGTHS), chi2))
    # Where even the best world leaves more than the scatter, all differences err by more (Birge 1932).
    more = max(1.0, min(float(s.chi2.min()) for s in scans) / (3 * len(logged) - 1))
    scans = [replace(s, chi2=s.chi2 / more) for s in scans]
    nominal = float(scans[0].chi2[0])
    good = [s for s in scans if nominal - s.chi2.min() >= _BETTER and s.chi2.min() <= _LEFT**2 * nominal]
    if not good:
        return None
    weights = np.exp([s.evidence - max(s.evidence for s in good) for s in good])
    weights /= weights.sum()
    members = [Member((s.cause(),), float(w)) for s, w in zip(good, weights, strict=True) if w >= _LEAST]
    members.sort(key=lambda member: -member.weight)
    words = " or ".join(_words(member.causes[0], mass) for member in members)
    said = f"{found.summary.rstrip('.')}. The walks are those of a simulated robot {words}"
    return replace(plain, members=tuple(members), summary=said)


def _scan(id: str, unit: str, values: Array, scale: Array, chi2: Callable[[Cause], float]) -> _Scan:
    found = [chi2(Cause(id, float(v), (float(v), float(v)), unit)) for v in values]
    return _Scan(id, unit, values, scale, np.array(found))


def _differences(logged: Sequence[Followed], lines: Sequence[dict[str, Any]]) -> Array:
    """Differences of velocities as parts of the command, for each command and component. A simulated robot that fell
    counts as one that stands."""
    simulated = [nearest(lines, one.command) for one in logged]
    velocities = np.array([np.zeros(3) if line["falls"] == 1.0 else line["velocity"] for line in simulated])
    sizes = np.array([one.size for one in logged])
    return np.asarray((np.array([one.velocity for one in logged]) - velocities) / sizes[:, None])


def _words(cause: Cause, mass: float) -> str:
    low, high = cause.interval
    if cause.id == "scale":
        return f"on sand with {1.0 + cause.value:.2g} times the stated stress ({1.0 + low:.2g} to {1.0 + high:.2g})"
    return f"with a payload of {cause.value / mass:.0%} ({low / mass:.0%} to {high / mass:.0%}) of its mass"
