"""What a robot's pipeline knows after one image: pose, covariance, fit, detections, tracked objects."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mirrorball import _core
from mirrorball.records import Record, equal
from mirrorball.tables import Table, structured_array
from mirrorball.vision import Detections, detections_from_columns

__all__ = ["Advice", "Certificate", "Cycle", "Estimate", "Fit", "Pose", "RunnerUp", "TrackedObject"]


def __dir__() -> list[str]:
    return __all__


class Pose(NamedTuple):
    """Position on the field (metres from its centre) and heading (radians counter-clockwise from its x axis)."""

    x_m: float
    y_m: float
    theta_rad: float


class RunnerUp(NamedTuple):
    """Another pose that explains the line points, with its probability."""

    pose: Pose
    probability: float


class Fit(NamedTuple):
    """How well the set-up fits the measurements of the last seconds (docs/methods.md 16.3)."""

    on_markings: float
    """Share of the line points on markings."""
    residual_m: float
    """Root mean square distance of these points from the markings."""
    markings_seen: float
    """Share of the markings in sight at which a line point was seen."""
    wheels_agree: float | None
    """Agreement of wheels and poses, −1 to 1; None before enough motion."""
    compass_agrees: float | None
    """Mean cosine of the compass's deviation; None before enough readings."""


@dataclass(frozen=True)
class Certificate:
    """Bounds of the exact search on what other poses of the field explain (docs/methods.md 6.9)."""

    points: int
    """Points compared."""
    answer_share: float
    """Share of them that the pose explains."""
    others_share_max: float
    """No other pose explains more."""
    unlisted_share_max: float
    """No pose explains more that is not among the hypotheses."""
    is_attained: bool
    """A pose explains exactly ``others_share_max``."""


@dataclass(frozen=True)
class Advice:
    """What would tell an ambiguous pose from the runner-up (docs/methods.md 6.10)."""

    text: str
    motion: tuple[float, float, float] | None
    """Displacement forward and left (m), turn (rad), in the robot frame; None if no motion tells."""


@dataclass(frozen=True, eq=False)
class Estimate(Record):
    """The robot's pose after one image. Two estimates are equal if all of their numbers are."""

    stamp_s: float
    pose: Pose | None
    """None while the robot is lost."""
    covariance: NDArray[np.float64]
    """Of x, y (m²) and θ (rad²) on the field: 3 × 3. When lost, that of a uniform distribution over the field.

    It supposes that the field half is right. While a pose's `half_known` is False, the pose at half a turn about the field's
    centre may as well be the true one. It is among the `runners_up`, with its probability.
    """
    mode: str
    """tracking, global or lost."""
    reason: str | None
    """Why the pose is not simply tracked."""
    points_used: int
    inlier_share: float
    """Share of this image's line points on markings."""
    residual_m: float
    """Root mean square distance of these points from the markings."""
    tilt_rad: tuple[float, float]
    """Tilt of the robot in this image (docs/methods.md 3.1)."""
    half_known: bool
    """Is it known which half of the field is which? If not, the pose in the other half is among the `runners_up`."""
    twist: tuple[float, float, float] | None
    """Velocity in the robot frame: forward, left (m/s), turn (rad/s); None while lost."""
    collision: bool
    """Wheel samples are skipped because of a collision or of slip."""
    runners_up: tuple[RunnerUp, ...]
    fit: Fit
    certificate: Certificate | None = None
    """What all other poses explain at most; None unless the whole field was searched exactly."""
    advice: Advice | None = None
    """What would make an ambiguous pose certain."""

    @classmethod
    def from_core(cls, cycle: _core.Cycle) -> Estimate:
        """The estimate of a compiled cycle."""
        fields = cycle.estimate()
        if fields["pose"] is not None:
            fields["pose"] = Pose(*fields["pose"])
        fields["fit"] = Fit(*fields["fit"])
        if fields["certificate"] is not None:
            fields["certificate"] = Certificate(*fields["certificate"])
        if fields["advice"] is not None:
            fields["advice"] = Advice(*fields["advice"])
        fields["runners_up"] = tuple(RunnerUp(Pose(*pose), probability) for pose, probability in fields["runners_up"])
        return cls(**fields)


