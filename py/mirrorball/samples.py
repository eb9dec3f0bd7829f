"""Stamped samples of a robot's sensors, as the simulation gives them and `Pipeline.process` takes them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mirrorball.estimates import Pose
from mirrorball.records import Record

__all__ = [
    "CommandSample",
    "CompassSample",
    "ImageSample",
    "ImuSample",
    "OdometrySample",
    "Sample",
    "TruthSample",
    "sample_from_core",
]


def __dir__() -> list[str]:
    return __all__


Vector = tuple[float, float, float]


@dataclass(frozen=True)
class OdometrySample:
    """Motion measured by the wheels since the previous sample, in the robot frame at that sample."""

    stamp_s: float
    motion: Vector
    """Forward and left (metres), turn (radians)."""


@dataclass(frozen=True)
class ImuSample:
    """A reading of the inertial unit, robot frame."""

    stamp_s: float
    specific_force_mps2: Vector
    angular_velocity_radps: Vector


@dataclass(frozen=True)
class CompassSample:
    """A reading of the compass."""

    stamp_s: float
    heading_rad: float
    """Direction of the robot's x axis on the field."""
    magnetic_field: tuple[float, float] | None
    """Horizontal, robot frame, in the unit of the magnetometer."""


@dataclass(frozen=True)
class CommandSample:
    """Velocity commanded to the motors, valid until the next."""

    stamp_s: float
    velocity: Vector
    """Forward, left (m/s), turn (rad/s)."""


@dataclass(frozen=True, eq=False)
class TruthSample(Record):
    """The true state at the time of an image, directly before it. No stage of a pipeline uses it."""

    stamp_s: float
    pose: Pose
    ball: tuple[float, float] | None
    """On the field, metres."""
    robots: NDArray[np.float64]
    """Poses of the other robots on the field: n × 3 (metres, radians)."""
    people: NDArray[np.float64]
    """Positions of people on the field: n × 2, metres."""


@dataclass(frozen=True, eq=False)
class ImageSample(Record):
    """A camera image."""

    stamp_s: float
    """Middle of the exposure."""
    image: NDArray[np.uint8]
    """As OpenCV has it: rows × columns × 3 (blue, green, red)."""


Sample = OdometrySample | ImuSample | CompassSample | CommandSample | TruthSample | ImageSample


def sample_from_core(sample: tuple[Any, ...]) -> Sample:
    """A sample from the name and the numbers that the compiled simulation gives."""
    kind, stamp_s, *values = sample
    match kind:
        case "odometry":
            return OdometrySample(stamp_s, *values)
        case "imu":
            force, rate = values
            return ImuSample(stamp_s, tuple(force), tuple(rate))
        case "compass":
            heading_rad, magnetic_field = values
            return CompassSample(stamp_s, heading_rad, None if magnetic_field is None else tuple(magnetic_field))
        case "command":
            return CommandSample(stamp_s, *values)
        case "truth":
            pose, ball, robots, people = values
            robots = np.array(robots, dtype=np.float64).reshape(-1, 3)
            return TruthSample(stamp_s, Pose(*pose), ball, robots, np.array(people, dtype=np.float64).reshape(-1, 2))
        case "image":
            return ImageSample(stamp_s, *values)
    raise ValueError(f"invalid sample: {kind}")
