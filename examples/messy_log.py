"""Simulated force logs that have all errors of a laboratory together, for messy_study.py.

The generator is written from the equations in docs/physics.md and shares no code with sandgait. Every log has these
errors: an offset and a drift in each channel of each trial, a bed whose strength scatters, a wrong height of the
surface, grain noise along the path, sensor noise, a load cell of finite resolution, and wrong coefficients. Some logs
have further errors, by chance: one channel is filtered, trials start from rest, samples are uneven or at a fixed rate,
or Ty is missing. In careless logs (`rough`) intruders, load cell and days differ, too. It needs numpy.
"""

import math
from typing import Any

import numpy as np

Array = np.ndarray[Any, Any]

TABLE = np.array([0.051, 0.047, 0.053, 0.083, 0.020, -0.026, 0.057, 0.0, 0.025]) * 1e6  # poppy-loose [N/m³]
DENSITY = 640.0
CHORD, WIDTH, PLATE = 0.076, 0.025, 0.038
XI = {"L": math.pi / 4, "revL": -math.pi / 4, "flat": 0.0}
HEADER = (
    "trial,condition,rep,kind,shape,medium,hip_z,plate_beta,plate_gamma,"
    "pass,pass_dx,x_bed,t,theta,omega,x,z,vx,vz,Fx,Fz,Ty"
)
FILTER = 0.005  # time constant of the filter that a channel may have [s]
FINE = 500  # times of a trial at which the force is computed; filters use the force at these times

EXPERIMENT = """kind = "intrusion"
medium = "poppy-loose"
bulk_density = 640.0
coefficient_sd = 0.08
[shape.L]
type = "leg"
chord = 0.076
width = 0.025
xi_deg = 45.0
[shape.revL]
type = "leg"
chord = 0.076
width = 0.025
xi_deg = -45.0
[shape.flat]
type = "leg"
chord = 0.076
width = 0.025
xi_deg = 0.0
[shape.plate]
type = "plate"
length = 0.038
width = 0.025
"""


