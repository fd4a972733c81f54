"""Does a policy need sensors, motors and delays in its training? Makes the table of docs/hardware_results.md.

For each task it trains policies with exact sensors and ideal motors, and policies with randomised ones, and evaluates
all of them with (a) exact sensors and ideal motors, (b) the motors, noise and a 40 ms delay of a real robot, (c) motors
half as strong and half as fast, and twice the noise and delay. Trainings that exist already in `--out` are taken as
they are, so the script can be stopped and started again.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

import sandgait

#: MPU-6050's data sheet (revision 3.4): gyroscope 0.005 °/s/√Hz. Its offset after calibration is our choice, 0.5 °/s.
GYROSCOPE = {"noise_density": 8.7e-5, "bias": 0.0087}
#: Dynamixel AX-18A (docs/hardware.md), the motor of Trossen's PhantomX hexapod: 10 bits over 300°, that is 0.0051 rad.
AX18 = {"stall_torque": 1.8, "no_load_speed": 10.2}
#: X-RHex, a hexapod whose legs turn as those of HexapodGait (Galloway et al. 2010): maxon EC 45 flat, 50 W, 24 V (part
#: 251601: 0.822 N·m, 6,710 rev/min), behind a gear of 28:1. For our robot of 0.15 kg only the motor's speed is a limit.
X_RHEX = {"stall_torque": 23.0, "no_load_speed": 25.1}
#: `legged_gym` adds uniform noise of ± these values. The standard deviation is the value divided by √3, and the density
#: at 50 Hz is the standard deviation divided by √50.
LEGGED_GYM = {"lin_vel": 0.1, "gyroscope": 0.2, "gravity": 0.05, "joint_position": 0.01, "joint_velocity": 1.5}


def hexapod(times: float) -> dict[str, Any]:
    """The noise of the PhantomX's sensors, multiplied by `times`. An estimator's velocity and attitude have errors of
    0.02 m/s and 0.01 (our choice)."""
    return {
        "gyroscope": {name: times * value for name, value in GYROSCOPE.items()},
        "joint_position": {"quantization": times * 0.0051},
        "lin_vel": {"bias": times * 0.02},
        "gravity": {"bias": times * 0.01},
    }


def quadruped(times: float) -> dict[str, Any]:
    """The noise of legged_gym, multiplied by `times`."""
    return {name: {"noise_density": times * most / 3**0.5 / 50**0.5} for name, most in LEGGED_GYM.items()}


#: Task, its options, its sensors, its motors, and the number of control steps of a training.
TASKS: dict[str, tuple[str, dict[str, Any], Any, dict[str, float], int]] = {
    "HexapodGait": ("sandgait/HexapodGait-v1", {}, hexapod, X_RHEX, 2_000_000),
    "HexapodLegs": ("sandgait/HexapodLegs-v1", {}, hexapod, AX18, 4_000_000),
    # The motors are those of Unitree Go1 in Isaac Lab; the robot is sandcat, whose legs carry a similar load.
    "sandcat": (
        "sandgait/LeggedVelocity-v1",
        {"ground": "rigid"},
        quadruped,
        {"stall_torque": 23.7, "no_load_speed": 30.0},
        4_000_000,
    ),
}

#: Delay of the real robot's actions [s].
DELAY = 0.04


def real(task: str, times: float) -> dict[str, Any]:
    """Options of the real robot; at `times` 2 noise and delay are twice as large, and the motors half as strong and
    half as fast."""
    _, _, sensors, motors, _ = TASKS[task]
    return {
        "sensors": sensors(times),
        "actuator": {name: value / times for name, value in motors.items()},
        "action_delay": [times * DELAY] * 2,
    }


def randomised(task: str, out: Path) -> dict[str, Any]:
    """Options of a training: motors from half to twice those of the real robot, delays up to 80 ms, and its noise."""
    _, _, sensors, motors, _ = TASKS[task]
    lines = [f"{name} = {{ value = {value}, interval = [{value / 2}, {value * 2}] }}" for name, value in motors.items()]
    out.mkdir(parents=True, exist_ok=True)
    file = out / f"{task}.toml"
    file.write_text("[actuator]\n" + "\n".join(lines) + "\n", encoding="utf-8")
    return {"sensors": sensors(1.0), "action_delay": [0.0, 2 * DELAY], "domain_rand": {"hardware": str(file)}}


def mean_return(task: str, policy: Path, options: dict[str, Any], episodes: int) -> float:
    """Mean return of episodes whose seeds no training uses."""
    id, own, *_ = TASKS[task]
    env = sandgait.SandgaitVectorEnv(id, episodes, **{**own, **options})
    env.reset(seed=2_000_000)
    returns = env.rollout_policy(policy, env.task.max_episode_steps).returns
    env.close()
    return float(np.mean(returns))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tasks", nargs="+", choices=TASKS, default=list(TASKS))
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--steps", type=int, help="control steps of a training; default: 2 to 4 million")
    parser.add_argument("--out", type=Path, default=Path("runs/hardware"))
    arguments = parser.parse_args()
    for task in arguments.tasks:
        id, own, _, _, steps = TASKS[task]
        steps = arguments.steps or steps
        rows: dict[str, list[list[float]]] = {}
        for seed in range(arguments.seeds):
            for kind, options in (("exact", {}), ("randomised", randomised(task, arguments.out))):
                folder = arguments.out / f"{task}-{kind}-{seed}"
                if not (folder / "policy.onnx").exists():
                    sandgait.train(id, out=folder, seed=seed, timesteps=steps, progress=False, **{**own, **options})
                cases: tuple[dict[str, Any], ...] = ({}, real(task, 1.0), real(task, 2.0))
                found = [mean_return(task, folder / "policy.onnx", case, arguments.episodes) for case in cases]
                rows.setdefault(kind, []).append(found)
                print(
                    json.dumps({"task": task, "training": kind, "seed": seed, "steps": steps, "returns": found}),
                    flush=True,
                )
        for kind, table in rows.items():
            cells = " | ".join(
                f"{mean:.1f} ({', '.join(f'{x:.1f}' for x in column)})"
                for mean, column in zip(np.mean(table, axis=0), np.array(table).T, strict=True)
            )
            print(f"| {task} | {kind} | {cells} |", flush=True)


if __name__ == "__main__":
    main()
