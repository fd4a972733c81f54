"""Recordings become the table that the diagnosis reads: `sandgait.logs`. Each format's own library writes the files."""

from __future__ import annotations

import bz2
import csv
import importlib.util
import io
import os
import random
import resource
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import lz4.frame
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import zstandard
from mcap.writer import CompressionType
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_typestore

import sandgait
from conftest import LONG
from sandgait import logs

DATA = Path(__file__).parents[1] / "data/trajectory"
spec = importlib.util.spec_from_file_location("make", DATA / "make.py")
assert spec
assert spec.loader
make = importlib.util.module_from_spec(spec)
spec.loader.exec_module(make)

WALK = make.rows()
FIRST = WALK[:60]


def read(path: Path, topics: dict[str, str] | None = None) -> dict[str, list[str]]:
    table = list(csv.DictReader(io.StringIO(logs.to_csv(path, topics).decode())))
    return {name: [row[name] for row in table] for name in table[0]}


def alike(
    got: dict[str, list[str]], want: list[dict[str, str]], close: float, names: dict[str, str] | None = None
) -> None:
    """Compares all columns of joints and IMU, and the time."""
    for name in want[0]:
        if name not in (*make.TEXTS, "slope_deg", "stride_frequency"):
            values = np.array(got[(names or {}).get(name, name)], dtype=float)
            assert np.abs(values - np.array([float(row[name]) for row in want])).max() <= close, name


def old_bag(path: Path, table: list[dict[str, str]], compression: Any = None, second: bool = False) -> None:
    store = get_typestore(Stores.ROS1_NOETIC)
    writer = rosbag1.Writer(path)
    if compression:
        writer.set_compression(compression)
    with writer:
        made = {n: writer.add_connection(t, f"sensor_msgs/msg/{n}", typestore=store) for n, t in make.TOPICS.items()}
        other = writer.add_connection("/other", "sensor_msgs/msg/Imu", typestore=store) if second else None
        for name, time, message in make.messages(table, store):
            data = store.serialize_ros1(message, f"sensor_msgs/msg/{name}")
            writer.write(made[name], time, data)
            if other and name == "Imu":
                writer.write(other, time, data)


def new_bag(path: Path, table: list[dict[str, str]], storage: Any) -> None:
    store = get_typestore(Stores.ROS2_HUMBLE)
    with rosbag2.Writer(path, version=9, storage_plugin=storage) as writer:
        made = {n: writer.add_connection(t, f"sensor_msgs/msg/{n}", typestore=store) for n, t in make.TOPICS.items()}
        for name, time, message in make.messages(table, store):
            writer.write(made[name], time, store.serialize_cdr(message, f"sensor_msgs/msg/{name}"))


def each_format(folder: Path) -> dict[str, Path]:
    """The first rows in each format and compression."""
    options: dict[str, dict[str, Any]] = {
        "none": {"use_dictionary": False, "data_page_size": 256},
        "snappy": {"data_page_version": "2.0"},
        "gzip": {"use_dictionary": list(make.TEXTS)},
        "brotli": {},
        "lz4": {},
        "zstd": {"data_page_version": "2.0"},
    }
    files = {}
    for name, chosen in options.items():
        files[f"parquet {name}"] = folder / f"{name}.parquet"
        make.parquet(folder / f"{name}.parquet", FIRST, compression=name, **chosen)
    for packing in (CompressionType.NONE, CompressionType.LZ4, CompressionType.ZSTD):
        files[f"mcap {packing.name}"] = folder / f"{packing.name}.mcap"
        make.mcap(folder / f"{packing.name}.mcap", FIRST, packing)
    formats = rosbag1.Writer.CompressionFormat
    for name, form in (("plain", None), ("bz2", formats.BZ2), ("lz4", formats.LZ4)):
        files[f"ROS 1 {name}"] = folder / f"{name}.bag"
        old_bag(folder / f"{name}.bag", FIRST, form)
    for storage in rosbag2.StoragePlugin:
        files[f"ROS 2 {storage.name}"] = folder / f"bag_{storage.name}"
        new_bag(folder / f"bag_{storage.name}", FIRST, storage)
    files["ROS 2 database"] = folder / "bag_SQLITE3/bag_SQLITE3.db3"
    return files


def test_each_format_gives_the_same_table(tmp_path: Path) -> None:
    for name, path in each_format(tmp_path).items():
        try:
            alike(read(path), FIRST, 0.0 if name.startswith("parquet") else 1e-14)
        except (AssertionError, sandgait.InvalidRequest) as error:
            raise AssertionError(name) from error
    alike(read(DATA / "walk.parquet"), WALK, 0.0)
    several = read(DATA / "walk.mcap")
    assert len(several["t"]) == len(WALK)
    assert float(several["t"][-1]) > 20  # the runs are 10 s apart


