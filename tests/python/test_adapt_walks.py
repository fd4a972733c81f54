"""What `sandgait adapt` takes from the walks of a log where joints and IMU name no cause."""

from __future__ import annotations

import tomllib
from typing import Any

import numpy as np
import pytest

from sandgait.adapt import Posterior, World
from sandgait.adapt.tracking import Followed
from sandgait.adapt.walks import explained

COMMANDS = ((0.4, 0.0, 0.0), (0.7, 0.0, 0.0), (0.0, 0.0, 0.9), (0.4, 0.0, 0.6))
MASS = 12.0
SAND = 'name = "seeds"\nlaw = "li2013"\n'
PLAIN = Posterior("none_of_these", "No known cause explains the log.", (), "", 'source = "test"\n', "")


def share(sand: float, payload: float, of: tuple[float, float]) -> float:
    """What a simulated robot reaches of its command. `of`: how much weak sand and payload cost."""
    return 1.0 - of[0] * 0.3 / (sand + 0.3) - of[1] * payload / MASS


def lines(of: tuple[float, float]) -> Any:
    def made(world: World) -> list[dict[str, Any]]:
        scale = tomllib.loads(world.sand).get("mechanisms", {}).get("scale", 0.0) if world.sand else 0.0
        reached = share(1.0 + scale, world.payload, of)
        return [
            {"command": c, "velocity": [reached * v for v in c], "error": 1.0 - reached, "falls": 0.0} for c in COMMANDS
        ]

    return made


def walks(reached: float, drift: float = 0.0) -> list[Followed]:
    logged = [np.array(c) for c in COMMANDS]
    return [Followed(c, reached * c + [0.0, drift, 0.0], float(np.linalg.norm(c))) for c in logged]


@pytest.mark.parametrize("sand", [0.25, 0.5, 3.0])
def test_weak_and_strong_sand_are_found(sand: float) -> None:
    of = (1.0, 0.0)
    found = explained(PLAIN, walks(share(sand, 0.0, of)), SAND, MASS, lines(of))
    assert found is not None
    ((cause,),) = (member.causes for member in found.members)
    low, high = cause.interval
    assert cause.id == "scale"
    assert low < sand - 1.0 < high
    assert (1.0 + high) / (1.0 + low) < (4.0 if sand < 1.0 else 20.0)
    assert "on sand with" in found.summary
    assert tomllib.loads(found.best.sand)["mechanisms"]["scale"] == pytest.approx(cause.value)


def test_walks_that_differ_otherwise_too_say_less() -> None:
    of = (1.0, 0.0)
    logged = [walks(share(0.3, 0.0, of), drift) for drift in (0.0, 0.08)]
    made = [explained(PLAIN, one, SAND, MASS, lines(of)) for one in logged]
    widths = [found.members[0].causes[0].interval for found in made if found is not None]
    assert len(widths) == 2
    assert widths[1][1] - widths[1][0] > 1.3 * (widths[0][1] - widths[0][0])
    assert all(low < -0.7 < high for low, high in widths)


def test_what_walks_cannot_tell_apart_stays_apart() -> None:
    of = (1.0, 1.5)
    found = explained(PLAIN, walks(share(0.3, 0.0, of)), SAND, MASS, lines(of))
    assert found is not None
    assert {member.causes[0].id for member in found.members} == {"scale", "payload"}
    assert sum(member.weight for member in found.members) == pytest.approx(1.0)
    assert " or with a payload of " in found.summary or " or on sand with " in found.summary


def test_on_hard_ground_only_a_payload_can_explain() -> None:
    of = (1.0, 1.5)
    found = explained(PLAIN, walks(share(1.0, 3.0, of)), "", MASS, lines(of))
    assert found is not None
    (member,) = found.members
    low, high = member.causes[0].interval
    assert low < 3.0 < high
    assert found.best.sand == ""
    assert found.best.payload == pytest.approx(3.0, abs=0.5)


def test_other_walks_are_not_explained() -> None:
    of = (1.0, 0.5)
    nominal = share(1.0, 0.0, of)
    # A drift that no sand makes, and a difference that is within the scatter of simulated robots.
    assert explained(PLAIN, walks(nominal, drift=0.3), SAND, MASS, lines(of)) is None
    assert explained(PLAIN, walks(nominal - 0.03), SAND, MASS, lines(of)) is None
    # A policy whose walks depend on neither says nothing.
    assert explained(PLAIN, walks(0.5), SAND, MASS, lines((0.0, 0.0))) is None
