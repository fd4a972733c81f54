#!/usr/bin/env python3
"""A granular laboratory's force logs, from the contract and RFT alone. make.py SEED OUTDIR"""

import sys, os, json
import numpy as np

R = np.pi / 180
G = 9.81
CO = ["a00", "a10", "b11", "b01", "bm11", "c11", "c01", "cm11", "d10"]
GENERIC = np.array([0.206, 0.169, 0.212, 0.358, 0.055, -0.124, 0.253, 0.007, 0.088]) * 1e6
LOOSE = np.array([0.051, 0.047, 0.053, 0.083, 0.020, -0.026, 0.057, 0, 0.025]) * 1e6
CLOSE = np.array([0.094, 0.092, 0.092, 0.151, 0.035, -0.039, 0.086, 0.018, 0.046]) * 1e6


# ---------------------------------------------------------------- motion
class Motion:
    """Grid of a trial: legs theta(t), plates x(t), z(t); speeds, accelerations and travelled path by interpolation."""

    def __init__(s, t, **q):
        s.t, s.q = t, q

    def __call__(s, t):
        return {k: np.interp(t, s.t, v) for k, v in s.q.items()}


def profile(T, s_total, acc_frac, wobble=0.0, nw=3, n=2500):
    """Path 0..s_total in time T: trapezoid of speed (smooth ramps), optionally a wobbling speed."""
    t = np.linspace(0, T, n)
    u = t / T
    ramp = np.clip(np.minimum(u, 1 - u) / acc_frac, 0, 1)
    v = ramp * ramp * (3 - 2 * ramp) * (1 + wobble * np.sin(2 * np.pi * nw * u))
    v = np.maximum(v, 0)
    s = np.concatenate([[0], np.cumsum((v[1:] + v[:-1]) / 2)]) * (t[1] - t[0])
    k = s_total / s[-1]
    return t, s * k, v * k, np.gradient(v * k, t)


def leg_motion(c):
    if c.get("osc"):
        f, A = c["osc"]
        T = 1.25 / f
        t = np.linspace(0, T, 4000)
        w = 2 * np.pi * f
        env = 1.0
        th, om, al = c["th0"] + A * np.sin(w * t) * env, A * w * np.cos(w * t), -A * w * w * np.sin(w * t)
        s = np.concatenate([[0], np.cumsum(np.abs((om[1:] + om[:-1]) / 2) * (t[1] - t[0]))]) * c["shape"]["chord"] / 2
        return Motion(t, theta=th, omega=om, alpha=al, path=s)
    T = abs(c["th1"] - c["th0"]) / abs(c["omega"])
    t, s, v, a = profile(T, c["th1"] - c["th0"], c["ramp"], c.get("wobble", 0), c.get("nw", 3))
    return Motion(t, theta=c["th0"] + s, omega=v, alpha=a, path=np.abs(s) * c["shape"]["chord"] / 2)


def plate_motion(c):
    T = c["path"] / c["speed"]
    t, s, v, a = profile(T, c["path"], c["ramp"], c.get("wobble", 0), c.get("nw", 3))
    if c.get("arc"):  # direction turns along the path
        g0, g1 = c["arc"]
        g = g0 + (g1 - g0) * s / c["path"]
    else:
        g = np.full_like(s, c["gamma"])
    dx, dz = np.cos(g) * c["dir"], -np.sin(g)
    ds = np.diff(s)
    x = c["x0"] + np.concatenate([[0], np.cumsum((dx[1:] + dx[:-1]) / 2 * ds)])
    z = c["z0"] + np.concatenate([[0], np.cumsum((dz[1:] + dz[:-1]) / 2 * ds)])
    vx, vz = v * dx, v * dz
    return Motion(t, x=x, z=z, vx=vx, vz=vz, ax=np.gradient(vx, t), az=np.gradient(vz, t), path=s)


# ---------------------------------------------------------------- ideal force
NSEG = 24


def pieces(q, c, chord_only=False):
    """positions (from world x = 0 / surface), lever arms, velocity, acceleration (body turning taken out), tangents, areas"""
    sh = c["shape"]
    u = (np.arange(NSEG) + 0.5) / NSEG
    if sh["type"] == "leg":
        th, om, al = q["theta"][:, None], q["omega"][:, None], q["alpha"][:, None]
        xi = 0.0 if chord_only else sh["xi"]
        C = sh["chord"]
        lk, lt = C * np.cos(xi), abs(C * np.sin(xi))
        P, TT, A = [], [], []
        ex = lambda a: np.stack([np.sin(a), -np.cos(a)], -1)
        ka = th + xi
        P.append(lk * u[None, :, None] * ex(ka))
        TT.append(np.broadcast_to(ex(ka), P[-1].shape))
        A.append(np.full(NSEG, lk / NSEG * sh["width"]))
        if lt > 1e-9:
            knee, tip = lk * ex(ka), C * ex(th)
            d = tip - knee
            P.append(knee + u[None, :, None] * d)
            TT.append(np.broadcast_to(d / lt, P[-1].shape))
            A.append(np.full(NSEG, lt / NSEG * sh["width"]))
        r = np.concatenate(P, 1)
        tg = np.concatenate(TT, 1)
        dA = np.concatenate(A)
        e = np.stack([-r[..., 1], r[..., 0]], -1)  # d r / d theta
        V, AC = om[..., None] * e, al[..., None] * e
        pos = r + np.array([0, c["hip_z"]])
        return pos, r, V, AC, tg, dA
    b = c["beta"]
    dl = q.get(
        "tilt_p", 0.0
    )  # a crooked mount: the same rotation in the world, counter-clockwise, whichever way the plate moves
    tg = np.array(
        [
            c["dir"] * np.cos(b) * np.cos(dl) - np.sin(b) * np.sin(dl),
            c["dir"] * np.cos(b) * np.sin(dl) + np.sin(b) * np.cos(dl),
        ]
    )
    r = ((u - 0.5) * sh["length"])[:, None] * tg
    cen = np.stack([q["x"], q["z"]], -1)[:, None, :]
    pos = cen + r[None]
    V = np.broadcast_to(np.stack([q["vx"], q["vz"]], -1)[:, None, :], pos.shape)
    AC = np.broadcast_to(np.stack([q["ax"], q["az"]], -1)[:, None, :], pos.shape)
    return (
        pos,
        np.broadcast_to(r[None], pos.shape),
        V,
        AC,
        np.broadcast_to(tg, pos.shape),
        np.full(NSEG, sh["length"] / NSEG * sh["width"]),
    )


