"""run.py BINARY N SEED OUT [--kinds nulls,singles,outside,weaker,geometry]: see README.md."""
import argparse, collections, json, os, pathlib, resource, subprocess, sys, time
import generate, score

CHECK = '../shared/checks/report_truth.py'


def one(binary, folder, timeout=1800):
    out = folder / 'out'
    cpu = lambda: sum(resource.getrusage(resource.RUSAGE_CHILDREN)[:2])   # noqa: E731
    t0, c0 = time.perf_counter(), cpu()
    try:
        p = subprocess.run([binary, 'diagnose', str(folder / 'data.csv'), '--experiment', str(folder / 'exp.toml'), '--out', str(out)],
                           capture_output=True, text=True, timeout=timeout)
        code, err, said = p.returncode, p.stderr.strip(), p.stdout.strip()
    except subprocess.TimeoutExpired:
        code, err, said = 'timeout', '', ''
    return code, err, said, time.perf_counter() - t0, cpu() - c0


def truth_check(files):
    bad = collections.defaultdict(list)
    if files:
        p = subprocess.run([sys.executable, CHECK] + [str(f) for f in files], capture_output=True, text=True)
        names = {str(f) for f in files}
        for line in p.stdout.splitlines():
            f, _, text = line.partition(': ')
            if f in names:
                bad[f].append(text)
        if p.stderr.strip():
            bad['checker'].append(p.stderr.strip().splitlines()[-1])
    return bad


def table(rows, out=sys.stdout):
    say = lambda *a: print(*a, file=out)                      # noqa: E731
    say(f"{len(rows)} logs")
    say('kind      n    exact  in set  silent  wrong  wrong set  refused | verdicts')
    for kind in generate.KINDS:
        r = [x for x in rows if x['kind'] == kind]
        if not r:
            continue
        c = collections.Counter(x['category'] for x in r)
        v = collections.Counter(x['verdict'] for x in r)
        say(f"{kind:9} {len(r):3}  {c['exact']:5}  {c['in_set']:6}  {c['silent']:6}  {c['wrong']:5}  {c['wrong_set']:9}  {c['refused']:7} | " + ', '.join(f'{k} {n}' for k, n in v.most_common()))
    s = [x for x in rows if x['kind'] == 'singles']
    if s:
        say('\nsingles by size of the effect (rms of the force it changes, or of sinkage over radius):')
        for lo, hi in [(0, .03), (.03, .1), (.1, .3), (.3, 99)]:
            r = [x for x in s if lo <= x['effect'] < hi]
            c = collections.Counter(x['category'] for x in r)
            if r:
                say(f'  {lo:.0%} to {hi:.0%}: {len(r)}: ' + ', '.join(f'{k} {c[k]}' for k in score.CATEGORIES if c[k]))
        say('singles by cause: ' + '; '.join(f"{k}: " + ', '.join(f'{q} {n}' for q, n in sorted(collections.Counter(x['category'] for x in s if x['cause'] == k).items())) for k in sorted({x['cause'] for x in s})))
    for kind in ('outside', 'geometry'):
        s = [x for x in rows if x['kind'] == kind]
        if s:
            say(f'{kind} by cause: ' + '; '.join(f"{k}: " + ', '.join(f'{q} {n}' for q, n in sorted(collections.Counter(x['category'] for x in s if x['cause'] == k).items())) for k in sorted({x['cause'] for x in s})))
    for cat in ('wrong', 'wrong_set'):
        w = [x for x in rows if x['category'] == cat]
        say(f"\n{cat} ({len(w)}):")
        for x in w:
            say(f"  seed {x['seed']} log {x['index']:3} {x['kind']:8} {'force' if x['form'] == 'intrusion' else 'body '} truth {x['cause'] or 'none'}{'' if x['value'] is None else ' ' + str(x['value'])[:28]} factor {x['factor']:.2f} effect {x['effect']:.1%} "
                f"({x['conditions']}x{x['reps']}) -> {x['answer']} ; gain {x['gain']}")
    n = [x for x in rows if x['kind'] == 'nulls']
    say(f"\ncauses of kind sand in nulls: {sum(bool(set(x['sand']) & score.SAND) for x in n)} of {len(n)}: " + ', '.join(f"log {x['index']} {x['answer']}" for x in n if set(x['sand']) & score.SAND))
    say('refused or failed: ' + ('; '.join(f"log {x['index']} ({x['kind']} {x['cause']}): {x['error'][:160]}" for x in rows if x['category'] == 'refused') or 'none'))
    viol = [(x['index'], t) for x in rows for t in x['violations']]
    say(f"truth-check violations: {len(viol)} in {len({i for i, _ in viol})} reports")
    for i, t in viol:
        say(f'  log {i:3}: {t}')
    for what in ('interval', 'limit', 'factor'):
        c = [(x['index'], ok, text) for x in rows for w, ok, text in x['coverage'] if w == what]
        if c:
            say(f"true value inside ({what}): {sum(ok for _, ok, _ in c)} of {len(c)}; outside: " + ('; '.join(f'log {i} {t}' for i, ok, t in c if not ok) or 'none'))
    t, c = sorted(x['seconds'] for x in rows), sorted(x['cpu'] for x in rows)
    say(f"time per log: median {t[len(t) // 2]:.1f} s, 90 % {t[int(.9 * (len(t) - 1))]:.1f} s, longest {t[-1]:.1f} s, all {sum(t):.0f} s; processor time: median {c[len(c) // 2]:.1f} s, longest {c[-1]:.1f} s")


