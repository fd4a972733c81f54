"""Learns gymnasium's Ant-v5 to walk on packed sand by PPO of stable-baselines3, and writes the curve.

    python examples/ant_on_sand.py                     # ten minutes on two cores
    python examples/ant_on_sand.py --minutes 1 --out runs/try

It compares the result with standing: actions of 0, which get only the reward for being healthy. It needs
sandgait[mujoco,sb3], and writes curve.csv, curve.png, policy.zip and normalization.pkl into the output directory.
"""

from __future__ import annotations

import argparse
import csv
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import matplotlib
import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import SubprocVecEnv, VecNormalize

from sandgait.wrappers import OnSand

matplotlib.use("Agg")
import matplotlib.pyplot as plt

MEDIUM = "poppy-close"


def make() -> gymnasium.Env[Any, Any]:
    # The contact forces are 78 of the 105 numbers, and few of them change: without them PPO learns sooner.
    return OnSand(gymnasium.make("Ant-v5", include_cfrc_ext_in_observation=False), medium=MEDIUM)


def mean_return(act: Callable[[Any], Any], episodes: int = 5) -> float:
    """Mean return of an ant whose action is `act(observation)` in every step."""
    env, returns = make(), []
    for seed in range(episodes):
        observation, _ = env.reset(seed=seed)
        total, ended = 0.0, False
        while not ended:
            observation, reward, terminated, truncated, _ = env.step(act(observation))
            total, ended = total + float(reward), terminated or truncated
        returns.append(total)
    env.close()
    return float(np.mean(returns))


class Curve(BaseCallback):
    """Records the mean return of the last episodes, and ends the training in time."""

    def __init__(self, seconds: float) -> None:
        super().__init__()
        self.seconds, self.start = seconds, time.monotonic()
        self.rows: list[tuple[float, int, float, float]] = []

    def _on_rollout_end(self) -> None:
        last = list(self.model.ep_info_buffer or [])
        if last:
            returns, lengths = np.mean([e["r"] for e in last]), np.mean([e["l"] for e in last])
            self.rows.append((time.monotonic() - self.start, self.num_timesteps, float(returns), float(lengths)))

    def _on_step(self) -> bool:
        return time.monotonic() - self.start < self.seconds


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--envs", type=int, default=8)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("runs/ant_on_sand"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    still = mean_return(lambda _: np.zeros(8, np.float32))
    print(f"standing: {still:.0f}")
    envs = VecNormalize(make_vec_env(make, options.envs, seed=options.seed, vec_env_cls=SubprocVecEnv))
    # Settings of rl-zoo3 for MuJoCo's environments with PPO; little exploration, because torques cost reward.
    settings: dict[str, Any] = {"n_steps": 512, "batch_size": 512, "n_epochs": 10, "learning_rate": 3e-4, "gamma": 0.98}
    settings |= {"gae_lambda": 0.92, "clip_range": 0.2, "max_grad_norm": 0.8, "seed": options.seed, "device": "cpu"}
    model = PPO("MlpPolicy", envs, policy_kwargs={"log_std_init": -2.0}, **settings)
    curve = Curve(60.0 * options.minutes)
    model.learn(10**9, callback=curve)
    model.save(options.out / "policy")
    envs.save(str(options.out / "normalization.pkl"))
    envs.training = False
    learnt = mean_return(lambda o: model.predict(envs.normalize_obs(o), deterministic=True)[0])
    envs.close()
    with open(options.out / "curve.csv", "w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["seconds", "steps", "return", "length"])
        writer.writerows((f"{t:.1f}", n, f"{r:.1f}", f"{k:.0f}") for t, n, r, k in curve.rows)
    if not curve.rows:
        raise SystemExit("no episode has ended: give more --minutes")
    seconds, _, returns, _ = np.array(curve.rows).T
    figure, axes = plt.subplots(figsize=(6, 3.5), layout="constrained")
    axes.plot(seconds / 60.0, returns, label=f"PPO, seed {options.seed}")
    axes.axhline(still, color="gray", linestyle="--", label="standing")
    axes.set(xlabel="minutes", ylabel="return of an episode", title=f"Ant-v5 on {MEDIUM}")
    axes.legend()
    figure.savefig(options.out / "curve.png", dpi=120)
    print(f"after {seconds[-1] / 60:.1f} minutes: {returns[-1]:.0f}, without exploration {learnt:.0f}")


if __name__ == "__main__":
    main()
