"""`sandgait certify`: verdicts on a kept policy, on spoiled ones, and wrong use."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sandgait.certify import Request, Wiring, certify, page, sheet
from sandgait.certify.__main__ import main
from sandgait.certify.causes import wirings
from sandgait.certify.walk import Job, outcome
from sandgait.plant import Conditions
from sandgait_deploy import read_policy

ROOT = Path(__file__).parents[2]
CAT = ROOT / "examples/policies/LeggedVelocity-sandcat"
ROBOT = ROOT / "robots/sandcat.xml"
FORWARD = ((0.4, 0.0, 0.0),)


def walked(conditions: Conditions, wiring: Wiring | None = None) -> float:
    made = outcome(Job(str(CAT), str(ROBOT), conditions, FORWARD, wiring=wiring or Wiring()))
    return made.error if not made.refused and made.falls == 0 else float("inf")
