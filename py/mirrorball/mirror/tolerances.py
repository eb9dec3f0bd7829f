"""Ground errors of an uncalibrated robot by tolerances of mirror and mount: Monte Carlo over complete mirrors.

Each mirror is traced in three dimensions by the robot's own tracer; the error is the difference between the ground point that a
pixel really shows and the one that the perfect mirror shows there, which an uncalibrated robot assumes.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
import scipy
from tqdm import tqdm

from mirrorball._core import Camera, Mount, Profile, trace_points
from mirrorball.arguments import checked
from mirrorball.mirror.profile_design import Mirror
from mirrorball.mirror.reflection import Array
from mirrorball.mirror.segment import Segment
from mirrorball.records import Record

TILT_MAX_DEG, FOCAL_SHARE_MAX = 20.0, 0.2
"""Largest standard deviations. With more, many of the drawn mirrors would show no ground, or have a negative focal length."""


@checked
@dataclass(frozen=True, kw_only=True)
class Tolerances:
    """One standard deviation of each error, all independent and normal."""

    form_m: float = 5e-6
    """Height of the surface; the errors of a lathe, the same all around."""
    form_length_m: float = 0.01
    """Over which radius the form error changes."""
    tilt_deg: float = 0.2
    """Of the mirror against the camera's axis, in each direction."""
    offset_m: float = 0.0005
    """Of the mirror's axis, in each direction."""
    height_m: float = 0.0005
    """Of the mirror above the camera."""
    focal_share: float = 0.002
    """Of the focal length."""

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not (np.isfinite(value) and value >= 0.0):
                raise ValueError(f"tolerance {field.name} = {value:g} must not be negative")
        for name, most in (("tilt_deg", TILT_MAX_DEG), ("focal_share", FOCAL_SHARE_MAX)):
            if getattr(self, name) > most:
                raise ValueError(f"tolerance {name} = {getattr(self, name):g} must be at most {most:g}")
        if self.form_length_m == 0.0:
            raise ValueError("tolerance form_length_m = 0 must be positive")

    def alone(self, cause: str) -> Tolerances:
        """Only one of ERROR_SOURCES, the others perfect."""
        kept = ERROR_SOURCES[cause]
        zeros = {f.name: 0.0 for f in fields(self) if f.name not in (kept, "form_length_m")}
        return replace(self, **zeros)


ERROR_SOURCES = {
    "form": "form_m",
    "tilt": "tilt_deg",
    "offset": "offset_m",
    "height": "height_m",
    "focal length": "focal_share",
}
"""Error sources, and the field with their standard deviation."""

AZIMUTHS = 8
"""Directions around the robot: tilt and offset err along some and across others."""
FOURIER_FEATURES = 32
"""Random cosines that make up one form error; enough for a normal distribution."""


@dataclass(frozen=True, eq=False)
class GroundErrors(Record):
    """What 95 % of the mirrors keep, over ground distance."""

    distance_m: Array
    radial_rms_m: Array
    tangential_rms_m: Array
    total_95_m: Array
    """95th percentile of the distance between true and assumed ground point."""
    lost_share: Array
    """Of pixels that no longer show ground."""
    by_cause_rms_m: dict[str, Array]
    """Total error when only this is off."""
    count: int


class PixelErrors:
    """Pixels at ground distances and directions around the robot, and how far off an imperfect mirror shows each."""

    def __init__(self, mirror: Mirror, *, camera: Camera, reach_m: float, step_m: float | None = None) -> None:
        self._mirror, self._camera = mirror, camera
        self.distance_m, t = _sample_distances(mirror, reach_m=reach_m)
        rho = np.repeat(t * camera.focal_px, AZIMUTHS)
        turn = np.tile(np.arange(AZIMUTHS) * (2.0 * np.pi / AZIMUTHS), t.size)
        self._u, self._v = camera.centre_px[0] + rho * np.cos(turn), camera.centre_px[1] + rho * np.sin(turn)
        self.radius_m, self.height_m = mirror.samples(step_m=step_m)
        self._profile = Profile(radius_m=self.radius_m, height_m=self.height_m)
        plain = _scaled_camera(camera, mirror, focal_factor=1.0)
        self._nominal = _ground_points(plain, self._profile, self._u, self._v, Mount())

    def of(self, profile: Profile | None = None, *, mount: Mount | None = None, focal_factor: float = 1.0) -> Array:
        """Errors along and across the line of sight, 2 × (distances · `AZIMUTHS`), metres; NaN where no ground is seen."""
        real = _scaled_camera(self._camera, self._mirror, focal_factor=focal_factor)
        shown = _ground_points(real, profile or self._profile, self._u, self._v, mount or Mount())
        return _radial_tangential_errors(self._nominal, shown)


