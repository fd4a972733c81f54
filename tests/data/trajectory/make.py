"""Writes walk.parquet and walk.mcap beside walk.csv, and its first 60 rows in each packing; needs pyarrow 26, mcap 1.6.

MCAP files have the messages of ROS 2 that walk.csv says, the runs one after the other, 10 s from start to start.
"""

import csv
import struct
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
from mcap.writer import CompressionType, Writer

HERE = Path(__file__).parent
START = 1_700_000_000 * 10**9  # [ns]
TEXTS = ("run", "condition", "leg")


class Cdr:
    """Little endian, each number at a multiple of its size."""

    def __init__(self) -> None:
        self.bytes = b""

    def put(self, form: str, *values: float) -> None:
        for value in values:
            self.bytes += b"\0" * (-len(self.bytes) % struct.calcsize(form)) + struct.pack("<" + form, value)

    def text(self, text: str) -> None:
        self.put("I", len(text) + 1)
        self.bytes += text.encode() + b"\0"

    def list(self, values: list[float]) -> None:
        self.put("I", len(values))
        self.put("d", *values)

    def header(self, nanoseconds: int) -> None:
        self.put("I", nanoseconds // 10**9, nanoseconds % 10**9)
        self.text("base")

    def message(self) -> bytes:
        return b"\0\1\0\0" + self.bytes


def messages(row: dict[str, str], nanoseconds: int) -> tuple[bytes, bytes]:
    """The readings of the joints and the IMU."""
    joints, imu = Cdr(), Cdr()
    names = [name[2:] for name in row if name.startswith("q:")]
    joints.header(nanoseconds)
    joints.put("I", len(names))
    for name in names:
        joints.text(name)
    for kind in ("q", "qd", "tau"):
        joints.list([float(row[f"{kind}:{name}"]) for name in names])
    imu.header(nanoseconds)
    for columns in (
        ("quat_x", "quat_y", "quat_z", "quat_w"),
        ("gyro_x", "gyro_y", "gyro_z"),
        ("acc_x", "acc_y", "acc_z"),
    ):
        imu.put("d", *(float(row[name]) for name in columns), *9 * [0.0])
    return joints.message(), imu.message()


def parquet(path: Path, rows: list[dict[str, str]], **options: Any) -> None:
    columns = {n: [r[n] if n in TEXTS else float(r[n]) for r in rows] for n in rows[0]}
    pq.write_table(pa.table(columns), path, row_group_size=300, **options)


def mcap(path: Path, rows: list[dict[str, str]], compression: CompressionType) -> None:
    runs = list(dict.fromkeys(row["run"] for row in rows))
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=1 << 16, compression=compression)
        writer.start()
        schemas = [writer.register_schema(f"sensor_msgs/msg/{n}", "ros2msg", b"") for n in ("JointState", "Imu")]
        topics = zip(("/joint_states", "/imu"), schemas, strict=True)
        channels = [writer.register_channel(topic, "cdr", schema) for topic, schema in topics]
        for row in rows:
            nanoseconds = START + round(1e9 * (10 * runs.index(row["run"]) + float(row["t"])))
            for channel, data in zip(channels, messages(row, nanoseconds), strict=True):
                writer.add_message(channel, nanoseconds, data, nanoseconds)
        writer.finish()


def main() -> None:
    with (HERE / "walk.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    parquet(HERE / "walk.parquet", rows, compression="zstd")
    mcap(HERE / "walk.mcap", rows, CompressionType.ZSTD)
    first = rows[:60]
    kinds: dict[str, dict[str, Any]] = {
        "none": {"use_dictionary": False, "data_page_size": 256},
        "snappy": {"data_page_version": "2.0"},
        "gzip": {"use_dictionary": list(TEXTS), "use_byte_stream_split": [n for n in first[0] if n not in TEXTS]},
        "lz4": {},
        "zstd": {"data_page_version": "2.0"},
    }
    for kind, options in kinds.items():
        parquet(HERE / f"first_{kind}.parquet", first, compression=kind, **options)
    for kind in (CompressionType.NONE, CompressionType.LZ4, CompressionType.ZSTD):
        mcap(HERE / f"first_{kind.name.lower()}.mcap", first, kind)


if __name__ == "__main__":
    main()
