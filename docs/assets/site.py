"""Hooks of mkdocs for the site: formulas, pages from files of the root folder and from the notebook, the page of the
protocol, the table of mechanisms, llms.txt."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[2]

#: Pages of the site whose files are not in docs/, because people look for them in the root folder.
ELSEWHERE = {
    "README.md": "index.md",
    "ARCHITECTURE.md": "architecture.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "benches/RESULTS.md": "results.md",
}

#: The pages' texts, for llms.txt.
TEXTS: dict[str, str] = {}

#: The notebook that is a page, too.
NOTEBOOK = ROOT / "docs/ten_minutes.ipynb"


def on_files(files: Files, config: Any, **_: Any) -> Files:
    """Adds the pages of `ELSEWHERE` and of the notebook."""
    for source, page in ELSEWHERE.items():
        files.append(File.generated(config, page, content=(ROOT / source).read_text(encoding="utf-8")))
    files.append(File.generated(config, "ten_minutes.md", content=notebook()))
    return files


def notebook() -> str:
    """The cells of the notebook as Markdown, with a link to the file below its title."""
    cells = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    texts = [(cell["cell_type"] == "code", "".join(cell["source"])) for cell in cells]
    title, *rest = [f"```python\n{text}\n```" if code else text for code, text in texts]
    return "\n\n".join([title, f"[Download this page as a notebook]({NOTEBOOK.name}) and run it.", *rest])


def on_page_markdown(markdown: str, page: Page, **_: Any) -> str:
    """Converts formulas (```math, which GitHub also shows) to MathML for browsers, and links to files of `ELSEWHERE` to
    links to their pages."""
    if page.file.src_uri == "index.md":
        markdown = markdown.replace("](docs/", "](").replace(f"]({NOTEBOOK.name})", "](ten_minutes.md)")
    for source, target in ELSEWHERE.items():
        markdown = markdown.replace(f"](../{source}", f"]({target}").replace(f"]({source})", f"]({target})")
    markdown = markdown.replace("<!-- proto/sandgait/v1 -->", protocol())
    markdown = markdown.replace("<!-- src/sand/mechanism.rs -->", mechanisms())
    TEXTS[page.file.dest_uri] = markdown
    return re.sub(r"^```math\n(.*?)\n```$", _formula, markdown, flags=re.DOTALL | re.MULTILINE)


def _formula(match: re.Match[str]) -> str:
    return f'<div class="formula">{convert(match[1], display="block")}</div>'


def protocol() -> str:
    """The files of proto/sandgait/v1 as Markdown: a section for each service and message, in the files' order."""
    parts = []
    for file in sorted((ROOT / "proto/sandgait/v1").glob("*.proto")):
        comment: list[str] = []
        body: list[str] = []
        for line in file.read_text(encoding="utf-8").splitlines():
            if body:
                body.append(line)
                if line == "}":
                    parts.append("```proto\n" + "\n".join(body) + "\n```\n")
                    body = []
            elif line.startswith("//"):
                comment.append(line.removeprefix("//").strip())
            elif match := re.match(r"(service|message|enum) (\w+) \{(\})?", line):
                parts.append(f"## {match[2]} ({match[1]})\n\n" + " ".join(comment) + "\n")
                body = [] if match[3] else [line]
                comment = []
            elif line.startswith("syntax"):
                parts.append(" ".join(comment) + "\n")
                comment = []
            elif not line.strip():
                comment = []
    return "\n".join(parts)


def mechanisms() -> str:
    """The rows of `mechanisms!` in src/sand/mechanism.rs as a table."""
    entry = r'^    (\w+): "(.*?)", "(.*?)", \[(.*?), (.*?)\], [\d.]+, (\w+),.*\n\s*"(.*?)", "(.*?)"'
    text = (ROOT / "src/sand/mechanism.rs").read_text(encoding="utf-8")
    lines = ["| id | value | law | acts in | bounds | source |", "|---|---|---|---|---|---|"]
    for name, symbol, unit, low, high, side, law, source in re.findall(entry, text, flags=re.MULTILINE):
        value = symbol if unit == "1" else f"{symbol} [{unit}]"
        bounds = f"{float(low):g} to {float(high):g}".replace("-", "−")
        cells = [f"`{name}`", value, law, side.lower(), bounds, source]
        lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join(lines)


def first_sentence(markdown: str) -> str:
    """The first sentence of a page, after headings, pictures and code."""
    prose = re.sub(r"^```.*?^```$|<!--.*?-->", "", markdown, flags=re.DOTALL | re.MULTILINE)
    paragraphs = [part.strip() for part in prose.split("\n\n")]
    first = next((part for part in paragraphs if part and part[0] not in "#!|<:"), "")
    return re.split(r"(?<=[.:]) ", re.sub(r"\s+", " ", re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", first)))[0].rstrip(":")


def on_post_build(config: Any, **_: Any) -> None:
    """llms.txt, a list of pages for language models (https://llmstxt.org), and llms-full.txt with the texts."""
    lines = [f"# {config.site_name}", "", f"> {config.site_description}", ""]
    full = []
    for title, pages in ((section, page) for entry in config.nav for section, page in entry.items()):
        lines += [f"## {title}", ""]
        for name, source in (item for page in pages for item in page.items()):
            uri = source.removesuffix(".md") + ".html"
            lines.append(f"- [{name}]({uri}): {first_sentence(TEXTS[uri])}")
            full.append(TEXTS[uri])
        lines.append("")
    site = Path(config.site_dir)
    (site / "llms.txt").write_text("\n".join(lines), encoding="utf-8")
    (site / "llms-full.txt").write_text("\n\n".join(full), encoding="utf-8")
