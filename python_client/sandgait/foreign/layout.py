"""The observation and the action of a foreign policy as linear maps of those of LeggedVelocity."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from sandgait_deploy import Refused

from .description import ABSOLUTE, MOST_SCALE, PARTS, Description, Floats, Term


def action_scale(description: Description) -> float:
    """The `action_scale` of LeggedVelocity [rad] at which its actions, within ±1, have the range of the network's."""
    if not np.isfinite(description.action_clip):
        return MOST_SCALE
    wanted = float(description.action_clip * description.action_scale.max())
    return min(MOST_SCALE, wanted)


def action_map(description: Description, joints: Sequence[str]) -> Floats:
    """M with action = M · output; `joints`: the order of the task's actions."""
    matrix = np.zeros((len(joints), len(joints)))
    factors = description.action_scale / action_scale(description)
    for k, name in enumerate(description.joints):
        matrix[joints.index(name), k] = factors[k]
    return matrix


def observation_map(
    description: Description, columns: Sequence[Mapping[str, Any]], joints: Sequence[str]
) -> tuple[Floats, Floats]:
    """M and b with the network's input = M · observation + b; `columns`: those of policy.json, `joints`: the order of
    their readings."""
    places = {(c["reading"], c["index"], c["steps_before"]): i for i, c in enumerate(columns)}
    rows = _numbers(description)
    matrix, offset = np.zeros((len(rows), len(columns))), np.zeros(len(rows))
    ratio = action_scale(description) / description.action_scale
    for row, (term, k, back) in enumerate(rows):
        factor, reading = float(term.scale[k]), term.reading
        if reading == "clock":
            index, sign = PARTS[term.parts[k]]
            factor *= sign
        else:
            index = k
        if reading in ("joint_position", "joint_velocity", "last_action"):
            index = joints.index(description.joints[k])
        if reading == "last_action":
            factor *= float(ratio[k])
        place = places.get((reading, index, back))
        if place is None:
            raise Refused(f"observation: {term.name} is no part of what LeggedVelocity observes")
        matrix[row, place] = factor
        if reading == "joint_position":
            origin = 0.0 if term.name in ABSOLUTE else float(description.default[k])
            offset[row] = factor * (float(columns[place]["subtract"]) - origin)
    return matrix, offset


def _numbers(description: Description) -> list[tuple[Term, int, int]]:
    """For each number of the network's input its term, its place in the term and its age in steps."""
    ages = list(range(description.history))
    if description.oldest_first:
        ages.reverse()
    if description.by_term:
        return [(term, k, age) for term in description.terms for age in ages for k in range(len(term.scale))]
    return [(term, k, age) for age in ages for term in description.terms for k in range(len(term.scale))]
