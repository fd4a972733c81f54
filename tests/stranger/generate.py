"""Force logs as a laboratory would have them, with the truth beside them.  make(seed, index, kind) -> (data.csv text, exp.toml text, truth dict)"""
import json, numpy as np
from lab import *

KINDS = ['nulls', 'singles', 'outside', 'weaker', 'geometry']
D = np.deg2rad
ALL_MESS = ['white', 'grain', 'offset', 'drift', 'gain', 'cross', 'latency', 'filter', 'attitude', 'joint_zero', 'size', 'origin', 'strength', 'day', 'surface', 'outliers', 'coefficients', 'jitter']

SINGLES = {'inertial_drag': [.6, 1.5, 3.], 'concave_fill': [.3, .6, .9], 'footprint': [.15, .35, .6], 'added_mass': [1., 3., 8.],
           'depth_power': [-.25, .15, .35], 'cohesion': [150., 300., 600.], 'packing_grad': [.06, .15, .3], 'slope': [.04, .1, .2],
           'rate_log': [-.08, .04, .08, .15], 'friction_clip': [1.5, 3., 6.]}
BODY_SINGLES = {'inertial_drag': [.5, 1.5], 'cohesion': [200., 600.], 'depth_power': [-.2, .3], 'rate_log': [.05, .12], 'skid_loss': [.5, 1., 2.], 'graze_loss': [.3, .7]}
OUTSIDE = ['out_saturation', 'out_archimedes', 'out_hardpan', 'out_wall', 'out_weakening', 'out_peak_rate', 'out_loosening', 'out_fabric', 'out_size',
           'out_drying', 'out_viscous', 'out_drag15', 'out_stick_slip']
GEOMETRY = ['attitude', 'joint_zero', 'size', 'delay', 'sensor_tilt', 'depth_zero']


def ar1(rng, s, ell):
    """Unit-variance noise with correlation exp(-Δs/ell) along the non-decreasing coordinate s."""
    e = rng.standard_normal(len(s))
    out = np.empty(len(s))
    out[0] = e[0]
    r = np.exp(-np.maximum(np.diff(s), 0) / ell)
    for i in range(1, len(s)):
        out[i] = r[i - 1] * out[i - 1] + np.sqrt(1 - r[i - 1] ** 2) * e[i]
    return out


def lowpass(t, y, tau):
    if tau <= 0:
        return y
    out = y.copy()
    a = 1 - np.exp(-np.diff(t) / tau)
    for i in range(1, len(t)):
        out[i] = out[i - 1] + a[i - 1] * (.5 * (y[i] + y[i - 1]) - out[i - 1])
    return out


def pick_sand(rng, law=None):
    law = law or 'li2013'
    if law == 'agarwal2023':
        zeta = float(rng.choice([.254, .33, .829, 1.4])) * 1e6
        rho = {.254e6: 638., .33e6: 1500., .829e6: 1330., 1.4e6: 1500.}[zeta]
        return Sand(law, np.array([zeta / .87574, 1., 1., 1.]), rho), f'[sand]\nzeta = {zeta / 1e6}\nbulk_density = {rho}\n', None
    k = rng.integers(4)
    if k == 0:
        return Sand(law, LOOSE.copy(), 638.), None, 'poppy-loose'
    if k == 1:
        return Sand(law, CLOSE.copy(), 680.), None, 'poppy-close'
    if k == 2:
        return Sand(law, GENERIC * .33, 1500.), None, 'glass-beads'
    zeta, rho = float(rng.choice([.46, .7, 1.24, 2.02])), float(rng.choice([1330., 1467., 1600.]))
    coef = GENERIC * zeta
    if rng.random() < .5:
        return Sand(law, coef, rho), f'[sand]\nzeta = {zeta}\nbulk_density = {rho}\n', None
    body = ''.join(f'{n} = {c:.6g}\n' for n, c in zip(C_NAMES, coef))
    return Sand(law, coef, rho), f'[sand]\nname = "mine"\nbulk_density = {rho}\n[sand.coefficients]\n{body}', None


