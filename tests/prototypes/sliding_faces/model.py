"""Both laws, plate meshes, and the sliding rule. numpy only."""
import csv
import numpy as np

G_ACC = 9.81
GEN = dict(A00=.206, A10=.169, B11=.212, B01=.358, Bm11=.055, C11=-.124, C01=.253, Cm11=.007, D10=.088)
COEF = np.array([
    [0.00212, -0.06796, -0.02634], [-0.02320, -0.10941, -0.03436], [-0.20890, 0.04725, 0.45256],
    [-0.43083, -0.06914, 0.00835], [-0.00259, -0.05835, 0.02553], [0.48872, -0.65880, -1.31290],
    [-0.00415, -0.11985, -0.05532], [0.07204, -0.25739, 0.06790], [-0.02750, -0.26834, -0.16404],
    [-0.08772, 0.02692, 0.02287], [0.01992, -0.00736, 0.02927], [-0.45961, 0.63758, 0.95406],
    [0.40799, 0.08997, -0.00131], [-0.10107, 0.21069, -0.11028], [-0.06576, 0.04748, 0.01487],
    [0.05664, 0.20406, -0.02730], [-0.09269, 0.18519, 0.10911], [0.01892, 0.04934, -0.04097],
    [0.01033, 0.13527, 0.07881], [0.15120, -0.33207, -0.27519]])


# ---------------------------------------------------------------- laws: stress per depth [N/m3] for normals n, directions u
def li2013(n, u, zeta):
    """zeta [N/m3]; n, u (N,3). Both vectors unit."""
    k = {a: b * zeta for a, b in GEN.items()}
    along = n[:, 0] * u[:, 0] + n[:, 1] * u[:, 1]
    nudge = np.where(along < 0, -1, 1) * 1e-6 * np.abs(u[:, 2])
    ex, ey = u[:, 0] + n[:, 0] * nudge, u[:, 1] + n[:, 1] * nudge
    na = n[:, 0] * ex + n[:, 1] * ey
    ratio = na / (ex ** 2 + ey ** 2 + 1e-36)
    c2b = n[:, 2] ** 2 - na * ratio
    s2b_h = -2 * n[:, 2] * ratio
    s2b_cg = -2 * n[:, 2] * along
    sg = -u[:, 2]
    along_v = (k['C11'] + k['Cm11']) * c2b + k['C01']
    along_e = ((k['Cm11'] - k['C11']) * sg + k['D10']) * s2b_h
    vert = k['A10'] * c2b + k['A00'] + ((k['B11'] + k['Bm11']) * c2b + k['B01']) * sg + (k['B11'] - k['Bm11']) * s2b_cg
    return np.stack([-(along_v * u[:, 0] + along_e * ex), -(along_v * u[:, 1] + along_e * ey), vert], 1)


def agarwal2023(n, u, zeta, gate=1e-20, mu=None):
    lower = np.where(n[:, 2] > 0, -1.0, 1.0)[:, None]
    n = n * lower
    x3 = (n * u).sum(1)
    x1, x2 = -u[:, 2], -n[:, 2]
    o = np.ones_like(x1)
    t = np.stack([o, x1, x2, x3, x1**2, x2**2, x3**2, x1*x2, x2*x3, x3*x1, x1**3, x2**3, x3**3, x1*x2**2,
                  x2*x1**2, x2*x3**2, x3*x2**2, x3*x1**2, x1*x3**2, x1*x2*x3], 1)
    f = t @ COEF
    a = n * f[:, :1] + u * f[:, 1:2]
    a[:, 2] -= f[:, 2]
    lead = np.clip(x3 / gate, -1, 1)
    nor = (a * n).sum(1)
    turned = np.maximum(nor * lead, 0) * 2
    a = a + n * np.where(nor < 0, turned, -turned)[:, None]
    if mu is not None:
        nor = (a * n).sum(1)
        tan = a - n * nor[:, None]
        size = np.sqrt((tan ** 2).sum(1) + 1e-20)
        a = n * nor[:, None] + tan * np.minimum(mu * np.abs(nor) / size, 1)[:, None]
    return a * (zeta / 0.87574)


LAWS = dict(li2013=li2013, agarwal2023=agarwal2023)


