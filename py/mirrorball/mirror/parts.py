"""The parts of a mirror. Each continues from the end of the previous part.

A part that names no beginning of its own goes on with the last ray of the part before it, so the tangent is continuous. Camera
rays are named by their slope t = tan β = ρ/f (image radius over focal length).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
import scipy

from mirrorball.arguments import checked
from mirrorball.mirror.conics import MAX_RAY_SLOPE, Circle, EndCondition, Hyperbola, Parabola, Straight, close
from mirrorball.mirror.integrate import Target, integrate
from mirrorball.mirror.reflection import Array
from mirrorball.mirror.segment import Segment, Start

TANGENT_TOLERANCE = 1e-9
"""Tangents that differ by less are one."""
KNOWN_TOLERANCE = 1e-9
"""Slopes t that differ by less are one: where a part ends may be the root of an equation."""


@runtime_checkable
class Part(Protocol):
    """Anything that can go on from where the part before it ended."""

    def build(self, start: Start) -> list[Segment]:
        """Its segments, from `start` outwards."""
        ...


@dataclass(frozen=True)
class LinearTarget:
    """Distance and height that grow evenly with t."""

    t: tuple[float, float]
    """Where it begins and ends."""
    distance_m: tuple[float, float]
    height_m: tuple[float, float]

    def __call__(self, t: Array) -> tuple[Array, Array]:
        """Distance from the axis, and height above the ground."""
        share = (t - self.t[0]) / (self.t[1] - self.t[0])
        (near, far), (low, high) = self.distance_m, self.height_m
        return near + share * (far - near), low + share * (high - low)


@checked
@dataclass(frozen=True, kw_only=True)
class HorizontallyIsometric:
    """Ground distance linear in image radius, d = d₀ + η·(t − t₀) (lima2001 2.2 and eq. 1; nubot2013 3.1)."""

    until_t: float
    until_m: float
    """Ground distance at `until_t`."""
    from_m: float | None = None
    """Ground distance where it begins; None: where the part before it ended (0 at the apex)."""

    def build(self, start: Start) -> list[Segment]:
        """One segment of the design equation."""
        name = "horizontally isometric"
        begin = _previous_ground_m(start, name) if self.from_m is None else self.from_m
        if self.until_m == begin:
            why = f"until_m = {begin:g} m is the ground distance where it begins"
            raise start.refuse(name, f"{why} (expected another: its rays would all show one point)")
        target = LinearTarget((start.t, self.until_t), distance_m=(begin, self.until_m), height_m=(0.0, 0.0))
        continues = self.from_m is None
        return [integrate(target, start, until_t=self.until_t, part=name, tangent_continuous=continues)]


@checked
@dataclass(frozen=True, kw_only=True)
class VerticallyIsometric:
    """Height on a wall linear in image radius, h = h₀ + κ·(t − t₀) at one distance (nubot2013 3.1)."""

    until_t: float
    until_height_m: float
    distance_m: float | None = None
    """Of the wall; None: where the last ray before it meets the ground."""
    from_height_m: float | None = None
    """Height where it begins; None: where the last ray before it meets the wall."""

    def build(self, start: Start) -> list[Segment]:
        """One segment of the design equation."""
        name = "vertically isometric"
        if self.distance_m is None and start.t == 0.0:
            raise start.refuse(name, "needs distance_m, that of the wall: no ray before it that could say where the wall is")
        wall = _previous_ground_m(start, name) if self.distance_m is None else self.distance_m
        if self.from_height_m is not None:
            low = self.from_height_m
        else:
            low = 0.0 if self.distance_m is None else float(start.last_ray.height_at_m(wall)[0])
        if not np.isfinite(low):
            raise start.refuse(name, f"the ray before it never reaches the wall at {wall:.3f} m", start.t)
        target = LinearTarget((start.t, self.until_t), distance_m=(wall, wall), height_m=(low, self.until_height_m))
        continues = self.from_height_m is None
        return [integrate(target, start, until_t=self.until_t, part=name, tangent_continuous=continues)]


@checked
@dataclass(frozen=True, kw_only=True)
class Free:
    """Any target map: a function of t that gives (distance from the axis, height above the ground), metres."""

    target: Target
    until_t: float
    tangent_continuous: bool = False
    """Require that the target map begins with the last ray of the previous part."""
    name: str = "free"
    known_t: tuple[float, float] | None = None
    """Slopes between which the target map is known, as that through points is; None: everywhere."""

    def build(self, start: Start) -> list[Segment]:
        """One segment of the design equation."""
        if self.known_t is not None:
            first, last = self.known_t
            if start.t < first - KNOWN_TOLERANCE:
                why = f"the points begin at t = {first:g}, but the part at t = {start.t:g}"
                raise start.refuse(self.name, why)
            if max(start.t, self.until_t) > last + KNOWN_TOLERANCE:
                verb = "begins" if start.t > last else "ends"
                why = f"the points end at t = {last:g}, but the part {verb} at t = {max(start.t, self.until_t):g}"
                raise start.refuse(self.name, why)
        if self.tangent_continuous:
            distance, height = (float(np.ravel(a)[0]) for a in self.target(np.array([start.t])))
            kink = start.slope_to_point(distance, height) - start.slope
            if abs(kink) > TANGENT_TOLERANCE:
                why = (
                    f"begins at distance {distance:.4f} m, height {height:.4f} m, off the last ray before it: "
                    f"the tangent would jump by {kink:.2e}"
                )
                raise start.refuse(self.name, why, start.t)
        return [integrate(self.target, start, until_t=self.until_t, part=self.name, tangent_continuous=self.tangent_continuous)]


@checked
@dataclass(frozen=True, kw_only=True)
class ConstantCurvature:
    """The tangent changes evenly with the radius until the ray `until_t` passes a wanted point (lima2001 2.3, eq. 2)."""

    until_t: float
    through_distance_m: float
    through_height_m: float
    from_slope: float | None = None
    """Tangent where it begins; None: that of the part before it."""

    def build(self, start: Start) -> list[Segment]:
        """Solves Y_A + (s_A + s_B)/2·(X_B − X_A) = Y_B = X_B/t_B for X_B (docs/methods.md 2)."""
        name = "constant curvature"
        if not start.t < self.until_t:
            raise start.refuse(name, f"ends at t = {self.until_t:.4f}, where it should begin or earlier", start.t)
        slope = start.slope if self.from_slope is None else self.from_slope

        def last_slope(x_m: float) -> float:
            end = Start(start.number, self.until_t, x_m / self.until_t, 0.0, start.pinhole_height_m, start.t_max)
            return end.slope_to_point(self.through_distance_m, self.through_height_m)

        def gap(x_m: float) -> float:
            return start.y_m + (slope + last_slope(x_m)) / 2.0 * (x_m - start.x_m) - x_m / self.until_t

        # Along the ray `until_t` the profile must come down from above it to below; the first meeting is the nearest.
        radii = start.x_m + start.y_m * np.linspace(0.0, 3.0, 1501)[1:]
        gaps = np.array([gap(x) for x in radii])
        met = np.flatnonzero((gaps[:-1] > 0.0) & (gaps[1:] <= 0.0))
        if met.size == 0:
            why = (
                f"no even bend leads the ray through distance {self.through_distance_m:.3f} m, "
                f"height {self.through_height_m:.3f} m"
            )
            raise start.refuse(name, why, self.until_t)
        x_m = float(scipy.optimize.brentq(gap, radii[met[0]], radii[met[0] + 1], xtol=1e-16, rtol=1e-15))
        curve = (last_slope(x_m) - slope) / (x_m - start.x_m)
        shape = Parabola(x_m=start.x_m, y_m=start.y_m, slope=slope, curve_per_m=curve)
        continues = self.from_slope is None
        return [close(shape, start, until=EndCondition(t=self.until_t), part=name, tangent_continuous=continues)]


@checked
@dataclass(frozen=True, kw_only=True)
class Cone:
    """A straight meridian."""

    slope: float | None = None
    """dY/dX; None: the tangent of the part before it."""
    until_t: float | None = None
    until_ground_m: float | None = None
    until_radius_m: float | None = None

    def build(self, start: Start) -> list[Segment]:
        """One closed segment."""
        shape = Straight(start, start.slope if self.slope is None else self.slope)
        return [close(shape, start, until=_end_condition(self), part="cone", tangent_continuous=self.slope is None)]


@checked
@dataclass(frozen=True, kw_only=True)
class Planar:
    """A flat ring square to the axis; it shows what is nearest, largest (lima2001 2.4, eq. 3)."""

    until_t: float | None = None
    until_ground_m: float | None = None
    until_radius_m: float | None = None
    seen_from_m: float | None = None
    """The ring's inner edge, as the ground distance it shows; the plane further in would only show the robot itself
    and is left black. None: all of the plane is mirror."""

    def build(self, start: Start) -> list[Segment]:
        """One closed segment, preceded by a black one if `seen_from_m` is given."""
        shape = Straight(start, 0.0)
        black = []
        if self.seen_from_m is not None:
            until = EndCondition(ground_m=self.seen_from_m)
            name = "black ring"
            black = [close(shape, start, until=until, part=name, tangent_continuous=False, reflects=False)]
            y_m, slope = black[0].end()
            start = Start(start.number, black[0].t_to, y_m, slope, start.pinhole_height_m, start.t_max)
        ring = close(shape, start, until=_end_condition(self), part="planar", tangent_continuous=bool(black))
        return [*black, ring]


@checked
@dataclass(frozen=True, kw_only=True)
class Sphere:
    """A sphere about the axis."""

    radius_m: float | None = None
    """None: that whose tangent goes on with the part before it."""
    until_t: float | None = None
    until_ground_m: float | None = None
    until_radius_m: float | None = None

    def build(self, start: Start) -> list[Segment]:
        """One closed segment."""
        radius = self.radius_m
        if radius is None:
            if not start.slope > 0.0:
                raise start.refuse("sphere", "needs radius_m: no rising tangent before it to go on with", start.t)
            radius = start.x_m * float(np.hypot(1.0, 1.0 / start.slope))
        if not radius > start.x_m:
            raise start.refuse("sphere", f"radius {radius:.4f} m is too small to begin at {start.x_m:.4f} m", start.t)
        continues = self.radius_m is None or start.t == 0.0
        return [close(Circle(start, radius), start, until=_end_condition(self), part="sphere", tangent_continuous=continues)]


@checked
@dataclass(frozen=True, kw_only=True)
class Paraboloid:
    """Y = Y₀ + X²/4f about the axis. Single-viewpoint only as the pinhole goes to infinity (an orthographic camera)."""

    focal_length_m: float | None = None
    """None: that whose tangent goes on with the part before it."""
    until_t: float | None = None
    until_ground_m: float | None = None
    until_radius_m: float | None = None

    def build(self, start: Start) -> list[Segment]:
        """One closed segment."""
        focal = self.focal_length_m
        if focal is None:
            if not start.slope > 0.0:
                why = "needs focal_length_m: no rising tangent before it to go on with"
                raise start.refuse("paraboloid", why, start.t)
            focal = start.x_m / (2.0 * start.slope)
        if not focal > 0.0:
            raise start.refuse("paraboloid", f"focal_length_m = {focal} must be positive")
        curve = 1.0 / (2.0 * focal)
        shape = Parabola(x_m=start.x_m, y_m=start.y_m, slope=start.x_m * curve, curve_per_m=curve)
        continues = self.focal_length_m is None or start.t == 0.0
        return [close(shape, start, until=_end_condition(self), part="paraboloid", tangent_continuous=continues)]


@checked
@dataclass(frozen=True, kw_only=True)
class Hyperboloid:
    """A hyperboloid with the pinhole at its second focus: all rays look out of the first, the single viewpoint."""

    eccentricity: float | None = None
    """c/a > 1; None: that whose tangent goes on with the part before it."""
    until_t: float | None = None
    until_ground_m: float | None = None
    until_radius_m: float | None = None

    def build(self, start: Start) -> list[Segment]:
        """One closed segment."""
        eccentricity = self.eccentricity
        if eccentricity is None:
            gamma = float(start.last_ray.gamma_rad[0])
            if not 0.0 < gamma < np.pi:
                raise start.refuse("hyperboloid", "needs eccentricity: no ray before it to go on with", start.t)
            # The last ray, drawn back, meets the axis in the first focus, 2c above the pinhole; r − r' = 2a.
            focus = start.y_m + start.x_m / np.tan(gamma)
            eccentricity = focus / (np.hypot(start.x_m, start.y_m) - np.hypot(start.x_m, focus - start.y_m))
        if not (1.0 < eccentricity < np.inf):
            raise start.refuse("hyperboloid", f"eccentricity = {eccentricity:.4f} must exceed 1", start.t)
        widest = float(np.sqrt(eccentricity**2 - 1.0))
        if start.t >= widest or (self.until_t is not None and self.until_t >= widest):
            why = f"its asymptote ends the view at t = {widest:.4f}"
            raise start.refuse("hyperboloid", why, self.until_t or min(start.t, MAX_RAY_SLOPE))
        shape = Hyperbola(start, eccentricity)
        continues = self.eccentricity is None or start.t == 0.0
        return [close(shape, start, until=_end_condition(self), part="hyperboloid", tangent_continuous=continues)]


def _end_condition(part: Cone | Planar | Sphere | Paraboloid | Hyperboloid) -> EndCondition:
    return EndCondition(t=part.until_t, ground_m=part.until_ground_m, radius_m=part.until_radius_m)


def _previous_ground_m(start: Start, part: str) -> float:
    ground = float(start.last_ray.distance_at_m(0.0)[0])
    if not np.isfinite(ground):
        raise start.refuse(part, "the ray before it does not come down to the ground, so it cannot go on with it", start.t)
    return ground
