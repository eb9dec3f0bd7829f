"""Optical analysis of a design: resolution on ground and objects, defocus, astigmatism, blind zones.

Everything is computed in the meridian plane from exact rays; pixels come in through the focal length alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mirrorball.arguments import checked, invalid
from mirrorball.mirror.profile_design import Mirror
from mirrorball.mirror.reflection import Array, Mask, Rays
from mirrorball.mirror.segment import Segment
from mirrorball.records import Record

BALL_RADIUS_M = 0.11
"""Size 5."""
LINE_WIDTH_M = 0.125
ROBOT_WIDTH_M, ROBOT_HEIGHT_M = 0.52, 0.80
"""The largest robot that the rules allow."""


@checked
@dataclass(frozen=True)
class Lens:
    """What decides how sharp the image is."""

    focal_length_m: float = 0.006
    f_number: float = 2.0
    focus_m: float | None = None
    """Distance from the pinhole that is in focus; None: the best compromise for the whole mirror."""

    def __post_init__(self) -> None:
        for name in ("focal_length_m", "f_number", "focus_m"):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value > 0.0):
                raise ValueError(f"lens: {name} = {value:g} must be positive")
        if self.focus_m is not None and self.focus_m <= self.focal_length_m:
            raise ValueError(
                f"lens: focus_m = {self.focus_m:g} must exceed focal_length_m = {self.focal_length_m:g}: "
                "no lens is in focus nearer than its focal length"
            )

    @property
    def aperture_m(self) -> float:
        """Diameter of the entrance pupil."""
        return self.focal_length_m / self.f_number


@dataclass(frozen=True, eq=False)
class View(Record):
    """One part's rays, densely and evenly spaced in t, with what follows from each."""

    part: str
    rays: Rays
    ground_m: Array
    """Distance from the axis where the ray meets the ground, on either side of it; NaN where it does not, or where the mirror
    itself is in its way."""
    blocked: Mask
    """True where the reflected ray meets the mirror again."""
    radial_px_per_m: Array
    """Image radius per metre of ground distance."""
    tangential_px_per_m: Array
    """Image arc per metre of ground across the line of sight."""
    curvature_per_m: Array
    """Of the meridian; positive is convex."""
    image_tangential_m: Array
    """Distance along the camera ray, from the pinhole, of the virtual image of the ground point, meridional focus."""
    image_sagittal_m: Array
    """The same across the meridian (Coddington's equations)."""
    viewpoint_error_m: Array
    """How far the ray, drawn back, passes the mirror's mean viewpoint."""
    caustic_x_m: Array
    caustic_y_m: Array
    """Where neighbouring rays, drawn back, meet: a point for a single-viewpoint mirror."""


@dataclass(frozen=True, eq=False)
class ObjectSizes(Record):
    """Pixels that a thing covers, over its distance."""

    distance_m: Array
    ball_radial_px: Array
    ball_tangential_px: Array
    line_radial_px: Array
    """A line across the line of sight."""
    line_tangential_px: Array
    """A line along the line of sight."""
    robot_radial_px: Array
    robot_tangential_px: Array


@dataclass(frozen=True, eq=False)
class PartMeridian(Record):
    """One part's meridian in the pinhole's frame, evenly spaced in t."""

    part: str
    number: int
    reflects: bool
    t: Array
    x_m: Array
    y_m: Array


@dataclass(frozen=True, eq=False)
class OpticalAnalysis(Record):
    """Everything the report draws: numbers alone, which can be sent to another process."""

    name: str
    pinhole_height_m: float
    outlines: tuple[PartMeridian, ...]
    """From the axis outwards, black rings included."""
    focal_px: float
    lens: Lens
    reach_m: float
    views: tuple[View, ...]
    sizes: ObjectSizes
    blind_m: tuple[tuple[float, float], ...]
    """Stretches of ground from the axis to the reach that no ray shows."""
    viewpoint_m: float
    """Height above the pinhole of the point on the axis that the rays, drawn back, pass nearest."""
    focus_m: float
    """Distance from the pinhole that the lens is focused at."""
    smallest_curvature_radius_m: float
    steepest_slope: float

    @property
    def radius_m(self) -> float:
        """Of the rim."""
        return float(self.outlines[-1].x_m[-1])

    def blur_px(self, view: View) -> tuple[Array, Array]:
        """Diameter of the blur (meridional, sagittal) in pixels: f·A·|1/s − 1/s₀|."""

        def blur(image_m: Array) -> Array:
            return np.asarray(self.focal_px * self.lens.aperture_m * np.abs(1.0 / image_m - 1.0 / self.focus_m))

        return blur(view.image_tangential_m), blur(view.image_sagittal_m)


