"""The documentation's site, opened from a disk in a real browser."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from chromium import Page

HOME = Path(__file__).parents[2]


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
        page.open(f"file://{site}/search.html?q=footprint")
        page.until("document.querySelectorAll('#mkdocs-search-results article').length > 2", timeout=20)
        links = page.ask("[...document.querySelectorAll('#mkdocs-search-results a')].map((a) => a.href)")
        assert any("HexapodTerrain" in link for link in links), links
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