# ---------------------------------------------------------------- bodies: centre, normal, area, half vertical extent
def box(lx, ly, lz, size=0.002):
    c, n, a, r = [], [], [], []
    L = np.array([lx, ly, lz])
    cnt = np.maximum(np.ceil(L / size - 1e-9).astype(int), 4)
    for ax in range(3):
        p, q = (ax + 1) % 3, (ax + 2) % 3
        gp = L[p] * ((np.arange(cnt[p]) + .5) / cnt[p] - .5)
        gq = L[q] * ((np.arange(cnt[q]) + .5) / cnt[q] - .5)
        P, Q = np.meshgrid(gp, gq, indexing='ij')
        for s in (-1, 1):
            C = np.zeros((P.size, 3)); C[:, p] = P.ravel(); C[:, q] = Q.ravel(); C[:, ax] = s * L[ax] / 2
            N = np.zeros_like(C); N[:, ax] = s
            c.append(C); n.append(N); a.append(np.full(P.size, L[p] * L[q] / (cnt[p] * cnt[q])))
            r.append(np.full(P.size, 0.0 if ax == 2 else L[2] / (2 * cnt[2])))
    return dict(c=np.vstack(c), n=np.vstack(n), a=np.concatenate(a), r=np.concatenate(r), low=-lz / 2)


def sphere(R, size=0.001):
    c, n, a, r = [], [], [], []
    nb = int(np.ceil(np.pi * R / size))
    edges = -np.cos(np.pi * np.arange(nb + 1) / nb)
    for lo, hi in zip(edges[:-1], edges[1:]):
        z = (lo + hi) / 2; w = np.sqrt(1 - z * z)
        m = max(int(np.ceil(2 * np.pi * R * w / size)), 8); m += m % 2
        ph = (np.arange(m) + .5) / m * 2 * np.pi
        N = np.stack([w * np.cos(ph), w * np.sin(ph), np.full(m, z)], 1)
        n.append(N); c.append(N * R); a.append(np.full(m, 2 * np.pi * R * R * (hi - lo) / m))
        r.append(np.full(m, w * np.pi * R / (2 * nb)))
    return dict(c=np.vstack(c), n=np.vstack(n), a=np.concatenate(a), r=np.concatenate(r), low=-R)


def cylinder(R, w, size=0.001, sides=True):
    """Axis along y."""
    m = int(np.ceil(2 * np.pi * R / size)); ph = (np.arange(m) + .5) / m * 2 * np.pi
    N = np.stack([np.sin(ph), 0 * ph, -np.cos(ph)], 1)
    c, n, a, r = [N * R], [N], [np.full(m, 2 * np.pi * R * w / m)], [np.abs(np.sin(ph)) * np.pi * R / m]
    if sides:
        h = size * 2
        g = np.arange(-R + h / 2, R, h)
        X, Z = [q.ravel() for q in np.meshgrid(g, g)]
        k = X**2 + Z**2 < R * R
        for s in (-1, 1):
            c.append(np.stack([X[k], np.full(k.sum(), s * w / 2), Z[k]], 1))
            n.append(np.tile([0., s, 0.], (k.sum(), 1))); a.append(np.full(k.sum(), np.pi * R * R / k.sum()))
            r.append(np.full(k.sum(), h / 2))
    return dict(c=np.vstack(c), n=np.vstack(n), a=np.concatenate(a), r=np.concatenate(r), low=-R)


def turned(body, angle):
    """Turned about y by `angle` (positive: +x toward -z)."""
    c, s = np.cos(angle), np.sin(angle)
    R = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    out = dict(body, c=body['c'] @ R.T, n=body['n'] @ R.T)
    return out


def wet(body, depth_low):
    """Mean depth of the wet part and wet area, for the lowest point (body['low']) at depth `depth_low`."""
    d = depth_low - (body['c'][:, 2] - body['low'])
    low = np.maximum(d + body['r'], 0)
    cov = d < body['r']
    mean = np.where(cov, low / 2, d)
    share = np.where(cov, low / np.maximum(2 * body['r'], 1e-30), 1.0)
    share = np.where((body['r'] <= 0) & (d < 0), 0, share)
    return mean * (share > 0), body['a'] * share


def plain(law, body, zeta, v, depth_low, omega=None):
    """The law as in `sandgait intrude`: one-sided, a face with s >= 0 counts."""
    V = np.broadcast_to(np.asarray(v, float), body['c'].shape)
    if omega is not None:
        V = V + np.cross(omega, body['c'])
    sp = np.linalg.norm(V, axis=1)[:, None]
    u = V / np.maximum(sp, 1e-30)
    n = np.where(np.abs(body['n']) < 1e-12, 0, body['n'])
    s = (n * u).sum(1)
    z, a = wet(body, depth_low)
    s = np.where(np.abs(s) < 1e-12, 0, s)
    u2 = u + n * (np.maximum(s, 1e-12) - s)[:, None]
    f = LAWS[law](n, u2, zeta)
    return (f * (z * a * (s >= 0))[:, None]).sum(0)