def segments(shape: str, pieces: int = 16) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Centres, tilts and areas of panels at Gauss-Legendre points; and for each panel: does it belong to the chord?"""
    nodes, weights = np.polynomial.legendre.leggauss(pieces)
    if shape == "plate":
        ends = [((-PLATE / 2, 0.0), (PLATE / 2, 0.0), False)]
    else:
        xi, tip = XI[shape], (0.0, -CHORD)
        knee = (CHORD * math.cos(xi) * math.sin(xi), -CHORD * math.cos(xi) ** 2)
        ends = [((0.0, 0.0), tip, True)]
        ends += [((0.0, 0.0), tip, False)] if xi == 0 else [((0.0, 0.0), knee, False), (knee, tip, False)]
    centres, tilts, areas, chord = [], [], [], []
    for start, end, whole in ends:
        a, b = np.array(start), np.array(end)
        length = np.hypot(*(b - a))
        centres.append(a + np.outer((nodes + 1) / 2, b - a))
        tilts.append(np.full(pieces, math.atan2(b[1] - a[1], b[0] - a[0])))
        areas.append(weights / 2 * length * WIDTH)
        chord.append(np.full(pieces, whole))
    return np.concatenate(centres), np.concatenate(tilts), np.concatenate(areas), np.concatenate(chord)


def law(
    hidden: dict[str, float],
    c: np.ndarray,
    trial: dict[str, Any],
    p: Array,
    tilt: Array,
    v: Array,
    dv: Array,
    zero: float,
    bed: float,
) -> Array:
    """Stress on panels: positions p, velocities v and accelerations dv are (..., 2)."""
    sigma = hidden.get("slope", 0.0)
    depth = (p[..., 0] * math.tan(sigma) - (p[..., 1] - zero)) * math.cos(sigma)
    speed = np.hypot(v[..., 0], v[..., 1])
    gamma = -(np.arctan2(v[..., 1], v[..., 0]) - sigma)
    beta = tilt - sigma
    mirrored = np.cos(gamma) < 0
    gamma, beta = np.where(mirrored, math.pi - gamma, gamma), np.where(mirrored, -beta, beta)
    az = c[0] + c[1] * np.cos(2 * beta) + c[2] * np.sin(2 * beta + gamma) + c[3] * np.sin(gamma)
    az = az + c[4] * np.sin(gamma - 2 * beta)
    ax = (
        c[5] * np.cos(2 * beta + gamma)
        + c[6] * np.cos(gamma)
        + c[7] * np.cos(gamma - 2 * beta)
        + c[8] * np.sin(2 * beta)
    )
    n = np.stack([np.sin(tilt), -np.cos(tilt)], axis=-1)
    vn = (n * v).sum(-1)
    n = np.where((vn < 0)[..., None], -n, n)
    vn, dvn = np.abs(vn), (n * dv).sum(-1)
    under = np.maximum(depth, 0.0)
    grown = 0.02 * (under / 0.02) ** (1 + hidden.get("depth_power", 0.0))
    factor = (1 + hidden.get("scale", 0.0)) * (1 + hidden.get("packing_grad", 0.0) * (trial["x_bed"] + p[..., 0]) / 0.1)
    factor = factor * (1 + hidden.get("rate_log", 0.0) * np.log1p(speed / 0.01)) * bed
    if trial["pass"] > 1:
        factor = factor * (1 - hidden.get("footprint", 0.0) * math.exp(-trial["pass_dx"] / 0.03))
    factor = factor * outside(hidden, trial["x_bed"] + p[..., 0], p[..., 1], p[..., 0] + p[..., 1], under)
    local = np.stack([np.where(mirrored, ax, -ax), az], axis=-1) * (grown * factor)[..., None]
    turn = np.array([[math.cos(sigma), -math.sin(sigma)], [math.sin(sigma), math.cos(sigma)]])
    stress = local @ turn.T
    clip = hidden.get("friction_clip", 0.0)
    if clip > 0:
        normal = (stress * n).sum(-1)
        along = stress - normal[..., None] * n
        size = np.linalg.norm(along, axis=-1)
        share = np.minimum(np.abs(normal) / clip / np.maximum(size, 1e-12), 1.0)
        stress = normal[..., None] * n + share[..., None] * along
    push = hidden.get("inertial_drag", 0.0) * DENSITY * vn**2 + hidden.get("cohesion", 0.0) * np.tanh(vn / 1e-3)
    push = push + hidden.get("added_mass", 0.0) * DENSITY * WIDTH * dvn
    if "law" in hidden:  # a law outside of the catalogue: coefficient · ρ g |z| · Fr^a · (|z|/w)^b
        under = np.maximum(under, 1e-9)  # above the surface the depth is negative, and its powers are not defined
        froude = vn**2 / (9.81 * under)
        push = push + hidden["law"] * DENSITY * 9.81 * under * froude ** hidden["a"] * (under / WIDTH) ** hidden["b"]
    return np.asarray((stress - push[..., None] * n) * (depth > 0)[..., None])


def outside(hidden: dict[str, float], x: Array, z: Array, along: Array, depth: Array) -> Array:
    """Forces of causes that are not in the catalogue: a wall, a crust, stick and slip, a buried stone."""
    factor = 1 + hidden.get("wall", 0.0) * np.exp(-np.maximum(0.12 - x, 0.0) / 0.04)
    factor = factor * np.where(depth < 0.012, 1 + hidden.get("crust", 0.0), 1.0)
    factor = factor * (1 + hidden.get("stick_slip", 0.0) * np.sin(2 * math.pi * along / 0.02))
    stone = np.exp(-(((x - 0.03) / 0.015) ** 2) - ((z + 0.02) / 0.012) ** 2)
    return np.asarray(factor * (1 + hidden.get("buried_stone", 0.0) * stone))


def path(trial: dict[str, Any], t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position, speed and acceleration along a path. The speed has ramps at both ends and three waves between them."""
    duration, ramp, wave = trial["duration"], trial["ramp"], trial["wave"]
    grid = np.linspace(0.0, duration, 4 * FINE)
    share = grid / duration
    rise = np.ones_like(share) if ramp == 0 else np.clip(np.minimum(share, 1 - share) / ramp, 0, 1)
    speed = rise * (1 - wave * np.cos(6 * math.pi * share))
    way = np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 2 * np.diff(grid))])
    scale = trial["way"] / way[-1]
    change = np.gradient(speed, grid)
    return tuple(scale * np.interp(t, grid, a) for a in (way, speed, change))


