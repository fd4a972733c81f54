import json, os, sys, glob, statistics as st
root = sys.argv[1]; tab = {}; ci = []; fac = []; det = []; cpu = []; wall = []
ALIAS = {'attitude':{'attitude'}, 'joint_zero':{'joint_zero'}, 'size':{'size'}, 'delay':{'delay'}, 'depth_zero':{'depth_zero'}, 'cross_talk':{'cross_talk'}, 'lowpass':{'lowpass'}, 'origin':{'origin'}}
for d in sorted(glob.glob(root + '/*_??')):
    t = json.load(open(d + '/truth.json')); k = t['kind']
    if 'rc' not in t: continue
    wall.append(t['wall']); cpu.append(t['cpu'])
    if t['rc']: cls = 'refused'; r = None; ids = []; v = 'refused'
    else:
        r = json.load(open(d + '/d/report.json')); v = r['verdict']; ids = [c['id'] for c in r['causes']]; kinds = [c.get('kind') for c in r['causes']]
        true = {t['cause']} if k in ('singles','geometry') else set()
        if k == 'weaker': true = {'scale'}
        sets = [set(s) for s in r['ambiguity_set']]
        if v == 'named':
            if set(ids) == true: cls = 'exact'
            elif any(i not in true and q == 'sand' for i, q in zip(ids, kinds)): cls = 'WRONG NAME'
            elif true & set(ids): cls = 'in the set'
            else: cls = 'wrong measurement'
        elif v == 'ambiguous': cls = 'in the set' if any(true and true <= s for s in sets) else 'wrong set'
        elif v == 'recalibrated': cls = {'weaker':'exact','nulls':'exact (recal.)'}.get(k, 'silent')
        elif v == 'noise_floor': cls = 'exact' if k == 'nulls' else 'silent'
        elif v in ('none_of_these','described'): cls = 'exact' if k == 'outside' else ('alarm: '+v if k == 'nulls' else 'silent')
        else: cls = 'silent'
        if v == 'named' and k in ('singles','geometry'):
            for c in r['causes']:
                if c['id'] == t['cause'] and c['ci95']: ci.append((d, c['id'], t['value'], c['value'], c['ci95'], c['ci95'][0] <= t['value'] <= c['ci95'][1]))
        if k == 'weaker':
            rc = r.get('recalibration') or {}; c = rc.get('ci95'); 
            if c: fac.append((d, v, t['value'], t['factor'], rc['factor'], c, c[0] <= t['value'] <= c[1], c[0] <= t['factor'] <= c[1]))
            if v == 'named' and ids == ['scale']:
                q = r['causes'][0]; ci.append((d, 'scale', t['value']-1, q['value'], q['ci95'], q['ci95'][0] <= t['value']-1 <= q['ci95'][1]))
        if k in ('nulls','singles','geometry','outside'):
            rc = r.get('recalibration') or {}; 
    tab.setdefault(k, {}).setdefault(cls, []).append(os.path.basename(d))
    det.append((os.path.basename(d), t['cause'], t['value'], round(t['effect'],3), v, ids, [] if r is None else r['ambiguity_set'], cls, round(t['wall'],1)))
cl = sorted({c for x in tab.values() for c in x})
print('| kind | n | ' + ' | '.join(cl) + ' |'); print('|---'*(len(cl)+2) + '|')
for k in ('nulls','weaker','singles','geometry','outside'):
    if k in tab: print(f"| {k} | {sum(map(len,tab[k].values()))} | " + ' | '.join(str(len(tab[k].get(c, []))) for c in cl) + ' |')
print(); [print(x) for x in det]
print('\nci95 of names:'); [print(x) for x in ci]; print('\nfactor:'); [print(x) for x in fac]
ok = [x for x in cpu if x]
if wall: print('wall median', st.median(wall), 'max', max(wall), 'cpu median', st.median(ok), 'max', max(ok), 'n', len(wall))
