"""Sand's forces on bodies of other simulators: against formulas of our own, and wrong use."""

from __future__ import annotations

import math
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rft
import sandgait
from sandgait.errors import InvalidRequest

LAWS = ["agarwal2023", "li2013"]


def cube(half: Any) -> Any:
    """Triangles of a box, counterclockwise seen from outside."""
    corner = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float) * half
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return np.array([corner[list(t)] for a, b, c, d in faces for t in ((a, b, c), (a, c, d))])


BODIES: dict[str, Any] = {
    "ball": "sphere:radius=0.03",
    "box": "box:length=0.08,width=0.05,height=0.03",
    "capsule": "capsule:radius=0.02,height=0.08",
    "roller": "cylinder:radius=0.03,height=0.05",
    "wheel": "cylinder:radius=0.05,width=0.03",
    "egg": "ellipsoid:length=0.1,width=0.06,height=0.05",
    "mesh": cube([0.05, 0.02, 0.03]),
    "hammer": ["box:length=0.1,width=0.02,height=0.02", ("sphere:radius=0.025", (0.05, 0, 0), (1, 0, 0, 0))],
}


def draw(random: Any, depth: float) -> tuple[Any, Any, Any, Any]:
    """A random pose with the origin about `depth` deep, and a velocity with some spin."""
    q = random.normal(size=4)
    p = np.array([random.uniform(-1, 1), random.uniform(-1, 1), -depth])
    return p, q / np.linalg.norm(q), random.normal(size=3) * 0.3, random.normal(size=3)


@pytest.mark.parametrize("law", LAWS)
def test_plates_have_the_published_force(law: str) -> None:
    """The same plates: equal to rounding where no plate moves along itself or crosses the surface, where the formulas
    leave open what part of it pushes. Thin plates and flat faces of solids, deep enough to be covered. `li2013` turns
    the horizontal direction of motion towards the normal by 1e-6 of the vertical speed, so that it exists for vertical
    motion, too."""
    exact = {"agarwal2023": 1e-9, "li2013": 1e-5}[law]
    random = np.random.default_rng(7)
    shapes = {
        "box": BODIES["box"],
        "mesh": BODIES["mesh"],
        "sheet": ("plate:length=0.1,width=0.03", (0.02, 0.01, 0.0), (0.8, 0.0, 0.6, 0.0)),
    }
    bodies = sandgait.Bodies(shapes, plate_size=0.005)
    sand = sandgait.Sand("poppy-loose", law=law, rest_speed=1e-9)  # the formulas have no regularised rest
    compared = 0
    for _ in range(300):
        p, q, v, w = draw(random, 0.2)
        f = sand.wrench(bodies, *(np.tile(x, (len(bodies), 1)) for x in (p, q, v, 0.1 * w)))
        for k, name in enumerate(bodies.names):
            expected, clear = rft.wrench(law, bodies.plates(name), p, q, v, 0.1 * w)
            if clear > 0.03:
                compared += 1
                assert np.abs(f[k] - expected).max() <= exact * np.abs(expected).max(), name
    assert compared > 300, compared


