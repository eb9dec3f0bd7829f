"""Heights that a mirror shows at each distance, from the lowest to the highest, part by part."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mirrorball.arguments import checked, invalid
from mirrorball.mirror.optical_analysis import OpticalAnalysis
from mirrorball.mirror.reflection import Array
from mirrorball.records import Record


@dataclass(frozen=True, eq=False)
class VisibleHeights(Record):
    """What one part shows over distances, metres above the ground; NaN where it shows nothing."""

    part: str
    distance_m: Array
    lowest_m: Array
    highest_m: Array

    def shows(self, *, distance_m: float, height_m: float) -> bool:
        """True if a point is visible; distances between the sampled ones are interpolated."""
        low = float(np.interp(distance_m, self.distance_m, self.lowest_m))
        high = float(np.interp(distance_m, self.distance_m, self.highest_m))
        return low <= height_m <= high


@checked
def visible_heights(judged: OpticalAnalysis, *, distance_m: Array | None = None) -> tuple[VisibleHeights, ...]:
    """Heights from the ground up that each part's rays pass at each distance (evenly to the reach, if none are given)."""
    distance = np.linspace(0.0, judged.reach_m, 160) if distance_m is None else np.asarray(distance_m, dtype=np.float64)
    if distance.ndim != 1 or not np.isfinite(distance).all():
        raise ValueError(invalid("distance_m", distance_m, "finite numbers of shape n"))
    found = []
    for view in judged.views:
        clear = ~view.blocked
        low, high = np.full(distance.shape, np.nan), np.full(distance.shape, np.nan)
        for index, at in enumerate(distance):
            passed = view.rays.height_at_m(float(at))[clear]
            seen = passed[passed >= 0.0]
            if seen.size:
                # With rays that came down before, everything from the ground up is seen.
                low[index] = 0.0 if (passed < 0.0).any() else seen.min()
                high[index] = seen.max()
        found.append(VisibleHeights(part=view.part, distance_m=distance, lowest_m=low, highest_m=high))
    return tuple(found)
