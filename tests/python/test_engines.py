"""One robot on one sand in two engines comes to the same place as the time step falls."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "examples"))

from engines_study import Case, distance

#: Each foot, law and ground twice.
CASES = [
    Case("ball", "li2013", "dunes"),
    Case("ball", "agarwal2023", "slope of 10°"),
    Case("box", "li2013", "level"),
    Case("box", "agarwal2023", "dunes"),
    Case("mesh", "li2013", "slope of 10°"),
    Case("mesh", "agarwal2023", "level"),
]


def test_paths_in_two_engines_come_together(tmp_path: Path) -> None:
    """Errors are of first order or, where feet stick and slip, of a lower one: a quarter of the step leaves less than
    half of the distance in the sum, and in no case more than 6 % of the way."""
    coarse = [distance(case, 1e-3, tmp_path)[0] for case in CASES]
    fine = [distance(case, 2.5e-4, tmp_path) for case in CASES]
    assert sum(apart for apart, _ in fine) < 0.5 * sum(coarse), (coarse, fine)
    wide = {" ".join(case): (apart, way) for case, (apart, way) in zip(CASES, fine, strict=True) if apart > 0.06 * way}
    assert not wide, wide
