"""Refuses wrong arguments with one line: the argument, what was expected, and what was given.

`checked` compares the arguments of a public function with its annotations. Values that the native module cannot
convert, such as a number that is too large, it refuses in the same way.
"""

from __future__ import annotations

import functools
import inspect
import re
import types
import typing
from collections.abc import Callable, Iterable, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, Union

import numpy as np
import numpy.typing as npt

from .errors import InvalidRequest, WrongType

P = ParamSpec("P")
R = TypeVar("R")
Scalar = TypeVar("Scalar", np.float32, np.float64)

#: Longest text of a value in a message: our choice, so that the message stays one line of a terminal.
SHOWN = 60

#: What messages call a type, and the values that it accepts. numpy's numbers are accepted as Python's are.
_TYPES: dict[Any, tuple[str, Callable[[Any], bool]]] = {
    bool: ("True or False", lambda value: isinstance(value, (bool, np.bool_))),
    int: ("a whole number", lambda value: hasattr(value, "__index__") and not isinstance(value, (bool, np.bool_))),
    float: ("a number", lambda value: _is_number(value)),
    str: ("a text", lambda value: isinstance(value, str)),
    bytes: ("bytes", lambda value: isinstance(value, bytes)),
    PathLike: ("a path", lambda value: isinstance(value, PathLike)),
    Path: ("a path", lambda value: isinstance(value, PathLike)),
    type(None): ("None", lambda value: value is None),
}

#: Types whose entries are checked.
_LISTS = (Iterable, Sequence, list, tuple)


def checked(function: Callable[P, R]) -> Callable[P, R]:
    """The same function, which refuses arguments whose types are not those of its annotations."""
    signature = inspect.signature(function)

    @functools.cache
    def hints() -> dict[str, Any]:
        own = typing.get_type_hints(function)
        named = (p.name for p in signature.parameters.values() if p.kind is not p.VAR_KEYWORD)
        return {name: own[name] for name in named if name in own}

    @functools.wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            given = signature.bind(*args, **kwargs).arguments
        except TypeError:  # an argument is missing or has no such name: Python's own words
            return function(*args, **kwargs)
        for name, hint in hints().items():
            if name in given and not _fits(given[name], hint):
                raise WrongType(f"{name}: expected {_words(hint)}, got {shown(given[name])}")
        try:
            return function(*args, **kwargs)
        except (TypeError, OverflowError) as error:
            raise _unconverted(error, given) or error from None

    return call


def numbers(name: str, values: npt.ArrayLike, kind: type[Scalar]) -> npt.NDArray[Scalar]:
    """`values` as an array of `kind`, a copy only if necessary. Texts and complex numbers are refused."""
    try:
        array = np.asarray(values)
        if array.dtype.kind in "biufO":
            return array.astype(kind, copy=False)
    except (OverflowError, TypeError, ValueError):
        pass
    raise WrongType(f"{name}: expected numbers, got {shown(values)}")


def shown(value: Any) -> str:
    """A value in a message: one line, with its type if the line is cut."""
    text = " ".join(repr(value).split())
    return text if len(text) <= SHOWN else f"{text[:SHOWN]}… ({type(value).__name__})"


def _unconverted(error: BaseException, given: Mapping[str, Any]) -> InvalidRequest | None:
    """The refusal of a value that the native module could not convert. None for every other error."""
    notes = " ".join(getattr(error, "__notes__", ()))
    found = re.match(r"failed to extract field \w+\.(\w+)", str(error)) or re.search("while processing '(.*?)'", notes)
    if found is None:
        return None
    name, cause = found[1], error.__cause__ or error
    value = f", got {shown(given[name])}" if name in given else ""
    if not isinstance(cause, OverflowError):
        return WrongType(f"{name}: {cause}{value}")
    negative = name in given and given[name] < 0
    return InvalidRequest(f"{name}: expected {'a whole number from 0' if negative else 'a smaller number'}{value}")


def _is_number(value: Any) -> bool:
    wrong = isinstance(value, (bool, np.bool_, complex, np.complexfloating, str, bytes))
    return not wrong and (hasattr(value, "__float__") or hasattr(value, "__index__"))


def _parts(hint: Any) -> tuple[Any, tuple[Any, ...]]:
    """A type without its arguments, and these."""
    return typing.get_origin(hint) or hint, typing.get_args(hint)


def _fits(value: Any, hint: Any) -> bool:
    """Has `value` the type `hint`? For other types than these the function itself has an error with advice."""
    kind, inner = _parts(hint)
    if kind in (Union, types.UnionType):
        return any(_fits(value, one) for one in inner)
    if kind in _TYPES:
        return _TYPES[kind][1](value)
    if kind is Callable:
        return callable(value)
    if isinstance(kind, type) and issubclass(kind, Mapping):  # a DataFrame has keys, too
        return hasattr(value, "keys") and all(_fits(key, inner[0]) for key in value.keys())  # noqa: SIM118
    if kind in _LISTS:
        return _fits_list(value, kind, inner)
    return True


def _fits_list(value: Any, kind: Any, inner: tuple[Any, ...]) -> bool:
    """Can `value` be iterated, and has it such entries? A list does for a tuple, and an array for both."""
    if isinstance(value, (str, bytes, Mapping)) or not hasattr(value, "__iter__"):
        return False
    if not hasattr(value, "__len__"):
        return kind is Iterable  # a generator, which can be read only once
    if kind is tuple and Ellipsis not in inner:
        return len(value) == len(inner) and all(map(_fits, value, inner))
    return all(_fits(entry, inner[0]) for entry in value)


def _words(hint: Any) -> str:
    """What a message calls a type."""
    kind, inner = _parts(hint)
    if kind in (Union, types.UnionType):
        return " or ".join(dict.fromkeys(map(_words, inner)))
    if kind in _TYPES:
        return _TYPES[kind][0]
    if kind is Callable:
        return "a function"
    if isinstance(kind, type) and issubclass(kind, Mapping):
        return "a dictionary of names"
    if kind is tuple and Ellipsis not in inner:
        return f"({', '.join(map(_words, inner))})"
    if kind in _LISTS:
        entries = [word for word in _words(inner[0]).split(" or ") if word != "None"]
        return "a list of " + " or ".join(f"{word.removeprefix('a ')}s" for word in entries)
    return str(getattr(kind, "__name__", kind))
