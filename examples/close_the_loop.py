# %% [markdown]
# # Does a diagnosis make better gaits?
#
# A sand differs from its textbook numbers in two ways, which the diagnosis does not know. We measure leg forces on this
# sand, and the diagnosis extends the textbook sand. Then we train gaits on the textbook sand, on the extended sand and
# on the true sand, and evaluate all of them on the true sand. Run this file as a script or cell by cell; it takes two
# to five minutes on two cores. The true sand was chosen before any gait was trained: batches of one medium differ by 20
# to 40 % in strength, and λ = 1.1 is the published inertial drag of an oblique plate.

# %%
from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd

import sandgait

Numbers = npt.NDArray[np.float64]

TEXTBOOK = """name = "{name}"
law = "li2013"
bulk_density = 638.0
source = "poppy seeds, loosely packed: Li, Zhang & Goldman 2013"
[coefficients]
a00 = 51e3
a10 = 47e3
b11 = 53e3
b01 = 83e3
bm11 = 20e3
c11 = -26e3
c01 = 57e3
cm11 = 0.0
d10 = 25e3
"""
TRUTH = {"scale": -0.4, "inertial_drag": 1.1}
EXPERIMENT = {
    "kind": "intrusion",
    "medium": "poppy-loose",
    "bulk_density": 638.0,
    "coefficient_sd": 0.08,
    "shape": {
        name: {"type": "leg", "chord": 0.076, "width": 0.025, "xi_deg": xi}
        for name, xi in (("L", 45.0), ("revL", -45.0), ("flat", 0.0))
    },
}


# %% [markdown]
# ## Measuring
#
# Legs of three shapes rotate through the true sand, at three speeds and two heights, with three repetitions. Each trial
# has errors: its bed's strength (5 %), the force of single grains (4 %, correlated from sample to sample) and the
# sensor (0.03 N).


# %%
def measured_forces(truth: Path, generator: np.random.Generator, samples: int = 40) -> pd.DataFrame:
    """A force log of the sand `truth`, with noise."""
    trials = []
    for shape in ("L", "revL", "flat"):
        for omega in (0.5, 5.0, 15.0):
            for hip_z in (0.02, 0.04):
                forces = sandgait.intrude(shape, hip_height=hip_z, omega=omega, sand=truth)
                theta = np.linspace(-1.7, 1.7, samples)
                clean = {name: np.interp(theta, forces.theta, forces[name]) for name in ("Fx", "Fz", "Ty")}
                for rep in range(3):
                    condition = f"{shape} {omega} {hip_z}"
                    columns = {"trial": f"{condition} {rep}", "condition": condition, "rep": rep, "shape": shape}
                    motion = {"hip_z": hip_z, "t": (theta + 1.75) / omega, "theta": theta, "omega": omega}
                    trials.append(pd.DataFrame({**columns, **motion, **noisy(clean, generator)}))
    log = pd.concat(trials, ignore_index=True).assign(kind="leg", medium="poppy-loose")
    return log.assign(**dict.fromkeys(("plate_beta", "plate_gamma", "x", "z", "vx", "vz")))


def noisy(clean: dict[str, Numbers], generator: np.random.Generator) -> dict[str, Numbers]:
    """One trial's sensor readings for the true loads `clean`."""
    size = np.hypot(clean["Fx"], clean["Fz"])
    gain = 1.0 + 0.05 * generator.standard_normal()
    readings = {}
    for name, load in clean.items():
        grain = np.empty_like(size)
        grain[0] = generator.standard_normal()
        for k in range(1, len(grain)):
            grain[k] = 0.7 * grain[k - 1] + np.sqrt(0.51) * generator.standard_normal()
        noise = 0.04 * size * grain + 0.03 * generator.standard_normal(len(size))
        readings[name] = gain * load + (0.05 if name == "Ty" else 1.0) * noise
    return readings


# %% [markdown]
# ## Gaits
#
# A gait has six numbers: the hips' speed as a parabola of the commanded speed, the change of this speed along the turn,
# and the strength with which the two tripods are kept half a turn apart. Its inputs are the command and the hips'
# angles and speeds, which a robot knows without motion capture. The cross-entropy method learns the numbers: a
# generation has 64 gaits with four episodes each, and the next generation is drawn around the best ten. The budget and
# the seeds are the same for all sands.

# %%
ID = "sandgait/HexapodGait-v1"
STEPS = 200
GAITS, EPISODES, BEST = 64, 4, 10
START = np.array([0.2, 0.4, 0.0, 0.0, 0.0, 0.1])
TRIPODS = np.array([0, 1, 0, 1, 0, 1])
SINE, COSINE, COMMAND = slice(9, 15), slice(15, 21), 39


def actions(gaits: Numbers, rows: npt.NDArray[np.float32]) -> Numbers:
    """Hip speeds [rows, 6]. Row i of `gaits` [rows, 6] is the gait of row i."""
    sine, cosine, command = rows[:, SINE], rows[:, COSINE], rows[:, [COMMAND]] / 0.4
    base, linear, square, fore, down, hold = (gaits[:, [k]] for k in range(6))
    other = [np.stack([x[:, side != TRIPODS].mean(axis=1) for side in TRIPODS], axis=1) for x in (sine, cosine)]
    # sin(θ of the other tripod + π − own θ)
    lag = other[1] * sine - other[0] * cosine
    turning = base + linear * command + square * command**2
    return np.clip(turning * (1.0 + fore * sine + down * cosine) + hold * lag, -1.0, 1.0)


