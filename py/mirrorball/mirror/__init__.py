"""Mirrors: design them from parts or wishes, judge them, hand them to the workshop.

>>> from mirrorball.mirror import HorizontallyIsometric, design, report
>>> mirror = design([HorizontallyIsometric(until_t=0.3, until_m=6.0)], pinhole_height_m=0.6, apex_above_pinhole_m=0.2)
>>> report(mirror, folder="out/my_mirror")  # doctest: +SKIP
"""

from mirrorball.mirror.building import Mirror, design
from mirrorball.mirror.files import Plan, load
from mirrorball.mirror.heights import HeightsSeen, heights_seen
from mirrorball.mirror.judging import Judgement, Lens, Sizes, View, judge
from mirrorball.mirror.law import Rays, reflect, slope_towards
from mirrorball.mirror.parts import (
    Cone,
    ConstantCurvature,
    Free,
    HorizontallyIsometric,
    Hyperboloid,
    Paraboloid,
    Part,
    Planar,
    Sphere,
    VerticallyIsometric,
)
from mirrorball.mirror.readymade import READYMADE, lima2001, minho_like, nubot2013, sphere_cone_1999
from mirrorball.mirror.reporting import Report, camera_for, report
from mirrorball.mirror.segment import Segment
from mirrorball.mirror.tolerances import GroundErrors, Tolerances, monte_carlo
from mirrorball.mirror.viewing import portrait, view
from mirrorball.mirror.wishes import (
    Heights,
    MaxDiameter,
    MinCurvatureRadius,
    Optimised,
    Resolution,
    Wish,
    optimise,
)
from mirrorball.mirror.workshop import Export, read_dxf, read_stl, write_csv, write_dxf, write_step, write_stl

__all__ = [
    "READYMADE",
    "Cone",
    "ConstantCurvature",
    "Export",
    "Free",
    "GroundErrors",
    "Heights",
    "HeightsSeen",
    "HorizontallyIsometric",
    "Hyperboloid",
    "Judgement",
    "Lens",
    "MaxDiameter",
    "MinCurvatureRadius",
    "Mirror",
    "Optimised",
    "Paraboloid",
    "Part",
    "Plan",
    "Planar",
    "Rays",
    "Report",
    "Resolution",
    "Segment",
    "Sizes",
    "Sphere",
    "Tolerances",
    "VerticallyIsometric",
    "View",
    "Wish",
    "camera_for",
    "design",
    "heights_seen",
    "judge",
    "lima2001",
    "load",
    "minho_like",
    "monte_carlo",
    "nubot2013",
    "optimise",
    "portrait",
    "read_dxf",
    "read_stl",
    "reflect",
    "report",
    "slope_towards",
    "sphere_cone_1999",
    "view",
    "write_csv",
    "write_dxf",
    "write_step",
    "write_stl",
]
