"""My own physics against the numbers that the documents print."""
import numpy as np
from lab import *

def li(b, g):
    v = np.array([np.cos(g), 0, -np.sin(g)]); n = np.array([np.sin(b), 0, -np.cos(b)])
    if abs(np.cos(g)) < 1e-9: v[0] = 1e-9
    a = li2013(LOOSE, v, n); return -a[0] / 1e6, a[2] / 1e6
D = np.deg2rad
for (b, g), w in {(0, 90): (0, .254), (90, 0): (.083, .004), (45, 45): (.0837, .1330), (-45, 45): (-.0031, .0864), (30, 60): (.0632, .1923), (0, -90): (0, -.058), (-30, -30): (.0277, -.0100)}.items():
    got = li(D(b), D(g)); assert np.allclose(got, w, atol=6e-5), (b, g, got, w)
a = agarwal2023(1., np.array([0, 0, -1.]), np.array([0, 0, -1.])); assert abs(a[2] - .87574) < 1e-5, a
sand = Sand('li2013', LOOSE, 638.)
for xi, fz, fx, ty in [(45, 7.49, 3.96, -.337), (-45, 3.52, 2.48, -.154), (0, 2.71, 3.45, -.211)]:
    th = np.linspace(-1.6, 1.6, 1601); t = th / .2 - th[0] / .2
    tr = dict(t=t, theta=th, omega=np.full_like(t, .2), hip_z=.02, shape_def=dict(type='leg', chord=.076, width=.025, xi_deg=xi), path=t, ctx={'strength': 1., 'pass': 1, 'pass_dx': 0., 'x_bed': 0., 'order': .5})
    F = trial_force(sand, {}, tr, {})
    print(xi, F[:, 1].max(), np.rad2deg(th[F[:, 1].argmax()]), np.abs(F[:, 0]).max(), F[np.abs(F[:, 2]).argmax(), 2])
    assert abs(F[:, 1].max() - fz) < .02 and abs(np.abs(F[:, 0]).max() - fx) < .02 and abs(F[np.abs(F[:, 2]).argmax(), 2] - ty) < .002
print('ok')
