"""Sand's forces on rigid bodies that another simulator moves.

sand = sandgait.Sand("poppy-loose", law="agarwal2023")
bodies = sandgait.Bodies({"foot": "sphere:radius=0.02", "shank": "mesh:shank.stl"})
wrench = sand.wrench(bodies, position, quaternion, velocity, angular_velocity)
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from . import _native
from .arguments import checked, numbers, shown
from .errors import InvalidRequest, WrongType
from .user_warnings import warn

Array = npt.NDArray[Any]
#: A shape: its name (`"sphere:radius=0.02"`), the triangles of a closed mesh [triangles, 3, 3] in metres, or one of
#: these with its position [m] and quaternion (w, x, y, z) in the body's frame.
Shape = str | Array | tuple[str | Array, Sequence[float], Sequence[float]]

_ARGUMENTS = (("position", 3), ("quaternion", 4), ("velocity", 3), ("angular_velocity", 3))
_SINGLE, _DOUBLE = np.dtype(np.float32), np.dtype(np.float64)
#: Processors that this process may use.
_PROCESSORS = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Sand:
    """Sand below a surface, in a world whose z points up.

    `medium` and `law` as for the tasks; see `sandgait media`. The surface is the plane at `height` [m], inclined by
    `slope_deg` so that it rises towards +x, or a field of heights: `relief={"spacing": m, "heights": rows along y}`
    or `{"seed": n, "wavelength": m, "slope_deg": degrees}` for dunes. `rest_speed` [m/s] and `leading_edge_gate`
    regularise the law, see docs/physics.md.
    """

    @checked
    def __init__(
        self,
        medium: str = "poppy-loose",
        *,
        law: str = "li2013",
        height: float = 0.0,
        slope_deg: float = 0.0,
        relief: Mapping[str, Any] | None = None,
        rest_speed: float = 2e-6,
        leading_edge_gate: float | None = None,
    ) -> None:
        options = (float(height), float(slope_deg), _relief(relief), rest_speed, leading_edge_gate)
        self._is_relief = relief is not None
        self._made(_native.Sand(medium, law, None, *options))

    @classmethod
    @checked
    def from_toml(
        cls,
        path: str | Path,
        *,
        height: float = 0.0,
        slope_deg: float = 0.0,
        relief: Mapping[str, Any] | None = None,
        rest_speed: float = 2e-6,
        leading_edge_gate: float | None = None,
    ) -> Sand:
        """The sand of a `sand.toml`, with its law, mechanisms and terms; for example from a diagnosis."""
        options = (float(height), float(slope_deg), _relief(relief), rest_speed, leading_edge_gate)
        new = cls.__new__(cls)
        new._is_relief = relief is not None
        new._made(_native.Sand("", "", Path(path), *options))
        return new

    def _made(self, native: _native.Sand) -> None:
        self._native = native
        name, law, without_effect = native.about()
        #: Name of the medium.
        self.medium: str = name
        #: Name of the force law.
        self.law: str = law
        for mechanism in without_effect:
            warn([f"mechanism {mechanism} has no effect on single bodies"])

    def __repr__(self) -> str:
        return f"Sand({self.medium!r}, law={self.law!r})"

    @checked
    def surface(self, x: float, y: float) -> tuple[float, Array]:
        """Height of the surface [m] at a place, and its upward unit normal."""
        height, normal = self._native.at(float(x), float(y))
        return height, np.array(normal)

    def wrench(
        self,
        bodies: Bodies,
        position: Any,
        quaternion: Any,
        velocity: Any,
        angular_velocity: Any,
        *,
        drag: bool = False,
        travel: Any = None,
        out: Any = None,
        threads: int = 0,
    ) -> Any:
        """Force [N] of the sand on each body, and torque [N·m] about the body's origin, in the world's axes.

        `position` [m], `velocity` of the bodies' origins [m/s] and `angular_velocity` in the world's axes [rad/s] are
        [..., bodies, 3], `quaternion` (w, x, y, z) is [..., bodies, 4]. All are float32 or all float64: numpy's arrays,
        or anything with `__dlpack__` in the processor's memory. They are read in place if their rows are contiguous.
        Returns [..., bodies, 6] of the same type.

        With `drag=True` returns (wrench, drag). `drag`, [..., bodies, 6, 6], is symmetric and positive semidefinite:
        −∂wrench/∂(velocity, angular velocity) as the secant from rest. An integrator that uses
        wrench − drag · (change of the velocities in the step) is stable at any step, and keeps a body at rest.

        `travel` [..., 3]: velocity of the vehicle that the bodies belong to, for mechanisms that depend on it. `out`:
        an array for the result, or with `drag=True` a pair of arrays. `threads`: the most to use; 0: all processors.

        Arrays of float64 are computed in float64; arrays of float32 have a state in each SIMD lane. Other Python
        threads run meanwhile.
        """
        if not isinstance(bodies, Bodies):
            raise WrongType(f"bodies: expected sandgait.Bodies, got {shown(bodies)}")
        count = len(bodies.names)
        arrays = [position, quaternion, velocity, angular_velocity]
        kind, leading, states = _motion(arrays, count)
        vehicle = None
        if travel is not None:
            vehicle = _array("travel", travel)
            if vehicle.shape != (*leading, 3) or vehicle.dtype != kind:
                raise InvalidRequest(f"travel: is {vehicle.dtype} {vehicle.shape}, not {kind} {(*leading, 3)}")
            vehicle = _rows(vehicle.reshape(states, 1, 3))
        shape = (*leading, count, 6)
        if not drag:
            wrench = np.empty(shape, kind) if out is None else _out(out, shape, kind)
            resistance = None
        elif out is None:
            wrench, resistance = np.empty(shape, kind), np.empty((*shape, 6), kind)
        else:
            if not isinstance(out, tuple | list) or len(out) != 2:
                raise InvalidRequest("out: with drag=True a pair of arrays, for the wrench and the drag")
            wrench, resistance = _out(out[0], shape, kind), _out(out[1], (*shape, 6), kind)
        if states:
            double = kind == _DOUBLE
            bodies._native.wrench(self._native, arrays, vehicle, wrench, resistance, double, threads or _PROCESSORS)
        return wrench if resistance is None else (wrench, resistance)


def implicit_wrench(wrench: Any, drag: Any, jacobian: Any, mass: Any, force: Any, dt: float) -> Array:
    """The sand's wrench on each body at the end of a step, for simulators that take external forces but no drag.

    It solves (M + dt JᵀCJ) q̈ = τ + Jᵀf and returns f − dt C J q̈. `wrench` f [..., bodies, 6] and `drag` C
    [..., bodies, 6, 6] are those of `Sand.wrench`; `jacobian` J [..., bodies, 6, dofs] maps generalized velocities to
    (velocity, angular velocity) of the bodies' origins; `mass` M [..., dofs, dofs]; `force` τ [..., dofs]: all other
    generalized forces, those of gravity and of velocities included; `dt`: the time step [s].
    """
    f, c, j = np.asarray(wrench), np.asarray(drag), np.asarray(jacobian)
    resisting = dt * np.einsum("...bij,...bjn->...bin", c, j)
    inertia = mass + np.einsum("...bim,...bin->...mn", j, resisting)
    acceleration = np.linalg.solve(inertia, (force + np.einsum("...bin,...bi->...n", j, f))[..., None])[..., 0]
    return np.asarray(f - np.einsum("...bin,...n->...bi", resisting, acceleration))


class Bodies:
    """Rigid bodies cut into the plates that sand pushes on.

    `bodies` maps names to shapes, or lists of shapes. Lengths are along x, widths along y, heights along z:
    `sphere:radius=M`, `box:length=M,width=M,height=M`, `capsule:radius=M,height=M` (height of the cylinder),
    `cylinder:radius=M,height=M`, `cylinder:radius=M,width=M` (a wheel, axis along y),
    `ellipsoid:length=M,width=M,height=M`, `plate:length=M,width=M` (thin, sand on both faces),
    `face:length=M,width=M` (the same, sand on the face towards +z only), `mesh:FILE` (closed, STL or OBJ, in metres).

    `plate_size` [m]: size of the plates. The law is then evaluated for each plate by itself, as in `sandgait intrude`.
    Without `plate_size` a shape has 256 plates, or up to 512 if it is curved, and the law is evaluated for patches of
    plates. The code for this is that of the engine for robots from files, which itself uses fewer plates.
    docs/wrench.md has the errors.
    """

    @checked
    def __init__(self, bodies: Mapping[str, Shape | Iterable[Shape]], plate_size: float | None = None) -> None:
        #: Names, in the order of the arrays' rows.
        self.names: tuple[str, ...] = tuple(bodies)
        self._native = _native.Bodies(shapes(bodies), plate_size)

    def __len__(self) -> int:
        return len(self.names)

    def __repr__(self) -> str:
        return f"Bodies({', '.join(self.names)})"

    @checked
    def plates(self, name: str) -> dict[str, Array]:
        """The plates of a body, in its frame.

        `center` [plates, 3] in metres, outward unit `normal` [plates, 3], `area` [plates] in m², and `thin` [plates],
        true where sand acts on both faces.
        """
        if name not in self.names:
            raise InvalidRequest(f"body: {name!r} is not one of {', '.join(self.names)}")
        rows = self._native.plates(self.names.index(name))
        center, normal, area, thin = zip(*rows, strict=True)
        return {"center": np.array(center), "normal": np.array(normal), "area": np.array(area), "thin": np.array(thin)}


def shapes(bodies: Mapping[str, Shape | Iterable[Shape]]) -> list[tuple[str, list[tuple[Any, Any, Any]]]]:
    """Names and shapes, as the native module takes them."""
    if not isinstance(bodies, Mapping):
        raise InvalidRequest("bodies: is no dictionary of names and shapes")
    return [(str(name), [_shape(name, one) for one in _listed(parts)]) for name, parts in bodies.items()]


def _listed(parts: Any) -> Iterable[Any]:
    return parts if isinstance(parts, list) else [parts]


def _shape(name: str, shape: Any) -> tuple[Any, Any, Any]:
    solid, position, quaternion = (
        shape if isinstance(shape, tuple) and len(shape) == 3 else (shape, (0, 0, 0), (1, 0, 0, 0))
    )
    if not isinstance(solid, str):
        triangles = numbers(f"bodies: the mesh of {name!r}", solid, np.float64)
        if triangles.ndim != 3 or triangles.shape[1:] != (3, 3):
            raise InvalidRequest(f"bodies: the mesh of {name!r} has shape {triangles.shape}, not [triangles, 3, 3]")
        solid = triangles.tolist()
    pose = [numbers(f"bodies: the pose of {name!r}", part, np.float64) for part in (position, quaternion)]
    if [p.shape for p in pose] != [(3,), (4,)]:
        raise InvalidRequest(f"bodies: a shape of {name!r} has no position (x, y, z) and quaternion (w, x, y, z)")
    return solid, pose[0].tolist(), pose[1].tolist()


def _relief(relief: Mapping[str, Any] | None) -> Any:
    if relief is None:
        return None
    try:
        if set(relief) == {"spacing", "heights"}:
            return float(relief["spacing"]), numbers("relief", relief["heights"], np.float64).tolist()
        if set(relief) == {"seed", "wavelength", "slope_deg"}:
            return int(relief["seed"]), float(relief["wavelength"]), float(relief["slope_deg"])
    except (TypeError, ValueError) as error:
        raise InvalidRequest(str(error) if isinstance(error, InvalidRequest) else f"relief: {error}") from None
    raise InvalidRequest("relief: give spacing and heights, or seed, wavelength and slope_deg")


def _motion(arrays: list[Any], count: int) -> tuple[np.dtype[Any], tuple[int, ...], int]:
    """Checks position, quaternion and velocities of `count` bodies, and makes each an array [states, bodies, 3 or 4].

    Returns their type, the leading dimensions, and the number of states.
    """
    first = arrays[0] = _array("position", arrays[0])
    kind, leading = first.dtype, first.shape[:-2]
    if kind != _DOUBLE and kind != _SINGLE:
        raise InvalidRequest(f"position: is {kind}, not float32 or float64")
    states = math.prod(leading)
    for i, (name, width) in enumerate(_ARGUMENTS):
        array = arrays[i]
        if type(array) is not np.ndarray:
            array = _array(name, array)
        if array.dtype != kind:
            raise InvalidRequest(f"{name}: is {array.dtype}, but position is {kind}")
        if array.shape != (*leading, count, width):
            wanted = ", ".join(map(str, (*leading, count, width)))
            raise InvalidRequest(f"{name}: has shape {array.shape}, not ({wanted}): [..., bodies, {width}]")
        ways = array.ndim
        if ways != 3:
            array = array[None] if ways == 2 else array.reshape(states, count, width)
        arrays[i] = array if array.flags.carray else _rows(array)
    return kind, leading, states


def _array(name: str, array: Any) -> Array:
    if isinstance(array, np.ndarray):
        return array
    if hasattr(array, "__dlpack__"):
        try:
            return np.from_dlpack(array)
        except (BufferError, RuntimeError, TypeError, ValueError) as error:
            raise InvalidRequest(f"{name}: numpy cannot read it in place: {error}") from error
    return numbers(name, array, np.float64)


def _rows(array: Array) -> Array:
    """`array` with contiguous rows. It is copied only if its rows are not contiguous."""
    if array.strides[-1] != array.itemsize or min(array.strides) < 0 or not array.flags.aligned:
        return np.ascontiguousarray(array)
    return array


def _out(out: Any, shape: tuple[int, ...], kind: Any) -> Array:
    array = _array("out", out)
    if array.shape != shape or array.dtype != kind:
        raise InvalidRequest(f"out: is {array.dtype} {array.shape}, not {kind} {shape}")
    if not array.flags.c_contiguous or not array.flags.writeable:
        raise InvalidRequest("out: is not a contiguous array that may be written")
    return array
