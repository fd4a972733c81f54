"""Force logs of a plate/leg rig with my own dirt. gen.make(kind, index, seed, out) -> truth dict"""
import numpy as np, json, os, sys
from law import *

SINGLES = ['inertial_drag','concave_fill','cohesion','depth_power','packing_grad','slope','rate_log','friction_clip','footprint','added_mass','scale','compliance']
GEOM = ['attitude','joint_zero','size','delay','depth_zero','attitude','joint_zero','size','delay','cross_talk','lowpass','origin']
OUT = ['hard_bottom','crust','linear_drag','tip_bending','buildup','fluidised','rate_weakening_slow','cell_nonlinear','tool_mass','ageing','edge_effect','wet_at_depth']
RANGE = dict(inertial_drag=(.6,2.5), concave_fill=(.3,.9), cohesion=(60,400), depth_power=(.12,.4), packing_grad=(.08,.3), slope=(.05,.2), rate_log=(.03,.09),
             friction_clip=(2.2,5), footprint=(.25,.6), added_mass=(1.,4.), scale=(.3,.6), compliance=(.06,.25))
GR = dict(attitude=(.09,.16), joint_zero=(.06,.12), size=(.07,.15), delay=(.008,.02), depth_zero=(.006,.010), cross_talk=(.07,.15), lowpass=(.02,.05), origin=(.005,.012))

def smooth(rng, s, ell):
    """unit-variance noise correlated along path s: sum of a telegraph-like stick-slip saw and an AR part"""
    n = len(s); ds = np.diff(s, prepend=s[0]); a = np.exp(-np.abs(ds)/ell); y = np.empty(n); y[0] = rng.normal()
    for i in range(1, n): y[i] = a[i]*y[i-1] + np.sqrt(1-a[i]**2)*rng.normal()
    saw = np.empty(n); level = rng.exponential()
    for i in range(n):
        level += abs(ds[i])/(1.5*ell)
        if rng.random() < 1 - np.exp(-abs(ds[i])/(1.5*ell)): level = max(level - rng.exponential(1.), 0) if level > .3 else level
        saw[i] = level
    saw = (saw - saw.mean())/(saw.std() + .3)
    return .85*y + .5*saw

def play(y, w):
    out = np.empty_like(y); o = y[0]
    for i, v in enumerate(y):
        if v > o + w: o = v - w
        if v < o - w: o = v + w
        out[i] = o
    return out

def profile(rng, T, n, ramp, ripple):
    """normalised motion s in 0..1 at fine grid; returns functions of n sample times"""
    m = 4000; t = np.linspace(0, 1, m); r = ramp
    f = lambda u: np.clip(u, 0, 1)**2*(3-2*np.clip(u, 0, 1))
    v = f(t/r)*f((1-t)/r) if r > 0 else np.ones(m)
    v = v*(1 + ripple*np.sin(2*np.pi*(rng.uniform(2,5)*t + rng.random())))
    s = np.concatenate([[0], np.cumsum((v[1:]+v[:-1])/2)])/(m-1)
    v, s = v/s[-1], s/s[-1]; a = np.gradient(v, t)
    return t*T, s, v/T, a/T**2

