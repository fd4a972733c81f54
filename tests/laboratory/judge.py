#!/usr/bin/env python3
"""judge.py BIN LOGDIR OUT [filter ...] [--redo]
Runs `BIN diagnose` on the logs (2 workers), keeps OUT/log_NNN/report.json, and compares them with LOGDIR/truth.json.
A filter keeps logs whose number, kind, id, rig letter, strength or flag equals it (several: any of them).
Reports that exist are not made anew (--redo does), so judging again costs nothing.

RULES, fixed from the contract before any result was seen
named, with every cause:  (aliases: tilt = sensor_tilt; offset, bias_x, bias_z = offset; gain_* = gain, but not gain_drift)
  right        exactly the truth; also the truth with a further effect of measuring whose true value (all logs carry small ones) lies within 3 sd
  near         outside: the cause of the same kind in another form (truth.json `near`). The contract asks that its form be rejected; no wrong name, but no credit
  measure_ok   null (or outside, or a sand too faint): only effects of measuring that are truly there (value within 3 sd, sign free where the contract leaves
               it open), or gain_drift / bed_strength (days have their own gain in every log)
  WRONG_NAME   a cause of the sand (or robot) that is not there; in nulls and measure logs a cause of the sand; a wrong second cause
  WRONG_MEAS   an effect of measuring that is not there, or has another value by more than 3 sd, while no cause of the sand is named
ambiguous:
  right_set    a member of the set is the truth (alone, or with effects of measuring)
  null_set     null: a member consists of effects of measuring that every log has in small (a soft claim, no wrong one)
  near_set     outside: a member consists of `near` causes
  WRONG_SET    otherwise
recalibrated:  right_recal for scale, gain (all channels), size; recal elsewhere (coefficients are off in all logs, so in nulls it is right)
silent = noise_floor; described, none_of_these, insufficient_data as they are; refused = exit code not 0 or no report
wrong value (for right and right_set with the truth's value in causes): |value - truth| > 3 sd, sd = width of ci95 / 3.92; coverage: truth in ci95.
Not compared: values of offset given by channel alone are; size, attitude, joint_zero, cross_talk by magnitude (signs are not in the contract).
"""

import sys, os, json, subprocess, collections
from concurrent.futures import ThreadPoolExecutor

SANDS = {
    "inertial_drag",
    "concave_fill",
    "footprint",
    "added_mass",
    "depth_power",
    "cohesion",
    "scale",
    "packing_grad",
    "slope",
    "rate_log",
    "friction_clip",
    "skid_loss",
    "graze_loss",
    "slip_bearing",
    "sliding_face",
    "motor_torque_limit",
}
FREE_SIGN = {"size", "attitude", "joint_zero", "cross_talk"}
PLAUSIBLE = {"gain_drift", "bed_strength"}


def norm(i):
    i = i.lower()
    if i in ("tilt", "sensor_tilt"):
        return "sensor_tilt"
    if i.startswith("offset") or i.startswith("bias"):
        return "offset"
    if i.startswith("gain") and "drift" not in i:
        return "gain"
    for p in ("cross_talk", "depth_zero", "delay", "lowpass", "attitude", "joint_zero", "size"):
        if i.startswith(p):
            return p
    return i


def ids_of(c):
    if isinstance(c, str):
        return [c]
    if isinstance(c, dict):
        return [c["id"]] if "id" in c else list(c.get("ids", []))
    return [i for e in c for i in ids_of(e)]


def true_values(T, i, of=None):
    """possible true values of an id of measuring in this log; `of` is the channel, where the report gives one"""
    m, n = T["total_measuring"], norm(i)
    if n == "offset":
        if i.endswith("x") or of == "Fx":
            return [m["bias_x"]]
        if i.endswith("z") or of == "Fz":
            return [m["bias_z"]]
        return [m["bias_x"], m["bias_z"]]
    if n == "cross_talk":
        return [m.get("cross_talk", 0), m.get("cross_talk_z", 0)]
    if n == "gain" and of in ("Fx", "Ty"):
        return [m.get("gain", 0)]
    if n == "gain" and of == "Fz":
        return [m.get("gain", 0) + m.get("gain_z", 0)]
    if n == "gain":
        return [m.get("gain", 0), m.get("gain", 0) + m.get("gain_z", 0), m.get("gain_z", 0)]
    return [m[n]] if n in m else ([m[i]] if i in m else [])


