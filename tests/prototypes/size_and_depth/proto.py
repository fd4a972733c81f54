"""Size and depth laws of discs in sand: fits, leave-one-diameter-out, wheels. Needs numpy and scipy only:
  OMP_NUM_THREADS=1 PYTHONDONTWRITEBYTECODE=1 python proto.py > tables.txt     (1.5 minutes)"""
import csv, collections, sys
import numpy as np
from scipy.optimize import least_squares, brentq

SRC = 'data/real_wheel/'
PHI = np.radians(29.0)                 # angle of repose, README of the data
C_TH = 0.5 * np.tan(np.pi / 4 + PHI / 2)   # 0.849: depth of the failure zone / B (Bowles, layered soils)
STRETCH, SKIP = 12, 0.1                # as `sandgait calibrate`: 12 stretches of depth, first tenth of each push left out

def stretches(a):
    top = a[:, 0].max(); e = np.linspace(SKIP * top, top, STRETCH + 1); k = [(a[:, 0] >= lo) & (a[:, 0] <= hi) for lo, hi in zip(e[:-1], e[1:])]
    return np.array([a[i].mean(0) for i in k if i.any()]).T
def load():
    g = collections.OrderedDict()
    for x in csv.DictReader(open(SRC + 'plates.csv')):
        g.setdefault(x['trial'], dict(body=x['intruder'], rows=[], full=[]))['rows'].append((float(x['depth_rig_corrected_m']), float(x['force_N'])))
        g[x['trial']]['full'].append((float(x['depth_m']), float(x['force_N'])))
    for k, v in g.items():
        a = np.array(v['rows']); v['trial'] = k
        v['z'], v['F'] = stretches(a); v['raw'] = a; v['full'] = np.array(v['full'])
        v['D'] = float(v['body'][5:-2]) / 1e3 if 'disc' in v['body'] else None
    return g

P = load(); DISCS = [v for v in P.values() if v['D']]; SIZES = [.06, .08, .10]
E = np.exp
# name: (p(z, D, theta) [Pa], starts, positive (log) parameters, source)
D0, Z0 = .08, .02
def kang(z, D, t): return E(t[0]) * (z + E(t[1]) * D * (1 - E(-z / (E(t[2]) * D))))
def influence(shape, c=None, m=None):
    def p(z, D, t):
        cc = c if c is not None else E(t[2]); s = z + cc * D
        if shape == 'exp': return E(t[0]) * z * E(s / E(t[1]))
        if shape == 'pow': return E(t[0]) * z * (s / .08) ** E(t[1])
        if shape == 'floor': return E(t[0]) * z * (1 + (s / E(t[1])) ** m)
        if shape == 'floorm': return E(t[0]) * z * (1 + (s / E(t[1])) ** E(t[2]))
        if shape == 'hyp': return E(t[0]) * z / np.maximum(1 - s / (.08+E(t[1])), 1e-3)
        if shape == 'lin': return E(t[0]) * z * np.maximum(1 + (s-.08) / E(t[1]), 1e-3)
    return p
