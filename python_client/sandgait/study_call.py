"""Calls of studies: Python's values become the words of the command line, and the result an object with numpy's arrays.

`study_functions` has the functions, which the program writes from its declarations.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable, Mapping
from os import PathLike, fspath
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from . import _native
from .arguments import numbers, shown
from .diagnosis import content
from .errors import InvalidRequest
from .options import keyword_error, with_files
from .results import StudyTables, result_of
from .user_warnings import warn

FilePath = str | PathLike[str]

#: A table: a CSV file, or columns by name as a mapping or a pandas DataFrame. A column may be one number for all rows.
Data = FilePath | Mapping[str, npt.ArrayLike]

#: True shows the progress as a line on the terminal or in the notebook. A function is called with the finished share
#: and the stage.
ProgressOption = bool | Callable[[float, str], None]


#: Endings of files in memory by which a study knows their format.
_ENDINGS = {"policy": ".onnx"}


class StudyCall:
    """Arguments of a study, each added with its option of the command line (empty: it has none) and its keyword."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._words: list[str] = []
        self._others: list[str] = []
        self._files: dict[str, Any] = {}
        self._outputs: set[str] = set()
        #: Option, keyword and measured data, which are converted when the experiment is known.
        self._measured: tuple[str, str, Any] | None = None
        self._experiment: Any = {}

    def _add(self, option: str, text: str) -> None:
        if option:
            self._words.append(f"{option}={text}")
        else:
            self._others.append(text)

    def flag(self, option: str, keyword: str, value: bool) -> None:
        """Adds a switch that is on."""
        if value:
            self._words.append(option)

    def value(self, option: str, keyword: str, value: float | str | None) -> None:
        """Adds a number or a text. Python writes a number with all digits that it needs."""
        if value is not None:
            self._add(option, value if isinstance(value, str) else _word(value))

    def numbers(self, option: str, keyword: str, values: float | npt.ArrayLike | None) -> None:
        """Adds one or several numbers."""
        if values is not None:
            many = np.atleast_1d(numbers(keyword, values, np.float64)).ravel()
            self._add(option, f"[{','.join(map(_word, many.tolist()))}]")

    def names(self, option: str, keyword: str, values: Iterable[str] | None) -> None:
        """Adds texts."""
        many = list(values or ())
        if many:
            self._add(option, json.dumps(many, ensure_ascii=False))

    def file(self, option: str, keyword: str, path: FilePath | bytes | None) -> None:
        """Adds a name, or a file, which is read on this machine. Bytes stand for the content of a file."""
        if isinstance(path, bytes):
            name = keyword + _ENDINGS.get(keyword, "")
            self._files[name] = path
            self._add(option, name)
        elif path is not None:
            self._add(option, fspath(path))

    def files(self, option: str, keyword: str, paths: FilePath | Iterable[FilePath]) -> None:
        """Adds one or several files."""
        for path in [paths] if isinstance(paths, (str, PathLike)) else paths:
            self.file(option, keyword, path)

    def output(self, option: str, keyword: str, path: FilePath | None) -> None:
        """Adds a file that `run` writes."""
        if path is not None:
            self._outputs.add(fspath(path))
            self._add(option, fspath(path))

    def data(self, option: str, keyword: str, data: Data | None) -> None:
        """Adds a table in a file or in memory."""
        if data is None or isinstance(data, (str, PathLike)):
            self.file(option, keyword, data)
            return
        self._files[keyword] = _table(keyword, data)
        self._add(option, keyword)

    def measured(self, option: str, keyword: str, data: Any) -> None:
        """Adds measured data: a CSV file, a pandas DataFrame, or a recording that `sandgait.logs` reads."""
        self._measured = option, keyword, data

    def tables(self, option: str, keyword: str, tables: FilePath | Mapping[str, Any]) -> None:
        """Adds a TOML file, or its tables as a dict."""
        self._experiment = tables
        if not isinstance(tables, Mapping):
            self._add(option, fspath(tables))
            return
        self._files[keyword] = json.dumps(_plain(tables), ensure_ascii=False).encode()
        self._add(option, keyword)

    def settings(self, option: str, keyword: str, values: Mapping[str, Any] | None) -> None:
        """Adds values by names. The command line writes leg-mass for the keyword leg_mass."""
        for name, value in (values or {}).items():
            self._add(option, f"{name.replace('_', '-')}={_setting(name, value)}")

    def options(self, option: str, keyword: str, options: Mapping[str, Any]) -> None:
        """Adds options of a task, with the contents of the files that they name."""
        for name, value in _native.option_words(with_files(options)):
            self._add(option, f"{name}={value}")

    def run(self, address: str | None, progress: ProgressOption) -> Any:
        """The result of the study at `address` or in this process. Ctrl-C, or an exception of `progress`, stops it."""
        if self._measured is not None:
            option, keyword, data = self._measured
            made = content(data, self._experiment)
            if made is not None:
                self._files[made[0]] = made[1]
            elif not isinstance(data, (str, PathLike)):
                raise InvalidRequest(f"{keyword}: {shown(data)} is neither a file nor a table")
            self._add(option, fspath(data) if made is None else made[0])
        words = [*self._words, "--", *self._others] if self._others else self._words
        with Display(progress) as told:
            if address is None:
                try:
                    reply = _native.study(None, self._name, words, self._files, told)
                except InvalidRequest as error:
                    raise keyword_error(str(error)) from None
            else:
                from . import client

                reply = client.study(address, self._name, words, self._files, told)
        summary, about, warnings, tables, files, named = reply
        for line in warnings:
            warn([line])
        for name, written in named:
            # A server chooses no files of this machine.
            if name not in self._outputs:
                raise InvalidRequest(f"{self._name}: the result has a file {name!r}, which was not asked for")
            Path(name).write_bytes(written)
        return result_of(StudyTables(summary, about, tables, dict(files)))


