"""The law of reflection in the meridian plane: reflected rays, and the slope that reflects a ray to a point (docs/methods.md).

One meridian plane: the pinhole is the origin, Y points up along the axis, the ground is at Y = −H. A camera ray has the
slope t = X/Y; all lengths are metres, all arrays of one shape.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from mirrorball.records import Record

Array: TypeAlias = NDArray[np.float64]
Mask: TypeAlias = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Rays(Record):
    """Reflected rays in the meridian plane: they leave (x_m, y_m) along (sin γ, −cos γ)."""

    t: Array
    x_m: Array
    y_m: Array
    slope: Array
    gamma_rad: Array
    """Angle from straight down; beyond π/2 the ray goes up."""
    pinhole_height_m: float

    def distance_at_m(self, height_m: float) -> Array:
        """Distance from the axis where each ray passes a height above the ground; NaN where it never does."""
        drop = self.y_m + self.pinhole_height_m - height_m
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = self.x_m + drop * np.tan(self.gamma_rad)
        meets = drop * np.cos(self.gamma_rad) > 0.0
        return np.where(meets, distance, np.nan)

    def height_at_m(self, distance_m: float | Array) -> Array:
        """Height above the ground at which each ray passes a distance from the axis; NaN where it never does."""
        run = distance_m - self.x_m
        with np.errstate(divide="ignore", invalid="ignore"):
            height = self.pinhole_height_m + self.y_m - run / np.tan(self.gamma_rad)
        return np.where(run * np.sin(self.gamma_rad) > 0.0, height, np.nan)


def reflect(*, t: Array, y_m: Array, slope: Array, pinhole_height_m: float) -> Rays:
    """Law of reflection at profile points (t·Y, Y) with tangent slope Y′: γ = β + 2α (docs/methods.md 2)."""
    gamma = np.arctan(t) + 2.0 * np.arctan(slope)
    return Rays(t=t, x_m=t * y_m, y_m=y_m, slope=slope, gamma_rad=gamma, pinhole_height_m=pinhole_height_m)


def slope_to_point(*, t: Array, y_m: Array, distance_m: Array, height_m: Array, pinhole_height_m: float) -> Array:
    """Slope Y′ that sends the ray t from (t·Y, Y) through (distance, height above the ground).

    The design equation of docs/methods.md, with atan2 so that points above the mirror can be targets, too.
    """
    gamma = np.arctan2(distance_m - t * y_m, y_m + pinhole_height_m - height_m)
    return np.asarray(np.tan((gamma - np.arctan(t)) / 2.0))
