"""Reads one recording and writes its table to stdout as CSV: the process that `sandgait.logs` starts.

    python -P logs_reader.py PARENT SECONDS FORM FILE [joints=TOPIC] [imu=TOPIC]

It ends with the process PARENT, and after SECONDS of processor time. It imports nothing of sandgait, so that it starts
fast. An error is one line on stderr and exit code 2; other lines on stderr are notes.
"""

from __future__ import annotations

import json
import os
import resource
import signal
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, cast

import numpy as np
import numpy.typing as npt

#: Largest memory of this process [bytes]: our choice. The messages of MOST_NUMBERS take about half of it.
MEMORY = 2 << 30
#: Largest file that this process may write [bytes]: our choice; compressed bags are unpacked into temporary files.
UNPACKED = 8 << 30
#: Largest number of values: the limit of the diagnosis (src/diagnose/trajectory/log.rs).
MOST_NUMBERS = 20_000_000
#: Largest number of columns: our choice, as many as some ten robots have.
MOST_COLUMNS = 2000
#: Longest time between two messages of the IMU between which its readings are interpolated [s]: our choice, the
#: longest usual time between two samples of the joints.
LONGEST_GAP = 0.05

JOINTS, IMU = "sensor_msgs/msg/JointState", "sensor_msgs/msg/Imu"

Numbers = npt.NDArray[np.float64]


class Wrong(Exception):
    """The file cannot be read; the message is for the user."""


def parquet(path: Path) -> Any:
    """The table of a Parquet file, or of all episodes of a LeRobot data set (layouts 2 and 3)."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    pa.set_memory_pool(pa.system_memory_pool())
    root = path if path.is_dir() else next((p for p in path.parents[:3] if (p / "meta" / "info.json").is_file()), None)
    files = sorted(path.glob("data/*/*.parquet")) if path.is_dir() else [path]
    if not files:
        raise Wrong("the data set has no file data/*/*.parquet")
    info = json.loads((root / "meta" / "info.json").read_text(encoding="utf-8")) if root else {}
    features = info.get("features", {})
    tables, numbers = [], 0
    for file in files:
        opened = pq.ParquetFile(file)
        chosen = [field.name for field in opened.schema_arrow if _is_data(field.type)]
        for batch in opened.iter_batches(columns=chosen, batch_size=4096, use_threads=False):
            table = pa.Table.from_batches([batch])
            columns = dict(
                pair for name in table.column_names for pair in _flat(name, table[name], features.get(name, {}))
            )
            numbers += len(columns) * table.num_rows
            _bound(len(columns), numbers)
            tables.append(pa.table(columns))
    table = pa.concat_tables(tables, promote_options="default") if tables else pa.table({})
    if root:
        names = {"timestamp": "t", "episode_index": "run"}
        table = table.rename_columns([names.get(name, name) for name in table.column_names])
    return table


def _is_data(kind: Any) -> bool:
    """Does a column of this type have numbers, texts, or lists of numbers? All others, such as images, are left out."""
    import pyarrow.types as types

    if types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind):
        return _is_number(kind.value_type)
    if types.is_struct(kind):
        return all(_is_number(field.type) for field in kind)
    text = kind.value_type if types.is_dictionary(kind) else kind
    return _is_number(kind) or types.is_timestamp(kind) or types.is_string(text) or types.is_large_string(text)


def _is_number(kind: Any) -> bool:
    import pyarrow.types as types

    return bool(types.is_integer(kind) or types.is_floating(kind) or types.is_boolean(kind))


def _flat(name: str, column: Any, feature: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    """A column as it is; a list or structure as one column for each value, NAME.0 or NAME.FIELD."""
    import pyarrow as pa
    import pyarrow.compute as pc

    kind = column.type
    column = column.combine_chunks()
    if pa.types.is_timestamp(kind):
        yield name, pc.divide(pc.cast(pc.cast(column, pa.timestamp("ns")), pa.int64()), 1e9)
    elif pa.types.is_dictionary(kind):
        yield name, pc.cast(column, kind.value_type)
    elif pa.types.is_struct(kind):
        yield from ((f"{name}.{kind.field(i).name}", pc.struct_field(column, i)) for i in range(kind.num_fields))
    elif _is_number(kind) or not hasattr(kind, "value_type"):
        yield name, column
    else:
        lengths = set(pc.unique(pc.list_value_length(column)).to_pylist())
        if len(lengths) != 1 or None in lengths:
            raise Wrong(f"column {name}: its lists have different lengths, or some are missing")
        (length,) = lengths
        _bound(length, length)
        names = _names(feature.get("names"))
        parts = names if len(names) == length else [str(i) for i in range(length)]
        yield from ((f"{name}.{part}", pc.list_element(column, i)) for i, part in enumerate(parts))


def _names(given: Any) -> list[str]:
    """Names of a LeRobot feature's values, which are a list, or a list under the name of an axis."""
    while isinstance(given, dict) and len(given) == 1:
        (given,) = given.values()
    return [str(name) for name in given] if isinstance(given, list) else []


