"""`sandgait certify`: may a policy leave the simulator?

The Controller of `sandgait.deploy` drives the robot in MuJoCo, an independent engine, on sand and on hard ground, with
the latency, noise and motors of a real robot. `docs/certify.md` explains the sheet. Needs `sandgait[deploy]`.
"""

from __future__ import annotations

from .causes import Cause
from .certificate import Certificate, Request, certify
from .grid import Case
from .page import page
from .sheet import sheet
from .walk import Line, Outcome, Wiring

__all__ = ["Case", "Cause", "Certificate", "Line", "Outcome", "Request", "Wiring", "certify", "page", "sheet"]
