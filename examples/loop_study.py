"""Does `sandgait adapt` help? Plants are robots in MuJoCo with a hidden difference from the policy's training.

For each plant the Controller runs the policy and writes a log, `sandgait adapt` reads it, and the new policy runs in
the same plant. The table compares the tracking errors there with the gain that `adapt` predicts. Plants that have been
studied in `--out` are taken as they are, so the script can be stopped and started again.

    python examples/loop_study.py runs/cat --robot robots/sandcat.xml --timesteps 2000000
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from sandgait import adapt
from sandgait.certify.ground import ground_of
from sandgait.certify.walk import Job, outcome, record
from sandgait.command_line import nine_commands
from sandgait_deploy import read_policy

#: What every plant has and the training need not have: 5 ms from a reading to the motors, and a tenth of legged_gym's
#: noise. Our choice: a good robot.
USUAL = {"latency": 0.005, "noise": 0.1}

#: The hidden differences.
PLANTS: dict[str, dict[str, float]] = {
    "nothing": {},
    "motors 12 % weak": {"motor_strength": 0.88},
    "motors 25 % weak": {"motor_strength": 0.75},
    "motors half as strong": {"motor_strength": 0.5},
    "delay of 15 ms": {"latency": 0.02},
    "delay of 30 ms": {"latency": 0.035},
    "payload of 15 %": {"payload": 0.15},
    "sand 30 % weaker": {"sand_strength": 0.7},
    "sand a quarter as strong": {"sand_strength": 0.25},
    "sand twice as strong": {"sand_strength": 2.0},
    "motors 25 % weak, payload of 15 %": {"motor_strength": 0.75, "payload": 0.15},
}

#: Commands of the log, by their place among the nine: slow, fast, turning and both.
LOGGED = (0, 1, 5, 7)


def study(name: str, given: argparse.Namespace) -> dict[str, Any]:
    """Logs, adapts and walks again in the plant `name`; the numbers of its row."""
    folder, began = given.out / name.replace(" ", "-").replace(",", ""), time.monotonic()
    done = folder / "result.json"
    if done.is_file():
        return dict(json.loads(done.read_text()))
    folder.mkdir(parents=True, exist_ok=True)
    policy = read_policy(given.policy)
    ground = ground_of(policy, None)
    commands = tuple(tuple(line["command"]) for line in nine_commands(policy.network, ground.options()))
    job = Job(str(given.policy), str(given.robot), ground.conditions(**{**USUAL, **PLANTS[name]}), commands)
    log = folder / "walk.csv"
    record(replace(job, commands=tuple(commands[k] for k in LOGGED)), log)
    request = adapt.Request(log, given.policy, given.robot, folder / "adapted", timesteps=given.timesteps)
    made = adapt.adapt(request, lambda stage: print(f"{name}: {stage}", flush=True))
    (request.out / "adapt.html").write_text(adapt.page(made), encoding="utf-8")
    before = outcome(job)
    # What a user would run: the new policy only if `adapt` says so.
    after = outcome(replace(job, folder=str(request.out / "policy"))) if made.gain is not None else before
    row = {
        "plant": name,
        "before": before.error,
        "after": after.error,
        "predicted": None if made.gain is None else [made.gain.mean, *made.gain.interval],
        "verdict": adapt.summary(made)[-1].split(":")[0],
        "reason": made.reason,
        "seconds": time.monotonic() - began,
    }
    done.write_text(json.dumps(row, indent=1))
    return row


def line(row: dict[str, Any]) -> str:
    """A row of the table."""
    predicted, gain = row["predicted"], row["before"] - row["after"]
    said = "–" if predicted is None else "{:.1%} ({:.1%} to {:.1%})".format(*predicted)
    holds = "–" if predicted is None else "yes" if predicted[1] <= gain <= predicted[2] else "no"
    errors = f"{row['before']:.1%} | {row['after']:.1%} | {gain:.1%}"
    return f"| {row['plant']} | {errors} | {said} | {holds} | {row['verdict'].lower()} | {row['seconds']:.0f} s |"


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("policy", type=Path, help="the folder that sandgait train wrote")
    parser.add_argument("--robot", type=Path, required=True, help="the robot's file")
    parser.add_argument("--out", type=Path, default=Path("runs/loop"), help="folder of the results [%(default)s]")
    parser.add_argument("--timesteps", type=int, default=2_000_000, metavar="N", help="of each training [%(default)s]")
    parser.add_argument("--plants", nargs="+", choices=PLANTS, default=list(PLANTS), metavar="NAME", help="[all]")
    given = parser.parse_args(arguments)
    head = ("plant", "error before", "after", "gain", "predicted gain (95 %)", "holds it", "verdict", "time")
    rows = [line(study(name, given)) for name in given.plants]
    print("\n".join(["| " + " | ".join(head) + " |", "|" + "---|" * len(head), *rows]))


if __name__ == "__main__":
    main()
