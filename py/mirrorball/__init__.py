"""Vision and localization of soccer robots with an omnidirectional mirror: optics, mirror design, simulation, logs."""

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
from mirrorball.simulation import Run, simulate

__all__ = [
    "Camera",
    "ColourTable",
    "Field",
    "GroundMap",
    "Mount",
    "Profile",
    "Run",
    "__version__",
    "ground_map",
    "render",
    "simulate",
    "trace_points",
    "trace_rays",
]
