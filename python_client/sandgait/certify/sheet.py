"""The certificate as text for a terminal."""

from __future__ import annotations

import math

from ..grounds import ground_name
from .certificate import Certificate, ranges
from .walk import FOLLOWS, Line, Outcome


def sheet(certificate: Certificate) -> str:
    """One page of text; the last line is the verdict."""
    c = certificate
    lines = [
        *([f"note: {c.ground.note}"] if c.ground.note else []),
        f"{c.policy.task}, {c.policy.robot['name']}, {c.request.shown or c.policy.folder}",
        *([f"robot as stated: {_stated(c.stated)}"] if c.nominal else []),
        "",
        *(f"golden trace, {line}" for line in str(c.verification).splitlines()),
    ]
    for ground, outcome in c.nominal.items():
        lines += [
            "",
            f"{ground}, ideal robot: this simulator | MuJoCo",
            *_commands(c, ground, outcome),
        ]
    if c.nominal:
        lines += [
            "",
            f"the robot as stated, in MuJoCo: {c.stated.words}",
            *_strain(c.stated),
            "",
            "one thing at a time:",
        ]
        lines += ["  " + line for line in ranges(c)]
    lines += ["", *verdict(c)]
    return "\n".join(lines) + "\n"


def verdict(c: Certificate) -> list[str]:
    """The verdict, its reasons, and what fails first."""
    if c.deploy:
        return [f"DEPLOY: golden trace, both engines and all required cases hold (no fall, errors up to {FOLLOWS:.0%})"]
    lines = [f"reason: {reason}" for reason in c.reasons]
    if c.cause is not None:
        lines.append(f"first cause ({c.cause.kind}): {c.cause.words}")
    return [*lines, f"DO NOT DEPLOY: {c.reasons[0]}"]


def _stated(outcome: Outcome) -> str:
    s = outcome.conditions
    return (
        f"ground {ground_name(s.ground)}, latency {1e3 * s.latency:.0f} ms, noise × {s.noise:g}, "
        f"motors × {s.motor_strength:g}, payload {100 * s.payload:.0f} %"
    )


def _commands(c: Certificate, ground: str, outcome: Outcome) -> list[str]:
    made: list[Line | None] = [*outcome.lines] or [None] * len(c.engine[ground])
    rows = ["  forward  left    yaw  | forward  left    yaw  error | forward  left    yaw  error"]
    for own, other in zip(c.engine[ground], made, strict=True):
        rows.append(f"  {_numbers(own.command)} | {_line(own)} | {'does not start' if other is None else _line(other)}")
    return rows


def _line(line: Line) -> str:
    return "falls" + " " * 24 if line.fell else f"{_numbers(line.velocity)}  {100 * line.error:4.0f} %"


def _numbers(row: tuple[float, float, float]) -> str:
    return " ".join(f"{x:6.2f}" for x in row)


def _strain(outcome: Outcome) -> list[str]:
    if outcome.refused or not math.isfinite(outcome.torque[0]):
        return []
    (torque, joint), (speed, fast), (load, hot) = outcome.torque, outcome.speed, outcome.load
    return [
        f"  largest torque {100 * torque:.0f} % of its limit ({joint}), largest speed {speed:.1f} rad/s ({fast}), "
        f"largest rms torque {100 * load:.0f} % of its limit ({hot})"
    ]
