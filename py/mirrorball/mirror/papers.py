"""What the three papers say of their mirrors, and the same of a design.

lima2001 states distances, heights and the diameter of its earlier mirror, nubot2013 the order of the parts, minho2016 how far
its camera sees. No paper publishes a profile.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mirrorball.arguments import checked
from mirrorball.mirror.heights import visible_heights
from mirrorball.mirror.optical_analysis import OpticalAnalysis, View
from mirrorball.mirror.reflection import Array

EVEN_SHARE = 0.01
"""Radial resolution is even where it varies by less than this share."""


@dataclass(frozen=True)
class PaperFigure:
    """One figure of a paper beside that of a design."""

    source: str
    """Paper and section."""
    quantity: str
    paper: str
    design: str


@checked
def compare_with_papers(judged: OpticalAnalysis) -> list[PaperFigure]:
    """The figures that the papers state, each as this design has it; a dash where it has none."""
    low, high = even_ground(judged)
    distance = np.array([11.2])
    heights = [float(seen.highest_m[0]) for seen in visible_heights(judged, distance_m=distance)]
    at_goal = max((height for height in heights if np.isfinite(height)), default=float("nan"))
    outer, inner = judged.views[-1], judged.views[0]
    several = len(judged.views) > 1
    farthest = max((_ground_end(view) for view in judged.views), default=float("nan"))
    parts = ", ".join(view.part for view in judged.views)
    outer_ground = _range_text(_finite(outer.ground_m), judged.reach_m) if several else "–"
    return [
        PaperFigure("lima2001 2.5", "ground without distortion", "0 to 6 m", f"{low:.2f} to {high:.2f} m"),
        PaperFigure("lima2001 2.5", "greatest height seen at 11.2 m", "0.60 m", _metres(at_goal)),
        PaperFigure("lima2001 2.5", "ground in the outermost part", "0.39 to 0.51 m", outer_ground),
        PaperFigure("lima2001 2.1 (1999)", "ground in the innermost part, until", "1.5 m", _metres(_ground_end(inner))),
        PaperFigure("lima2001 2.1 (1999)", "farthest ground", "6 m", _beyond(farthest, judged.reach_m)),
        PaperFigure("lima2001 2.1 (1999)", "diameter", "185 mm", f"{2e3 * judged.radius_m:.1f} mm"),
        PaperFigure(
            "nubot2013 3.1", "parts from the axis outwards", "hyperboloid, horizontally isometric, vertically isometric", parts
        ),
        PaperFigure("minho2016 II", "farthest ground", "about 4 m", _beyond(farthest, judged.reach_m)),
    ]


def even_ground(judged: OpticalAnalysis) -> tuple[float, float]:
    """The longest stretch of ground, metres, over which a part's radial resolution varies by less than `EVEN_SHARE`."""
    best = (0.0, 0.0)
    for view in judged.views:
        seen = np.isfinite(view.ground_m) & np.isfinite(view.radial_px_per_m) & (view.radial_px_per_m > 0.0)
        ground, resolution = view.ground_m[seen], view.radial_px_per_m[seen]
        order = np.argsort(ground)
        ground, resolution = ground[order], resolution[order]
        first = 0
        for last in range(ground.size):
            while np.ptp(resolution[first : last + 1]) > EVEN_SHARE * resolution[first : last + 1].max():
                first += 1
            if ground[last] - ground[first] > best[1] - best[0]:
                best = (float(ground[first]), float(ground[last]))
    return best


def _finite(values: Array) -> Array:
    return np.asarray(values[np.isfinite(values)])


def _ground_end(view: View) -> float:
    """Farthest ground of a part; infinite if its last ray rises above the horizon."""
    seen = _finite(view.ground_m)
    if seen.size == 0:
        return float("nan")
    rises = view.rays.gamma_rad.max() >= np.pi / 2.0
    return float("inf") if rises else float(seen.max())


def _beyond(distance_m: float, reach_m: float) -> str:
    return f"beyond {reach_m:.0f} m" if distance_m > reach_m else _metres(distance_m)


def _range_text(ground: Array, reach_m: float) -> str:
    if not ground.size:
        return "–"
    low, high = float(ground.min()), float(ground.max())
    return f"{low:.2f} m to {_beyond(high, reach_m)}" if high > reach_m else f"{low:.2f} to {high:.2f} m"


def _metres(value: float) -> str:
    return "to the horizon" if np.isinf(value) else f"{value:.2f} m" if np.isfinite(value) else "–"
