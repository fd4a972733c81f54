"""Libraries for reinforcement learning, as their own documentation uses them. `make test-clients` runs this file.

Each test trains or records for a moment. The keywords that a library needs are those of the table in docs/python.md.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import gymnasium
import pytest

import sandgait  # noqa: F401 (registers the ids)

ID = "sandgait/HexapodGait-v1"
HOME = Path(__file__).parents[2]


def test_torchrl_gym_env() -> None:
    from torchrl.envs import GymEnv, TransformedEnv
    from torchrl.envs.transforms import RewardSum, StepCounter
    from torchrl.envs.utils import check_env_specs

    env = TransformedEnv(GymEnv(ID, leg="C", max_episode_steps=20), RewardSum()).append_transform(StepCounter())
    check_env_specs(env)
    data = env.rollout(50)
    assert data["next", "truncated"].sum() == 1
    assert data["observation"].shape == (20, 41)
    env.close()


@pytest.mark.parametrize("mode", ["DISABLED", "SAME_STEP"])
def test_torchrl_gym_wrapper_of_a_vector(mode: str) -> None:
    import torch
    from torchrl.envs import GymWrapper

    vector = gymnasium.make_vec(ID, num_envs=4, autoreset_mode=mode, max_episode_steps=20)
    env = GymWrapper(vector)
    data = env.rollout(50, break_when_any_done=False)
    assert data["observation"].shape == (4, 50, 41)
    assert data["next", "truncated"].sum(dim=1).flatten().tolist() == [2, 2, 2, 2]
    assert torch.isfinite(data["next", "reward"]).all()
    # Within an episode an observation is the next one of the step before.
    ends = data["next", "done"].squeeze(-1)[:, :-1]
    same = (data["next", "observation"][:, :-1] == data["observation"][:, 1:]).all(dim=-1)
    assert (same | ends).all()
    assert not same[ends].any()
    env.close()


def test_torchrl_ppo() -> None:
    """One batch of a collector, its advantages, and a step of the optimizer."""
    import torch
    from tensordict.nn import TensorDictModule
    from tensordict.nn.distributions import NormalParamExtractor
    from torchrl.collectors import Collector
    from torchrl.envs import GymWrapper
    from torchrl.modules import ProbabilisticActor, TanhNormal, ValueOperator
    from torchrl.objectives import ClipPPOLoss
    from torchrl.objectives.value import GAE

    env = GymWrapper(gymnasium.make_vec(ID, num_envs=8, autoreset_mode="DISABLED", max_episode_steps=20))
    network = torch.nn.Sequential(
        torch.nn.Linear(41, 32), torch.nn.Tanh(), torch.nn.Linear(32, 12), NormalParamExtractor()
    )
    module = TensorDictModule(network, in_keys=["observation"], out_keys=["loc", "scale"])
    bounds = {"low": -1.0, "high": 1.0}
    actor = ProbabilisticActor(
        module,
        in_keys=["loc", "scale"],
        distribution_class=TanhNormal,
        distribution_kwargs=bounds,
        return_log_prob=True,
    )
    critic = ValueOperator(torch.nn.Linear(41, 1), in_keys=["observation"])
    collector = Collector(env, actor, frames_per_batch=8 * 32, total_frames=8 * 32)
    loss = ClipPPOLoss(actor, critic)
    optimizer = torch.optim.Adam(loss.parameters(), lr=3e-4)
    for batch in collector:
        GAE(gamma=0.99, lmbda=0.95, value_network=critic)(batch)
        found = loss(batch.reshape(-1))
        total = found["loss_objective"] + found["loss_critic"] + found["loss_entropy"]
        assert torch.isfinite(total)
        total.backward()
        optimizer.step()
    collector.shutdown()


def test_minari_records_infos(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    import minari

    env = minari.DataCollector(gymnasium.make(ID, max_episode_steps=20), record_infos=True)
    env.action_space.seed(0)
    for episode in range(3):
        env.reset(seed=episode)
        for _ in range(20):
            env.step(env.action_space.sample())
    made = env.create_dataset(dataset_id="sandgait/gait/random-v0", algorithm_name="random")
    env.close()
    read = minari.load_dataset("sandgait/gait/random-v0")
    assert made.total_episodes == read.total_episodes == 3
    for episode in read.iterate_episodes():
        assert episode.observations.shape == (21, 41)
        assert episode.infos["speed"].shape == (21,)
        assert episode.infos["speed"][0] == 0
        assert episode.infos["speed"][1:].all()


def test_rllib_remote_workers() -> None:
    import ray
    from ray.rllib.algorithms.ppo import PPOConfig

    # Workers import this package by the part of the id before the colon.
    paths = os.pathsep.join(p for p in sys.path if p)
    ray.init(num_cpus=2, include_dashboard=False, runtime_env={"env_vars": {"PYTHONPATH": paths}})
    try:
        config = (
            PPOConfig()
            .environment(f"sandgait:{ID}", env_config={"threads": 1})
            .env_runners(num_env_runners=1, num_envs_per_env_runner=2, rollout_fragment_length=100)
            .training(train_batch_size_per_learner=200, minibatch_size=100, num_epochs=1)
        )
        algorithm = config.build_algo()
        result = algorithm.train()
        assert result["env_runners"]["num_env_steps_sampled"] == 200
        algorithm.stop()
    finally:
        ray.shutdown()


def test_skrl_ppo(tmp_path: Path) -> None:
    import torch
    from skrl.agents.torch.ppo import PPO, PPO_CFG
    from skrl.envs.wrappers.torch import wrap_env
    from skrl.memories.torch import RandomMemory
    from skrl.models.torch import DeterministicMixin, GaussianMixin, Model
    from skrl.trainers.torch import SequentialTrainer

    class Policy(GaussianMixin, Model):
        def __init__(self, **spaces: Any) -> None:
            Model.__init__(self, **spaces)
            GaussianMixin.__init__(self)
            self.net = torch.nn.Linear(41, 6)
            self.log_std = torch.nn.Parameter(torch.zeros(6))

        def compute(self, inputs: Any, role: str) -> Any:
            return self.net(inputs["observations"]), {"log_std": self.log_std}

    class Value(DeterministicMixin, Model):
        def __init__(self, **spaces: Any) -> None:
            Model.__init__(self, **spaces)
            DeterministicMixin.__init__(self)
            self.net = torch.nn.Linear(41, 1)

        def compute(self, inputs: Any, role: str) -> Any:
            return self.net(inputs["observations"]), {}

    env = wrap_env(gymnasium.make_vec(ID, num_envs=4, clip_actions=True, max_episode_steps=20))
    spaces = {"observation_space": env.observation_space, "action_space": env.action_space, "device": env.device}
    models = {"policy": Policy(**spaces), "value": Value(**spaces)}
    settings = PPO_CFG(rollouts=16)
    settings.experiment.directory = str(tmp_path)
    memory = RandomMemory(memory_size=16, num_envs=4, device=env.device)
    agent = PPO(models=models, memory=memory, cfg=settings, **spaces)
    before = models["policy"].net.weight.detach().clone()
    SequentialTrainer(cfg={"timesteps": 40, "headless": True}, env=env, agents=agent).train()
    assert not torch.equal(before, models["policy"].net.weight)
    env.close()


def test_tianshou_ppo() -> None:
    import torch
    from tianshou.algorithm import PPO
    from tianshou.algorithm.modelfree.reinforce import ProbabilisticActorPolicy
    from tianshou.algorithm.optim import AdamOptimizerFactory
    from tianshou.data import Collector, VectorReplayBuffer
    from tianshou.env import DummyVectorEnv
    from tianshou.trainer import OnPolicyTrainerParams
    from tianshou.utils.net.common import Net
    from tianshou.utils.net.continuous import ContinuousActorProbabilistic, ContinuousCritic
    from torch.distributions import Independent, Normal

    envs = DummyVectorEnv([lambda: gymnasium.make(ID, max_episode_steps=20) for _ in range(3)])
    space = envs.action_space[0]
    assert isinstance(space, gymnasium.spaces.Box)
    actor = ContinuousActorProbabilistic(
        preprocess_net=Net(state_shape=(41,), hidden_sizes=[32]), action_shape=(6,), unbounded=True
    )
    policy = ProbabilisticActorPolicy(
        actor=actor,
        dist_fn=lambda both: Independent(Normal(*both), 1),
        action_space=space,
        action_bound_method="clip",
    )
    critic = ContinuousCritic(preprocess_net=Net(state_shape=(41,), hidden_sizes=[32]))
    algorithm: Any = PPO(policy=policy, critic=critic, optim=AdamOptimizerFactory(lr=3e-4))
    before = [w.detach().clone() for w in actor.parameters()]
    collector = Collector(algorithm, envs, VectorReplayBuffer(600, 3))
    algorithm.run_training(
        OnPolicyTrainerParams(
            training_collector=collector,
            max_epochs=1,
            epoch_num_steps=240,
            collection_step_num_env_steps=120,
            update_step_num_repetitions=1,
            batch_size=60,
            show_progress=False,
            verbose=False,
        )
    )
    assert any(not torch.equal(a, b) for a, b in zip(before, actor.parameters(), strict=True))
    envs.close()


#: TransformObservation got a third argument in gymnasium 1.0, which CleanRL 1.2 does not know.
CLEANRL = """
import runpy, sys
import gymnasium
class TransformObservation(gymnasium.wrappers.TransformObservation):
    def __init__(self, env, func, observation_space=None):
        super().__init__(env, func, observation_space or env.observation_space)