def main():
    a = argparse.ArgumentParser(description=__doc__)
    a.add_argument('binary'); a.add_argument('n', type=int); a.add_argument('seed', type=int); a.add_argument('out')
    a.add_argument('--kinds', default=','.join(generate.KINDS)); a.add_argument('--cause'); a.add_argument('--off', default='', help='parts of the mess to leave out')
    a.add_argument('--only', help='only these parts of the mess ("" for none)'); a.add_argument('--indices', help='only these logs, as 3,17'); a.add_argument('--score', action='store_true', help='score the reports that are there')
    a.add_argument('--resume', action='store_true', help='keep the logs that are finished, make the others')
    o = a.parse_args()
    os.nice(max(0, 15 - os.nice(0)))                         # the generator, too, steps back for others
    kinds = o.kinds.split(',')
    out = pathlib.Path(o.out).resolve()
    rows = []
    indices = [int(i) for i in o.indices.split(',')] if o.indices else range(o.n)
    for i in indices:
        kind = kinds[i % len(kinds)]
        folder = out / 'logs' / f'{i:04d}'
        if o.score and not (folder / 'run.json').exists():
            continue
        folder.mkdir(parents=True, exist_ok=True)
        made = not o.score and not (o.resume and (folder / 'run.json').exists())
        if made:
            csv, toml, truth = generate.make(o.seed, i, kind, o.cause, tuple(filter(None, o.off.split(','))), None if o.only is None else tuple(filter(None, o.only.split(','))))
            (folder / 'data.csv').write_text(csv); (folder / 'exp.toml').write_text(toml); (folder / 'truth.json').write_text(json.dumps(truth, indent=1, default=float))
            rep = folder / 'out' / 'report.json'
            if rep.exists():
                rep.unlink()
            code, err, said, sec, cpu = one(o.binary, folder)
            (folder / 'run.json').write_text(json.dumps(dict(code=code, err=err, said=said, seconds=sec, cpu=cpu)))
        truth = json.loads((folder / 'truth.json').read_text())
        ran = json.loads((folder / 'run.json').read_text())
        row = {k: truth[k] for k in ('seed', 'index', 'kind', 'form', 'cause', 'value', 'factor', 'effect', 'conditions', 'reps')}
        row.update(seconds=ran['seconds'], cpu=ran.get('cpu', 0.), said=ran['said'], error='', violations=[], coverage=[], sand=[], gain=None)
        rep = folder / 'out' / 'report.json'
        if ran['code'] != 0 or not rep.exists():
            row.update(category='refused', verdict=f"exit {ran['code']}", answer=f"exit {ran['code']}", error=ran['err'])
        else:
            r = json.loads(rep.read_text())
            cat, named = score.classify(truth, r)
            g = r['gain']
            row.update(category=cat, verdict=r['verdict'], answer=score.answer(r), sand=sorted(named), coverage=score.coverage(truth, r), report=str(rep),
                       gain=None if g.get('reduction') is None else [round(g['reduction'], 3)] + [None if q is None else round(q, 3) for q in (g.get('ci95') or [])])
        rows.append(row)
        if made:
            print(f"{i:4} {kind:8} {row['cause'] or '-':16} {row['category']:9} {row['answer'][:90]} ({row['seconds']:.1f} s)", flush=True)
    bad = truth_check([x['report'] for x in rows if x.get('report')])
    for x in rows:
        x['violations'] = bad.get(x.get('report'), [])
    if 'checker' in bad:
        print('the checker failed:', bad['checker'])
    (out / 'results.jsonl').write_text(''.join(json.dumps(x) + '\n' for x in rows))
    with open(out / 'table.txt', 'w') as f:
        table(rows, f)
    print(); table(rows)


if __name__ == '__main__':
    main()