def sand_force(q, c, coef, rho, m, chord_only=False):
    pos, r, V, AC, tg, dA = pieces(q, c, chord_only)
    N = np.stack([-tg[..., 1], tg[..., 0]], -1)
    N = N * np.where((N * V).sum(-1) >= 0, 1, -1)[..., None]
    sg = m.get("slope", 0.0)
    cs, sn = np.cos(sg), np.sin(sg)
    rot = lambda a: np.stack([cs * a[..., 0] + sn * a[..., 1], -sn * a[..., 0] + cs * a[..., 1]], -1)
    back = lambda a: np.stack([cs * a[..., 0] - sn * a[..., 1], sn * a[..., 0] + cs * a[..., 1]], -1)
    depth = (pos[..., 0] * np.tan(sg) - pos[..., 1]) * cs + m.get("depth_zero", 0.0) + c.get("_dz", 0.0)
    sub = depth > 0
    d = np.where(sub, depth, 0)
    v, n = rot(V), rot(N)
    sp = np.sqrt((v**2).sum(-1))
    ok = sub & (sp > 1e-7)
    spd = np.where(sp > 1e-7, sp, 1)
    e = np.where(v[..., 0] >= 0, 1.0, -1.0)
    nx, nz = n[..., 0] * e, n[..., 1]
    c2, s2 = nz**2 - nx**2, -2 * nz * nx
    cg, sG = np.abs(v[..., 0]) / spd, -v[..., 1] / spd
    A00, A10, B11, B01, Bm, C11, C01, Cm, D10 = coef
    az = A00 + A10 * c2 + B11 * (s2 * cg + c2 * sG) + B01 * sG + Bm * (-s2 * cg + c2 * sG)
    ax = C11 * (c2 * cg - s2 * sG) + C01 * cg + Cm * (c2 * cg + s2 * sG) + D10 * s2
    p = 1 + m.get("depth_power", 0.0)
    de = 0.02 * (np.maximum(d, 1e-9) / 0.02) ** p
    if "o_janssen" in m:
        de = m["o_janssen"] * (1 - np.exp(-de / m["o_janssen"]))
    f = np.ones_like(de) * (1 + m.get("scale", 0.0))
    if m.get("packing_grad"):
        f = f * np.maximum(1 + m["packing_grad"] * (c["x_bed"] + pos[..., 0]) / 0.1, 0.2)
    if m.get("rate_log"):
        f = f * np.maximum(1 + m["rate_log"] * np.log1p(sp / 0.01), 0.2)
    if m.get("footprint") and c["pass"] > 1:
        f = f * (1 - m["footprint"] * np.exp(-c["pass_dx"] / 0.03))
    if "o_softening" in m:
        f = f * (1 - m["o_softening"] * (1 - np.exp(-q["path"] / 0.04)))[:, None]
    if "o_layer" in m:
        f = f * (1 + m["o_layer"] / (1 + np.exp(-(d - 0.03) / 0.002)))
    if "o_bottom" in m:
        f = f * (1 + m["o_bottom"] * np.exp(-np.maximum(c["floor"] - d, 0) / 0.015))
    if "o_size" in m:
        f = f * (c["shape"]["width"] / c["w_ref"]) ** m["o_size"]
    if "o_fluid" in m:
        f = f * (1 - m["o_fluid"] / (1 + np.exp(-(sp - c["v_hi"] * 0.5) / (c["v_hi"] * 0.05))))
    if "o_hyst" in m:
        acc = (AC * V).sum(-1) / spd
        f = f * (1 + m["o_hyst"] * np.tanh(acc / (0.3 * c["a_ref"])))
    if "o_aniso" in m:
        f = f * np.where(V[..., 0] < 0, 1 - m["o_aniso"], 1.0)
    if "o_order" in m:
        f = f * (1 + m["o_order"] * np.log1p(10 * c.get("_order", 0.5)) / np.log(11))
    st = np.stack([-ax * e, az], -1) * (de * f)[..., None]
    if m.get("friction_clip"):
        mu = 1 / m["friction_clip"]
        sn_ = (st * n).sum(-1, keepdims=True)
        tt = st - sn_ * n
        tl = np.sqrt((tt**2).sum(-1, keepdims=True))
        st = sn_ * n + tt * np.minimum(1, mu * np.abs(sn_) / np.maximum(tl, 1e-12))
    vn = (v * n).sum(-1)
    nrm = m.get("inertial_drag", 0.0) * rho * vn**2
    nrm = nrm + m.get("cohesion", 0.0) * np.tanh(vn / 1e-3)
    if m.get("added_mass"):
        nrm = nrm + m["added_mass"] * rho * c["shape"]["width"] * (rot(AC) * n).sum(-1)
    if "o_drag" in m:
        nrm = nrm + m["o_drag"][0] * rho * 0.3**2 * (vn / 0.3) ** m["o_drag"][1]
    if "o_crust" in m:
        nrm = nrm + m["o_crust"] * np.exp(-d / 0.006) * np.tanh(vn / 1e-3)
    st = st - nrm[..., None] * n
    F = back(st) * (ok * dA)[..., None]
    T = r[..., 0] * F[..., 1] - r[..., 1] * F[..., 0]
    return np.stack([F[..., 0].sum(1), F[..., 1].sum(1), T.sum(1)], -1)