def flat(name: str, plates: dict[str, Any]) -> Any:
    """Plates of flat faces: those become a leading face as a whole."""
    axis = {"box": 2, "mesh": 2, "roller": 2, "wheel": 1}.get(name)
    if axis is None:
        return np.zeros(len(plates["area"]), bool)
    along = np.abs(plates["normal"][:, axis])
    return (along > 0.999) | (name in ("box", "mesh"))


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("name", [name for name in BODIES if name != "hammer"])
def test_default_plates_are_near_the_formulas(law: str, name: str) -> None:
    """Forces and torques against the formulas on fine plates, within 1 % (rms) and in every pose within 2 %: oblique,
    spinning, partly in the sand. If hardly any part of the body leads in the sand, a relative error says nothing: only
    forces above a tenth of the largest count. Torques are divided by the force and the body's size."""
    random = np.random.default_rng(sum(map(ord, law + name)))
    plates = sandgait.Bodies({name: BODIES[name]}, plate_size=0.0016).plates(name)
    usual = sandgait.Bodies({name: BODIES[name]})
    sand = sandgait.Sand("poppy-loose", law=law)
    size = np.linalg.norm(plates["center"], axis=1).max()
    errors = []
    for _ in range(200):
        q = random.normal(size=4)
        q /= np.linalg.norm(q)
        lowest = (plates["center"] @ rft.rotation(q).T)[:, 2].min()
        p = np.array([random.uniform(-1, 1), 0.3, -lowest - size * random.uniform(0.1, 1.0)])
        v = random.normal(size=3)
        v *= 0.3 / np.linalg.norm(v)
        w = random.normal(size=3)
        w *= random.uniform(-1, 1) / np.linalg.norm(w)
        expected, _ = rft.wrench(law, plates, p, q, v, w, flat(name, plates))
        found = sand.wrench(usual, p[None], q[None], v[None], w[None])[0]
        off = np.linalg.norm((found - expected).reshape(2, 3), axis=1)
        errors.append((np.linalg.norm(expected[:3]), *off))
    force, off, turned = np.array(errors).T
    large = force > 0.1 * force.max()
    relative, moment = off[large] / force[large], turned[large] / force[large] / size
    rms, turning = np.sqrt((relative**2).mean()), np.sqrt((moment**2).mean())
    print(f"{law} {name}: {large.sum()}, worst {relative.max():.4f} {moment.max():.4f}, rms {rms:.4f} {turning:.4f}")
    assert large.sum() > 40
    assert max(rms, turning) <= 0.01
    assert max(relative.max(), moment.max()) <= 0.02


@pytest.mark.parametrize("plate_size", [None, 0.005])
def test_drag_is_the_change_of_the_force_along_the_motion(plate_size: float | None) -> None:
    """From rest to the present motion ξ, −ξᵀ(f(ξ) − f(0)) = ξᵀDξ. Near rest, where the force rises linearly with the
    motion, also for small changes, if the body has no flat faces. D is symmetric and positive semidefinite."""
    random = np.random.default_rng(3)
    sand = sandgait.Sand("poppy-loose", law="li2013")
    bodies = sandgait.Bodies(BODIES, plate_size)
    round_ones = np.isin(bodies.names, ["ball", "egg", "capsule"])
    worst, near = 0.0, 0.0
    for k in range(60):
        p, q, v, w = (np.tile(x, (len(bodies), 1)) for x in draw(random, 0.05))
        # Motions at full speed, and others far below the speed of rest, 2e-6 m/s.
        scale = 1.0 if k % 2 == 0 else 1e-9
        xi = np.concatenate([v, w], 1) * scale
        f, drag = sand.wrench(bodies, p, q, v * scale, w * scale, drag=True)
        assert np.allclose(drag, drag.transpose(0, 2, 1), rtol=1e-12, atol=0.0)
        assert (np.linalg.eigvalsh(drag) >= -1e-9 * np.abs(drag).max()).all()
        still = sand.wrench(bodies, p, q, 0 * v, 0 * w)
        assert np.array_equal(still, 0 * still)
        lost = -(xi * (f - still)).sum(1)
        by_drag = np.einsum("bi,bij,bj->b", xi, drag, xi)
        if scale == 1.0:
            worst = max(worst, np.abs(by_drag / lost - 1).max())
        else:
            step = 1e-3
            more = sand.wrench(bodies, p, q, v * scale * (1 + step), w * scale * (1 + step))
            change = -(xi * (more - f)).sum(1) / step
            near = max(near, np.abs(by_drag / change - 1)[round_ones].max())
            assert (by_drag >= (1 - 1e-9) * lost).all()
    print("worst", worst, "near rest", near)
    assert worst <= 0.01
    assert near <= 0.01


