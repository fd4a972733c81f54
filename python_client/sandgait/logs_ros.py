"""Messages of ROS as one table: joints, and an IMU or a force sensor. `logs_reader.py` loads this file.

Recordings have several senders on one topic, messages that were recorded twice, and clocks that are set back. What is
done about them is printed as a note; what cannot be repaired is an error that names topic, time and remedy.
"""

from __future__ import annotations

import re
import sys
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import numpy.typing as npt

#: Largest number of values: the limit of the diagnosis (src/diagnose/trajectory/log.rs).
MOST_NUMBERS = 20_000_000
#: Largest number of columns: our choice, as many as some ten robots have.
MOST_COLUMNS = 2000
#: Longest time between two messages between which readings are interpolated [s]: our choice, the longest usual time
#: between two samples of the joints.
LONGEST_GAP = 0.05
#: A clock that goes back by more than this was set back [s]: our choice; messages overtake each other by less.
SET_BACK = 0.1
#: Messages of a topic with which a message is compared to find copies: our choice, more than a topic has senders.
COPIES = 16
#: A sender whose joints are known at less than this share of the rows is left out: our choice.
COVERED = 0.9

JOINTS, IMU, WRENCH = "sensor_msgs/msg/JointState", "sensor_msgs/msg/Imu", "geometry_msgs/msg/WrenchStamped"
#: Keys of [topics].
KEYS = {JOINTS: "joints", IMU: "imu", WRENCH: "wrench"}

Numbers = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]
Message = tuple[str, str, str, int, bytes]


class Wrong(Exception):
    """The file cannot be read; the message is for the user."""


def note(text: str) -> None:
    print(text, file=sys.stderr)


def bound(columns: int, numbers: int) -> None:
    if columns > MOST_COLUMNS:
        raise Wrong(f"more than {MOST_COLUMNS} columns")
    if numbers > MOST_NUMBERS:
        raise Wrong(f"more than {MOST_NUMBERS} values: keep only every n-th sample")


def mcap(path: Path) -> Iterator[Message]:
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
            note("the file ends early, as after a crash of the recorder; what is complete is read")


def bag(path: Path) -> Iterator[Message]:
    """Topic, type, encoding, time [ns] and bytes of each message."""
    from rosbags import rosbag1, rosbag2

    first = b"" if path.is_dir() else path.open("rb").read(7)
    if first == b"#ROSBAG":
        with rosbag1.Reader(path) as old:
            chosen = [c for c in old.connections if c.msgtype in KEYS]
            for connection, time, data in old.messages(chosen) if chosen else ():
                yield connection.topic, connection.msgtype, "ros1", time, data
        return
    try:
        reader = rosbag2.Reader(path)
        reader.open()
    except (rosbag2.ReaderError, OSError) as error:
        if not path.is_dir():
            raise
        yield from _files(path, error)
        return
    try:
        chosen = [c for c in reader.connections if c.msgtype in KEYS]
        for connection, time, data in reader.messages(chosen) if chosen else ():
            yield connection.topic, connection.msgtype, "cdr", time, bytes(data)
    finally:
        reader.close()


def _files(folder: Path, error: Exception) -> Iterator[Message]:
    """The messages of a bag whose metadata.yaml is missing, as after a crash, or incomplete, as after a reindex."""

    def number(path: Path) -> tuple[list[int], str]:
        return [int(digits) for digits in re.findall(r"\d+", path.stem)], path.name

    files = sorted((p for p in folder.iterdir() if p.suffix in (".mcap", ".db3") and p.is_file()), key=number)
    if not files:
        raise Wrong(f"the folder has no file .mcap or .db3 to read without its metadata.yaml ({error})")
    note(f"metadata.yaml is missing or incomplete; read without it: {', '.join(path.name for path in files[:4])}")
    for path in files:
        yield from mcap(path) if path.suffix == ".mcap" else bag(path)