def force(c, t, coef, rho, m, me):
    """What the sensor would read at times t without noise. m: sand, me: effects of measuring."""
    lag = me.get("delay", 0.0)
    tau = me.get("lowpass", 0.0)
    if tau > 0:
        k = 9
        nodes = -tau * np.log(1 - (np.arange(k) + 0.5) / k)
        return np.mean([force(c, t - u, coef, rho, m, {**me, "lowpass": 0}) for u in nodes], 0)
    c = dict(c)
    q = c["mo"](np.maximum(t - lag, 0))
    m = {**m, "depth_zero": me.get("depth_zero", 0.0)}
    if me.get("size"):
        c["shape"] = {
            k: (v * (1 + me["size"]) if k in ("chord", "length", "width") else v) for k, v in c["shape"].items()
        }
    if c["shape"]["type"] == "leg":
        q["theta"] = q["theta"] + me.get("joint_zero", 0.0)
    else:
        q["tilt_p"] = me.get("attitude", 0.0)

    def both(q):
        if c["shape"]["type"] != "leg" or not m.get("concave_fill"):
            return sand_force(q, c, coef, rho, m)
        F = sand_force(q, c, coef, rho, m)
        x = m["concave_fill"] * (q["omega"] * c["shape"]["xi"] < 0)
        return F * (1 - x)[:, None] + x[:, None] * sand_force(q, c, coef, rho, m, True)

    F = both(q)
    if me.get("compliance") and c["shape"]["type"] == "leg":
        th = q["theta"]
        for _ in range(3):
            F = both({**q, "theta": th + me["compliance"] * F[:, 2]})
    if "o_periodic" in m:  # a motor shakes: frequency belongs to its speed
        F = F + (m["o_periodic"] * np.sin(2 * np.pi * q["path"] / 0.011 + 1.0) * c["f_ref"])[:, None] * np.array(
            [1, 0.6, 0.02]
        )
    if "o_sensor" in m:
        F = F * (1 - m["o_sensor"] * np.abs(F) / (c["f_ref"] * np.array([2, 2, 0.1])))
    if me.get("sensor_tilt"):
        a = me["sensor_tilt"]
        F = np.stack(
            [F[:, 0] * np.cos(a) - F[:, 1] * np.sin(a), F[:, 0] * np.sin(a) + F[:, 1] * np.cos(a), F[:, 2]], -1
        )
    ct = me.get("cross_talk", 0.0)
    if ct:
        F = F + ct * np.stack([F[:, 1], 0 * F[:, 1], 0 * F[:, 1]], -1)
    if me.get("cross_talk_z"):
        F = F + me["cross_talk_z"] * np.stack([0 * F[:, 0], F[:, 0], 0 * F[:, 0]], -1)
    F = F * (1 + me.get("gain", 0.0)) * np.array([1, 1 + me.get("gain_z", 0.0), 1])
    return F + np.array([me.get("bias_x", 0.0), me.get("bias_z", 0.0), 0])


# ---------------------------------------------------------------- rigs
def deg(*a):
    return [x * R for x in a]