@checked
def monte_carlo(
    mirror: Mirror,
    *,
    camera: Camera,
    tolerances: Tolerances | None = None,
    count: int = 1000,
    reach_m: float = 12.0,
    seed: int = 1,
    progress: bool = True,
) -> GroundErrors:
    """Makes `count` imperfect mirrors and asks each where the ground lies; a tenth as many for each cause alone."""
    if count < 10:
        raise ValueError(f"count = {count}: at least 10 mirrors are needed for a 95 % limit")
    tolerances = tolerances or Tolerances()
    traced = PixelErrors(mirror, camera=camera, reach_m=reach_m)
    distance, radius, height = traced.distance_m, traced.radius_m, traced.height_m
    rng = np.random.default_rng(seed)
    alone = max(count // 10, 10)
    with tqdm(total=count + alone * len(ERROR_SOURCES), unit="mirror", disable=not progress, leave=False) as bar:

        def errors(spread: Tolerances, mirrors: int) -> Array:
            found = np.empty((mirrors, 2, distance.size, AZIMUTHS))
            for index in range(mirrors):
                profile = Profile(radius_m=radius, height_m=height + _sample_form_error(radius, spread, rng))
                tilt, offset = rng.normal(size=2) * spread.tilt_deg, rng.normal(size=2) * spread.offset_m
                mount = Mount(
                    mirror_tilt_deg=(float(tilt[0]), float(tilt[1])),
                    mirror_offset_m=(float(offset[0]), float(offset[1])),
                    mirror_raise_m=float(rng.normal() * spread.height_m),
                )
                factor = 1.0 + float(rng.normal()) * spread.focal_share
                found[index] = traced.of(profile, mount=mount, focal_factor=factor).reshape(2, -1, AZIMUTHS)
                bar.update()
            return found

        together = errors(tolerances, count)
        by_cause = {cause: _rms(np.hypot(*np.moveaxis(errors(tolerances.alone(cause), alone), 1, 0)))
                    for cause in ERROR_SOURCES}  # fmt: skip
    total = np.hypot(together[:, 0], together[:, 1])
    lost = ~np.isfinite(total)
    # A lost pixel is worse than any limit.
    ranked = np.where(lost, np.inf, total).transpose(1, 0, 2).reshape(distance.size, -1)
    return GroundErrors(
        distance_m=distance,
        radial_rms_m=_rms(together[:, 0]),
        tangential_rms_m=_rms(together[:, 1]),
        total_95_m=np.quantile(ranked, 0.95, axis=1, method="higher"),
        lost_share=lost.mean(axis=(0, 2)),
        by_cause_rms_m=by_cause,
        count=count,
    )


def _scaled_camera(camera: Camera, mirror: Mirror, *, focal_factor: float) -> Camera:
    return Camera(
        width_px=camera.width_px,
        height_px=camera.height_px,
        focal_px=camera.focal_px * focal_factor,
        pinhole_height_m=mirror.pinhole_height_m,
        centre_px=camera.centre_px,
        forward_deg=camera.forward_deg,
        flipped=camera.flipped,
    )


def _ground_points(camera: Camera, profile: Profile, u: Array, v: Array, mount: Mount) -> Array:
    """Ground points, n × 2, robot frame; NaN where the pixel shows none."""
    origin, direction = trace_points(camera=camera, profile=profile, u_px=u, v_px=v, mount=mount)
    falling = direction[:, 2].astype(np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        way = np.where(falling < 0.0, -origin[:, 2] / falling, np.nan)
    return np.asarray(origin[:, :2] + way[:, None] * direction[:, :2])


def _radial_tangential_errors(nominal: Array, real: Array) -> Array:
    """Errors along and across the line of sight."""
    ahead = nominal / np.linalg.norm(nominal, axis=1, keepdims=True)
    off = real - nominal
    return np.stack([(off * ahead).sum(axis=1), off[:, 1] * ahead[:, 0] - off[:, 0] * ahead[:, 1]])


def _rms(errors: Array) -> Array:
    """Over mirrors and directions; of what is still seen."""
    seen = np.isfinite(errors)
    total = np.where(seen, errors, 0.0) ** 2
    return np.asarray(np.sqrt(total.sum(axis=(0, 2)) / np.maximum(seen.sum(axis=(0, 2)), 1)))


def _sample_form_error(radius: Array, spread: Tolerances, rng: np.random.Generator) -> Array:
    """A smooth random function of the radius with the wanted deviation and length (random Fourier features)."""
    waves = rng.normal(size=FOURIER_FEATURES) / spread.form_length_m
    phases = rng.uniform(0.0, 2.0 * np.pi, size=FOURIER_FEATURES)
    if spread.form_m == 0.0:
        return np.zeros_like(radius)
    error = np.cos(radius[:, None] * waves + phases).sum(axis=1)
    return np.asarray(error * (spread.form_m * np.sqrt(2.0 / FOURIER_FEATURES)))


def shows_ground(mirror: Mirror, *, reach_m: float) -> bool:
    """Does a ray of the mirror meet the ground between 0.25 m and `reach_m`?"""
    return any(_slope_at_ground_distance(mirror, float(wanted)) is not None for wanted in np.arange(0.25, reach_m + 1e-9, 0.25))


def _sample_distances(mirror: Mirror, *, reach_m: float) -> tuple[Array, Array]:
    """Ground distances 0.25 m apart that the mirror shows, and the innermost camera slope that shows each."""
    distances, slopes = [], []
    for wanted in np.arange(0.25, reach_m + 1e-9, 0.25):
        t = _slope_at_ground_distance(mirror, float(wanted))
        if t is not None:
            distances.append(float(wanted))
            slopes.append(t)
    if not distances:
        raise ValueError(f"{mirror.name} shows no ground between 0.25 m and {reach_m} m")
    return np.array(distances), np.array(slopes)


def _slope_at_ground_distance(mirror: Mirror, distance_m: float) -> float | None:
    for segment in mirror.segments:
        if not segment.reflects:
            continue
        t = np.linspace(segment.t_from, segment.t_to, 400)

        def off(t: Array, segment: Segment = segment) -> Array:
            # The distance of a ray that crosses the axis is negative.
            return np.abs(segment.rays(t, mirror.pinhole_height_m).distance_at_m(0.0)) - distance_m

        found = off(t)
        crossing = np.flatnonzero(np.isfinite(found[:-1]) & np.isfinite(found[1:]) & (found[:-1] * found[1:] <= 0.0))
        if crossing.size:
            first = int(crossing[0])
            return float(scipy.optimize.brentq(lambda t, off=off: float(off(np.array([t]))[0]), t[first], t[first + 1]))
    return None
