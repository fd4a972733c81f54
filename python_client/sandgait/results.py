"""Results of studies as tables that can plot themselves."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from . import notebook
from .diagnosis import Diagnosis as Diagnosis
from .errors import InvalidRequest, unknown
from .tables import Numbers, Table, new_axes


class Intrusion(Table):
    """Forces on a leg that rotates through sand about a fixed hip; one row for each angle."""

    @property
    def theta(self) -> Numbers:
        """Angle of the leg [rad]: 0 if the tip is straight down, positive if it is forward (+x)."""
        return self["theta"]

    @property
    def Fx(self) -> Numbers:  # noqa: N802 - the field's symbol
        """Horizontal force on the leg [N], positive along +x."""
        return self["Fx"]

    @property
    def Fz(self) -> Numbers:  # noqa: N802
        """Vertical force on the leg [N], positive up."""
        return self["Fz"]

    @property
    def Ty(self) -> Numbers:  # noqa: N802
        """Torque x·Fz − z·Fx about the hip [N·m]."""
        return self["Ty"]

    def plot(self, axes: Any = None, label: str = "") -> Any:
        """Plots the forces over the leg's angle on matplotlib `axes`; returns the axes. Needs `sandgait[plot]`."""
        axes = new_axes(axes)
        for name, style in (("Fx", "-"), ("Fz", "--")):
            axes.plot(np.degrees(self.theta), self[name], style, label=f"{name} {label}".strip())
        axes.set_xlabel("leg angle θ [°], 0: tip straight down")
        axes.set_ylabel("force on the leg [N]")
        axes.axhline(0.0, color="0.7", linewidth=0.8, zorder=0)
        axes.legend()
        return axes


class Trials(Table):
    """Motions of a body through sand with constant velocity; one row for each motion. A row without equilibrium is NaN.

    Columns: Fx, Fy, Fz [N], Tx, Ty, Tz [N·m] about the body's origin, depth [m], status (ok or no_equilibrium).
    """

    @property
    def force(self) -> Numbers:
        """Fx, Fy, Fz on the body [N], an array of rows by 3."""
        return np.stack([self[name] for name in ("Fx", "Fy", "Fz")], axis=1)

    @property
    def torque(self) -> Numbers:
        """Tx, Ty, Tz about the body's origin [N·m], an array of rows by 3."""
        return np.stack([self[name] for name in ("Tx", "Ty", "Tz")], axis=1)

    @property
    def depth(self) -> Numbers:
        """Depth of the lowest point below the undisturbed surface [m]."""
        return self["depth"]

    @property
    def status(self) -> npt.NDArray[np.str_]:
        """ok, or no_equilibrium if the sand carries the load at no depth."""
        return self["status"]


class Walks(Table):
    """Walks at constant stride frequencies; one row for each frequency. Rows of walks that diverged are NaN.

    Columns: frequency [Hz], speed [m/s], base_height [m], pitch_rms [rad], hip_torque_rms [N·m], hip_speed_error_rms
    [rad/s], cost_of_transport, sink [m], drift [m].
    """

    @property
    def frequency(self) -> Numbers:
        """Turns of the hips in a second [Hz]."""
        return self["frequency"]

    @property
    def speed(self) -> Numbers:
        """Horizontal displacement over four strides, divided by their duration [m/s]; negative toward −x."""
        return self["speed"]

    @property
    def cost_of_transport(self) -> Numbers:
        """Work of the hips / (weight · distance); NaN if the robot stands."""
        return self["cost_of_transport"]

    def plot(self, axes: Any = None, label: str = "") -> Any:
        """Plots the speed over the stride frequency on matplotlib `axes`; returns the axes. Needs `sandgait[plot]`."""
        axes = new_axes(axes)
        order = np.argsort(self.frequency)
        axes.plot(self.frequency[order], 100.0 * self.speed[order], "o-", markersize=3, label=label or None)
        axes.set_xlabel("stride frequency [Hz]")
        axes.set_ylabel("forward speed [cm/s]")
        if label:
            axes.legend()
        return axes


#: For each measure: its column, the factor that gives the unit of the axis, the label of the axis, and a sign: −1 if
#: the best design has the greatest value, else 1.
_MEASURES = {
    "speed": ("speed", 100.0, "forward speed [cm/s]", -1.0),
    "cost-of-transport": ("cost_of_transport", 1.0, "cost of transport", 1.0),
}


