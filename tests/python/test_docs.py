"""Checks the documentation: every command and every block of Python works as shown, and every link leads somewhere."""

from __future__ import annotations

import functools
import os
import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

import sandgait
from pages import PAGES, ROOT, RUN, SHOWN, Run, blocks, inline_code, links
from sandgait import server

#: Pages with blocks that are run.
RUNNABLE = [page for page in PAGES if any(b.language in RUN and not b.excuse for b in blocks(page))]


def name(page: Path) -> str:
    return str(page.relative_to(ROOT))


@pytest.fixture
def directory() -> Iterator[Path]:
    """A copy of the repository for files that the pages write. Its path is short, because paths of sockets must be."""
    with tempfile.TemporaryDirectory(prefix="docs") as path:
        for entry in ROOT.iterdir():
            if not entry.name.startswith(".") and entry.name not in ("runs", "site"):
                Path(path, entry.name).symlink_to(entry)
        Path(path, ".venv").symlink_to(sys.prefix)
        yield Path(path)


@pytest.fixture
def environment() -> Iterator[dict[str, str]]:
    """An environment in which `sandgait` and `python` are those under test."""
    with tempfile.TemporaryDirectory(prefix="docs") as path:
        for command, program in (("sandgait", server.command()), ("python", [sys.executable])):
            Path(path, command).write_text(f'#!/bin/sh\nexec {shlex.join(program)} "$@"\n')
            Path(path, command).chmod(0o755)
        yield {**os.environ, "PATH": f"{path}:{os.environ['PATH']}", "MPLBACKEND": "Agg"}


@pytest.mark.parametrize("page", RUNNABLE, ids=name)
def test_code_blocks_work_as_shown(
    page: Path, directory: Path, environment: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(directory)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    session = Run(directory, environment)
    try:
        for block in blocks(page):
            if block.language in RUN and not block.excuse:
                session.run(block)
    finally:
        session.stop()


def test_every_block_runs_or_says_why_not(capsys: pytest.CaptureFixture[str]) -> None:
    all_blocks = [block for page in PAGES for block in blocks(page)]
    for block in all_blocks:
        assert block.language in RUN + SHOWN, f"{block}: language {block.language!r} is none of {RUN + SHOWN}"
    excused = [block for block in all_blocks if block.excuse is not None]
    for block in excused:
        assert len(str(block.excuse).split()) > 2, f"{block}: {block.excuse!r} is no reason"
    run = [block for block in all_blocks if block.language in RUN and block.excuse is None]
    assert len(run) > 3 * len(excused)
    with capsys.disabled():
        print(f"\ndocumentation: {len(run)} blocks run, {len(excused)} excused:")
        for block in excused:
            print(f"  {block}: {block.excuse}")


@functools.cache
def options(*command: str) -> list[str]:
    """The options that `sandgait COMMAND --help` lists; without a command, the commands."""
    text = subprocess.run([*server.command(), *command, "--help"], capture_output=True, text=True).stdout
    return re.findall(r"--[a-z-]+" if command else r"^  ([a-z]+) ", text, flags=re.MULTILINE)


@functools.cache
def all_options() -> set[str]:
    """The options of every command, example and benchmark."""
    scripts = [script.read_text(encoding="utf-8") for script in ROOT.glob("[be]*s/*.py")]
    found = [option for command in options() for option in options(command)]
    return {*found, *re.findall(r"--[a-z-]+", " ".join(scripts))}


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_commands_and_files_in_the_text_exist(page: Path) -> None:
    for code in inline_code(page):
        if match := re.match(r"--[a-z-]+", code):
            assert match[0] in all_options(), f"{name(page)}: nothing takes {code}"
        if re.fullmatch(r"(src|tests|docs|examples|benches|robots|python_client|proto)/[\w./-]*\w", code):
            assert (ROOT / code).exists(), f"{name(page)}: there is no {code}"
        if match := re.match(r"cargo (?:run|test) --release --(example|test) (\w+)", code):
            at = ROOT / f"{match[1]}s"
            assert (at / f"{match[2]}.rs").exists() or (at / match[2]).is_dir(), f"{name(page)}: there is no {code}"
        if match := re.match(r"python ([\w/]+\.py)", code):
            assert (ROOT / match[1]).exists(), f"{name(page)}: there is no {code}"
        if match := re.match(r"make ([a-z][a-z-]+)", code):
            assert f"\n{match[1]}:" in (ROOT / "Makefile").read_text(), f"{name(page)}: there is no {code}"
        if match := re.match(r"sandgait ([a-z]+)(?![:.])", code):
            assert match[1] in options(), f"{name(page)}: there is no {code}"
            for option in re.findall(r" (--[a-z-]+)", code):
                assert option in options(match[1]), f"{name(page)}: {code} has no {option}"


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_links_within_the_repository_exist(page: Path) -> None:
    """These are the links as GitHub shows them; the build of the site checks the site's links."""
    for link in links(page):
        target = link.partition("#")[0]
        assert "://" in link or (page.parent / target).exists(), f"{name(page)}: {link}"


def test_the_site_is_whole_and_needs_no_other_host(tmp_path: Path) -> None:
    """Every link has a target, every page is in the navigation, and formulas are rendered without another host."""
    # Not --quiet: it would hide the warnings that --strict counts.
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path)]
    built = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert built.returncode == 0, built.stderr
    for file in tmp_path.rglob("*"):
        if file.suffix == ".html":
            text = file.read_text(encoding="utf-8")
            loads = re.findall(r"<(?:script|link|img|iframe)[^>]*(?:src|href)=[\"']?(?:https?:)?//[^>]*", text)
            assert not loads, f"{file.name}: {loads}"
        if file.suffix == ".css":
            assert not re.findall(r"(?:url\(|@import )[\"']?(?:https?:)?//", file.read_text(encoding="utf-8")), file
    physics = (tmp_path / "physics.html").read_text(encoding="utf-8")
    assert "<math" in physics
    mechanisms = (ROOT / "src/sand/mechanism.rs").read_text(encoding="utf-8")
    ids = re.findall(r'^    (\w+): ".*(?:Sand|Sensor|Drive), intrusion', mechanisms, flags=re.MULTILINE)
    assert len(ids) > 15
    assert not [name for name in ids if f"<td><code>{name}</code></td>" not in physics]
    # The index of a search without a server, and the notebook as a page.
    assert (tmp_path / "search" / "search_index.js").read_text(encoding="utf-8").startswith("var __index")
    assert "diagnose" in (tmp_path / "ten_minutes.html").read_text(encoding="utf-8")
    page = (tmp_path / "reference" / "python.html").read_text(encoding="utf-8")
    shown = set(re.findall(r'<h2 id="sandgait\.([^"]*)"', page))
    # The version is of the native module, which only a build puts beside the sources.
    modules = {"export.to_sb3", "mujoco", "wrappers", "logs", "ray", "foreign", "identified"}
    assert shown | {"__version__"} == {*sandgait.__all__, *modules}
    for name in ("mujoco.add_sand", "wrappers.OnSand", "logs.to_csv", "ray.serve"):
        assert f'id="sandgait.{name}"' in page