def motion(trial: dict[str, Any], t: Array) -> tuple[Array, Array, Array]:
    s, rate, change = path(trial, t)
    if trial["kind"] == "leg":
        return trial["sign"] * (s - trial["way"] / 2), trial["sign"] * rate, trial["sign"] * change
    along = np.array([math.cos(trial["gamma"]), -math.sin(trial["gamma"])])
    start = np.array([-0.5 * trial["way"] * along[0], -trial["start"]])
    return start + np.outer(s, along), np.outer(rate, along), np.outer(change, along)


def loads(trial: dict[str, Any], t: Array, hidden: dict[str, float], c: Array, zero: float, bed: float) -> Array:
    """Fx, Fz and Ty at the times t. The intruder may have another size and attitude than the log says."""
    centres, tilts, areas, chord = segments(trial["shape"])
    long, wide = trial.get("size", (1.0, 1.0))
    centres, areas = centres * long, areas * long * wide
    where, rate, change = motion(trial, t)
    if trial["kind"] == "leg":
        where = where + trial.get("turned", 0.0)
        cos, sin = np.cos(where)[:, None], np.sin(where)[:, None]
        r = np.stack([centres[:, 0] * cos - centres[:, 1] * sin, centres[:, 0] * sin + centres[:, 1] * cos], axis=-1)
        v = np.stack([-rate[:, None] * r[..., 1], rate[:, None] * r[..., 0]], axis=-1)
        dv = np.stack([-change[:, None] * r[..., 1], change[:, None] * r[..., 0]], axis=-1)
        tilt, p = tilts + where[:, None], r + np.array([0.0, trial["hip"]])
        concave = XI[trial["shape"]] * trial["sign"] < 0
        chi = hidden.get("concave_fill", 0.0) if concave else 0.0
        weight = np.where(chord, chi, 1 - chi)
    else:
        b = trial["beta"] + trial.get("turned", 0.0)
        r = centres @ np.array([[math.cos(b), math.sin(b)], [-math.sin(b), math.cos(b)]])
        r = np.broadcast_to(r, (len(t), *r.shape))
        p, tilt = r + where[:, None, :], np.full(r.shape[:2], b)
        v, dv = np.broadcast_to(rate[:, None, :], r.shape), np.broadcast_to(change[:, None, :], r.shape)
        weight = np.ones(len(areas))
    f = law(hidden, c, trial, p, tilt, v, dv, zero, bed) * (areas * weight)[:, None]
    torque = (r[..., 0] * f[..., 1] - r[..., 1] * f[..., 0]).sum(1)
    return np.column_stack([f.sum(1), torque])