class Sender:
    """Messages of one sender: those of a topic with the same names. A run ends where the clock is set back."""

    def __init__(self, topic: str, names: tuple[str, ...]) -> None:
        self.topic, self.names = topic, names
        self.entries: list[tuple[int, int, Any]] = []
        self.jumps: list[tuple[int, int]] = []
        self.latest = 0

    def add(self, stamp: int, message: Any) -> None:
        if self.entries and stamp < self.latest - SET_BACK * 1e9:
            self.jumps.append((self.latest, stamp))
            self.latest = stamp
        self.latest = max(self.latest, stamp)
        self.entries.append((len(self.jumps), stamp, message))

    def run(self, number: int) -> tuple[Stamps, list[Any]]:
        """Stamps and messages of a run, in the order of the stamps; of several messages with one stamp the first."""
        own = sorted((entry for entry in self.entries if entry[0] == number), key=lambda entry: entry[1])
        kept = [entry for k, entry in enumerate(own) if k == 0 or entry[1] > own[k - 1][1]]
        if len(kept) < len(own):
            note(f"topic {self.topic}: {len(own) - len(kept)} messages have the stamp of another one; the first counts")
        return np.array([entry[1] for entry in kept], dtype=np.int64), [entry[2] for entry in kept]

    def span(self) -> tuple[float, float]:
        """First and last stamp [s]."""
        stamps = [entry[1] for entry in self.entries]
        return min(stamps) / 1e9, max(stamps) / 1e9


def robot(messages: Iterator[Message], topics: dict[str, str]) -> dict[str, Any]:
    """Columns with one row for each message of the joints, and the other readings interpolated at its time."""
    read = _decoded(messages, topics)
    senders = _senders(read, by_recorder=False)
    joints = _main(senders, topics)
    other = _sensor(senders, topics)
    if not _overlap(joints, other):
        said = f"the stamps of {_clock(other)} and of {_clock(joints)} do not overlap"
        senders = _senders(read, by_recorder=True)
        joints, other = _main(senders, topics), _sensor(senders, topics)
        if not _overlap(joints, other):
            raise Wrong(f"{said}: log both with one clock")
        note(f"{said}: the times at which the recorder got the messages are taken instead")
    if len(joints.jumps) != len(other.jumps):
        early = joints if len(joints.jumps) > len(other.jumps) else other
        before, after = early.jumps[-1]
        last = other if early is joints else joints
        raise Wrong(
            f"the clock of {early.topic} goes back from {before / 1e9:.3f} to {after / 1e9:.3f} s, "
            f"that of {last.topic} does not: cut the recording there"
        )
    for before, after in joints.jumps:
        note(f"the clock goes back from {before / 1e9:.3f} to {after / 1e9:.3f} s: what follows is a run of its own")
    beside = [sender for kind, sender in senders if kind == JOINTS and sender is not joints]
    parts = [_rows(number, joints, beside, other) for number in range(len(joints.jumps) + 1)]
    common = [name for name in parts[0] if all(name in part for part in parts)]
    table: dict[str, Any] = {name: np.concatenate([part[name] for part in parts]) for name in common}
    if not len(table["t"]):
        raise Wrong(
            f"no message of {joints.topic} is between two of {other.topic} that are at most {LONGEST_GAP} s apart"
        )
    if len(parts) > 1:
        table["run"] = np.concatenate([np.full(len(part["t"]), k + 1) for k, part in enumerate(parts)])
    return table


def _decoded(messages: Iterator[Message], topics: dict[str, str]) -> list[tuple[str, str, int, int, Any]]:
    """Type, topic, stamp (0 if it is not set), time of the recorder, and content of each message; each once."""
    from rosbags.typesys import Stores, get_typestore

    stores = {"cdr": get_typestore(Stores.ROS2_HUMBLE), "ros1": get_typestore(Stores.ROS1_NOETIC)}
    asked = {kind: topics.get(key) for kind, key in KEYS.items()}
    read: list[tuple[str, str, int, int, Any]] = []
    last: dict[str, deque[bytes]] = {}
    numbers = copies = 0
    for topic, name, encoding, time, data in messages:
        # ROS 1 writes the same types without "/msg".
        kind = name if "/msg/" in name else name.replace("/", "/msg/")
        if kind not in asked or asked[kind] not in (None, topic):
            continue
        if encoding not in stores:
            raise Wrong(f"topic {topic}: its messages are encoded as {encoding!r}; cdr and ros1 are read")
        store = stores[encoding]
        decode = store.deserialize_cdr if encoding == "cdr" else store.deserialize_ros1
        message: Any = decode(data, kind)
        stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
        before = last.setdefault(topic, deque(maxlen=COPIES))
        if stamp and data in before:
            copies += 1
            continue
        before.append(data)
        numbers += 3 * len(message.name) if kind == JOINTS else 10
        bound(len(message.name) if kind == JOINTS else 0, numbers)
        read.append((kind, topic, stamp, time, message))
    if copies:
        note(f"{copies} messages are in the file twice; each is read once")
    return read


