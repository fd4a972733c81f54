"""What mkdocs does not do by itself: formulas, and pages that are files of the repository's root."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parents[2]

#: Pages of the site that live outside docs/, where people look for them first.
ELSEWHERE = {
    "ARCHITECTURE.md": "architecture.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "benches/RESULTS.md": "results.md",
}


def on_files(files: Files, config: Any, **_: Any) -> Files:
    """Adds the pages of `ELSEWHERE`."""
    for source, page in ELSEWHERE.items():
        files.append(File.generated(config, page, content=(ROOT / source).read_text(encoding="utf-8")))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Formulas (```math, which GitHub draws too) become MathML, which browsers draw; links to `ELSEWHERE` stay here."""
    for source, page in ELSEWHERE.items():
        markdown = markdown.replace(f"](../{source}", f"]({page}")
    return re.sub(r"^```math\n(.*?)\n```$", _formula, markdown, flags=re.DOTALL | re.MULTILINE)


def _formula(match: re.Match[str]) -> str:
    return f'<div class="formula">{convert(match[1], display="block")}</div>'
