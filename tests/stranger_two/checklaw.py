import numpy as np, subprocess, csv, sys
from law import *
c, rho = MEDIA['poppy-loose']
for b, g in [(0,90),(90,0),(45,45),(-45,45),(30,60),(0,-90),(-30,-30)]: print(b, g, np.round(np.array(alpha(c, *np.radians([b, g])))/1e6, 4))
for n, xi in [('L',45),('revL',-45),('flat',0)]:
    subprocess.run(['nice','-n','15','sandgait','intrude','--shape',n,'--omega','3','--csv',f'{n}.csv','-q'], stdout=subprocess.DEVNULL)
    D = np.genfromtxt(f'{n}.csv', delimiter=',', names=True); th = D['theta']
    F = leg(c, rho, dict(chord=.076, width=.025, xi_deg=xi), .02, th, np.full_like(th, 3.), 0*th, {})
    for k, q in enumerate(['Fx','Fz','Ty']): print(n, q, 'max |F|', np.abs(D[q]).max().round(4), 'max diff', np.abs(D[q]-F[k]).max().round(5))
