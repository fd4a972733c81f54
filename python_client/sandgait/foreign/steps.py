"""A network as an ONNX file of few operators without attributes, which simulator and Controller compute to the same
bits (`sandgait_deploy.network`)."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import onnx
from onnx import helper, numpy_helper

from sandgait_deploy import Refused

Array = npt.NDArray[np.float32]

#: A value, by its name, or constants: a row.
Operand = str | Array

#: Version of ONNX's operators, and of the file format that goes with it: old enough for every reader.
_OPSET, _FORMAT = 13, 8


class Steps:
    """The steps of a network from its `observation`; each gives the name of its result."""

    def __init__(self, observation: int) -> None:
        self._nodes: list[Any] = []
        self._constants: list[Any] = []
        #: How many numbers each value has.
        self.widths = {"observation": observation}

    def dense(self, x: str, weights: npt.ArrayLike, bias: npt.ArrayLike) -> str:
        """x · weights + bias; weights: [inputs, outputs]."""
        matrix, row = np.asarray(weights, np.float32), np.asarray(bias, np.float32).reshape(-1)
        if matrix.ndim != 2 or matrix.shape[0] != self.widths[x] or row.size not in (1, matrix.shape[1]):
            raise Refused(f"network: its layer of the shape {matrix.shape} gets {self.widths[x]} numbers")
        row = np.broadcast_to(row, matrix.shape[1:])
        return self._step("Gemm", [x, self._constant(matrix), self._constant(row)], matrix.shape[1])

    def chosen(self, x: str, places: npt.ArrayLike) -> str:
        """The numbers of x at these places."""
        matrix = np.eye(self.widths[x], dtype=np.float32)[:, np.asarray(places, np.int64)]
        return self.dense(x, matrix, 0.0)

    def each(self, kind: str, x: str) -> str:
        """A function of each number: Elu, Relu, Sigmoid or Tanh."""
        return self._step(kind, [x], self.widths[x])

    def both(self, kind: str, left: Operand, right: Operand) -> str:
        """Add, Sub, Mul, Div, Min or Max, number by number; a single constant counts for all numbers."""
        sizes = [self.widths[o] if isinstance(o, str) else o.size for o in (left, right)]
        if sizes[0] != sizes[1] and 1 not in sizes:
            raise Refused(f"network: {kind} joins {sizes[0]} numbers and {sizes[1]}")
        names = [o if isinstance(o, str) else self._constant(o.reshape(-1)) for o in (left, right)]
        return self._step(kind, names, max(sizes))

    def file(self, output: str) -> bytes:
        """The ONNX file whose output is the value `output`."""
        row = helper.make_tensor_value_info
        graph = helper.make_graph(
            [*self._nodes, helper.make_node("Identity", [output], ["action"])],
            "policy",
            [row("observation", onnx.TensorProto.FLOAT, ["n", self.widths["observation"]])],
            [row("action", onnx.TensorProto.FLOAT, ["n", self.widths[output]])],
            self._constants,
        )
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", _OPSET)], ir_version=_FORMAT)
        return bytes(model.SerializeToString())

    def _constant(self, numbers: Array) -> str:
        name = f"constant{len(self._constants)}"
        self._constants.append(numpy_helper.from_array(np.ascontiguousarray(numbers, np.float32), name))
        return name

    def _step(self, kind: str, inputs: list[str], width: int) -> str:
        name = f"value{len(self._nodes)}"
        self._nodes.append(helper.make_node(kind, inputs, [name]))
        self.widths[name] = width
        return name
