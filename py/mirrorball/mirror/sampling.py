"""How far is the interpolated profile from its design, and how close must its samples be?

`Profile` interpolates by Akima's cubics. Their slopes decide where a ray meets the ground.
"""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING

import numpy as np

from mirrorball._core import Profile
from mirrorball.mirror.reflection import Array, Mask, reflect
from mirrorball.mirror.segment import Segment

if TYPE_CHECKING:
    from mirrorball.mirror.profile_design import Mirror

SAMPLES_MAX = 200_000
"""Most samples of a profile: with more, slopes are dominated by the rounding of the heights."""

STEP_MAX_M = 1e-4
STEPS_MIN = 500
"""Fewest steps over the radius: a small mirror needs smaller steps."""

DEVIATION_MAX_M = 1e-9
"""Of the surface, apart from joints: far below the form error of a lathe (`Tolerances.form_m`)."""
GROUND_ERROR_M, GROUND_ERROR_SHARE, SLOPE_ERROR = 1e-5, 1e-5, 1e-6
"""Of the ground point: an absolute part, a share of its distance, and what this much of a camera ray's slope t moves it (less
than a thousandth of a pixel at a focal length of 1000 px)."""
GROUND_REACH_M = 1000.0
"""Farthest ground that counts: the largest reach of a design file."""

JOINT_STEPS = 3.0
"""Akima's slopes use two neighbours on each side. This many steps from a joint they mix two parts."""


def profile_deviation_m(mirror: Mirror, radius_m: Array, height_m: Array) -> float:
    """Largest difference in height (metres) between the design and `Profile` of these samples, joints included."""
    read = Profile(radius_m=radius_m, height_m=height_m)
    # Samples and seven places between each two.
    shares = np.arange(8) / 8.0
    x = np.append((radius_m[:-1, None] + shares * np.diff(radius_m)[:, None]).ravel(), radius_m[-1])
    height, _ = exact_height_and_slope(mirror, x)
    return float(np.abs(read.height_and_slope(x)[0] - height).max())


def exact_height_and_slope(mirror: Mirror, radius_m: Array) -> tuple[Array, Array]:
    """Height above the ground (metres) and slope of the design at radii up to its rim."""
    ends = [segment.t_to * segment.end()[0] for segment in mirror.segments]
    owner = np.minimum(np.searchsorted(ends, radius_m, side="left"), len(ends) - 1)
    height, slope = np.empty_like(radius_m), np.empty_like(radius_m)
    for index, segment in enumerate(mirror.segments):
        inside = owner == index
        if inside.any():
            t = slopes_at_radii(segment, radius_m[inside])
            y = segment.height(t)
            slope[inside] = segment.tangent(t, y)
            # Removes what Newton's method leaves of the difference in radius.
            height[inside] = y + slope[inside] * (radius_m[inside] - t * y) + mirror.pinhole_height_m
    return height, slope


@functools.lru_cache(maxsize=16)
def fine_step_m(mirror: Mirror) -> float:
    """Longest step between samples (metres) at which `Profile` keeps `DEVIATION_MAX_M` and the limits of the ground error.

    At least a 50 000th of the radius. Places within three steps of a joint do not count.
    """
    step = min(STEP_MAX_M, mirror.radius_m / STEPS_MIN)
    least = mirror.radius_m / (SAMPLES_MAX / 4)
    while step > least:
        excess = _excess(mirror, step)
        if excess <= 1.0:
            return step
        # Akima's slopes err with the square of the step.
        step = max(step * float(np.clip(0.9 / np.sqrt(excess), 0.1, 0.9)), least)
    return step


def _excess(mirror: Mirror, step_m: float) -> float:
    """The largest of all errors, as a multiple of its limit."""
    radius, height = mirror.samples(step_m=step_m)
    read = Profile(radius_m=radius, height_m=height)
    x = np.sort(np.concatenate([radius[1:], (radius[1:] + radius[:-1]) / 2.0]))
    exact_height, exact_slope = exact_height_and_slope(mirror, x)
    read_height, read_slope = read.height_and_slope(x)
    kept = _far_from_joints(mirror, x, JOINT_STEPS * step_m)
    shape = np.abs(read_height - exact_height) / DEVIATION_MAX_M
    ground = _ground_m(mirror, x, exact_height, exact_slope)
    with np.errstate(invalid="ignore", divide="ignore"):
        off = np.abs(_ground_m(mirror, x, read_height, read_slope) - ground)
        counted = kept & (np.abs(ground) <= GROUND_REACH_M)
        per_slope = np.abs(np.gradient(ground, x / (exact_height - mirror.pinhole_height_m)))
    limits = GROUND_ERROR_M + GROUND_ERROR_SHARE * np.abs(ground) + SLOPE_ERROR * np.nan_to_num(per_slope)
    return float(max(shape[kept].max(initial=0.0), (off / limits)[counted].max(initial=0.0)))


def _ground_m(mirror: Mirror, radius_m: Array, height_m: Array, slope: Array) -> Array:
    y = height_m - mirror.pinhole_height_m
    return reflect(t=radius_m / y, y_m=y, slope=slope, pinhole_height_m=mirror.pinhole_height_m).distance_at_m(0.0)


def _far_from_joints(mirror: Mirror, radius_m: Array, apart_m: float) -> Mask:
    kept = np.ones(radius_m.shape, dtype=bool)
    for segment in mirror.segments[:-1]:
        kept &= np.abs(radius_m - segment.t_to * segment.end()[0]) > apart_m
    return kept


def slopes_at_radii(segment: Segment, x_m: Array) -> Array:
    """Camera slopes t at which a segment has the radii x: Newton on X(t) = t·Y(t), with dX/dt = Y/(1 − t·Y′)."""
    grid = np.linspace(segment.t_from, segment.t_to, 400)
    t = np.interp(x_m, grid * segment.height(grid), grid)
    for _ in range(6):
        y = segment.height(t)
        rate = y / (1.0 - t * segment.tangent(t, y))
        t = np.clip(t - (t * y - x_m) / rate, segment.t_from, segment.t_to)
    return t
