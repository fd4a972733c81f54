"""Recordings of robots and test benches as CSV: Parquet, LeRobot data sets, MCAP, and bags of ROS 1 and ROS 2.

    python -m sandgait.logs walk.mcap --out walk.csv

`sandgait.diagnose` does the same with a recording. Files are read by pyarrow, mcap and rosbags, which
`pip install 'sandgait[logs]'` installs, in a process of their own with limits on memory, size and time, which ends with
this one. So a damaged or hostile file ends with one error, even if a library crashes on it. Only the table is passed
on.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import threading
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from tempfile import TemporaryFile

from .arguments import checked
from .errors import InvalidRequest
from .user_warnings import warn

#: First bytes of each format that is converted.
MARKS = {b"PAR1": "parquet", b"\x89MCAP": "mcap", b"#ROSBAG": "bag", b"SQLite format 3\0": "bag"}

#: Largest table [bytes]: the most that a diagnosis reads (src/table/mod.rs).
MOST_BYTES = 256 << 20

#: The program that reads one file.
READER = str(Path(__file__).with_name("logs_reader.py"))

#: Longest time for a file [s]: our choice, so that a hostile file does not hold its caller for hours.
LONGEST = 600

#: Longest error of a library that is shown: our choice, about three lines on a terminal.
SHOWN = 300


def kind(source: str | PathLike[str]) -> str | None:
    """The format of a recording: parquet, mcap or bag. None for CSV, other formats, and what cannot be read."""
    try:
        path = Path(source)
        if (path / "metadata.yaml").is_file():
            return "bag"
        if (path / "meta" / "info.json").is_file():
            return "parquet"
        with path.open("rb") as file:
            first = file.read(max(map(len, MARKS)))
    except (OSError, TypeError, ValueError):
        return None
    return next((name for mark, name in MARKS.items() if first.startswith(mark)), None)


@checked
def to_csv(path: str | PathLike[str], topics: Mapping[str, str] | None = None) -> bytes:
    """The table in a recording, as CSV.

    `topics` names the topics of a bag, `joints` and `imu`, if it has several of the same type. Raises InvalidRequest
    with one line if the file cannot be read.
    """
    source = Path(path)
    form = kind(source)
    if form is None:
        raise InvalidRequest(f"{source}: neither Parquet, LeRobot, MCAP nor a bag of ROS 1 or ROS 2")
    wrong = [name for name in topics or {} if name not in ("joints", "imu")]
    if wrong:
        raise InvalidRequest(f"topics: {wrong[0]!r} is unknown; known: joints, imu")
    chosen = [f"{name}={topic}" for name, topic in (topics or {}).items()]
    own = [str(os.getpid()), str(LONGEST)]
    command = [sys.executable, "-P", "-W", "ignore", READER, *own, form, str(source.resolve()), *chosen]
    # OpenBLAS reserves memory for each of its threads, which would count as memory that the file needs.
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1"}
    late = threading.Event()
    with TemporaryFile() as errors:
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors, env=environment) as reader:

            def stop() -> None:
                late.set()
                reader.kill()

            timer = threading.Timer(LONGEST, stop)
            timer.daemon = True
            timer.start()
            try:
                assert reader.stdout
                table = reader.stdout.read(MOST_BYTES + 1)
                if len(table) > MOST_BYTES:
                    reader.kill()
                reader.wait()
            finally:  # also after Ctrl-C
                timer.cancel()
                reader.kill()
        errors.seek(0)
        said = [line[:SHOWN] for line in errors.read().decode(errors="replace").splitlines() if line.strip()]
    if len(table) > MOST_BYTES:
        raise InvalidRequest(f"{source}: more than {MOST_BYTES >> 20} MiB as CSV: keep only every n-th sample")
    if late.is_set():
        raise InvalidRequest(f"{source}: it was not read within {LONGEST} s")
    if reader.returncode:
        raise InvalidRequest(f"{source}: {said[-1] if said else f'its reader crashed ({reader.returncode})'}")
    for line in said:
        warn([f"{source}: {line}"])
    return table


def main() -> int:
    """Writes a recording as CSV. If the recording cannot be read, nothing is written, and the exit code is 2. It is 1
    if the table cannot be written."""
    parser = argparse.ArgumentParser(prog="python -m sandgait.logs", description="Writes a recording as CSV.")
    parser.add_argument("file", help="a Parquet, MCAP or bag file, or the folder of a LeRobot data set or a ROS 2 bag")
    parser.add_argument("--out", required=True, type=Path, help="the CSV file to write")
    parser.add_argument("--joints", help="topic of sensor_msgs/JointState, if a bag has several")
    parser.add_argument("--imu", help="topic of sensor_msgs/Imu, if a bag has several")
    given = parser.parse_args()
    topics = {name: topic for name, topic in (("joints", given.joints), ("imu", given.imu)) if topic}
    try:
        table = to_csv(given.file, topics)
    except (InvalidRequest, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    try:
        given.out.write_bytes(table)
    except (FileNotFoundError, IsADirectoryError, NotADirectoryError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except OSError as error:  # a full disk, or a folder that is read-only
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
