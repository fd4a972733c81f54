"""Writes walk.parquet and walk.mcap beside walk.csv. Needs pyarrow 26, mcap 1.6, rosbags 0.11.

The tests of `sandgait.logs` (tests/python/test_logs.py) write its other formats with the same functions. MCAP files and
bags have the messages of ROS that walk.csv says, the runs one after the other, 10 s from start to start.
"""

import csv
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_typestore

HERE = Path(__file__).parent
START = 1_700_000_000 * 10**9  # [ns]
TEXTS = ("run", "condition", "leg")
TOPICS = {"JointState": "/joint_states", "Imu": "/imu"}


def rows() -> list[dict[str, str]]:
    with (HERE / "walk.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def messages(table: list[dict[str, str]], store: Any) -> Iterator[tuple[str, int, Any]]:
    """Type, time [ns] and message: for each row one of the joints and one of the IMU."""
    packages = ("builtin_interfaces", "std_msgs", "geometry_msgs", "sensor_msgs")
    known = [name for package in reversed(packages) for name in store.types if name.startswith(package + "/")]
    make = {name.rsplit("/", 1)[1]: store.types[name] for name in known}  # the Time of builtin_interfaces
    runs = list(dict.fromkeys(row["run"] for row in table))
    one = {"seq": 0} if "seq" in make["Header"].__dataclass_fields__ else {}
    for row in table:
        time = START + round(1e9 * (10 * runs.index(row["run"]) + float(row["t"])))
        header = make["Header"](stamp=make["Time"](time // 10**9, time % 10**9), frame_id="base", **one)
        names = [name[2:] for name in row if name.startswith("q:")]
        values = [np.array([float(row[f"{kind}:{name}"]) for name in names]) for kind in ("q", "qd", "tau")]
        yield "JointState", time, make["JointState"](header, names, *values)
        vectors = [make["Vector3"](*(float(row[f"{of}_{axis}"]) for axis in "xyz")) for of in ("gyro", "acc")]
        quat = make["Quaternion"](*(float(row[f"quat_{axis}"]) for axis in "xyzw"))
        none = np.zeros(9)
        yield "Imu", time, make["Imu"](header, quat, none, vectors[0], none, vectors[1], none)


def parquet(path: Path, table: list[dict[str, str]], **options: Any) -> None:
    columns = {n: [r[n] if n in TEXTS else float(r[n]) for r in table] for n in table[0]}
    pq.write_table(pa.table(columns), path, row_group_size=300, **options)


def mcap(path: Path, table: list[dict[str, str]], compression: CompressionType) -> None:
    store = get_typestore(Stores.ROS2_HUMBLE)
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=1 << 16, compression=compression)
        writer.start()
        schemas = {name: writer.register_schema(f"sensor_msgs/msg/{name}", "ros2msg", b"") for name in TOPICS}
        channels = {name: writer.register_channel(TOPICS[name], "cdr", schema) for name, schema in schemas.items()}
        for name, time, message in messages(table, store):
            data = bytes(store.serialize_cdr(message, f"sensor_msgs/msg/{name}"))
            writer.add_message(channels[name], time, data, time)
        writer.finish()


if __name__ == "__main__":
    parquet(HERE / "walk.parquet", rows(), compression="zstd")
    mcap(HERE / "walk.mcap", rows(), CompressionType.ZSTD)
