import numpy as np, make as M

R = np.pi / 180
for b, g in [(0, 90), (90, 0), (45, 45), (-45, 45), (30, 60), (0, -90), (-30, -30)]:
    sh = dict(type="plate", length=0.02, width=0.05)
    c = dict(shape=sh, beta=b * R, dir=1, x_bed=0, **{"pass": 1}, pass_dx=0)
    one = np.ones(1)
    v = 0.1
    q = dict(
        x=0 * one,
        z=-0.1 * one,
        vx=v * np.cos(g * R) * one,
        vz=-v * np.sin(g * R) * one,
        ax=0 * one,
        az=0 * one,
        path=one,
    )
    F = M.sand_force(q, c, M.LOOSE, 640.0, {})
    print(b, g, -F[0, :2] * [1, -1] / (0.1 * 0.001) / 1e6)
    c["dir"] = -1
    q["vx"] = -q["vx"]
    print("   mirror", M.sand_force(q, c, M.LOOSE, 640.0, {})[0, :2] / (0.1 * 0.001) / 1e6)
for xi in (45, -45, 0):
    sh = dict(type="leg", chord=0.076, width=0.025, xi=xi * R)
    c = dict(shape=sh, hip_z=0.02, x_bed=0, **{"pass": 1}, pass_dx=0)
    th = np.linspace(-2, 2, 2001)
    q = dict(theta=th, omega=0.2 + 0 * th, alpha=0 * th, path=0 * th)
    F = M.sand_force(q, c, M.LOOSE, 640.0, {})
    i = F[:, 1].argmax()
    j = abs(F[:, 0]).argmax()
    print(xi, F[i, 1], th[i] / R, F[j, 0], th[j] / R, F[abs(F[:, 2]).argmax(), 2])
