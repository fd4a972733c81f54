"""Wheels with constants from the discs alone (agarwal2023, numpy). Called by proto.py."""
import csv, re
import numpy as np
import proto
R, W, G = .0625, .06, .02
src = open('src/sand/law/agarwal2023.rs').read()
COEF = np.array([[float(a) for a in m] for m in re.findall(r'\[(-?\d\.\d{5}), (-?\d\.\d{5}), (-?\d\.\d{5})\]', src)][:20])
ANCHOR = .87574
def alpha(n, v):
    """stress per depth / xi_n and outward normal n, velocity v (rows); sand pushes only on the leading side"""
    sp = np.linalg.norm(v, axis=1) + 1e-12; u = v / sp[:, None]
    N = np.where(n[:, 2:] > 0, -n, n)
    x1, x2, x3 = -u[:, 2], -N[:, 2], (N * u).sum(1); o = np.ones_like(x1)
    T = np.array([o, x1, x2, x3, x1**2, x2**2, x3**2, x1*x2, x2*x3, x3*x1, x1**3, x2**3, x3**3, x1*x2**2, x2*x1**2, x2*x3**2, x3*x2**2, x3*x1**2, x1*x3**2, x1*x2*x3])
    f = COEF.T @ T
    a = f[0][:, None] * N + f[1][:, None] * u; a[:, 2] -= f[2]
    an = (a * n).sum(1); at = a - an[:, None] * n
    return an, at, (n * u).sum(1)
def wheel(nr=180, ny=6, nd=12):
    th = (np.arange(nr) + .5) / nr * 2 * np.pi; y = W * ((np.arange(ny) + .5) / ny - .5)
    T, Y = map(np.ravel, np.meshgrid(th, y, indexing='ij'))
    pos = [np.c_[R*np.sin(T), Y, -R*np.cos(T)]]; nor = [np.c_[np.sin(T), 0*T, -np.cos(T)]]; ar = [np.full(T.size, 2*np.pi*R*W/T.size)]
    r = R * np.sqrt((np.arange(nd) + .5) / nd); t2 = (np.arange(72) + .5) / 72 * 2 * np.pi
    Q, S = map(np.ravel, np.meshgrid(r, t2, indexing='ij'))
    for s in (-1, 1):
        pos.append(np.c_[Q*np.sin(S), 0*Q + s*W/2, -Q*np.cos(S)]); nor.append(np.c_[0*Q, 0*Q + s, 0*Q]); ar.append(np.full(Q.size, np.pi*R*R/Q.size))
    return np.concatenate(pos), np.concatenate(nor), np.concatenate(ar)
POS, NOR, AR = wheel()
S_MAX = .1015   # greatest z + cD in the discs: strength is not extrapolated beyond it
def size_of(rule, w, r, n, a):
    """One length of the body's footprint, seen from above, of the plates that push sand (w = gate)"""
    q = a * np.clip(-n[:, 2], 0, None) * w; A = q.sum()
    if rule == 'area': return np.sqrt(4 * A / np.pi)
    if rule == 'width': return W
    if rule == 'gyration':   # 4 x smaller radius of gyration: diameter of a disc, 1.155 x the smaller side of a rectangle
        if A <= 0: return 0.
        m = (q[:, None] * r[:, :2]).sum(0) / A; d = r[:, :2] - m; C = (q[:, None, None] * d[:, :, None] * d[:, None, :]).sum(0) / A
        return 4 * np.sqrt(max(np.linalg.eigvalsh(C)[0], 0))
    return 0.
def force(depth, vel, wy, zeta, rule, ahead, mu, bearing):
    """zeta(s) [N/m3], s = z + c B (-v_z/|v|)+ if ahead, z + c B otherwise"""
    pos = POS + [0, 0, R - depth]; z = np.clip(-pos[:, 2], 0, None); k = z > 0
    if not k.any(): return np.zeros(3)
    z, n, a, r = z[k], NOR[k], AR[k], POS[k]
    v = np.asarray(vel, float) + wy * np.c_[r[:, 2], 0*z, -r[:, 0]]; sp = np.linalg.norm(v, axis=1) + 1e-12
    an, at, lead = alpha(n, v); gate = np.clip(lead / G, 0, 1); an = np.abs(an)
    V = np.array(vel[:2]); d = v[:, :2] - V; gr = np.maximum(V @ V, (d**2).sum(1) + v[:, 2]**2)
    if V @ V > 0:
        slip = -(v[:, :2] @ V) / (np.sqrt((V @ V) * gr) + 9e-8)
        an = an + bearing * max(0, 1 - mu)**1.5 * ANCHOR * np.clip(slip, 0, None) * np.clip(-n[:, 2], 0, None)
    tn = np.linalg.norm(at, axis=1) + 1e-12; at = at * np.minimum(1, mu * an / tn)[:, None]
    s = z + proto.C_TH * size_of(rule, gate, r, n, a) * (np.clip(-v[:, 2] / sp, 0, 1) if ahead else 1.)
    return ((-an[:, None] * n + at) * (zeta(np.minimum(s, S_MAX)) * z / ANCHOR * a * gate)[:, None]).sum(0)