def _senders(read: list[tuple[str, str, int, int, Any]], by_recorder: bool) -> list[tuple[str, Sender]]:
    """The senders, with stamps of their own or the times of the recorder."""
    senders: dict[tuple[str, str, tuple[str, ...]], Sender] = {}
    for kind, topic, stamp, time, message in read:
        names = tuple(message.name) if kind == JOINTS else ()
        sender = senders.setdefault((kind, topic, names), Sender(topic, names))
        sender.add(time if by_recorder else stamp or time, message)
    return [(kind, sender) for (kind, _, _), sender in senders.items()]


def _only_topic(kind: str, senders: list[tuple[str, Sender]]) -> list[Sender]:
    """The senders of one type; an error if they are on several topics."""
    own = [sender for of, sender in senders if of == kind]
    different = list(dict.fromkeys(sender.topic for sender in own))
    if len(different) > 1:
        raise Wrong(
            f"topics {different[0]} and {different[1]} have the same type: "
            f"name one of them as {KEYS[kind]} under [topics]"
        )
    return own


def _main(senders: list[tuple[str, Sender]], topics: dict[str, str]) -> Sender:
    """The sender of the most joints: its messages are the rows."""
    own = _only_topic(JOINTS, senders)
    if not own:
        _absent((JOINTS,), topics)
    return max(own, key=lambda sender: (len(sender.names), len(sender.entries)))


def _sensor(senders: list[tuple[str, Sender]], topics: dict[str, str]) -> Sender:
    """The IMU of a robot, or the force sensor of an arm."""
    for kind in (WRENCH, IMU) if "wrench" in topics else (IMU, WRENCH):
        own = _only_topic(kind, senders)
        if own:
            return own[0]
    _absent((WRENCH, IMU) if "wrench" in topics else (IMU, WRENCH), topics)


def _absent(kinds: tuple[str, ...], topics: dict[str, str]) -> NoReturn:
    """No topic has messages of these types, or the one that is named has none."""
    key = KEYS[kinds[0]]
    if key in topics:
        raise Wrong(f"no message of {kinds[0]} in topic {topics[key]}, which {key} names")
    raise Wrong("no message of " + ", and none of ".join(kinds))


def _overlap(a: Sender, b: Sender) -> bool:
    (first, last), (start, end) = a.span(), b.span()
    return max(first, start) <= min(last, end)


def _clock(sender: Sender) -> str:
    return "{} ({:.1f} to {:.1f} s)".format(sender.topic, *sender.span())


class Between:
    """Interpolation of a sender's readings at the times of the rows."""

    def __init__(self, stamps: Stamps, at: Stamps) -> None:
        # The last message that is not after a row, and the first that is not before it.
        before, after = np.searchsorted(stamps, at, "right") - 1, np.searchsorted(stamps, at, "left")
        inside = (before >= 0) & (after < len(stamps))
        self.before, self.after = np.maximum(before, 0), np.minimum(after, len(stamps) - 1)
        apart = stamps[self.after] - stamps[self.before]
        self.known = inside & (apart <= LONGEST_GAP * 1e9)
        self.share = np.where(apart > 0, (at - stamps[self.before]) / np.maximum(apart, 1), 0.0)[:, None]

    def mixed(self, values: Numbers, turn: float | None = None) -> Numbers:
        """`values` has a row for each message. Of an angle that is wrapped after a `turn` the shorter way is taken."""
        way = values[self.after] - values[self.before]
        if turn:
            way = np.where(np.abs(way) > turn / 2, way - turn * np.round(way / turn), way)
        return np.asarray(values[self.before] + self.share * way)


