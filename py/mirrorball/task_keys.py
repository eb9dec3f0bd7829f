"""Is a task, or a function, one of an earlier sweep? Keys follow from the content alone, not from how an object was made."""

from __future__ import annotations

import copyreg
import hashlib
import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import BuiltinFunctionType, FunctionType
from typing import Any

import numpy as np

from mirrorball.arguments import invalid
from mirrorball.simulation import Run

__all__ = ["function_name", "task_key"]


def task_key(task: Any) -> str:
    """Identifies a task: a run by its key, plain data as JSON, other objects by what pickle stores of them.

    Lists, tuples and numpy's arrays of equal entries are the same. So are dictionaries and sets in any order.
    TypeError for an object that cannot be pickled.
    """
    return task.key if isinstance(task, Run) else _digest(task)


def function_name(function: Callable[..., Any]) -> str:
    """Identifies a function: its module and name. Of `functools.partial` and other objects, the class and a digest.

    ValueError for a function without a name in its module.
    """
    if isinstance(function, type | FunctionType | BuiltinFunctionType):
        return _qualified_name(function)
    return f"{_qualified_name(type(function))} {_digest(function)}"


def _digest(value: Any) -> str:
    return hashlib.sha256(_text(value).encode()).hexdigest()[:24]


def _text(value: Any) -> str:
    return json.dumps(_canonical(value))


def _canonical(value: Any) -> Any:
    """A value in JSON's types. Everything but plain data is an object with one key, which says what it is."""
    # Exact types: a subclass may behave differently with equal content.
    kind = type(value)
    if value is None or kind in (bool, int, float, str):
        return value
    if isinstance(value, np.ndarray | np.generic):
        return _canonical(value.tolist())
    if kind in (list, tuple):
        return [_canonical(entry) for entry in value]
    if kind is dict:
        return {"dict": sorted(([_canonical(key), _canonical(entry)] for key, entry in value.items()), key=json.dumps)}
    if kind in (set, frozenset):
        return {"set": sorted((_canonical(entry) for entry in value), key=json.dumps)}
    if kind is bytes:
        return {"bytes": value.hex()}
    if isinstance(value, type | FunctionType | BuiltinFunctionType):
        return {"name": _qualified_name(value)}
    return {"object": _pickled_parts(value)}


def _pickled_parts(value: Any) -> list[Any]:
    """What pickle stores of an object: how it is made, and its state."""
    reduce = copyreg.dispatch_table.get(type(value))
    parts = reduce(value) if reduce else value.__reduce_ex__(2)
    if isinstance(parts, str):
        return [_qualified_name(type(value)), parts]
    return [_canonical(list(part) if isinstance(part, Iterator) else part) for part in parts]


def _qualified_name(function: Callable[..., Any]) -> str:
    module, name = function.__module__, function.__qualname__
    if "<" in name:
        raise ValueError(invalid("function", function, "one that a module defines under a name"))
    # Scripts are all called __main__, and have another name where they are imported.
    file = getattr(sys.modules["__main__"], "__file__", None) if module == "__main__" else None
    return f"{Path(file).stem if file else module}.{name}"
