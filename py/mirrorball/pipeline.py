"""The robot's own pipeline in Python: stamped samples in, one cycle per image out.

`Pipeline` is the whole robot, camera included. `Localizer` takes line points of another vision system. Both compute
what `mirrorball locate` computes, with Python's lock released, so that two of them use two cores. Stamps are seconds of one
clock. Samples may arrive in any order; those up to an image's stamp count for it.
"""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike, NDArray

from mirrorball import _core
from mirrorball._core import Field
from mirrorball.arguments import Number, Vector, invalid
from mirrorball.estimates import Cycle, Estimate
from mirrorball.samples import (
    CommandSample,
    CompassSample,
    ImageSample,
    ImuSample,
    OdometrySample,
    Sample,
    TruthSample,
)

__all__ = ["Localizer", "Pipeline"]


def __dir__() -> list[str]:
    return __all__


POINT_STD_M = 0.04
"""Standard deviation of line points that come without one, as in `mirrorball locate`."""

Config = Mapping[str, Any] | str | PathLike[str]
"""Settings by dotted key or nested, {"localize.matching.steps_max": 20}; or the path of an overlay file."""


class _Sensors:
    """Samples that every robot has."""

    _pipeline: _core.Pipeline

    def odometry(self, stamp_s: Number, motion: Vector) -> None:
        """Wheels: motion since the previous sample, in the robot frame at that sample.

        `motion`: forward and left (metres), turn (radians).
        """
        self._pipeline.odometry(stamp_s, motion)

    def imu(self, stamp_s: Number, specific_force_mps2: Vector, angular_velocity_radps: Vector) -> None:
        """Inertial unit: x forward, y left, z up; at rest the specific force is (0, 0, 9.81)."""
        self._pipeline.imu(stamp_s, specific_force_mps2, angular_velocity_radps)

    def compass(self, stamp_s: Number, heading_rad: Number, *, magnetic_field: Vector | None = None) -> None:
        """Compass: direction of the robot's x axis on the field; `magnetic_field` in the robot frame, any unit."""
        self._pipeline.compass(stamp_s, heading_rad, magnetic_field)

    def command(self, stamp_s: Number, velocity: Vector) -> None:
        """Velocity commanded to the motors from `stamp_s` on: forward, left (m/s), turn (rad/s)."""
        self._pipeline.command(stamp_s, velocity)

    def set_pose(self, stamp_s: Number, pose: Vector, *, std: Vector = (0.1, 0.1, 0.1)) -> None:
        """Starts from a known pose (x, y in metres, θ in radians) with these standard deviations."""
        self._pipeline.set_pose(stamp_s, pose, std)


class Localizer(_Sensors):
    """Localization of a robot that has its own vision.

    `field`: a `Field`, or the path of a field.toml. `config`: settings as in `Pipeline`.

    Examples:
        >>> from mirrorball import Localizer, Field
        >>> loc = Localizer(field=Field())
        >>> loc.odometry(0.03, [0.01, 0.0, 0.0])
        >>> loc.points(0.03, [[1.0, 2.0], [1.5, 2.0]]).mode
        'lost'

    """

    def __init__(self, *, field: Field | str | PathLike[str], config: Config | None = None, preset: str = "default") -> None:
        self._pipeline = _core.Pipeline(field=_field(field), config=_config(config), preset=preset)

    def points(self, stamp_s: Number, points: ArrayLike, *, std_m: Number = POINT_STD_M) -> Estimate:
        """Line points of one image in the robot frame, metres; gives the pose.

        `points`: n × 2 (x forward, y left), with the standard deviation `std_m`; or n × 4, with a standard deviation along
        and across the direction from the robot. Of more than 4096 rows those at equal steps count. Raises ValueError for
        another shape or numbers that are not finite.
        """
        return Estimate.from_core(self._pipeline.points(stamp_s, points, std_m))


class Pipeline(_Sensors):
    """A robot with its camera: images in, poses, ball and robots out.

    `robot`: path of a robot.toml, or of a folder that has one. `field`: in place of the robot's. `map`: path of a calibrated
    ground map in place of the robot's. `config`: settings by dotted key, or the path of an overlay file.
    """

    def __init__(
        self,
        robot: str | PathLike[str],
        *,
        field: Field | str | PathLike[str] | None = None,
        map: str | PathLike[str] | None = None,
        config: Config | None = None,
        preset: str = "default",
    ) -> None:
        # Without a robot the compiled pipeline is one for line points alone.
        if not isinstance(robot, str | PathLike):
            raise TypeError(invalid("robot", robot, "a path"))
        if Path(robot).is_dir():
            robot = Path(robot) / "robot.toml"
        self._pipeline = _core.Pipeline(
            robot=robot,
            field=None if field is None else _field(field),
            map=map,
            config=_config(config),
            preset=preset,
        )

    @classmethod
    def of_simulation(cls, simulation: _core.Simulation, *, preset: str, config: Config | None) -> Pipeline:
        """The pipeline of a simulated robot; users call `Simulation.pipeline`."""
        pipeline = cls.__new__(cls)
        pipeline._pipeline = simulation.pipeline(preset=preset, config=_config(config))
        return pipeline

    def image(self, stamp_s: Number, image: NDArray[Any]) -> Cycle:
        """An image as OpenCV reads it: uint8, rows × columns × 3 (blue, green, red) or rows × columns (grey)."""
        return Cycle(self._pipeline.image(stamp_s, image))

    def points(self, stamp_s: Number, points: ArrayLike, *, std_m: Number = POINT_STD_M) -> Cycle:
        """Line points in place of an image, as in `Localizer.points`."""
        return Cycle(self._pipeline.points(stamp_s, points, std_m))

    def process(self, sample: Sample) -> Cycle | None:
        """A sample of any kind, as `mirrorball.Simulation` gives them; an image gives a cycle. Truth is not used."""
        match sample:
            case ImageSample(stamp_s, image):
                return self.image(stamp_s, image)
            case OdometrySample(stamp_s, motion):
                self.odometry(stamp_s, motion)
            case ImuSample(stamp_s, force, rate):
                self.imu(stamp_s, force, rate)
            case CompassSample(stamp_s, heading_rad, magnetic_field):
                self.compass(stamp_s, heading_rad, magnetic_field=magnetic_field)
            case CommandSample(stamp_s, velocity):
                self.command(stamp_s, velocity)
            case TruthSample():
                pass
            case _:
                raise TypeError(f"invalid sample: {type(sample).__name__} (expected a sample of mirrorball.samples)")
        return None


def _field(field: Field | str | PathLike[str]) -> Field:
    # What is no path is refused where the field is used.
    return Field(field) if isinstance(field, str | PathLike) else field


def _config(config: Config | None) -> dict[str, Any] | str | PathLike[str] | None:
    return dict(config) if isinstance(config, Mapping) else config
