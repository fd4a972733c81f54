"""The conditions under which a policy is certified."""

from __future__ import annotations

from dataclasses import dataclass, replace

from sandgait_deploy import Policy

from ..plant import Conditions

#: Factors on the nominal sand's strength that are tried. 95 pushes of a robot's leg into dunes differed by a factor of
#: 18 between the 10th and the 90th percentile; these span this factor.
SANDS = (18**-0.5, 18**-0.25, 18**0.25, 18**0.5)
SLOPES = (-10.0, -5.0, 5.0, 10.0)
PAYLOADS = (0.1, 0.2)
MOTORS = (0.9, 0.8, 0.7)
LATENCIES = (0.0, 0.01, 0.02, 0.03, 0.04, 0.06)
NOISES = (0.0, 1.0, 2.0)
FRICTIONS = (0.5, 0.75)


@dataclass(frozen=True)
class Case:
    """One row of the sheet: what differs from the robot as it is stated, and whether the verdict depends on it."""

    what: str
    value: str
    conditions: Conditions
    required: bool = False


def cases(policy: Policy, stated: Conditions, quick: bool) -> list[Case]:
    """What is tried one at a time around the robot as it is `stated`. Required are those that the training drew."""
    drawn = policy.trained_with.get("domain_rand") or {}
    found: list[Case] = []

    def add(what: str, text: str, required: bool = False, **changes: object) -> None:
        found.append(Case(what, text, replace(stated, **changes), required))  # type: ignore[arg-type]

    if stated.ground == "rigid":
        for factor in () if quick else FRICTIONS:
            add("friction of the ground", f"× {factor:g}", friction=factor)
    else:
        trained = [f for f in drawn.get("sand_range", ()) if f != 1.0]
        for factor in sorted({*trained, *(() if quick else SANDS)}):
            add("sand's strength", f"× {factor:.2f}", factor in trained, sand_strength=factor)
    for degrees in () if quick else SLOPES:
        add("slope", f"{degrees:+g}°", slope_deg=degrees)
    mass = max([0.0, *drawn.get("added_mass_range", ())])
    for part in sorted({*([mass] if mass else []), *(() if quick else PAYLOADS)}):
        add("payload", f"{100 * part:.0f} %", part == mass, payload=part)
    weakest = min([1.0, *drawn.get("motor_strength_range", ())])
    for factor in sorted({*([weakest] if weakest < 1.0 else []), *(() if quick else MOTORS)}, reverse=True):
        if factor != stated.motor_strength:
            add("motors' strength", f"× {factor:g}", factor == weakest, motor_strength=factor)
    for seconds in LATENCIES[::3] if quick else LATENCIES:
        if seconds != stated.latency:
            add("latency", f"{1e3 * seconds:.0f} ms", latency=seconds)
    for factor in () if quick else NOISES:
        if factor != stated.noise:
            add("noise", f"× {factor:g}", noise=factor)
    return found