def sd_of(c):
    ci = c.get("ci95")
    return None if not ci or ci[0] is None or ci[1] is None else (ci[1] - ci[0]) / 3.92


def present(T, c):
    """is this measuring effect truly there with this value?"""
    if norm(c["id"]) in PLAUSIBLE:
        return True
    v, sd = c.get("value"), sd_of(c)
    tv = true_values(T, c["id"], c.get("of"))
    if not tv:
        return False
    if v is None or sd is None:
        return any(abs(t) > 0 for t in tv)
    f = (lambda a: [a, -a]) if norm(c["id"]) in FREE_SIGN else (lambda a: [a])
    return any(abs(v - s) <= 3 * sd + 1e-12 for t in tv for s in f(t))


def truth_is(T, ident):
    if T["kind"] == "sand":
        return ident == T["id"]
    if T["kind"] == "measure":
        return norm(ident) == norm(T["id"])
    return False


def judge(T, r):
    """outcome, details"""
    v = r.get("verdict")
    C = r.get("causes") or []
    name = [c["id"] for c in C]
    if v == "noise_floor":
        return "silent", ""
    if v in ("described", "none_of_these", "insufficient_data"):
        return v, ""
    if v == "recalibrated":
        return (
            "right_recal" if T["id"] in ("scale", "size") or (T["id"] == "gain" and T["channel"] != "z") else "recal"
        ), ""
    if v == "named":
        sand = [c for c in C if c["id"] in SANDS or c["id"] == "compliance" or c.get("kind") == "robot"]
        meas = [c for c in C if c not in sand]
        hit = [c for c in C if truth_is(T, c["id"])]
        rest = [c for c in C if not truth_is(T, c["id"])]
        s_rest = [c for c in rest if c in sand]
        m_bad = [c for c in rest if c in meas and not present(T, c)]
        if hit and not s_rest and not m_bad:
            return "right", ("with " + "+".join(c["id"] for c in rest) if rest else "")
        if T["kind"] == "outside" and C and all(norm(c["id"]) in T["near"] for c in C):
            return "near", ""
        if s_rest:
            return "WRONG_NAME", "+".join(name)
        if m_bad or (T["kind"] in ("sand", "measure") and not hit and not T["strength"] == "faint"):
            return "WRONG_MEAS", "+".join(name)
        return "measure_ok", "+".join(name)
    if v == "ambiguous":
        sets = [ids_of(s) for s in r.get("ambiguity_set") or []]
        for s in sets:
            rest = [i for i in s if not truth_is(T, i)]
            if len(rest) < len(s) and not [i for i in rest if i in SANDS]:
                return "right_set", str(sets)
        if T["kind"] == "outside" and any(s and all(norm(i) in T["near"] for i in s) for s in sets):
            return "near_set", str(sets)
        if T["kind"] == "null" and any(
            s and all(i not in SANDS and (norm(i) in PLAUSIBLE or true_values(T, i)) for i in s) or not s for s in sets
        ):
            return "null_set", str(sets)
        return "WRONG_SET", str(sets)
    return "verdict?" + str(v), ""


def values(T, r):
    """[(id, value, sd, truth, z, covered)] for the truth's cause"""
    out = []
    for c in r.get("causes") or []:
        if not truth_is(T, c["id"]):
            continue
        sd = sd_of(c)
        if c.get("value") is None or sd is None:
            out.append((c["id"], c.get("value"), None, T["value"], None, None))
            continue
        tv = (
            [T["value"]]
            if T["kind"] == "sand" or not true_values(T, c["id"], c.get("of"))
            else true_values(T, c["id"], c.get("of"))
        )
        if norm(c["id"]) in FREE_SIGN:
            tv = tv + [-t for t in tv]
        t = min(tv, key=lambda t: abs(t - c["value"]))
        out.append((c["id"], c["value"], sd, t, (c["value"] - t) / max(sd, 1e-300), c["ci95"][0] <= t <= c["ci95"][1]))
    return out


