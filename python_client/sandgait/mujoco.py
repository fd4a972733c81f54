"""Sand in MuJoCo models: `add_sand`. Needs `sandgait[mujoco]`.

A step with sand is M q̈ = τ + Jᵀ(f − dt C J q̈): f is the sand's force on the bodies at the beginning of the step and
C its drag. So the acting force is that at the end of the step, f − C (v⁺ − v). Between `mj_step1` and `mj_step2`, Jᵀf
is added to the passive forces and dt JᵀCJ to the inertia matrix M. M has entries wherever JᵀCJ has some, because only
the joints between a body and the root move the body. MuJoCo factorises the sum, and the constraints use the sum, too.
The sand's drag is an inertia without weight and without momentum.
"""

from __future__ import annotations

import weakref
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from . import _native, user_warnings
from .arguments import checked
from .errors import InvalidRequest
from .mujoco_floor import (
    SAND_COLOUR,
    body_name,
    collide,
    compare_floors,
    find_floors,
    number_of,
    replace_floor,
    restore_options,
    saved_options,
)
from .sand import Sand, Shape, shapes

try:
    import mujoco
except ImportError as error:
    raise ImportError("mujoco is not installed: pip install 'sandgait[mujoco]'") from error

Array = npt.NDArray[np.float64]

#: Colour of forces: our choice.
FORCE_COLOUR = (0.85, 0.2, 0.1, 1.0)
#: Length of the arrow of a force that carries the model's weight, as a share of the model's extent: our choice.
_ARROW = 0.5
#: Least cosine between a force and the surface's normal for an arrow that begins at the surface: our choice.
_STEEP = 0.3
#: Lines along a side of a drawn relief: our choice, few enough for the 1000 shapes of gymnasium's scenes.
_LINES = 13

_GEOM = mujoco.mjtGeom
#: MuJoCo's shapes by the names of `sandgait.Bodies`, with the factors on their sizes.
_SHAPES = {
    _GEOM.mjGEOM_SPHERE: ("sphere", (("radius", 0, 1.0),)),
    _GEOM.mjGEOM_CAPSULE: ("capsule", (("radius", 0, 1.0), ("height", 1, 2.0))),
    _GEOM.mjGEOM_CYLINDER: ("cylinder", (("radius", 0, 1.0), ("height", 1, 2.0))),
    _GEOM.mjGEOM_BOX: ("box", (("length", 0, 2.0), ("width", 1, 2.0), ("height", 2, 2.0))),
    _GEOM.mjGEOM_ELLIPSOID: ("ellipsoid", (("length", 0, 2.0), ("width", 1, 2.0), ("height", 2, 2.0))),
}

#: The sand of each model, by the model's address.
_MODELS: weakref.WeakValueDictionary[int, ModelSand] = weakref.WeakValueDictionary()


@checked
def add_sand(
    model: mujoco.MjModel,
    sand: Sand,
    bodies: Iterable[str] | Mapping[str, Shape | Iterable[Shape]] | None = None,
    *,
    plate_size: float | None = None,
    floor: Iterable[str] | None = None,
) -> ModelSand:
    """Puts `model` on `sand`. The result's `step(data)` takes the place of `mujoco.mj_step(model, data)`.

    `bodies`: names of the bodies that touch sand, with the shapes of their colliding geoms, or a dictionary of names
    and shapes in the bodies' frames (`sandgait.Bodies`). None: all bodies that move and collide with the floor. A
    mesh stands for itself if it is closed, otherwise its convex hull does. `plate_size`: see `sandgait.Bodies`.
    `floor`: names of the geoms that the sand replaces; None: all planes and height fields that face upward and do not
    move. Bodies on sand no longer collide with them. A warning names a floor that is not where the sand's surface is.

    The integrator RK4 becomes implicitfast: dry friction has no fourth order, and RK4 would evaluate the sand four
    times.
    """
    if not isinstance(model, mujoco.MjModel):
        raise InvalidRequest(f"model: is {type(model).__name__}, not mujoco.MjModel")
    if not hasattr(model, "M_rowadr"):
        raise InvalidRequest(f"mujoco: {mujoco.__version__} has two inertia matrices; sand needs 3.3.6 or later")
    if not isinstance(sand, Sand):
        raise InvalidRequest(f"sand: is {type(sand).__name__}, not sandgait.Sand")
    if model._address in _MODELS:
        raise InvalidRequest("model: has sand already; its `remove()` takes that away")
    return ModelSand(model, sand, bodies, plate_size, floor)


