"""Constants from the grains' courses alone. No law enters: each course's steady lift is the grains' own mean over 40-60 mm
(gamma = .1: free, proportional to depth), and the size of its transient is free."""
from model import *
from scipy.optimize import minimize
N = 40  # rows of 1 mm used


def transient(k, ell, delta):
    """Passing lift along the way (1 mm means), 1 at the start: press stress times n_z and depth, each plate with its own rate."""
    way, dep, fx, fz = grains(k)
    mesh = COURSES[k][1]
    u = np.array([1., 0, 0]) if COURSES[k][3] else np.array([np.cos(.1), 0, -np.sin(.1)])
    n = mesh['n']; s = n @ u; c = np.sqrt(np.maximum(1 - s * s, 0))
    rate = c / ell + np.abs(s) / delta
    z, a = wet(mesh, dep[0])
    w = np.maximum(-n[:, 2], 0) ** 3 * z * a
    i = w > 0
    x = way[:N]; h = .0005
    E = (np.exp(-np.outer(x - h, rate[i])) - np.exp(-np.outer(x + h, rate[i]))) / (2 * h * rate[i])
    return E @ w[i] / w.sum()


def misfit(p, keys, full=False):
    ell, delta = np.exp(p); tot = 0; mus = []
    for k in keys:
        way, dep, fx, fz = grains(k)
        T = transient(k, ell, delta); y = fz[:N]
        if COURSES[k][3] is None:
            A = np.stack([T, dep[:N] / dep[0]], 1); co = np.linalg.lstsq(A, y, rcond=None)[0]; fit_ = A @ co
        else:
            lev = fz[(way > .04) & (way < .06)].mean()
            size = (T @ (y - lev)) / (T @ T); fit_ = lev + size * T
            if k in ('flat', 'block'):  # what passes drags: -Fx = level + mu_e * passing lift, from the third mm on
                e = fz[2:15] - lev
                mus.append(np.linalg.lstsq(np.stack([np.ones(13), e], 1), -fx[2:15], rcond=None)[0][1])
        tot += np.mean(((y - fit_) / np.abs(y).max()) ** 2)
    return (tot, np.mean(mus) if mus else np.nan) if full else tot


def fit(keys):
    best = None
    for e in (.004, .008):
        for d in (1e-4, 4e-4):
            r = minimize(misfit, np.log([e, d]), args=(keys,), method='Nelder-Mead', options=dict(xatol=.01, fatol=1e-7))
            if best is None or r.fun < best.fun:
                best = r
    (ell, delta), mu = np.exp(best.x), misfit(best.x, keys, True)[1]
    return ell, delta, mu


if __name__ == '__main__':
    bodies = ['ball', 'plate', 'block', 'flat']
    for keys in [['flat', 'flat g=.1'], ['block', 'ball'], ['flat'], ['block']] + [[k for k in COURSES if COURSES[k][0] != b] for b in bodies] + [list(COURSES)]:
        e, d, m = fit(keys)
        print(keys, 'ell %.2f mm  delta %.3f mm  kappa %.4f  mu_e %.3f' % (e * 1e3, d * 1e3, d / e, m), flush=True)