def design(rng: np.random.Generator, rig: dict[str, Any]) -> list[dict[str, Any]]:
    trials = []
    places = rng.permutation(np.linspace(-0.1, 0.1, 24))
    for k in range(16):
        rate = math.exp(rng.uniform(math.log(0.2), math.log(18.0))) if k > 3 else [0.2, 18.0, 3.0, 10.0][k]
        trial = {
            "kind": "leg",
            "shape": ["L", "revL", "flat", "L", "revL"][k % 5],
            "hip": rng.choice([0.02, 0.03, 0.045]),
        }
        trials.append({**trial, "sign": 1, "way": 3.5, "speed": rate})
    plates = [(0, 90), (0, 90), (45, 45), (-45, 45), (90, 0), (90, 0), (30, -60), (60, 30)]
    for beta, gamma in plates:
        rate = math.exp(rng.uniform(math.log(0.01), math.log(1.2)))
        start = 0.03 if gamma == 0 else 0.055 if gamma < 0 else 0.0
        trial = {"kind": "plate", "shape": "plate", "beta": math.radians(beta), "gamma": math.radians(gamma)}
        trials.append({**trial, "start": start, "way": 0.05, "speed": rate})
    for k, trial in enumerate(trials):
        again = rng.random() < 0.35
        trial |= {
            "x_bed": places[k],
            "pass": 2 if again else 1,
            "pass_dx": rng.choice([0.0, 0.02, 0.04]) if again else 0.0,
        }
        trial |= {"wave": rng.choice([0.0, 0.4]), "ramp": rig["ramp"]}
        trial["duration"] = trial["way"] / trial["speed"] * (1 + trial["ramp"])
    return trials


def times(rng: np.random.Generator, trial: dict[str, Any], sampling: str) -> np.ndarray:
    duration = trial["duration"]
    if sampling == "rate":
        step = max(1 / 200, duration / 119)
        return np.arange(rng.uniform(0, 0.3) * step if trial["ramp"] == 0 else 0.0, duration, step)
    even = np.linspace(0.0, duration, 60) if trial["ramp"] > 0 else (np.arange(60) + 0.5) / 60 * duration
    if sampling == "jitter":
        moved = even + rng.uniform(-0.35, 0.35, 60) * duration / 60
        moved[[0, -1]] = even[[0, -1]]
        return np.asarray(np.clip(moved, 0.0, duration))
    return even


def rough(rng: np.random.Generator, rig: dict[str, Any], trials: list[dict[str, Any]]) -> None:
    """Errors of a careless laboratory in sizes, mounting and gains, about as large as a diagnosis expects by default.
    Beds differ more than usual, and the log was made on one to three days, each with sand that was prepared anew."""
    sizes = {shape: tuple(1 + 0.014 * rng.standard_normal(2)) for shape in [*XI, "plate"]}
    turned = {True: 0.02 * rng.standard_normal(), False: math.radians(1.2) * rng.standard_normal()}
    for trial in trials:
        trial |= {"size": sizes[trial["shape"]], "turned": turned[trial["kind"] == "leg"]}
    rig |= {"bed": rng.uniform(0.02, 0.1), "gain": 1 + 0.014 * rng.standard_normal(3)}
    rig |= {"days": 1 + 0.02 * rng.standard_normal(rng.integers(1, 4))}


def strength(trials: list[dict[str, Any]], hidden: dict[str, float], c: Array) -> float:
    """Force of this sand over that of the stated sand: the geometric mean over conditions."""
    ratios = []
    for trial in trials:
        t = np.linspace(0.0, trial["duration"], 60)
        bare = {k: v for k, v in trial.items() if k not in ("size", "turned")}
        own, stated = (loads(bare, t, h, k, 0.0, 1.0)[:, :2] for h, k in ((hidden, c), ({}, TABLE)))
        ratios.append((own * stated).sum() / (stated * stated).sum())
    return float(np.exp(np.mean(np.log(ratios))))


