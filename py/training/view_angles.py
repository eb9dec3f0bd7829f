"""Where does the image show a direction? The same table as crates/vision/src/objects/view_angles.rs."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

AZIMUTHS = 360
ANGLES = np.radians(np.arange(10.0, 112.0, 0.5))
EXTRAPOLATION_ENTRIES = 20
ENTRIES_MIN = 10
RAY_STEP_PX = 0.5
BALL_RADIUS = 0.11

Floats = NDArray[np.float64]


@dataclass
class ViewAngles:
    """Image radius by azimuth (image right towards up) and view angle (from straight down at the viewpoint)."""

    x_m: Floats
    y_m: Floats
    centre_px: tuple[float, float]
    rim_px: float
    height_m: float
    radius_px: Floats = field(init=False)

    def __post_init__(self) -> None:
        """Inverts the ground map along each azimuth."""
        ranges = np.hypot(self.x_m, self.y_m)
        self.radius_px = np.stack([self._radii(ranges, 2 * np.pi * index / AZIMUTHS) for index in range(AZIMUTHS)])

    def _radii(self, ranges: Floats, azimuth: float) -> Floats:
        height, width = ranges.shape
        radius = np.arange(int(np.hypot(width, height) / RAY_STEP_PX)) * RAY_STEP_PX
        u = np.round(self.centre_px[0] + radius * np.cos(azimuth)).astype(int)
        v = np.round(self.centre_px[1] - radius * np.sin(azimuth)).astype(int)
        inside = (u >= 0) & (v >= 0) & (u < width) & (v < height)
        radius, ground = radius[inside], ranges[v[inside], u[inside]]
        known = np.isfinite(ground)
        if known.sum() < ENTRIES_MIN:
            return np.full(len(ANGLES), np.nan)
        angles = np.maximum.accumulate(np.arctan2(ground[known], self.height_m))
        radii = np.interp(ANGLES, angles, radius[known], left=np.nan, right=np.nan)
        entries = np.flatnonzero(np.isfinite(radii))
        if len(entries) < ENTRIES_MIN:
            return np.full(len(ANGLES), np.nan)
        last = entries[-1]
        first = max(entries[0], last - EXTRAPOLATION_ENTRIES)
        slope = (radii[last] - radii[first]) / (last - first)
        radii[last + 1 :] = radii[last] + slope * np.arange(1, len(ANGLES) - last)
        return radii

    def radii_of(self, view_angle: Floats, azimuth: Floats) -> Floats:
        """Image radius of directions, pixels; NaN where unknown."""
        view_angle, azimuth = np.broadcast_arrays(view_angle, azimuth)
        place = np.clip((view_angle - ANGLES[0]) / (ANGLES[1] - ANGLES[0]), 0, len(ANGLES) - 1.001)
        lower = place.astype(int)
        part = place - lower
        turns = (azimuth / (2 * np.pi) % 1) * AZIMUTHS
        before = turns.astype(int) % AZIMUTHS
        after = (before + 1) % AZIMUTHS
        across = turns - np.floor(turns)
        table = self.radius_px
        near = table[before, lower] * (1 - part) + table[before, lower + 1] * part
        far = table[after, lower] * (1 - part) + table[after, lower + 1] * part
        return near * (1 - across) + far * across

    def positions(self, view_angle: Floats, azimuth: Floats) -> tuple[Floats, Floats]:
        """Columns and rows of directions, pixels."""
        radius = self.radii_of(view_angle, azimuth)
        return self.centre_px[0] + radius * np.cos(azimuth), self.centre_px[1] - radius * np.sin(azimuth)

    def angle_at(self, radius_px: float, azimuth: float) -> float:
        """View angle of an image position given by its radius and azimuth, radians."""
        column = self.radius_px[int(azimuth / (2 * np.pi) % 1 * AZIMUTHS)]
        known = np.isfinite(column)
        return float(np.interp(radius_px, column[known], ANGLES[known]))

    def ball_angles(self, range_m: Floats) -> tuple[Floats, Floats, Floats]:
        """View angle of a ball's centre on the ground, and half its extent in view angle and azimuth, radians."""
        centre = self.height_m - BALL_RADIUS
        slant = np.hypot(range_m, centre)
        return np.arctan2(range_m, centre), np.arcsin(BALL_RADIUS / slant), np.arcsin(np.minimum(0.95, BALL_RADIUS / range_m))
