"""A built part of a profile: an interval of camera slopes t with height and tangent."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from mirrorball.mirror.reflection import Array, Rays, reflect, slope_to_point


@dataclass(frozen=True)
class Start:
    """Where a part begins: the end of the part before it, or the apex."""

    number: int
    """Of the part, counted from 1."""
    t: float
    y_m: float
    slope: float
    """Tangent of the part before it; 0 at the apex."""
    pinhole_height_m: float
    t_max: float
    """The largest slope that the lens sees."""

    @property
    def x_m(self) -> float:
        """Radius where the part begins."""
        return self.t * self.y_m

    @property
    def last_ray(self) -> Rays:
        """The ray that the part before it ends with."""
        return reflect(
            t=np.array([self.t]),
            y_m=np.array([self.y_m]),
            slope=np.array([self.slope]),
            pinhole_height_m=self.pinhole_height_m,
        )

    def slope_to_point(self, distance_m: float, height_m: float) -> float:
        """Tangent here that sends this ray through a point."""
        slope = slope_to_point(
            t=np.array([self.t]),
            y_m=np.array([self.y_m]),
            distance_m=np.array([distance_m]),
            height_m=np.array([height_m]),
            pinhole_height_m=self.pinhole_height_m,
        )
        return float(slope[0])

    def refuse(self, part: str, why: str, t: float | None = None) -> ValueError:
        """The error that names the part, the place and the reason."""
        place = "" if t is None else f", at t = {t:.4f}"
        return ValueError(f"part {self.number} ({part}){place}: {why}")


@dataclass(frozen=True, eq=False)
class Segment:
    """A built part: Y over t and the tangent at a point (t, Y), both vectorised. Equal if they run through the same points."""

    part: str
    number: int
    t_from: float
    t_to: float
    height: Callable[[Array], Array] = field(repr=False)
    tangent: Callable[[Array, Array], Array] = field(repr=False)
    tangent_continuous: bool
    """True where the tangent at t_from is promised to be that of the segment before."""
    reflects: bool = True
    """False for a ring that is left black."""

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Segment):
            return NotImplemented
        return self._identity() == other._identity() and np.array_equal(self._course(), other._course())

    def __hash__(self) -> int:
        return hash(self._identity())

    def _identity(self) -> tuple[object, ...]:
        return self.part, self.number, self.t_from, self.t_to, self.tangent_continuous, self.reflects

    def _course(self) -> Array:
        t = np.linspace(self.t_from, self.t_to, 33)
        y = self.height(t)
        return np.stack([y, self.tangent(t, y)])

    def end(self) -> tuple[float, float]:
        """Height and tangent at its end."""
        t = np.array([self.t_to])
        y = self.height(t)
        return float(y[0]), float(self.tangent(t, y)[0])

    def rays(self, t: Array, pinhole_height_m: float) -> Rays:
        """Its reflected rays at slopes t within it."""
        y = self.height(t)
        return reflect(t=t, y_m=y, slope=self.tangent(t, y), pinhole_height_m=pinhole_height_m)

    def curvature_per_m(self, t: Array) -> Array:
        """Signed curvature of the meridian, 1/m; positive where the mirror is convex.

        The tangent is exact, so the parabola through three of them, 10⁻⁵ in t apart and all within the segment, gives its
        rate to six digits.
        """
        reach = min(1e-5, (self.t_to - self.t_from) / 4.0)
        middle = np.clip(t, self.t_from + reach, self.t_to - reach)
        low, mid, high = (self.tangent(u, self.height(u)) for u in (middle - reach, middle, middle + reach))
        rate = (high - low) / (2.0 * reach) + (t - middle) * (high - 2.0 * mid + low) / reach**2
        y = self.height(t)
        slope = self.tangent(t, y)
        x_rate = y / (1.0 - t * slope)
        return np.asarray(rate / x_rate / (1.0 + slope**2) ** 1.5)