def pick_shapes(rng, need_leg, need_plate, need_rev, two_sizes):
    shapes = {}
    if need_leg:
        chord, w, th = float(rng.uniform(.05, .1)), float(rng.uniform(.015, .03)), float(rng.choice([0, 0, 0, .004]))
        xi = float(rng.choice([30, 45, 45, 60]))
        names = [('legL', xi), ('legR', -xi), ('legF', 0.)]
        keep = [True, need_rev or rng.random() < .7, rng.random() < .6]
        for (n, x), k in zip(names, keep):
            if k:
                shapes[n] = dict(type='leg', chord=round(chord, 4), width=round(w, 4), xi_deg=x)
                if th:
                    shapes[n]['thickness'] = th
    if need_plate:
        th = float(rng.choice([0, 0, .003, .006]))
        for i in range(2 if two_sizes else 1):
            f = 1 + i * rng.uniform(.5, 1.2)
            L, w = rng.uniform(.02, .04) * f, rng.uniform(.02, .04) * f
            shapes[f'plate{i}'] = dict(type='plate', length=round(float(L), 4), width=round(float(w), 4))
            if th:
                shapes[f'plate{i}']['thickness'] = th
    return shapes


ANGLES = [(0, 90), (0, 90), (90, 0), (90, 0), (45, 45), (-45, 45), (30, 60), (-30, 20), (60, 30), (90, 45), (-60, 60), (15, 75), (30, 0), (60, -30), (-60, -30)]


def design(rng, shapes, n_cond, speeds, has_pass, has_place, modulate, both_ways, cover):
    """Conditions: dicts of what is set on the rig. `cover` is what the hidden effect needs to be seen at all."""
    conds, seen = [], set()
    names = list(shapes)
    tries = 0
    while len(conds) < n_cond and tries < 500:
        tries += 1
        name = names[len(conds) % len(names)] if rng.random() < .7 else str(rng.choice(names))
        sh = shapes[name]
        lo, hi = speeds
        v = float(np.exp(rng.uniform(np.log(lo), np.log(hi))))
        c = dict(shape=name, **{'pass': 1, 'pass_dx': 0.}, x_bed=0., mod=bool(modulate and rng.random() < .6))
        if sh['type'] == 'leg':
            depth = rng.uniform(.02, min(.08, sh['chord'] * .95))
            c.update(hip_z=round(float(sh['chord'] - depth), 4), omega=round(v / (.7 * sh['chord']), 3) * (-1 if both_ways and rng.random() < .45 else 1),
                     th0=float(rng.uniform(-1.6, -.9)), th1=float(rng.uniform(.8, 1.5)))
            key = (name, c['hip_z'], c['omega'])
        else:
            b, g = ANGLES[rng.integers(len(ANGLES))]
            half = sh['length'] / 2 * abs(np.sin(D(b)))
            if g == 0:
                z0 = z1 = -float(rng.uniform(max(.012, half * rng.uniform(.5, 1)), .075))
                run = float(rng.uniform(.03, .08))
            elif g > 0:
                deep = float(rng.uniform(.03, .08))
                z0, z1 = (half + .002 if rng.random() < .6 else -half - .003), -deep
                z0 = max(z0, z1 + .02)
                run = (z0 - z1) / np.sin(D(g))
            else:
                z0, z1 = -float(rng.uniform(.04, .075)), -max(half * .3, .004)
                run = (z0 - z1) / np.sin(D(g))
            c.update(beta=float(D(b)), gamma=float(D(g)), speed=round(v, 4), z0=round(float(z0), 4), run=float(abs(run)))
            key = (name, b, g, round(z0, 3), c['speed'])
        if has_pass and len(conds) >= 1 and rng.random() < .45:
            c.update({'pass': int(rng.choice([2, 2, 3])), 'pass_dx': float(rng.choice([0., .01, .02, .04]))})
        if has_place:
            c['x_bed'] = float(np.round(rng.uniform(-.12, .12), 3))
        if key in seen:
            continue
        seen.add(key)
        conds.append(c)
    return conds


