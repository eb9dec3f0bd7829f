"""Tasks that a sweep's processes can import."""

import os
import time
from pathlib import Path
from typing import Any


def square(task: dict[str, Any]) -> dict[str, float]:
    """Squares a number and leaves a trace of having been called."""
    with Path(task["trace"]).open("a") as file:
        file.write(f"{task['value']}\n")
    return {"value": task["value"], "square": task["value"] ** 2}


def fragile(task: dict[str, Any]) -> dict[str, float]:
    """Fails at the first call."""
    marker = Path(task["trace"])
    if not marker.exists():
        marker.write_text("once\n")
        raise OSError("the disk hiccuped")
    return {"value": 1.0}


def hopeless(task: dict[str, Any]) -> dict[str, float]:
    """Refuses its task."""
    raise ValueError(f"no mirror for {task['value']}")


def deadly(task: dict[str, Any]) -> dict[str, float]:
    """Ends its process for negative numbers, as a lack of memory would."""
    row = square(task)
    if task["value"] < 0.0:
        os._exit(3)
    return row


def deadly_once(task: dict[str, Any]) -> dict[str, float]:
    """Ends its process at the first call."""
    marker = Path(task["trace"])
    if not marker.exists():
        marker.write_text("once\n")
        os._exit(3)
    return {"value": 1.0}


def bare(task: Any) -> Any:
    """Returns its task, which is no row."""
    return task


def slow_square(value: float) -> dict[str, float]:
    """Squares a number within a second."""
    time.sleep(1.0)
    return {"value": value**2}


def slow_cube(value: float) -> dict[str, float]:
    """Cubes a number within a second."""
    time.sleep(1.0)
    return {"value": value**3}