def test_quoted_speeds_are_in_the_results() -> None:
    """Every number on the page on performance is in the record of measurements."""
    quoted = set(re.findall(r"\b\d{1,3},\d{3}\b", (ROOT / "docs/performance.md").read_text(encoding="utf-8")))
    measured = (ROOT / "benches/RESULTS.md").read_text(encoding="utf-8")
    assert len(quoted) > 10
    assert not {figure for figure in quoted if figure not in measured}


def test_messages_are_those_of_the_sources() -> None:
    """Every message in the first column of a table on troubleshooting is one that the program can give."""
    sources = [*ROOT.glob("src/**/*.rs"), *ROOT.glob("python_client/sandgait/*.py"), ROOT / "Makefile"]
    text = " ".join(source.read_text(encoding="utf-8") for source in sources).replace('\\"', '"')
    text = re.sub(r'\\\n\s*|"\n\s*f?"', "", text)
    page = (ROOT / "docs/troubleshooting.md").read_text(encoding="utf-8")
    page = re.sub(r"\| it says \|.*?\n\n", "", page, flags=re.DOTALL)  # these are grpc's
    messages = re.findall(r"^\| `([^`]*)` \|", page, flags=re.MULTILINE)
    assert len(messages) > 15  # the page leaves out messages that say what to do
    parts = [(message, part.strip(" :;,.")) for message in messages for part in re.split("…|: ", message)]
    assert not [(message, part) for message, part in parts if part not in text]


def test_the_page_on_physics_has_the_numbers_of_the_sources() -> None:
    """The coefficients of both laws."""
    page = (ROOT / "docs/physics.md").read_text(encoding="utf-8").replace("−", "-")
    spatial = (ROOT / "src/sand/law/agarwal2023.rs").read_text(encoding="utf-8")
    for numbers in re.findall(r"^    \[(-?\d\.\d{5}), (.*?), (.*?)\],$", spatial, flags=re.MULTILINE):
        assert f" | {' | '.join(numbers)} |" in page, numbers
    planar = (ROOT / "src/sand/coefficients.rs").read_text(encoding="utf-8")
    sets = re.findall(r"per_cm3\(\[([-\d., ]+)\]\)", planar)
    assert len(sets) == 3
    for numbers in sets:
        shown = [re.sub(r"^(-?)0(?=\.\d*[1-9])", r"\1", n) if float(n) else "0" for n in numbers.split(", ")]
        assert f" | {' | '.join(shown)} |" in page, shown


def test_the_dashboard_and_the_compose_file_name_what_exists() -> None:
    """Metrics of the dashboard are those of the table in docs/serving.md; mounted files are there."""
    folder = ROOT / "examples/server"
    shown = set(re.findall(r"sandgait_[a-z_]+", (folder / "grafana.json").read_text(encoding="utf-8")))
    page = (ROOT / "docs/serving.md").read_text(encoding="utf-8")
    known = set(re.findall(r"`(sandgait_[a-z_]+)", page))
    assert {metric.removesuffix("_bucket") for metric in shown} == known
    compose = yaml.safe_load((folder / "compose.yaml").read_text(encoding="utf-8"))
    mounts = [mount for service in compose["services"].values() for mount in service.get("volumes", [])]
    files = [mount.partition(":")[0] for mount in mounts if mount.startswith("./") and "keys" not in mount]
    assert len(files) == 5
    for file in files:
        assert (folder / file).is_file(), file
    for option in compose["services"]["sandgait"]["command"][1:]:
        assert option.partition("=")[0] in options("serve"), option