def test_slopes_and_reliefs_are_turned_ground() -> None:
    """On a slope the force is that on level ground, turned with the world; a relief that is a plane is that slope."""
    angle = np.radians(20.0)
    turn = np.array([[np.cos(angle), 0, -np.sin(angle)], [0, 1, 0], [np.sin(angle), 0, np.cos(angle)]])
    tilt = np.array([np.cos(angle / 2), 0, -np.sin(angle / 2), 0])
    rows = np.tan(angle) * 0.1 * np.arange(40)
    relief = {"spacing": 0.1, "heights": np.tile(rows, (40, 1))}
    level, slope = sandgait.Sand(height=0.3), sandgait.Sand(slope_deg=20.0, height=0.3 / np.cos(angle))
    uneven = sandgait.Sand(relief=relief, height=0.3 / np.cos(angle))
    bodies = sandgait.Bodies({"box": BODIES["box"], "ball": BODIES["ball"]})
    for seed in range(20):
        p, q, v, w = draw(np.random.default_rng(seed), 0.02)
        p = np.array([2.0, 2.0, 0.28])
        w0, x0, y0, z0 = tilt
        w1, x1, y1, z1 = q
        turned = np.array(
            [
                w0 * w1 - x0 * x1 - y0 * y1 - z0 * z1,
                w0 * x1 + x0 * w1 + y0 * z1 - z0 * y1,
                w0 * y1 - x0 * z1 + y0 * w1 + z0 * x1,
                w0 * z1 + x0 * y1 - y0 * x1 + z0 * w1,
            ]
        )
        two = lambda x: np.tile(x, (2, 1))  # noqa: E731
        expected = level.wrench(bodies, two(p), two(q), two(v), two(w)).reshape(2, 2, 3) @ turn.T
        moved = [two(x) for x in (turn @ p, turned, turn @ v, turn @ w)]
        found = slope.wrench(bodies, *moved).reshape(2, 2, 3)
        assert np.abs(found - expected).max() <= 1e-9 * np.abs(expected).max()
        if 0.3 < (turn @ p)[0] < 3.5:
            found = uneven.wrench(bodies, *moved).reshape(2, 2, 3)
            assert np.abs(found - expected).max() <= 1e-4 * np.abs(expected).max()
    assert slope.surface(1.0, 5.0)[0] == pytest.approx(np.tan(angle) + 0.3 / np.cos(angle))
    assert uneven.surface(1.0, 1.0)[0] == pytest.approx(np.tan(angle) + 0.3 / np.cos(angle), abs=1e-6)


def many(kind: Any, states: int = 300) -> tuple[Any, ...]:
    random = np.random.default_rng(11)
    all = [draw(random, 0.02) for _ in range(states * len(BODIES))]
    return tuple(np.array(x, kind).reshape(states, len(BODIES), -1) for x in zip(*all, strict=True))


def test_bits_depend_on_the_own_state_only() -> None:
    """The same for any leading shape, number of threads, layout of the arrays, and for one state alone; float32 is
    within rounding of float64."""
    sand, bodies = sandgait.Sand(), sandgait.Bodies(BODIES)
    for kind in (np.float32, np.float64):
        arrays = many(kind)
        f, drag = sand.wrench(bodies, *arrays, drag=True)
        assert f.dtype == kind
        assert f.shape == (300, len(bodies), 6)
        for threads in (1, 2, 3):
            assert np.array_equal(f, sand.wrench(bodies, *arrays, threads=threads))
        folded = [a.reshape(3, 1, 100, len(bodies), -1) for a in arrays]
        assert np.array_equal(f.reshape(3, 1, 100, len(bodies), 6), sand.wrench(bodies, *folded))
        for i in (0, 17, 299):
            assert np.array_equal(f[i], sand.wrench(bodies, *(a[i] for a in arrays)))
        wide = np.zeros((300, len(bodies), 13), kind)
        views = [wide[..., 0:3], wide[..., 3:7], wide[..., 7:10], wide[..., 10:13]]
        for view, a in zip(views, arrays, strict=True):
            view[:] = a
        out, matrix = np.full_like(f, np.nan), np.full_like(drag, np.nan)
        answer = sand.wrench(bodies, *views, drag=True, out=(out, matrix))
        assert answer[0] is out
        assert np.array_equal(f, out)
        assert np.array_equal(drag, matrix)
        if kind == np.float32:
            single = f
    scale = np.abs(f).max()
    assert np.abs(single - f).max() <= 1e-4 * scale
    assert sand.wrench(bodies, *(a[:0] for a in arrays)).shape == (0, len(bodies), 6)


