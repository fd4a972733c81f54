import numpy as np, subprocess
from law import *
c, rho = MEDIA['poppy-loose']
base = 'name = "x"\nlaw = "li2013"\nbulk_density = 638.0\nsource="me"\n[coefficients]\n' + ''.join(f'{k} = {v}\n' for k, v in zip(['a00','a10','b11','b01','bm11','c11','c01','cm11','d10'], c)) + '[mechanisms]\n'
for m in [dict(inertial_drag=1.5), dict(cohesion=200.), dict(depth_power=.3), dict(depth_power=-.2), dict(packing_grad=.2), dict(slope=.15), dict(rate_log=.06), dict(friction_clip=3.), dict(friction_clip=4.5), dict(concave_fill=.6), dict(scale=.3)]:
    open('m.toml','w').write(base + ''.join(f'{k} = {v}\n' for k, v in m.items()))
    for n, xi in [('L',45),('revL',-45)]:
        p = subprocess.run(['nice','-n','15','sandgait','intrude','--shape',n,'--omega','6','--sand','m.toml','--csv','m.csv','-q'], capture_output=True, text=True)
        if p.returncode: print(m, p.stderr); break
        D = np.genfromtxt('m.csv', delimiter=',', names=True); th = D['theta']
        F = leg(c, 638., dict(chord=.076, width=.025, xi_deg=xi), .02, th, np.full_like(th, 6.), 0*th, m)
        print(m, n, [(np.abs(D[q]).max().round(3), np.abs(D[q]-F[k]).max().round(4)) for k, q in enumerate(['Fx','Fz','Ty'])])
