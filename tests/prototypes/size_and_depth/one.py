from proto import *
for name in ('plain RFT: zeta z','influence floor m=4, c = .849 (2 constants)','influence exp, c = .849 (2 constants)','influence floor m=3, c = .849 (2 constants)'):
    law=[l for l in LAWS if l[0]==name][0]
    for src in SIZES:
        t,_=fit(law,[v for v in DISCS if v['D']==src])
        print(name,'from %d:'%(1e3*src),' '.join('%d: %.1f'%(1e3*D,errs(law,t,[v for v in DISCS if v['D']==D])[0]) for D in SIZES), np.exp(t))