def _part_meridian(segment: Segment) -> PartMeridian:
    t = np.linspace(segment.t_from, segment.t_to, 20)
    y = segment.height(t)
    return PartMeridian(part=segment.part, number=segment.number, reflects=segment.reflects, t=t, x_m=t * y, y_m=y)


@checked
def judge(
    mirror: Mirror, *, focal_px: float, lens: Lens | None = None, reach_m: float = 12.0, rays_per_part: int = 600
) -> OpticalAnalysis:
    """Traces the mirror densely and derives what the report shows; `reach_m` is how far the ground matters."""
    for key, value in (("focal_px", focal_px), ("reach_m", reach_m)):
        if not (np.isfinite(value) and value > 0.0):
            raise ValueError(f"{key} = {value} must be positive")
    if rays_per_part < 2:
        raise ValueError(invalid("rays_per_part", rays_per_part, "at least 2"))
    lens = lens or Lens()
    traced = []
    for segment in mirror.segments:
        if segment.reflects:
            # Strictly inside, so that a kink belongs to neither side.
            edge = (segment.t_to - segment.t_from) * 1e-9
            t = np.linspace(segment.t_from + edge, segment.t_to - edge, rays_per_part)
            traced.append((segment, segment.rays(t, mirror.pinhole_height_m)))
    viewpoint = _fit_viewpoint([rays for _, rays in traced])
    views = tuple(
        _analyse_part(mirror, rays, focal_px=focal_px, part=segment.part, viewpoint_m=viewpoint,
              curvature=segment.curvature_per_m(rays.t))
        for segment, rays in traced
    )  # fmt: skip
    bend = max(float(np.abs(view.curvature_per_m).max()) for view in views)
    return OpticalAnalysis(
        name=mirror.name,
        pinhole_height_m=mirror.pinhole_height_m,
        outlines=tuple(_part_meridian(segment) for segment in mirror.segments),
        focal_px=focal_px,
        lens=lens,
        reach_m=reach_m,
        views=views,
        sizes=_object_sizes(views, focal_px=focal_px, reach_m=reach_m),
        blind_m=_blind_zones(views, reach_m=reach_m),
        viewpoint_m=viewpoint,
        focus_m=lens.focus_m if lens.focus_m is not None else _best_focus(views, reach_m=reach_m),
        smallest_curvature_radius_m=1.0 / bend if bend > 0.0 else float("inf"),
        steepest_slope=max(float(np.abs(view.rays.slope).max()) for view in views),
    )


def _analyse_part(mirror: Mirror, rays: Rays, *, focal_px: float, part: str, viewpoint_m: float, curvature: Array) -> View:
    blocked = _self_occlusion(mirror, rays)
    ground = np.where(blocked, np.nan, rays.distance_at_m(0.0))
    sin, cos = np.sin(rays.gamma_rad), np.cos(rays.gamma_rad)
    # Cosine law of the meridian: rates along t of the meeting point, the ray and the ground.
    x_rate = rays.y_m / (1.0 - rays.t * rays.slope)
    alpha_rate = curvature * np.hypot(1.0, rays.slope) * x_rate
    gamma_rate = 1.0 / (1.0 + rays.t**2) + 2.0 * alpha_rate
    drop = rays.y_m + rays.pinhole_height_m
    with np.errstate(divide="ignore", invalid="ignore"):
        ground_rate = x_rate * (1.0 + rays.slope * sin / cos) + drop * gamma_rate / cos**2
        radial = np.abs(focal_px / ground_rate)
        tangential = np.abs(focal_px * rays.t / ground)
        # The envelope of the rays lies where moving t moves the ray along itself only.
        along = -x_rate * (cos + rays.slope * sin) / gamma_rate
    meridional, sagittal = _astigmatic_foci(rays, curvature, ground)
    return View(
        part=part,
        rays=rays,
        # A ray that crosses the axis shows ground on its other side, at a positive distance as well.
        ground_m=np.abs(ground),
        blocked=blocked,
        radial_px_per_m=np.where(np.isfinite(ground), radial, np.nan),
        tangential_px_per_m=tangential,
        curvature_per_m=curvature,
        image_tangential_m=meridional,
        image_sagittal_m=sagittal,
        viewpoint_error_m=np.abs(rays.x_m * cos + (rays.y_m - viewpoint_m) * sin),
        caustic_x_m=rays.x_m + along * sin,
        caustic_y_m=rays.y_m - along * cos,
    )


