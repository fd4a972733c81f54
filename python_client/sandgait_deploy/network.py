"""The network of a policy: an ONNX file, computed by numpy to the same bits as the simulator computes it.

`sandgait train` and `sandgait.foreign` write networks of a few operators. Here each sum is made in the order of the
simulator (`src/policy/operator.rs`): it begins with the bias and adds the inputs one by one, in 32 bits, without fused
multiply-add; tanh, exp and expm1 are those of the C library, as in the simulator. So actions are equal to the last bit
on a machine with the same C library. onnxruntime adds in another order, and its actions differ in the last places.
"""

from __future__ import annotations

import ctypes
import ctypes.util
import math
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from .errors import Refused

Row = npt.NDArray[np.float32]

#: How a policy's network is computed.
RUNTIMES = ("numpy", "onnxruntime")

#: TensorProto.FLOAT
_FLOAT = 1


class Network:
    """A policy: observation → action, f32 [observation] → f32 [action]."""

    def __init__(self, path: Path, observation: int, action: int, runtime: str = "numpy") -> None:
        if runtime not in RUNTIMES:
            raise Refused(f"runtime: {runtime!r} is none of {', '.join(RUNTIMES)}")
        self._size, self._out = observation, action
        try:
            content = path.read_bytes()
        except OSError as error:
            raise Refused(f"{path}: cannot be read: {error.strerror}") from None
        self._act = _with_onnxruntime(path, content) if runtime == "onnxruntime" else _Program(path, content)
        if len(self.act(np.zeros(observation, np.float32))) != action:
            raise Refused(f"{path}: its output is not the {action} numbers of policy.json's action")

    def act(self, observation: npt.NDArray[Any]) -> Row:
        """The action for one observation. Raises Refused if it is not finite."""
        row = np.ascontiguousarray(observation, np.float32)
        if row.shape != (self._size,):
            raise Refused(f"observation: has the shape {row.shape}, not ({self._size},)")
        action = self._act(row)
        if not np.isfinite(action).all():
            raise Refused("network: its action is not finite; look at the readings, or take another policy")
        return action


def _with_onnxruntime(path: Path, content: bytes) -> Callable[[Row], Row]:
    try:
        import onnxruntime
    except ImportError:
        raise Refused("onnxruntime is not installed: pip install onnxruntime, or take runtime='numpy'") from None
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    try:
        session = onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
    except Exception as error:
        raise Refused(f"{path}: onnxruntime cannot read it: {error}") from None
    name = session.get_inputs()[0].name
    return lambda row: np.asarray(session.run(None, {name: row[None]})[0][0], np.float32)


class _Program:
    """The steps of an ONNX file, for numpy."""

    def __init__(self, path: Path, content: bytes) -> None:
        try:
            graph = _field(_fields(content), 7)
            parts = list(_fields(graph))
            self._constants = dict(
                _tensor(value) for number, value in parts if number == 5 and isinstance(value, bytes)
            )
            self._nodes = [_node(value) for number, value in parts if number == 1 and isinstance(value, bytes)]
            self._input = _field(_fields(_field(parts, 11)), 1).decode()
            self._output = _field(_fields(_field(parts, 12)), 1).decode()
        except (ValueError, IndexError, UnicodeDecodeError) as error:
            raise Refused(f"{path}: is no ONNX file of a policy ({error}); copy it again") from None
        unknown = [kind for kind, _, _ in self._nodes if kind not in _OPERATORS]
        if unknown:
            raise Refused(f"{path}: has the operator {unknown[0]}, which runtime='onnxruntime' computes")

    def __call__(self, row: Row) -> Row:
        values: dict[str, Row] = {**self._constants, self._input: row}
        for kind, inputs, output in self._nodes:
            values[output] = _OPERATORS[kind](*(values[name] for name in inputs))
        return values[self._output]


def _dense(x: Row, weights: Row, bias: Row) -> Row:
    # add.accumulate adds in order, in 32 bits.
    products = np.concatenate([bias[None], weights * x[:, None]])
    return np.asarray(np.add.accumulate(products, axis=0, dtype=np.float32)[-1])