def _bound(columns: int, numbers: int) -> None:
    if columns > MOST_COLUMNS:
        raise Wrong(f"more than {MOST_COLUMNS} columns")
    if numbers > MOST_NUMBERS:
        raise Wrong(f"more than {MOST_NUMBERS} values: keep only every n-th sample")


def mcap(path: Path) -> Iterator[tuple[str, str, str, int, bytes]]:
    """Topic, type, encoding, time [ns] and bytes of each message."""
    from mcap.exceptions import EndOfFile
    from mcap.reader import NonSeekingReader

    with path.open("rb") as file:
        try:
            for schema, channel, message in NonSeekingReader(file, validate_crcs=True).iter_messages(
                log_time_order=False
            ):
                name = schema.name if schema else ""
                yield channel.topic, name, channel.message_encoding, message.log_time, message.data
        except EndOfFile:
            print("the file ends early, as after a crash of the recorder; what is complete is read", file=sys.stderr)


def bag(path: Path) -> Iterator[tuple[str, str, str, int, bytes]]:
    """Topic, type, encoding, time [ns] and bytes of each message."""
    from rosbags import rosbag1, rosbag2

    first = b"" if path.is_dir() else path.open("rb").read(7)
    if first == b"#ROSBAG":
        with rosbag1.Reader(path) as old:
            chosen = [c for c in old.connections if c.msgtype in (JOINTS, IMU)]
            for connection, time, data in old.messages(chosen) if chosen else ():
                yield connection.topic, connection.msgtype, "ros1", time, data
        return
    with rosbag2.Reader(path) as reader:
        chosen = [c for c in reader.connections if c.msgtype in (JOINTS, IMU)]
        for connection, time, data in reader.messages(chosen) if chosen else ():
            yield connection.topic, connection.msgtype, "cdr", time, bytes(data)


def robot(messages: Iterator[tuple[str, str, str, int, bytes]], topics: dict[str, str]) -> Any:
    """One row for each message of the joints, with the IMU's readings interpolated at its time."""
    import pyarrow as pa
    from rosbags.typesys import Stores, get_typestore

    stores = {"cdr": get_typestore(Stores.ROS2_HUMBLE), "ros1": get_typestore(Stores.ROS1_NOETIC)}
    asked = {JOINTS: topics.get("joints"), IMU: topics.get("imu")}
    found: dict[str, str] = {}
    read: dict[str, list[tuple[int, Any]]] = {JOINTS: [], IMU: []}
    numbers = 0
    for topic, name, encoding, time, data in messages:
        # ROS 1 writes the same types without "/msg".
        kind = name if "/msg/" in name else name.replace("/", "/msg/")
        if kind not in asked or asked[kind] not in (None, topic):
            continue
        if found.setdefault(kind, topic) != topic:
            key = "joints" if kind == JOINTS else "imu"
            raise Wrong(
                f"topics {found[kind]} and {topic} have the same type: name one of them as {key} under [topics]"
            )
        if encoding not in stores:
            raise Wrong(f"topic {topic}: its messages are encoded as {encoding!r}; cdr and ros1 are read")
        store = stores[encoding]
        decode = store.deserialize_cdr if encoding == "cdr" else store.deserialize_ros1
        message: Any = decode(data, kind)
        stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
        numbers += 10 if kind == IMU else 3 * len(message.name)
        _bound(len(message.name) if kind == JOINTS else 0, numbers)
        read[kind].append((stamp or time, message))
    for kind, key in ((JOINTS, "joints"), (IMU, "imu")):
        if not read[kind]:
            raise Wrong(
                f"no message of {kind}" + (f" in topic {asked[kind]}, which {key} names" if asked[kind] else "")
            )
        read[kind].sort(key=lambda entry: entry[0])
    return pa.table(_rows(read[JOINTS], read[IMU]))


