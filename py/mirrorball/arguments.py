"""Is each argument what its annotation says? One message for all functions: the name, the value, what is expected.

The compiled half checks its arguments itself, with the same words.
"""

from __future__ import annotations

import functools
import inspect
import math
import types
import typing
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from numbers import Integral, Real
from os import PathLike
from pathlib import Path
from typing import Any, Literal, TypeVar, Union

import numpy as np
from numpy.typing import NDArray

__all__ = ["Number", "Vector", "Whole", "checked", "invalid", "plain", "require_at_least", "require_columns"]

Number = float | np.floating[Any] | np.integer[Any]
"""Python's numbers and numpy's."""

Whole = int | np.integer[Any]

Vector = Sequence[Number] | NDArray[np.floating[Any] | np.integer[Any]]
"""Two or three numbers."""

Function = TypeVar("Function", bound=Callable[..., Any])

SHOWN_MAX = 80
"""Characters of a value that an error shows."""


def checked(function: Function) -> Function:
    """Refuses arguments that are not what their annotations say, and numbers that are not finite.

    TypeError for another type, ValueError for another value of the right type. Of a class, the constructor is checked.
    """
    if isinstance(function, type):
        function.__init__ = checked(function.__init__)  # type: ignore[misc]
        return function
    signature = inspect.signature(function)

    @functools.cache
    def hints() -> dict[str, Any]:
        # What a function returns need not be imported when it runs.
        taken = {name: hint for name, hint in inspect.get_annotations(function).items() if name != "return"}
        scope = getattr(function, "__globals__", {})
        return {name: eval(hint, scope) if isinstance(hint, str) else hint for name, hint in taken.items()}

    @functools.wraps(function)
    def call(*positional: Any, **keywords: Any) -> Any:
        for name, value in signature.bind(*positional, **keywords).arguments.items():
            if name in hints():
                _check(name, value, hints()[name])
        return function(*positional, **keywords)

    return typing.cast(Function, call)


def invalid(name: str, value: Any, expected: str) -> str:
    """The message about an argument."""
    if isinstance(value, np.ndarray):
        shown = f"{value.dtype} array of shape {list(value.shape)}"
    else:
        shown = " ".join(repr(value).split())
        shown = shown if len(shown) <= SHOWN_MAX else shown[:SHOWN_MAX] + "…"
    return f"invalid {name}: {shown} (expected {expected})"


def plain(value: Any) -> Any:
    """Python's own numbers and lists in place of numpy's, also inside of lists, tuples and mappings."""
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, Mapping):
        return {key: plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    return value


def require_at_least(name: str, value: float, least: float) -> None:
    """Raises ValueError for less."""
    if value < least:
        raise ValueError(invalid(name, value, f"at least {least}"))


def require_columns(name: str, table: Any, columns: Iterable[str]) -> None:
    """Raises ValueError if a table lacks one of the columns."""
    missing = [column for column in columns if column not in table.columns]
    if missing:
        raise ValueError(f"invalid {name}: no column {', '.join(missing)} (expected a table of mirrorball.analysis.cycles)")


def _check(name: str, value: Any, hint: Any) -> None:
    fits = [_fit(value, choice) for choice in _choices(hint)]
    if True in fits:
        return
    # None: the type is right, the value is not.
    error = ValueError if None in fits else TypeError
    expected = dict.fromkeys(_words(choice) for choice in _choices(hint) if choice is not type(None))
    if "a finite number" in expected:
        # Numpy's types of a number; each whole one is finite.
        expected.pop("a whole number", None)
    raise error(invalid(name, value, " or ".join(expected)))


def _choices(hint: Any) -> tuple[Any, ...]:
    if typing.get_origin(hint) in (Union, types.UnionType):
        return tuple(choice for part in typing.get_args(hint) for choice in _choices(part))
    return (hint,)


def _fit(value: Any, hint: Any) -> bool | None:
    """True: it fits. False: another type. None: the type fits, the value does not."""
    origin, inner = typing.get_origin(hint) or hint, typing.get_args(hint)
    if origin is Any or isinstance(origin, TypeVar):
        return True
    if origin is Literal:
        return (True if value in inner else None) if isinstance(value, str) else False
    if origin in (float, np.floating):
        return (True if math.isfinite(value) else None) if isinstance(value, Real) else False
    if origin in (int, np.integer):
        return isinstance(value, Integral) and not isinstance(value, bool)
    if origin is bool:
        return isinstance(value, bool | np.bool_)
    if origin is np.ndarray:
        return _fit_array(value, inner)
    if origin is tuple and not hasattr(hint, "_fields"):
        return _fit_tuple(value, inner)
    if origin is Callable:
        return callable(value)
    if not isinstance(value, origin) or (isinstance(value, str) and issubclass(str, origin) and origin is not str):
        return False
    if inner and isinstance(value, Collection) and not isinstance(value, Mapping):
        return _all_fit(value, inner[0])
    return True


def _fit_array(value: Any, inner: tuple[Any, ...]) -> bool | None:
    try:
        array = np.asarray(value)
    except ValueError:
        return None
    # Of NDArray[np.float64], the second argument is dtype[np.float64].
    element = typing.get_args(inner[1])[0] if len(inner) == 2 and typing.get_args(inner[1]) else Any
    if element is np.uint8:
        return isinstance(value, np.ndarray) and (value.dtype == np.uint8 or None)
    return (array.ndim > 0 and array.dtype.kind in "biufV") or (None if isinstance(value, np.ndarray) else False)


def _fit_tuple(value: Any, inner: tuple[Any, ...]) -> bool | None:
    """A fixed number of entries is also taken from a list or an array."""
    if isinstance(value, str) or not isinstance(value, Collection):
        return False
    if len(inner) == 2 and inner[1] is Ellipsis:
        return _all_fit(value, inner[0])
    if len(value) != len(inner):
        return None
    fits = [_fit(entry, hint) for entry, hint in zip(value, inner, strict=True)]
    return None if None in fits else all(fits)


def _all_fit(values: Iterable[Any], hint: Any) -> bool | None:
    fits = [any(_fit(value, choice) for choice in _choices(hint)) for value in values]
    return all(fits) or None


def _words(hint: Any) -> str:
    """What a type is to a reader."""
    origin, inner = typing.get_origin(hint) or hint, typing.get_args(hint)
    simple = {float: "a finite number", np.floating: "a finite number", int: "a whole number", np.integer: "a whole number",
              bool: "True or False", str: "a text", Path: "a path", PathLike: "a path", Callable: "a function"}  # fmt: skip
    if origin in simple:
        return simple[origin]
    if origin is Literal:
        return ", ".join(repr(choice) for choice in inner)
    if origin is np.ndarray:
        return "an array of bytes" if "uint8" in str(hint) else "an array of numbers"
    if origin is tuple and inner and inner[-1] is not Ellipsis:
        return f"{len(inner)} entries, each {' or '.join(dict.fromkeys(map(_words, inner)))}"
    name = f"{'mirrorball.' if origin.__module__.startswith('mirrorball') else ''}{origin.__name__}"
    if inner and not issubclass(origin, Mapping):
        return f"several, each {' or '.join(_words(choice) for choice in _choices(inner[0]))}"
    return f"a {name}"