def _plain(value: Any) -> Any:
    """`value` with Python's numbers and lists in place of numpy's."""
    if isinstance(value, Mapping):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    if isinstance(value, (list, tuple)):
        return [_plain(entry) for entry in value]
    return fspath(value) if isinstance(value, PathLike) else value


def _word(value: Any) -> str:
    """A number as a text that is read back to the same bits."""
    return repr(value.item() if isinstance(value, np.generic) else value)


def _table(keyword: str, data: Mapping[str, npt.ArrayLike]) -> list[tuple[str, str, bytes]]:
    """The columns of `data`, all of the same length."""
    try:
        columns = [np.atleast_1d(np.asarray(data[name], dtype=np.float64)) for name in data]
        full = np.broadcast_arrays(*columns)
    except (TypeError, ValueError) as error:
        raise InvalidRequest(f"{keyword}: {error}") from error
    if full and full[0].ndim != 1:
        raise InvalidRequest(f"{keyword}: each column must be a number or a one-dimensional array")
    return [(name, "", column.astype("<f8").tobytes()) for name, column in zip(data, full, strict=True)]


def _setting(name: str, value: Any) -> str:
    if isinstance(value, str):
        return json.dumps([value], ensure_ascii=False) if "," in value or ":" in value else value
    try:
        listed = list(value) if hasattr(value, "__iter__") else [value]
        if all(isinstance(one, str) for one in listed):
            return json.dumps(listed, ensure_ascii=False)
        return f"[{','.join(_word(float(one)) for one in listed)}]"
    except (TypeError, ValueError) as error:
        raise InvalidRequest(f"{name}: {shown(value)} are neither all numbers nor all names") from error


class Display:
    """Shows the progress of a study on a terminal or in a notebook, as a line that is overwritten."""

    def __init__(self, option: ProgressOption) -> None:
        self._tell = option if callable(option) else None
        watched = sys.stderr is not None and (sys.stderr.isatty() or "ipykernel" in sys.modules)
        self._line = option is True and watched
        self._width = 0

    def __call__(self, fraction: float, stage: str) -> None:
        if self._tell is not None:
            self._tell(fraction, stage)
        elif self._line:
            text = f"{100.0 * fraction:3.0f} % {stage}"
            sys.stderr.write(f"\r{text:<{self._width}}")
            sys.stderr.flush()
            self._width = len(text)

    def __enter__(self) -> Display:
        return self

    def __exit__(self, *_: object) -> None:
        if self._width:
            sys.stderr.write(f"\r{'':<{self._width}}\r")