def models(T):
    e, f, p = T['influence exp, c = .849 (2 constants)'], T['influence floor m=4, c = .849 (2 constants)'], T['plain RFT: zeta z']
    ex, fl = lambda s: np.exp(e[0] + s / np.exp(e[1])), lambda s: np.exp(f[0]) * (1 + (s / np.exp(f[1]))**4)
    return [('plain, .829 N/cm3 (present sand_discs)', lambda s: .829e6 + 0*s, 'none', 0), ('plain, .706 N/cm3 (zeta0 of floor4)', lambda s: np.exp(f[0]) + 0*s, 'none', 0), ('plain, zeta of all discs', lambda s: np.exp(p[0]) + 0*s, 'none', 0),
            ('exp, width', ex, 'width', 0), ('exp, width, ahead', ex, 'width', 1),
            ('floor4, depth only (c = 0)', fl, 'none', 0),
            ('floor4, area', fl, 'area', 0), ('floor4, area, ahead', fl, 'area', 1), ('floor4, width', fl, 'width', 0), ('floor4, width, ahead', fl, 'width', 1),
            ('floor4, gyration', fl, 'gyration', 0), ('floor4, gyration, ahead', fl, 'gyration', 1)]
def rows(name):
    return [{k: (float(x) if k not in ('trial', 'wheel', 'date') else x) for k, x in r.items()} for r in csv.DictReader(open(proto.SRC + name)) if abs(float(r['slip_angle_nominal_deg'])) <= 60.5]
def run(T):
    print('\nWheels pushed straight down, 2021 (no number fitted to them): mean |F/Fm - 1| %, bias ln %, and the spread of the bias with depth: mean ln(F/Fm) in thirds of depth (%)')
    for name, law, rule, ahead in models(T):
        out = []
        for body, mu in (('wheel_smooth', .46), ('wheel_grouser', .70)):
            q = np.array([[np.log(force(z, (0, 0, -1e-2), 0, law, rule, ahead, mu, 0)[2] / F) for z, F in zip(v['z'] , v['F'])] for v in proto.P.values() if v['body'] == body])
            out.append('%5.1f %+5.0f (%s)' % (100 * abs(np.exp(q) - 1).mean(), 100 * q.mean(), ' '.join('%+3.0f' % (100 * q[:, i:i+4].mean()) for i in (0, 4, 8))))
        print('  %-40s smooth %s   grouser %s' % (name, *out))
    print('\nMoving wheels, slip angle <= 60 deg, forces at measured sinkage, rms in % of mean load; sinkage under measured load rms mm [n without equilibrium]; slip_bearing 1, mu .46/.70; no other mechanism')
    data = [(r, mu) for f, mu in (('wheel_smooth.csv', .46), ('wheel_grouser.csv', .70)) for r in rows(f)]
    for name, law, rule, ahead in models(T):
        res, sink = [], []
        for r, mu in data:
            b = np.radians(r['slip_angle_deg']); vel = (r['V_m_per_s']*np.cos(b), -r['V_m_per_s']*np.sin(b), 0.); f = lambda d: force(d, vel, r['omega_rad_per_s'], law, rule, ahead, mu, 1.)
            p = f(r['sinkage_m']); res.append(p - [r['Fx_N'], r['Fy_N'], r['Fz_N']])
            ds = np.linspace(.004, .11, 22); fz = [f(d)[2] for d in ds]; i = next((i for i, x in enumerate(fz) if x > r['Fz_N']), None)
            sink.append(np.nan if i is None else (ds[0] if i == 0 else ds[i-1] + (r['Fz_N'] - fz[i-1]) / (fz[i] - fz[i-1]) * (ds[i] - ds[i-1])) - r['sinkage_m'])
        res, sink = np.array(res), np.array(sink); load = np.mean([r['Fz_N'] for r, _ in data]); s = np.array([r['slip'] for r, _ in data])
        line = []
        for lab, k in (('all', s < 9), ('locked', s < -.9), ('|s|<=.55', abs(s) <= .55), ('spin', s > .55)):
            e = 100 * np.sqrt((res[k]**2).mean(0)) / load; line.append('%s %d: %4.1f %4.1f %4.1f bias %+3.0f, %4.1f mm' % (lab, k.sum(), *e, 100 * res[k, 2].mean() / load, 1e3 * np.sqrt(np.nanmean(sink[k]**2))))
        print('  %-40s %s [%d]' % (name, ' | '.join(line), np.isnan(sink).sum()))
    print('\nPushed wheels by "power and size" k z^n B^q (constants from the discs), mean error % (bias ln %)')
    law = [l for l in proto.LAWS if l[0].startswith('power and size')][0]; t = T[law[0]]
    for rule in ('area', 'width', 'gyration'):
        out = []
        for body, mu in (('wheel_smooth', .46), ('wheel_grouser', .70)):
            q = []
            for z, F in ((z, F) for u in proto.P.values() if u['body'] == body for z, F in zip(u['z'], u['F'])):
                deep = np.clip(depth_of(z), 0, None); k = deep > 0; n, a = NOR[k], AR[k]
                an, at, lead = alpha(n, np.tile([0, 0, -.01], (k.sum(), 1))); gate = np.clip(lead / G, 0, 1); an = np.abs(an)
                at = at * np.minimum(1, mu * an / (np.linalg.norm(at, axis=1) + 1e-12))[:, None]
                p = law[1](deep[k], max(size_of(rule, gate, POS[k], n, a), 1e-6), t)
                q.append(np.log((((-an[:, None] * n + at) * (p / ANCHOR * a * gate)[:, None]).sum(0)[2]) / F))
            out.append('%.1f (%+.0f)' % (100 * np.mean(abs(np.exp(q) - 1)), 100 * np.mean(q)))
        print('  %-9s smooth %s, grouser %s' % (rule, *out))
def depth_of(depth): return -(POS[:, 2] + R - depth)
