"""Reports of a finished diagnosis, as far as `sandgait adapt` reads them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

#: The form of a sand.toml of a diagnosis, with the numbers of poppy-close.
POPPY = """name = "poppy-close"
law = "li2013"
bulk_density = 680.0
source = "a test"

[coefficients]
a00 = 94000.0
a10 = 92000.0
b11 = 92000.0
b01 = 151000.0
bm11 = 35000.0
c11 = -39000.0
c01 = 86000.0
cm11 = 18000.0
d10 = 46000.0
"""

SAND = POPPY + "\n[mechanisms]\nscale = 0.7\n"


HARDWARE = 'source = "a test"\n\n[actuator]\nfriction = { value = 0.2, interval = [0.1, 0.3] }\n'


LISTS = ("causes", "ambiguity_set", "candidates", "evidence", "upper_limits")


def found(verdict: str, version: int = 4, **others: Any) -> dict[str, Any]:
    """The report of a diagnosis that names no cause, as far as it is read."""
    lists = dict.fromkeys(LISTS, ())
    schema = f"sandgait.diagnosis.v{version}"
    return {
        "schema": schema,
        "verdict": verdict,
        "summary": f"it is {verdict}",
        "next_experiment": None,
        **lists,
        **others,
    }


def row(ids: list[str], difference: float, error: float) -> dict[str, Any]:
    return {"ids": ids, "terms": [], "difference": difference, "standard_error": error}


SCALE = {"id": "scale", "value": 0.7, "unit": "1", "ci95": [0.6, 0.8]}


WEAK = found("named", causes=[SCALE], ambiguity_set=[["scale"]], evidence=[row(["scale"], 0.0, 0.0)])


UNCERTAIN = found(
    "ambiguous",
    causes=[SCALE],
    ambiguity_set=[["scale"], ["inertial_drag"], ["payload", "joint_zero"], ["slope"]],
    evidence=[
        row([], -30.0, 5.0),
        row(["inertial_drag"], -1.0, 1.0),
        row(["scale"], 0.0, 0.0),
        row(["payload", "joint_zero"], -1.0, 1.0),
        row(["slope"], -9.0, 1.0),
    ],
    candidates=[
        {"ids": ["scale"], "values": [0.7], "delta_chi2": 90.0},
        {"ids": ["inertial_drag"], "values": [4.0], "delta_chi2": 64.0},
        {"ids": ["payload", "joint_zero"], "values": [1.2, 0.05], "delta_chi2": 36.0},
        {"ids": ["slope"], "values": [0.02], "delta_chi2": 9.0},
    ],
    next_experiment={
        "why": "it separates these",
        "conditions": [{"condition": "walk at 0.4 m/s"}, {"condition": "stand"}],
    },
)


def written(report: dict[str, Any], out: Path) -> Path:
    """The folder of a finished diagnosis."""
    out.mkdir()
    (out / "report.json").write_text(json.dumps(report))
    (out / "sand.toml").write_text(SAND)
    (out / "hardware.toml").write_text(HARDWARE)
    return out
