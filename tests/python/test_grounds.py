"""`sandgait.grounds`: media and files of sand, weaker and stronger."""

from __future__ import annotations

import json
import tomllib

import numpy as np
import pytest

import sandgait
from reports import POPPY
from sandgait.command_line import said_by
from sandgait.errors import InvalidRequest
from sandgait.grounds import ground_name, make_sand, stronger

MEDIA = [medium["name"] for medium in json.loads(said_by("media", "--json"))]
TERM = """
[[term]]
on = "normal"
coefficient = 0.5
groups = { froude = 1.0 }
range = { froude = [0.0, 4.0] }
"""


def force(sand: sandgait.Sand) -> np.ndarray:
    """On a ball that moves down and forward."""
    ball = sandgait.Bodies({"ball": "sphere:radius=0.03"})
    motion = [[0.0, 0.0, -0.03]], [[1.0, 0.0, 0.0, 0.0]], [[0.1, 0.0, -0.1]], [[0.0, 0.0, 0.0]]
    return sand.wrench(ball, *map(np.array, motion))[0, :3]


@pytest.mark.parametrize("law", ["li2013", "agarwal2023"])
@pytest.mark.parametrize("ground", [*MEDIA, "zeta=0.5", "mu=0.5,rho=1500"])
def test_every_medium_can_be_weaker_and_stronger(ground: str, law: str) -> None:
    plain = force(make_sand(ground, law))
    np.testing.assert_array_equal(plain, force(sandgait.Sand(ground, law=law)))
    for factor in (0.236, 0.7, 4.24):
        np.testing.assert_allclose(force(make_sand(ground, law, factor)), factor * plain, rtol=1e-9)


@pytest.mark.parametrize("mechanisms", ["", "[mechanisms]\nscale = 0.5\n", "[mechanisms]\ndepth_power = 0.2\n"])
def test_a_file_can_be_weaker_and_stronger(mechanisms: str) -> None:
    text = POPPY + mechanisms
    plain = force(make_sand(text))
    np.testing.assert_allclose(force(make_sand(text, "ignored", 0.7)), 0.7 * plain, rtol=1e-9)
    twice = stronger(stronger(text, 0.7), 2.0)
    np.testing.assert_allclose(force(make_sand(twice)), 1.4 * plain, rtol=1e-9)
    assert ground_name(twice) == "poppy-close"
    # Tables that follow stay as they are.
    before, after = tomllib.loads(text + TERM), tomllib.loads(stronger(text + TERM, 0.7))
    assert after["term"] == before["term"]
    assert after["coefficients"] == before["coefficients"]


@pytest.mark.parametrize(
    "ground", ["popy", "zeta=x", "mu=0.5", "mu=0.5,rho=", "no toml\n", POPPY.replace("d10", "d11")]
)
@pytest.mark.parametrize("strength", [1.0, 0.7])
def test_other_grounds_are_refused(ground: str, strength: float) -> None:
    with pytest.raises(InvalidRequest):
        make_sand(ground, "li2013", strength)
