"""Converts policies. `export_onnx` writes a policy of stable-baselines3 as an ONNX file, for `rollout_policy`,
`sandgait.evaluate` and `sandgait evaluate`. `to_sb3` makes a model of stable-baselines3 from a policy of `sandgait
train`."""

from __future__ import annotations

import contextlib
import logging
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from .arguments import checked
from .errors import InvalidRequest
from .from_rust import to_sb3 as to_sb3
from .snapshots import FilePath

try:
    import onnxscript  # noqa: F401 - torch needs onnxscript and would report its absence only during the export
    import torch
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.policies import ActorCriticPolicy
    from stable_baselines3.common.vec_env import VecNormalize
    from stable_baselines3.sac.policies import SACPolicy
    from stable_baselines3.td3.policies import TD3Policy
except ImportError as error:
    raise ImportError(f"{error.name} is not installed: pip install 'sandgait[sb3]'") from error


@checked
def export_onnx(model: BaseAlgorithm, path: FilePath, normalize: VecNormalize | None = None) -> Path:
    """Writes the deterministic policy of a PPO, A2C, SAC, TD3 or DDPG `model` to the ONNX file `path`; returns `path`.

    `normalize`: the VecNormalize of the model's training; its present statistics and its clipping become part of the
    network. The network's input is `observation`, f32 [n, observation], the environments' observations without
    normalization. Its output is `action`, f32 [n, action].
    """
    actor = _Actor(model, normalize).eval()
    size = model.observation_space.shape
    assert size is not None
    rows = torch.zeros(2, *size)
    with _quiet():
        program = torch.onnx.export(
            actor,
            (rows,),
            dynamo=True,
            verbose=False,
            input_names=["observation"],
            output_names=["action"],
            dynamic_shapes=({0: torch.export.Dim("n")},),
        )
    assert program is not None
    graph = program.model.graph
    for part in (graph, *graph):  # removes the source files and lines that torch writes into each node
        part.metadata_props.clear()
    path = Path(path)
    program.save(path, external_data=False)
    return path


class _Actor(torch.nn.Module):
    """Computes the action of `predict(deterministic=True)` from observations that are not normalized."""

    center: torch.Tensor
    rest: torch.Tensor
    scale: torch.Tensor
    low: torch.Tensor
    high: torch.Tensor

    def __init__(self, model: BaseAlgorithm, normalize: VecNormalize | None) -> None:
        super().__init__()
        policy = model.policy.to("cpu")
        space = model.action_space
        self.mean = _mean(policy)
        self.parts = policy
        self.squashed = bool(policy.squash_output)
        self.register_buffer("low", torch.as_tensor(space.low))  # type: ignore[attr-defined]
        self.register_buffer("high", torch.as_tensor(space.high))  # type: ignore[attr-defined]
        self.normalized = normalize is not None and normalize.norm_obs
        if normalize is not None and self.normalized:
            statistics: Any = normalize.obs_rms
            if isinstance(statistics, dict):
                raise InvalidRequest("normalize: observations that are dicts have no ONNX here")
            # VecNormalize computes in f64. Here the mean is a sum of two f32, which is as accurate, because a small
            # variance makes errors of the mean large.
            mean = torch.as_tensor(statistics.mean, dtype=torch.float64)
            scale = torch.sqrt(torch.as_tensor(statistics.var, dtype=torch.float64) + normalize.epsilon)
            self.register_buffer("center", mean.float())
            self.register_buffer("rest", (mean - mean.float()).float())
            self.register_buffer("scale", scale.float())
            self.clip = float(normalize.clip_obs)

    def forward(self, observation: Any) -> Any:
        rows = observation
        if self.normalized:
            rows = ((rows - self.center - self.rest) / self.scale).clamp(-self.clip, self.clip)
        action = self.mean(rows)
        if self.squashed:
            return self.low + 0.5 * (action + 1.0) * (self.high - self.low)
        return action.clamp(self.low, self.high)


def _mean(policy: Any) -> Callable[[Any], Any]:
    """The policy's action without noise, before SB3 scales or clips it to the action space."""
    if isinstance(policy, ActorCriticPolicy):

        def actor_critic(rows: Any) -> Any:
            features: Any = policy.extract_features(rows, policy.pi_features_extractor)
            action = policy.action_net(policy.mlp_extractor.forward_actor(features))
            return torch.tanh(action) if policy.squash_output else action

        return actor_critic
    if isinstance(policy, SACPolicy):
        actor = policy.actor

        def squashed(rows: Any) -> Any:
            features = actor.extract_features(rows, actor.features_extractor)
            return torch.tanh(actor.mu(actor.latent_pi(features)))

        return squashed
    if isinstance(policy, TD3Policy):
        return policy.actor
    raise InvalidRequest(f"model: {type(policy).__name__} is no policy of PPO, A2C, SAC, TD3 or DDPG")


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Hides the exporter's warnings, which are about torch and not about this network."""
    logger = logging.getLogger("torch.onnx")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.setLevel(level)