gymnasium.wrappers.TransformObservation = TransformObservation
sys.argv = ["ppo_continuous_action.py", *sys.argv[1:]]
runpy.run_module("cleanrl.ppo_continuous_action", run_name="__main__")
"""


def test_cleanrl_ppo_continuous_action(tmp_path: Path) -> None:
    options = ["--env-id", f"sandgait:{ID}", "--num-envs", "2", "--num-steps", "128", "--total-timesteps", "512"]
    command = [sys.executable, "-W", "ignore", "-c", CLEANRL, *options, "--cuda", "false"]
    paths = os.pathsep.join(p for p in sys.path if p)
    done = subprocess.run(
        command, cwd=tmp_path, env={**os.environ, "PYTHONPATH": paths}, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.count("SPS:") == 2


def test_optuna_searches_for_a_leg(tmp_path: Path) -> None:
    """The same command continues a study and finds the trials that are finished."""
    short = ["--trainings", "1", "--timesteps", "150000", "--out", str(tmp_path)]
    command = [sys.executable, str(HOME / "examples/codesign.py"), "--trials", "3", *short]
    outputs = [subprocess.run(command, capture_output=True, text=True, check=True).stdout for _ in range(2)]
    assert outputs[0] == outputs[1]
    assert outputs[0].count("°: ") == 3
    assert len(list(tmp_path.glob("leg*-0/policy.onnx"))) == 3
