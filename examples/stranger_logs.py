"""Force logs with an error model that is not the diagnosis's own, and the tally of what a diagnosis says of them.

Usage: stranger_logs.py SANDGAIT COUNT [FIRST]. Each log has intruders of sizes of its own, a sand of its own, and the mess of a
laboratory that the diagnosis's noise model does not have: multiplicative heavy-tailed noise (Student's t, 3 degrees of freedom) whose
size differs between conditions, tilted intruders, wrong sizes, wrong zeros, hysteresis of the load cell, a bed whose strength changes
along it, outliers, delays, clipped readings. A third of the logs hides nothing in the sand, a third one effect of the catalogue, a
sixth an effect outside of it, a sixth a sand of another strength. The program prints one line for each log, and a table.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

GENERIC = np.array([0.206, 0.169, 0.212, 0.358, 0.055, -0.124, 0.253, 0.007, 0.088]) * 1e6
NAMES = ["a00", "a10", "b11", "b01", "bm11", "c11", "c01", "cm11", "d10"]
PIECES = 31
COLUMNS = (
    "trial,condition,rep,kind,shape,medium,hip_z,plate_beta,plate_gamma,pass,pass_dx,x_bed,t,theta,omega,x,z,vx,vz,Fx,Fz,Ty"
)
SAND = {
    "inertial_drag": (0.5, 2.5),
    "cohesion": (150.0, 800.0),
    "depth_power": (0.15, 0.5),
    "slope": (0.05, 0.15),
    "rate_log": (0.05, 0.12),
    "packing_grad": (0.1, 0.3),
    "concave_fill": (0.3, 0.9),
}
OUTSIDE = ["bottom", "fatigue", "drag_1.3", "anisotropy"]


def pieces(shape: dict[str, float]) -> tuple[np.ndarray, np.ndarray, float]:
    """Centres and tilts of the pieces of an intruder at rest, and the area of a piece."""
    if "xi" in shape:
        chord, xi = shape["chord"], np.radians(shape["xi"])
        knee = np.array([chord * np.cos(xi) * np.sin(xi), -chord * np.cos(xi) ** 2])
        ends = [np.zeros(2), knee, np.array([0.0, -chord])] if xi else [np.zeros(2), np.array([0.0, -chord])]
        parts = list(zip(ends[:-1], ends[1:], strict=True))
    else:
        parts = [(np.array([-shape["length"] / 2, 0.0]), np.array([shape["length"] / 2, 0.0]))]
    u = ((np.arange(PIECES) + 0.5) / PIECES)[:, None]
    centres = np.concatenate([a + u * (b - a) for a, b in parts])
    tilts = np.concatenate([np.full(PIECES, np.arctan2(b[1] - a[1], b[0] - a[0])) for a, b in parts])
    lengths = np.concatenate([np.full(PIECES, np.hypot(*(b - a)) / PIECES) for a, b in parts])
    return centres, tilts, lengths * shape["width"]


def load(
    shape: dict[str, float], angle: float, place: np.ndarray, velocity: np.ndarray, spin: float, sand: dict[str, Any], way: float
) -> np.ndarray:
    """Fx, Fz and Ty about `place`."""
    own = dict(shape)
    total = np.zeros(3)
    chi = sand.get("concave_fill", 0.0) if own.get("xi", 0.0) * spin < 0 else 0.0
    for share, this in ((1 - chi, own), (chi, {**own, "xi": 0.0})):
        if share == 0:
            continue
        centres, tilts, area = pieces(this)
        c, s = np.cos(angle), np.sin(angle)
        r = np.stack([centres[:, 0] * c - centres[:, 1] * s, centres[:, 0] * s + centres[:, 1] * c], 1)
        v = velocity + spin * np.stack([-r[:, 1], r[:, 0]], 1)
        x, z = place[0] + r[:, 0], place[1] + r[:, 1]
        sigma = sand.get("slope", 0.0)
        depth = (x * np.tan(sigma) - z) * np.cos(sigma)
        speed = np.hypot(v[:, 0], v[:, 1]) + 1e-12
        gamma = -np.arctan2(v[:, 1], v[:, 0]) + sigma
        beta = tilts + angle - sigma
        back = np.cos(gamma) < 0
        gamma, beta = np.where(back, np.pi - gamma, gamma), np.where(back, -beta, beta)
        a00, a10, b11, b01, bm11, c11, c01, cm11, d10 = sand["table"]
        az = a00 + a10 * np.cos(2 * beta) + b11 * np.sin(2 * beta + gamma) + b01 * np.sin(gamma)
        az = az + bm11 * np.sin(gamma - 2 * beta)
        ax = c11 * np.cos(2 * beta + gamma) + c01 * np.cos(gamma) + cm11 * np.cos(gamma - 2 * beta) + d10 * np.sin(2 * beta)
        wet = depth > 0
        d = np.where(wet, depth, 0.0)
        felt = 0.02 * (d / 0.02) ** (1 + sand.get("depth_power", 0.0))
        factor = (1 + sand.get("packing_grad", 0.0) * (sand["x_bed"] + x) / 0.1) * (1 + sand["bed"] * (sand["x_bed"] + x) / 0.1)
        factor = factor * (1 + sand.get("rate_log", 0.0) * np.log1p(speed / 0.01))
        factor = factor * (1 + sand.get("bottom", 0.0) * np.exp(-(0.08 - d) / 0.02))
        factor = factor * (1 - sand.get("fatigue", 0.0) * (1 - np.exp(-way / 0.05)))
        factor = factor * np.where(back, 1 + sand.get("anisotropy", 0.0), 1.0)
        local = np.stack([np.where(back, ax, -ax), az], 1) * (felt * factor)[:, None]
        stress = np.stack(
            [local[:, 0] * np.cos(sigma) - local[:, 1] * np.sin(sigma), local[:, 0] * np.sin(sigma) + local[:, 1] * np.cos(sigma)], 1
        )
        n = np.stack([np.sin(tilts + angle), -np.cos(tilts + angle)], 1)
        vn = (v * n).sum(1)
        n, vn = np.where(vn[:, None] < 0, -n, n), np.abs(vn)
        press = sand.get("inertial_drag", 0.0) * sand["density"] * vn**2 + sand.get("cohesion", 0.0) * np.tanh(vn / 1e-3)
        press = press + sand.get("drag_1.3", 0.0) * sand["density"] * vn**1.3
        f = (stress - press[:, None] * n) * (area * wet)[:, None]
        total += share * np.array([f[:, 0].sum(), f[:, 1].sum(), (r[:, 0] * f[:, 1] - r[:, 1] * f[:, 0]).sum()])
    return total


def hide(rng: np.random.Generator, seed: int) -> dict[str, float]:
    kind = seed % 6
    if kind in (0, 3):
        return {}
    if kind in (1, 4):
        name = list(SAND)[(seed // 3) % len(SAND)]
        low, high = SAND[name]
        sign = rng.choice([-1, 1]) if name in ("slope", "packing_grad", "depth_power") else 1
        return {name: float(sign * low * (high / low) ** rng.uniform())}
    if kind == 2:
        name = OUTSIDE[(seed // 6) % len(OUTSIDE)]
        return {name: float({"bottom": 2.0, "fatigue": 0.6, "drag_1.3": 1.0, "anisotropy": 0.4}[name] * rng.uniform(0.5, 1.5))}
    return {"scale": float(rng.choice([-0.35, -0.25, 0.3, 0.5]))}


def log(seed: int) -> tuple[str, str, dict[str, float], dict[str, float]]:
    """Data, experiment, what is hidden, and the mess."""
    rng = np.random.default_rng(9000 + seed)
    hidden = hide(rng, seed)
    zeta, density = rng.uniform(0.2, 1.2), rng.uniform(600, 1600)
    stated = GENERIC * zeta
    table = stated * (1 + 0.03 * rng.standard_normal(9)) * (1 + hidden.get("scale", 0.0))
    shapes: dict[str, dict[str, float]] = {
        "P": {"length": rng.uniform(0.025, 0.05), "width": rng.uniform(0.02, 0.04)},
        "Q": {"length": rng.uniform(0.05, 0.07), "width": rng.uniform(0.02, 0.04)},
    }
    if seed % 4 != 3:
        chord, width = rng.uniform(0.06, 0.1), rng.uniform(0.02, 0.035)
        shapes |= {"L": {"chord": chord, "width": width, "xi": 45.0}, "R": {"chord": chord, "width": width, "xi": -45.0}}
    mess = {
        "tilt": float(rng.choice([0, 1]) * np.radians(2.0) * rng.standard_normal()),
        "size": float(0.01 * rng.standard_normal()),
        "depth": float(0.0015 * rng.standard_normal()),
        "delay": float(rng.choice([0.0, 0.0, 0.003])),
        "talk": float(0.015 * rng.standard_normal()),
        "hysteresis": float(rng.choice([0.0, 0.02])),
        "bed": float(0.02 * rng.standard_normal()),
        "grain": float(rng.uniform(0.02, 0.06)),
        "outliers": float(rng.choice([0.0, 0.003])),
    }
    rows = [COLUMNS]
    count = int(rng.integers(7, 13))
    for condition in range(count):
        name = list(shapes)[condition % len(shapes)]
        shape = shapes[name]
        leg = "xi" in shape
        rate = float(np.exp(rng.uniform(np.log(0.5), np.log(9.0)))) if leg else float(np.exp(rng.uniform(np.log(0.02), np.log(0.8))))
        hip = float(rng.uniform(0.2, 0.6) * shape.get("chord", 0.0))
        beta, gamma = [(0, 90), (90, 0), (45, 45), (-45, 45), (30, 60)][int(rng.integers(5))]
        beta, gamma = np.radians(beta), np.radians(gamma)
        start = 0.04 if gamma == 0 else 0.0
        x_bed = float(rng.uniform(-0.1, 0.1))
        loud = mess["grain"] * float(np.exp(0.4 * rng.standard_normal()))
        true = {k: v * (1 + mess["size"]) if k in ("length", "width", "chord") else v for k, v in shape.items()}
        sand = {**hidden, "table": table, "density": density, "x_bed": x_bed, "bed": mess["bed"]}
        duration = 3.2 / rate if leg else 0.05 / rate
        times = (np.arange(45) + 0.5) / 45 * duration

        def at(t: float) -> np.ndarray:
            if leg:
                return load(true, -1.6 + rate * t + mess["tilt"], np.array([0.0, hip - mess["depth"]]), np.zeros(2), rate, sand, rate * t * 0.05)
            along = np.array([np.cos(gamma), -np.sin(gamma)])
            place = along * rate * t + np.array([0.0, -start - mess["depth"]])
            return load(true, beta + mess["tilt"], place, along * rate, 0.0, sand, rate * t)

        clean = np.array([at(max(t - mess["delay"], 0.0)) for t in times])
        clean = clean @ np.array([[1, mess["talk"], 0], [mess["talk"], 1, 0], [0, 0, 1]])
        if mess["hysteresis"]:
            for k in range(1, 45):
                clean[k, :2] = clean[k, :2] + mess["hysteresis"] * (clean[k - 1, :2] - clean[k, :2])
        for rep in range(int(rng.choice([3, 3, 4]))):
            size = np.hypot(clean[:, 0], clean[:, 1])[:, None] * np.array([1, 1, 0.04])
            noise = np.zeros_like(clean)
            state = rng.standard_t(3, 3) / 1.7
            for k in range(45):
                noise[k] = state
                state = 0.8 * state + 0.6 * rng.standard_t(3, 3) / 1.7
            measured = clean * (1 + 0.03 * rng.standard_normal()) + loud * size * noise
            measured += 0.01 * np.abs(clean[:, :2]).max() * rng.standard_normal((45, 3)) * np.array([1, 1, 0.03])
            wild = rng.uniform(size=measured.shape) < mess["outliers"]
            measured = np.where(wild, measured * 1.8, measured)
            for k, t in enumerate(times):
                head = f"c{condition}r{rep},c{condition},{rep},"
                tail = f"1,0,{x_bed:.4f},{t:.6f}"
                if leg:
                    motion = f"leg,{name},,{hip:.5f},,,{tail},{-1.6 + rate * t:.7f},{rate:.6f},0,0,0,0"
                else:
                    p = np.array([np.cos(gamma), -np.sin(gamma)])
                    x, z = p * rate * t + np.array([0.0, -start])
                    motion = f"plate,{name},,,{beta:.7f},{gamma:.7f},{tail},,,{x:.7f},{z:.7f},{p[0] * rate:.7f},{p[1] * rate:.7f}"
                rows.append(head + motion + "," + ",".join(f"{v:.6g}" for v in measured[k]))
    toml = [f'kind = "intrusion"\nbulk_density = {density:.1f}\ncoefficient_sd = 0.08\n[sand]\nname = "mine"\n[sand.coefficients]']
    toml += [f"{n} = {v:.1f}" for n, v in zip(NAMES, stated, strict=True)]
    for name, shape in shapes.items():
        kind = "leg" if "xi" in shape else "plate"
        keys = {"xi": "xi_deg"}
        toml.append(f'[shape.{name}]\ntype = "{kind}"\n' + "\n".join(f"{keys.get(k, k)} = {v:.6f}" for k, v in shape.items()))
    return "\n".join(rows), "\n".join(toml), hidden, mess


def main() -> None:
    binary, count, first = sys.argv[1], int(sys.argv[2]), int(sys.argv[3]) if len(sys.argv) > 3 else 0
    tally: dict[str, dict[str, int]] = {}
    for seed in range(first, first + count):
        data, experiment, hidden, mess = log(seed)
        with tempfile.TemporaryDirectory() as folder:
            files = [Path(folder, name) for name in ("log.csv", "experiment.toml")]
            for path, text in zip(files, (data, experiment), strict=True):
                path.write_text(text)
            command = [binary, "diagnose", str(files[0]), "--experiment", str(files[1]), "--out", folder]
            made = subprocess.run(command, capture_output=True, text=True)
            if made.returncode:
                print(seed, "FAILED", made.stderr[-200:], flush=True)
                continue
            report = json.loads(Path(folder, "report.json").read_text())
        name = next(iter(hidden), "nothing")
        group = "nothing" if name == "nothing" else "strength" if name == "scale" else "outside" if name in OUTSIDE else "sand"
        sensor = ("bias_x", "bias_z", "sensor_tilt", "depth_zero", "delay", "lowpass", "compliance")
        sand = [c["id"] for c in report["causes"] if c.get("kind", "measurement" if c["id"] in sensor else "sand") == "sand"]
        named = report["verdict"] == "named"
        if named and sand:
            result = "right" if sand == [name] else "wrong name"
        elif report["verdict"] == "ambiguous" and sand:
            result = "in the set" if any(name in ids for ids in report["ambiguity_set"]) else "set without it"
        else:
            result = report["verdict"] if not named else "measurement"
        tally.setdefault(group, {}).setdefault(result, 0)
        tally[group][result] += 1
        causes = [(c["id"], round(c["value"], 4), [round(v, 4) for v in c["ci95"]]) for c in report["causes"]]
        gain = report["gain"]
        why = [w["why"] for w in report.get("withheld", [])]
        short = {k: round(v, 4) for k, v in (hidden | mess).items()}
        print(seed, name, result, report["verdict"], causes, gain["reduction"], gain["ci95"], why, short, flush=True)
    for group, results in tally.items():
        print(f"| {group} | " + ", ".join(f"{n} {what}" for what, n in sorted(results.items())) + " |")


if __name__ == "__main__":
    main()