def own_contract(r):
    """violations of the contract inside the report, without any truth"""
    e = []
    ev = r.get("evidence") or []
    v, w = r.get("verdict"), r.get("written")
    get = lambda x, k: x.get(k) if isinstance(x, dict) else None
    if len(r.get("headline") or "") > 160 or not r.get("headline"):
        e.append("headline missing or longer than 160")
    if ev:
        if ev[0].get("ids") or ev[0].get("terms"):
            e.append("evidence: row 0 is not the plain model")
        d, s = ev[0].get("difference"), ev[0].get("standard_error")
        if d is not None and s is not None and abs(d) > 2 * max(s, 1e-12):
            if v == "noise_floor":
                e.append(f"noise_floor, but a model is better by {abs(d):.1f} +- {s:.1f}")
            if w == "plain" or get(w, "kind") == "plain":
                e.append(f"plain is written, but a model is better by {abs(d):.1f} +- {s:.1f}")
    else:
        e.append("no evidence")
    for c in r.get("causes") or []:
        ci = c.get("ci95")
        if v == "named" and ci and None not in ci and ci[0] <= 0 <= ci[1]:
            e.append(f"{c['id']} named with an interval that holds 0")
    if v in ("named", "ambiguous") and not r.get("causes"):
        e.append("causes empty")
    if v == "recalibrated" and r.get("causes"):
        e.append("recalibrated, but causes not empty")
    if v not in ("noise_floor",) and r.get("next_experiment") is None:
        e.append("next_experiment null")
    if r.get("check", {}).get("design", {}).get("conditions", 3) and v == "insufficient_data":
        e.append("insufficient_data for a log with repetitions and >= 10 conditions")
    g = (r.get("gain") or {}).get("ci95")
    if (
        v == "named"
        and g
        and None not in g
        and g[0] <= 0
        and any(c.get("kind") == "sand" or c["id"] in SANDS for c in r["causes"])
    ):
        e.append(f"sand named with a gain interval {g} that holds 0")
    return e


