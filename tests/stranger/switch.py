"""switch.py BINARY SEED INDEX [PART,PART …] …: one log of the default kinds, made again without some parts of the mess (each argument one variant; `+PART,…` keeps only these)."""
import os, pathlib, json, sys, tempfile
import generate, run, score

os.nice(15)
binary, seed, index = os.path.abspath(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
kind = generate.KINDS[index % 5]
for v in sys.argv[4:]:
    only = tuple(filter(None, v[1:].split(','))) if v.startswith('+') else None
    off = () if only is not None else tuple(filter(None, v.split(',')))
    csv, toml, truth = generate.make(seed, index, kind, None, off, only)
    with tempfile.TemporaryDirectory() as d:
        f = pathlib.Path(d)
        (f / 'data.csv').write_text(csv); (f / 'exp.toml').write_text(toml)
        code, err, said, sec, cpu = run.one(binary, f)
        if code != 0:
            print(index, v or 'all', 'exit', code, err[:100], flush=True); continue
        r = json.loads((f / 'out' / 'report.json').read_text())
        ci = ' '.join(f"{c['id']}={c['value']:.3g} [{c['ci95'][0]:.3g}, {c['ci95'][1]:.3g}]" for c in r['causes'])
        print(f"{index:3} {('without ' + v) if only is None and v else ('only ' + v[1:]) if v else 'all':40} {score.classify(truth, r)[0]:9} {score.answer(r)[:60]:60} {ci}  ({sec:.0f} s)", flush=True)
