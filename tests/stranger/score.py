"""What an answer is worth, given the truth. README.md says the same in words."""
SAND = {'inertial_drag', 'concave_fill', 'footprint', 'added_mass', 'depth_power', 'cohesion', 'scale', 'packing_grad', 'slope', 'rate_log', 'friction_clip',
        'skid_loss', 'graze_loss', 'slip_bearing'}
# what else names the same thing about the rig, without blaming the sand
SAME = {'attitude': {'attitude'}, 'joint_zero': {'joint_zero'}, 'size': {'size', 'geometry'}, 'delay': {'delay', 'lowpass', 'clock'},
        'sensor_tilt': {'sensor_tilt', 'cross_talk', 'tilt'}, 'depth_zero': {'depth_zero'}}
CATEGORIES = ['exact', 'in_set', 'silent', 'wrong', 'wrong_set', 'refused']


ELSEWHERE = {'compliance', 'motor_torque_limit'}            # not of the sand, but no log has them: naming one is wrong, too


def is_sand(c):
    kind = c.get('kind')
    return kind == 'sand' if kind else c['id'] in SAND


def answer(report):
    v = report['verdict']
    if v == 'named':
        return 'named ' + '+'.join(f"{c['id']}={c['value']:.3g}" for c in report['causes'])
    if v == 'ambiguous':
        return 'ambiguous ' + '|'.join('+'.join(s) for s in report['ambiguity_set'])
    if v == 'recalibrated':
        f = (report.get('recalibration') or {}).get('factor')
        return f'recalibrated x{f:.3g}' if f else 'recalibrated'
    if v == 'described':
        return 'described ' + ';'.join(t['formula'] for t in report.get('terms') or [])[:60]
    return v


def classify(truth, report):
    """(category, causes named that are none of measuring). Only a definite name of a cause of the sand that is not there is `wrong`."""
    v, kind, cause = report['verdict'], truth['kind'], truth['cause']
    blamed = lambda c: is_sand(c) or c['id'] in ELSEWHERE    # noqa: E731
    named = {c['id'] for c in report['causes'] if blamed(c)} if v == 'named' else set()
    other = {c['id'] for c in report['causes'] if not blamed(c)} if v == 'named' else set()
    sets = [set(s) for s in report['ambiguity_set']] if v == 'ambiguous' else []
    if kind == 'nulls':
        if v in ('noise_floor', 'recalibrated', 'insufficient_data') or (v == 'named' and not named):
            return 'exact', named
        return ('wrong' if named else 'wrong_set' if v == 'ambiguous' and all(s & SAND for s in sets) else 'silent'), named
    if kind == 'weaker':
        if v == 'recalibrated':
            return 'exact', named
        if named == {'scale'} or any(s == {'scale'} for s in sets):
            return 'in_set', named - {'scale'}
        return ('wrong' if named else 'wrong_set' if v == 'ambiguous' and all(s & SAND for s in sets) else 'silent'), named
    if kind == 'singles':
        if named == {cause}:
            return 'exact', named
        if any(cause in s for s in sets):
            return 'in_set', named
        return ('wrong' if named else 'wrong_set' if sets else 'silent'), named
    if kind == 'geometry':
        same = SAME[cause]
        if not named and other & same:
            return 'exact', named
        if any(s & same for s in sets):
            return 'in_set', named
        return ('wrong' if named else 'wrong_set' if v == 'ambiguous' and all(s & SAND for s in sets) else 'silent'), named
    # outside of the catalogue: a law, a set or none is right; noise_floor and a measurement's name are silence
    if named:
        return 'wrong', named
    if v in ('none_of_these', 'described'):
        return 'exact', named
    return ('in_set' if v == 'ambiguous' else 'silent'), named


def true_value(truth, cid):
    if truth['kind'] == 'singles' and cid == truth['cause']:
        return truth['value']
    if truth['kind'] == 'weaker' and cid == 'scale':
        return truth['factor'] - 1
    if truth['kind'] == 'geometry' and cid == truth['cause']:
        return truth['value']
    return None


def coverage(truth, report):
    """[(what, inside?, signed distance)] for every interval or limit whose true value is known."""
    out = []
    for c in report['causes'] if report['verdict'] in ('named', 'ambiguous') else []:
        w = true_value(truth, c['id'])
        if w is not None and c.get('ci95') and None not in c['ci95']:
            out.append(('interval', c['ci95'][0] <= w <= c['ci95'][1], f"{c['id']} {w:.3g} in [{c['ci95'][0]:.3g}, {c['ci95'][1]:.3g}]"))
    if truth['kind'] in ('singles', 'weaker'):
        cid = truth['cause'] if truth['kind'] == 'singles' else 'scale'
        w = true_value(truth, cid)
        for u in report.get('upper_limits') or []:
            if u['id'] == cid and u.get('value') is not None:
                out.append(('limit', abs(w) <= abs(u['value']), f"{cid} {w:.3g} below {u['value']:.3g}"))
    r = report.get('recalibration')
    if truth['kind'] == 'weaker' and r and r.get('ci95'):
        out.append(('factor', r['ci95'][0] <= truth['factor'] <= r['ci95'][1], f"factor {truth['factor']:.3g} in [{r['ci95'][0]:.3g}, {r['ci95'][1]:.3g}]"))
    return out