L = np.log
LAWS = [
 ('plain RFT: zeta z', lambda z, D, t: E(t[0]) * z, [[14.]]),
 ('depth_power: k z^n', lambda z, D, t: E(t[0]) * Z0 * (z / Z0) ** t[1], [[14., 1.]]),
 ('Reece/scale-free: k D (z/D)^n', lambda z, D, t: E(t[0]) * D * (z / D) ** t[1], [[14., 1.]]),
 ('Terzaghi-Vesic: aD + bz', lambda z, D, t: E(t[0]) * D + E(t[1]) * z, [[11., 14.]]),
 ('Kang cone, mobilised: zeta(z + cD(1-e^(-z/kD)))', kang, [[14., -2., -2.], [13.5, 0., 0.]]),
 ('Meyerhof depth factor: bz(1 + az/D) + cD', lambda z, D, t: E(t[0]) * z * (1 + E(t[1]) * z / D) + E(t[2]) * D, [[14., 0., 9.], [13.7, -2., 11.]]),
 ('Bekker: (kc/b + kphi) z^n', lambda z, D, t: np.maximum(t[0] / (D / 2) * D0 / 2 + t[1], 1e-3) * 1e4 * (z / Z0) ** t[2], [[-1., 4., 1.2], [1., 2., 1.]]),
 ('size only: zeta z (D/D0)^q', lambda z, D, t: E(t[0]) * z * (D / D0) ** t[1], [[14., 1.]]),
 ('power and size: k z^n D^q', lambda z, D, t: E(t[0]) * Z0 * (z / Z0) ** t[1] * (D / D0) ** t[2], [[14., 1., 1.]]),
 ('pressure grows with area: k z^n D^2', lambda z, D, t: E(t[0]) * Z0 * (z / Z0) ** t[1] * (D / D0) ** 2, [[14., 1.]]),
 ('influence exp: k z e^((z+cD)/L), c fit', influence('exp'), [[12., L(.04), L(.8)], [13., L(.1), 0.]]),
 ('influence power: k z (z+cD)^m, c fit', influence('pow'), [[14., L(2.), L(.8)]]),
 ('influence hyperbola (bottom): k z/(1-(z+cD)/H), c fit', influence('hyp'), [[13., L(.06), L(.6)]]),
 ('influence exp, c = .849 (2 constants)', influence('exp', C_TH), [[12., L(.04)], [13., L(.1)]]),
 ('influence power, c = .849 (2 constants)', influence('pow', C_TH), [[14., L(2.)]]),
 ('influence linear, c = .849 (2 constants)', influence('lin', C_TH), [[14., L(.05)]]),
 ('influence floor m=2, c = .849 (2 constants)', influence('floor', C_TH, 2), [[12., L(.05)], [13.5, L(.08)]]),
 ('influence floor m=3, c = .849 (2 constants)', influence('floor', C_TH, 3), [[12., L(.05)], [13.5, L(.08)]]),
 ('influence floor m=4, c = .849 (2 constants)', influence('floor', C_TH, 4), [[13., L(.06)], [13.5, L(.08)]]),
 ('influence floor m fit, c = .849 (3 constants)', influence('floorm', C_TH), [[13.4, L(.08), L(4.)]]),
]
def fit(law, pushes):
    f, starts = law[1], law[2]; best = None
    r = lambda t: np.concatenate([L(np.maximum(f(v['z'], v['D'], t), 1e-9)) - L(v['F'] / (np.pi / 4 * v['D'] ** 2)) for v in pushes])
    for s in starts:
        o = least_squares(r, s, x_scale='jac', max_nfev=4000)
        if best is None or o.cost < best.cost: best = o
    return best.x, np.sqrt(2 * best.cost / len(best.fun))
def errs(law, t, pushes):
    """mean |F_pred/F - 1| over stretches, the same weighted by force (sum|dF|/sum F), bias (mean ln)"""
    q = [(law[1](v['z'], v['D'], t) * np.pi / 4 * v['D'] ** 2, v['F']) for v in pushes]
    p, F = np.concatenate([a for a, b in q]), np.concatenate([b for a, b in q])
    return 100 * np.mean(abs(p / F - 1)), 100 * np.sum(abs(p - F)) / np.sum(F), 100 * np.mean(L(np.maximum(p,1e-9) / F))

def repeatability():
    print('Repeatability (sd of ln F between the 3 pushes of a size at equal depth; last: one push predicts another, mean |.|)')
    for D in SIZES:
        g = [v for v in DISCS if v['D'] == D]; top = min(v['raw'][:, 0].max() for v in g)
        z = np.linspace(.1 * top, top, 40)
        F = np.array([L(np.interp(z, np.maximum.accumulate(v['raw'][:, 0]), v['raw'][:, 1])) for v in g])
        one = np.mean([abs(E(F[i] - F[j]) - 1).mean() for i in range(3) for j in range(3) if i != j])
        print('  %3.0f mm  sd %.1f %%  shallow third %.1f %%  one predicts another %.1f %%  zmax %.1f mm Fmax %.0f N' % (D * 1e3, 100 * F.std(0, ddof=1).mean(), 100 * F.std(0, ddof=1)[:13].mean(), 100 * one, 1e3 * top, E(F[:, -1]).mean()))
