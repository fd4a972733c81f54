"""The sand, the intruders and the hidden effects. Written from physics.md, diagnosis.md and the user docs only. SI units."""
import numpy as np

G = 9.80665
C_NAMES = ['a00', 'a10', 'b11', 'b01', 'bm11', 'c11', 'c01', 'cm11', 'd10']
GENERIC = np.array([.206, .169, .212, .358, .055, -.124, .253, .007, .088]) * 1e6
LOOSE = np.array([.051, .047, .053, .083, .020, -.026, .057, 0., .025]) * 1e6
CLOSE = np.array([.094, .092, .092, .151, .035, -.039, .086, .018, .046]) * 1e6

# 3D-RFT, table of section 3: (powers of x1, x2, x3), c1, c2, c3
AG = [((0, 0, 0), .00212, -.06796, -.02634), ((3, 0, 0), .01992, -.00736, .02927), ((1, 0, 0), -.02320, -.10941, -.03436),
      ((0, 3, 0), -.45961, .63758, .95406), ((0, 1, 0), -.20890, .04725, .45256), ((0, 0, 3), .40799, .08997, -.00131),
      ((0, 0, 1), -.43083, -.06914, .00835), ((1, 2, 0), -.10107, .21069, -.11028), ((2, 0, 0), -.00259, -.05835, .02553),
      ((2, 1, 0), -.06576, .04748, .01487), ((0, 2, 0), .48872, -.65880, -1.31290), ((0, 1, 2), .05664, .20406, -.02730),
      ((0, 0, 2), -.00415, -.11985, -.05532), ((0, 2, 1), -.09269, .18519, .10911), ((1, 1, 0), .07204, -.25739, .06790),
      ((2, 0, 1), .01892, .04934, -.04097), ((0, 1, 1), -.02750, -.26834, -.16404), ((1, 0, 2), .01033, .13527, .07881),
      ((1, 0, 1), -.08772, .02692, .02287), ((1, 1, 1), .15120, -.33207, -.27519)]


def li2013(coef, v, n):
    """Stress per depth [N/m³] for velocities v and normals n (..., 3); the sign of n does not matter (a thin plate)."""
    a00, a10, b11, b01, bm11, c11, c01, cm11, d10 = coef
    speed = np.maximum(np.linalg.norm(v, axis=-1), 1e-12)
    vh = np.hypot(v[..., 0], v[..., 1])
    cg, sg = vh / speed, -v[..., 2] / speed
    horizontal = np.where((vh > 1e-9 * speed)[..., None], v[..., :2], n[..., :2])
    e = horizontal / np.maximum(np.hypot(horizontal[..., 0], horizontal[..., 1]), 1e-30)[..., None]
    ne = n[..., 0] * e[..., 0] + n[..., 1] * e[..., 1]
    c2, s2 = n[..., 2] ** 2 - ne ** 2, -2 * n[..., 2] * ne
    sp, sm = s2 * cg + c2 * sg, sg * c2 - cg * s2            # sin(2β+γ), sin(γ-2β)
    cp, cm = c2 * cg - s2 * sg, cg * c2 + sg * s2
    az = a00 + a10 * c2 + b11 * sp + b01 * sg + bm11 * sm
    ax = c11 * cp + c01 * cg + cm11 * cm + d10 * s2
    return np.stack([-ax * e[..., 0], -ax * e[..., 1], az], -1)


def agarwal2023(xi, v, n, mu_s=None, f_scale=(1., 1., 1.)):
    """Stress per depth of the leading face; n must be the outward normal of the leading face."""
    speed = np.maximum(np.linalg.norm(v, axis=-1), 1e-12)[..., None]
    d = v / speed
    m = np.where((n[..., 2:] > 0), -n, n)                   # β in [-90°, 90°]
    x = [-d[..., 2], -m[..., 2], (m * d).sum(-1)]
    f = [0., 0., 0.]
    pw = [[np.ones_like(x[i]), x[i], x[i] ** 2, x[i] ** 3] for i in range(3)]
    for (p1, p2, p3), *c in AG:
        t = pw[0][p1] * pw[1][p2] * pw[2][p3]
        for i in range(3):
            f[i] = f[i] + c[i] * t
    f = [f[i] * f_scale[i] for i in range(3)]
    a = f[0][..., None] * m + f[1][..., None] * d
    a[..., 2] -= f[2]
    an = (a * n).sum(-1, keepdims=True)
    at = a - an * n
    if mu_s is not None:
        at = at * np.minimum(mu_s * np.abs(an) / np.maximum(np.linalg.norm(at, axis=-1, keepdims=True), 1e-12), 1)
    return xi * (-np.abs(an) * n + at)


