"""compare.py OUT1 OUT2: which logs changed their verdict between two runs of the same seed, and whether that is better."""
import json, pathlib, sys
import score

RANK = {'exact': 3, 'in_set': 2, 'silent': 1, 'refused': 1, 'wrong_set': 0, 'wrong': -1}
a, b = ({(r['seed'], r['index'], r['kind']): r for r in map(json.loads, (pathlib.Path(d) / 'results.jsonl').read_text().splitlines())} for d in sys.argv[1:3])
both = [k for k in a if k in b]
better = worse = 0
for k in both:
    x, y = a[k], b[k]
    if (x['category'], x['answer'].split('=')[0]) != (y['category'], y['answer'].split('=')[0]):
        d = RANK[y['category']] - RANK[x['category']]
        better += d > 0
        worse += d < 0
        print(f"{'+' if d > 0 else '-' if d < 0 else ' '} log {k[1]:3} {k[2]:8} {x['cause'] or 'none':16} {x['category']:9} -> {y['category']:9} | {x['answer'][:60]} -> {y['answer'][:60]}")
print(f"{len(both)} logs in both; {better} better, {worse} worse")
for c in score.CATEGORIES:
    print(f"  {c:9} {sum(a[k]['category'] == c for k in both):3} -> {sum(b[k]['category'] == c for k in both):3}")
print(f"  violations {sum(len(a[k]['violations']) for k in both)} -> {sum(len(b[k]['violations']) for k in both)};  seconds {sum(a[k]['seconds'] for k in both):.0f} -> {sum(b[k]['seconds'] for k in both):.0f}")
