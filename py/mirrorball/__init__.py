"""Mirrorball in Python: mirrors for soccer robots, designed, judged and drawn; the optics are the robot's own."""

from mirrorball._core import (
    Camera,
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
