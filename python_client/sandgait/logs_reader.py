"""Reads one recording and writes its table to stdout as CSV: the process that `sandgait.logs` starts.

    python -P logs_reader.py PARENT SECONDS FORM FILE [joints=TOPIC] [imu=TOPIC] [wrench=TOPIC]

It ends with the process PARENT, and after SECONDS of processor time. It imports nothing of sandgait, so that it starts
fast. An error is one line on stderr and exit code 2; other lines on stderr are notes.
"""

from __future__ import annotations

import importlib.util
import json
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, cast

#: Largest memory of this process [bytes]: our choice. The messages of MOST_NUMBERS take about half of it.
MEMORY = 2 << 30
#: Largest file that this process may write [bytes]: our choice; compressed bags are unpacked into temporary files.
UNPACKED = 8 << 30


def _beside(name: str) -> Any:
    """A module of this folder, which is not on the path: other modules here have the names of libraries."""
    spec = importlib.util.spec_from_file_location(name, Path(__file__).with_name(f"{name}.py"))
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def parquet(path: Path) -> Any:
    """The table of a Parquet file, or of all episodes of a LeRobot data set (layouts 2 and 3)."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    pa.set_memory_pool(pa.system_memory_pool())
    root = path if path.is_dir() else next((p for p in path.parents[:3] if (p / "meta" / "info.json").is_file()), None)
    files = sorted(path.glob("data/*/*.parquet")) if path.is_dir() else [path]
    if not files:
        raise ros.Wrong("the data set has no file data/*/*.parquet")
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
            ros.bound(len(columns), numbers)
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
            raise ros.Wrong(f"column {name}: its lists have different lengths, or some are missing")
        (length,) = lengths
        ros.bound(length, length)
        names = _names(feature.get("names"))
        parts = names if len(names) == length else [str(i) for i in range(length)]
        yield from ((f"{name}.{part}", pc.list_element(column, i)) for i, part in enumerate(parts))


def _names(given: Any) -> list[str]:
    """Names of a LeRobot feature's values, which are a list, or a list under the name of an axis."""
    while isinstance(given, dict) and len(given) == 1:
        (given,) = given.values()
    return [str(name) for name in given] if isinstance(given, list) else []


def end_with(parent: int) -> None:
    """This process is killed when the thread that started it ends, for whatever reason. Only Linux can do this; on
    other systems the limit of processor time ends it."""
    if sys.platform == "linux":
        import ctypes

        kill_me = 1  # PR_SET_PDEATHSIG (linux/prctl.h)
        ctypes.CDLL(None).prctl(kill_me, signal.SIGKILL, 0, 0, 0)
        if os.getppid() != parent:  # it ended before the call
            sys.exit(1)


def limit(seconds: int) -> None:
    """Limits memory, files and processor time of this process."""
    import resource  # Windows lacks it

    limits = (
        (resource.RLIMIT_AS, MEMORY),
        (resource.RLIMIT_FSIZE, UNPACKED),
        (resource.RLIMIT_CORE, 0),
        (resource.RLIMIT_CPU, seconds),
    )
    for what, most in limits:
        with suppress(ValueError, OSError):  # some systems do not have all limits
            resource.setrlimit(what, (most, most))


def main(parent: str, seconds: str, form: str, file: str, *topics: str) -> None:
    """Writes the table, or one line on stderr."""
    end_with(int(parent))
    if sys.platform == "win32":
        print("this system has no limits of a process's memory and time, so none are set", file=sys.stderr)
    else:
        limit(int(seconds))
    path = Path(file)
    load("pyarrow.csv", *(("pyarrow.parquet",) if form == "parquet" else ("rosbags.typesys", "mcap.reader")))
    try:
        import pyarrow.csv

        if form == "parquet":
            table = parquet(path)
        else:
            chosen = dict(cast(tuple[str, str], tuple(topic.split("=", 1))) for topic in topics)
            messages = ros.mcap(path) if form == "mcap" else ros.bag(path)
            of_controller, messages = walk.split(messages)
            columns = walk.table(messages, ros.bound) if of_controller else ros.robot(messages, chosen)
            table = pyarrow.table(columns)
        if not table.num_rows or not table.num_columns:
            raise ros.Wrong("no rows")
        pyarrow.csv.write_csv(table, sys.stdout.buffer)
        sys.stdout.flush()
    except MemoryError:
        end(f"the file needs more than {MEMORY >> 30} GiB of memory")
    except ros.Wrong as error:
        end(str(error))
    except Exception as error:  # each library has errors of its own for damaged files
        reason = " ".join(str(error).split()) or type(error).__name__
        hint = "; `mcap recover` repairs a file whose recorder crashed" if form == "mcap" else ""
        end(f"cannot be read as {form}: {reason}{hint}")


def load(*modules: str) -> None:
    """Loads the libraries; a library that is missing, or too old for another, is no fault of the file."""
    for module in modules:
        try:
            importlib.import_module(module)
        except ModuleNotFoundError as error:
            end(f"{error.name} is needed to read this file: pip install 'sandgait[logs]'")
        except Exception as error:  # what a library raises if another one is too old
            reason = " ".join(str(error).split()) or type(error).__name__
            name = module.partition(".")[0]
            end(f"{name}, which reads this file, cannot be loaded: {reason}; pip install --upgrade 'sandgait[logs]'")


def end(reason: str) -> None:
    """Ends the process with one line."""
    print(reason, file=sys.stderr)
    sys.exit(2)


ros = _beside("logs_ros")
walk = _beside("logs_walk")

if __name__ == "__main__":
    main(*sys.argv[1:])
