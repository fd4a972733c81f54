"""Writes docs/images/diagnosis.png: the page of the diagnosis that docs/diagnosis.md makes. `make diagnosis-picture`.

python docs/assets/diagnosis_picture.py SANDGAIT [OUT.png WIDTH HEIGHT]
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[2]
sys.path.append(str(ROOT / "tests/browser"))

from chromium import Page  # noqa: E402


def picture(page: Path, out: Path, width: int, height: int) -> None:
    """A screenshot of the upper part of a page at this width [px]."""
    with tempfile.TemporaryDirectory() as profile:
        tab = Page(Path(profile))
        tab.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)
        tab.open(page.as_uri())
        wider = tab.ask("document.documentElement.scrollWidth")
        assert wider <= width, f"the page is {wider} px wide in a window of {width} px"
        tab.picture(out)
        tab.close()


def main(program: str, out: str = "docs/images/diagnosis.png", width: str = "1000", height: str = "900") -> None:
    """Makes the diagnosis and the picture."""
    log = ROOT / "examples/data/force_log"
    with tempfile.TemporaryDirectory() as folder:
        files = [f"{log}.csv", "--experiment", f"{log}.toml", "--out", folder]
        subprocess.run([program, "diagnose", *files], check=True, stdout=subprocess.DEVNULL)
        picture(Path(folder) / "report.html", ROOT / out, int(width), int(height))


if __name__ == "__main__":
    main(*sys.argv[1:])
