"""The page of a diagnosis in a real browser: it fits windows of every width and requests nothing.

If $SANDGAIT_SHOTS is set, screenshots are written to this directory.
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from chromium import Page

import sandgait

DATA = Path(__file__).parents[2] / "examples/data"


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("diagnosis")
    sandgait.diagnose(DATA / "force_log.csv", DATA / "force_log.toml", progress=False).save(out)
    return out / "report.html"


@pytest.mark.parametrize("width", [1400, 1024, 390])
def test_the_page_fits(report: Path, tmp_path: Path, width: int) -> None:
    page = Page(tmp_path / "profile")
    page.call("Emulation.setDeviceMetricsOverride", width=width, height=1200, deviceScaleFactor=1, mobile=width < 500)
    page.open(report.as_uri())
    page.picture(Path(os.environ.get("SANDGAIT_SHOTS", tmp_path)) / f"diagnosis_{width}.png")
    assert page.ask("document.documentElement.scrollWidth") <= width
    smallest = page.ask(
        "Math.min(...[...document.querySelectorAll('svg text')].filter(t => t.textContent)"
        ".map(t => t.getBoundingClientRect().height))"
    )
    assert smallest >= 9, "texts of figures are readable"
    first = page.ask("document.querySelector('.verdict').getBoundingClientRect().bottom")
    assert first < 400, "the sentence is on top"
    assert page.ask("document.querySelector('svg').getBoundingClientRect().top") < 1200, (
        "a figure is in the first window"
    )
    assert page.troubles == []
    assert [address for address in page.requests if not address.startswith("file:")] == []
    page.close()