def test_tensors_are_read_in_place() -> None:
    import torch

    sand, bodies = sandgait.Sand(), sandgait.Bodies(BODIES)
    arrays = many(np.float32)
    tensors = [torch.from_numpy(a.copy()) for a in arrays]
    out = torch.zeros(300, len(bodies), 6)
    found = sand.wrench(bodies, *tensors, out=out)
    assert np.shares_memory(found, out.numpy())
    assert np.array_equal(out.numpy(), sand.wrench(bodies, *arrays))


def test_other_threads_run_meanwhile() -> None:
    sand, bodies = sandgait.Sand(), sandgait.Bodies(BODIES, plate_size=0.002)
    arrays = many(np.float64)
    ticks = [0]
    done = threading.Event()

    def count() -> None:
        while not done.wait(0.0):
            ticks[0] += 1

    counter = threading.Thread(target=count)
    counter.start()
    before = ticks[0]
    sand.wrench(bodies, *arrays, threads=1)
    during = ticks[0] - before
    done.set()
    counter.join()
    # A call that kept Python's lock would let the counter run for one switch interval at most.
    assert during > 1000, during


def test_sand_of_a_file(tmp_path: Path) -> None:
    """A sand.toml gives its law, mechanisms and terms; a mechanism that needs the vehicle's velocity says so."""
    text = """
name = "tried"
law = "li2013"
bulk_density = 638.0
source = "a test"
[coefficients]
a00 = 51e3
a10 = 47e3
b11 = 53e3
b01 = 83e3
bm11 = 20e3
c11 = -26e3
c01 = 57e3
cm11 = 0.0
d10 = 25e3
[mechanisms]
inertial_drag = 1.1
"""
    path = tmp_path / "sand.toml"
    path.write_text(text)
    bodies = sandgait.Bodies({"ball": "sphere:radius=0.03"}, plate_size=0.001)
    down = np.array([[0.0, 0.0, -0.03]]), np.array([[1.0, 0, 0, 0]]), np.array([[0.0, 0, -2.0]]), np.zeros((1, 3))
    inertial, plain = sandgait.Sand.from_toml(path), sandgait.Sand()
    assert (inertial.medium, inertial.law) == ("tried", "li2013")
    # λ ρ v² ∫ n_z³ dA over the lower half of the ball, which is in the sand: π r²/2.
    extra = inertial.wrench(bodies, *down)[0, 2] - plain.wrench(bodies, *down)[0, 2]
    assert extra == pytest.approx(1.1 * 638 * 2.0**2 * np.pi * 0.03**2 / 2, rel=0.02)
    path.write_text(text + "skid_loss = 1.0\n")
    skidding = sandgait.Sand.from_toml(path)
    with pytest.raises(InvalidRequest, match="travel: is missing: mechanism skid_loss"):
        skidding.wrench(bodies, *down)
    skidding.wrench(bodies, *down, travel=np.zeros(3))
    path.write_text(text + "footprint = 0.3\n")
    with pytest.warns(UserWarning, match="footprint has no effect"):
        sandgait.Sand.from_toml(path)


def good() -> list[Any]:
    return [np.zeros((2, 1, 3)), np.tile([1.0, 0, 0, 0], (2, 1, 1)), np.zeros((2, 1, 3)), np.zeros((2, 1, 3))]