def scale_free():
    print('Any scale-free law p = rho g D f(z/D): p/z at equal z/D must not depend on D.  Measured p/z [N/cm3], and d ln(p/z)/d ln D:')
    for x in (.03, .05, .08, .12, .15):
        r = [np.mean([np.interp(x * D, np.maximum.accumulate(v['raw'][:, 0]), v['raw'][:, 1]) for v in DISCS if v['D'] == D]) / (np.pi / 4 * D * D) / (x * D) / 1e6 for D in SIZES]
        print('  z/D %.2f: ' % x + ' '.join('%.2f' % a for a in r) + '   exponent %.2f' % np.polyfit(L(SIZES), L(r), 1)[0])
def table():
    print('%-56s %4s  %5s | leave one diameter out: mean rel. error %% 60, 80, 100 | worst | force-weighted %% | bias ln %% | theta of all' % ('law', 'fit%', 'k'))
    out = {}
    for law in LAWS:
        t, rms = fit(law, DISCS); fe = errs(law, t, DISCS)[0]; lo = []
        for D in SIZES:
            tt, _ = fit(law, [v for v in DISCS if v['D'] != D]); lo.append(errs(law, tt, [v for v in DISCS if v['D'] == D]))
        lo = np.array(lo); out[law[0]] = t
        print('%-56s %4.1f  %d | %5.1f %5.1f %5.1f | %5.1f | %5.1f %5.1f %5.1f | %+4.0f %+4.0f %+4.0f | %s' % (law[0], fe, len(t), *lo[:, 0], lo[:, 0].max(), *lo[:, 1], *lo[:, 2], np.array2string(t, precision=3)))
    return out
def constants():
    print('Constants of the chosen laws with jackknife standard errors over the nine pushes')
    for name in ('influence floor m=4, c = .849 (2 constants)', 'influence exp, c = .849 (2 constants)', 'influence exp: k z e^((z+cD)/L), c fit'):
        law = [l for l in LAWS if l[0] == name][0]; t = fit(law, DISCS)[0]
        J = np.array([fit(law, [v for v in DISCS if v is not u])[0] for u in DISCS]); n = len(J)
        print('  %-44s' % name, ' '.join('%.4g (%.0f %%)' % (a, 100 * b) for a, b in zip(E(t), np.sqrt((n - 1) / n * ((J - J.mean(0))**2).sum(0)))))
    print('c held, floor m=4: rms ln %, leave one out 60/80/100')
    for c in (.3, .5, .6, .7, .8, C_TH, .9, 1., 1.2, 1.6, 2.):
        law = ('', influence('floor', c, 4), [[13., L(.06)], [13.5, L(.08)]])
        print('  c %.2f  %4.1f   %s' % (c, 100 * fit(law, DISCS)[1], ' '.join('%.1f' % x for x in loo(law, DISCS))))
def loo(law, ds):
    return [errs(law, fit(law, [v for v in ds if v['D'] != D])[0], [v for v in ds if v['D'] == D])[0] for D in SIZES]
def sensitivity():
    names = ['plain RFT: zeta z', 'size only: zeta z (D/D0)^q', 'power and size: k z^n D^q', 'influence exp, c = .849 (2 constants)', 'influence exp: k z e^((z+cD)/L), c fit', 'influence floor m=4, c = .849 (2 constants)']
    laws = [[l for l in LAWS if l[0] == n][0] for n in names]
    print('Sensitivity of leave-one-out (60/80/100) to the rig bending correction (factor) and to the zero of depth; last: c fitted with the exponential')
    for k, dz in ((0, 0), (.5, 0), (.8, 0), (1, 0), (1.2, 0), (1, -1e-3), (1, -.5e-3), (1, .5e-3), (1, 1e-3)):
        ds = []
        for v in DISCS:
            a = v['full'].copy(); a[:, 0] += dz - k * .153e-3 * a[:, 1] ** .6; z, F = stretches(a); ds.append(dict(z=z, F=F, D=v['D']))
        print('  bending x %.1f, zero %+.1f mm: ' % (k, 1e3 * dz) + '  '.join('/'.join('%.0f' % x for x in loo(l, ds)) for l in laws) + '   c %.2f' % E(fit(laws[4], ds)[0][2]))
    print('  columns: ' + '; '.join(names))
if __name__ == '__main__':
    repeatability(); scale_free(); T = table(); constants(); sensitivity()
    import wheels
    wheels.run(T)
