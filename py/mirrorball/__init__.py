"""Mirrorball in Python: mirrors for soccer robots, designed, judged and drawn; optics and eyes are the robot's own."""

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

__all__ = [
    "Camera",
    "ColourTable",
    "Field",
    "GroundMap",
    "Mount",
    "Profile",
    "__version__",
    "ground_map",
    "render",
    "trace_points",
    "trace_rays",
]
