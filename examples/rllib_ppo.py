"""RLlib's PPO on a Ray cluster. Every node has a server and a runner that steps a batch of the server's environments.

RLlib needs a vector environment with the autoreset mode NEXT_STEP, such as `SandgaitVectorEnv`. A runner uses the
server of its own node, so observations and actions do not cross the network. RLlib sends episodes to the learner and
weights to the runners.

usage: python examples/rllib_ppo.py [--iterations 30] [--runners 1] [--envs 64] [--ray auto]
"""

from __future__ import annotations

import argparse
from typing import Any

import ray
from ray.rllib.algorithms.ppo import PPO, PPOConfig
from ray.tune.registry import register_env

import sandgait
import sandgait.ray

ID = "sandgait/HexapodGait-v1"

#: Control steps of every environment between two updates: our choice, because 1.3 s have some strides.
STEPS = 64

#: Hyperparameters of PPO: our choice, close to the defaults of stable-baselines3 and untuned.
TRAINING = {"lr": 3e-4, "gamma": 0.99, "lambda_": 0.95, "clip_param": 0.2, "num_epochs": 5, "minibatch_size": 512}


def build(servers: sandgait.ray.Servers, runners: int, envs: int, seed: int = 0, **options: Any) -> PPO:
    """PPO with `runners` runners, each with `envs` environments. `options`: options of the task."""
    addresses = dict(zip(servers.nodes, servers.addresses, strict=True))

    def make(context: Any) -> sandgait.SandgaitVectorEnv:
        address = addresses[ray.get_runtime_context().get_node_id()]
        return sandgait.SandgaitVectorEnv(ID, context["num_envs"], address, **options)

    register_env("sandgait", make)
    config = (
        PPOConfig()
        .environment("sandgait")
        .env_runners(
            num_env_runners=runners,
            num_envs_per_env_runner=envs,
            gym_env_vectorize_mode="vector_entry_point",
            rollout_fragment_length=STEPS,
        )
        .training(train_batch_size_per_learner=max(runners, 1) * envs * STEPS, **TRAINING)
        .debugging(seed=seed, log_level="ERROR")
    )
    return config.build_algo()


def train(algorithm: PPO, iterations: int) -> list[float]:
    """Mean return of the episodes that ended in each iteration; NaN before the first end of an episode."""
    curve = []
    for iteration in range(iterations):
        runners = algorithm.train()["env_runners"]
        curve.append(float(runners.get("episode_return_mean", float("nan"))))
        steps = int(runners["num_env_steps_sampled_lifetime"])
        print(f"iteration {iteration:3}: {steps:9} environment steps, mean return {curve[-1]:7.2f}")
    return curve


def main() -> None:
    parser = argparse.ArgumentParser(description=str(__doc__).split("\n\n", maxsplit=1)[0])
    parser.add_argument("--iterations", type=int, default=30)
    parser.add_argument("--runners", type=int, default=1, help="number of runners; Ray must have a processor for each")
    parser.add_argument("--envs", type=int, default=64, help="environments of each runner")
    parser.add_argument(
        "--ray", default=None, metavar="ADDRESS", help="address of a running cluster; by default this machine"
    )
    arguments = parser.parse_args()
    ray.init(arguments.ray, log_to_driver=False)
    with sandgait.ray.serve() as servers:
        algorithm = build(servers, arguments.runners, arguments.envs, command=[0.3, 0.3])
        train(algorithm, arguments.iterations)
        algorithm.stop()
    ray.shutdown()


if __name__ == "__main__":
    main()