class Sand:
    def __init__(self, law, coef, rho):
        self.law, self.coef, self.rho = law, coef, rho

    def zeta(self):
        return self.coef[:5].sum() if self.law == 'li2013' else self.coef[0] * .87574

    def alpha(self, v, n):
        if self.law == 'li2013':
            return li2013(self.coef, v, n)
        return agarwal2023(self.coef[0], v, n, f_scale=self.coef[1:4])


def rot_y(a, ang):
    """Turn vectors counter-clockwise in the x-z plane (x toward z)."""
    c, s = np.cos(ang), np.sin(ang)
    out = np.array(a, float, copy=True)
    out[..., 0], out[..., 2] = c * a[..., 0] - s * a[..., 2], s * a[..., 0] + c * a[..., 2]
    return out


def stress(sand, hid, pos, vel, nrm, acc_n, width, ctx):
    """True stress [Pa] on points. hid: hidden effects {id: value}; ctx: what the trial is (x_bed, pass, pass_dx, V, path, strength ...)."""
    speed = np.linalg.norm(vel, axis=-1)
    lead = np.sign((nrm * vel).sum(-1))
    lead = np.where(lead == 0, 1, lead)
    n = nrm * lead[..., None]                                # outward normal of the leading face
    vn = np.maximum((n * vel).sum(-1), 0)
    x, z = pos[..., 0], pos[..., 2]
    if 'slope' in hid:
        s = hid['slope']
        depth = (x * np.tan(s) - z) * np.cos(s)
        a = rot_y(sand.alpha(rot_y(vel, -s), rot_y(n, -s)), s)
    else:
        depth = -z
        a = sand.alpha(vel, n)
    wet = depth > 0
    depth = np.maximum(depth, 0)
    eff = depth
    if 'depth_power' in hid:
        eff = .02 * (depth / .02) ** (1 + hid['depth_power'])
    if 'out_saturation' in hid:
        z1 = hid['out_saturation']
        eff = z1 * (1 - np.exp(-depth / z1))
    if 'out_archimedes' in hid:                              # a dead zone that must build up below the surface first
        z1 = hid['out_archimedes']
        eff = depth * (1 - .6 * np.exp(-(depth / z1) ** 2))
    fac = np.full(depth.shape, ctx['strength'])
    fac = fac * (1 + hid.get('scale', 0))
    if 'footprint' in hid and ctx['pass'] >= 2:
        fac = fac * (1 - hid['footprint'] * np.exp(-ctx['pass_dx'] / .03))
    if 'packing_grad' in hid:
        fac = fac * np.maximum(.2, 1 + hid['packing_grad'] * (ctx['x_bed'] + x) / .1)
    if 'rate_log' in hid:
        fac = fac * np.maximum(.2, 1 + hid['rate_log'] * np.log(1 + speed / .01))
    if 'out_hardpan' in hid:
        h, ell, amp = hid['out_hardpan']
        fac = fac * (1 + amp * np.exp(-np.maximum(h - depth, 0) / ell))
    if 'out_wall' in hid:
        xw, ell, amp = hid['out_wall']
        fac = fac * (1 + amp * np.exp(-np.maximum(xw - ctx['x_bed'] - x, 0) / ell))
    if 'out_weakening' in hid:
        v0, amp = hid['out_weakening']
        fac = fac * (1 - amp * speed / (speed + v0))
    if 'out_peak_rate' in hid:                               # weakens, then hardens
        v0, amp = hid['out_peak_rate']
        fac = fac * (1 + amp * (np.tanh((speed / v0) ** 2) - 1.6 * np.exp(-((np.log(np.maximum(speed, 1e-6) / (.25 * v0))) ** 2))))
    if 'out_loosening' in hid:
        ell, amp = hid['out_loosening']
        fac = fac * (1 - amp * (1 - np.exp(-ctx['path'] / ell)))
    if 'out_fabric' in hid:
        fac = fac * (1 + hid['out_fabric'] * vel[..., 0] / np.maximum(speed, 1e-9))
    if 'out_size' in hid:
        fac = fac * (ctx['size'] / .03) ** hid['out_size']
    if 'out_drying' in hid:
        fac = fac * (1 + hid['out_drying'] * (ctx['order'] - .5))
    s_ = a * (eff * fac)[..., None]
    if 'friction_clip' in hid and hid['friction_clip'] > 0:
        mu = 1 / hid['friction_clip']
        sn = (s_ * n).sum(-1, keepdims=True)
        st = s_ - sn * n
        cap = mu * np.abs(sn)
        s_ = sn * n + st * np.minimum(1, cap / np.maximum(np.linalg.norm(st, axis=-1, keepdims=True), 1e-12))
    V = ctx.get('V')
    if V is not None and np.hypot(V[0], V[1]) > 3e-4:
        Vm = np.hypot(V[0], V[1])
        Vh = np.array([V[0], V[1], 0]) / Vm
        if 'graze_loss' in hid:
            nh = np.hypot(n[..., 0], n[..., 1])
            along = np.abs(n @ Vh) / np.maximum(nh, 1e-12)
            s_ = s_ * (1 - hid['graze_loss'] * nh ** 8 * (1 - along))[..., None]
        if 'skid_loss' in hid:
            rel = np.linalg.norm(vel - np.array([V[0], V[1], 0]), axis=-1)
            slip = -(vel @ Vh) / np.maximum(np.maximum(Vm, rel), 1e-12)
            s_[..., 2] = np.where(slip < 0, s_[..., 2] / (1 + hid['skid_loss'] * slip ** 2), s_[..., 2])
    extra = np.zeros(depth.shape)
    if 'inertial_drag' in hid:
        extra = extra + hid['inertial_drag'] * sand.rho * vn ** 2
    if 'added_mass' in hid:
        extra = extra + hid['added_mass'] * sand.rho * width * acc_n * lead
    if 'cohesion' in hid:
        extra = extra + hid['cohesion'] * np.tanh(vn / 1e-3)
    if 'out_viscous' in hid:
        extra = extra + hid['out_viscous'] * vn
    if 'out_drag15' in hid:
        extra = extra + hid['out_drag15'] * sand.rho * vn ** 1.5
    s_ = s_ - extra[..., None] * n
    return np.where(wet[..., None], s_, 0.)


