"""Parts in closed form: conic sections and straight lines, solved for the height Y(t) at which a camera ray meets them.

Every closed part ends where its caller says: at a slope t, at a radius, or where its ray meets the ground.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import scipy

from mirrorball.mirror.reflection import Array, reflect
from mirrorball.mirror.segment import Segment, Start

MAX_RAY_SLOPE = 3.0
"""A ray 72° off the axis; no lens that looks into a mirror sees further."""


@dataclass(frozen=True)
class EndCondition:
    """Where a closed part ends; exactly one of the three."""

    t: float | None = None
    ground_m: float | None = None
    radius_m: float | None = None


class Shape(Protocol):
    """Y(t) (NaN where the ray misses) and Y′(t, Y). A class, not two functions, so that a mirror can be pickled."""

    def height(self, t: Array) -> Array:
        """Y(t)."""
        ...

    def tangent(self, t: Array, y: Array) -> Array:
        """Y′(t, Y)."""
        ...


@dataclass(frozen=True)
class Straight:
    """A cone, or with slope 0 a plane, from where the part begins."""

    start: Start
    slope: float

    def height(self, t: Array) -> Array:
        """Y(t)."""
        facing = 1.0 - self.slope * t
        with np.errstate(divide="ignore"):
            y = (self.start.y_m - self.slope * self.start.x_m) / facing
        return np.where(facing > 0.0, y, np.nan)

    def tangent(self, t: Array, _y: Array) -> Array:
        """The slope."""
        return np.full_like(t, self.slope)


@dataclass(frozen=True, kw_only=True)
class Parabola:
    """Y = Y₀ + s·(X − X₀) + k/2·(X − X₀)²: the tangent changes evenly with the radius (lima2001 2.3)."""

    x_m: float
    y_m: float
    slope: float
    curve_per_m: float

    def height(self, t: Array) -> Array:
        """Y(t)."""
        square = self.curve_per_m * t**2 / 2.0
        linear = self.slope * t - self.curve_per_m * self.x_m * t - 1.0
        constant = self.y_m - self.slope * self.x_m + self.curve_per_m * self.x_m**2 / 2.0
        with np.errstate(invalid="ignore"):
            root = np.sqrt(linear**2 - 4.0 * square * constant)
        y = 2.0 * constant / (root - linear)
        return np.where(1.0 - t * (self.slope + self.curve_per_m * (t * y - self.x_m)) > 0.0, y, np.nan)

    def tangent(self, t: Array, y: Array) -> Array:
        """Y′(t, Y)."""
        return self.slope + self.curve_per_m * (t * y - self.x_m)


@dataclass(frozen=True)
class Circle:
    """The lower side of a sphere about the axis, through the point where the part begins."""

    start: Start
    radius_m: float

    @property
    def centre(self) -> float:
        """Of the sphere, above the pinhole."""
        return float(self.start.y_m + np.sqrt(self.radius_m**2 - self.start.x_m**2))

    def height(self, t: Array) -> Array:
        """Y(t)."""
        bend = 1.0 + t**2
        with np.errstate(invalid="ignore"):
            root = np.sqrt(self.centre**2 - bend * (self.centre**2 - self.radius_m**2))
        return np.asarray((self.centre - root) / bend)

    def tangent(self, t: Array, y: Array) -> Array:
        """Y′(t, Y)."""
        return t * y / (self.centre - y)


@dataclass(frozen=True)
class Hyperbola:
    """The far sheet of a hyperboloid whose second focus is the pinhole: r = a·(e² − 1)/(e·cos β − 1)."""

    start: Start
    eccentricity: float

    @property
    def parameter(self) -> float:
        """a·(e² − 1), so that the sheet passes where the part begins."""
        start = self.start
        return float(np.hypot(start.x_m, start.y_m) * (self.eccentricity / np.hypot(1.0, start.t) - 1.0))

    def height(self, t: Array) -> Array:
        """Y(t)."""
        facing = self.eccentricity - np.sqrt(1.0 + t**2)
        with np.errstate(divide="ignore"):
            y = self.parameter / facing
        return np.where(facing > 0.0, y, np.nan)

    def tangent(self, t: Array, y: Array) -> Array:
        """Both foci lie on the axis, 2c apart; the tangent halves the angle between the two focal rays."""
        foci_apart = 2.0 * self.eccentricity * self.parameter / (self.eccentricity**2 - 1.0)
        gamma = np.arctan2(t * y, foci_apart - y)
        return np.asarray(np.tan((gamma - np.arctan(t)) / 2.0))


def close(
    shape: Shape, start: Start, *, until: EndCondition, part: str, tangent_continuous: bool, reflects: bool = True
) -> Segment:
    """Finds where the part ends and makes it a segment; ValueError if it never gets there."""
    t_to = _solve_end_slope(shape, start, until=until, part=part)
    if not start.t < t_to:
        raise start.refuse(part, f"ends at t = {t_to:.4f}, where it should begin or earlier", start.t)
    if t_to > start.t_max:
        raise start.refuse(part, f"the lens sees no further than t = {start.t_max:.4f}", t_to)
    t = np.linspace(start.t, t_to, 257)
    missed = ~np.isfinite(shape.height(t))
    if missed.any():
        raise start.refuse(part, "the ray misses the mirror: the shape bends away from it", float(t[missed][0]))
    return Segment(
        part=part,
        number=start.number,
        t_from=start.t,
        t_to=t_to,
        height=shape.height,
        tangent=shape.tangent,
        tangent_continuous=tangent_continuous,
        reflects=reflects,
    )


def _solve_end_slope(shape: Shape, start: Start, *, until: EndCondition, part: str) -> float:
    given = [value for value in (until.t, until.ground_m, until.radius_m) if value is not None]
    if len(given) != 1:
        raise start.refuse(part, "say where it ends by exactly one of until_t, until_ground, until_radius (Python: with _m)")
    if until.t is not None:
        return until.t

    def reached(t: Array) -> Array:
        y = shape.height(t)
        if until.ground_m is None:
            return t * y
        rays = reflect(t=t, y_m=y, slope=shape.tangent(t, y), pinhole_height_m=start.pinhole_height_m)
        return rays.distance_at_m(0.0)

    wanted, what = (until.ground_m, "the ground at") if until.ground_m is not None else (until.radius_m or 0.0, "the radius")
    t = np.linspace(start.t, min(start.t_max, MAX_RAY_SLOPE), 2001)
    found = reached(t)
    met = np.isfinite(found)
    crossings = np.flatnonzero(met[:-1] & met[1:] & ((found[:-1] - wanted) * (found[1:] - wanted) <= 0.0))
    if crossings.size == 0:
        seen = f"{np.nanmin(found):.4f} to {np.nanmax(found):.4f} m" if met.any() else "nothing"
        why = f"never reaches {what} {wanted:.4f} m: up to t = {t[-1]:.4f} it covers {seen}"
        raise start.refuse(part, why)
    first = int(crossings[0])
    return float(scipy.optimize.brentq(lambda t: float(reached(np.array([t]))[0]) - wanted, t[first], t[first + 1], xtol=1e-15))