def changed(index: int, place: Any, value: float) -> list[Any]:
    arrays = good()
    arrays[index][place] = value
    return arrays


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        (changed(0, (1, 0, 2), np.nan), 'position: of "ball" in state 1 is not finite'),
        (changed(3, (0, 0, 0), np.inf), 'angular_velocity: of "ball" in state 0 is not finite'),
        (changed(1, (1, 0, 0), 1.1), 'quaternion: of "ball" in state 1 has length 1.1000, not 1'),
        ([np.zeros((2, 2, 3)), *good()[1:]], "position: has shape (2, 2, 3), not (2, 1, 3)"),
        ([*good()[:1], np.zeros((2, 1, 3)), *good()[2:]], "quaternion: has shape (2, 1, 3), not (2, 1, 4)"),
        ([*good()[:3], np.zeros((3, 1, 3))], "angular_velocity: has shape (3, 1, 3), not (2, 1, 3)"),
        ([*good()[:2], np.zeros((2, 1, 3), np.float32), *good()[3:]], "velocity: is float32, but position is float64"),
        ([np.zeros((2, 1, 3), int), *good()[1:]], "position: is int64, not float32 or float64"),
    ],
)
def test_wrong_arrays(arrays: Any, message: str) -> None:
    sand, bodies = sandgait.Sand(), sandgait.Bodies({"ball": "sphere:radius=0.03"})
    with pytest.raises(InvalidRequest) as refused:
        sand.wrench(bodies, *arrays)
    assert message in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: sandgait.Sand("gravel"), "gravel"),
        (lambda: sandgait.Sand(law="coulomb"), "coulomb"),
        (lambda: sandgait.Sand(slope_deg=60.0), "slope_deg"),
        (lambda: sandgait.Sand(relief={"spacing": 0.1}), "relief: give spacing and heights"),
        (lambda: sandgait.Sand(relief={"seed": 1, "wavelength": 1.0, "slope_deg": 10}, slope_deg=5.0), "leave out"),
        (lambda: sandgait.Bodies({}), "bodies: there are none"),
        (lambda: sandgait.Bodies({"a": []}), '"a" has no shapes'),
        (lambda: sandgait.Bodies({"a": "sphere:size=1"}), "size"),
        (lambda: sandgait.Bodies({"a": "cone:radius=1"}), "cone"),
        (lambda: sandgait.Bodies({"a": cube(0.05)[:-1]}), 'mesh of body "a": the surface is not closed'),
        (lambda: sandgait.Bodies({"a": np.zeros((4, 3))}), "not [triangles, 3, 3]"),
        (lambda: sandgait.Bodies({"a": ("sphere:radius=0.1", (0, 0, 0), (1, 1, 0, 0))}), "no pose"),
        (lambda: sandgait.Bodies({"a": "mesh:nowhere.stl"}), "nowhere.stl"),
        (lambda: sandgait.Bodies({"a": "sphere:radius=0.1"}, plate_size=1e-4), "plates"),
        (lambda: sandgait.Bodies({"a": "plate:length=0.1,width=0.1"}, plate_size=1e-6), "plate_size: "),
        (lambda: sandgait.Bodies({"a": "plate:length=0.1,width=0.1"}, plate_size=-1.0), "plate_size: -1 is outside"),
        (lambda: sandgait.Bodies({"a": "face:length=0.1,width=0.1"}, plate_size=math.nan), "plate_size: NaN"),
        (lambda: sandgait.Bodies({"a": "plate:length=10,width=10"}, plate_size=1e-4), "are more than 20000"),
    ],
)
def test_wrong_sand_and_bodies(make: Any, message: str) -> None:
    with pytest.raises(sandgait.SandgaitError) as refused:
        make()
    assert message in str(refused.value)
    assert "\n" not in str(refused.value)


def test_out_must_fit() -> None:
    sand, bodies = sandgait.Sand(), sandgait.Bodies({"ball": "sphere:radius=0.03"})
    with pytest.raises(InvalidRequest, match="out: is float64"):
        sand.wrench(bodies, *good(), out=np.zeros((2, 6)))
    with pytest.raises(InvalidRequest, match="out: with drag=True a pair"):
        sand.wrench(bodies, *good(), drag=True, out=np.zeros((2, 1, 6)))
    locked = np.zeros((2, 1, 6))
    locked.flags.writeable = False
    with pytest.raises(InvalidRequest, match="may be written"):
        sand.wrench(bodies, *good(), out=locked)
