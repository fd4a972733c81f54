"""What `sandgait certify` and `sandgait adapt` share: their parser, calls of the program, the frame of their pages."""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from sandgait_deploy import Refused

from . import server


class CommandParser(argparse.ArgumentParser):
    """The parser of `sandgait COMMAND`."""

    def __init__(self, command: str, description: str) -> None:
        super().__init__(prog=f"sandgait {command}", description=description)
        self._command = command

    def error(self, message: str) -> None:  # type: ignore[override]
        """One line, without the usage."""
        print(f"sandgait: {self._command}: {message}; see {self.prog} --help", file=sys.stderr)
        raise SystemExit(2)


def check_file(path: Path) -> None:
    """Raises Refused if a file cannot be written at `path`; to be called before the work whose results it gets."""
    if not path.parent.is_dir():
        raise Refused(f"{path}: its folder does not exist; make it first")
    is_new = not path.exists()
    try:
        with path.open("a", encoding="utf-8"):
            pass
        if is_new:
            path.unlink()
    except OSError as error:
        raise Refused(f"{unwritten(path, error)}; give another path") from None


def check_folder(path: Path) -> None:
    """Raises Refused if `path` has something in it, or if no folder can be made there."""
    try:
        if path.exists() and any(path.iterdir()):
            raise Refused(f"{path}: is not empty; give another folder with --out")
        above = next(place for place in (path, *path.absolute().parents) if place.exists())
        tempfile.TemporaryDirectory(dir=above).cleanup()
    except OSError as error:
        raise Refused(f"{path}: cannot be written: {error.strerror}; give another folder with --out") from None


def unwritten(path: Path, error: OSError) -> str:
    """What is said of a file or folder that cannot be written."""
    return f"{error.filename or path}: cannot be written: {error.strerror or error}"


def failure(*words: str) -> str | None:
    """Runs `sandgait WORDS`. None if it succeeds; otherwise its last line on stderr, which may be empty."""
    done = _run(words)
    return _last_line(done) if done.returncode else None


def said_by(*words: str) -> str:
    """The output of `sandgait WORDS`. Raises Refused with its last line on stderr if it fails."""
    done = _run(words)
    if done.returncode:
        raise Refused(_last_line(done).removeprefix("sandgait: ") or f"sandgait {' '.join(words)} fails")
    return done.stdout


def _run(words: Iterable[str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*server.command(), *words], capture_output=True, text=True, check=False)


def _last_line(done: subprocess.CompletedProcess[str]) -> str:
    return (done.stderr.strip().splitlines() or [""])[-1]


def nine_commands(network: Path, options: Mapping[str, Any]) -> list[dict[str, Any]]:
    """How the policy follows the nine commands in the simulator: for each its command, velocity, error and falls.

    `sandgait evaluate --commands` plays them, with `options` in the place of the training's. Raises Refused if the
    policy cannot be evaluated."""
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / "made.json"
        said = failure("evaluate", str(network), "--commands", "--json", str(made), "--options", json.dumps(options))
        if said is not None:
            raise Refused(f"{network.parent}: the policy cannot be evaluated: {said or 'it says nothing'}")
        rows: list[dict[str, float]] = json.loads(made.read_text())["results"]
    names = ["lin_vel_x", "lin_vel_y", "ang_vel_yaw"]
    return [
        {
            "command": [row[f"command_{name}"] for name in names],
            "velocity": [row[name] for name in names],
            "error": row["error"],
            "falls": row["falls"],
        }
        for row in rows
    ]


def html_page(title: str, width: int, style: str, parts: Iterable[str]) -> str:
    """A self-contained page of HTML `parts`, at most `width` rem wide. `title` is HTML, too."""
    frame = (
        f"body {{ font: 16px/1.5 system-ui, sans-serif; max-width: {width}rem; margin: 2rem auto; padding: 0 1rem; "
        "color: #222; }\nh1 { font-size: 1.5rem; }\n"
    )
    head = f"<meta charset='utf-8'><title>{title}</title><style>\n{frame}{style}</style>"
    return f"<!doctype html><html lang='en'><head>{head}</head><body>{''.join(parts)}</body></html>\n"
