"""Recordings of environments."""

from __future__ import annotations

import gzip
import json
import struct
import subprocess
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

import sandgait
from conftest import ID
from sandgait import server

ACTION = np.full(6, 0.4, dtype=np.float32)
LEGGED = "sandgait/LeggedVelocity-v1"
SANDCAT = Path(__file__).parents[2] / "robots" / "sandcat.urdf"


def test_a_recording_has_the_numbers_of_the_steps(tmp_path: Path) -> None:
    path = tmp_path / "walk.rec"
    env = sandgait.SandgaitEnv(ID, max_episode_steps=40, command=[0.2, 0.2])
    env.record(path)
    with pytest.raises(sandgait.OutOfOrder, match="stop_recording"):
        env.record(path)
    rewards, speeds = [], []
    for episode in range(2):
        env.reset(seed=7 if episode == 0 else None)
        for _ in range(40):
            _, reward, _, _, info = env.step(ACTION)
            rewards.append(reward)
            speeds.append(info["speed"])
    env.stop_recording()
    env.close()
    recording = sandgait.read_recording(path)
    assert [len(s) for s in recording.sections] == [41, 41]
    assert [s.header["episode"] for s in recording.sections] == [0, 1]
    assert recording.header["seed"] == 7
    made = np.concatenate([s["reward"][1:] for s in recording.sections])
    assert made == pytest.approx(rewards, abs=1e-6)
    assert np.concatenate([s["speed"][1:] for s in recording.sections]) == pytest.approx(speeds, abs=1e-6)
    first = recording.sections[0]
    assert first["time"] == pytest.approx(np.arange(41) / 50, abs=1e-6)
    moved = np.diff(first["position"][:, 0]) * 50
    assert moved == pytest.approx(first["x_velocity"][1:], abs=1e-4)
    assert first["forces"].shape == (41, len(first.header["segments"]), 3)
    assert first["angles"].shape == (41, 6) == first["torques"].shape
    assert recording["position"].shape == (82, 3)
    assert path.stat().st_size < 82 * 1200
    with pytest.raises(sandgait.InvalidRequest, match='column "nothing" is unknown; known: time, position'):
        recording["nothing"]


def test_a_recording_of_a_robot_from_a_file_has_its_shapes_once(tmp_path: Path) -> None:
    path = tmp_path / "cat.rec"
    env = sandgait.SandgaitEnv(LEGGED, robot=SANDCAT, ground="dunes")
    env.record(path)
    for seed in range(3):
        env.reset(seed=seed)
        env.step(np.zeros(12, np.float32))
    env.close()
    headers = [s.header for s in sandgait.read_recording(path).sections]
    assert [h["seed"] for h in headers] == [0, 1, 2]
    forms = {name for s in headers[0]["shapes"]["shapes"] for name in s["form"]}
    assert forms == {"box", "cylinder", "sphere"}
    assert len(headers[0]["bodies"]) == 13
    assert len(headers[0]["relief"]["heights"]) == 128
    assert all(h["shapes"] == headers[0]["shapes"] and h["relief"] == headers[0]["relief"] for h in headers)
    assert gzip.decompress(path.read_bytes()).count(b'"heights"') == 1


def test_recordings_of_hexapods_are_as_before(tmp_path: Path) -> None:
    env = sandgait.SandgaitEnv(ID)
    env.record(tmp_path / "walk.rec")
    env.reset(seed=1)
    env.step(ACTION)
    env.close()
    header = sandgait.read_recording(tmp_path / "walk.rec").header
    assert header["columns"][-1]["name"] == "forces"
    assert not {"hard", "touching"} & set(header)


def test_a_vector_environment_records_one_of_its_own(tmp_path: Path) -> None:
    path = tmp_path / "rocks.rec"
    env = sandgait.SandgaitVectorEnv("sandgait/HexapodRocks-v1", 2, max_episode_steps=10)
    env.record(path, index=1)
    env.reset(seed=3)
    for _ in range(20):
        env.step(np.stack([ACTION] * 2))
    env.close()
    recording = sandgait.read_recording(path)
    assert [len(s) for s in recording.sections] == [11, 10], "a reset's moment comes with explicit resets only"
    assert recording.header["seed"] == 4
    assert recording.header["obstacles"]
    loose = sum(o["moves"] for o in recording.header["obstacles"])
    assert recording.sections[0]["objects"].shape == (11, loose, 7)


def test_files_other_than_recordings_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "walk.rec"
    with pytest.raises(sandgait.InvalidRequest, match="No such file"):
        sandgait.read_recording(path)
    path.write_bytes(b"nothing")
    with pytest.raises(sandgait.InvalidRequest, match="not one of sandgait's recordings"):
        sandgait.read_recording(path)
    env = sandgait.SandgaitEnv(ID)
    env.record(path)
    env.reset(seed=1)
    env.close()
    whole = path.read_bytes()
    assert len(sandgait.read_recording(path)) == 1
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(sandgait.InvalidRequest, match="cut off"):
        sandgait.read_recording(path)