def motion(rng, sh, c, ramp, n=None):
    """Fine-grained motion of one trial (slightly different speed each time)."""
    n = n or 420
    u = np.linspace(0, 1, n)
    if ramp > 0:                                             # speed profile over relative time, starts and ends slow
        prof = np.clip(np.minimum(u / ramp, (1 - u) / ramp), .02, 1)
    else:
        prof = np.ones(n)
    if c['mod']:
        prof = prof * (1 + .5 * np.sin(2 * np.pi * 2.5 * u))
    way = np.concatenate([[0], np.cumsum(.5 * (prof[1:] + prof[:-1]) * np.diff(u))])
    k = way[-1]
    f = 1 + .003 * rng.standard_normal()
    tr = dict(shape_def=sh, hip_z=c.get('hip_z'))
    if sh['type'] == 'leg':
        om = c['omega'] * f
        T = (c['th1'] - c['th0']) / (abs(om) * k)
        s = np.sign(om)
        start = c['th0'] if s > 0 else c['th1']
        tr['theta'] = start + s * (c['th1'] - c['th0']) * way / k
        tr['omega'] = om * prof
        t = u * T
        mid, _, ln = leg_line(sh['chord'], D(sh['xi_deg']))
        cx, cz = (mid * ln[:, None]).sum(0) / ln.sum()
        a = tr['theta']
        tr['x'], tr['z'] = cx * np.cos(a) - cz * np.sin(a), c['hip_z'] + cx * np.sin(a) + cz * np.cos(a)
        tr['vx'], tr['vz'] = tr['omega'] * (-cx * np.sin(a) - cz * np.cos(a)), tr['omega'] * (cx * np.cos(a) - cz * np.sin(a))
        tr['path'] = sh['chord'] * .8 * np.abs(a - a[0])
    else:
        v = c['speed'] * f
        T = c['run'] / (v * k)
        t = u * T
        d = c['run'] * way / k
        tr['beta'] = c['beta']
        tr['x'] = d * np.cos(c['gamma']) - .5 * c['run'] * np.cos(c['gamma'])
        tr['z'] = c['z0'] - d * np.sin(c['gamma'])
        tr['vx'], tr['vz'] = v * prof * np.cos(c['gamma']), -v * prof * np.sin(c['gamma'])
        tr['path'] = d
    tr['t'] = t
    return tr


def make(seed, index, kind, cause=None, off=(), only=None):
    """off: names of ALL_MESS to leave out; only: keep only these."""
    rng = np.random.default_rng([seed, index, KINDS.index(kind)])
    mess = set(ALL_MESS if only is None else only) - set(off)
    u = rng.random()
    bodies = u < (.12 if kind in ('nulls', 'weaker', 'singles', 'outside') else 0)
    if cause is None:
        if kind == 'singles':
            cause = list(BODY_SINGLES if bodies else SINGLES)[int(rng.integers(len(BODY_SINGLES if bodies else SINGLES)))]
        elif kind == 'outside':
            cause = ['out_saturation', 'out_size', 'out_hardpan'][int(rng.integers(3))] if bodies else OUTSIDE[int(rng.integers(len(OUTSIDE)))]
        elif kind == 'geometry':
            cause = GEOMETRY[int(rng.integers(len(GEOMETRY)))]
    if bodies:
        return make_bodies(rng, seed, index, kind, cause, mess)
    return make_intrusion(rng, seed, index, kind, cause, mess)


