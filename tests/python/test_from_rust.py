"""`sandgait train` and stable-baselines3 make the same update from the same rollout, and SB3 can load its policies."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
import pytest
import torch
from onnx.reference import ReferenceEvaluator
from stable_baselines3 import PPO
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

import sandgait
from conftest import ID
from sandgait import server
from sandgait.errors import InvalidRequest
from sandgait.export import to_sb3

#: SB3's parameters after the update below. A test in src/train/learner.rs compares with the same numbers.
KEPT = Path(__file__).parents[1] / "data" / "train" / "sb3_update.json"

ROWS, OBSERVATION, ACTION = 64, 41, 6


class Still(gymnasium.Env[Any, Any]):
    """An environment that has only spaces."""

    observation_space = gymnasium.spaces.Box(-10.0, 10.0, (OBSERVATION,))
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (ACTION,))

    def reset(self, **_: Any) -> tuple[Any, dict[str, Any]]:
        return np.zeros(OBSERVATION, np.float32), {}


def wave(count: int, size: float, pitch: float, shift: float) -> npt.NDArray[np.float32]:
    """Numbers from a formula that the test in Rust uses, too."""
    return (size * np.sin(pitch * np.arange(count)) + shift).astype(np.float32)


def updated() -> list[float]:
    """The parameters after three epochs of SB3's PPO with one minibatch; weights [inputs, outputs], actor first."""
    model = PPO(
        "MlpPolicy",
        DummyVecEnv([Still]),
        learning_rate=1e-3,
        n_steps=ROWS,
        batch_size=ROWS,
        n_epochs=3,
        clip_range=0.2,
        clip_range_vf=0.3,
        ent_coef=0.01,
        max_grad_norm=0.5,
        policy_kwargs={"net_arch": [8, 7], "log_std_init": -0.3},
        device="cpu",
    )
    policy = model.policy
    parts: list[Any] = [*policy.mlp_extractor.policy_net, policy.action_net]
    parts += [*policy.mlp_extractor.value_net, policy.value_net]
    layers = [part for part in parts if isinstance(part, torch.nn.Linear)]
    place = 0
    with torch.no_grad():
        for layer in layers:
            for rows in (layer.weight.T, layer.bias):
                values = wave(place + rows.numel(), 0.4, 1.1, 0.0)[place:]
                rows.copy_(torch.from_numpy(values).reshape(rows.shape))
                place += rows.numel()
    buffer = model.rollout_buffer
    buffer.observations = wave(ROWS * OBSERVATION, 1.5, 0.37, 0.1).reshape(ROWS, 1, OBSERVATION)
    buffer.actions = wave(ROWS * ACTION, 1.2, 0.71, 0.0).reshape(ROWS, 1, ACTION)
    columns = {"log_probs": (0.4, 1.9, -6.0), "values": (0.5, 0.53, 0.0), "advantages": (2.0, 0.91, 0.3)}
    for name, numbers in {**columns, "returns": (1.0, 0.77, 0.2)}.items():
        setattr(buffer, name, wave(ROWS, *numbers).reshape(ROWS, 1))
    buffer.full = True
    model.set_logger(Logger(None, []))
    model.train()
    numbers = [part.detach().numpy().ravel() for layer in layers for part in (layer.weight.T, layer.bias)]
    return [float(x) for x in np.concatenate([*numbers, policy.log_std.detach().numpy()])]


def test_the_kept_numbers_equal_sb3s() -> None:
    np.testing.assert_allclose(updated(), json.loads(KEPT.read_text()), atol=2e-6)


@pytest.fixture(scope="module", params=["mirror=true", "mirror=false"])
def trained(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("train")
    changes = [request.param, "n_envs=16", "batch_size=64", "policy_kwargs={net_arch: [16, 8]}", "n_epochs=2"]
    settings = [word for change in changes for word in ("--set", change)]
    command = [*server.command(), "train", "--timesteps", "2000", "--option", "max_episode_steps=60", *settings]
    subprocess.run([*command, "--out", out], check=True, capture_output=True, text=True)
    return out


def test_the_model_acts_as_the_onnx_file(trained: Path) -> None:
    """Loads the policy as a model of SB3, compares its actions, and continues the training."""
    env = sandgait.make_sb3(ID, 16, max_episode_steps=60)
    model = to_sb3(trained / "policy.safetensors", env)
    normalized = model.get_env()
    assert isinstance(normalized, VecNormalize)
    file = ReferenceEvaluator(str(trained / "policy.onnx"))
    normalized.training = False
    observations = normalized.reset()
    for _ in range(20):
        actions, _ = model.predict(observations, deterministic=True)
        (wanted,) = file.run(None, {"observation": normalized.get_original_obs()})
        np.testing.assert_allclose(actions, wanted, atol=1e-5)
        observations, *_ = normalized.step(actions)
    before = model.num_timesteps
    model.learn(256, reset_num_timesteps=False)
    assert model.num_timesteps > before >= 2000
    normalized.close()


def test_a_policy_for_another_environment_acts_the_same(tmp_path: Path) -> None:
    """Its actions are scaled to the action space, ±2 here."""
    vector = gymnasium.make_vec("Pendulum-v1", num_envs=8)
    training = sandgait.train(vector, out=tmp_path / "out", timesteps=20_000, progress=False)
    model = to_sb3(training.weights, DummyVecEnv([lambda: gymnasium.make("Pendulum-v1")] * 8))
    normalized = model.get_env()
    assert isinstance(normalized, VecNormalize)
    normalized.training = False
    file = ReferenceEvaluator(str(training.policy))
    observations = normalized.reset()
    for _ in range(20):
        actions, _ = model.predict(observations, deterministic=True)
        (wanted,) = file.run(None, {"observation": normalized.get_original_obs()})
        np.testing.assert_allclose(actions, wanted, atol=2e-5)
        observations, *_ = normalized.step(2.0 * np.sin(np.arange(8.0)[:, None]))
    assert np.abs(actions).max() > 1e-3


def test_tensorboard_reads_the_events(trained: Path) -> None:
    events = EventAccumulator(str(trained / "tensorboard"))
    events.Reload()
    losses = events.Scalars("train/value_loss")
    assert losses[-1].step >= 2000
    assert all(np.isfinite(event.value) for event in losses)
    assert {"train/approx_kl", "rollout/ep_rew_mean", "time/fps"} <= set(events.Tags()["scalars"])


def test_files_other_than_policies_are_refused(trained: Path, tmp_path: Path) -> None:
    env = sandgait.make_sb3("sandgait/HexapodLegs-v1", 1)
    with pytest.raises(InvalidRequest, match="the policy takes"):
        to_sb3(trained / "policy.safetensors", env)
    env.close()
    whole = (trained / "policy.safetensors").read_bytes()
    for content in (b"", whole[:100], b"\x00" * 64, whole.replace(b"sandgait policy 1", b"sandgait policy 9")):
        (tmp_path / "broken").write_bytes(content)
        with pytest.raises(InvalidRequest, match="broken"):
            to_sb3(tmp_path / "broken", env)
