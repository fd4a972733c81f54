"""Heights of the ground from a file: the same ground as from numbers, through every door; wrong files are one line."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sandgait
from conftest import RemoteServer
from sandgait import client, server

TASK = "sandgait/LeggedVelocity-v1"

#: 30 × 20 heights in whole tenths of a millimetre, which travel without rounding.
HEIGHTS = np.round(0.1 * np.sin(0.4 * np.arange(20)) + 0.05 * np.cos(0.3 * np.arange(30))[:, None], 4)


def walked(relief: dict[str, Any], **keywords: Any) -> np.ndarray:
    env = sandgait.SandgaitVectorEnv(TASK, 2, ground="rigid", relief=relief, measure_heights=True, **keywords)
    seen = [env.reset(seed=3)[0]]
    for _ in range(20):
        seen.append(env.step(np.zeros((2, 12), np.float32))[0])
    env.close()
    return np.array(seen)


@pytest.fixture
def files(tmp_path: Path) -> list[Path]:
    np.savetxt(tmp_path / "plain.csv", HEIGHTS, delimiter=",", header="heights [m]")
    np.savetxt(tmp_path / "blanks.csv", HEIGHTS, fmt="%.4f")
    (tmp_path / "semicolons.CSV").write_text("\ufeff" + "\r\n".join("; ".join(map(str, row)) for row in HEIGHTS))
    np.save(tmp_path / "double.npy", HEIGHTS)
    np.save(tmp_path / "single.npy", HEIGHTS.astype(np.float32))
    return sorted(tmp_path.iterdir())


def test_a_file_is_its_numbers(files: list[Path]) -> None:
    given = walked({"heights": HEIGHTS.tolist(), "spacing": 0.25})
    assert np.ptp(given[:, :, 48:]) > 0.05, "the ground is not flat"
    for file in files:
        np.testing.assert_array_equal(walked({"file": file, "spacing": 0.25}), given, err_msg=file.name)
    assert not np.array_equal(walked({"file": files[0], "spacing": 0.3}), given)


def test_a_file_travels_through_every_door(files: list[Path], remote: RemoteServer) -> None:
    here = walked({"file": str(files[0]), "spacing": 0.25})
    for door in ({"isolated": True}, {"address": remote.address}):
        np.testing.assert_array_equal(walked({"file": str(files[0]), "spacing": 0.25}, **door), here)


def test_a_server_opens_no_path(files: list[Path], remote: RemoteServer, monkeypatch: pytest.MonkeyPatch) -> None:
    """A client that sends the path itself is refused, whether the file exists or not."""
    monkeypatch.setattr(client, "with_files", lambda options: options)
    for file in (str(files[0]), "/etc/passwd", "nowhere.csv"):
        with pytest.raises(sandgait.InvalidRequest, match=r"relief\.file: is no packed text.*a server opens none"):
            sandgait.SandgaitVectorEnv(TASK, 1, remote.address, relief={"file": file})
    with pytest.raises(sandgait.InvalidRequest, match=r"relief\.file: not packed heights"):
        sandgait.SandgaitVectorEnv(TASK, 1, remote.address, relief={"file": "heights:AAAA"})


def saved(path: Path, array: Any) -> None:
    with path.open("wb") as file:
        np.save(file, array)


#: Name, content and message of each wrong file.
WRONG: list[tuple[str, Any, str]] = [
    ("ragged.csv", "0,0,0,0\n0,0,0,0\n0,0,0\n0,0,0,0\n", "line 3 has 3 numbers, but the first row has 4"),
    ("nan.csv", "0,0,0,0\n0,nan,0,0\n0,0,0,0\n0,0,0,0\n", "line 2, number 2: nan is not finite"),
    ("word.csv", "0,0,0,0\n0,0,high,0\n", 'line 2, number 3: "high" is not a number'),
    ("gap.csv", "0,0,0,0\n0,,0,0\n", 'line 2, number 2: "" is not a number'),
    ("empty.csv", "# nothing\n", "rows: 0 is outside [4, 512]"),
    ("small.csv", "0,0,0,0\n" * 3, "rows: 3 is outside [4, 512]"),
    ("wide.csv", ("0," * 512 + "0\n") * 4, "columns: 513 is outside [4, 512]"),
    ("high.csv", "0,0,0,200\n" * 4, "200 is outside [-100, 100]"),
    ("large.csv", "0,0,0,0\n" * 1_100_000, "is more than the 8 MiB"),
    ("binary.csv", b"\xff\xfe\x00", "it is not a text in UTF-8"),
    ("heights.txt", "0,0,0,0\n" * 4, "heights are read from .csv and .npy"),
    ("flat.npy", np.zeros(16), "its shape is (16,), but it must be (rows, columns)"),
    ("whole.npy", np.zeros((4, 4), int), 'its numbers have type "<i8"; save heights.astype(float)'),
    ("turned.npy", np.asfortranarray(np.zeros((4, 5))), "Fortran"),
    ("infinite.npy", np.full((4, 4), np.inf), "row 1, number 1: inf is not finite"),
    ("text.npy", "0,0,0,0", "not a file of numpy.save"),
    ("rough.npy", np.random.default_rng(0).uniform(-90, 90, (512, 512)), "give fewer, or smoother ones"),
]


@pytest.mark.parametrize(("name", "content", "said"), WRONG, ids=[w[0] for w in WRONG])
def test_wrong_files_are_one_clear_line(name: str, content: Any, said: str, tmp_path: Path) -> None:
    path = tmp_path / name
    if isinstance(content, np.ndarray):
        saved(path, content)
    else:
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(sandgait.SandgaitError) as error:
        sandgait.SandgaitVectorEnv(TASK, 1, relief={"file": path})
    assert said in str(error.value)
    assert str(error.value).startswith(str(path))
    assert "\n" not in str(error.value)


def test_a_cut_file_of_numpy_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "cut.npy"
    saved(path, np.zeros((6, 6)))
    whole = path.read_bytes()
    for length in (0, 6, 9, 60, len(whole) - 8, len(whole) - 1):
        path.write_bytes(whole[:length])
        says = r"cut\.npy: (it is not a file of numpy\.save|its numbers have \d+ bytes)"
        with pytest.raises(sandgait.SandgaitError, match=says):
            sandgait.SandgaitVectorEnv(TASK, 1, relief={"file": path})


def test_wrong_uses_are_one_clear_line(tmp_path: Path) -> None:
    np.save(tmp_path / "flat.npy", np.zeros((8, 8)))
    good = tmp_path / "flat.npy"
    for relief, said in [
        ({"file": tmp_path / "nowhere.csv"}, r"nowhere\.csv: No such file"),
        ({"file": tmp_path}, "is a folder"),
        ({"file": 3}, r"relief\.file: 3 is not a path"),
        ({"file": good, "heights": [[0.0] * 4] * 4}, "heights and file are both given"),
        ({"file": good, "spacing": 0}, r"relief\.spacing: 0 is outside"),
    ]:
        with pytest.raises(sandgait.SandgaitError, match=said) as error:
            sandgait.SandgaitVectorEnv(TASK, 1, relief=relief)
        assert "\n" not in str(error.value)


def test_the_command_line_reads_files_too(files: list[Path], tmp_path: Path) -> None:
    def bench(file: Path) -> subprocess.CompletedProcess[str]:
        relief = json.dumps({"file": str(file), "spacing": 0.25})
        words = ["bench", "--task", TASK, "--option", f"relief={relief}", "--envs=1", "--seconds=0.01", "--repeats=5"]
        return subprocess.run([*server.command(), *words], capture_output=True, text=True, check=False)

    assert bench(files[0]).returncode == 0
    wrong = bench(tmp_path / "nowhere.csv")
    assert wrong.returncode == 2
    assert wrong.stderr.count("\n") == 1
    assert "nowhere.csv: No such file" in wrong.stderr
