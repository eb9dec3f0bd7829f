"""Joins parts to a mirror's profile, for ray tracing, analysis and manufacturing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mirrorball._core import Profile
from mirrorball.arguments import checked
from mirrorball.mirror.parts import Part
from mirrorball.mirror.reflection import Array, Rays
from mirrorball.mirror.segment import Segment, Start

KINK_SAMPLE_SPACING_M = 2e-6
"""A sample this close on either side of a kink keeps it from rounding off whatever curve is laid through the samples."""


@dataclass(frozen=True)
class Mirror:
    """A designed mirror: segments from the axis outwards, in the pinhole's frame."""

    name: str
    pinhole_height_m: float
    """Pinhole above the ground."""
    segments: tuple[Segment, ...]

    @property
    def t_max(self) -> float:
        """Slope of the camera ray to the rim."""
        return self.segments[-1].t_to

    @property
    def radius_m(self) -> float:
        """Of the rim."""
        return self.t_max * self.segments[-1].end()[0]

    def segment(self, part: str) -> Segment:
        """The first segment of that name; KeyError if there is none."""
        for segment in self.segments:
            if segment.part == part:
                return segment
        raise KeyError(f"{self.name} has no part {part!r}; it has {', '.join(s.part for s in self.segments)}")

    def rays(self, t: Array) -> Rays:
        """Reflected rays at camera slopes t (ascending or not) from the axis to the rim."""
        t = np.atleast_1d(np.asarray(t, dtype=np.float64))
        if t.size and not (t.min() >= 0.0 and t.max() <= self.t_max):
            raise ValueError(f"t runs from {t.min():.4f} to {t.max():.4f}, the mirror from 0 to {self.t_max:.4f}")
        y, slope = np.empty_like(t), np.empty_like(t)
        owner = np.searchsorted([segment.t_to for segment in self.segments[:-1]], t, side="left")
        for index, segment in enumerate(self.segments):
            inside = owner == index
            if not inside.any():
                continue
            y[inside] = segment.height(t[inside])
            slope[inside] = segment.tangent(t[inside], y[inside])
        gamma = np.arctan(t) + 2.0 * np.arctan(slope)
        return Rays(t=t, x_m=t * y, y_m=y, slope=slope, gamma_rad=gamma, pinhole_height_m=self.pinhole_height_m)

    def samples(self, *, step_m: float = 5e-5) -> tuple[Array, Array]:
        """Radius and height above the ground (metres), at most `step_m` apart, with every joint between parts."""
        if not step_m > 0.0:
            raise ValueError(f"step_m = {step_m} must be positive")
        radii, heights = [np.zeros(1)], [np.array([float(self.segments[0].height(np.zeros(1))[0])])]
        for segment in self.segments:
            ends = np.array([segment.t_from, segment.t_to])
            first, last = ends * segment.height(ends)
            count = max(int(np.ceil((last - first) / step_m)), 4)
            x = np.linspace(first, last, count + 1)[1:]
            if segment is not self.segments[0] and not segment.tangent_continuous:
                x = np.append(first + KINK_SAMPLE_SPACING_M, x)
            if (following := self._next_segment(segment)) and not following.tangent_continuous:
                x = np.insert(x, -1, last - KINK_SAMPLE_SPACING_M)
            t = _slopes_at_radii(segment, x)
            radii.append(x)
            heights.append(x / t)
        return np.concatenate(radii), np.concatenate(heights) + self.pinhole_height_m

    def _next_segment(self, segment: Segment) -> Segment | None:
        index = self.segments.index(segment) + 1
        return self.segments[index] if index < len(self.segments) else None

    def profile(self, *, step_m: float = 5e-5) -> Profile:
        """The profile as the robot's own tracer and the simulator take it."""
        radius, height = self.samples(step_m=step_m)
        return Profile(radius_m=radius, height_m=height)


def _slopes_at_radii(segment: Segment, x_m: Array) -> Array:
    """Camera slopes t at which a segment has the radii x: Newton on X(t) = t·Y(t), with dX/dt = Y/(1 − t·Y′)."""
    grid = np.linspace(segment.t_from, segment.t_to, 400)
    t = np.interp(x_m, grid * segment.height(grid), grid)
    for _ in range(6):
        y = segment.height(t)
        rate = y / (1.0 - t * segment.tangent(t, y))
        t = np.clip(t - (t * y - x_m) / rate, segment.t_from, segment.t_to)
    return t


@checked
def design(
    parts: Sequence[Part],
    *,
    pinhole_height_m: float,
    apex_above_pinhole_m: float,
    t_max: float | None = None,
    name: str = "mirror",
) -> Mirror:
    """Builds the parts one after the other, from the apex outwards.

    `t_max` is the largest slope the lens sees (half the image over the focal length). Raises ValueError saying which part
    cannot be built, where, and why.
    """
    if not parts:
        raise ValueError("a mirror needs at least one part")
    for key, value in (("pinhole_height_m", pinhole_height_m), ("apex_above_pinhole_m", apex_above_pinhole_m)):
        if not (np.isfinite(value) and value > 0.0):
            raise ValueError(f"{key} = {value} must be positive")
    limit = np.inf if t_max is None else t_max
    start = Start(1, 0.0, apex_above_pinhole_m, 0.0, pinhole_height_m, limit)
    segments: list[Segment] = []
    for number, part in enumerate(parts, start=1):
        built = part.build(Start(number, start.t, start.y_m, start.slope, pinhole_height_m, limit))
        segments.extend(built)
        y_m, slope = built[-1].end()
        start = Start(number, built[-1].t_to, y_m, slope, pinhole_height_m, limit)
    return Mirror(name=name, pinhole_height_m=pinhole_height_m, segments=tuple(segments))