def sand_of(model: mujoco.MjModel) -> ModelSand | None:
    """The sand that `add_sand` has put below `model`."""
    return _MODELS.get(model._address)


class ModelSand:
    """Sand below a MuJoCo model; `add_sand` makes it."""

    def __init__(
        self,
        model: mujoco.MjModel,
        sand: Sand,
        bodies: Iterable[str] | Mapping[str, Shape | Iterable[Shape]] | None,
        plate_size: float | None,
        floor: Iterable[str] | None,
    ) -> None:
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        floors = find_floors(model, data, floor)
        parts = _parts(model, data, floors, bodies)
        #: The sand.
        self.sand = sand
        #: Names of the bodies on sand; bodies welded to another one count as that one.
        self.names = tuple(body_name(model, body) for body in parts)
        self._bodies = list(parts)
        last = [int(model.body_dofadr[b] + model.body_dofnum[b] - 1) for b in parts]
        roots = [int(model.body_rootid[b]) for b in parts]
        matrix = [model.dof_parentid, model.M_rowadr, model.M_rownnz, model.M_colind]
        self._shapes = {name: parts[body] for name, body in zip(self.names, parts, strict=True)}
        solids = shapes(self._shapes)
        self._native = _native.JointSand(
            sand._native, solids, plate_size, [self._bodies, roots, last], [x.tolist() for x in matrix]
        )
        self._roots = roots
        #: The model.
        self.model = model
        self._dual = model.opt.solver == mujoco.mjtSolver.mjSOL_PGS or model.opt.noslip_iterations > 0
        self._saved = saved_options(model)
        same, notes = compare_floors(model, data, floors, sand)
        user_warnings.warn(notes)
        self._drawn = replace_floor(model, floors, self._bodies, same)
        if model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4:
            model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        # A sleeping body keeps its part of M, which contains the drag of an earlier step.
        model.opt.enableflags &= ~int(getattr(mujoco.mjtEnableBit, "mjENBL_SLEEP", 0))
        if hasattr(mujoco.MjData, "iLD"):  # before MuJoCo 3.6 islands copy M before it has the drag
            model.opt.disableflags |= int(getattr(mujoco.mjtDisableBit, "mjDSBL_ISLAND", 0))
            model.opt.enableflags &= ~int(getattr(mujoco.mjtEnableBit, "mjENBL_ISLAND", 0))
        self._address = model._address
        _MODELS[self._address] = self

    def remove(self) -> None:
        """Takes the sand away: floor, solver's options and colours are as before."""
        if _MODELS.pop(self._address, None) is not None:
            restore_options(self.model, self._saved)

    def step(self, data: mujoco.MjData, nstep: int = 1) -> None:
        """`mujoco.mj_step` with sand."""
        for _ in range(nstep):
            mujoco.mj_step1(self.model, data)
            self.press(data)
            mujoco.mj_step2(self.model, data)

    def forward(self, data: mujoco.MjData) -> None:
        """`mujoco.mj_forward` with sand: accelerations and forces, without a step."""
        mujoco.mj_step1(self.model, data)
        self.press(data)
        mujoco.mj_fwdActuation(self.model, data)
        mujoco.mj_fwdAcceleration(self.model, data)
        mujoco.mj_fwdConstraint(self.model, data)
        mujoco.mj_sensorAcc(self.model, data)

    def press(self, data: mujoco.MjData) -> None:
        """Adds the sand's force to `data.qfrc_passive`, and its drag to `data.M`.

        For programs that call `mj_step1` and `mj_step2` themselves: once between the two.
        """
        model = self.model
        if self._native.add(_motion(data), model.opt.timestep, data.qfrc_passive, data.M):
            mujoco.mj_factorM(model, data)
            if self._dual:
                mujoco.mj_projectConstraint(model, data)

    def wrenches(self, data: mujoco.MjData) -> Array:
        """Force [N] and torque [N·m] about each body's origin in the last step, world axes: [bodies, 6]."""
        central = self._central(data)
        force, torque = central[:, 3:], central[:, :3]
        arm = data.subtree_com[self._roots] - data.xpos[self._bodies]
        return np.concatenate([force, torque + np.cross(arm, force)], axis=1)

    def add_contact_forces(self, data: mujoco.MjData) -> None:
        """Adds the sand's forces in the last step to `data.cfrc_ext`, in which MuJoCo has those of contacts."""
        data.cfrc_ext[self._bodies] += self._central(data)

    def draw(self, scene: mujoco.MjvScene, data: mujoco.MjData, *, forces: bool = True) -> None:
        """Adds the sand's surface, if it is not the plane of the model's floor, and arrows of its forces to a scene.

        Call it after `mjv_updateScene` or `Renderer.update_scene`.
        """
        for marker in self.markers(data, forces=forces):
            if scene.ngeom >= scene.maxgeom:
                return
            mujoco.mjv_initGeom(scene.geoms[scene.ngeom], **marker)
            scene.ngeom += 1

    def markers(self, data: mujoco.MjData, *, forces: bool = True) -> list[dict[str, Any]]:
        """What `draw` adds, each as keywords of `mjv_initGeom`."""
        model = self.model
        all = [] if self._drawn else self._surface(model, data)
        if not forces:
            return all
        weight = float(model.body_mass.sum()) * max(float(np.linalg.norm(model.opt.gravity)), 1e-9)
        for body, wrench in zip(self._bodies, self.wrenches(data), strict=True):
            force, torque = wrench[:3], wrench[3:]
            size = float(np.linalg.norm(force))
            if size > 1e-3 * weight:
                # A point at which the force alone has the same torque, moved along the force to the sand's surface.
                start = data.xpos[body] + np.cross(force, torque) / size**2
                height, normal = self.sand.surface(start[0], start[1])
                rising = float(normal @ force) / size
                if rising > _STEEP:
                    start = start - force / size * (normal[2] * (start[2] - height) / rising)
                length = _ARROW * model.stat.extent * size / weight
                thick = 0.01 * model.stat.extent
                all.append(_marker(_GEOM.mjGEOM_ARROW, (thick, thick, length), start, force / size, FORCE_COLOUR))
        return all

    def _central(self, data: mujoco.MjData) -> Array:
        out = np.empty((len(self._bodies), 6))
        self._native.wrenches(_motion(data), self.model.opt.timestep, data.qacc, out)
        return out

    def _surface(self, model: mujoco.MjModel, data: mujoco.MjData) -> list[dict[str, Any]]:
        """A plane, or lines along a relief, around the first body."""
        x, y = data.xpos[self._bodies[0]][:2]
        height, normal = self.sand.surface(x, y)
        extent = 2.0 * model.stat.extent
        if not self.sand._is_relief:
            return [_marker(_GEOM.mjGEOM_PLANE, (extent, extent, 0.1), (x, y, height), normal, SAND_COLOUR)]
        ticks = np.linspace(-extent, extent, _LINES)
        nodes = np.array([[(x + a, y + b, self.sand.surface(x + a, y + b)[0]) for a in ticks] for b in ticks])
        pairs = [*zip(nodes[:, :-1].reshape(-1, 3), nodes[:, 1:].reshape(-1, 3), strict=True)]
        pairs += zip(nodes[:-1].reshape(-1, 3), nodes[1:].reshape(-1, 3), strict=True)
        line = []
        for start, end in pairs:
            length = float(np.linalg.norm(end - start))
            line.append(_marker(_GEOM.mjGEOM_LINE, (2.0, 2.0, length), start, (end - start) / length, SAND_COLOUR))
        return line


