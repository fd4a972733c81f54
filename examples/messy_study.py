"""Measures how well the diagnosis works on simulated force logs that have all errors of a laboratory together.

usage: messy_study.py SANDGAIT KIND FIRST COUNT
KIND: nulls, singles, pairs, laws, outside, weaker, or a mechanism's id

The logs are those of messy_log.py. Those of the kind weaker have sand of another strength than stated, and the errors
of a careless laboratory. The program prints one line for each log, and counts of the verdicts. It needs numpy.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from messy_log import EXPERIMENT, FILTER, log

# Strengths that are published for dry and slightly cohesive sands, or that are usual in laboratories.
CAUSES: dict[str, tuple[float, float, bool]] = {
    "inertial_drag": (1.1, 2.8, False),
    "concave_fill": (0.4, 1.0, False),
    "cohesion": (150.0, 600.0, False),
    "footprint": (0.2, 0.5, False),
    "added_mass": (0.4, 1.2, False),
    "depth_power": (0.1, 0.3, True),
    "scale": (0.25, 0.4, True),
    "packing_grad": (0.08, 0.2, True),
    "slope": (0.03, 0.09, True),
    "rate_log": (0.02, 0.06, True),
    "friction_clip": (1.5, 4.0, False),
}


def hide(kind: str, seed: int) -> dict[str, float]:
    rng = np.random.default_rng(10_000 + seed)

    def usual(name: str) -> float:
        low, high, signed = CAUSES[name]
        return float(rng.uniform(low, high) * (rng.choice([-1, 1]) if signed else 1))

    if kind == "nulls":
        return {}
    if kind == "laws":
        a, b = float(rng.choice([0.5, 0.75])), float(rng.choice([-0.5, -0.25, 0.0, 0.25]))
        return {"law": float(rng.uniform(3, 6)), "a": a, "b": b}
    if kind == "outside":
        return {["wall", "crust", "stick_slip", "buried_stone"][seed % 4]: float(rng.uniform(0.5, 1.5))}
    if kind == "weaker":
        return {"scale": float(rng.uniform(-0.5, 0.5))}
    if kind == "pairs":
        names = rng.choice(["inertial_drag", "concave_fill", "cohesion", "footprint"], 2, replace=False)
        return {name: usual(name) for name in names}
    if kind == "singles":
        kind = list(CAUSES)[seed % len(CAUSES)]
    return {kind: usual(kind)}


def main() -> None:
    binary, kind, first, count = sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4])
    tally = {"exact": 0, "in the set": 0, "wrong": 0, "other": 0}
    held, asked, factors = 0, 0, 0
    for seed in range(first, first + count):
        hidden = hide(kind, seed)
        text, rig = log(seed, hidden, kind != "weaker")
        with tempfile.TemporaryDirectory() as directory:
            data, experiment = Path(directory, "log.csv"), Path(directory, "experiment.toml")
            data.write_text(text)
            # Every second log of weaker sand states its coefficients as roughly as batches differ.
            unsure = kind == "weaker" and seed % 2 == 0
            experiment.write_text(EXPERIMENT.replace("sd = 0.08", "sd = 0.3") if unsure else EXPERIMENT)
            command = [binary, "diagnose", str(data), "--experiment", str(experiment), "--out", directory]
            made = subprocess.run(command, capture_output=True, text=True)
            if made.returncode:
                print(seed, "FAILED", made.stderr.strip()[-200:])
                continue
            report = json.loads(Path(directory, "report.json").read_text())
        truth = sorted(k for k in hidden if k in CAUSES)
        found = [sorted(s) for s in report["ambiguity_set"]]
        # The filter of one channel is in the log, so its name is right, alone or beside a cause.
        filtered = [c["of"] for c in report["causes"] if c["id"] == "lowpass"]
        if report["verdict"] == "named" and filtered and filtered == [rig["filter"]]:
            found = [[id for id in found[0] if id != "lowpass"]]
        quiet = ("noise_floor", "recalibrated")
        right = {
            "nulls": quiet,
            "laws": ("described",),
            "outside": ("none_of_these", "described", *quiet),
            "weaker": ("recalibrated",),
        }.get(kind)
        named = report["verdict"] == "named"
        exact = report["verdict"] in right if right else named and found == [truth]
        exact = exact or (kind == "nulls" and named and found == [[]])
        wrong = named and not exact and found not in ([[]], [truth])
        place = "exact" if exact else "wrong" if wrong else "in the set" if truth and truth in found else "other"
        tally[place] += 1
        values = {**hidden, "lowpass": FILTER}
        for cause in report["causes"] if exact and truth else ():
            asked += 1
            held += cause["ci95"][0] <= values[cause["id"]] <= cause["ci95"][1]
        low, high = report["recalibration"]["ci95"]
        factors += low <= rig["strength"] <= high
        factor = f"strength {rig['strength']:.3f} {report['recalibration']['factor']:.3f} [{low:.3f}, {high:.3f}]"
        said = [(c["id"], round(c["value"], 4), [round(v, 4) for v in c["ci95"]]) for c in report["causes"]]
        fit, rest = report["lack_of_fit"], report["remainder"]
        short = " ".join(str(rig[k]) for k in ("sampling", "filter", "ramp", "torque"))
        best = report["candidates"][0] if report["candidates"] else {}
        rivals = sorted(c["distance_to_best"] for c in report["candidates"][1:8] if c["distance_to_best"])
        strengths = {k: round(v, 4) for k, v in hidden.items()}
        rest_said = f"{report['written']} rest {rest['significant']} {rest['fraction']:.2f}"
        fits = f"lof {fit['plain']:.2f} {fit['extended'] or 0:.2f} limit {fit['limit']:.2f}"
        near = f"best {best.get('ids')} {best.get('delta_chi2', 0):.0f} rival {rivals[0] if rivals else 0:.1f}"
        near += f" plain {report['evidence'][0]['difference']:.0f} ± {report['evidence'][0]['standard_error']:.0f}"
        laws = [t["formula"] for t in report["terms"]]
        print(
            *(seed, strengths, short, place, report["verdict"], said, found[1:], fits, near, rest_said, laws, factor),
            flush=True,
        )
    print(kind, tally, f"intervals hold {held} of {asked}, the strength {factors} of {count}")


if __name__ == "__main__":
    main()
