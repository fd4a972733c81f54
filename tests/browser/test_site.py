"""The documentation's site, opened from a disk in a real browser."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from chromium import Page

HOME = Path(__file__).parents[2]

#: Types a word into the field of the search.
TYPED = """const field = document.querySelector(".md-search__input");
field.focus();
field.value = "footprint";
field.dispatchEvent(new Event("input", { bubbles: true }));
field.dispatchEvent(new Event("keyup", { bubbles: true }));"""


def built(folder: Path) -> Path:
    """The site, built in a folder."""
    site = folder / "site"
    build = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(site)]
    subprocess.run(build, cwd=HOME, check=True)
    return site


def test_the_search_works_from_a_disk(tmp_path: Path) -> None:
    site = built(tmp_path)
    page = Page(tmp_path / "profile")
    try:
        page.open(f"file://{site}/index.html")
        page.ask(TYPED)
        page.until("document.querySelectorAll('.md-search-result__item').length > 2", timeout=20)
        links = page.ask("[...document.querySelectorAll('.md-search-result__item a')].map((a) => a.href)")
        assert any("HexapodTerrain" in link for link in links), links
        assert not [address for address in page.requests if not address.startswith(("file:", "data:", "about:"))]
        assert not page.troubles
    finally:
        page.close()


def test_no_page_is_wider_than_a_phone(tmp_path: Path) -> None:
    """Tables, figures and code scroll within themselves."""
    site = built(tmp_path)
    page = Page(tmp_path / "profile")
    try:
        page.call("Emulation.setDeviceMetricsOverride", width=390, height=844, deviceScaleFactor=1, mobile=True)
        wide = {}
        for file in sorted(site.rglob("*.html")):
            page.open(f"file://{file}")
            wide[str(file.relative_to(site))] = page.ask("document.documentElement.scrollWidth - 390")
        assert not {name: by for name, by in wide.items() if by > 0}
    finally:
        page.close()


def test_pages_are_dark_where_the_reader_wants_it(tmp_path: Path) -> None:
    """Text and background differ in both schemes, and the theme follows the system."""
    site = built(tmp_path)
    page = Page(tmp_path / "profile")
    try:
        light = {}
        for scheme in ("light", "dark"):
            page.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
            page.open(f"file://{site}/index.html")
            page.ask("localStorage.clear()")
            page.open(f"file://{site}/index.html")
            light[scheme] = page.ask(
                "['backgroundColor', 'color'].map((of) => getComputedStyle(document.body)[of].match(/[0-9.]+/g)"
                ".slice(0, 3).reduce((a, b) => a + Number(b), 0))"
            )
        assert light["light"][0] > 600 > 300 > light["light"][1], light
        assert light["dark"][0] < 200 < 400 < light["dark"][1], light
    finally:
        page.close()
