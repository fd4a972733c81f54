"""Reads policies of `sandgait train` as models of stable-baselines3, for further training."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from .arguments import checked
from .errors import InvalidRequest
from .snapshots import FilePath

try:
    import torch
    from stable_baselines3 import PPO
    from stable_baselines3.common.policies import ActorCriticPolicy
    from stable_baselines3.common.running_mean_std import RunningMeanStd
    from stable_baselines3.common.type_aliases import Schedule
    from stable_baselines3.common.vec_env import VecEnv, VecNormalize
    from torch import nn
except ImportError as error:
    raise ImportError(f"{error.name} is not installed: pip install 'sandgait[sb3]'") from error

FORMAT = "sandgait policy 1"
DTYPES = {"F32": np.float32, "F64": np.float64, "I64": np.int64}

Arrays = dict[str, npt.NDArray[Any]]


def read_policy(path: FilePath) -> tuple[dict[str, str], Arrays]:
    """The texts and arrays in a file of `sandgait train`. Its weight matrices are [inputs, outputs]."""
    data = Path(path).read_bytes()
    try:
        length = int.from_bytes(data[:8], "little")
        header: dict[str, Any] = json.loads(data[8 : 8 + length])
        about = header.pop("__metadata__")
        if about["format"] != FORMAT:
            raise InvalidRequest(f"{path}: it is {about['format']!r}, not {FORMAT!r}")
        body = memoryview(data)[8 + length :]
        arrays = {
            name: np.frombuffer(body[slice(*entry["data_offsets"])], DTYPES[entry["dtype"]]).reshape(entry["shape"])
            for name, entry in header.items()
        }
    except (KeyError, TypeError, ValueError) as error:
        if isinstance(error, InvalidRequest):
            raise
        raise InvalidRequest(f"{path}: this is no policy of sandgait train: {error}") from error
    return about, arrays


@checked
def to_sb3(path: FilePath, env: VecEnv, **changes: Any) -> PPO:
    """A PPO model with the weights and settings in `path`, a `policy.safetensors` or checkpoint of `sandgait train`.

    `env`: environments of the same task, made by `make_sb3`. If the training used `normalize`, the model's `get_env()`
    is a `VecNormalize` around `env` with the training's statistics. `changes`: arguments of PPO that replace those of
    the training, for example `learning_rate`. The optimizer's state is not restored.
    """
    about, arrays = read_policy(path)
    settings = json.loads(about["settings"])
    if "action.low" in arrays:
        _scale(arrays, len(settings["policy_kwargs"]["net_arch"]["pi"]))
    wanted, given = arrays["actor.0.weights"].shape[0], env.observation_space.shape
    if given is None or np.prod(given) != wanted:
        raise InvalidRequest(
            f"env: observations are {given}, the policy takes ({wanted},): it was learnt for {about['task']}"
        )
    if settings["normalize"]:
        env = _normalized(env, arrays, settings)
    names = ("n_steps", "batch_size", "n_epochs", "gamma", "gae_lambda", "normalize_advantage", "ent_coef", "vf_coef")
    arguments = {name: settings[name] for name in (*names, "max_grad_norm", "target_kl")}
    for name in ("learning_rate", "clip_range", "clip_range_vf"):
        arguments[name] = _schedule(settings[name])
    policy: Any = "MlpPolicy"
    arguments["policy_kwargs"] = kwargs = dict(settings["policy_kwargs"])
    if settings["mirror"]:
        policy = MirroredPolicy
        kwargs["mirrors"] = tuple(
            (arrays[f"mirror.{name}.order"].tolist(), arrays[f"mirror.{name}.signs"].tolist())
            for name in ("observation", "action")
        )
    model = PPO(policy, env, device="cpu", seed=int(about["seed"]), **{**arguments, **changes})
    _load(model.policy, arrays, bool(settings["mirror"]))
    model.num_timesteps = int(about["steps"])
    return model


def _scale(arrays: Arrays, last: int) -> None:
    """Scales the actions of a policy for another package's environment from ±1 to its action space."""
    low, high = arrays["action.low"], arrays["action.high"]
    half = (0.5 * (high - low)).astype(np.float32)
    arrays[f"actor.{last}.weights"] = arrays[f"actor.{last}.weights"] * half
    arrays[f"actor.{last}.bias"] = arrays[f"actor.{last}.bias"] * half + (0.5 * (low + high)).astype(np.float32)
    arrays["log_std"] = arrays["log_std"] + np.log(half)


def _schedule(setting: Any) -> Any:
    """A constant, or a schedule that falls to zero."""
    if not isinstance(setting, str):
        return setting
    first = float(setting.removeprefix("lin_"))
    return lambda remaining: first * remaining