def _rows(number: int, joints: Sender, beside: list[Sender], other: Sender) -> dict[str, Numbers]:
    """The table of one run."""
    at, messages = joints.run(number)
    columns = {"t": (at - at[0]) / 1e9} | _joints(joints, at, messages)
    kept = np.ones(len(at), dtype=bool)
    for sender in beside:
        stamps, own = sender.run(number)
        names = [name for name in sender.names if f"q:{name}" not in columns]
        between = Between(stamps, at) if len(stamps) else None
        if between is None or between.known.mean() < COVERED:
            note(f"topic {sender.topic}: {', '.join(names[:4])} are sent too rarely, or at other times, and left out")
            continue
        kept &= between.known
        for column, values in _joints(sender, stamps, own).items():
            if column.partition(":")[2] in names:
                turn = 2 * np.pi if column.startswith("q:") else None
                columns[column] = between.mixed(values[:, None], turn)[:, 0]
    stamps, readings = other.run(number)
    if not len(stamps):
        raise Wrong(f"topic {other.topic} has no message in run {number + 1}")
    between = Between(stamps, at)
    columns |= _readings(readings, between)
    return {name: values[kept & between.known] for name, values in columns.items()}


#: Columns, and the fields of messages that have them.
FIELDS = {"gyro": "angular_velocity", "acc": "linear_acceleration"}
WRENCHES = {"force": "force", "torque": "torque"}


def _readings(messages: list[Any], between: Between) -> dict[str, Numbers]:
    """The columns of an IMU or of a force sensor."""
    wrench = hasattr(messages[0], "wrench")
    columns: dict[str, Numbers] = {}
    for name, field in (WRENCHES if wrench else FIELDS).items():
        values = np.array([_vector(getattr(m.wrench if wrench else m, field)) for m in messages])
        mixed = between.mixed(values)
        columns |= {f"{name}_{axis}": mixed[:, k] for k, axis in enumerate("xyz")}
    # The first covariance of a sensor without attitude is -1 (sensor_msgs/Imu).
    if not wrench and messages[0].orientation_covariance[0] >= 0:
        quat = np.array([[m.orientation.w, *_vector(m.orientation)] for m in messages])
        a, b = quat[between.before], quat[between.after]
        sign = np.where((a * b).sum(axis=1, keepdims=True) < 0, -1.0, 1.0)  # q and -q are the same attitude
        mixed = a + between.share * (sign * b - a)
        # The length of the first quaternion is kept, so that the check of the table refuses an invalid quaternion.
        length = np.maximum(np.linalg.norm(mixed, axis=1, keepdims=True), 1e-9)
        mixed *= np.linalg.norm(a, axis=1, keepdims=True) / length
        columns |= {f"quat_{axis}": mixed[:, k] for k, axis in enumerate("wxyz")}
    return columns


def _vector(field: Any) -> list[float]:
    return [field.x, field.y, field.z]


def _joints(sender: Sender, stamps: Stamps, messages: list[Any]) -> dict[str, Numbers]:
    """Angles, speeds and torques of a sender's joints."""
    columns: dict[str, Numbers] = {}
    for kind, field in (("q", "position"), ("qd", "velocity"), ("tau", "effort")):
        if kind != "q" and not len(getattr(messages[0], field)):
            continue
        rows = [list(getattr(message, field)) for message in messages]
        short = next((k for k, row in enumerate(rows) if len(row) != len(sender.names)), None)
        if short is not None:
            raise Wrong(
                f"topic {sender.topic}, message at {stamps[short] / 1e9:.3f} s: "
                f"{len(rows[short])} values of {field} for {len(sender.names)} joints"
            )
        columns |= {
            f"{kind}:{name}": column for name, column in zip(sender.names, np.array(rows, dtype=float).T, strict=True)
        }
    return columns