def rig_A(rng):  # three legs that sweep once through the bed
    S = {
        "Lf": dict(type="leg", chord=0.09, width=0.03, xi=50 * R),
        "Lr": dict(type="leg", chord=0.09, width=0.03, xi=-50 * R),
        "Ls": dict(type="leg", chord=0.09, width=0.03, xi=0.0),
    }
    C = []
    sp = [0.3, 2.0, 5.0, 9.0]
    for i in range(15):
        C.append(
            dict(
                sname=list(S)[i % 3],
                hip_z=[0.01, 0.028, 0.045][(i // 3 + i) % 3],
                omega=sp[(i + i // 4) % 4],
                th0=-1.45,
                th1=1.4,
                ramp=[0.05, 0.3][i % 2],
            )
        )
    return dict(
        name="A sweeping legs",
        S=S,
        C=C,
        coef=LOOSE,
        medium="poppy-loose",
        rho=640.0,
        reps=3,
        rows=28,
        bed=True,
        passes=True,
        torque=True,
        coefsd=0.08,
        noise=dict(gain=0.015, day=0.012, grain=0.03, lc=0.02, sensor=0.006, tail=3, drift=0, quant=0, spikes=0),
        extra="",
    )


def rig_B(rng):  # plates towed at constant depth on a rail, both ways
    S = {"wide": dict(type="plate", length=0.03, width=0.06), "small": dict(type="plate", length=0.03, width=0.03)}
    C = []
    sp = [0.01, 0.06, 0.25, 0.6]
    be = deg(90, 60, 30, -30, -60)
    for i in range(16):
        C.append(
            dict(
                sname=["wide", "small"][(i // 2) % 2],
                beta=be[i % 5],
                gamma=0.0,
                dir=[1, 1, -1][i % 3],
                x0=0.0 if i % 3 < 2 else 0.24,
                z0=-[0.022, 0.035, 0.055][(i + i // 5) % 3],
                path=0.22,
                speed=sp[(i + i // 4) % 4],
                ramp=[0.06, 0.3][(i // 3) % 2],
            )
        )
    return dict(
        name="B towed plates",
        S=S,
        C=C,
        coef=GENERIC * 0.8,
        medium=None,
        rho=1500.0,
        reps=3,
        rows=30,
        bed=True,
        passes=True,
        torque=False,
        coefsd=0.08,
        noise=dict(
            gain=0.012,
            day=0.01,
            grain=0.025,
            lc=0.012,
            sensor=0.004,
            tail=0,
            drift=0.012,
            quant=0.05,
            spikes=0,
            filt=0.0015,
        ),
        extra="",
    )


def rig_C(rng):  # penetrometer: discs (as squares of equal area), from above the surface
    h = np.sqrt(np.pi) / 2
    S = {f"D{d}": dict(type="plate", length=h * d / 1000, width=h * d / 1000) for d in (25, 40, 60)}
    C = []
    ga = deg(90, 60, 45, 90, 75)
    be = deg(0, 0, 15, 0, -15)
    sp = [0.005, 0.05, 0.3]
    for i in range(14):
        k = i % 5
        if i in (7, 12):
            c = dict(gamma=-90 * R, beta=0.0, z0=-0.07, path=0.062)  # pulled out
        else:
            c = dict(gamma=ga[k], beta=be[k], z0=0.008, path=0.075)
        C.append(
            dict(
                sname=list(S)[(i + i // 3) % 3],
                dir=1,
                x0=-0.02,
                speed=sp[(i + i // 5) % 3],
                ramp=[0.08, 0.25][i % 2],
                **c,
            )
        )
    return dict(
        name="C penetrometer",
        S=S,
        C=C,
        coef=GENERIC * 0.33,
        medium=None,
        rho=1480.0,
        reps=4,
        rows=26,
        bed=False,
        passes=False,
        torque=False,
        coefsd=0.1,
        noise=dict(
            gain=0.02, day=0.01, grain=0.03, lc=0.01, sensor=0.003, tail=0, drift=0.01, quant=0.02, spikes=0.004
        ),
        extra="",
    )


def rig_D(rng):  # an arm draws arcs with a plate
    S = {"P80": dict(type="plate", length=0.05, width=0.08), "P40": dict(type="plate", length=0.05, width=0.04)}
    C = []
    sp = [0.02, 0.12, 0.5]
    be = deg(0, 30, 60, -30, 90, -60)
    for i in range(15):
        C.append(
            dict(
                sname=["P80", "P40"][(i // 3) % 2],
                beta=be[i % 6],
                arc=(55 * R, -25 * R) if i % 4 else (80 * R, 10 * R),
                dir=[1, -1][(i // 2) % 2],
                x0=[0.0, 0.1][(i // 2) % 2],
                z0=-[0.012, 0.025, 0.04][(i // 2) % 3],
                path=0.1,
                speed=sp[(i + i // 3) % 3],
                ramp=0.22,
                wobble=[0, 0.5][i % 2],
                nw=2,
            )
        )
    return dict(
        name="D arcs of an arm",
        S=S,
        C=C,
        coef=CLOSE,
        medium="poppy-close",
        rho=700.0,
        reps=3,
        rows=32,
        bed=True,
        passes=True,
        torque=True,
        coefsd=0.08,
        noise=dict(gain=0.015, day=0.02, grain=0.02, lc=0.03, sensor=0.01, tail=0, drift=0, quant=0, spikes=0, ou=0.05),
        extra="[uncertainty]\nattitude = 0.03\nsize = 0.015\n",
    )


def rig_E(rng):  # inclined rods, deep, speed wobbles
    S = {"rod10": dict(type="plate", length=0.12, width=0.010), "rod18": dict(type="plate", length=0.12, width=0.018)}
    C = []
    sp = [0.02, 0.15, 0.5]
    be = deg(90, 65, -65)
    for i in range(12):
        C.append(
            dict(
                sname=["rod10", "rod18"][(i + i // 3) % 2],
                beta=be[i % 3],
                gamma=[0.0, 0.0, 20 * R][(i // 2) % 3],
                dir=1,
                x0=0.0,
                z0=-[0.065, 0.09][(i // 4) % 2],
                path=0.15,
                speed=sp[(i + i // 3) % 3],
                ramp=0.12,
                wobble=[0.8, 0.0][(i // 2) % 2],
                nw=4,
            )
        )
    return dict(
        name="E rods",
        S=S,
        C=C,
        coef=GENERIC * 2.02,
        medium=None,
        rho=1600.0,
        reps=5,
        rows=30,
        bed=True,
        passes=False,
        torque=False,
        coefsd=0.1,
        noise=dict(
            gain=0.02,
            day=0.015,
            grain=0.03,
            lc=0.008,
            sensor=0.005,
            tail=4,
            drift=0.01,
            quant=0.1,
            spikes=0.002,
            filt=0.001,
        ),
        extra="[nuisances]\noffset = 0.05\n",
    )


def rig_F(rng):  # wagging small legs, both ways
    S = {
        "K": dict(type="leg", chord=0.06, width=0.02, xi=35 * R),
        "I": dict(type="leg", chord=0.06, width=0.02, xi=0.0),
    }
    C = []
    f = [0.15, 0.6, 2.0]
    for i in range(12):
        C.append(
            dict(
                sname=["K", "K", "I"][i % 3],
                hip_z=[0.005, 0.018, 0.03][(i + i // 3) % 3],
                osc=(f[(i // 2 + i) % 3], [1.2, 0.8][(i // 3) % 2]),
                th0=[0.0, 0.35, -0.35][(i // 4) % 3],
            )
        )
    return dict(
        name="F wagging legs",
        S=S,
        C=C,
        coef=LOOSE * 1.3,
        medium=None,
        coefs_explicit=True,
        rho=690.0,
        reps=4,
        rows=34,
        bed=True,
        passes=True,
        torque=True,
        coefsd=0.08,
        noise=dict(gain=0.02, day=0.01, grain=0.025, lc=0.015, sensor=0.008, tail=3, drift=0.01, quant=0.005, spikes=0),
        extra="",
    )


RIGS = dict(A=rig_A, B=rig_B, C=rig_C, D=rig_D, E=rig_E, F=rig_F)


def build(letter, rng, flags):
    r = RIGS[letter](rng)
    r["letter"] = letter
    r["S"] = {k: dict(v) for k, v in r["S"].items()}
    n = r["noise"] = dict(r["noise"])
    for k in ("gain", "day", "grain", "sensor", "drift"):
        n[k] = n[k] * np.exp(rng.normal(0, 0.25))
    C = r["C"]
    sp = "omega" if letter == "A" else "speed"
    if "one_speed" in flags:
        common = None if letter == "F" else sorted({k[sp] for k in C})[1]
        for c in C:
            if "osc" in c:
                c["osc"] = (0.6, c["osc"][1])
            else:
                c[sp] = common
    j = rng.permutation(len(C))
    for i, c in enumerate(C):
        for k in ("speed", "omega", "z0", "hip_z", "path"):  # a real laboratory's round numbers are not quite the same
            if k in c and not (k == "z0" and c[k] > 0):
                c[k] = (
                    c[k] * rng.uniform(0.93, 1.07) if "one_speed" not in flags or k not in ("speed", "omega") else c[k]
                )
        c["shape"] = r["S"][c["sname"]]
        c["mo"] = (leg_motion if c["shape"]["type"] == "leg" else plate_motion)(c)
        c["x_bed"] = float(np.round(rng.uniform(-0.15, 0.15), 3)) if r["bed"] else 0.0
        c["pass"], c["pass_dx"] = (
            (2, float(rng.choice([0.0, 0.01, 0.02, 0.04]))) if r["passes"] and j[i] % 3 == 0 else (1, 0.0)
        )
        c["floor"], c["w_ref"] = 0.085 if letter != "E" else 0.15, 0.03
        T = c["mo"].t[-1]
        if "osc" in c:
            t = np.linspace(0.02 * T, 0.98 * T, r["rows"] + 12)
            om = np.abs(c["mo"](t)["omega"])
            c["t"] = t[om > 0.2 * om.max()][: r["rows"]]
        else:
            c["t"] = np.linspace(0.03 * T, 0.965 * T, r["rows"])
        q = c["mo"](c["mo"].t)
        v = np.abs(q["omega"]) * c["shape"]["chord"] * 0.6 if "omega" in q else np.hypot(q["vx"], q["vz"])
        a = np.abs(q["alpha"]) * c["shape"]["chord"] * 0.6 if "alpha" in q else np.hypot(q["ax"], q["az"])
        c["_v"], c["_a"] = v.max(), a.max()
    for c in C:
        c["v_hi"], c["a_ref"] = max(k["_v"] for k in C), max(np.median([k["_a"] for k in C]), 1e-3)
    r["F0"] = [force(c, c["t"], r["coef"], r["rho"], {}, {}) for c in C]
    fr = np.sqrt(np.mean(np.concatenate(r["F0"])[:, :2] ** 2))
    for c in C:
        c["f_ref"] = fr
    r["f_ref"] = fr
    r["rms"] = np.maximum(np.sqrt(np.mean(np.concatenate(r["F0"]) ** 2, 0)), 1e-4)
    return r


# ---------------------------------------------------------------- noise: grains, sensor, trial, day
def noisy(F, q, t, r, rng, day_gain, scale_drift=0):
    n, N = r["noise"], len(t)
    s = q["path"]
    rho = np.exp(-np.abs(np.diff(s)) / n["lc"])
    g = np.zeros((N, 3))
    g[0] = rng.normal(size=3)
    for i in range(1, N):
        g[i] = rho[i - 1] * g[i - 1] + np.sqrt(1 - rho[i - 1] ** 2) * rng.normal(size=3)
    mag = np.hypot(F[:, 0], F[:, 1])
    arm = np.array([1, 1, r["rms"][2] / r["f_ref"]])
    ch = r["rms"] * np.array([1, 1, 1])
    out = F + n["grain"] * g * (0.5 * np.abs(F) + 0.5 * mag[:, None] * arm)
    out = out * (1 + n["gain"] * rng.normal() + day_gain)
    sens = (
        rng.standard_t(n["tail"], size=(N, 3)) / np.sqrt(n["tail"] / (n["tail"] - 2))
        if n["tail"]
        else rng.normal(size=(N, 3))
    )
    if n.get("ou"):  # noise of the electronics, correlated in time
        rt = np.exp(-np.abs(np.diff(t)) / (n["ou"] * t[-1]))
        for i in range(1, N):
            sens[i] = rt[i - 1] * sens[i - 1] + np.sqrt(1 - rt[i - 1] ** 2) * sens[i]
    out = out + n["sensor"] * sens * ch + n["sensor"] * rng.normal(size=3) * ch
    u = (t - t[0]) / (t[-1] - t[0])
    out = out + n["drift"] * ch * (
        rng.normal(size=3) * u[:, None] + 0.4 * np.cumsum(rng.normal(size=(N, 3)), 0) / np.sqrt(N)
    )
    if n["spikes"]:
        hit = rng.random((N, 3)) < n["spikes"]
        out = out + hit * rng.normal(0, 0.15, (N, 3)) * ch
    if n["quant"]:
        out = np.round(out / (n["quant"] * np.array([1, 1, 0.02]))) * (n["quant"] * np.array([1, 1, 0.02]))
    return out


def cosines(F, K=6):
    N = len(F)
    k = np.arange(K)[:, None]
    B = np.cos(np.pi * k * (np.arange(N) + 0.5) / N) * np.sqrt(2 / N)
    B[0] /= np.sqrt(2)
    return B @ F / np.sqrt(N)  # K x 3, rms-like


TYP = dict(
    inertial_drag=1.0,
    concave_fill=0.5,
    footprint=0.4,
    added_mass=1.0,
    depth_power=0.2,
    cohesion=200.0,
    scale=0.2,
    packing_grad=0.1,
    slope=0.05,
    rate_log=0.04,
    friction_clip=2.0,
)
NUIS = dict(
    gain=0.02,
    sensor_tilt=0.05,
    depth_zero=0.002,
    delay=0.002,
    lowpass=0.005,
    attitude=0.035,
    joint_zero=0.02,
    size=0.02,
    cross_talk=0.02,
)


class Size:
    """Whitened distance of an effect from the plain law, with coefficients and stated nuisances marginalised; and from each rival."""

    def __init__(s, r, rng):
        s.r = r
        C = r["C"]
        s.ch = 3 if r["torque"] else 2
        s.base = s.log({}, {})
        res = []
        for c, F in zip(C, r["F0"]):
            q = c["mo"](c["t"])
            e = []
            for k in range(6):
                c2 = dict(c, _dz=rng.normal(0, 0.0003))
                F1 = force(c2, c["t"], r["coef"], r["rho"], {}, {})
                e.append(cosines(noisy(F1, q, c["t"], r, rng, rng.normal(0, r["noise"]["day"])) - F)[:, : s.ch])
            res.append(np.mean(np.square(e), 0))
        V = np.array(res)  # cond x K x ch
        s.V = ((0.7 * V + 0.3 * V.mean(0)) / r["reps"]).reshape(-1)
        J = []
        for i in range(9):
            co = r["coef"].copy()
            if co[i] == 0:
                continue
            co[i] *= 1 + r["coefsd"]
            J.append(s.log({}, {}, co) - s.base)
        leg = C[0]["shape"]["type"] == "leg"
        for k, sd in NUIS.items():
            if (k == "attitude" and leg) or (k == "joint_zero" and not leg):
                continue
            J.append(s.log({}, {k: sd}) - s.base)
        for k in ("bias_x", "bias_z"):
            J.append(s.log({}, {k: 0.1 * r["rms"][0 if k == "bias_x" else 1]}) - s.base)
        s.J = np.array(J).T
        s.riv = None

    def log(s, m, me, coef=None):
        r = s.r
        out = []
        for i, c in enumerate(r["C"]):
            cc = dict(c, _order=(i + 0.5) / len(r["C"])) if "o_order" not in m else dict(c, _order=0.5)
            out.append(
                cosines(force(cc, c["t"], r["coef"] if coef is None else coef, r["rho"], m, me))[:, : s.ch].reshape(-1)
            )
        return np.concatenate(out)

    def dist(s, d, J):
        w = 1 / np.sqrt(s.V)
        d, J = d * w, J * w[:, None]
        M = np.eye(J.shape[1]) + J.T @ J
        return np.sqrt(max(d @ d - (J.T @ d) @ np.linalg.solve(M, J.T @ d), 0))

    def sigma(s, m, me):
        return s.dist(s.log(m, me) - s.base, s.J)

    def rival(s, m, me, skip):
        d = s.log(m, me) - s.base
        if s.riv is None:
            s.riv = {}
            for k, v in TYP.items():
                if k in ("concave_fill",) and s.r["C"][0]["shape"]["type"] != "leg":
                    continue
                if k == "footprint" and not s.r["passes"] or k == "packing_grad" and not s.r["bed"]:
                    continue
                s.riv[k] = s.log({k: v}, {}) - s.base
            for k, v in NUIS.items():
                x = s.log({}, {k: v}) - s.base
                if np.any(x):
                    s.riv[k] = x
        best = ("", 1e9)
        for k, x in s.riv.items():
            if k in skip or not np.any(x):
                continue
            y = s.dist(d, np.column_stack([s.J, 20 * x]))
            if y < best[1]:
                best = (k, y)
        return best


# ---------------------------------------------------------------- what is hidden
SAND = dict(
    inertial_drag=(3, (0.05, 5), "ABDEF"),
    concave_fill=(3, (0.01, 1.0), "AFA"),
    footprint=(3, (0.03, 0.85), "ABDF"),
    added_mass=(2, (0.1, 5), "EDF"),
    depth_power=(3, (0.02, 0.7), "ABCDEF"),
    cohesion=(3, (10, 1500), "ABCDF"),
    scale=(2, (0.08, 0.5), "ABDF"),
    packing_grad=(3, (0.004, 0.35), "ABDE"),
    slope=(3, (0.002, 0.3), "ABDF"),
    rate_log=(3, (0.002, 0.15), "ABCDE"),
    friction_clip=(2, (0.4, 6), "BDAE"),
)
MEAS = dict(
    attitude=(2, (0.06, 0.16), "BCDE"),
    sensor_tilt=(2, (0.1, 0.3), "ABDEF"),
    depth_zero=(2, (0.004, 0.012), "ABCDF"),
    delay=(2, (0.01, 0.08), "ADF"),
    lowpass=(1, (0.02, 0.08), "AF"),
    gain=(2, (0.08, 0.25), "ABCDEF"),
    cross_talk=(2, (0.06, 0.2), "ABCDE"),
    offset=(2, (0.15, 0.6), "ABCDEF"),
    size=(1, (0.06, 0.12), "AF"),
    joint_zero=(1, (0.06, 0.15), "AF"),
    compliance=(1, (0.02, 0.3), "AF"),
)
OUT = [
    ("drag_exponent_1", lambda s: {"o_drag": (s, 1.0)}, (0.05, 6), "BDA", ["inertial_drag", "rate_log"]),
    ("drag_exponent_3.2", lambda s: {"o_drag": (s, 3.2)}, (0.05, 6), "ABE", ["inertial_drag"]),
    ("softening_with_path", lambda s: {"o_softening": s}, (0.03, 0.7), "ABDE", []),
    ("crust", lambda s: {"o_crust": s}, (50, 6000), "ACDF", ["cohesion"]),
    ("layer_at_3cm", lambda s: {"o_layer": s}, (0.05, 1.5), "ABCD", ["depth_power"]),
    ("hysteresis_of_acceleration", lambda s: {"o_hyst": s}, (0.008, 0.5), "DEF", ["added_mass"]),
    ("worn_sensor_saturates", lambda s: {"o_sensor": s}, (0.03, 0.5), "ABCDEF", []),
    ("periodic_disturbance", lambda s: {"o_periodic": s}, (0.03, 0.6), "ABDE", []),
    ("bottom_of_the_bed", lambda s: {"o_bottom": s}, (0.1, 4), "ACDF", ["depth_power"]),
    ("size_exponent", lambda s: {"o_size": -s}, (0.03, 0.5), "BCDE", []),
    ("fluidised_above_a_speed", lambda s: {"o_fluid": s}, (0.03, 0.6), "ABCDE", ["rate_log"]),
    ("weaker_toward_minus_x", lambda s: {"o_aniso": s}, (0.03, 0.5), "BDF", []),
    ("janssen_saturation", lambda s: {"o_janssen": 0.02 / s}, (0.02, 1.0), "ABCDE", ["depth_power"]),
    ("ageing_with_trial_order", lambda s: {"o_order": s}, (0.1, 0.5), "ABDE", ["gain_drift", "gain"]),
]


def plan(rng):
    L = []
    for i in range(28):
        L.append(dict(kind="null", rig="ABCDEF"[i % 6], id=None, flags=[]))
    for i in (5, 17):
        L[i]["flags"] = ["days_aligned"]
    k = 0
    for cid, (n, lim, rigs) in SAND.items():
        o = rng.permutation(len(rigs))
        for i in range(n):
            L.append(
                dict(
                    kind="sand",
                    id=cid,
                    lim=lim,
                    rig=rigs[o[i % len(rigs)]],
                    strength=["faint", "mid", "strong", "strong", "mid"][k % 5],
                    flags=[],
                )
            )
            k += 1
    S = [x for x in L if x["kind"] == "sand"]
    one = [x for x in S if x["id"] in ("rate_log", "inertial_drag")]
    one[int(rng.integers(3))]["flags"] = ["one_speed"]
    one[3 + int(rng.integers(3))]["flags"] = ["one_speed"]
    [x for x in S if x["id"] == "scale"][int(rng.integers(2))]["flags"] = ["no_bed_columns"]
    for cid, (n, lim, rigs) in MEAS.items():
        o = rng.permutation(len(rigs))
        for i in range(n):
            L.append(
                dict(
                    kind="measure",
                    id=cid,
                    lim=lim,
                    rig=rigs[o[i % len(rigs)]],
                    strength=["strong", "mid", "strong"][k % 3],
                    flags=[],
                )
            )
            k += 1
    M = [x for x in L if x["kind"] == "measure"]
    [x for x in M if x["id"] == "delay"][0]["flags"] = ["one_speed"]
    [x for x in M if x["id"] == "gain"][0]["flags"] = ["no_bed_columns"]
    for name, fn, lim, rigs, near in OUT:
        L.append(
            dict(
                kind="outside",
                id=name,
                fn=fn,
                lim=lim,
                near=near,
                rig=rigs[int(rng.integers(len(rigs)))],
                strength=["strong", "mid", "strong", "strong"][k % 4],
                flags=[],
            )
        )
        k += 1
    O = [x for x in L if x["kind"] == "outside"]
    for nm in ("size_exponent", "drag_exponent_3.2"):
        [x for x in O if x["id"] == nm][0]["flags"] = ["one_shape"] if nm == "size_exponent" else ["one_speed"]
    return [L[i] for i in rng.permutation(len(L))]


def effect(x, val, r):
    """(sand mechanisms, measuring effects) for a value"""
    if x["kind"] == "sand":
        return {x["id"]: val}, {}
    if x["kind"] == "outside":
        return x["fn"](val), {}
    if x["id"] == "offset":
        return {}, {x["chan"]: val * r["rms"][0 if x["chan"] == "bias_x" else 1]}
    if x["id"] == "cross_talk":
        return {}, {x["chan"]: val}
    if x["id"] == "gain" and x["chan"] == "z":
        return {}, {"gain_z": val}
    return {}, {x["id"]: val}


def one(i, x, seed, out):
    rng = np.random.default_rng([seed, i, 77])
    r = build(x["rig"], rng, x["flags"])
    if "one_shape" in x["flags"]:
        k = list(r["S"])[0]
        for c in r["C"]:
            c["sname"], c["shape"] = k, r["S"][k]
        r["S"] = {k: r["S"][k]}
        r["F0"] = [force(c, c["t"], r["coef"], r["rho"], {}, {}) for c in r["C"]]
    if "no_bed_columns" in x["flags"]:
        r["bed"] = r["passes"] = False
    if not r["passes"]:
        for c in r["C"]:
            c["pass"], c["pass_dx"] = 1, 0.0
    leg = r["C"][0]["shape"]["type"] == "leg"
    sz = Size(r, rng)
    # small errors, all logs
    coef = r["coef"] * (1 + rng.normal(0, 0.4 * r["coefsd"], 9))
    small = dict(
        sensor_tilt=rng.normal(0, 0.012),
        depth_zero=rng.normal(0, 0.0007),
        delay=abs(rng.normal(0, 0.0007)),
        gain=rng.normal(0, 0.007),
        cross_talk=rng.normal(0, 0.006),
        size=rng.normal(0, 0.006),
        bias_x=rng.normal(0, 0.008) * r["rms"][0],
        bias_z=rng.normal(0, 0.008) * r["rms"][1],
    )
    small["joint_zero" if leg else "attitude"] = rng.normal(0, 0.006 if leg else 0.01)
    if r["noise"].get("filt"):
        small["lowpass"] = r["noise"]["filt"]
    small = {k: float(v) for k, v in small.items()}
    m, big, val, sig, riv = {}, {}, None, 0.0, ("", 0.0)
    sgn = 1.0
    if x["kind"] != "null":
        if x["id"] in (
            "packing_grad",
            "slope",
            "scale",
            "attitude",
            "sensor_tilt",
            "depth_zero",
            "joint_zero",
            "gain",
            "offset",
            "cross_talk",
            "depth_power",
            "size",
            "rate_log",
        ):
            sgn = float(rng.choice([-1, 1]))
        if x["id"] == "rate_log":
            sgn = float(rng.choice([1, 1, -1]))
        x["chan"] = dict(
            offset=str(rng.choice(["bias_x", "bias_z"])),
            cross_talk=str(rng.choice(["cross_talk", "cross_talk_z"])),
            gain=str(rng.choice(["all", "z"])),
        ).get(x["id"], "")
        if "no_bed_columns" in x["flags"] and x["id"] == "gain":
            x["chan"] = "all"
        target = dict(
            faint=rng.uniform(2, 4),
            mid=np.exp(rng.uniform(np.log(5), np.log(12))),
            strong=np.exp(rng.uniform(np.log(12), np.log(60))),
        )[x["strength"]]
        lo, hi = x["lim"]
        grid = np.exp(np.linspace(np.log(lo), np.log(hi), 8))
        s = np.array([sz.sigma(*effect(x, sgn * g, r)) for g in grid])
        s = np.maximum.accumulate(s) + np.arange(8) * 1e-9
        if target > s[-1] or x["id"] == "scale":
            val = sgn * float(
                np.exp(rng.uniform(np.log(lo * hi) / 2, np.log(hi)))
            )  # more than nature gives: somewhere in the upper half
        else:
            val = sgn * float(np.exp(np.interp(target, s, np.log(grid))))
        m, big = effect(x, val, r)
        sig = sz.sigma(m, big)
        riv = sz.rival(m, big, {x["id"], x["chan"]})
    me = {**small, **{k: v + (small.get(k, 0.0) if k not in ("gain",) else small.get(k, 0.0)) for k, v in big.items()}}
    # trials in random order over days; repetitions of a condition on different days (unless days_aligned)
    C, reps = r["C"], r["reps"]
    T = [(ci, k) for k in range(reps) for ci in rng.permutation(len(C))]
    if "days_aligned" in x["flags"]:
        T = [(ci, k) for ci in range(len(C)) for k in range(reps)]
    nd = reps if "days_aligned" not in x["flags"] else 5
    day = rng.normal(0, r["noise"]["day"], nd)
    if "days_aligned" in x["flags"]:
        day = rng.normal(0, 0.04, nd)
    leg_cols = ["hip_z", "theta", "omega", "x", "z", "vx", "vz"]
    head = (
        ["trial", "condition", "rep", "kind", "shape"]
        + (["hip_z"] if leg else ["plate_beta", "plate_gamma"])
        + (["pass", "pass_dx"] if r["passes"] else [])
        + (["x_bed"] if r["bed"] else [])
        + ["t"]
        + (["theta", "omega"] if leg else [])
        + ["x", "z", "vx", "vz", "Fx", "Fz"]
        + (["Ty"] if r["torque"] else [])
    )
    rows, ratio_n, ratio_d, noise_e, eff_e = [], np.zeros(len(C)), np.zeros(len(C)), [], []
    for o, (ci, k) in enumerate(T):
        c = dict(C[ci], _dz=rng.normal(0, 0.0003), _order=o / len(T))
        t = c["t"]
        F1 = force(c, t, coef, r["rho"], m, me)
        F = noisy(F1, c["mo"](t), t, r, rng, day[min(o * nd // len(T), nd - 1)])
        noise_e.append(F - F1)
        F_pl = r["F0"][ci]
        ratio_n[ci] += np.sum(F1[:, :2] * F_pl[:, :2])
        ratio_d[ci] += np.sum(F_pl[:, :2] ** 2)
        if k == 0:
            eff_e.append(force(C[ci], t, r["coef"], r["rho"], m, big) - F_pl)
        q = c["mo"](t)
        if leg:
            xi, ch, th = c["shape"]["xi"], c["shape"]["chord"], q["theta"]
            lk, lt = ch * np.cos(xi), abs(ch * np.sin(xi))
            e = lambda a: np.stack([np.sin(a), -np.cos(a)], -1)
            kn, tip = lk * e(th + xi), ch * e(th)
            cen = (lk * kn / 2 + lt * (kn + tip) / 2) / (lk + lt)
            X, Z, VX, VZ = cen[:, 0], cen[:, 1] + c["hip_z"], -q["omega"] * cen[:, 1], q["omega"] * cen[:, 0]
        else:
            X, Z, VX, VZ = q["x"], q["z"], q["vx"], q["vz"]
        for j in range(len(t)):
            d = dict(
                trial=f"t{o:03d}",
                condition=f"c{ci:02d}",
                rep=k,
                kind="leg" if leg else "plate",
                shape=c["sname"],
                x_bed=c["x_bed"],
                pass_dx="%.3f" % c["pass_dx"],
                t="%.6f" % t[j],
                x="%.6f" % X[j],
                z="%.6f" % Z[j],
                vx="%.6g" % VX[j],
                vz="%.6g" % VZ[j],
                Fx="%.5g" % F[j, 0],
                Fz="%.5g" % F[j, 1],
                Ty="%.5g" % F[j, 2],
            )
            d["pass"] = c["pass"]
            if leg:
                d.update(hip_z="%.5f" % c["hip_z"], theta="%.5f" % q["theta"][j], omega="%.6g" % q["omega"][j])
            else:
                d.update(plate_beta="%.5f" % c["beta"], plate_gamma="%.5f" % np.arctan2(-VZ[j], abs(VX[j])))
            rows.append(",".join(str(d[h]) for h in head))
    f = os.path.join(out, f"log_{i:03d}")
    os.makedirs(f, exist_ok=True)
    open(f + "/data.csv", "w").write(",".join(head) + "\n" + "\n".join(rows) + "\n")
    ex = ['kind = "intrusion"']
    if r["medium"]:
        ex.append(f'medium = "{r["medium"]}"')
    ex += [f"bulk_density = {r['rho']}", f"coefficient_sd = {r['coefsd']}", ""]
    if not r["medium"]:
        ex += ["[sand]", f'name = "{r["letter"].lower()}sand"', f"bulk_density = {r['rho']}"]
        if r.get("coefs_explicit"):
            ex += ["[sand.coefficients]"] + [f"{n} = {float(v)!r}" for n, v in zip(CO, r["coef"])]
        else:
            ex.append(f"zeta = {float(r['coef'][0] / GENERIC[0]):.4f}")
        ex.append("")
    for k, s in r["S"].items():
        if not any(c["sname"] == k for c in C):
            continue
        ex.append(f"[shape.{k}]")
        ex.append(f'type = "{s["type"]}"')
        if s["type"] == "leg":
            ex += [f"chord = {s['chord']}", f"width = {s['width']}", f"xi_deg = {s['xi'] / R:.6g}"]
        else:
            ex += [f"length = {s['length']:.6f}", f"width = {s['width']:.6f}"]
        ex.append("")
    ex.append(r["extra"])
    open(f + "/exp.toml", "w").write("\n".join(ex))
    eff, noi = np.concatenate(eff_e)[:, :2], np.concatenate(noise_e)[:, :2]
    v = val
    label = None if x["kind"] == "null" else "faint" if sig < 4 else "mid" if sig < 12 else "strong"
    if x["kind"] == "measure" and x["id"] == "offset":
        v = big[x["chan"]]
    ident = x["id"]
    unident = bool(
        x["flags"]
        or (x["kind"] == "sand" and riv[1] < 2 and sig > 6 and not (x["id"] == "scale" and riv[0] in ("gain", "size")))
    )
    cf = np.exp(np.mean(np.log(np.maximum(ratio_n / ratio_d, 1e-3))))
    return dict(
        log=f"log_{i:03d}",
        kind=x["kind"],
        id=ident,
        channel=x.get("chan", ""),
        value=v,
        strength=label,
        aimed_strength=x.get("strength"),
        rig=r["name"],
        flags=x["flags"],
        unidentifiable=unident,
        sigma=round(float(sig), 2),
        nearest_rival=riv[0],
        sigma_to_rival=round(float(min(riv[1], 1e6)), 2),
        effect_rms=float(np.sqrt(np.mean(eff**2))),
        noise_rms=float(np.sqrt(np.mean(noi**2))),
        force_rms=float(r["f_ref"]),
        effect_over_noise=float(np.sqrt(np.mean(eff**2) / np.mean(noi**2))),
        near=x.get("near", []),
        small=small,
        total_measuring={k: float(v) for k, v in me.items()},
        coefficient_errors=[float(v) for v in (coef / np.where(r["coef"] == 0, 1, r["coef"]) - 1) * (r["coef"] != 0)],
        factor_true=float(cf),
        conditions=len(C),
        repetitions=reps,
        rows=len(rows),
    )


def main():
    seed, out = int(sys.argv[1]), sys.argv[2]
    only = set(map(int, sys.argv[3].split(","))) if len(sys.argv) > 3 else None
    os.makedirs(out, exist_ok=True)
    L = plan(np.random.default_rng(seed))
    truth = []
    for i, x in enumerate(L):
        if only is None or i in only:
            truth.append(one(i, x, seed, out))
    json.dump(dict(seed=seed, logs=truth), open(out + "/truth.json", "w"), indent=1)


if __name__ == "__main__":
    main()
