"""Robots from descriptions: does a robot stand?"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from . import _native
from .arguments import checked
from .options import folders
from .options import packages as installed
from .user_warnings import warn


@checked
def check_robot(
    robot: str | Path,
    ground: str | None = None,
    packages: str | Path | Sequence[str | Path] = (),
    inertia: str = "plausible",
) -> dict[str, Any]:
    """Lets a robot stand in its default pose for five seconds on hard ground and on sand, as `sandgait robot --check`.

    `robot`: path of a URDF, MJCF or packed file, a name that `sandgait robots` lists, or `"name=path"`. `ground`: a
    ground of LeggedVelocity in place of sand, such as `"poppy-close"`. `packages`: folders in which the description's
    meshes may lie besides its own package. `inertia`: `"file"` keeps inertias that no body can have, which are
    otherwise replaced by those of the body's shapes.

    The sheet is a dictionary: `stands`, `plates`, `dt`, `needed_dt` [s], and for each of `grounds` whether and why the
    robot does not stand there (`stands`, `reason`), `height` and `default_height` of the hips [m], `tilt` [rad], `feet`
    (`sinkage` [m], `load` [N], `pressure` [Pa]), `joints` (`torque` [N·m], `part_of_limit`) and `steps_per_second` of
    one thread.
    """
    sheet, lines = _native.check_robot(str(robot), ground, installed(), folders(packages), inertia)
    warn(lines, f"`sandgait robot {robot}` lists them")
    read: dict[str, Any] = json.loads(sheet)
    return read
