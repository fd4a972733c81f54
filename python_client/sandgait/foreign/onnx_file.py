"""Reads the ONNX file of a foreign policy: a network from one row to one, without memory."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import onnx
from onnx import helper, numpy_helper

from sandgait_deploy import Refused

from .steps import Array, Operand, Steps

Floats = npt.NDArray[np.float64]

_MEMORY = ("LSTM", "GRU", "RNN", "Loop", "Scan", "If")
_SAME = ("Cast", "Dropout", "Flatten", "Identity", "Reshape", "Squeeze", "Unsqueeze")
_EACH = ("Relu", "Sigmoid", "Tanh")
_BOTH = ("Add", "Sub", "Mul", "Div", "Min", "Max")


class OnnxFile:
    """A foreign ONNX file, with its weights, also if they lie in a file beside it."""

    def __init__(self, path: Path) -> None:
        try:
            self._model = onnx.load(str(path))
            self._graph = self._model.graph
            constants = {tensor.name: _numbers(numpy_helper.to_array(tensor)) for tensor in self._graph.initializer}
        except Exception as error:  # protobuf and onnx have errors of their own for damaged and missing files
            reason = " ".join(str(error).split())[:200] or type(error).__name__
            raise Refused(f"network: {path.name} cannot be read as ONNX: {reason}") from None
        inputs = [one for one in self._graph.input if one.name not in constants]
        if not inputs or not self._graph.output:
            raise Refused(f"network: {path.name} cannot be read as ONNX: it has no input or no output")
        if len(inputs) > 1:
            names = ", ".join(one.name for one in inputs)
            raise Refused(f"network: {path.name} has the inputs {names}; a network with memory is not run, export one "
                          "with a single input, the observation")  # fmt: skip
        self._input, self._output = inputs[0].name, self._graph.output[0].name
        self._constants = constants

    def width(self, otherwise: int) -> int:
        """How many numbers its input has; `otherwise`, if the file does not say."""
        shape = next(one for one in self._graph.input if one.name == self._input).type.tensor_type.shape.dim
        return int(shape[-1].dim_value or otherwise) if shape else otherwise

    def add(self, steps: Steps, x: str) -> str:
        """Its steps from the value `x`; the name of their result."""
        reader = _Nodes(steps, {**self._constants, self._input: x})
        for node in self._graph.node:
            reader.read(node)
        result = reader.names.get(self._output)
        if not isinstance(result, str):
            raise Refused(f"network: its output {self._output} does not come from its input")
        return result

    def function(self) -> Callable[[Floats], Floats]:
        """The network as onnx itself computes it, for a row."""
        from onnx.reference import ReferenceEvaluator

        evaluator = ReferenceEvaluator(self._model)

        def act(row: Floats) -> Floats:
            made: Any = evaluator.run([self._output], {self._input: row[None].astype(np.float32)})
            return np.asarray(made[0], np.float64).reshape(-1)

        return act


class _Nodes:
    """Turns nodes into steps. `names`: values and constants by their names in the file."""

    def __init__(self, steps: Steps, names: dict[str, Operand]) -> None:
        self._steps, self.names = steps, names

    def read(self, node: Any) -> None:
        kind = node.op_type
        if kind in _MEMORY:
            raise Refused(f"network: has the operator {kind}; a network with memory is not run")
        if kind == "Constant":
            self.names[node.output[0]] = _constant(node)
        elif kind == "Split":
            self._split(node)
        elif kind in _SAME:
            self.names[node.output[0]] = self._named(node.input[0])
        else:
            self.names[node.output[0]] = self._value(node)

    def _named(self, name: str) -> Operand:
        if name not in self.names:
            raise Refused(f"network: reads {name!r}, which no earlier node computes")
        return self.names[name]

    def _value(self, node: Any) -> str:
        kind, steps = node.op_type, self._steps
        given = [self._named(name) for name in node.input if name]
        if kind in _BOTH and len(given) == 2 and any(isinstance(one, str) for one in given):
            return steps.both(kind, given[0], given[1])
        x = given[0] if given else None
        if not isinstance(x, str):
            raise Refused(f"network: {kind} computes with constants only; export with constant folding")
        if kind in ("Gemm", "MatMul"):
            return self._dense(node, x)
        if kind in _EACH:
            return steps.each(kind, x)
        if kind == "Elu" and _attribute(node, "alpha", 1.0) == 1.0:
            return steps.each(kind, x)
        if kind == "LeakyRelu" and 0.0 <= (alpha := _attribute(node, "alpha", 0.01)) <= 1.0:
            return steps.both("Max", x, steps.both("Mul", x, _numbers(alpha)))
        if kind == "Clip":
            return self._clip(node, x)
        if kind == "Slice":
            return self._slice(node, x)
        known = ", ".join((*_EACH, *_BOTH, *_SAME, "Gemm", "MatMul", "Elu", "LeakyRelu", "Clip", "Slice", "Split"))
        raise Refused(f"network: has the operator {kind} in a form that is not read; read are {known}")

    def _dense(self, node: Any, x: str) -> str:
        names = [self._named(name) for name in node.input[1:] if name]
        given = [one for one in names if not isinstance(one, str)]
        if len(given) != len(names) or not given or _attribute(node, "transA", 0):
            raise Refused(f"network: {node.op_type} has weights that depend on the observation")
        matrix = given[0].T if _attribute(node, "transB", 0) else given[0]
        bias = given[1] if len(given) > 1 else np.zeros(1, np.float32)
        factor, added = _attribute(node, "alpha", 1.0), _attribute(node, "beta", 1.0)
        return self._steps.dense(x, np.float32(factor) * matrix, np.float32(added) * bias)

    def _clip(self, node: Any, x: str) -> str:
        for k, name, kind in ((1, "min", "Max"), (2, "max", "Min")):
            bound: Any = self._whole(node, k, name)
            x = x if bound is None else self._steps.both(kind, x, _numbers(bound))
        return x

    def _split(self, node: Any) -> None:
        x = self._named(node.input[0])
        if not isinstance(x, str) or _attribute(node, "axis", 0) not in (1, -1):
            raise Refused("network: has the operator Split in a form that is not read")
        sizes: Any = self._whole(node, 1, "split")
        count = len(node.output)
        sizes = [self._steps.widths[x] // count] * count if sizes is None else np.asarray(sizes, np.int64).tolist()
        first = 0
        for name, size in zip(node.output, sizes, strict=True):
            self.names[name] = self._steps.chosen(x, range(first, first + size))
            first += size

    def _slice(self, node: Any, x: str) -> str:
        parts: list[Any] = [
            self._whole(node, k + 1, name) for k, name in enumerate(("starts", "ends", "axes", "steps"))
        ]
        start, end, axis, step = (None if one is None else np.asarray(one).reshape(-1).tolist() for one in parts)
        if not start or not end or axis not in ([1], [-1]):
            raise Refused("network: has the operator Slice in a form that is not read")
        places = range(self._steps.widths[x])[slice(int(start[0]), int(end[0]), int(step[0]) if step else 1)]
        return self._steps.chosen(x, places)

    def _whole(self, node: Any, k: int, name: str) -> Any:
        """Input k, or the attribute of older operator sets; None if there is neither."""
        if len(node.input) > k and node.input[k]:
            return self._named(node.input[k])
        return _attribute(node, name, None)


def _numbers(values: Any) -> Array:
    return np.asarray(values, np.float32)


def _constant(node: Any) -> Array:
    for attribute in node.attribute:
        value = helper.get_attribute_value(attribute)
        return _numbers(numpy_helper.to_array(value) if attribute.name == "value" else value)
    raise Refused("network: has a Constant without a value")


def _attribute(node: Any, name: str, otherwise: Any) -> Any:
    found = next((one for one in node.attribute if one.name == name), None)
    return otherwise if found is None else helper.get_attribute_value(found)