@dataclass(frozen=True, eq=False)
class TrackedObject(Record):
    """A ball or a robot that is tracked from image to image."""

    id: int
    """Constant over the life of the track."""
    position_m: tuple[float, float]
    """Robot frame: forward, left."""
    velocity_mps: tuple[float, float]
    """Over the ground, in the robot's axes."""
    covariance: NDArray[np.float64]
    """Of position and velocity, robot frame: 4 × 4 (m², m²/s, m²/s²)."""
    field_position_m: tuple[float, float] | None
    """On the field; None while the robot is lost."""
    field_velocity_mps: tuple[float, float] | None
    field_covariance: NDArray[np.float64] | None
    """Of position and velocity on the field, the pose's uncertainty included: 4 × 4."""
    probability: float
    """That it exists, 0 to 1."""
    last_seen_s: float
    team: str | None
    """Colour of its team: cyan or magenta."""


class Cycle:
    """The result of one image. Tables are made when they are first read. It can be pickled."""

    def __init__(self, core: _core.Cycle) -> None:
        self._core: _core.Cycle | None = core
        self.estimate = Estimate.from_core(core)
        self.image_fault = core.image_fault
        """Why the image could not be used; None if it was."""
        vision_ms, localization_ms = core.timings_ms
        self.timings_ms = {"vision": vision_ms, "localization": localization_ms}
        """Durations of the stages, milliseconds."""
        self.camera_command = core.camera_command
        """Next exposure and gain of the camera; None: unchanged."""

    @property
    def stamp_s(self) -> float:
        """Time of the image."""
        return self.estimate.stamp_s

    @property
    def pose(self) -> Pose | None:
        """The robot's pose; None while it is lost."""
        return self.estimate.pose

    @property
    def covariance(self) -> NDArray[np.float64]:
        """Of x, y (m²) and θ (rad²) on the field: 3 × 3, if the field half is right (`Estimate.covariance`)."""
        return self.estimate.covariance

    @property
    def mode(self) -> str:
        """One of tracking, global, lost."""
        return self.estimate.mode

    @property
    def reason(self) -> str | None:
        """Why the pose is not simply tracked."""
        return self.estimate.reason

    @property
    def fit(self) -> Fit:
        """How well the set-up fits the measurements of the last seconds."""
        return self.estimate.fit

    @cached_property
    def line_points(self) -> Table:
        """Line points that localization used, robot frame: x_m, y_m, std_radial_m, std_tangential_m."""
        return structured_array(self.core.line_points())

    @cached_property
    def detections(self) -> Detections | None:
        """All detections of the image, as `mirrorball.vision.see` returns them; None without a usable image."""
        columns = self.core.detections()
        return None if columns is None else detections_from_columns(columns)

    @property
    def refused(self) -> Table:
        """Rejected line candidates: u_px, v_px, reason. Empty without a usable image."""
        if self.detections is None:
            return structured_array({"u_px": np.empty(0, np.float32), "v_px": np.empty(0, np.float32), "reason": []})
        return self.detections.refused

    @cached_property
    def ball(self) -> TrackedObject | None:
        """The tracked ball."""
        fields = self.core.ball()
        return None if fields is None else TrackedObject(**fields)

    @cached_property
    def robots(self) -> tuple[TrackedObject, ...]:
        """Tracked robots, the oldest track first."""
        return tuple(TrackedObject(**fields) for fields in self.core.robots())

    def __repr__(self) -> str:
        return f"Cycle(stamp_s={self.stamp_s:.3f}, mode={self.mode!r}, pose={self.pose})"

    def __eq__(self, other: object) -> bool:
        """Equal results; durations differ from run to run."""
        if not isinstance(other, Cycle):
            return NotImplemented
        names = ("image_fault", "camera_command", "estimate", "ball", "robots", "detections", "line_points")
        return all(equal(getattr(self, name), getattr(other, name)) for name in names)

    __hash__ = None  # type: ignore[assignment]

    def __getstate__(self) -> dict[str, Any]:
        for name in ("line_points", "detections", "ball", "robots"):
            getattr(self, name)
        return {**self.__dict__, "_core": None}

    @property
    def core(self) -> _core.Cycle:
        """The compiled cycle; a copy has none, but all tables."""
        if self._core is None:
            raise ValueError("a copied cycle has no compiled half")
        return self._core