def _normalized(env: VecEnv, arrays: Arrays, settings: dict[str, Any]) -> VecNormalize:
    normalized = VecNormalize(env, gamma=settings["gamma"])
    for name, statistics in (("observations", normalized.obs_rms), ("returns", normalized.ret_rms)):
        assert isinstance(statistics, RunningMeanStd)
        statistics.mean = arrays[f"{name}.mean"].reshape(statistics.mean.shape).copy()
        statistics.var = arrays[f"{name}.variance"].reshape(statistics.var.shape).copy()
        statistics.count = float(arrays[f"{name}.count"])
    return normalized


def _load(policy: Any, arrays: Arrays, mirrored: bool) -> None:
    """Copies the weights layer by layer. torch's weight matrices are [outputs, inputs]."""
    extractor = policy.mlp_extractor
    if mirrored:
        actor, critic = [*extractor.actor], [*extractor.critic, policy.value_net]
    else:
        actor, critic = [*extractor.policy_net, policy.action_net], [*extractor.value_net, policy.value_net]
    with torch.no_grad():
        for name, modules in (("actor", actor), ("critic", critic)):
            for k, layer in enumerate(module for module in modules if isinstance(module, nn.Linear)):
                layer.weight.copy_(torch.from_numpy(arrays[f"{name}.{k}.weights"].T.copy()))
                layer.bias.copy_(torch.from_numpy(arrays[f"{name}.{k}.bias"].copy()))
        policy.log_std.copy_(torch.from_numpy(arrays["log_std"].copy()))


#: For each column: the index of the column that has its mirrored value, and the sign of that value.
Mirror = tuple[list[int], list[float]]


class _Reflection(nn.Module):
    """Mirrors rows by a product with a matrix of 0, 1 and -1, which is exact and possible in ONNX."""

    matrix: torch.Tensor

    def __init__(self, mirror: Mirror) -> None:
        super().__init__()
        order, signs = mirror
        matrix = torch.zeros(len(order), len(order))
        matrix[order, range(len(order))] = torch.tensor(signs)
        self.register_buffer("matrix", matrix, persistent=False)

    def forward(self, rows: torch.Tensor) -> torch.Tensor:
        return rows @ self.matrix


class _MirroredNetworks(nn.Module):
    """Actor f and critic v, averaged with their mirror images: (f(s) + M f(M s)) / 2 and (v(s) + v(M s)) / 2."""

    def __init__(self, sizes: tuple[list[int], list[int]], observation: Mirror, action: Mirror) -> None:
        super().__init__()
        self.observation, self.action = _Reflection(observation), _Reflection(action)
        inputs, outputs = len(observation[0]), len(action[0])
        self.latent_dim_pi, self.latent_dim_vf = outputs, [inputs, *sizes[1]][-1]
        self.actor = nn.Sequential(*_tangents([inputs, *sizes[0]]), nn.Linear([inputs, *sizes[0]][-1], outputs))
        self.critic = nn.Sequential(*_tangents([inputs, *sizes[1]]))

    def forward(self, rows: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        return self.forward_actor(rows), self.forward_critic(rows)

    def forward_actor(self, rows: torch.Tensor) -> torch.Tensor:
        mean: torch.Tensor = self.actor(rows) + self.action(self.actor(self.observation(rows)))
        return 0.5 * mean

    def forward_critic(self, rows: torch.Tensor) -> torch.Tensor:
        value: torch.Tensor = self.critic(rows) + self.critic(self.observation(rows))
        return 0.5 * value


def _tangents(sizes: list[int]) -> list[nn.Module]:
    return [part for before, after in pairwise(sizes) for part in (nn.Linear(before, after), nn.Tanh())]


class MirroredPolicy(ActorCriticPolicy):
    """PPO's policy for trainings with `mirror`. Actor and critic give mirrored results for mirrored observations."""

    def __init__(self, *args: Any, mirrors: tuple[Mirror, Mirror], **kwargs: Any) -> None:
        self.mirrors = mirrors
        super().__init__(*args, **{**kwargs, "ortho_init": False})

    def _build_mlp_extractor(self) -> None:
        assert isinstance(self.net_arch, dict)
        sizes = self.net_arch["pi"], self.net_arch["vf"]
        self.mlp_extractor = _MirroredNetworks(sizes, *self.mirrors)  # type: ignore[assignment]

    def _build(self, lr_schedule: Schedule) -> None:
        super()._build(lr_schedule)
        self.action_net = nn.Identity()  # another layer after the mirrored mean would not be symmetric
        self.optimizer = self.optimizer_class(self.parameters(), lr=lr_schedule(1), **self.optimizer_kwargs)  # type: ignore[call-arg]

    def _get_constructor_parameters(self) -> dict[str, Any]:
        return {**super()._get_constructor_parameters(), "mirrors": self.mirrors}
