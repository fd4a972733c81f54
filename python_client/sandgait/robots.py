"""Robots from descriptions: does a robot stand?"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from . import _native
from .arguments import checked
from .options import packages
from .user_warnings import warn


@checked
def check_robot(robot: str | Path, ground: str | None = None) -> dict[str, Any]:
    """Lets a robot stand in its default pose for five seconds on hard ground and on sand, as `sandgait robot --check`.

    `robot`: path of a URDF, MJCF or packed file, a name that `sandgait robots` lists, or `"name=path"`. `ground`: a
    ground of LeggedVelocity in place of sand, such as `"poppy-close"`.

    The sheet is a dictionary: `stands`, `plates`, `dt`, `needed_dt` [s], and for each of `grounds` whether and why the
    robot does not stand there (`stands`, `reason`), `height` and `default_height` of the base [m], `tilt` [rad], `feet`
    (`sinkage` [m], `load` [N], `pressure` [Pa]), `joints` (`torque` [N·m], `part_of_limit`) and `steps_per_second` of
    one thread.
    """
    sheet, lines = _native.check_robot(str(robot), ground, packages())
    warn(lines, f"`sandgait robot {robot}` lists them")
    read: dict[str, Any] = json.loads(sheet)
    return read