def log(seed: int, hidden: dict[str, float], careful: bool = True) -> tuple[str, dict[str, Any]]:
    rng = np.random.default_rng(seed)
    rig: dict[str, Any] = {
        "offset": rng.uniform(0.03, 0.08),
        "drift": rng.uniform(0.02, 0.06),
        "zero": 3e-4,
        "bed": 0.03,
        "ramp": rng.choice([0.0, 0.05, 0.07, 0.1]),
        "sampling": rng.choice(["even", "jitter", "rate"]),
        "filter": rng.choice(["", "", "Fx", "Fz"]),
        "torque": bool(rng.random() < 0.7),
    }
    error = rng.standard_normal(9) * 0.04
    c = TABLE * (1 + error)
    c[7] += 0.04 * TABLE[8] * rng.standard_normal()
    lines, trials = [HEADER], design(rng, rig)
    rig |= {"gain": np.ones(3), "days": np.ones(1), "strength": strength(trials, hidden, c)}
    if not careful:
        rough(rng, rig, trials)
    for condition, trial in enumerate(trials):
        day = rig["days"][condition * len(rig["days"]) // len(trials)]
        for rep in range(3):
            t = times(rng, trial, rig["sampling"])
            zero = float(np.clip(rng.normal(0, rig["zero"]), -2 * rig["zero"], 2 * rig["zero"]))
            bed = day * (1 + rig["bed"] * rng.standard_normal())
            grid = t
            if rig["filter"] and trial["duration"] < 3.0:  # a filter of 5 ms is negligible in slower trials
                grid = np.linspace(0.0, trial["duration"], FINE)
            clean = loads(trial, grid, hidden, c, zero, bed)
            if len(grid) == FINE:
                share = (grid[1] - grid[0]) / FILTER  # exact if the force is linear between the times
                keep = math.exp(-share)
                end = 1 - (1 - keep) / share
                channel = ["Fx", "Fz"].index(rig["filter"])
                state = 0.0 if trial["ramp"] > 0 else clean[0, channel]
                clean[0] = 0.0 if trial["ramp"] > 0 else clean[0]
                force = clean[:, channel].copy()
                clean[0, channel] = state
                for i in range(1, FINE):
                    state = keep * state + (1 - keep - end) * force[i - 1] + end * force[i]
                    clean[i, channel] = state
            f = np.column_stack([np.interp(t, grid, clean[:, k]) for k in range(3)]) * rig["gain"]
            way, _, _ = path(trial, t)
            if trial["ramp"] > 0:
                f[0] = 0.0  # before the motion the sand exerts no force
            size = np.hypot(f[:, 0], f[:, 1])
            for k, arm in enumerate([1.0, 1.0, 0.05]):
                grain = rng.standard_normal()
                for i in range(len(t)):
                    phi = 0.7 ** ((way[i] - way[i - 1]) / trial["way"] * 60) if i else 0.0
                    grain = phi * grain + math.sqrt(1 - phi * phi) * rng.standard_normal()
                    f[i, k] += arm * 0.04 * size[i] * grain
                dirt = (
                    rig["offset"] * rng.standard_normal() + rig["drift"] * rng.standard_normal() * t / trial["duration"]
                )
                f[:, k] += arm * (dirt + 0.03 * rng.standard_normal(len(t)))
                f[:, k] = np.round(f[:, k] / (0.01 * arm)) * 0.01 * arm
            where, rates, _ = motion(trial, t)
            head = f"{condition}_{rep},{condition},{rep},{trial['kind']},{trial['shape']},poppy-loose"
            tail = f"{trial['pass']},{trial['pass_dx']},{trial['x_bed']:.4f}"
            for i in range(len(t)):
                torque = f"{f[i, 2]:.6g}" if rig["torque"] else ""
                if trial["kind"] == "leg":
                    place = f"{trial['hip']},,,{tail},{t[i]:.6g},{where[i]:.6g},{rates[i]:.6g},,,,"
                else:
                    place = f",{trial['beta']:.6g},{trial['gamma']:.6g},{tail},{t[i]:.6g},,,"
                    place += f"{where[i, 0]:.6g},{where[i, 1]:.6g},{rates[i, 0]:.6g},{rates[i, 1]:.6g}"
                lines.append(f"{head},{place},{f[i, 0]:.6g},{f[i, 1]:.6g},{torque}")
    return "\n".join(lines) + "\n", rig
