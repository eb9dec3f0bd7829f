"""Joins parts to a mirror's profile, for ray tracing, analysis and manufacturing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mirrorball._core import Profile
from mirrorball.arguments import checked, invalid
from mirrorball.mirror.parts import Part
from mirrorball.mirror.reflection import Array, Rays
from mirrorball.mirror.sampling import SAMPLES_MAX, fine_step_m, slopes_at_radii
from mirrorball.mirror.segment import Segment, Start

KINK_SAMPLE_SPACING_M = 2e-7
"""A sample this close on either side of a kink keeps it from rounding off whatever curve is laid through the samples."""

PROFILE_RADIUS_MAX_M, PROFILE_HEIGHT_MAX_M, PROFILE_SLOPE_MAX = 2.0, 10.0, 50.0
"""Limits of `Profile` (height above the ground): larger numbers mean a file that is not in metres."""


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

    def samples(self, *, step_m: float | None = None) -> tuple[Array, Array]:
        """Radius and height above the ground (metres), at most `step_m` apart, with every joint between parts.

        Without a step, the spacing is that at which interpolation reproduces the design (`sampling.fine_step_m`). ValueError
        for a step that is not positive or gives more than `SAMPLES_MAX` samples, and for a mirror that `Profile` refuses.
        """
        require_readable(self)
        if step_m is None:
            step_m = fine_step_m(self)
        least = self.radius_m / SAMPLES_MAX
        if not (np.isfinite(step_m) and step_m >= least):
            raise ValueError(invalid("step_m", step_m, f"at least {least:.2g} m, {SAMPLES_MAX} samples"))
        spacing = min(KINK_SAMPLE_SPACING_M, step_m / 50.0)
        radii, heights = [np.zeros(1)], [np.array([float(self.segments[0].height(np.zeros(1))[0])])]
        for segment in self.segments:
            ends = np.array([segment.t_from, segment.t_to])
            first, last = ends * segment.height(ends)
            count = max(int(np.ceil((last - first) / step_m)), 4)
            x = np.linspace(first, last, count + 1)[1:]
            if segment is not self.segments[0] and not segment.tangent_continuous:
                x = np.append(first + spacing, x)
            if (following := self._next_segment(segment)) and not following.tangent_continuous:
                x = np.insert(x, -1, last - spacing)
            t = slopes_at_radii(segment, x)
            radii.append(x)
            heights.append(x / t)
        return np.concatenate(radii), np.concatenate(heights) + self.pinhole_height_m

    def _next_segment(self, segment: Segment) -> Segment | None:
        index = self.segments.index(segment) + 1
        return self.segments[index] if index < len(self.segments) else None

    def profile(self, *, step_m: float | None = None) -> Profile:
        """The profile as the robot's own tracer and the simulator take it; `step_m` as in `samples`."""
        radius, height = self.samples(step_m=step_m)
        return Profile(radius_m=radius, height_m=height)


def require_readable(mirror: Mirror) -> None:
    """Raises ValueError if a part exceeds what `Profile` accepts."""
    for segment in mirror.segments:
        t = np.linspace(segment.t_from, segment.t_to, 257)
        y = segment.height(t)
        for name, values, most, unit in (
            ("radius", t * y, PROFILE_RADIUS_MAX_M, " m"),
            ("height above the ground", y + mirror.pinhole_height_m, PROFILE_HEIGHT_MAX_M, " m"),
            ("slope", np.abs(segment.tangent(t, y)), PROFILE_SLOPE_MAX, ""),
        ):
            largest = float(values.max())
            if largest > most:
                raise ValueError(
                    f"part {segment.number} ({segment.part}): {name} {largest:.4g}{unit} is out of range (expected at most "
                    f"{most:g}{unit}, the limit of every program that reads profiles)"
                )


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