# ---------------------------------------------------------------- the rule
class Rule:
    """ell, delta [m]; mu_e; fixed: mu (surface friction), rho [kg/m3], K0."""
    def __init__(self, ell=0.0065, delta=0.00016, mu_e=0.13, mu=0.4, rho=1467.0, K0=0.5):
        self.ell, self.delta, self.mu_e, self.mu, self.rho, self.K0 = ell, delta, mu_e, mu, rho, K0

    def parts(self, law, n, u, zeta):
        """Steady traction per depth f (N,3), its normal pressure per depth P, s, tangential unit vector."""
        s = (n * u).sum(1)
        s = np.where(np.abs(s) < 1e-12, 0, s)
        ut = u - n * s[:, None]
        c = np.sqrt(np.maximum(1 - s * s, 0))
        t = ut / np.maximum(c, 1e-9)[:, None]
        kap = self.delta / self.ell
        geo = self.rho * G_ACC * (n[:, 2] ** 2 + self.K0 * (1 - n[:, 2] ** 2))
        u2 = u + n * (np.maximum(s, 1e-12) - s)[:, None]
        fl = LAWS[law](n, u2, zeta)
        phi = np.clip(s / kap, 0, 1)              # share of the law: elastic loading up to failure
        psi = np.maximum(1 - np.abs(s) / kap, 0)  # share of the geostatic stress, on both sides of s = 0
        fg = -(geo * psi)[:, None] * (n + self.mu * t)
        f = fl * phi[:, None] + fg
        return f, -(f * n).sum(1), s, t, c

    def steady(self, law, body, zeta, v, depth_low, omega=None):
        V = np.broadcast_to(np.asarray(v, float), body['c'].shape)
        if omega is not None:
            V = V + np.cross(omega, body['c'])
        sp = np.linalg.norm(V, axis=1)[:, None]
        u = V / np.maximum(sp, 1e-30)
        f = self.parts(law, body['n'], u, zeta)[0]
        z, a = wet(body, depth_low)
        return (f * (z * a)[:, None]).sum(0)

    def course(self, law, body, zeta, u_of, depths, step):
        """Pressed down (0,0,-1) to depths[0], then moved along unit directions u_of[i], one row each `step` metres.
        Returns Fx, Fz means of each row."""
        q = self.parts(law, body['n'], np.broadcast_to([0., 0, -1], body['n'].shape), zeta)[1]
        out = []
        old = None
        for u1, d in zip(u_of, depths):
            if old is None or np.any(u1 != old):
                u = np.broadcast_to(u1, body['n'].shape)
                f, P, s, t, c = self.parts(law, body['n'], u, zeta)
                rate = c / self.ell + np.abs(s) / self.delta
                old = u1
            k = np.exp(-rate * step)
            e0 = q - P
            mean = e0 * (1 - k) / np.maximum(rate * step, 1e-12)
            z, a = wet(body, d)
            tr = f - mean[:, None] * (body['n'] + self.mu_e * t)
            out.append((tr * (z * a)[:, None]).sum(0))
            q = P + e0 * k
        return np.array(out)


# ---------------------------------------------------------------- data
DRAG = 'data/drag/'


def read(path):
    rows = list(csv.DictReader(open(path)))
    out = {}
    for k in rows[0]:
        try:
            out[k] = np.array([float(r[k]) if r[k] else np.nan for r in rows])
        except ValueError:
            out[k] = np.array([r[k] for r in rows])
    return out


COURSES = {  # name: (body name, body, depth of lowest point or None)
    'ball': ('ball', sphere(0.02), 'ball_0.02.csv', 0.015),
    'plate': ('plate', box(0.005, 0.05, 0.04), 'plate_0.05.csv', 0.020),
    'block': ('block', box(0.04, 0.05, 0.04), 'block_0.04_0.05_20mm.csv', 0.020),
    'flat': ('flat', box(0.04, 0.05, 0.006), 'flat_0.04_0.05_20mm.csv', 0.020),
    'flat g=.1': ('flat', box(0.04, 0.05, 0.006), 'flat_0.04_0.05_gamma_0.1.csv', None),
}


def grains(name):
    body, mesh, file, depth = COURSES[name]
    d = read(DRAG + file)
    way = d['way']
    dep = d['depth'] if depth is None else np.full(way.shape, depth)
    return way, dep, d['Fx'], d['Fz']


def windows(way, x, n=5):
    return np.array([x[(way > .01 * i) & (way < .01 * (i + 1))].mean() for i in range(n)])
