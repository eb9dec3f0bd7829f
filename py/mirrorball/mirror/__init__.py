"""Mirror design from parts or requirements, optical analysis, export for manufacturing.

>>> from mirrorball.mirror import HorizontallyIsometric, design, report
>>> mirror = design([HorizontallyIsometric(until_t=0.3, until_m=6.0)], pinhole_height_m=0.6, apex_above_pinhole_m=0.2)
>>> report(mirror, folder="out/my_mirror")  # doctest: +SKIP
"""

from mirrorball.mirror.cad_export import Export, read_dxf, read_stl, write_csv, write_dxf, write_step, write_stl
from mirrorball.mirror.design_file import DesignSpec, load
from mirrorball.mirror.drawing import drawing, radius_table, write_pdf
from mirrorball.mirror.ground_costs import GroundCost, ground_costs
from mirrorball.mirror.heights import VisibleHeights, visible_heights
from mirrorball.mirror.optical_analysis import Lens, ObjectSizes, OpticalAnalysis, View, judge
from mirrorball.mirror.papers import PaperFigure, compare_with_papers
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
from mirrorball.mirror.preview import Preview, plot_preview, preview
from mirrorball.mirror.profile_design import Mirror, design
from mirrorball.mirror.reference_designs import REFERENCE_DESIGNS, lima2001, minho_like, nubot2013, sphere_cone_1999
from mirrorball.mirror.reflection import Rays, reflect, slope_to_point
from mirrorball.mirror.rendering import plot_profile_and_image, view
from mirrorball.mirror.reporting import Report, fit_camera, report
from mirrorball.mirror.requirements import (
    Heights,
    MaxDiameter,
    MinCurvatureRadius,
    OptimisationResult,
    Requirement,
    Resolution,
    optimise,
)
from mirrorball.mirror.segment import Segment
from mirrorball.mirror.tolerances import GroundErrors, Tolerances, monte_carlo

__all__ = [
    "REFERENCE_DESIGNS",
    "Cone",
    "ConstantCurvature",
    "DesignSpec",
    "Export",
    "Free",
    "GroundCost",
    "GroundErrors",
    "Heights",
    "HorizontallyIsometric",
    "Hyperboloid",
    "Lens",
    "MaxDiameter",
    "MinCurvatureRadius",
    "Mirror",
    "ObjectSizes",
    "OpticalAnalysis",
    "OptimisationResult",
    "PaperFigure",
    "Paraboloid",
    "Part",
    "Planar",
    "Preview",
    "Rays",
    "Report",
    "Requirement",
    "Resolution",
    "Segment",
    "Sphere",
    "Tolerances",
    "VerticallyIsometric",
    "View",
    "VisibleHeights",
    "compare_with_papers",
    "design",
    "drawing",
    "fit_camera",
    "ground_costs",
    "judge",
    "lima2001",
    "load",
    "minho_like",
    "monte_carlo",
    "nubot2013",
    "optimise",
    "plot_preview",
    "plot_profile_and_image",
    "preview",
    "radius_table",
    "read_dxf",
    "read_stl",
    "reflect",
    "report",
    "slope_to_point",
    "sphere_cone_1999",
    "view",
    "visible_heights",
    "write_csv",
    "write_dxf",
    "write_pdf",
    "write_step",
    "write_stl",
]


def __dir__() -> list[str]:
    return __all__