def make(kind, idx, seed, out, clean=False):
    rng = np.random.default_rng([seed, idx, {'nulls':0,'weaker':1,'singles':2,'geometry':3,'outside':4}[kind]])
    cause = {'nulls':None,'weaker':'strength','singles':SINGLES[idx%12],'geometry':GEOM[idx%12],'outside':OUT[idx%12]}[kind]
    med = rng.choice(['poppy-loose','poppy-loose','poppy-close','glass-beads'])
    c0, rho = MEDIA[med]; truth = {'kind':kind,'cause':cause,'medium':str(med)}
    csd = rng.choice([.06,.08,.10]); coef_err = rng.normal(0, rng.uniform(.4,.8)*csd, 9)
    c = c0*(1 + (0 if clean else coef_err)); m = {}; G = {}; val = None
    if kind == 'weaker':
        val = float(rng.choice([rng.uniform(.5,.82), rng.uniform(1.2,1.5)])); c = c*val
    if kind == 'singles':
        lo, hi = RANGE[cause]; val = float(lo*(hi/lo)**rng.random())
        if cause in ('packing_grad','slope','depth_power','scale') : val *= rng.choice([-1,1])
        if cause == 'scale' and val < 0: val = max(val, -.45)
        if cause == 'depth_power' and val < 0: val *= .8
        if cause == 'rate_log' and rng.random() < .3: val = -val*.7
        if cause != 'compliance': m[cause] = val
    if kind == 'geometry':
        lo, hi = GR[cause]; val = float(rng.uniform(lo, hi))*(1 if cause in ('delay','lowpass') else float(rng.choice([-1,1]))); G[cause] = val
    truth['value'] = val
    # rig
    legs = {'L':dict(type='leg', chord=.076, width=.025, xi_deg=45.), 'revL':dict(type='leg', chord=.076, width=.025, xi_deg=-45.),
            'flat':dict(type='leg', chord=.07, width=.03, xi_deg=0.), 'bent':dict(type='leg', chord=.085, width=.02, xi_deg=30.), 'rbent':dict(type='leg', chord=.085, width=.02, xi_deg=-30.)}
    plates = {'plate':dict(type='plate', length=.038, width=.025), 'wide':dict(type='plate', length=.03, width=.05), 'small':dict(type='plate', length=.02, width=.02)}
    style = rng.choice(['legs','plates','both'])
    if cause in ('concave_fill','joint_zero','compliance'): style = rng.choice(['legs','both'])
    if cause in ('attitude','tip_bending','buildup','tool_mass'): style = 'plates'
    if cause == 'origin': style = 'both'
    use = []
    if style != 'plates': use += list(rng.choice([k for k in legs], 2 if style == 'both' else 3, replace=False))
    if cause == 'concave_fill' and not any(legs[k]['xi_deg'] < 0 for k in use if k in legs): use[0] = 'revL'
    if style != 'legs': use += list(rng.choice([k for k in plates], 2, replace=False))
    shp = {k:(legs.get(k) or plates[k]) for k in use}
    ncond = int(rng.integers(10, 21)); reps = int(rng.choice([2,3,3,4]));
    while ncond*reps > 50: ncond -= 1
    ns = int(rng.choice([50, 60, 80])); vmax = rng.uniform(.3,.9); vmin = rng.choice([.01,.03])
    ty = rng.random() < .75 or cause == 'origin'; has2 = rng.random() < .6 or cause == 'footprint'
    # lab
    D = dict(bed=rng.uniform(.015,.05), day=rng.uniform(0,.03), grain=rng.uniform(.015,.05), ell=rng.uniform(.0015,.006), white=rng.uniform(.006,.03),
             gain=rng.normal(0,.01,3), xt=rng.normal(0,.008,2), att=rng.normal(0,.012), tilt=rng.normal(0,.015), jz=rng.normal(0,.008), size=rng.normal(0,.006,8), dz=rng.normal(0,.0007),
             dzt=rng.uniform(.0002,.0006), late=abs(rng.normal(.0008,.0006)), hyst=rng.uniform(0,.006), offs=rng.uniform(.005,.04), drift=rng.uniform(.005,.04),
             thermal=rng.uniform(0,.05), backlash=rng.uniform(0,.0003), jitter=rng.uniform(0,.3), sat=rng.random()<.25, outl=rng.random()<.3, tare=int(rng.integers(4,15)), q=rng.choice([0,.002,.01]), origin=rng.normal(0,.0005), patt=rng.uniform(0,.006))
    if clean: D = {k:(v*0 if not isinstance(v,(bool,np.bool_)) else False) for k,v in D.items()}; D.update(ell=.003, white=.01, bed=.02, grain=.02, tare=5)
    truth['dirt'] = {k:(np.asarray(v).tolist()) for k,v in D.items()}; truth['coef_err'] = coef_err.tolist(); truth['style'] = str(style)
    # conditions
    conds = []
    for k in range(ncond):
        sh = use[k % len(use)]; sp = shp[sh]
        v = float(np.exp(rng.uniform(np.log(vmin), np.log(vmax)))); 
        if k % 4 == 3: v = vmax*rng.uniform(.7,1)
        d = dict(shape=sh, pass_=2 if (has2 and rng.random() < .35) else 1, xb=float(rng.uniform(0,.25)))
        d['dx'] = float(rng.choice([0,.01,.03])) if d['pass_'] == 2 else 0.
        if sp['type'] == 'leg':
            sg = -1. if rng.random() < .35 else 1.
            d.update(hip=float(rng.uniform(.01,.035)), a=-sg*rng.uniform(1.1,1.5), b=sg*rng.uniform(.7,1.4), om=v/sp['chord'])
        else:
            mo = rng.choice(['down','oblique','drag','oblique'])
            b = rng.uniform(-1.2,1.2); g = {'down':np.pi/2,'oblique':rng.uniform(.25,1.3),'drag':0.}[mo]; L = rng.uniform(.05,.1)
            half = abs(np.sin(b))*sp['length']/2
            z0 = .004 + half if mo != 'drag' else -rng.uniform(.015,.045) - half
            if mo != 'drag': L = min((rng.uniform(.03,.06) + z0)/np.sin(g), .14)
            d.update(b=b, g=g, L=L, z0=z0, v=v, sg=-1. if (mo != 'down' and rng.random() < .3) else 1.)
        conds.append(d)
    order = [(k, r) for k in range(ncond) for r in range(reps)]
    if rng.random() < .7: order = [order[i] for i in rng.permutation(len(order))]
    else: order = sorted(order, key=lambda o: o[1])
    if cause == 'ageing': order = sorted(order, key=lambda o: (o[0], o[1]))
    N = len(order); rows = []; day = np.cumsum(rng.normal(0, 1, N)); day = D['day']*(day-day.mean())/max(day.std(),1e-9)
    temp = np.sin(np.linspace(0, rng.uniform(2,5), N)) ; fs = 0; trials = []; zero = np.zeros(3)
    sizes = {k:1 + D['size'][i] + G.get('size',0.) for i, k in enumerate(use)}
    atts = {k:D['att'] + rng.normal(0,.005)*(not clean) for k in use}
    for i, (k, r) in enumerate(order):
        d = conds[k]; sp = dict(shp[d['shape']]); f = sizes[d['shape']]
        for q in ('chord','length','width'):
            if q in sp: sp[q] *= f
        bed = np.exp(rng.normal(0, D['bed']) + day[i])
        if cause == 'ageing': bed *= 1 + .22*np.log1p(i/6)      # bed settles trial by trial while conditions run in blocks
        T = (abs(d['b']-d['a'])/d['om']) if sp['type'] == 'leg' else d['L']/d['v']
        t, s, v, a = profile(rng, T, ns, rng.uniform(.06,.15), rng.uniform(.0,.04))
        ts = np.linspace(.02*T + D['late'] + G.get('delay',0.), .98*T, ns); h = ts[1]-ts[0]
        ts = np.sort(ts + D['jitter']*h*rng.uniform(-.5,.5,ns))
        # fine grid of forces (dense), then clock lag, then sampling
        late = D['late'] + G.get('delay',0.)
        tf = np.linspace(0, T, 500); S = np.interp(tf, t, s); V = np.maximum(np.interp(tf, t, v), 1e-5/T); A = np.interp(tf, t, a)
        zt = D['dz'] + rng.normal(0, D['dzt']) - G.get('depth_zero',0.)          # true z = logged z + zt ; contract: true depth = logged + value
        hook = make_hook(cause if kind == 'outside' else None, d, sp, rng, tf, S) 
        kw = dict(xbed=d['xb'], pass_=d['pass_'], dx=d['dx'], hook=hook)
        cb = c*bed
        if sp['type'] == 'leg':
            th = d['a'] + (d['b']-d['a'])*S; om = (d['b']-d['a'])*V; al = (d['b']-d['a'])*A; sg = np.sign(om.mean())
            off = D['jz'] + G.get('joint_zero',0.) - sg*D['backlash']*10
            hip = d['hip'] + zt; tht, omt, alt = th + off, om, al
            F = leg(cb, rho, sp, hip, tht, omt, alt, m, **kw)
            if cause == 'compliance':
                for _ in range(6): 
                    tt = tht + val*comp_sign*F[2]; ot = np.gradient(tt, tf); F = leg(cb, rho, sp, hip, tt, np.where(np.sign(ot)==sg, ot, sg*1e-4), alt, m, **kw)
            if cause == 'tool_mass': pass
            path = np.abs(th-d['a'])*sp['chord']*.7
            log = dict(theta=th, omega=om); nominal = leg(c0, rho, shp[d['shape']], d['hip'], th, om, al, {})
        else:
            cg, sgm = np.cos(d['g']), np.sin(d['g']); dirx = d['sg']*cg; 
            if d['g'] > np.pi/2-1e-9: dirx = 0.
            x = dirx*d['L']*S; z = d['z0'] - sgm*d['L']*S; vx = dirx*d['L']*V; vz = -sgm*d['L']*V; ax = dirx*d['L']*A; az = -sgm*d['L']*A
            be = d['b'] + (atts[d['shape']] + rng.normal(0, D['patt']) + G.get('attitude',0.))*(d['sg'] if dirx else 1.)   # a physical tilt, mirrored frame flips it
            zz = z + zt + D['backlash']*np.sign(sgm)
            bb = np.full_like(x, be)
            F = plate(cb, rho, sp, x, zz, vx, vz, bb, (ax, az), m, **kw)
            if cause == 'tip_bending':
                for _ in range(5): F = plate(cb, rho, sp, x, zz, vx, vz, be - .5*F[2]*0 - .035*F[1]*np.sign(be+1e-9), (ax, az), m, **kw)
            if cause == 'tool_mass': F = F + np.stack([-.25*ax, -.25*az, 0*ax])
            path = d['L']*S; log = dict(x=x, z=z, vx=vx, vz=vz); nominal = plate(c0, rho, shp[d['shape']], x, z, vx, vz, np.full_like(x, d['b']), (ax, az), {})
        ref = F.copy(); scale = np.abs(nominal)
        lever = .05 if sp['type'] == 'leg' else .015
        amp = np.hypot(F[0], F[1])
        g1, g2, g3 = (smooth(rng, path, D['ell']) for _ in range(3))
        F = F + D['grain']*np.stack([amp*(.8*g1+.2*g2)*.7, amp*(.5*g1+.85*g2)*.7, (.4*F[2]*g1 + .5*amp*lever*g3)])
        if cause == 'cell_nonlinear': F[:2] = F[:2]*(1 + .35*np.abs(F[:2])/np.maximum(np.abs(F[:2]).max(), 3.)*np.sign(F[:2]))
        # sensor
        gx = 1 + D['gain']; xt = D['xt'] + np.array([G.get('cross_talk',0.)]*2)
        M = np.stack([gx[0]*F[0] + xt[0]*F[1], gx[1]*F[1] + xt[1]*F[0], gx[2]*F[2]])
        ti = D['tilt']; M[:2] = np.stack([np.cos(ti)*M[0]-np.sin(ti)*M[1], np.sin(ti)*M[0]+np.cos(ti)*M[1]])
        o = D['origin'] + G.get('origin',0.); M[2] = M[2] + o*M[0]*1. - o*M[1]*1.
        M = np.stack([play(q, D['hyst']*max(np.abs(q).max(),.5)*.5) for q in M])
        if 'lowpass' in G:
            k_ = 1-np.exp(-(tf[1]-tf[0])/G['lowpass']); 
            for q in range(3):
                y = M[q,0]
                for j in range(500): y += k_*(M[q,j]-y); M[q,j] = y
        M = np.stack([np.interp(ts - late - abs(rng.normal(0,.0002))*(not clean), tf, q) for q in M])
        if i % D['tare'] == 0: zero = -D['thermal']*temp[i]*np.array([1,-.7,.04]) + rng.normal(0, D['offs']*.5, 3)*np.array([1,1,.05])
        w = np.cumsum(rng.normal(0,1,(3,ns)),1)/np.sqrt(ns); wsc = np.array([1,1,.05])[:,None]
        M = M + (zero + D['thermal']*temp[i]*np.array([1,-.7,.04]))[:,None] + rng.normal(0, D['offs'], (3,1))*wsc + D['drift']*w*wsc + rng.normal(0, D['white'], (3,ns))*wsc
        if D['q']: M[:2] = np.round(M[:2]/D['q'])*D['q']
        if D['outl']:
            for q in range(2):
                hit = rng.random(ns) < .0015; M[q,hit] += rng.choice([-1,1],hit.sum())*rng.uniform(1,4,hit.sum())*np.abs(M[q]).max()*.4
        L_ = {q:np.interp(ts, tf, y) for q, y in log.items()}
        for q in ('omega','vx','vz'):
            if q in L_ and not clean: L_[q] = L_[q]*(1 + rng.normal(0,.004,ns))
        trials.append(dict(i=i, k=k, r=r, d=d, ts=ts, L=L_, M=M, ref=np.stack([np.interp(ts, tf, q) for q in ref]), nom=np.stack([np.interp(ts, tf, q) for q in nominal])))
    if D['sat']:
        lim = np.max([np.abs(t['M'][1]).max() for t in trials])*.9
        for t in trials: t['M'][1] = np.clip(t['M'][1], -lim, lim)
    os.makedirs(out, exist_ok=True)
    cols = 'trial,condition,rep,kind,shape,medium,hip_z,plate_beta,plate_gamma,pass,pass_dx,x_bed,t,theta,omega,x,z,vx,vz,Fx,Fz' + (',Ty' if ty else '')
    with open(f'{out}/log.csv','w') as f:
        f.write(cols + '\n'); t0 = 0.
        for t in trials:
            d = t['d']; lg = shp[d['shape']]['type'] == 'leg'; L = t['L']
            for j in range(len(t['ts'])):
                head = [f"t{t['i']:02d}", f"c{t['k']}", t['r'], 'leg' if lg else 'plate', d['shape'], med, f"{d['hip']:.5f}" if lg else '', '' if lg else f"{d['b']:.5f}", '' if lg else f"{d['g']:.5f}", d['pass_'], d['dx'], f"{d['xb']:.4f}", f"{t['ts'][j]:.6f}"]
                kin = [f"{L['theta'][j]:.6g}", f"{L['omega'][j]:.6g}", '', '', '', ''] if lg else ['', ''] + [f"{L[q][j]:.6g}" for q in ('x','z','vx','vz')]
                f.write(','.join(map(str, head + kin + [f"{q:.6g}" for q in t['M'][:3 if ty else 2, j]])) + '\n')
    with open(f'{out}/exp.toml','w') as f:
        f.write(f'kind = "intrusion"\nmedium = "{med}"\nbulk_density = {rho}\ncoefficient_sd = {csd}\n')
        for k, s in shp.items():
            f.write(f'\n[shape.{k}]\n' + ''.join(f'{a} = {json.dumps(b)}\n' for a, b in s.items()))
    # factor of the force without noise: per condition, least squares of true on stated
    fa = []
    for k in range(ncond):
        A_ = np.concatenate([t['nom'][:2].ravel() for t in trials if t['k']==k]); B_ = np.concatenate([t['ref'][:2].ravel() for t in trials if t['k']==k]); fa.append((A_@B_)/(A_@A_))
    truth.update(factor=float(np.exp(np.mean(np.log(np.maximum(fa,1e-3))))), per_condition=fa, effect=float(np.sqrt(sum(((t['ref']-t['nom'])[:2]**2).sum() for t in trials)/sum((t['nom'][:2]**2).sum() for t in trials))),
                 conditions=ncond, reps=reps, samples=ns, trials=N, Ty=bool(ty), coefficient_sd=float(csd), shapes=[str(u) for u in use], conds=[{a:(float(b) if not isinstance(b,(str,np.str_)) else str(b)) for a,b in d.items()} for d in conds])
    json.dump(truth, open(f'{out}/truth.json','w'), indent=1)
    return truth

