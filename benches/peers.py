"""Compares the speed of sandgait with other simulators, in one run on this machine.

usage: python benches/peers.py [--binary BINARY] [--robot robots/sandcat.xml] [--seconds 2] [--repeats 5]

The program measures these in turns, so that changes of the machine's speed affect all of them; first on one pinned
core, then on all cores:

- `sandgait bench`: whole environment steps, including the sand
- EnvPool's Ant-v5
- gymnasium's Ant-v5 in a SyncVectorEnv
- MuJoCo's `mj_step` of the same hexapod without sand, with the same time step of 1 ms

It also compares a robot from an MJCF file on a hard floor with random actions: LeggedVelocity with its own time step,
and `mj_step` with 2 ms. A control step of both is 20 ms.

It needs `pip install "gymnasium[mujoco]" envpool`; `make bench-peers` makes an environment with them. It prints a table
and, as the last line, the same as JSON.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
XPLORER = ROOT / "src/sim/robots/xplorer.toml"
SUBSTEPS = 20  # 1 ms steps in a 50 Hz control step
FLOOR_STEP, FLOOR_SUBSTEPS = 0.002, 10


def hexapod_mjcf(robot: dict) -> str:
    """The robot `xplorer` for MuJoCo, with the same masses, hinges, armature and servos, and without contacts."""
    base, link = robot["base"], robot["leg"]["link"][0]
    size = " ".join(str(s / 2) for s in base["size"])
    reach = " ".join(map(str, link["reach"]))
    legs, servos = [], []
    untouchable = 'contype="0" conaffinity="0"'
    for hip in robot["hip"]:
        name, position = hip["name"], " ".join(map(str, hip["position"]))
        legs.append(
            f'<body pos="{position}"><joint name="{name}" axis="0 1 0" armature="{link["armature"]}"/>'
            f'<geom type="capsule" fromto="0 0 0 {reach}" size="0.002" mass="{link["mass"]}" {untouchable}/>'
            "</body>"
        )
        gains = f'kp="{robot["servo"]["kp"]}" kv="{robot["servo"]["kd"]}"'
        servos.append(f'<position joint="{name}" {gains}/>')
    return (
        '<mujoco><option timestep="0.001" integrator="implicitfast"/><worldbody><body pos="0 0 1"><freejoint/>'
        f'<geom type="box" size="{size}" mass="{base["mass"]}" {untouchable}/>{"".join(legs)}'
        f"</body></worldbody><actuator>{''.join(servos)}</actuator></mujoco>"
    )


def timed(step: Callable[[], int], seconds: float) -> float:
    """Environment steps per second. `step` makes some steps and returns their number."""
    clock, done = time.perf_counter(), 0
    while time.perf_counter() - clock < seconds:
        done += step()
    return done / (time.perf_counter() - clock)


def mujoco_step(seconds: float, _cores: int) -> float:
    """Speed of `mj_step` with one robot on one thread, because `mj_step` has no batches."""
    import tomllib

    import mujoco

    model = mujoco.MjModel.from_xml_string(hexapod_mjcf(tomllib.loads(XPLORER.read_text())))
    data = mujoco.MjData(model)

    def step() -> int:
        data.ctrl[:] = math.tau * 2 * data.time
        mujoco.mj_step(model, data, 1000 * SUBSTEPS)
        mujoco.mj_resetData(model, data)
        return 1000

    step()
    return timed(step, seconds)


def mujoco_floor(robot: Path) -> Callable[[float, int], float]:
    """Speed of `mj_step` with the file's robot on a plane, with random targets of its servos. The robot is reset every
    2 s."""

    def measure(seconds: float, _cores: int) -> float:
        import mujoco
        import numpy as np

        spec = mujoco.MjSpec.from_file(str(robot))
        if not any(geom.type == mujoco.mjtGeom.mjGEOM_PLANE for geom in spec.worldbody.geoms):
            spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[50, 50, 0.1])
        spec.option.timestep = FLOOR_STEP
        model = spec.compile()
        data = mujoco.MjData(model)
        rest = model.key_ctrl[0] if model.nkey else np.zeros(model.nu)
        actions = rest + np.random.default_rng(0).uniform(-1, 1, (100, model.nu))

        def step() -> int:
            if model.nkey:
                mujoco.mj_resetDataKeyframe(model, data, 0)
            else:
                mujoco.mj_resetData(model, data)
            for action in actions:
                data.ctrl[:] = action
                mujoco.mj_step(model, data, FLOOR_SUBSTEPS)
            return len(actions)

        step()
        return timed(step, seconds)

    return measure


def ant_steps(pool: Any, envs: int, seconds: float) -> float:
    """Speed of a vector of Ants. Its random actions are drawn before the measurement."""
    import numpy as np

    actions = np.random.default_rng(0).uniform(-1, 1, (16, envs, 8))
    turn = iter(range(10**9))

    def step() -> int:
        pool.step(actions[next(turn) % 16])
        return envs

    timed(step, seconds / 4)
    return timed(step, seconds)


def envpool_ant(seconds: float, cores: int) -> float:
    import envpool

    envs = 64
    pool = envpool.make_gymnasium("Ant-v5", num_envs=envs, num_threads=cores)
    pool.reset()
    return ant_steps(pool, envs, seconds)


def gymnasium_ant(seconds: float, _cores: int) -> float:
    """SyncVectorEnv uses one core on any machine."""
    import gymnasium

    envs = 16
    pool = gymnasium.make_vec("Ant-v5", num_envs=envs, vectorization_mode="sync")
    pool.reset(seed=0)
    return ant_steps(pool, envs, seconds)


def sandgait(binary: Path, task: str, options: tuple[str, ...] = ()) -> Callable[[float, int], float]:
    def measure(seconds: float, cores: int) -> float:
        command = [
            binary,
            "bench",
            "--task",
            task,
            "--threads",
            cores,
            "--seconds",
            seconds / 5,
            "--repeats",
            5,
            "--json",
            *(part for option in options for part in ("--option", option)),
        ]
        output = subprocess.run(list(map(str, command)), check=True, capture_output=True, text=True).stdout
        return float(json.loads(output)["env_steps_per_second"])

    return measure


def rows(binary: Path, robot: Path) -> dict[str, Callable[[float, int], float]]:
    floor = (f"robot={robot}", "ground=rigid")
    return {
        "sandgait HexapodGait (6 joints, sand)": sandgait(binary, "sandgait/HexapodGait-v1"),
        "sandgait HexapodLegs (18 joints, sand)": sandgait(binary, "sandgait/HexapodLegs-v1"),
        "MuJoCo mj_step, same hexapod, no sand": mujoco_step,
        f"sandgait {robot.name}, hard floor": sandgait(binary, "sandgait/LeggedVelocity-v1", floor),
        f"MuJoCo mj_step, {robot.name}, hard floor": mujoco_floor(robot),
        "EnvPool Ant-v5": envpool_ant,
        "gymnasium Ant-v5, SyncVectorEnv": gymnasium_ant,
    }


def child(binary: Path, robot: Path, name: str, seconds: float, cores: list[int]) -> float:
    """Measures one row in a new process, which is pinned to cores before any library starts threads."""
    command = [sys.executable, __file__, "--binary", binary, "--robot", robot, "--only", name, "--seconds", seconds]
    output = subprocess.run(
        list(map(str, command)),
        check=True,
        capture_output=True,
        text=True,
        preexec_fn=lambda: os.sched_setaffinity(0, cores),
    ).stdout
    return float(output.splitlines()[-1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--binary", type=Path, default=ROOT / "target/release/sandgait")
    parser.add_argument("--robot", type=Path, default=ROOT / "robots/sandcat.xml", help="MJCF file of a robot")
    parser.add_argument("--seconds", type=float, default=2.0)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--only", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    table = rows(arguments.binary, arguments.robot)
    if arguments.only:
        print(table[arguments.only](arguments.seconds, len(os.sched_getaffinity(0))))
        return
    every = sorted(os.sched_getaffinity(0))
    results: dict[str, dict[str, float]] = {}
    for cores in ([every[0]], every):
        figures: dict[str, list[float]] = {name: [] for name in table}
        for _ in range(arguments.repeats):
            for name in table:
                figures[name].append(child(arguments.binary, arguments.robot, name, arguments.seconds, cores))
        ours = statistics.median(figures["sandgait HexapodGait (6 joints, sand)"])
        print(f"\n{len(cores)} cores: environment steps/s, median (min to max), HexapodGait's ratio to it")
        for name, values in figures.items():
            middle = statistics.median(values)
            print(f"  {name:40} {middle:10.0f}  ({min(values):.0f} to {max(values):.0f})  {ours / middle:6.1f}")
            results.setdefault(name, {})[f"{len(cores)} cores"] = round(middle)
    print(json.dumps(results))


if __name__ == "__main__":
    main()
