"""The workflows: what they run is fixed, and packages carry the notices of the crates that they contain."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

HOME = Path(__file__).parents[2]
WORKFLOWS = sorted((HOME / ".github" / "workflows").glob("*.yml"))


def test_actions_and_tools_have_fixed_versions() -> None:
    """A tag can be moved to other code; a commit cannot."""
    assert len(WORKFLOWS) == 2
    for file in WORKFLOWS:
        text = file.read_text()
        for action in re.findall(r"uses: (\S+)", text):
            assert action.startswith("./") or re.search(r"@[0-9a-f]{40}$", action), action
        for line in re.findall(r"cargo install .*", text):
            assert "--locked" in line, line
            assert re.search(r"@\d+\.\d+\.\d+", line), line


def test_a_release_waits_for_all_tests() -> None:
    text = (HOME / ".github" / "workflows" / "release.yml").read_text()
    assert "uses: ./.github/workflows/check.yml" in text
    for job in ("container", "publish"):
        needs = re.search(rf"\n  {job}:\n    needs: (.+)", text)
        assert needs, job
        assert "check" in needs[1], job


def test_notices_of_all_linked_crates(tmp_path: Path) -> None:
    out = tmp_path / "notices.txt"
    subprocess.run([sys.executable, HOME / ".github" / "notices.py", out], cwd=HOME, check=True)
    head, *texts = out.read_text().split("\n---- [")
    crates = re.findall(r"^(\S+) \d[^:]*: .+ \[([\d, ]+)\]$", head, re.MULTILINE)
    names = {name for name, _ in crates}
    assert {"tonic", "rustls", "rapier3d", "tiny-skia", "pyo3"} <= names
    assert not {"prost-build", "trybuild"} & names
    assert {int(n) for _, marks in crates for n in marks.split(", ")} <= set(range(1, len(texts) + 1))
    whole = {k for k, text in enumerate(texts, start=1) if len(text) > 400}
    assert all(whole & {int(n) for n in marks.split(", ")} for _, marks in crates)
