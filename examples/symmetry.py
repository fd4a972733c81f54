"""Policies that are symmetric in left and right.

The mirror image of a symmetric robot on sand is again that robot on sand. So a good policy chooses the mirrored action
for the mirrored observation. A network that is averaged with its own mirror image always does so. This helps a robot to
walk straight: observations do not have the heading, so no policy can correct a wrong heading later. `sandgait.mirror`
gives the mirrors of a task's rows.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.type_aliases import Schedule
from stable_baselines3.common.vec_env import VecNormalize
from torch import nn

from sandgait.training import Mirror


class Reflection(nn.Module):
    """Mirrors rows by a product with a matrix of 0, 1 and −1, which is exact and possible in ONNX."""

    matrix: torch.Tensor

    def __init__(self, mirrored: Mirror) -> None:
        super().__init__()
        order, signs = mirrored
        matrix = torch.zeros(len(order), len(order))
        matrix[order, range(len(order))] = torch.tensor(signs)
        self.register_buffer("matrix", matrix, persistent=False)

    def forward(self, rows: torch.Tensor) -> torch.Tensor:
        return rows @ self.matrix


class MirroredNetworks(nn.Module):
    """Actor f and critic v, averaged with their mirror images: (f(s) + M f(M s)) / 2 and (v(s) + v(M s)) / 2."""

    def __init__(self, sizes: list[int], observation: Mirror, action: Mirror) -> None:
        super().__init__()
        self.observation, self.action = Reflection(observation), Reflection(action)
        self.latent_dim_pi, self.latent_dim_vf = len(action[0]), sizes[-1]
        self.actor = _layers([len(observation[0]), *sizes], [self.latent_dim_pi])
        self.critic = _layers([len(observation[0]), *sizes], [])

    def forward(self, rows: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        return self.forward_actor(rows), self.forward_critic(rows)

    def forward_actor(self, rows: torch.Tensor) -> torch.Tensor:
        mean: torch.Tensor = self.actor(rows) + self.action(self.actor(self.observation(rows)))
        return 0.5 * mean

    def forward_critic(self, rows: torch.Tensor) -> torch.Tensor:
        value: torch.Tensor = self.critic(rows) + self.critic(self.observation(rows))
        return 0.5 * value


def _layers(hidden: list[int], last: list[int]) -> nn.Sequential:
    """Tanh layers, then a linear layer with small initial weights, as in stable-baselines3's PPO."""
    layers: list[nn.Module] = []
    for before, after in pairwise(hidden):
        layers += [_linear(before, after, 2.0**0.5), nn.Tanh()]
    return nn.Sequential(*layers, *(_linear(hidden[-1], after, 0.01) for after in last))


def _linear(before: int, after: int, gain: float) -> nn.Linear:
    layer = nn.Linear(before, after)
    nn.init.orthogonal_(layer.weight, gain=gain)
    nn.init.zeros_(layer.bias)
    return layer


class MirroredPolicy(ActorCriticPolicy):
    """PPO's policy with `MirroredNetworks`; `net_arch` is a list of layer sizes."""

    def __init__(self, *args: Any, observation: Mirror, action: Mirror, **kwargs: Any) -> None:
        self.mirrors = observation, action
        super().__init__(*args, **{**kwargs, "ortho_init": False})

    def _build_mlp_extractor(self) -> None:
        assert isinstance(self.net_arch, list)
        self.mlp_extractor = MirroredNetworks(self.net_arch, *self.mirrors)  # type: ignore[assignment]

    def _build(self, lr_schedule: Schedule) -> None:
        super()._build(lr_schedule)
        self.action_net = nn.Identity()  # another layer after the mirrored mean would not be symmetric
        self.optimizer = self.optimizer_class(self.parameters(), lr=lr_schedule(1), **self.optimizer_kwargs)  # type: ignore[call-arg]

    def _get_constructor_parameters(self) -> dict[str, Any]:
        observation, action = self.mirrors
        return {**super()._get_constructor_parameters(), "observation": observation, "action": action}


class MirroredStatistics(BaseCallback):
    """Makes the statistics of VecNormalize symmetric, so that normalized rows stay mirror images of each other."""

    def __init__(self, observation: Mirror) -> None:
        super().__init__()
        self.order, self.signs = np.array(observation[0]), np.array(observation[1])

    def _on_rollout_start(self) -> None:
        normalized = self.training_env
        assert isinstance(normalized, VecNormalize)
        statistics = normalized.obs_rms
        assert isinstance(statistics, RunningMeanStd)
        statistics.mean = 0.5 * (statistics.mean + statistics.mean[self.order] * self.signs)
        statistics.var = 0.5 * (statistics.var + statistics.var[self.order])

    def _on_step(self) -> bool:
        return True