def test_the_page_of_a_recording(tmp_path: Path) -> None:
    """Checks the page without a browser; `make test-browser` uses one."""
    path, page = tmp_path / "walk.rec", tmp_path / "walk.html"
    env = sandgait.SandgaitEnv(ID)
    env.record(path)
    env.reset(seed=1)
    for _ in range(10):
        env.step(ACTION)
    env.close()
    subprocess.run([*server.command(), "replay", str(path), "--html", str(page)], check=True, capture_output=True)
    html = page.read_text()
    assert html.count("<script") == html.count("</script>") == 7
    assert "https://" not in html
    assert html.count("http://") == html.count("http://www.w3.org/1999/xhtml")


def block(kind: bytes, content: bytes, length: int | None = None) -> bytes:
    return kind + struct.pack("<I", len(content) if length is None else length) + content


def test_a_recording_is_unpacked_within_a_bound(tmp_path: Path) -> None:
    """A file of some kilobytes can unpack to gigabytes, and a block's header can state such a length."""
    header = {"format": "sandgait recording", "version": 1, "columns": [{"name": "time", "shape": [1]}]}
    head = block(b"HEAD", json.dumps(header).encode())
    path = tmp_path / "bomb.rec"
    path.write_bytes(gzip.compress(head + 64 * block(b"ROWS", bytes(2**20))))
    assert len(sandgait.read_recording(path)) == 16 * 2**20
    tracemalloc.start()
    with pytest.raises(sandgait.InvalidRequest, match="unpacks to more than max_bytes"):
        sandgait.read_recording(path, max_bytes=2**22)
    assert tracemalloc.get_traced_memory()[1] < 2**24
    path.write_bytes(gzip.compress(head + block(b"ROWS", bytes(4), 2**32 - 1)))
    with pytest.raises(sandgait.InvalidRequest, match="max_bytes"):
        sandgait.read_recording(path)
    assert tracemalloc.get_traced_memory()[1] < 2**24
    path.write_bytes(gzip.compress(head + 1_000_000 * block(b"ROWS", bytes(4)), 1))
    tracemalloc.reset_peak()
    assert len(sandgait.read_recording(path)) == 1_000_000
    assert tracemalloc.get_traced_memory()[1] < 2**24, "a small block takes no more than its rows"
    tracemalloc.stop()
    for wrong in (b"[]", b"{", b'{"format": "sandgait recording", "version": 1}', b"[" * 100_000):
        path.write_bytes(gzip.compress(block(b"HEAD", wrong)))
        with pytest.raises(sandgait.InvalidRequest, match="not one of sandgait's recordings"):
            sandgait.read_recording(path)


def test_headers_and_sections_are_bounded(tmp_path: Path) -> None:
    """JSON of some megabytes, which a small file can have, takes gigabytes as objects."""
    path = tmp_path / "bomb.rec"
    about = '"format": "sandgait recording", "version": 1, "columns": [{"name": "time", "shape": [1]}]'
    plain = block(b"HEAD", f"{{{about}}}".encode())
    nested = block(b"HEAD", f'{{{about}, "x": [{"[]," * 4_000_001}0]}}'.encode())
    for stream, said in (
        (100_001 * plain, "more than 100000 sections"),
        (nested, "8000000 values"),
        (block(b"HEAD", b"x" * (129 << 20)), "more than 134217728 bytes"),
    ):
        path.write_bytes(gzip.compress(stream, 1))
        assert path.stat().st_size < 2**20
        with pytest.raises(sandgait.InvalidRequest, match=said):
            sandgait.read_recording(path)


def test_the_first_state_of_an_episode_has_its_commands(tmp_path: Path) -> None:
    for task, options, columns in (
        (ID, {}, ["commanded_speed"]),
        (
            LEGGED,
            {"robot": SANDCAT},
            ["command_lin_vel_x", "command_lin_vel_y", "command_ang_vel_yaw"],
        ),
    ):
        env = sandgait.SandgaitEnv(task, **options)
        env.record(tmp_path / "walk.rec")
        for seed in range(4):
            env.reset(seed=seed)
            env.step(np.zeros(env.action_space.shape))
        env.close()
        for section in sandgait.read_recording(tmp_path / "walk.rec").sections:
            assert section["time"][0] == 0
            for name in columns:
                assert section[name][0] == section[name][1] != 0
            assert not section[env.task.info[0].name][0], "no reward has been paid"
