"""Resistive force theory by its published formulas, in numpy, as a check that shares no code with the package.

`agarwal2023`: Agarwal, Goldman & Kamrin, PNAS 120:e2214017120 (2023), with β, γ and ψ as angles. `li2013`: Li, Zhang &
Goldman, Science 339:1408 (2013), in the vertical plane of the motion. Both for loosely packed poppy seeds.
"""

from __future__ import annotations

from typing import Any

import numpy as np

#: The coefficients c_1k, c_2k, c_3k, in one row for each of the monomials 1, x1, x2, x3, x1², x2², x3², x1x2, x2x3,
#: x3x1, x1³, x2³, x3³, x1x2², x2x1², x2x3², x3x2², x3x1², x1x3², x1x2x3.
_TABLE = np.array(
    [
        [0.00212, -0.06796, -0.02634],
        [-0.02320, -0.10941, -0.03436],
        [-0.20890, 0.04725, 0.45256],
        [-0.43083, -0.06914, 0.00835],
        [-0.00259, -0.05835, 0.02553],
        [0.48872, -0.65880, -1.31290],
        [-0.00415, -0.11985, -0.05532],
        [0.07204, -0.25739, 0.06790],
        [-0.02750, -0.26834, -0.16404],
        [-0.08772, 0.02692, 0.02287],
        [0.01992, -0.00736, 0.02927],
        [-0.45961, 0.63758, 0.95406],
        [0.40799, 0.08997, -0.00131],
        [-0.10107, 0.21069, -0.11028],
        [-0.06576, 0.04748, 0.01487],
        [0.05664, 0.20406, -0.02730],
        [-0.09269, 0.18519, 0.10911],
        [0.01892, 0.04934, -0.04097],
        [0.01033, 0.13527, 0.07881],
        [0.15120, -0.33207, -0.27519],
    ]
)

#: N/m³: A00 A10 B11 B01 B-11, C11 C01 C-11 D10.
_LOOSE = 1e6 * np.array([0.051, 0.047, 0.053, 0.083, 0.020, -0.026, 0.057, 0.0, 0.025])


def agarwal2023(n: Any, v: Any) -> Any:
    """Stress per depth [N/m³] on plates with outward normals `n` and velocities `v`, [plates, 3] each."""
    u = v / np.linalg.norm(v, axis=1, keepdims=True)
    level = np.hypot(u[:, 0], u[:, 1])
    gamma = np.arctan2(-u[:, 2], level)
    safe = np.where(level > 1e-12, level, 1.0)
    r = np.where(level[:, None] > 1e-12, np.stack([u[:, 0], u[:, 1], 0 * level], 1) / safe[:, None], [1.0, 0.0, 0.0])
    theta = np.cross([0.0, 0.0, 1.0], r)
    lower = np.where(n[:, 2:] > 0, -n, n)
    beta = np.arccos(np.clip(-lower[:, 2], -1, 1))
    psi = np.arctan2((lower * theta).sum(1), (lower * r).sum(1))
    sb, cb, sg, cg, sp, cp = (f(x) for x in (beta, gamma, psi) for f in (np.sin, np.cos))
    x1, x2, x3 = sg, cb, cp * cg * sb + sg * cb
    one = np.ones_like(x1)
    terms = [one, x1, x2, x3, x1**2, x2**2, x3**2, x1 * x2, x2 * x3, x3 * x1, x1**3, x2**3, x3**3]
    terms += [x1 * x2**2, x2 * x1**2, x2 * x3**2, x3 * x2**2, x3 * x1**2, x1 * x3**2, x1 * x2 * x3]
    f1, f2, f3 = (np.stack(terms, 1) @ _TABLE).T
    along = (f1 * sb * cp + f2 * cg)[:, None] * r + (f1 * sb * sp)[:, None] * theta
    alpha = along + (-f1 * cb - f2 * sg - f3)[:, None] * np.array([0.0, 0.0, 1.0])
    normal = (alpha * n).sum(1, keepdims=True)
    return (alpha - normal * n - np.abs(normal) * n) * (_LOOSE[:5].sum() / 0.87574)


def li2013(n: Any, v: Any) -> Any:
    """The same by Li et al."""
    level = np.hypot(v[:, 0], v[:, 1])
    safe = np.where(level > 1e-12, level, 1.0)
    e = np.where(level[:, None] > 1e-12, np.stack([v[:, 0], v[:, 1], 0 * level], 1) / safe[:, None], [1.0, 0.0, 0.0])
    gamma = np.arctan2(-v[:, 2], level)
    # cos 2β and sin 2β of a plate that is inclined across the plane of motion, too.
    across = (n * e).sum(1)
    cos, sin = n[:, 2] ** 2 - across**2, -2 * n[:, 2] * across
    plus_sin, plus_cos = sin * np.cos(gamma) + cos * np.sin(gamma), cos * np.cos(gamma) - sin * np.sin(gamma)
    less_sin, less_cos = -sin * np.cos(gamma) + cos * np.sin(gamma), cos * np.cos(gamma) + sin * np.sin(gamma)
    a00, a10, b11, b01, bm11, c11, c01, cm11, d10 = _LOOSE
    z = a00 + a10 * cos + b11 * plus_sin + b01 * np.sin(gamma) + bm11 * less_sin
    x = c11 * plus_cos + c01 * np.cos(gamma) + cm11 * less_cos + d10 * sin
    return -x[:, None] * e + z[:, None] * np.array([0.0, 0.0, 1.0])


LAWS = {"agarwal2023": agarwal2023, "li2013": li2013}


def rotation(q: Any) -> Any:
    """Matrix of the quaternion (w, x, y, z)."""
    w, x, y, z = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def wrench(law: str, plates: dict[str, Any], p: Any, q: Any, v: Any, w: Any, flat: Any = False) -> tuple[Any, float]:
    """Force and torque about the origin on plates that push where they lead and are below z = 0, and the least |n·v̂|:
    near 0 a plate's force is a matter of definition. Those of `flat` faces rise to their full force at 0.02."""
    turn = rotation(q)
    arm = plates["center"] @ turn.T
    n = plates["normal"] @ turn.T
    speed = v + np.cross(w, arm)
    depth = -(p[2] + arm[:, 2])
    leads = (n * speed).sum(1) / np.linalg.norm(speed, axis=1)
    # Of a thin plate the side that leads counts.
    n = np.where((plates["thin"] & (leads < 0))[:, None], -n, n)
    pushes = (depth > 0) & ((leads >= 0) | plates["thin"])
    share = np.where(flat & ~plates["thin"], np.clip(leads / 0.02, 0, 1), 1.0)
    force = np.zeros_like(arm)
    if pushes.any():
        load = (depth * plates["area"] * share)[pushes, None]
        force[pushes] = LAWS[law](n[pushes], speed[pushes]) * load
    total = np.concatenate([force.sum(0), np.cross(arm, force).sum(0)])
    return total, float(np.abs(leads).min())
