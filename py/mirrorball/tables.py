"""Columns of numbers and texts as structured arrays."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["Table", "structured_array"]

Table = NDArray[np.void]
"""One row per entry, with named fields."""


def structured_array(columns: Mapping[str, Any]) -> Table:
    """The columns as one array with a field for each."""
    arrays = {name: np.asarray(values, dtype=_column_dtype(values)) for name, values in columns.items()}
    rows = len(next(iter(arrays.values())))
    table = np.empty(rows, dtype=[(name, array.dtype) for name, array in arrays.items()])
    for name, array in arrays.items():
        table[name] = array
    return table


def _column_dtype(values: Any) -> Any:
    # numpy takes an empty list of texts for numbers.
    return None if isinstance(values, np.ndarray) else f"<U{max([1, *map(len, values)])}"
