"""What `sandgait certify` and `sandgait adapt` share: their parser, calls of the program, the frame of their pages."""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterable
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


def failure(*words: str) -> str | None:
    """Runs `sandgait WORDS`. None if it succeeds; otherwise its last line on stderr, which may be empty."""
    done = subprocess.run([*server.command(), *words], capture_output=True, text=True, check=False)
    return (done.stderr.strip().splitlines() or [""])[-1] if done.returncode else None


def nine_commands(network: Path, *options: str) -> list[dict[str, Any]]:
    """How the policy follows the nine commands in the simulator: for each its command, velocity, error and falls.

    `sandgait evaluate --commands` plays them, with `--option` before each of the options. Raises Refused if the policy
    cannot be evaluated."""
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / "made.json"
        chosen = [word for option in options for word in ("--option", option)]
        said = failure("evaluate", str(network), "--commands", "--json", str(made), *chosen)
        if said is not None:
            raise Refused(f"{network.parent}: the policy cannot be evaluated: {said or 'it says nothing'}")
        lines: list[dict[str, Any]] = json.loads(made.read_text())["results"]["lines"]
    return lines


def html_page(title: str, width: int, style: str, parts: Iterable[str]) -> str:
    """A self-contained page of HTML `parts`, at most `width` rem wide. `title` is HTML, too."""
    frame = (
        f"body {{ font: 16px/1.5 system-ui, sans-serif; max-width: {width}rem; margin: 2rem auto; padding: 0 1rem; "
        "color: #222; }\nh1 { font-size: 1.5rem; }\n"
    )
    head = f"<meta charset='utf-8'><title>{title}</title><style>\n{frame}{style}</style>"
    return f"<!doctype html><html lang='en'><head>{head}</head><body>{''.join(parts)}</body></html>\n"