def main():
    a = [x for x in sys.argv[1:] if x != "--redo"]
    redo = "--redo" in sys.argv
    binary, logs, out = a[:3]
    filt = set(a[3:])
    T = json.load(open(os.path.join(logs, "truth.json")))["logs"]
    keep = lambda t: (
        not filt
        or filt
        & {
            t["log"],
            t["log"][4:],
            str(int(t["log"][4:])),
            t["kind"],
            t["id"],
            t["rig"][0],
            t["strength"],
            "unidentifiable" if t["unidentifiable"] else "",
            *t["flags"],
        }
    )
    T = [t for t in T if keep(t)]

    def run(t):
        o = os.path.join(out, t["log"])
        p = os.path.join(o, "report.json")
        if redo or not os.path.exists(p):
            os.makedirs(o, exist_ok=True)
            d = os.path.join(logs, t["log"])
            try:
                x = subprocess.run(
                    [binary, "diagnose", d + "/data.csv", "--experiment", d + "/exp.toml", "--out", o],
                    capture_output=True,
                    text=True,
                    timeout=600,
                )
                open(o + "/stdout.txt", "w").write(x.stdout)
                open(o + "/stderr.txt", "w").write(x.stderr)
                if x.returncode:
                    return t, None, f"exit {x.returncode}: {x.stderr.strip()[:300]}"
            except subprocess.TimeoutExpired:
                return t, None, "more than 600 s"
        try:
            return t, json.load(open(p)), ""
        except Exception as e:
            return t, None, f"no report: {e}"

    with ThreadPoolExecutor(2) as ex:
        res = list(ex.map(run, T))
    tab, wrong, vals, bad, recs, lines = collections.defaultdict(collections.Counter), [], [], [], [], []
    for t, r, msg in res:
        row = (
            t["kind"]
            + (" " + t["strength"] if t["kind"] == "sand" else "")
            + (" (unidentifiable)" if t["unidentifiable"] else "")
        )
        tr = f"{t['log']} {t['rig'][0]} {t['kind']} {t['id'] or ''} {t['channel']} {'' if t['value'] is None else '%.4g' % t['value']} sigma {t['sigma']} rival {t['nearest_rival']} {t['sigma_to_rival']} {','.join(t['flags'])}"
        if r is None:
            tab[row]["refused"] += 1
            wrong.append(f"REFUSED {tr}: {msg}")
            continue
        o, d = judge(t, r)
        tab[row][o] += 1
        said = f"{r.get('verdict')} " + ", ".join(
            f"{c['id']} {c.get('value')} {c.get('ci95')}" for c in r.get("causes") or []
        )
        lines.append(f"{o:13} {tr} -> {said} {d if o.endswith('set') or o.endswith('SET') else ''}")
        if o.startswith("WRONG") or "?" in o:
            wrong.append(f"{o} {tr} -> {said} {d} | {r.get('headline')}")
        if o in ("right", "right_set"):
            for x in values(t, r):
                vals.append((t, o) + x)
                if x[4] is not None and abs(x[4]) > 3:
                    tab[row]["wrong_value"] += 1
                    wrong.append(
                        f"WRONG_VALUE {tr} -> {x[0]} {x[1]:.4g} sd {x[2]:.3g}, truth {x[3]:.4g}, {x[4]:+.1f} sd"
                    )
        rc = r.get("recalibration") or {}
        f, ci = rc.get("factor"), rc.get("ci95")
        if f and ci and None not in ci:
            recs.append((t, ci[0] <= t["factor_true"] <= ci[1], f / t["factor_true"]))
        for x in own_contract(r):
            bad.append(f"{t['log']} {t['rig'][0]} {t['kind']} {t['id'] or ''}: {x}")
    cols = [
        c
        for c in [
            "right",
            "right_set",
            "right_recal",
            "null_set",
            "near",
            "near_set",
            "measure_ok",
            "silent",
            "recal",
            "described",
            "none_of_these",
            "insufficient_data",
            "refused",
            "WRONG_NAME",
            "WRONG_MEAS",
            "WRONG_SET",
            "wrong_value",
        ]
    ]
    cols += sorted({k for c in tab.values() for k in c} - set(cols))
    cols = [c for c in cols if any(t[c] for t in tab.values())]
    print("%-28s %5s " % ("", "logs") + " ".join("%s" % c for c in cols))
    tot = collections.Counter()
    for row in sorted(tab):
        n = sum(v for k, v in tab[row].items() if k != "wrong_value")
        tot.update(tab[row])
        tot["_n"] += n
        print("%-28s %5d " % (row, n) + " ".join(("%" + str(len(c)) + "s") % (tab[row][c] or ".") for c in cols))
    print("%-28s %5d " % ("all", tot["_n"]) + " ".join(("%" + str(len(c)) + "s") % (tot[c] or ".") for c in cols))
    for what, sel in (("sand", lambda v: v[0]["kind"] == "sand"), ("measuring", lambda v: v[0]["kind"] == "measure")):
        c = [v for v in vals if sel(v) and v[7] is not None]
        if c:
            print(
                f"intervals of {what}: truth inside {sum(v[7] for v in c)} of {len(c)}; |relative error| median {sorted(abs(v[3] / v[5] - 1) for v in c if v[5])[len(c) // 2]:.3f}"
            )
    if recs:
        print(
            f"recalibration.factor: noise-free factor inside ci95 in {sum(x[1] for x in recs)} of {len(recs)} reports (its definition is not sharp in the contract: only to look at)"
        )
    print("\n== wrong, one a line")
    print("\n".join(wrong) or "none")
    print("\n== reports against the contract itself")
    print("\n".join(bad) or "none")
    os.makedirs(out, exist_ok=True)
    open(os.path.join(out, "lines.txt"), "w").write("\n".join(lines) + "\n")
    print(f"\nevery log: {out}/lines.txt")


if __name__ == "__main__":
    main()