def make_intrusion(rng, seed, index, kind, cause, mess):
    M = lambda name, value: value if name in mess else 0.     # noqa: E731
    stated, sand_toml, medium = pick_sand(rng)              # li2013: the docs give kind = "intrusion" no way to state another law
    need_leg = rng.random() < .6 or cause in ('concave_fill', 'joint_zero')
    need_plate = rng.random() < .7 or cause in ('attitude', 'out_size') or not need_leg
    shapes = pick_shapes(rng, need_leg, need_plate, cause == 'concave_fill', rng.random() < .5 or cause == 'out_size')
    few = rng.random() < .35
    n_cond = int(rng.integers(3, 7)) if few else int(rng.integers(8, 25))
    reps = int(rng.choice([1, 2, 3, 3, 3, 4, 5])) if kind in ('nulls', 'weaker') else int(rng.choice([2, 3, 3, 3, 4, 5]))
    fastest = float(rng.choice([.05, .3, .6, 1.]))
    slowest = float(rng.choice([.005, .01, .02]))
    if cause in ('inertial_drag', 'added_mass', 'rate_log', 'out_weakening', 'out_peak_rate', 'out_viscous', 'out_drag15', 'delay'):
        fastest, slowest = float(rng.choice([.5, .7, 1.])), .03
    has_pass = rng.random() < .35 or cause == 'footprint'
    has_place = rng.random() < .65 or cause == 'packing_grad'
    pass_col, place_col = has_pass or rng.random() < .7, has_place or rng.random() < .5
    if cause not in ('footprint',) and rng.random() < .08:
        has_pass = pass_col = False
    ty = rng.random() < .75
    modulate = cause == 'added_mass' or rng.random() < .25
    both = cause == 'out_fabric' or rng.random() < .25
    conds = design(rng, shapes, n_cond, (slowest, fastest), has_pass, has_place, modulate, both, cause)
    shapes = {n: s for n, s in shapes.items() if any(c['shape'] == n for c in conds)}
    ramp = float(rng.choice([0, .06, .1]))
    coefficient_sd = float(rng.choice([.08, .08, .08, .15, .3]))

    # --- the true sand ---
    coef = stated.coef * (1 + M('coefficients', .03) * rng.standard_normal(len(stated.coef)))
    factor = 1.
    if kind == 'weaker':
        factor = float(rng.choice([-1, 1], p=[.6, .4]) * rng.uniform(.10, .50))
        factor = 1 + factor
        coef = coef * factor * (1 + (.06 if rng.random() < .5 else 0.) * rng.standard_normal(len(coef)))
    true = Sand(stated.law, coef, stated.rho)
    value, hid = None, {}
    if kind == 'singles':
        value = float(SINGLES[cause][int(rng.integers(len(SINGLES[cause])))] * rng.uniform(.85, 1.15))
        if cause == 'concave_fill':
            value = min(value, .95)
        if cause in ('packing_grad', 'slope') and rng.random() < .5:
            value = -value
        hid = {cause: value}
    elif kind == 'outside':
        amp = float(rng.uniform(.25, .7))
        hid = {'out_saturation': {'out_saturation': float(rng.uniform(.012, .04))}, 'out_archimedes': {'out_archimedes': float(rng.uniform(.012, .03))},
               'out_hardpan': {'out_hardpan': (float(rng.uniform(.07, .1)), float(rng.uniform(.008, .02)), float(rng.uniform(1, 3)))},
               'out_wall': {'out_wall': (float(rng.uniform(.06, .14)), float(rng.uniform(.015, .03)), float(rng.uniform(.6, 2)))},
               'out_weakening': {'out_weakening': (float(rng.uniform(.02, .15)), amp)}, 'out_peak_rate': {'out_peak_rate': (float(rng.uniform(.1, .4)), amp / 2)},
               'out_loosening': {'out_loosening': (float(rng.uniform(.01, .05)), amp)}, 'out_fabric': {'out_fabric': amp / 2},
               'out_size': {'out_size': float(rng.uniform(.25, .6)) * rng.choice([-1, 1])}, 'out_drying': {'out_drying': float(rng.uniform(.2, .5)) * rng.choice([-1, 1])},
               'out_viscous': {'out_viscous': float(rng.uniform(.2, .8)) * .03 * stated.zeta() / max(fastest, .3)},
               'out_drag15': {'out_drag15': float(rng.uniform(1, 4))}, 'out_stick_slip': {'out_stick_slip': (float(rng.uniform(.002, .008)), float(rng.uniform(.15, .4)))}}[cause]
        value = hid[cause]

    # --- the rig: what is the same in the whole log ---
    rig = {}
    geo = {}
    plates_att = M('attitude', float(np.clip(1.2 * rng.standard_normal(), -3, 3)))
    joint = M('joint_zero', float(rng.uniform(-.02, .02)))
    for n, s in shapes.items():
        g = dict(length=1 + M('size', float(rng.uniform(-.02, .02))), width=1 + M('size', float(rng.uniform(-.02, .02))))
        if s['type'] == 'leg':
            g['joint_zero'] = joint
        else:
            g['attitude'] = D(plates_att + M('attitude', .3 * rng.standard_normal()))
        geo[n] = g
    rig['latency'] = M('latency', float(rng.uniform(0, .004)))
    rig['filter'] = M('filter', float(rng.choice([0, .002, .005])))
    rig['gain'] = [1 + M('gain', float(rng.choice([.005, .01, .02]) * rng.standard_normal())) for _ in range(3)]
    rig['cross'] = (M('cross', 1) * .008 * rng.standard_normal((2, 2))).tolist()
    rig['origin'] = [M('origin', .001 * rng.standard_normal()) for _ in range(2)]
    rig['sensor_tilt'] = 0.
    rig['channel_delay'] = [0., 0., 0.]
    rig['depth_zero'] = 0.
    sign = float(rng.choice([-1, 1]))
    big = None
    if kind == 'geometry':
        if cause == 'attitude':
            big = sign * D(rng.uniform(2, 4))
            for n, s in shapes.items():
                if s['type'] == 'plate':
                    geo[n]['attitude'] = big
        elif cause == 'joint_zero':
            big = sign * float(rng.uniform(.03, .08))
            for n, s in shapes.items():
                if s['type'] == 'leg':
                    geo[n]['joint_zero'] = big
        elif cause == 'size':
            big = sign * float(rng.uniform(.04, .08))
            for n in shapes:
                geo[n].update(length=1 + big, width=1 + big)
        elif cause == 'delay':
            big = float(rng.uniform(.01, .03))
            ch = int(rng.integers(3))
            rig['channel_delay'] = [big] * 3 if ch == 2 else [big * (ch == 0), big * (ch == 1), 0.]
        elif cause == 'sensor_tilt':
            big = rig['sensor_tilt'] = sign * D(rng.uniform(2, 4))
        elif cause == 'depth_zero':
            big = rig['depth_zero'] = sign * float(rng.uniform(.002, .004))
        value = float(-big if cause == 'depth_zero' else big)  # the contract: true depth = logged depth + value
    days = int(rng.choice([1, 1, 2, 3]))
    day_factor = [float(np.exp(M('day', .04 if days > 1 else 0.) * rng.standard_normal())) for _ in range(days)]
    scatter = M('strength', float(rng.uniform(.05, .15) if rng.random() < .6 else rng.uniform(.01, .05)))
    grain = M('grain', float(rng.uniform(.01, .05)))
    grain_len = float(rng.uniform(.001, .004))
    white = M('white', float(rng.uniform(.004, .03)))
    offset_sd, drift_sd = M('offset', float(rng.uniform(.003, .03))), M('drift', float(rng.uniform(.002, .02)))
    surface_sd = M('surface', float(rng.uniform(.0002, .0008)))
    sampling = str(rng.choice(['even', 'jitter', 'rate']))
    n_samples = int(rng.integers(30, 100))
    own_place = has_place and rng.random() < .2
    blocked = rng.random() < .3                              # conditions done one after the other, not in random order

    # --- trials ---
    order = [(ci, r) for r in range(reps) for ci in range(len(conds))]
    if blocked:
        order = [(ci, r) for ci in range(len(conds)) for r in range(reps)]
    else:
        rng.shuffle(order)
    trials, forces, clean0 = [], [], []
    for k, (ci, r) in enumerate(order):
        c = conds[ci]
        sh = shapes[c['shape']]
        tr = motion(rng, sh, c, ramp)
        x_bed = c['x_bed'] if not own_place else float(np.round(rng.uniform(-.12, .12), 3))
        day = int(k * days / len(order))
        st = float(np.exp(scatter * rng.standard_normal())) * day_factor[day]
        tr['ctx'] = {'strength': st, 'pass': c['pass'], 'pass_dx': c['pass_dx'], 'x_bed': x_bed, 'order': k / max(1, len(order) - 1)}
        tr['depth_zero'] = float(np.clip(surface_sd * rng.standard_normal(), -2 * surface_sd, 2 * surface_sd)) - rig['depth_zero']
        if sh['type'] == 'plate':
            tr['attitude'] = D(M('attitude', .2) * rng.standard_normal())
        tr.update(ci=ci, rep=r, k=k, day=day, st=st)
        F = trial_force(true, hid, tr, geo[c['shape']])
        plain = dict(tr)
        plain['ctx'] = {**tr['ctx']}
        F0 = trial_force(true, {}, plain, geo[c['shape']]) if hid else F
        if kind == 'geometry':
            neutral = {k2: v for k2, v in geo[c['shape']].items()}
            for key, base in (('attitude', 0.), ('joint_zero', 0.)):
                if key in neutral:
                    neutral[key] = base
            neutral.update(length=1., width=1.)
            F0 = trial_force(true, hid, {**tr, 'depth_zero': tr['depth_zero'] + rig['depth_zero']}, neutral)
        if 'out_stick_slip' in hid:
            period, a = hid['out_stick_slip']
            ph = (tr['path'] / (period * (1 + .1 * rng.standard_normal())) + rng.random()) % 1
            F = F * (1 + a * (ph - .5) * 2)[:, None]
        trials.append(tr)
        forces.append(F)
        clean0.append(F0)
    level = np.sqrt(np.mean(np.concatenate(forces)[:, :2] ** 2))
    diff = np.sqrt(np.mean((np.concatenate(forces)[:, :2] - np.concatenate(clean0)[:, :2]) ** 2) / np.mean(np.concatenate(clean0)[:, :2] ** 2))
    rows, spikes = [], 0
    spike_rng = np.random.default_rng([seed, index, 99])      # of its own, so that leaving outliers out changes nothing else
    outliers = spike_rng.random() < .25 and 'outliers' in mess
    for tr, F in zip(trials, forces):
        c = conds[tr['ci']]
        t = tr['t']
        T = t[-1]
        g = np.stack([ar1(rng, tr['path'], grain_len), ar1(rng, tr['path'], grain_len)], 1)
        mag = np.hypot(F[:, 0], F[:, 1])
        Fm = F.copy()
        Fm[:, :2] += grain * g * mag[:, None]
        rx = tr['x'] if c['shape'].startswith('leg') else 0 * t
        rz = tr['z'] - c['hip_z'] if c['shape'].startswith('leg') else 0 * t
        arm = .15 * (shapes[c['shape']].get('length') or shapes[c['shape']]['chord'])
        Fm[:, 2] += grain * mag * (rx * g[:, 1] - rz * g[:, 0]) + grain * mag * arm * ar1(rng, tr['path'], grain_len)
        # the sensor: place, turn, cross-talk, gain, delay, filter
        S = Fm.copy()
        S[:, 2] += rig['origin'][1] * S[:, 0] - rig['origin'][0] * S[:, 1]
        a = rig['sensor_tilt']
        S[:, 0], S[:, 1] = np.cos(a) * S[:, 0] - np.sin(a) * S[:, 1], np.sin(a) * S[:, 0] + np.cos(a) * S[:, 1]
        X = np.array(rig['cross'])
        S[:, :2] = S[:, :2] + S[:, :2] @ np.array([[0, X[1, 0]], [X[0, 1], 0]])
        for j in range(3):
            y = lowpass(t, S[:, j], rig['filter']) * rig['gain'][j]
            S[:, j] = np.interp(t - rig['latency'] - rig['channel_delay'][j], t, y)
        # samples
        m = n_samples
        if sampling == 'rate':
            m = int(np.clip(T * 200, 14, n_samples))
        ts = np.linspace(.01 * T, .985 * T, m)
        if sampling == 'jitter':
            ts = np.sort(ts + rng.uniform(-.3, .3, m) * (ts[1] - ts[0]))
        ts = np.clip(ts, 0, T) if 'jitter' in mess else np.linspace(.01 * T, .985 * T, m)
        I = lambda y: np.interp(ts, t, y)                     # noqa: E731
        Y = np.stack([I(S[:, j]) for j in range(3)], 1)
        torque_scale = .5 * max(.02, shapes[c['shape']].get('chord', shapes[c['shape']].get('length')))
        for j, sc in enumerate([1, 1, torque_scale]):
            slow = ar1(rng, ts, .15 * T)
            Y[:, j] += level * sc * (white * rng.standard_normal(m) + .3 * white * slow + offset_sd * rng.standard_normal() + drift_sd * rng.standard_normal() * ts / T)
        if outliers:
            for i in np.flatnonzero(spike_rng.random(m) < .0015):
                Y[i, spike_rng.integers(2)] += level * spike_rng.choice([-1, 1]) * spike_rng.uniform(.3, 1.5)
                spikes += 1
        for i in range(m):
            leg = c['shape'].startswith('leg')
            row = [f"t{tr['k']:03d}", f"c{tr['ci']}", tr['rep'], 'leg' if leg else 'plate', c['shape'], medium or '', f"{c['hip_z']:.5f}" if leg else '',
                   '' if leg else f"{c['beta']:.6f}", '' if leg else f"{c['gamma']:.6f}", c['pass'], c['pass_dx'], tr['ctx']['x_bed'], f'{ts[i]:.6f}',
                   f"{I(tr['theta'])[i]:.6f}" if leg else '', f"{I(tr['omega'])[i]:.6f}" if leg else '']
            rows.append((tr['k'], row, ts[i], Y[i], tr))
    # write (interpolate the motion once a trial)
    head = ['trial', 'condition', 'rep', 'kind', 'shape', 'medium', 'hip_z', 'plate_beta', 'plate_gamma', 'pass', 'pass_dx', 'x_bed', 't', 'theta', 'omega', 'x', 'z', 'vx', 'vz', 'Fx', 'Fz', 'Ty']
    drop = set()
    if not pass_col:
        drop |= {'pass', 'pass_dx'}
    if not place_col:
        drop |= {'x_bed'}
    if not ty:
        drop |= {'Ty'}
    if all(r[1][3] == 'plate' for r in rows):
        drop |= {'hip_z', 'theta', 'omega'}
    if all(r[1][3] == 'leg' for r in rows):
        drop |= {'plate_beta', 'plate_gamma'}
    keep = [i for i, h in enumerate(head) if h not in drop]
    lines = [','.join(head[i] for i in keep)]
    for _, row, ti, y, tr in rows:
        mo = [f'{np.interp(ti, tr["t"], tr[q]):.6g}' for q in ('x', 'z', 'vx', 'vz')]
        full = row + mo + [f'{y[0]:.5g}', f'{y[1]:.5g}', f'{y[2]:.5g}']
        lines.append(','.join(str(full[i]) for i in keep))
    toml = 'kind = "intrusion"\n' + (f'medium = "{medium}"\n' if medium else '') + f'bulk_density = {stated.rho}\ncoefficient_sd = {coefficient_sd}\n'
    toml += (sand_toml or '')
    for n, s in shapes.items():
        toml += f'[shape.{n}]\n' + ''.join(f'{k} = {json.dumps(v)}\n' for k, v in s.items())
    truth = dict(seed=seed, index=index, kind=kind, form='intrusion', cause=cause, value=value, factor=factor, conditions=len(conds), reps=reps, rows=len(rows), days=days, blocked=bool(blocked),
                 stated=dict(zip(C_NAMES, stated.coef.tolist())), true=dict(zip(C_NAMES, coef.tolist())), coefficient_sd=coefficient_sd,
                 effect=float(diff), level=float(level), speeds=[slowest, fastest], shapes=list(shapes), pass_col=bool(pass_col), place_col=bool(place_col), Ty=bool(ty),
                 passes=bool(has_pass), mess=dict(scatter=scatter, grain=grain, white=white, offset=offset_sd, drift=drift_sd, surface=surface_sd, day=day_factor, outliers=spikes, rig=rig,
                                                 geo={n: {k: float(v) for k, v in g.items()} for n, g in geo.items()}, sampling=sampling, ramp=ramp))
    return '\n'.join(lines) + '\n', toml, truth