def _astigmatic_foci(rays: Rays, curvature: Array, ground: Array) -> tuple[Array, Array]:
    """Coddington: 1/s′ = 1/s + 2κ/cos i (meridional), 1/s + 2·cos i·κₛ (sagittal), s′ behind the mirror."""
    incidence = np.cos(np.arctan(rays.t) + np.arctan(rays.slope))
    to_mirror = np.hypot(rays.x_m, rays.y_m)
    with np.errstate(divide="ignore", invalid="ignore"):
        across = np.where(rays.x_m > 0.0, rays.slope / (rays.x_m * np.hypot(1.0, rays.slope)), curvature)
        drop = rays.y_m + rays.pinhole_height_m
        nearness = np.where(np.isfinite(ground), 1.0 / np.hypot(ground - rays.x_m, drop), 0.0)
        meridional = to_mirror + 1.0 / (nearness + 2.0 * curvature / incidence)
        sagittal = to_mirror + 1.0 / (nearness + 2.0 * across * incidence)
    return meridional, sagittal


def _best_focus(views: tuple[View, ...], *, reach_m: float) -> float:
    """Where the middle one of all rays is sharp; not the mean, since concave stretches focus behind the pinhole."""
    vergence = [np.zeros(0)]
    for view in views:
        near = view.ground_m <= reach_m
        vergence += [1.0 / view.image_tangential_m[near], 1.0 / view.image_sagittal_m[near]]
    middle = float(np.median(np.concatenate(vergence))) if any(part.size for part in vergence) else 0.0
    return 1.0 / middle if middle > 0.0 else float("inf")


def _fit_viewpoint(parts: list[Rays]) -> float:
    """Least squares on the axis: each ray's distance from (0, Y_v) is x·cos γ + (y − Y_v)·sin γ."""
    gamma = np.concatenate([rays.gamma_rad for rays in parts])
    x, y = (np.concatenate([getattr(rays, key) for rays in parts]) for key in ("x_m", "y_m"))
    sin, cos = np.sin(gamma), np.cos(gamma)
    return float(np.sum(sin * (x * cos + y * sin)) / np.sum(sin**2))


def _self_occlusion(mirror: Mirror, rays: Rays) -> Mask:
    """True where a reflected ray would have to pass through the mirror (either side of the axis)."""
    t = np.linspace(0.0, mirror.t_max, 400)
    surface = mirror.rays(t)
    sin, cos = np.sin(rays.gamma_rad)[:, None], np.cos(rays.gamma_rad)[:, None]
    clearance = 1e-6
    blocked = np.zeros(rays.t.shape, dtype=bool)
    for side in (1.0, -1.0):
        with np.errstate(divide="ignore", invalid="ignore"):
            way = (side * surface.x_m - rays.x_m[:, None]) / sin
        height = rays.y_m[:, None] - way * cos
        # A millimetre on, so that a ray does not meet the place it leaves from.
        blocked |= np.asarray(((way > 1e-3) & (height > surface.y_m + clearance)).any(axis=1))
    return blocked


