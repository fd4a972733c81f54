import sys, json, csv, numpy as np
import gen, law
# compares the program's plain predictions (curves.csv) with my law on the logged kinematics
out = sys.argv[1]; t = json.load(open(out+'/truth.json'))
log = list(csv.DictReader(open(out+'/log.csv'))); cur = list(csv.DictReader(open(out+'/d/curves.csv')))
print(list(cur[0].keys()), len(log), len(cur))
import tomllib; e = tomllib.load(open(out+'/exp.toml','rb')); c0, rho = law.MEDIA[t['medium']]
by = {}
for k, r in enumerate(log): by.setdefault(r['trial'], []).append(r)
pb = {}
for r in cur: pb.setdefault(r['trial'], []).append(r)
f = lambda R, q: np.array([float(r[q]) for r in R])
res = {}
for tr, R in by.items():
    sp = e['shape'][R[0]['shape']]; P = pb[tr]
    if len(P) != len(R): print('len', tr, len(P), len(R)); continue
    if R[0]['kind'] == 'leg': F = law.leg(c0, rho, sp, float(R[0]['hip_z']), f(R,'theta'), f(R,'omega'), 0*f(R,'t'), {})
    else: F = law.plate(c0, rho, sp, f(R,'x'), f(R,'z'), f(R,'vx'), f(R,'vz'), f(R,'plate_beta'), (0*f(R,'t'),)*2, {})
    for k, q in enumerate(['Fx','Fz','Ty']):
        if q+'_plain' in P[0]:
            p = f(P, q+'_plain'); s = np.sqrt(np.mean(p**2)); dd = np.sqrt(np.mean((p-F[k])**2)); res.setdefault((R[0]['shape'], R[0]['condition'], q), []).append((s, dd, np.sqrt(np.mean((f(R,q)-p)**2))))
for k, v in res.items(): print(k, np.round(np.mean(v, 0), 5))
