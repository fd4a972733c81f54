"""Results as columns of numpy arrays with units. pandas and matplotlib are imported only when they are needed."""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from . import notebook

Numbers = npt.NDArray[np.float64]


class Table(Mapping[str, npt.NDArray[Any]]):
    """Columns of equal length by name. `units[name]` is SI, "1" for dimensionless numbers, "" for names."""

    def __init__(self, columns: Mapping[str, npt.NDArray[Any]], units: Mapping[str, str]) -> None:
        self._columns = dict(columns)
        self.units = dict(units)

    def __getitem__(self, name: str) -> npt.NDArray[Any]:
        return self._columns[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def __len__(self) -> int:
        """Number of columns."""
        return len(self._columns)

    def __repr__(self) -> str:
        rows = len(next(iter(self._columns.values()), []))
        return f"<{type(self).__name__}: {rows} rows of {', '.join(self.label(name) for name in self)}>"

    def _repr_html_(self) -> str:
        return notebook.table([self.label(name) for name in self], list(self.values()))

    def label(self, name: str) -> str:
        """The label of an axis: name and unit, for example `Fx [N]`."""
        unit = self.units[name]
        return name if unit in ("", "1") else f"{name} [{unit}]"

    def to_frame(self) -> Any:
        """A pandas DataFrame with these columns; `frame.attrs["units"]` has the units. Needs `sandgait[plot]`."""
        frame = optional("pandas").DataFrame(self._columns)
        frame.attrs["units"] = dict(self.units)
        return frame


def optional(module: str) -> Any:
    """Imports a module that is needed only for tables and plots."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise ImportError(f"tables and plots need {module}: pip install 'sandgait[plot]'") from error


def new_axes(axes: Any, rows: int = 1, columns: int = 1, size: tuple[float, float] = (6.4, 4.0)) -> Any:
    """`axes` if they are given, else the axes of a new matplotlib figure of `size` [inch]."""
    if axes is not None:
        return axes
    return optional("matplotlib.pyplot").subplots(rows, columns, figsize=size, layout="constrained")[1]
