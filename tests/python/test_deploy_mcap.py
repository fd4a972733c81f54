"""The Controller's log as MCAP: the same rows as its CSV, and what is said if mcap is missing."""

from __future__ import annotations

import csv
import io
import sys
from pathlib import Path

import pytest

from sandgait import logs
from sandgait.certify import walk
from sandgait.certify.walk import Job
from sandgait.errors import InvalidRequest
from sandgait.plant import Conditions
from sandgait_deploy import Controller, Refused

ROOT = Path(__file__).parents[2]
CAT = ROOT / "examples/policies/LeggedVelocity-sandcat"


def rows(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(text)))


def test_mcap_has_the_rows_of_the_csv(tmp_path: Path) -> None:
    job = Job(str(CAT), str(ROOT / "robots/sandcat.xml"), Conditions(), ((0.4, 0.0, 0.0), (0.0, 0.0, 0.8)))
    for name in ("walk.csv", "walk.mcap"):
        assert walk.record(job, tmp_path / name, seconds=0.4)
    assert logs.kind(tmp_path / "walk.mcap") == "mcap"
    read, wanted = rows(logs.to_csv(tmp_path / "walk.mcap").decode()), rows((tmp_path / "walk.csv").read_text())
    assert len(read) == len(wanted) > 30
    assert {row["run"] for row in read} == {"walk1", "walk2"}
    for got, row in zip(read, wanted, strict=True):
        assert set(got) == {name for name, value in row.items() if value}
        assert all(got[name] == value or float(got[name]) == float(value) for name, value in row.items() if value)


def test_a_log_that_was_cut_off_is_one_error(tmp_path: Path) -> None:
    job = Job(str(CAT), str(ROOT / "robots/sandcat.xml"), Conditions(), ((0.4, 0.0, 0.0),))
    walk.record(job, tmp_path / "walk.mcap", seconds=0.4)
    whole = (tmp_path / "walk.mcap").read_bytes()
    (tmp_path / "walk.mcap").write_bytes(whole[:200])
    with pytest.raises(InvalidRequest, match=r"walk\.mcap: "):
        logs.to_csv(tmp_path / "walk.mcap")


def test_without_mcap_the_remedy_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mcap.writer", None)
    with pytest.raises(Refused, match=r"mcap is not installed: pip install mcap, or give a path that ends in \.csv"):
        Controller(CAT, log=tmp_path / "walk.mcap")
    assert not (tmp_path / "walk.mcap").exists()