def _blind_zones(views: tuple[View, ...], *, reach_m: float) -> tuple[tuple[float, float], ...]:
    seen: list[tuple[float, float]] = []
    for view in views:
        ground = view.ground_m
        both = np.isfinite(ground[:-1]) & np.isfinite(ground[1:])
        low, high = np.minimum(ground[:-1], ground[1:])[both], np.maximum(ground[:-1], ground[1:])[both]
        seen.extend(zip(low.tolist(), high.tolist(), strict=True))
    blind: list[tuple[float, float]] = []
    reached = 0.0
    # Rays stop a billionth short of a part's ends; two parts that meet leave no gap.
    slack = 1e-6 * reach_m
    for begin, end in sorted(seen):
        if begin > reached + slack and reached < reach_m:
            blind.append((reached, min(begin, reach_m)))
        reached = max(reached, end)
    if reached + slack < reach_m:
        blind.append((reached, reach_m))
    return tuple(blind)


def _object_sizes(views: tuple[View, ...], *, focal_px: float, reach_m: float) -> ObjectSizes:
    distance = np.linspace(0.3, reach_m, 150)
    ball, robot = np.zeros_like(distance), np.zeros_like(distance)
    line = np.zeros_like(distance)
    arc_ball, arc_robot, arc_line = np.zeros_like(distance), np.zeros_like(distance), np.zeros_like(distance)
    for view in views:
        rays, step = view.rays, np.gradient(view.rays.t)[:, None] * focal_px
        clear = ~view.blocked[:, None]
        # A ray, moved along itself, passes the ball's centre at this distance.
        high = rays.y_m[:, None] + rays.pinhole_height_m - BALL_RADIUS_M
        sin, cos = np.sin(rays.gamma_rad)[:, None], np.cos(rays.gamma_rad)[:, None]
        off = (distance - rays.x_m[:, None]) * cos - high * sin
        hits = clear & (np.abs(off) <= BALL_RADIUS_M) & (high * cos + (distance - rays.x_m[:, None]) * sin > 0.0)
        ball += (hits * step).sum(axis=0)
        arc_ball = np.maximum(arc_ball, _tangential_size_px(hits, rays, distance, BALL_RADIUS_M, focal_px))
        near, far = distance - LINE_WIDTH_M / 2.0, distance + LINE_WIDTH_M / 2.0
        line += focal_px * _slope_range_between(view, near, far)
        ground = np.where(np.isfinite(view.ground_m), view.ground_m, np.inf)[:, None]
        hits = (ground >= near) & (ground <= far)
        arc_line = np.maximum(arc_line, _tangential_size_px(hits, rays, distance, LINE_WIDTH_M / 2.0, focal_px))
        with np.errstate(divide="ignore", invalid="ignore"):
            height = rays.y_m[:, None] + rays.pinhole_height_m - (distance - rays.x_m[:, None]) * cos / sin
        hits = clear & (sin > 0.0) & (height >= 0.0) & (height <= ROBOT_HEIGHT_M)
        robot += (hits * step).sum(axis=0)
        arc_robot = np.maximum(arc_robot, _tangential_size_px(hits, rays, distance, ROBOT_WIDTH_M / 2.0, focal_px))
    return ObjectSizes(
        distance_m=distance,
        ball_radial_px=ball,
        ball_tangential_px=arc_ball,
        line_radial_px=line,
        line_tangential_px=arc_line,
        robot_radial_px=robot,
        robot_tangential_px=arc_robot,
    )


def _slope_range_between(view: View, near: Array, far: Array) -> Array:
    """How much of t shows the ground between two distances, linear between neighbouring rays."""
    ground = view.ground_m
    low, high = np.fmin(ground[:-1], ground[1:])[:, None], np.fmax(ground[:-1], ground[1:])[:, None]
    whole = np.isfinite(ground[:-1] + ground[1:])[:, None]
    overlap = np.clip(np.minimum(high, far) - np.maximum(low, near), 0.0, None)
    share = np.divide(overlap, high - low, out=np.zeros_like(overlap), where=whole & (high > low))
    return np.asarray((share * np.diff(view.rays.t)[:, None]).sum(axis=0))


def _tangential_size_px(hits: Mask, rays: Rays, distance: Array, half_width_m: float, focal_px: float) -> Array:
    """Pixels across the line of sight, at the middle of the rays that hit."""
    count = hits.sum(axis=0)
    middle = np.divide((hits * rays.t[:, None]).sum(axis=0), count, out=np.zeros_like(distance), where=count > 0)
    return np.asarray(2.0 * focal_px * middle * np.arctan(half_width_m / distance))