@pytest.mark.parametrize("layout", ["lerobot_v2", "lerobot_v3"])
def test_a_lerobot_data_set(layout: str) -> None:
    names = {}
    for name in FIRST[0]:
        kind, _, joint = name.partition(":")
        suffix = {"q": "pos", "qd": "vel", "tau": "torque"}.get(kind)
        names[name] = f"observation.state.{joint}.{suffix}" if suffix else f"observation.imu.{name}"
    got = read(DATA / layout)
    assert [got["run"].count(run) for run in ("0", "1")] == [40, 40]
    want = [row for row in WALK if row["run"] != "3_1" and float(row["t"]) < 0.395]
    quat = {name for name in want[0] if name.startswith("quat")}
    alike(got, [{n: v for n, v in row.items() if n not in quat} for row in want], 1e-6, names | {"t": "t"})
    assert "action.5" in got  # a feature without names
    one = next((DATA / layout / "data").glob("*/*.parquet"))
    assert set(read(one)) == set(got)


def test_columns_of_parquet(tmp_path: Path) -> None:
    path = tmp_path / "mixed.parquet"
    picture = {"bytes": b"\x89PNG", "path": "a.png"}
    columns = {
        "q": pa.array([[1.0, 2.0], [3.0, 4.5]], pa.list_(pa.float32())),
        "v": pa.array([{"x": 1.5, "y": 2}, {"x": 2.5, "y": 3}]),
        "when": pa.array([10**9, 2 * 10**9 + 5 * 10**8], pa.timestamp("ns")),
        "shape": pa.array(["L", "C"]).dictionary_encode(),
        "picture": pa.array([picture, picture]),
        "blank": pa.array([None, 0.1], pa.float64()),
    }
    pq.write_table(pa.table(columns), path)
    table = '"q.0","q.1","v.x","v.y","when","shape","blank"\n1,2,1.5,2,1,"L",\n3,4.5,2.5,3,2.5,"C",0.1\n'
    assert logs.to_csv(path).decode() == table
    pq.write_table(pa.table({"q": [[1.0], [1.0, 2.0]]}), path)
    with pytest.raises(sandgait.InvalidRequest, match="column q: its lists have different lengths"):
        logs.to_csv(path)


def refused(path: Path, words: str, topics: dict[str, str] | None = None) -> None:
    with pytest.raises(sandgait.InvalidRequest, match=words) as caught:
        logs.to_csv(path, topics)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value) or str(caught.value).startswith("topics")
    assert len(str(caught.value)) < 500


def test_wrong_use_is_one_line(tmp_path: Path) -> None:
    mcap, bag = DATA / "walk.mcap", tmp_path / "two.bag"
    old_bag(bag, FIRST, second=True)
    refused(bag, "topics /imu and /other have the same type: name one of them as imu under")
    alike(read(bag, {"imu": "/imu"}), FIRST, 1e-14)
    refused(mcap, "no message of sensor_msgs/msg/Imu in topic /nowhere", {"imu": "/nowhere"})
    refused(mcap, '"mood" is unknown; known: joints, imu', {"mood": "/imu"})
    refused(mcap, "topics: expected a dictionary of names or None, got 3", 3)  # type: ignore[arg-type]
    refused(DATA / "walk.csv", "neither Parquet, LeRobot, MCAP nor a bag")
    refused(tmp_path / "none.parquet", "neither Parquet")
    empty = tmp_path / "empty.parquet"
    pq.write_table(pa.table({"t": pa.array([], pa.float64())}), empty)
    refused(empty, "no rows")


def test_the_command(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "sandgait.logs"]
    out = tmp_path / "walk.csv"
    subprocess.run([*command, DATA / "walk.mcap", "--out", out], check=True)
    assert out.read_bytes() == logs.to_csv(DATA / "walk.mcap")
    out.unlink()
    wrong = subprocess.run([*command, DATA / "walk.csv", "--out", out], capture_output=True, text=True, check=False)
    assert (wrong.returncode, len(wrong.stderr.splitlines()), out.exists()) == (2, 1, False)


