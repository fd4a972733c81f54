import numpy as np
from law import *
c,rho=MEDIA['poppy-loose']; sp=dict(chord=.076,width=.025,xi_deg=45.); th=np.linspace(-1.3,1.2,60); om=np.full(60,2.); z=0*th
s=-.0578
F=leg(c,rho,sp,.02,th,om,z,dict(slope=s)); P=leg(c,rho,sp,.02,th,om,z,{})
for sj in (1,-1):
  G=leg(c,rho,sp,.02*np.cos(s),th+sj*s,om,z,{})
  for st in (1,-1):
    t=st*s; H=np.stack([np.cos(t)*G[0]-np.sin(t)*G[1],np.sin(t)*G[0]+np.cos(t)*G[1],G[2]]); print(sj,st,np.abs(F-H).max(1),np.abs(F-P).max(1))