def make_bodies(rng, seed, index, kind, cause, mess):
    """Balls and wheels pushed or rolled under a load: one row for each steady state (kind = "intruder")."""
    M = lambda name, value: value if name in mess else 0.     # noqa: E731
    law = str(rng.choice(['agarwal2023', 'li2013'], p=[.8, .2]))
    stated, sand_toml, _ = pick_sand(rng, 'agarwal2023')
    zeta, rho = stated.zeta(), stated.rho
    if law == 'li2013':
        stated = Sand('li2013', GENERIC * zeta / 1e6, rho)
    coefficient_sd = float(rng.choice([.08, .15]))
    coef = stated.coef * (1 + M('coefficients', .03) * rng.standard_normal(len(stated.coef)))
    factor = 1.
    if kind == 'weaker':
        factor = 1 + float(rng.choice([-1, 1], p=[.6, .4]) * rng.uniform(.10, .50))
        coef = coef.copy()
        if law == 'li2013':
            coef *= factor
        else:
            coef[0] *= factor
    true = Sand(law, coef, rho)
    n_bodies = int(rng.integers(1, 4)) if cause != 'out_size' else 3
    bodies = {}
    wheel_needed = cause in ('skid_loss', 'graze_loss')
    for i in range(n_bodies):
        r = float(np.round(rng.uniform(.015, .03) * (1 + .5 * i), 4))
        if wheel_needed or rng.random() < .4:
            bodies[f'wheel{i}'] = dict(kind='cylinder', radius=r * 1.6, width=round(r * float(rng.uniform(.8, 1.4)), 4))
        else:
            bodies[f'ball{i}'] = dict(kind='sphere', radius=r)
    mu = {n: float(rng.choice([.3, .45, .6])) for n in bodies}
    value, hid = None, {}
    if kind == 'singles':
        value = float(BODY_SINGLES[cause][int(rng.integers(len(BODY_SINGLES[cause])))] * rng.uniform(.85, 1.15))
        value = min(value, .95) if cause == 'graze_loss' else value
        hid = {cause: value}
    elif kind == 'outside':
        hid = {'out_saturation': {'out_saturation': float(rng.uniform(.008, .02))}, 'out_size': {'out_size': float(rng.uniform(.3, .6)) * rng.choice([-1, 1])},
               'out_hardpan': {'out_hardpan': (float(rng.uniform(.02, .04)), float(rng.uniform(.005, .012)), float(rng.uniform(1, 3)))}}[cause]
        value = hid[cause]
    true_mu = {n: m * (1 + .1 * rng.standard_normal()) for n, m in mu.items()}
    true_body = {n: {**b, 'radius': b['radius'] * (1 + M('size', float(rng.uniform(-.01, .01))))} for n, b in bodies.items()}
    reps = int(rng.choice([2, 3, 4]))
    n_cond = int(rng.integers(5, 14))
    fastest = .5 if cause in ('inertial_drag', 'rate_log') else float(rng.choice([.02, .1, .5]))
    scatter = M('strength', float(rng.uniform(.03, .12)))
    white = M('white', float(rng.uniform(.01, .04)))
    dz = M('surface', .0007 * rng.standard_normal())
    gain = [1 + M('gain', .01 * rng.standard_normal()) for _ in range(2)]
    rows, eff, ref = [], [], []
    names = list(bodies)
    k = 0
    ci = 0
    tries = 0
    while ci < n_cond and tries < 60:
        tries += 1
        n = names[ci % len(names)]
        b = bodies[n]
        v = float(np.round(np.exp(rng.uniform(np.log(.01), np.log(fastest))), 4))
        slipang = float(rng.choice([0, 0, 15, 30, 60])) if b['kind'] == 'cylinder' else 0.
        wy = float(np.round(v / b['radius'] * rng.choice([0, .5, .8, 1., 1.3, 2.]), 3)) if b['kind'] == 'cylinder' else 0.
        V = np.array([v * np.cos(D(slipang)), -v * np.sin(D(slipang)), 0.])
        W = np.array([0, wy, 0.])
        # a load that sinks the body by a third of its radius, by the stated sand
        F = body_force(stated, {}, b, V, W, rng.uniform(.25, .8) * b['radius'], mu[n], 1., {})
        load0 = float(F[2])
        got = []
        for r in range(reps):
            st = float(np.exp(scatter * rng.standard_normal()))
            load = load0 * (1 + .02 * rng.standard_normal())
            ctx = {'order': k / (n_cond * reps)}
            if load0 <= 1e-3:
                break
            d = sinkage(true, hid, true_body[n], V, W, load, true_mu[n], st, ctx)
            d0 = sinkage(true, {}, true_body[n], V, W, load, true_mu[n], st, ctx) if hid else d
            if d is None or d > 1.9 * b['radius']:
                break
            F = body_force(true, hid, true_body[n], V, W, d, true_mu[n], st, ctx)
            got.append([f't{k}', f'c{ci}', r, n, *(f'{q:.5g}' for q in V), 0, f'{wy:.5g}', 0, f'{load:.4g}', f'{d + dz + .0003 * rng.standard_normal():.5g}',
                        f'{gain[0] * F[0] + white * load * rng.standard_normal():.4g}', f'{gain[1] * F[1] + white * load * rng.standard_normal():.4g}'])
            if d0 is not None:
                eff.append((d - d0) / b['radius'])
            k += 1
        if len(got) == reps:
            rows += got
            ci += 1
    head = 'trial,condition,rep,body,vx,vy,vz,wx,wy,wz,load,depth,Fx,Fy'
    toml = f'kind = "intruder"\nlaw = "{law}"\ncoefficient_sd = {coefficient_sd}\n' + f'[sand]\nzeta = {zeta / 1e6}\nbulk_density = {rho}\n'
    for n, b in bodies.items():
        spec = f"sphere:radius={b['radius']:.5g}" if b['kind'] == 'sphere' else f"cylinder:radius={b['radius']:.5g},width={b['width']:.5g}"
        toml += f'[body.{n}]\nbody = "{spec}"\nfriction = {mu[n]}\n'
    truth = dict(seed=seed, index=index, kind=kind, form='intruder', cause=cause, value=value, factor=factor, conditions=ci, reps=reps, rows=len(rows), law=law, coefficient_sd=coefficient_sd,
                 stated=dict(zeta=zeta), true=dict(zeta=zeta * factor), effect=float(np.sqrt(np.mean(np.square(eff)))) if eff else 0., shapes=names,
                 mess=dict(scatter=scatter, white=white, dz=dz, gain=gain, true_mu=true_mu, geo={n: b['radius'] for n, b in true_body.items()}))
    return head + '\n' + '\n'.join(','.join(map(str, r)) for r in rows) + '\n', toml, truth


if __name__ == '__main__':
    import time
    for i in range(20):
        kind = KINDS[i % 5]
        t0 = time.time()
        csv, toml, truth = make(1, i, kind)
        print(i, kind, truth['form'], truth['cause'], truth['conditions'], truth['reps'], truth['rows'], f"{truth['effect']:.3f}", truth['shapes'], f'{time.time() - t0:.1f}s')