def _motion(data: mujoco.MjData) -> tuple[Array, ...]:
    return data.xpos, data.xmat, data.cvel, data.subtree_com, data.cdof


def _parts(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    floors: list[int],
    bodies: Iterable[str] | Mapping[str, Any] | None,
) -> dict[int, list[Any]]:
    """Shapes of each body that moves by itself, in its frame. Bodies welded to a body are parts of it."""
    parts: dict[int, list[Any]] = {}
    if isinstance(bodies, Mapping):
        for name, own in bodies.items():
            body = number_of(model, mujoco.mjtObj.mjOBJ_BODY, name)
            for shape in own if isinstance(own, list) else [own]:
                solid, position, quaternion = shape if isinstance(shape, tuple) else (shape, (0, 0, 0), (1, 0, 0, 0))
                pose = _within(model, data, body, data.xpos[body], data.xmat[body])
                parts.setdefault(_mover(model, body), []).append((solid, *_after(pose, position, quaternion)))
        return parts
    chosen = None if bodies is None else {number_of(model, mujoco.mjtObj.mjOBJ_BODY, name) for name in bodies}
    for geom in range(model.ngeom):
        body = int(model.geom_bodyid[geom])
        moves = model.body_dofnum[model.body_weldid[body]] > 0
        named = moves if chosen is None else body in chosen
        meets = (
            any(collide(model, geom, f) for f in floors)
            if floors
            else model.geom_contype[geom] | model.geom_conaffinity[geom]
        )
        if named and meets:
            pose = _within(model, data, body, data.geom_xpos[geom], data.geom_xmat[geom])
            parts.setdefault(_mover(model, body), []).append((_solid(model, geom), *pose))
    if not parts:
        raise InvalidRequest("bodies: none of them moves and has geoms that collide with the floor")
    return parts


