"""Each study three ways: on the command line, in this process and on a server. The results have the same bytes."""

from __future__ import annotations

import csv
import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sandgait
from conftest import RemoteServer
from sandgait import _native, client, server

ROOT = Path(__file__).parents[2]
WHEELS = ROOT / "tests/data/real_wheel"
LOGS = ROOT / "examples/data"
SAND = str(WHEELS / "sand_discs.toml")
#: A study that warns: a mechanism of this sand has no effect on a walking robot.
UNFELT = (WHEELS / "sand_discs.toml").read_text(encoding="utf-8") + "added_mass = 0.1\n"

#: Name and words of each study. Files are named by paths, as a user would.
STUDIES: list[tuple[str, list[str]]] = [
    ("walk", ["--frequency=[2.0,0.0,-1.3333333333333333]", "--leg=revC", "--medium=zeta=0.4", "--slope-deg=-5"]),
    ("walk", ["--frequency=3", "--sand=UNFELT", "--engine=rapier"]),
    ("walk", ["--frequency=2", "--option=torque_limit=0.0212345678901234567", "--option=payload=0.01"]),
    ("intrude", ["--shape=xi=-30", "--omega=-3", f"--sand={SAND}"]),
    (
        "intrude",
        ["--body=cylinder:radius=0.0625,width=0.06", "--trials=ROWS", "--mu-s=0.3", "--medium=mu=1.3,rho=1500"],
    ),
    ("intrude", ["--body=sphere:radius=0.02", "--trials=PATH", "--memory"]),
    ("sweep", ["--vary=leg=L,C", "--vary=frequency=1,2.5", "--set=leg-mass=0.003", "--medium=poppy-close"]),
    ("sweep", ["--vary=xi=0:75:2", "--optimize=cost-of-transport"]),
    ("evaluate", ["--seeds=3", "--slopes=[0.0,5.0]", "--option=max_episode_steps=40", "--", "tripod:2"]),
    ("evaluate", ["--seeds=2", "--option=max_episode_steps=20", "--", str(ROOT / "tests/data/policy_ppo.onnx")]),
    ("diagnose", [f"--experiment={LOGS / 'force_log.toml'}", "--", str(LOGS / "force_log.csv")]),
    ("calibrate", ["--", str(WHEELS / "discs.csv")]),
    ("calibrate", ["--", str(ROOT / "tests/data/penetration.csv")]),
    ("reproduce", ["--figure=2"]),
    ("validate", [f"--data={WHEELS}"]),
]


def test_every_study_is_compared() -> None:
    listed = subprocess.run([*server.command(), "studies"], capture_output=True, text=True, check=True).stdout
    names = {line.split()[0] for line in listed.splitlines() if not line.startswith(" ")}
    assert names == {name for name, _ in STUDIES}


@pytest.mark.parametrize(("name", "words"), STUDIES, ids=lambda one: one if isinstance(one, str) else one[0])
def test_three_ways_have_the_same_bytes(name: str, words: list[str], tmp_path: Path, remote: RemoteServer) -> None:
    (tmp_path / "sand.toml").write_text(UNFELT, encoding="utf-8")
    (tmp_path / "rows.csv").write_text("name,vx,wy,depth [mm],load\na,0.01,0.1,,20\nb,0.01,0.1,20,\nc,0.01,0,,1e5\n")
    (tmp_path / "path.csv").write_text("trial,t,vx,vz,depth\n1,0,0,0,0.01\n1,1,0.01,0,0.012\n1,2,0.01,0,0.012\n")
    files = {"UNFELT": "sand.toml", "ROWS": "rows.csv", "PATH": "path.csv"}
    for word, file in files.items():
        words = [one.replace(word, str(tmp_path / file)) for one in words]
    here = _native.study(None, name, words, {}, None)
    there = _native.study(client.place(remote.address), name, words, {}, None)
    same(here, there)
    # on the command line words follow the options without `--`
    out = tmp_path / "out"
    if name == "calibrate":  # its --out is the file of a sand
        outputs = [f"--csv={tmp_path / 'table.csv'}"]
    else:
        outputs = [f"--out={out}", f"--csv={tmp_path / 'table.csv'}"]
    run = [*server.command(), name, *outputs, *words]
    done = subprocess.run(run, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    _, _, warnings, tables, made, _ = here
    for line in warnings:
        assert line in done.stderr
    equal_table(tables[0][1], tmp_path / "table.csv")
    if name == "calibrate":
        return
    for title, columns in tables:
        equal_table(columns, out / f"{title}.csv")
    for file, content in made:
        assert (out / file).read_bytes() == content, file


def same(here: tuple[Any, ...], there: tuple[Any, ...]) -> None:
    """Two results are the same to the bit."""
    assert here[0] == there[0]
    assert json.loads(here[1] or "{}") == json.loads(there[1] or "{}")
    assert here[2] == there[2]
    assert here[4] == there[4]
    assert here[5] == there[5]
    for (a, mine), (b, theirs) in zip(here[3], there[3], strict=True):
        assert a == b
        assert [(name, unit) for name, unit, _ in mine] == [(name, unit) for name, unit, _ in theirs]
        for (name, _, x), (_, _, y) in zip(mine, theirs, strict=True):
            equal = x == y if isinstance(x, list) else np.asarray(x).tobytes() == np.asarray(y).tobytes()
            assert equal, name


def equal_table(columns: list[tuple[str, str, Any]], path: Path) -> None:
    """A table equals the CSV file: numbers to the bit, and a blank cell is NaN."""
    with path.open(newline="") as file:
        heading, *rows = csv.reader(file)
    assert heading == [name for name, _, _ in columns]
    for k, (name, _, values) in enumerate(columns):
        cells = [row[k] for row in rows]
        if isinstance(values, list):
            assert cells == values, name
        else:
            numbers = np.array([float(cell or "nan") for cell in cells])
            assert np.array_equal(numbers, values, equal_nan=True), name


def test_functions_pass_their_arguments_on() -> None:
    """A function gives what its words give."""
    walks = sandgait.walk([2.0, -1.5], leg="revC", medium="zeta=0.4", slope_deg=-5, dt=2.5e-4, progress=False)
    words = ["--frequency=2,-1.5", "--leg=revC", "--medium=zeta=0.4", "--slope-deg=-5", "--dt=2.5e-4"]
    _, columns = _native.study(None, "walk", words, {}, None)[3][0]
    assert all(np.array_equal(walks[name], values) for name, _, values in columns)
    optioned = sandgait.walk(2, torque_limit=0.02, memory=True)
    plain = sandgait.walk(2)
    assert optioned.speed != plain.speed