class Sweep(Table):
    """Walks of a grid of designs, or of the best design that a search has found.

    The table has one row for each design; the last parameter varies fastest. Columns: the `parameters` in their units,
    then the columns of :class:`Walks` without the frequency.
    """

    def __init__(
        self,
        columns: Mapping[str, npt.NDArray[Any]],
        units: Mapping[str, str],
        measure: str,
        figure: str = "",
    ) -> None:
        super().__init__(columns, units)
        #: Names of the varied parameters, in order.
        self.parameters = tuple(columns)[: list(columns).index("speed")]
        #: The measure that `best` and `plot` use: speed or cost-of-transport.
        self.measure = measure
        #: The figure of a grid as SVG: a heat map over two numerical parameters. Notebooks show it.
        self.figure = figure

    def _repr_html_(self) -> str:
        if not self.figure:
            return super()._repr_html_()
        return notebook.drawing(self.figure, f"{self.measure} of {', '.join(self.parameters)}")

    @property
    def speed(self) -> Numbers:
        """Walking speed [m/s], as in :class:`Walks`."""
        return self["speed"]

    @property
    def cost_of_transport(self) -> Numbers:
        """Work of the hips / (weight · distance); NaN if the robot stands."""
        return self["cost_of_transport"]

    def best(self, measure: str | None = None) -> dict[str, Any]:
        """The row with the greatest speed or, among robots that walk forward, with the least cost of transport."""
        column, _, _, sign = _MEASURES[checked_measure(measure or self.measure)]
        values = sign * self[column]
        if column == "cost_of_transport":
            values = np.where(self.speed > 0.0, values, np.inf)
        index = int(np.argmin(np.where(np.isfinite(values), values, np.inf)))
        return {name: self[name][index].item() for name in self}

    def plot(self, measure: str | None = None, axes: Any = None) -> Any:
        """Plots the measure over the last parameter on matplotlib `axes`, one line for each value of the first. Returns
        the axes. Needs `sandgait[plot]`. A heat map over two numerical parameters is in `figure`.
        """
        column, factor, label, _ = _MEASURES[checked_measure(measure or self.measure)]
        if len(self.parameters) > 2:
            raise InvalidRequest(f"plot: {len(self.parameters)} parameters were searched; a figure shows one or two")
        axes = new_axes(axes)
        values = factor * self[column]
        *families, along = self.parameters
        x = self[along]
        if not families:
            axes.plot(x, values, "o-", markersize=3)
        else:
            for name in dict.fromkeys(self[families[0]].tolist()):
                chosen = self[families[0]] == name
                axes.plot(x[chosen], values[chosen], "o-", markersize=3, label=f"{families[0]} = {name}")
            axes.legend()
        axes.set_xlabel(self.label(along))
        axes.set_ylabel(label)
        return axes


class Evaluation(Table):
    """Evaluation of a gait; one row for each medium and slope. Undefined values are NaN.

    Columns: medium, slope_deg [°], rate [Hz] (only for "tripod": the best rate found), episodes, return, speed [m/s],
    speed_error [m/s], cost_of_transport, slip, falls and diverged. For each column X from return to falls, X_low and
    X_high are the ends of its 95 % interval. `docs/evaluate.md` defines the columns.

    A policy of LeggedVelocity has one row for each command: command_lin_vel_x, command_lin_vel_y [m/s],
    command_ang_vel_yaw [rad/s], the velocities lin_vel_x, lin_vel_y, ang_vel_yaw, error and falls.
    """

    @property
    def speed(self) -> Numbers:
        """Mean forward speed [m/s]."""
        return self["speed"]

    @property
    def cost_of_transport(self) -> Numbers:
        """Work of all episodes / (weight · distance); NaN if the robot does not walk forward."""
        return self["cost_of_transport"]


def checked_measure(name: str) -> str:
    """`name`, if it is a measure of walks."""
    if name not in _MEASURES:
        raise unknown("measure", name, _MEASURES)
    return name


class StudyTables(NamedTuple):
    """The result of a study as it comes from the native module."""

    summary: str
    #: What the JSON form states beside the rows.
    about: str
    #: Name and columns of each table; a column has a name, a unit and its values.
    tables: list[tuple[str, list[tuple[str, str, Any]]]]
    files: dict[str, bytes]

    def columns(self, index: int = 0) -> tuple[dict[str, npt.NDArray[Any]], dict[str, str]]:
        """Arrays and units of a table, with names that are valid in Python."""
        series = [(name.replace("-", "_"), unit, np.asarray(values)) for name, unit, values in self.tables[index][1]]
        return {name: values for name, _, values in series}, {name: unit for name, unit, _ in series}


def _sweep(result: StudyTables) -> Sweep:
    about = json.loads(result.about)
    figure = result.files.get("sweep.svg", b"").decode()
    return Sweep(*result.columns(), about.get("optimize") or about["measure"], figure)


def _diagnosis(result: StudyTables) -> Diagnosis:
    report, page, sand, hardware = (
        result.files[name].decode() for name in ("report.json", "report.html", "sand.toml", "hardware.toml")
    )
    return Diagnosis(report, page, sand, hardware, Table(*result.columns()))


#: The class of a result by the name of its first table. Any other result is a plain table.
_CLASSES: dict[str, Callable[[StudyTables], Any]] = {
    "walks": lambda result: Walks(*result.columns()),
    "intrusion": lambda result: Intrusion(*result.columns()),
    "trials": lambda result: Trials(*result.columns()),
    "sweep": _sweep,
    "optimum": _sweep,
    "evaluation": lambda result: Evaluation(*result.columns()),
    "commands": lambda result: Evaluation(*result.columns()),
    "curves": _diagnosis,
}


def result_of(result: StudyTables) -> Any:
    """The result as an object of its class."""
    made = _CLASSES.get(result.tables[0][0])
    return Table(*result.columns()) if made is None else made(result)