def _library(name: str, otherwise: Callable[[float], float]) -> Callable[[Row], Row]:
    """The function `name` of the C library for each number of a row; without it `otherwise`, rounded to 32 bits, which
    may differ in the last bit."""
    library = ctypes.util.find_library("m") or ctypes.util.find_library("c")
    try:
        function: Any = getattr(ctypes.CDLL(library), name) if library else None
    except (OSError, AttributeError):
        function = None
    if function is None:
        function = otherwise
    else:
        function.restype, function.argtypes = ctypes.c_float, [ctypes.c_float]
    return lambda x: np.array([function(number) for number in x.tolist()], np.float32)


_TANH, _EXPM1 = _library("tanhf", math.tanh), _library("expm1f", math.expm1)
#: Of the exponent's overflow, beyond 88.7 in 32 bits, nothing else has to be known: 1 / (1 + inf) is 0.
_EXP = _library("expf", lambda x: math.exp(x) if x < 700.0 else math.inf)


def _elu(x: Row) -> Row:
    return np.where(x < 0.0, _EXPM1(np.minimum(x, np.float32(0.0))), x)


def _sigmoid(x: Row) -> Row:
    one = np.float32(1.0)
    with np.errstate(over="ignore"):
        return np.asarray(one / (one + _EXP(-x)))


_OPERATORS: dict[str, Callable[..., Row]] = {
    "Add": lambda a, b: a + b,
    "Sub": lambda a, b: a - b,
    "Mul": lambda a, b: a * b,
    "Div": lambda a, b: a / b,
    "Max": np.maximum,
    "Min": np.minimum,
    "Clip": lambda x, low, high: np.minimum(np.maximum(x, low), high),
    "Gemm": _dense,
    "Elu": _elu,
    "Relu": lambda x: np.where(x < 0.0, np.float32(0.0), x),
    "Sigmoid": _sigmoid,
    "Tanh": _TANH,
    "Identity": lambda x: x,
}


def _fields(message: bytes) -> Iterator[tuple[int, int | bytes]]:
    """Number and value of each field of a protobuf message."""
    at = 0
    while at < len(message):
        key, at = _varint(message, at)
        number, wire = key >> 3, key & 7
        if wire == 0:
            value, at = _varint(message, at)
            yield number, value
            continue
        if wire == 2:
            size, at = _varint(message, at)
        elif wire in (1, 5):
            size = 8 if wire == 1 else 4
        else:
            raise ValueError(f"wire type {wire}")
        if at + size > len(message):
            raise ValueError("it is cut off")
        yield number, message[at : at + size]
        at += size


def _varint(message: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = message[at]
        value |= (byte & 127) << shift
        at, shift = at + 1, shift + 7
        if byte < 128:
            return value, at


def _field(fields: Iterable[tuple[int, int | bytes]], number: int) -> bytes:
    found = next((value for own, value in fields if own == number), None)
    if not isinstance(found, bytes):
        raise ValueError(f"field {number} is missing")
    return found


def _tensor(message: bytes) -> tuple[str, Row]:
    """Name and numbers of a TensorProto: dims 1, data_type 2, name 8, raw_data 9."""
    fields = list(_fields(message))
    dims: list[int] = []
    for value in (value for number, value in fields if number == 1):
        if isinstance(value, int):
            dims.append(value)
            continue
        at = 0
        while at < len(value):  # packed
            size, at = _varint(value, at)
            dims.append(size)
    if (2, _FLOAT) not in fields:
        raise ValueError("a tensor is not of 32-bit floats")
    numbers = np.frombuffer(_field(fields, 9), "<f4").astype(np.float32)
    return _field(fields, 8).decode(), numbers.reshape(dims or [1])


def _node(message: bytes) -> tuple[str, list[str], str]:
    """Operator, inputs and output of a NodeProto: input 1, output 2, op_type 4, attribute 5."""
    fields = list(_fields(message))
    kind = _field(fields, 4).decode()
    if any(number == 5 for number, _ in fields):
        raise ValueError(f"{kind} has attributes, which runtime='onnxruntime' knows")
    inputs = [value.decode() for number, value in fields if number == 1 and isinstance(value, bytes)]
    return kind, inputs, _field(fields, 2).decode()