@pytest.mark.filterwarnings("ignore:.*ends early")
def test_damaged_files_give_a_table_or_one_line(tmp_path: Path) -> None:
    """Cut off and randomly changed files of each library."""
    files = each_format(tmp_path)
    rng, read_anyway, broken = random.Random(1), 0, tmp_path / "broken"
    for name in (
        "parquet zstd",
        "parquet none",
        "mcap NONE",
        "mcap ZSTD",
        "ROS 1 plain",
        "ROS 1 lz4",
        "ROS 2 database",
    ):
        whole = files[name].read_bytes()
        variants = [whole[: len(whole) // 2], whole[:60]]
        for _ in range(4 if LONG else 1):
            changed = bytearray(whole)
            for _ in range(rng.randrange(1, 8)):
                at = len(whole) - 1 - rng.randrange(min(len(whole), rng.choice([len(whole), 2000])))
                changed[at] = rng.choice([0, 0x7F, 0xFF, rng.randrange(256)])
            variants.append(bytes(changed))
        path = broken.with_suffix(files[name].suffix)
        for variant in variants:
            path.write_bytes(variant)
            said = ""
            try:
                read_anyway += bool(logs.to_csv(path))
            except sandgait.InvalidRequest as error:
                said = str(error)
            assert len(said) < 500
            assert "\n" not in said
            assert "Traceback" not in said
    assert read_anyway < (30 if LONG else 15), "most of these files are broken"


def bomb(compressor: Any) -> bytes:
    """One stream that is unpacked into 3 GiB of zeros."""
    start = compressor.begin() if hasattr(compressor, "begin") else b""
    return start + b"".join(compressor.compress(bytes(64 << 20)) for _ in range(48)) + compressor.flush()


def test_the_reader_has_a_time_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source, reader = tmp_path / "walk.mcap", tmp_path / "reader.py"
    old_bag(source, FIRST)
    reader.write_text("import time\ntime.sleep(600)\n")
    monkeypatch.setattr(logs, "READER", str(reader))
    monkeypatch.setattr(logs, "LONGEST", 1)
    with pytest.raises(sandgait.InvalidRequest, match="it was not read within 1 s"):
        logs.to_csv(source)


def test_the_reader_ends_with_its_parent(tmp_path: Path) -> None:
    """The reader waits for a file that never comes, and its parent is killed."""
    source = tmp_path / "walk.mcap"
    os.mkfifo(source)
    code = (
        "import os, subprocess, sys, time\n"
        f"reader = [sys.executable, '-P', {logs.READER!r}, str(os.getpid()), '600', 'mcap', {str(source)!r}]\n"
        "print(subprocess.Popen(reader).pid, flush=True)\n"
        "time.sleep(600)\n"
    )
    for pause in (0.0, 2.0):  # before and after the reader has told the system
        with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as parent:
            assert parent.stdout
            reader = int(parent.stdout.readline())
            time.sleep(pause)
            assert runs(reader)
            parent.kill()
        end = time.monotonic() + 20
        while runs(reader):
            assert time.monotonic() < end, "the reader outlives its parent"
            time.sleep(0.05)


def runs(process: int) -> bool:
    """Does the process exist, and has it not ended?"""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def test_bombs_are_refused(tmp_path: Path) -> None:
    """Small files that would take 3 GiB and more: the reader ends with one line, and this process stays small."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    rows = tmp_path / "rows.parquet"
    writer = pq.ParquetWriter(rows, pa.schema({f"c{i}": pa.float64() for i in range(20)}))
    for _ in range(3):
        writer.write_table(pa.table({f"c{i}": np.zeros(1 << 19) for i in range(20)}))
    writer.close()
    refused(rows, "more than 20000000 values")
    text = tmp_path / "text.parquet"
    long = pa.DictionaryArray.from_arrays(np.zeros(4096, dtype=np.int32), ["x" * (1 << 20)])
    pq.write_table(pa.table({"run": long}), text)
    assert text.stat().st_size < 1 << 20
    refused(text, "GiB of memory|MiB as CSV")

    bombs = {"zstd": zstandard.ZstdCompressor().compressobj(), "lz4": lz4.frame.LZ4FrameCompressor()}
    for packing, packed in ((name, bomb(compressor)) for name, compressor in bombs.items()):
        path = tmp_path / f"{packing}.mcap"
        chunk = b"".join(n.to_bytes(8, "little") for n in (0, 0, 3 << 30)) + bytes(4)
        chunk += len(packing).to_bytes(4, "little") + packing.encode() + len(packed).to_bytes(8, "little") + packed
        header = bytes(8)
        records = (
            b"\x01" + len(header).to_bytes(8, "little") + header + b"\x06" + len(chunk).to_bytes(8, "little") + chunk
        )
        path.write_bytes(b"\x89MCAP0\r\n" + records)
        refused(path, "GiB of memory|cannot be read as mcap")

    bag = tmp_path / "bomb.bag"
    old_bag(bag, WALK, rosbag1.Writer.CompressionFormat.BZ2)
    whole = bag.read_bytes()
    start = whole.index(b"BZh")
    size = int.from_bytes(whole[start - 4 : start], "little")
    stream = bz2.compress(bytes(64 << 20))
    packed = stream * (size // len(stream))
    assert size // len(stream) > 48, "3 GiB"
    bag.write_bytes(whole[:start] + packed.ljust(size, b"\0") + whole[start + size :])
    refused(bag, "GiB of memory|cannot be read as bag")
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss < before + (8 << 20)