comp_sign = 1.
def make_hook(cause, d, sp, rng, tf, S):
    if cause is None: return None
    def hook(fx, fz, pn, q):
        z, v = q['depth'], q['speed']
        if cause == 'hard_bottom': k = 1 + 1.2*np.exp(-(.075-z)/.015); return fx*k, fz*k, pn
        if cause == 'crust': k = np.where(z < .008, 2.6, 1.); return fx*k, fz*k, pn
        if cause == 'linear_drag': return fx, fz, pn + q['rho']*.9*q['vn']
        if cause == 'fluidised': k = 1 - .35*np.exp(-(np.log(np.maximum(v,1e-4)/.12)/.5)**2); return fx*k, fz*k, pn
        if cause == 'rate_weakening_slow': k = 1 + .45/(1 + v/.03); return fx*k, fz*k, pn
        if cause == 'edge_effect': k = .6 + .4*.025/q['w'] + .8*z/q['w']*.25; return fx*k, fz*k, pn
        if cause == 'wet_at_depth': return fx, fz, pn + 1500*np.clip((z-.02)/.02, 0, 1)*np.tanh(q['vn']/1e-3)
        if cause == 'buildup': k = (1 - .5*np.exp(-d.get('L',.05)*S/.015))[:,None]; return fx*k, fz*k, pn
        return fx, fz, pn
    return hook
if __name__ == '__main__': print(make(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), sys.argv[4]))
