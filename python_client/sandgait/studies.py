"""Studies that need no environment: forces on a leg, walks, sweeps over designs.

They are the functions of the commands `sandgait intrude`, `walk` and `sweep`, with the same names, defaults and
results. `address`: a running server that computes the study; by default this process computes it. Ctrl-C stops a study.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Mapping
from os import PathLike
from pathlib import Path
from typing import Any, overload

import numpy as np
import numpy.typing as npt

from .arguments import checked, numbers, shown
from .door import study
from .errors import InvalidRequest, unknown
from .tables import Numbers, Table, new_axes
from .user_warnings import warn

FilePath = str | PathLike[str]

#: True shows the progress as a line on the terminal or in the notebook. A function is called with the finished share
#: and the stage.
ProgressOption = bool | Callable[[float, str], None]


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
        parameters: tuple[str, ...],
        measure: str,
    ) -> None:
        super().__init__(columns, units)
        #: Names of the varied parameters, in order.
        self.parameters = parameters
        #: The measure that `best` and `plot` use: speed or cost-of-transport.
        self.measure = measure

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
        column, _, _, sign = _MEASURES[_measure(measure or self.measure)]
        values = sign * self[column]
        if column == "cost_of_transport":
            values = np.where(self.speed > 0.0, values, np.inf)
        index = int(np.argmin(np.where(np.isfinite(values), values, np.inf)))
        return {name: self[name][index].item() for name in self}

    def plot(self, measure: str | None = None, axes: Any = None) -> Any:
        """Plots the measure on matplotlib `axes`: a heat map over two numerical parameters, or else lines over the last
        parameter, one line for each value of the first. Returns the axes. Needs `sandgait[plot]`.
        """
        column, factor, label, _ = _MEASURES[_measure(measure or self.measure)]
        if len(self.parameters) > 2:
            raise InvalidRequest(f"plot: {len(self.parameters)} parameters were searched; a figure shows one or two")
        axes = new_axes(axes)
        values = factor * self[column]
        *families, along = self.parameters
        x = self[along]
        if not families:
            axes.plot(x, values, "o-", markersize=3)
        elif self[families[0]].dtype.kind == "f" and x.dtype.kind == "f":
            rows, across = np.unique(self[families[0]]), np.unique(x)
            grid = np.full((len(rows), len(across)), np.nan)
            grid[np.searchsorted(rows, self[families[0]]), np.searchsorted(across, x)] = values
            mesh = axes.pcolormesh(across, rows, grid, cmap="viridis", shading="nearest")
            axes.figure.colorbar(mesh, ax=axes, label=label)
        else:
            for name in dict.fromkeys(self[families[0]].tolist()):
                chosen = self[families[0]] == name
                axes.plot(x[chosen], values[chosen], "o-", markersize=3, label=f"{families[0]} = {name}")
            axes.legend()
        heat = bool(axes.collections)
        axes.set_xlabel(self.label(along))
        axes.set_ylabel(self.label(families[0]) if heat else label)
        return axes


@overload
def intrude(
    shape: str,
    chord: float = 0.076,
    width: float = 0.025,
    hip_height: float = 0.02,
    omega: float = 0.2,
    medium: str | None = None,
    law: str | None = None,
    sand: FilePath | None = None,
    address: str | None = None,
) -> Intrusion: ...


@overload
def intrude(
    *,
    body: FilePath,
    rows: Mapping[str, npt.ArrayLike],
    mu_s: float | None = None,
    plate_size: float | None = None,
    medium: str | None = None,
    law: str | None = None,
    sand: FilePath | None = None,
    address: str | None = None,
    progress: ProgressOption = False,
) -> Trials: ...


@checked
def intrude(
    shape: str | None = None,
    chord: float = 0.076,
    width: float = 0.025,
    hip_height: float = 0.02,
    omega: float = 0.2,
    medium: str | None = None,
    law: str | None = None,
    sand: FilePath | None = None,
    address: str | None = None,
    *,
    body: FilePath | None = None,
    rows: Mapping[str, npt.ArrayLike] | None = None,
    mu_s: float | None = None,
    plate_size: float | None = None,
    progress: ProgressOption = False,
) -> Intrusion | Trials:
    """Computes the forces of sand on a rotating leg, or on any body that moves with constant velocity.

    Without `body` a leg of shape `shape` rotates about a hip that is fixed above the sand. The result has force and
    torque for angles from −1.75 to 1.75 rad. `shape`: L, revL, C, revC, flat or xi=DEGREES. `chord`: distance from hip
    to tip [m]. `width`: width of the leg [m]. `hip_height`: height of the hip above the surface [m]. `omega`: angular
    speed [rad/s]; with a negative one the tip moves backward.

    With `body` and `rows` the result has forces and torques, one row for each motion. `body`: cylinder:radius=M,width=M
    (axle along y), box:length=M,width=M,height=M, sphere:radius=M, or an STL or OBJ file [m]. `rows`: a mapping or a
    DataFrame with columns vx, vy, vz [m/s] and wx, wy, wz [rad/s] in the body's frame (x heading, y axle, z up; absent
    columns are 0), and depth [m] of the lowest point or load [N] that the sand carries. If there are both columns, one
    of them must be NaN in each row. A column may be a single number for all rows. `mu_s`: friction coefficient of the
    body's surface, instead of the sand's. `plate_size`: size of the plates into which the surface is cut [m]; by
    default a fiftieth of the body's longest side.

    `medium`: a name from `sandgait media`, zeta=VALUE or mu=VALUE,rho=VALUE; by default poppy-loose. `law`: li2013,
    penetration-drag-1d or agarwal2023; by default li2013. `sand`: a sand.toml, for example from a diagnosis, instead
    of medium and law.
    """
    if body is not None or rows is not None:
        if shape is not None or body is None or rows is None:
            raise InvalidRequest("intrude: give shape, or body with rows")
        request = _motions(rows) | {"sand": _sand(medium, law, sand), "friction": mu_s, "plate_size": plate_size}
        is_mesh = Path(body).suffix.lower() in (".stl", ".obj")
        request["shape"] = None if is_mesh else str(body)
        request["mesh"] = file(body, "body") if is_mesh else None
        with Display(progress) as told:
            reply = study(address, "Trials", request, told)
        arrays, units = columns(reply)
        lost = arrays.pop("no_equilibrium")
        arrays["status"], units["status"] = np.where(lost > 0.0, "no_equilibrium", "ok"), ""
        return Trials(arrays, {name: units[name] for name in arrays})
    if shape is None:
        raise InvalidRequest("intrude: give shape, or body with rows")
    request = {
        "shape": shape,
        "chord": chord,
        "width": width,
        "hip_height": hip_height,
        "omega": omega,
        "sand": _sand(medium, law, sand),
    }
    return Intrusion(*columns(study(address, "Intrude", request)))


@checked
def walk(
    frequency: float | npt.ArrayLike,
    leg: str | None = None,
    engine: str = "lanes",
    medium: str | None = None,
    law: str | None = None,
    sand: FilePath | None = None,
    slope_deg: float = 0.0,
    dt: float | None = None,
    robot: str = "xplorer",
    address: str | None = None,
    progress: ProgressOption = False,
) -> Walks:
    """Simulates a robot that walks with an alternating tripod at each stride frequency [Hz], and measures speed and
    work. At frequency 0 the robot stands for 10 s.

    `leg`: shape of the legs, L, revL, C, revC, flat or xi=DEGREES; by default the robot's own. `engine`: lanes or
    rapier. `medium`, `law`, `sand`: the same as for :func:`intrude`. `slope_deg`: slope of the surface [°]; a positive
    slope rises in the walking direction. `dt`: time step [s]; by default 0.001, or 0.0005 with rapier. `robot`: a
    built-in robot or a .toml file.
    """
    frequencies = np.atleast_1d(numbers("frequency", frequency, np.float64)).ravel()
    request = {
        "leg": leg,
        "frequency": frequencies.tolist(),
        "engine": engine,
        "sand": _sand(medium, law, sand),
        "slope_deg": slope_deg,
        "dt": dt,
        "robot": _robot(robot),
    }
    with Display(progress) as told:
        reply = study(address, "Walk", request, told)
    return Walks(*columns(reply))


@checked
def sweep(
    vary: Mapping[str, Iterable[float] | Iterable[str]],
    *,
    set: Mapping[str, float | str] | None = None,
    robot: str = "xplorer",
    frequency: float = 2.0,
    medium: str | None = None,
    law: str | None = None,
    sand: FilePath | None = None,
    measure: str = "speed",
    optimize: str | None = None,
    address: str | None = None,
    progress: ProgressOption = True,
) -> Sweep:
    """Simulates walks of a robot over a grid of one or two parameters, or searches for the best design.

    `vary`: the values of each varied parameter. `set`: the one value of each other parameter. Parameters: xi [°], leg,
    chord [m], width [m], leg_mass [kg], base_mass [kg], hip_height [m], belly [m], frequency [Hz], phase [rad], medium,
    zeta [N/cm³], law, slope [°], payload [kg], torque_limit [N·m], kp [N·m/rad]. `robot`, `medium`, `law`, `sand`: the
    same as for :func:`walk`. `frequency`: stride frequency [Hz]. `measure`: speed or cost-of-transport; `plot` and
    `best` use it. `optimize`: the measure of a search for the best design. The search replaces the grid, and stays
    between the least and the greatest value of each parameter.
    """
    request = {
        "vary": [_variation(name, values) for name, values in vary.items()],
        "set": [_variation(name, [value]) for name, value in (set or {}).items()],
        "robot": _robot(robot),
        "frequency": frequency,
        "sand": _sand(medium, law, sand),
        "optimize": optimize,
    }
    measure = _measure(optimize or measure)
    with Display(progress) as told:
        reply = study(address, "Sweep", request, told)
    arrays, units = columns(reply)
    return Sweep(arrays, units, tuple(arrays)[: len(vary)], measure)


def _measure(name: str) -> str:
    if name not in _MEASURES:
        raise unknown("measure", name, _MEASURES)
    return name


def file(path: FilePath, what: str) -> tuple[str, bytes]:
    """Name and content of a local file. The client reads it, because the server may be on another machine."""
    try:
        return str(path), Path(path).read_bytes()
    except (OSError, TypeError) as error:
        raise InvalidRequest(f"{what}: {path!r} cannot be read as a file: {error}") from error


_MOTION = ("vx", "vy", "vz", "wx", "wy", "wz", "depth", "load")


def _motions(rows: Mapping[str, npt.ArrayLike]) -> dict[str, Any]:
    """The columns of `rows` as bytes."""
    for name in rows:
        if name not in _MOTION:
            raise unknown("rows: column", name, _MOTION)
    absent = {"depth": np.nan, "load": np.nan}
    try:
        given = [np.asarray(rows.get(name, absent.get(name, 0.0)), dtype=np.float64) for name in _MOTION]
        full = np.broadcast_arrays(*(np.atleast_1d(column) for column in given))
    except (TypeError, ValueError) as error:
        raise InvalidRequest(f"rows: {error}") from error
    if full[0].ndim != 1:
        raise InvalidRequest("rows: each column must be a number or a one-dimensional array")
    groups = {"velocity": full[:3], "spin": full[3:6], "depth": full[6:7], "load": full[7:]}
    return {name: np.stack(group, axis=1).astype("<f8").tobytes() for name, group in groups.items()}


def _sand(medium: str | None, law: str | None, path: FilePath | None) -> dict[str, Any]:
    return {"medium": medium, "law": law, "file": None if path is None else file(path, "sand")}


def _robot(robot: str) -> dict[str, Any]:
    named = not robot.endswith(".toml")
    return {"name": robot if named else None, "file": None if named else file(robot, "robot")}


def _variation(name: str, values: Iterable[Any]) -> tuple[str, list[float], list[str]]:
    # the command line writes leg-mass for the column leg_mass
    parameter = name.replace("_", "-")
    try:
        listed = list(values)
        if all(isinstance(value, str) for value in listed):
            return parameter, [], listed
        return parameter, [float(value) for value in listed], []
    except (TypeError, ValueError) as error:
        raise InvalidRequest(f"{name}: {shown(values)} are neither all numbers nor all names") from error


def columns(
    table: tuple[list[tuple[str, str, Any]], list[str]],
) -> tuple[dict[str, npt.NDArray[Any]], dict[str, str]]:
    """The arrays and the units of a table, with names that are valid in Python."""
    series, told = table
    for warning in told:
        warn([warning])
    names = [name.replace("-", "_") for name, _, _ in series]
    arrays = {name: np.asarray(values) for name, (_, _, values) in zip(names, series, strict=True)}
    return arrays, {name: unit for name, (_, unit, _) in zip(names, series, strict=True)}


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