# ---- shapes: mid-line pieces in the body's frame, (x, z) of centres, unit tangents, lengths ----

def leg_line(chord, xi, n=60):
    knee = chord * np.array([np.cos(xi) * np.sin(xi), -np.cos(xi) ** 2])
    tip = chord * np.array([0., -1.])
    pts = [np.zeros(2), knee, tip]
    mid, tan, ln = [], [], []
    total = np.linalg.norm(knee) + np.linalg.norm(tip - knee)
    for a, b in zip(pts[:-1], pts[1:]):
        L = np.linalg.norm(b - a)
        if L < 1e-9:
            continue
        k = max(4, int(round(n * L / total)))
        u = (np.arange(k) + .5) / k
        mid += list(a + u[:, None] * (b - a))
        tan += [(b - a) / L] * k
        ln += [L / k] * k
    return np.array(mid), np.array(tan), np.array(ln)


def plate_line(length, n=40):
    u = ((np.arange(n) + .5) / n - .5) * length
    return np.stack([u, 0 * u], 1), np.tile([1., 0.], (n, 1)), np.full(n, length / n)


def kinematics(mid, tan, ang, origin, t, angle0=0.):
    """Positions and normals of the pieces, all as (T, S, 3), turned counter-clockwise by ang + angle0 about origin."""
    a = (ang + angle0)[:, None]
    c, s = np.cos(a), np.sin(a)
    x = c * mid[None, :, 0] - s * mid[None, :, 1] + origin[:, None, 0]
    z = s * mid[None, :, 0] + c * mid[None, :, 1] + origin[:, None, 1]
    tx, tz = c * tan[None, :, 0] - s * tan[None, :, 1], s * tan[None, :, 0] + c * tan[None, :, 1]
    zero = np.zeros_like(x)
    pos = np.stack([x, zero, z], -1)
    nrm = np.stack([tz, zero, -tx], -1)                      # tangent (cos β, sin β) -> normal (sin β, -cos β)
    vel = np.stack([np.gradient(x, t, axis=0), zero, np.gradient(z, t, axis=0)], -1)
    return pos, vel, nrm