def _mover(model: mujoco.MjModel, body: int) -> int:
    mover = int(model.body_weldid[body])
    if model.body_dofnum[mover] == 0:
        what = "does not move" if mover == 0 else "is a mocap body: sand pushes only bodies with joints"
        raise InvalidRequest(f"bodies: {body_name(model, body)} {what}")
    return mover


def _within(
    model: mujoco.MjModel, data: mujoco.MjData, body: int, position: Array, rotation: Array
) -> tuple[Array, Array]:
    """A pose in the world as a pose in the body that carries `body`."""
    carrier = model.body_weldid[body]
    turn = data.xmat[carrier].reshape(3, 3)
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, (turn.T @ rotation.reshape(3, 3)).ravel())
    return turn.T @ (position - data.xpos[carrier]), quaternion


def _after(pose: tuple[Array, Array], position: Any, quaternion: Any) -> tuple[Array, Array]:
    moved, turned = np.empty(3), np.empty(4)
    at, turn = np.asarray(position, np.float64), np.asarray(quaternion, np.float64)
    if at.shape != (3,) or turn.shape != (4,):
        raise InvalidRequest("bodies: a shape has no position (x, y, z) and quaternion (w, x, y, z)")
    mujoco.mju_mulPose(moved, turned, *pose, at, turn)
    return moved, turned


def _solid(model: mujoco.MjModel, geom: int) -> Any:
    kind = _GEOM(model.geom_type[geom])
    if kind in _SHAPES:
        name, sizes = _SHAPES[kind]
        lengths = ",".join(f"{key}={float(model.geom_size[geom][k]) * factor!r}" for key, k, factor in sizes)
        return f"{name}:{lengths}"
    if kind != _GEOM.mjGEOM_MESH:
        called = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_GEOM, geom) or geom
        raise InvalidRequest(f"geom {called}: sand has no shape for {kind.name}; give `bodies` with shapes")
    mesh = model.geom_dataid[geom]
    vertices = model.mesh_vert[model.mesh_vertadr[mesh] :][: model.mesh_vertnum[mesh]]
    faces = model.mesh_face[model.mesh_faceadr[mesh] :][: model.mesh_facenum[mesh]]
    surface = _native.closed_surface(vertices[faces].astype(np.float64).tolist())
    if surface is None:
        called = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_MESH, mesh)
        raise InvalidRequest(f"mesh {called}: is flat, it has no volume")
    return np.array(surface[0])


def _marker(kind: mujoco.mjtGeom, size: Any, position: Any, axis: Any, colour: Any) -> dict[str, Any]:
    """A shape whose z axis points along the unit vector `axis`."""
    quaternion, matrix = np.empty(4), np.empty(9)
    mujoco.mju_quatZ2Vec(quaternion, np.asarray(axis, np.float64))
    mujoco.mju_quat2Mat(matrix, quaternion)
    place = np.asarray(position, np.float64)
    return {"type": kind, "size": np.array(size), "pos": place, "mat": matrix, "rgba": np.array(colour, np.float32)}
