"""Vision and localization of soccer robots with an omnidirectional mirror: optics, mirror design, simulation, logs."""

import importlib
from types import ModuleType

# Inside the executable the compiled half is there before this package; only this makes it an attribute.
from mirrorball import _core as _core
from mirrorball._core import (
    Camera,
    ColourTable,
    Field,
    GroundMap,
    Mount,
    Profile,
    __version__,
    ground_map,
    render,
    trace_points,
    trace_rays,
)
from mirrorball.estimates import Cycle, Estimate, Pose
from mirrorball.log import Log
from mirrorball.pipeline import Localizer, Pipeline
from mirrorball.simulation import Run, Simulation, simulate

__all__ = [
    "Camera",
    "ColourTable",
    "Cycle",
    "Estimate",
    "Field",
    "GroundMap",
    "Localizer",
    "Log",
    "Mount",
    "Pipeline",
    "Pose",
    "Profile",
    "Run",
    "Simulation",
    "__version__",
    "ground_map",
    "render",
    "simulate",
    "trace_points",
    "trace_rays",
]

_MODULES = (
    "analysis",
    "bags",
    "estimates",
    "evaluation",
    "gym",
    "log",
    "mirror",
    "pipeline",
    "samples",
    "simulation",
    "sweep",
    "vision",
)
"""Modules that are imported when they are first used: some need packages that are not installed everywhere."""


def __getattr__(name: str) -> ModuleType:
    if name in _MODULES:
        return importlib.import_module(f"mirrorball.{name}")
    raise AttributeError(f"module 'mirrorball' has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*__all__, *_MODULES]