def trial_force(sand, hid, tr, geo):
    """Force and torque (T, 3: Fx, Fz, Ty) of the sand on the intruder of trial tr, at its fine instants, noise-free.
    geo: what the intruder truly is {size factors, attitude, joint zero}; the trial's own motion is as logged."""
    t = tr['t']
    sh = tr['shape_def']
    fl, fw = geo.get('length', 1.), geo.get('width', 1.)
    width = sh['width'] * fw
    depth0 = tr.get('depth_zero', 0.)
    ctx = dict(tr['ctx'])
    if sh['type'] == 'leg':
        xi = np.deg2rad(sh['xi_deg'])
        mid, tan, ln = leg_line(sh['chord'] * fl, xi)
        ang = tr['theta'] + geo.get('joint_zero', 0.)
        origin = np.stack([np.zeros_like(t), np.full_like(t, tr['hip_z'])], 1)
        ctx['size'] = width
    else:
        mid, tan, ln = plate_line(sh['length'] * fl)
        ang = np.full_like(t, tr['beta'] + geo.get('attitude', 0.) + tr.get('attitude', 0.))
        origin = np.stack([tr['x'], tr['z']], 1)
        ctx['size'] = min(width, sh['length'] * fl)

    def total(mid, tan, ln):
        pos, vel, nrm = kinematics(mid, tan, ang, origin, t)
        h = sh.get('thickness', 0.) / 2
        if h:
            sgn = np.sign((nrm * vel).sum(-1, keepdims=True))
            pos = pos + nrm * sgn * h
        pos[..., 2] -= depth0
        ctx['path'] = tr['path'][:, None]
        vn_signed = (nrm * vel).sum(-1)
        acc_n = np.gradient(vn_signed, t, axis=0)
        s = stress(sand, hid, pos, vel, nrm, acc_n, width, ctx)
        f = s * (ln * width)[None, :, None]
        rx, rz = pos[..., 0] - origin[:, None, 0], pos[..., 2] + depth0 - origin[:, None, 1]
        ty = (rx * f[..., 2] - rz * f[..., 0]).sum(1)
        return np.stack([f[..., 0].sum(1), f[..., 2].sum(1), ty], 1)

    F = total(mid, tan, ln)
    if 'concave_fill' in hid and sh['type'] == 'leg' and sh['xi_deg'] != 0:
        concave = np.sign(sh['xi_deg']) * np.sign(tr['omega']) < 0          # ξ > 0: convex leads when the tip moves to +x
        cm, ct, cl = leg_line(sh['chord'] * fl, 0.)
        chi = hid['concave_fill']
        F = np.where(concave[:, None], (1 - chi) * F + chi * total(cm, ct, cl), F)
    if sh['type'] == 'plate' and sh.get('thickness') and 'inertial_drag' in hid:
        h = sh['thickness']
        k = 6
        for sgn in (1, -1):
            u = ((np.arange(k) + .5) / k - .5) * h
            m2 = np.stack([np.full(k, sgn * sh['length'] * fl / 2), u], 1)
            F = F + _side(sand, hid, m2, np.tile([0., float(sgn)], (k, 1)), np.full(k, h / k * width), ang, origin, t, depth0, ctx)
    return F


