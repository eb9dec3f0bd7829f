"""Are two records equal? Those with arrays and tables, which answer entry by entry themselves."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

__all__ = ["Record", "equal"]


class Record:
    """A dataclass whose fields may be arrays or tables. Two are equal if all of their fields are; NaN equals NaN."""

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        return equal(vars(self), vars(other))

    __hash__ = None  # type: ignore[assignment]


def equal(one: Any, other: Any) -> bool:
    """Equal values of one type; arrays of one shape and element type."""
    if isinstance(one, np.ndarray):
        return isinstance(other, np.ndarray) and one.dtype == other.dtype and one.shape == other.shape and _arrays(one, other)
    if isinstance(one, Mapping):
        return isinstance(other, Mapping) and one.keys() == other.keys() and all(equal(one[key], other[key]) for key in one)
    if isinstance(one, tuple | list):
        return type(one) is type(other) and len(one) == len(other) and all(map(equal, one, other))
    if hasattr(one, "equals"):
        # A table of pandas.
        return bool(one.equals(other))
    if isinstance(one, float) and isinstance(other, float) and one != one:
        return other != other
    return bool(one == other)


def _arrays(one: Any, other: Any) -> bool:
    if one.dtype.names:
        return all(_arrays(one[name], other[name]) for name in one.dtype.names)
    return bool(np.array_equal(one, other, equal_nan=one.dtype.kind in "fc"))