def _rows(joints: list[tuple[int, Any]], imu: list[tuple[int, Any]]) -> dict[str, Numbers]:
    start = joints[0][0]
    at, of_imu = (np.array([stamp - start for stamp, _ in each], dtype=np.int64) for each in (joints, imu))
    # The last message of the IMU that is not after a row, and the first that is not before it.
    before, after = np.searchsorted(of_imu, at, "right") - 1, np.searchsorted(of_imu, at, "left")
    inside = (before >= 0) & (after < len(of_imu))
    before, after = np.maximum(before, 0), np.minimum(after, len(of_imu) - 1)
    apart = of_imu[after] - of_imu[before]
    kept = inside & (apart <= LONGEST_GAP * 1e9)
    share = np.where(apart > 0, (at - of_imu[before]) / np.maximum(apart, 1), 0.0)[:, None]
    columns = {"t": at / 1e9} | _joints([message for _, message in joints])
    vectors = {name: np.array([_vector(getattr(m, field)) for _, m in imu]) for name, field in FIELDS.items()}
    for name, values in vectors.items():
        mixed = values[before] + share * (values[after] - values[before])
        columns |= {f"{name}_{axis}": mixed[:, k] for k, axis in enumerate("xyz")}
    # The first covariance of a sensor without attitude is -1 (sensor_msgs/Imu).
    if all(message.orientation_covariance[0] != -1 for _, message in imu):
        quat = np.array([[m.orientation.w, *_vector(m.orientation)] for _, m in imu])
        a, b = quat[before], quat[after]
        sign = np.where((a * b).sum(axis=1, keepdims=True) < 0, -1.0, 1.0)  # q and -q are the same attitude
        mixed = a + share * (sign * b - a)
        # The length of the first quaternion is kept, so that the check of the table refuses an invalid quaternion.
        length = np.maximum(np.linalg.norm(mixed, axis=1, keepdims=True), 1e-9)
        mixed *= np.linalg.norm(a, axis=1, keepdims=True) / length
        columns |= {f"quat_{axis}": mixed[:, k] for k, axis in enumerate("wxyz")}
    return {name: values[kept] for name, values in columns.items()}


#: Columns of the IMU, and the fields of its messages.
FIELDS = {"gyro": "angular_velocity", "acc": "linear_acceleration"}


def _vector(field: Any) -> list[float]:
    return [field.x, field.y, field.z]


def _joints(messages: list[Any]) -> dict[str, Numbers]:
    """Angles, speeds and torques of the joints that the first message names."""
    names = list(messages[0].name)
    columns: dict[str, Numbers] = {}
    for kind, field in (("q", "position"), ("qd", "velocity"), ("tau", "effort")):
        if kind != "q" and not len(getattr(messages[0], field)):
            continue
        rows = []
        for message in messages:
            places = {name: i for i, name in enumerate(message.name)}
            values = getattr(message, field)
            try:
                rows.append([values[places[name]] for name in names])
            except (KeyError, IndexError):
                raise Wrong("a message of joints lacks a joint or a value that the first one has") from None
        columns |= {f"{kind}:{name}": column for name, column in zip(names, np.array(rows).T, strict=True)}
    return columns


def end_with(parent: int) -> None:
    """This process is killed when the thread that started it ends, for whatever reason. Only Linux can do this; on
    other systems the limit of processor time ends it."""
    if sys.platform == "linux":
        import ctypes

        kill_me = 1  # PR_SET_PDEATHSIG (linux/prctl.h)
        ctypes.CDLL(None).prctl(kill_me, signal.SIGKILL, 0, 0, 0)
        if os.getppid() != parent:  # it ended before the call
            sys.exit(1)


def main(parent: str, seconds: str, form: str, file: str, *topics: str) -> None:
    """Writes the table, or one line on stderr."""
    end_with(int(parent))
    limits = (
        (resource.RLIMIT_AS, MEMORY),
        (resource.RLIMIT_FSIZE, UNPACKED),
        (resource.RLIMIT_CORE, 0),
        (resource.RLIMIT_CPU, int(seconds)),
    )
    for what, most in limits:
        with suppress(ValueError, OSError):  # some systems do not have all limits
            resource.setrlimit(what, (most, most))
    path = Path(file)
    try:
        import pyarrow.csv

        if form == "parquet":
            table = parquet(path)
        else:
            chosen = dict(cast(tuple[str, str], tuple(topic.split("=", 1))) for topic in topics)
            table = robot(mcap(path) if form == "mcap" else bag(path), chosen)
        if not table.num_rows or not table.num_columns:
            raise Wrong("no rows")
        pyarrow.csv.write_csv(table, sys.stdout.buffer)
        sys.stdout.flush()
    except ModuleNotFoundError as error:
        end(f"{error.name} is needed to read this file: pip install 'sandgait[logs]'")
    except MemoryError:
        end(f"the file needs more than {MEMORY >> 30} GiB of memory")
    except Wrong as error:
        end(str(error))
    except Exception as error:  # each library has errors of its own for damaged files
        reason = " ".join(str(error).split()) or type(error).__name__
        hint = "; `mcap recover` repairs a file whose recorder crashed" if form == "mcap" else ""
        end(f"cannot be read as {form}: {reason}{hint}")


def end(reason: str) -> None:
    """Ends the process with one line."""
    print(reason, file=sys.stderr)
    sys.exit(2)


if __name__ == "__main__":
    main(*sys.argv[1:])
