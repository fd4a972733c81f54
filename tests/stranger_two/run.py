import sys, os, json, subprocess, time
from gen import make
BIN='sandgait'
def one(kind, i, seed, root, clean=False):
    out = f'{root}/{kind}_{i:02d}'; t = make(kind, i, seed, out, clean=clean); t0 = time.time()
    p = subprocess.run(['nice','-n','15','/usr/bin/time','-f','%e %U',BIN,'diagnose',f'{out}/log.csv','--experiment',f'{out}/exp.toml','--out',f'{out}/d'], capture_output=True, text=True)
    w = time.time()-t0; open(f'{out}/console.txt','w').write(p.stdout+'\n---\n'+p.stderr); t['rc']=p.returncode; t['wall']=w
    try: t['cpu']=float(p.stderr.strip().split('\n')[-1].split()[1])
    except Exception: t['cpu']=None
    json.dump(t, open(f'{out}/truth.json','w'), indent=1)
    if p.returncode: print(out, kind, t['cause'], 'REFUSED', p.returncode, p.stderr[-300:], flush=True); return
    r = json.load(open(f'{out}/d/report.json'))
    print(f"{kind}_{i:02d} {t['cause']} {t['value'] if t['value'] is None else round(t['value'],4)} eff {t['effect']:.2f} {t['style']} {t['conditions']}x{t['reps']}x{t['samples']} | {r['verdict']} {[(c['id'],c.get('kind'),round(c['value'],4),[round(x,4) for x in c['ci95']] if c['ci95'] else None) for c in r['causes']]} set {r['ambiguity_set']} written {r['written']} | {r['headline']} | {w:.0f}s", flush=True)
    if kind in ('weaker',): print('   factor', t['factor'], t['value'], r.get('recalibration',{}).get('factor'), r.get('recalibration',{}).get('ci95'), flush=True)
if __name__ == '__main__':
    root, seed = sys.argv[1], int(sys.argv[2])
    for a in sys.argv[3:]:
        k, i = a.split(':'); clean = k.endswith('!'); one(k.rstrip('!'), int(i), seed, root, clean)
