"""Recordings of ROS as they are: several senders, other clocks, clocks that jump, bags whose recorder has crashed."""

from __future__ import annotations

import csv
import io
import math
import os
import shutil
import subprocess
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import Writer
from rosbags import rosbag2
from rosbags.typesys import Stores, get_typestore

import sandgait
from sandgait import logs

STORE = get_typestore(Stores.ROS2_HUMBLE)
START = 1_760_000_000 * 10**9
LEGS = [f"{side}-{place}" for side in ("right", "left") for place in ("front", "middle", "rear")]

#: Topic, type, time of the recorder [ns] and message.
Sent = tuple[str, str, int, Any]


def nanoseconds(t: float) -> int:
    return START + round(t * 1e9)


def header(ns: int) -> Any:
    return STORE.types["std_msgs/msg/Header"](
        stamp=STORE.types["builtin_interfaces/msg/Time"](ns // 10**9, ns % 10**9), frame_id="base"
    )


def joints(ns: int, t: float, names: list[str] = LEGS, topic: str = "/joint_states", got: int | None = None) -> Sent:
    q = np.array([4 * math.pi * t + LEGS.index(name) if name in LEGS else math.sin(t) for name in names])
    kind = "sensor_msgs/msg/JointState"
    return topic, kind, got or ns, STORE.types[kind](header(ns), list(names), q, np.full(len(q), 4 * math.pi), 0 * q)


def imu(ns: int, t: float, got: int | None = None) -> Sent:
    zero, vector = np.zeros(9), STORE.types["geometry_msgs/msg/Vector3"]
    quat = STORE.types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    kind = "sensor_msgs/msg/Imu"
    message = STORE.types[kind](header(ns), quat, zero, vector(0.0, 0.0, t), zero, vector(0.0, 0.0, 9.81), zero)
    return "/imu", kind, got or ns, message


def plain(t: float) -> list[Sent]:
    return [joints(nanoseconds(t), t), imu(nanoseconds(t), t)]


def record(path: Path, sent: Callable[[float], list[Sent]], seconds: float = 2.0) -> Path:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channels: dict[str, int] = {}
        for k in range(round(100 * seconds)):
            for topic, kind, got, message in sent(k / 100):
                if topic not in channels:
                    schema = writer.register_schema(kind, "ros2msg", b"")
                    channels[topic] = writer.register_channel(topic, "cdr", schema)
                writer.add_message(channels[topic], got, STORE.serialize_cdr(message, kind).tobytes(), got)
        writer.finish()
    return path


def read(path: Path, note: str = "") -> dict[str, Any]:
    """The table; exactly one warning if `note` is given, which has these words."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        rows = list(csv.reader(io.StringIO(logs.to_csv(path).decode())))
    said = " ".join(str(warning.message) for warning in caught)
    assert note in said
    assert bool(note) == bool(said), said
    return dict(zip(rows[0], np.array(rows[1:], dtype=float).T, strict=True))


def refused(path: Path, *words: str) -> None:
    with pytest.raises(sandgait.InvalidRequest) as caught:
        logs.to_csv(path)
    assert all(word in str(caught.value) for word in words), caught.value
    assert "\n" not in str(caught.value)


@pytest.fixture
def whole(tmp_path: Path) -> dict[str, Any]:
    return read(record(tmp_path / "plain.mcap", plain))


def same(got: dict[str, Any], want: dict[str, Any], rows: int | None = None) -> None:
    for name, values in want.items():
        assert np.abs(got[name] - values[:rows]).max() < 1e-6, name


def test_a_second_sender_of_joints(tmp_path: Path, whole: dict[str, Any]) -> None:
    def with_pan(t: float) -> list[Sent]:
        return [*plain(t), joints(nanoseconds(t + 0.002), t, ["pan"])]

    got = read(record(tmp_path / "pan.mcap", with_pan))
    # The first row has no message of the pan joint before it.
    same(got, {name: values[1:] for name, values in whole.items()})
    assert np.abs(got["q:pan"] - np.sin(got["t"] - 0.002)).max() < 1e-4

    def seldom(t: float) -> list[Sent]:
        return plain(t) + ([joints(nanoseconds(t), t, ["pan"])] if round(100 * t) % 50 == 0 else [])

    got = read(record(tmp_path / "seldom.mcap", seldom), "/joint_states: pan are sent too rarely")
    same(got, whole)
    assert "q:pan" not in got


@pytest.mark.parametrize("late", [0.0, 0.004])
def test_two_halves_of_the_joints(tmp_path: Path, whole: dict[str, Any], late: float) -> None:
    def halves(t: float) -> list[Sent]:
        right, left = joints(nanoseconds(t), t, LEGS[:3]), joints(nanoseconds(t + late), t + late, LEGS[3:])
        return [right, left, imu(nanoseconds(t), t)]

    got = read(record(tmp_path / "halves.mcap", halves))
    same(got, {name: values[1 if late else 0 :] for name, values in whole.items()})


def test_every_message_twice(tmp_path: Path, whole: dict[str, Any]) -> None:
    same(read(record(tmp_path / "twice.mcap", lambda t: plain(t) * 2), "400 messages are in the file twice"), whole)


def test_a_clock_that_is_set_back(tmp_path: Path) -> None:
    def back(t: float) -> list[Sent]:
        shift = -1.005 if t >= 1.5 else 0.0
        return [joints(nanoseconds(t + shift), t), imu(nanoseconds(t + shift), t)]

    got = read(record(tmp_path / "back.mcap", back), "the clock goes back from 1760000001.490 to 1760000000.495 s")
    assert [int((got["run"] == run).sum()) for run in (1, 2)] == [150, 50]
    assert (np.diff(got["t"][got["run"] == 2]) > 0).all()
    assert np.abs(np.diff(got["q:right-front"])).max() < 0.2  # in the order of the file the angle does not jump

    def one(t: float) -> list[Sent]:
        return [joints(nanoseconds(t - (1.005 if t >= 1.5 else 0.0)), t), imu(nanoseconds(t), t)]

    refused(record(tmp_path / "one.mcap", one), "the clock of /joint_states goes back", "that of /imu does not")


def test_an_imu_with_a_clock_of_its_own(tmp_path: Path, whole: dict[str, Any]) -> None:
    def since_boot(t: float, got: int | None = None) -> list[Sent]:
        return [joints(nanoseconds(t), t), imu(round((t + 12) * 1e9), t, got)]

    refused(
        record(tmp_path / "boot.mcap", since_boot),
        "the stamps of /imu (12.0 to 14.0 s) and of /joint_states (1760000000.0 to 1760000002.0 s) do not overlap",
    )
    path = record(tmp_path / "got.mcap", lambda t: since_boot(t, nanoseconds(t)))
    same(read(path, "the times at which the recorder got the messages are taken instead"), whole)


def test_errors_name_topic_and_time(tmp_path: Path) -> None:
    def short(t: float) -> list[Sent]:
        topic, kind, got, message = joints(nanoseconds(t), t)
        if t > 1.0:
            message.position = message.position[:4]
        return [(topic, kind, got, message), imu(got, t)]

    refused(record(tmp_path / "short.mcap", short), "topic /joint_states", "1760000001.010 s", "4 values of position")
    refused(record(tmp_path / "still.mcap", lambda t: [joints(nanoseconds(t), t)]), "no message of sensor_msgs/msg/Imu")
    rare = record(tmp_path / "rare.mcap", lambda t: plain(t) if round(100 * t) % 20 == 0 else plain(t)[:1], 1.0)
    got = read(rare)
    assert len(got["t"]) == 5  # only rows at the time of a message


def test_bags_without_metadata(tmp_path: Path, whole: dict[str, Any]) -> None:
    folder = tmp_path / "crashed"
    folder.mkdir()
    shutil.copy(tmp_path / "plain.mcap", folder / "crashed_0.mcap")
    same(read(folder, "metadata.yaml is missing or incomplete; read without it: crashed_0.mcap"), whole)
    (folder / "metadata.yaml").write_text(
        "rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: ''\n"
        "  relative_file_paths:\n  - crashed_0.mcap\n"
        "  duration: {nanoseconds: 1}\n  starting_time: {nanoseconds_since_epoch: 0}\n  message_count: 0\n"
        "  topics_with_message_count: []\n"
    )
    same(read(folder, "metadata.yaml is missing or incomplete"), whole)
    # Several files, in the order of their numbers.
    parts = tmp_path / "parts"
    parts.mkdir()
    for number in (0, 2, 10):
        first = {0: 0.0, 2: 0.5, 10: 1.0}[number]
        record(parts / f"parts_{number}.mcap", lambda t, first=first: plain(t + first), 0.5)
    got = read(parts, "read without it: parts_0.mcap, parts_2.mcap, parts_10.mcap")
    same(got, whole, 150)
    database = tmp_path / "database"
    with rosbag2.Writer(database, version=9, storage_plugin=rosbag2.StoragePlugin.SQLITE3) as writer:
        connections: dict[str, Any] = {}
        for k in range(200):
            for topic, kind, got_at, message in plain(k / 100):
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
                writer.write(connections[topic], got_at, STORE.serialize_cdr(message, kind))
    (database / "metadata.yaml").unlink()
    same(read(database, "read without it: database.db3"), whole)
    empty = tmp_path / "empty"
    empty.mkdir()
    (empty / "metadata.yaml").write_text("{}")
    refused(empty, "the folder has no file .mcap or .db3")


def test_a_library_that_cannot_be_loaded_is_no_fault_of_the_file(tmp_path: Path) -> None:
    path = record(tmp_path / "plain.mcap", plain, 0.1)
    fake = tmp_path / "fake/pyarrow"
    fake.mkdir(parents=True)
    (fake / "__init__.py").write_text("raise ImportError('pyarrow requires NumPy 2.0 or newer, found 1.26.4')")
    script = f"import sys; sys.path.insert(0, {str(fake.parent)!r}); import runpy; sys.argv = sys.argv[1:]; "
    script += "runpy.run_path(sys.argv[0], run_name='__main__')"
    parent, seconds = str(os.getpid()), "60"
    command = [sys.executable, "-c", script, logs.READER, parent, seconds, "mcap", str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "pyarrow, which reads this file, cannot be loaded: pyarrow requires NumPy 2.0" in done.stderr
    assert "pip install --upgrade 'sandgait[logs]'" in done.stderr
    assert len(done.stderr.splitlines()) == 1
