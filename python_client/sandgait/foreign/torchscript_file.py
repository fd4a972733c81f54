"""Reads the TorchScript file of a foreign policy, as rsl_rl, legged_gym and Isaac Lab export it: layers one after the
other, without memory."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sandgait_deploy import Refused

from .steps import Array, Steps

Floats = npt.NDArray[np.float64]

_MEMORY = ("LSTM", "GRU", "RNN")
_EACH = {"ELU": "Elu", "ReLU": "Relu", "Tanh": "Tanh", "Sigmoid": "Sigmoid"}
_SAME = ("Identity", "Dropout", "Flatten")


class TorchScriptFile:
    """A foreign TorchScript file."""

    def __init__(self, path: Path) -> None:
        try:
            import torch
        except ImportError:
            raise Refused(f"network: {path.name} is TorchScript, which torch reads: pip install torch") from None
        try:
            load: Any = torch.jit.load
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", FutureWarning)  # torch wants other files; the field has these
                self._module = load(str(path), map_location="cpu").eval()
        except (RuntimeError, ValueError) as error:
            reason = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise Refused(f"network: {path.name} cannot be read as TorchScript: {reason}") from None
        layers = [one for one in self._module.modules() if not list(one.children())]
        # rsl_rl's exporter holds the normalization of the observation behind the layers that it is computed before.
        self._layers = sorted(layers, key=lambda one: not _is_normalization(one))
        memory = [one.original_name for one in self._layers if one.original_name in _MEMORY]
        if memory:
            raise Refused(f"network: {path.name} has the layer {memory[0]}; a network with memory is not run")

    def width(self, otherwise: int) -> int:
        """How many numbers its input has."""
        first = next((one for one in self._layers if one.original_name == "Linear"), None)
        return otherwise if first is None else int(first.weight.shape[1])

    def add(self, steps: Steps, x: str) -> str:
        """Its steps from the value `x`; the name of their result."""
        for layer in self._layers:
            x = self._step(steps, x, layer)
        return x

    def function(self) -> Callable[[Floats], Floats]:
        """The network as torch itself computes it, for a row."""
        import torch

        def act(row: Floats) -> Floats:
            with torch.inference_mode():
                made = self._module(torch.from_numpy(row[None].astype(np.float32)))
            return np.asarray(made.numpy(), np.float64).reshape(-1)

        return act

    def _step(self, steps: Steps, x: str, layer: Any) -> str:
        kind = layer.original_name
        if kind == "Linear":
            bias = 0.0 if layer.bias is None else _row(layer.bias)
            return steps.dense(x, _row(layer.weight).T, bias)
        if kind == "SiLU":
            return steps.both("Mul", x, steps.each("Sigmoid", x))
        if kind in _EACH:
            return steps.each(_EACH[kind], x)
        if _is_normalization(layer):
            # 1e-2 is rsl_rl's default; the comparison with torch finds another value.
            deviation = _row(layer._std) + np.float32(getattr(layer, "eps", 1e-2))
            return steps.both("Div", steps.both("Sub", x, _row(layer._mean)), deviation)
        if kind in _SAME:
            return x
        raise Refused(f"network: has the layer {kind}, which is not read; export it as ONNX")


def _is_normalization(layer: Any) -> bool:
    """rsl_rl's EmpiricalNormalization."""
    return {"_mean", "_std"} <= {name for name, _ in layer.named_buffers()}


def _row(tensor: Any) -> Array:
    return np.asarray(tensor.detach().numpy(), np.float32)
