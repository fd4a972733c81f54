"""Prepares the options of tasks for sending."""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from . import _native
from .errors import InvalidRequest, UnknownOption, shortened
from .files import read_within
from .user_warnings import warn

#: Longest part of a path in a message: our choice, a line of a terminal. A whole file's text may be given by mistake.
SHOWN = 100


def task_id(name: str) -> str:
    """The id of the task that a user calls `name`. The namespace can be left out, and also the version, which then is
    the latest. Any other name is returned unchanged, because a server may have tasks that this client does not know."""
    from . import TASKS  # not above, because that module imports this one

    full = name if name.startswith("sandgait/") else f"sandgait/{name}"
    return next((id for id in reversed(TASKS) if full in (id, id.rpartition("-v")[0])), name)


def with_files(options: Mapping[str, Any]) -> Mapping[str, Any]:
    """Replaces paths of files (sand.toml, hardware.toml, URDF, MJCF, heights of the ground) by the files' contents."""
    texts: dict[str, Any] = {name: _text(name, options[name]) for name in ("sand", "hardware") if name in options}
    drawn = options.get("domain_rand")
    if isinstance(drawn, Mapping) and "hardware" in drawn:
        texts["domain_rand"] = {**drawn, "hardware": _text("domain_rand.hardware", drawn["hardware"])}
    robot = options.get("robot")
    if isinstance(robot, (str, Path)):
        texts["robot"] = str(robot)
        if _native.is_description(str(robot)):
            # with its meshes cut into plates, as servers require
            allowed = folders(options.get("packages", ()))
            inertia = str(options.get("inertia", "plausible"))
            texts["robot"], lines, dt = _native.pack_robot(str(robot), packages(), allowed, inertia)
            options = {name: value for name, value in options.items() if name not in ("packages", "inertia")}
            if dt is not None and "dt" not in options:
                texts["dt"] = dt
            warn(lines, f"`sandgait robot {robot}` lists them")
    relief = options.get("relief")
    if isinstance(relief, Mapping) and relief.get("file"):
        texts["relief"] = {**relief, "file": _heights(relief["file"])}
    return {**options, **texts}


def _text(name: str, file: Any) -> Any:
    """The contents of an option's `file`. A text of several lines, as settings.json has it, is the contents already."""
    if isinstance(file, str) and (not file or "\n" in file):
        return file
    try:
        return read_within(file).decode("utf-8")
    except (OSError, TypeError, ValueError) as error:
        # an OSError repeats the path
        reason = error.strerror if isinstance(error, OSError) else error
        raise InvalidRequest(f"{name}: {shortened(repr(file), SHOWN)} cannot be read as a file: {reason}") from error


def keyword_error(message: str) -> InvalidRequest:
    """The exception for a refused request. For an unknown option it has Python's words for an unknown keyword."""
    unknown = re.match(r'option "(.*)" is unknown; (?:did you mean "(.*)"\? )?known: ', message)
    if unknown is None:
        return InvalidRequest(message)
    meant = f"did you mean {unknown[2]!r}? " if unknown[2] else ""
    return UnknownOption(
        f"unexpected keyword argument {unknown[1]!r}; {meant}the task's options: {message[unknown.end() :]}"
    )


def _heights(file: object) -> str:
    if not isinstance(file, (str, Path)):
        raise InvalidRequest(f"relief.file: {file!r} is not a path")
    return file if isinstance(file, str) and file.startswith("heights:") else _native.pack_heights(str(file))


def folders(allowed: Any) -> list[str]:
    """The option `packages`, one folder or several, in which the files of a robot's description may lie."""
    if isinstance(allowed, (str, Path)):
        return [str(allowed)]
    try:
        return [str(Path(folder)) for folder in allowed]
    except TypeError as error:
        raise InvalidRequest(f"packages: {allowed!r} is no folder, and no list of folders") from error


def packages() -> list[str]:
    """Folders from which Python imports. Packages with robots' descriptions may be in them."""
    return [folder for folder in sys.path if folder]