def _side(sand, hid, mid, tan, dA, ang, origin, t, depth0, ctx):
    pos, vel, nrm = kinematics(mid, tan, ang, origin, t)
    pos[..., 2] -= depth0
    only = {'inertial_drag': hid['inertial_drag']}            # the law gives the sides no stress of their own
    bare = Sand('li2013', np.zeros(9), sand.rho)
    s = stress(bare, only, pos, vel, nrm, np.zeros(pos.shape[:2]), 0., {**ctx, 'strength': 1.})
    s = np.where(((nrm * vel).sum(-1) > 0)[..., None], s, 0.)
    f = s * dA[None, :, None]
    rx, rz = pos[..., 0] - origin[:, None, 0], pos[..., 2] + depth0 - origin[:, None, 1]
    return np.stack([f[..., 0].sum(1), f[..., 2].sum(1), (rx * f[..., 2] - rz * f[..., 0]).sum(1)], 1)


# ---- balls and wheels in steady motion under a load (kind = "intruder") ----

def sphere_points(r, n=1500):
    i = np.arange(n) + .5
    ph, th = np.arccos(1 - 2 * i / n), np.pi * (1 + 5 ** .5) * i
    u = np.stack([np.cos(th) * np.sin(ph), np.sin(th) * np.sin(ph), np.cos(ph)], 1)
    return r * u, u, np.full(n, 4 * np.pi * r * r / n)


def cylinder_points(r, w, na=180, nw=8, nr=10):
    a = (np.arange(na) + .5) / na * 2 * np.pi
    y = ((np.arange(nw) + .5) / nw - .5) * w
    A, Y = np.meshgrid(a, y, indexing='ij')
    n = np.stack([np.cos(A), 0 * A, np.sin(A)], -1).reshape(-1, 3)
    p = n * r
    p[:, 1] = Y.reshape(-1)
    pos, nrm, dA = [p], [n], [np.full(len(p), 2 * np.pi * r * w / (na * nw))]
    rr = (np.arange(nr) + .5) / nr * r
    R, A = np.meshgrid(rr, a, indexing='ij')
    for s in (1, -1):
        q = np.stack([R * np.cos(A), np.full_like(R, s * w / 2), R * np.sin(A)], -1).reshape(-1, 3)
        pos.append(q)
        nrm.append(np.tile([0., s, 0.], (len(q), 1)))
        dA.append((R * (r / nr) * (2 * np.pi / na)).reshape(-1))
    return np.concatenate(pos), np.concatenate(nrm), np.concatenate(dA)


def body_force(sand, hid, body, V, W, depth, mu_s, strength, ctx):
    """Force on a body whose lowest point is `depth` below the surface."""
    r = body['radius']
    pos, nrm, dA = sphere_points(r) if body['kind'] == 'sphere' else cylinder_points(r, body['width'])
    pos = pos + np.array([0, 0, r - depth])
    vel = np.array(V) + np.cross(np.array(W), pos - np.array([0, 0, r - depth]))
    lead = ((nrm * vel).sum(1) > 0) & (pos[:, 2] < 0)
    if not lead.any():
        return np.zeros(3)
    p, v, n, a = pos[lead], vel[lead], nrm[lead], dA[lead]
    c = {**ctx, 'strength': strength, 'V': V, 'size': 2 * r, 'path': np.zeros(len(p)), 'pass': 1, 'pass_dx': 0., 'x_bed': 0.}
    law = sand
    if sand.law == 'agarwal2023':
        class Frictional(Sand):
            def alpha(self, v, n):
                return agarwal2023(self.coef[0], v, n, mu_s, self.coef[1:4])
        law = Frictional(sand.law, sand.coef, sand.rho)
    elif mu_s:
        hid = {**hid, 'friction_clip': 1 / mu_s}
    s = stress(law, hid, p, v, n, np.zeros(len(p)), 0., c)
    return (s * a[:, None]).sum(0)


def sinkage(sand, hid, body, V, W, load, mu_s, strength, ctx):
    lo, hi = 1e-4, 2 * body['radius'] * .98
    f = lambda d: body_force(sand, hid, body, V, W, d, mu_s, strength, ctx)[2] - load
    ds = np.linspace(lo, hi, 24)
    prev = lo
    for d in ds:
        if f(d) >= 0:
            a, b = prev, d
            for _ in range(28):
                m = .5 * (a + b)
                a, b = (a, m) if f(m) >= 0 else (m, b)
            return b
        prev = d
    return None