def returns(env: sandgait.SandgaitVectorEnv, gaits: Numbers, seed: int) -> tuple[Numbers, Numbers]:
    """Sum of rewards and mean speed error [m/s] of each gait's episode."""
    rows, _ = env.reset(seed=seed)
    total, error, running = np.zeros(len(gaits)), np.zeros(len(gaits)), np.ones(len(gaits), dtype=np.bool_)
    for _ in range(STEPS):
        rows, rewards, terminated, truncated, infos = env.step(actions(gaits, rows))
        total += np.where(running, rewards, 0.0)
        error += np.where(running, np.abs(infos["speed"] - infos["commanded_speed"]), 0.0) / STEPS
        running &= ~(terminated | truncated)
    return total, error


def learn(sand: Path, seed: int, generations: int) -> Numbers:
    """The gait that the cross-entropy method finds on `sand`."""
    generator = np.random.default_rng(seed)
    env = sandgait.SandgaitVectorEnv(ID, GAITS * EPISODES, sand=sand, max_episode_steps=STEPS)
    mean, spread = START, np.full(len(START), 0.3)
    for generation in range(generations):
        tried = mean + spread * generator.standard_normal((GAITS, len(mean)))
        score, _ = returns(env, np.repeat(tried, EPISODES, axis=0), seed=1000 * (seed * generations + generation))
        best = tried[np.argsort(-score.reshape(GAITS, EPISODES).mean(axis=1))[:BEST]]
        mean, spread = best.mean(axis=0), best.std(axis=0) + 0.3 * 0.8**generation * 0.2
    env.close()
    return mean


def interval(rows: Numbers, generator: np.random.Generator) -> tuple[float, float, float]:
    """Mean of `rows` [training seeds, evaluation seeds], and its 95 % interval from a bootstrap over both seeds with
    2000 draws."""
    trained, played = rows.shape
    again = [
        rows[np.ix_(generator.integers(trained, size=trained), generator.integers(played, size=played))].mean()
        for _ in range(2000)
    ]
    low, high = np.quantile(again, [0.025, 0.975])
    return float(rows.mean()), float(low), float(high)


# %% [markdown]
# ## Closing the loop


# %%
def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description="Gaits learnt on a diagnosed sand and on the textbook's")
    parser.add_argument("--seeds", type=int, default=3, help="trainings on each sand")
    parser.add_argument("--generations", type=int, default=25, help="generations of each training")
    parser.add_argument("--evaluations", type=int, default=200, help="episodes for the evaluation of each gait")
    parser.add_argument("--out", type=Path, default=Path("runs/close_the_loop"))
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)

    textbook, truth = options.out / "textbook.toml", options.out / "truth.toml"
    textbook.write_text(TEXTBOOK.format(name="textbook"))
    causes = "\n".join(f"{name} = {value}" for name, value in TRUTH.items())
    truth.write_text(f"{TEXTBOOK.format(name='truth')}[mechanisms]\n{causes}\n")

    diagnosis = sandgait.diagnose(measured_forces(truth, np.random.default_rng(7)), EXPERIMENT)
    diagnosis.save(options.out / "diagnosis")
    print("hidden:", ", ".join(f"{name} = {value}" for name, value in TRUTH.items()))
    print(f"{diagnosis.verdict}: {diagnosis.summary}")

    sands = {"textbook": textbook, "diagnosed": options.out / "diagnosis" / "sand.toml", "true": truth}
    env = sandgait.SandgaitVectorEnv(ID, options.evaluations, sand=truth, max_episode_steps=STEPS)
    scores: dict[str, Numbers] = {}
    errors: dict[str, Numbers] = {}
    for name, sand in sands.items():
        gaits = [learn(sand, seed, options.generations) for seed in range(options.seeds)]
        played = [returns(env, np.tile(gait, (options.evaluations, 1)), seed=1_000_000) for gait in gaits]
        scores[name], errors[name] = (np.array([p[k] for p in played]) for k in (0, 1))
    env.close()

    generator = np.random.default_rng(0)
    print(f"\nwalking on the true sand, {options.evaluations} unseen episodes for each of {options.seeds} trainings")
    print(f"{'learnt on':12} {'return (95 % interval)':28} error of speed [cm/s]")
    for name in sands:
        score, low, high = interval(scores[name], generator)
        error, least, most = (100.0 * e for e in interval(errors[name], generator))
        print(f"{name:12} {f'{score:.1f} ({low:.1f} to {high:.1f})':28} {error:.2f} ({least:.2f} to {most:.2f})")
    gain, low, high = interval(scores["diagnosed"] - scores["textbook"], generator)
    known = scores["true"].mean() - scores["textbook"].mean()
    surely = "better" if low > 0.0 else "worse" if high < 0.0 else "not surely different"
    print(f"diagnosed minus textbook: {gain:+.2f} ({low:+.2f} to {high:+.2f}), {surely}; ", end="")
    print(f"knowing the true sand gains {known:+.2f}")


if __name__ == "__main__":
    main()
