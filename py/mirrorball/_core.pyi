"""Types of the compiled half."""

from collections.abc import Callable, Iterator, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mirrorball.arguments import Number as _Number
from mirrorball.arguments import Vector as _Vector
from mirrorball.arguments import Whole as _Whole

__version__: str
__all__ = [
    "Camera",
    "ColourTable",
    "Cycle",
    "Field",
    "GroundMap",
    "LogError",
    "LogReader",
    "Mount",
    "Pipeline",
    "Profile",
    "Simulation",
    "Vision",
    "__version__",
    "calibrate_lines",
    "calibrate_mask",
    "calibrate_sizes",
    "calibrate_strip",
    "colours_from_labels",
    "findings",
    "ground_map",
    "learn_colours",
    "render",
    "scenario_files",
    "simulate",
    "trace_points",
    "trace_rays",
]

@final
class Profile:
    """A mirror of revolution: height above the ground over radius, smooth between its samples."""

    def __new__(cls, *, radius_m: ArrayLike, height_m: ArrayLike) -> Profile: ...
    @staticmethod
    def load(path: str | PathLike[str]) -> Profile: ...
    @property
    def radius_m(self) -> NDArray[np.float64]: ...
    @property
    def height_m(self) -> NDArray[np.float64]: ...
    def height_and_slope(self, radius_m: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]: ...
    def __getnewargs_ex__(self) -> tuple[tuple[()], dict[str, Any]]: ...

@final
class Camera:
    """A pinhole camera looking straight up into the mirror, as `[camera]` of robot.toml states it."""

    def __new__(
        cls,
        *,
        width_px: _Whole,
        height_px: _Whole,
        focal_px: _Number | None = None,
        pinhole_height_m: _Number | None = None,
        centre_px: _Vector | None = None,
        forward_deg: _Number = 90.0,
        flipped: bool = True,
        outer_radius_px: _Number | None = None,
    ) -> Camera: ...
    @staticmethod
    def of_map(map: GroundMap) -> Camera: ...
    @staticmethod
    def load(path: str | PathLike[str]) -> Camera: ...
    @property
    def width_px(self) -> int: ...
    @property
    def height_px(self) -> int: ...
    @property
    def focal_px(self) -> float: ...
    @property
    def pinhole_height_m(self) -> float: ...
    @property
    def centre_px(self) -> tuple[float, float]: ...
    @property
    def forward_deg(self) -> float: ...
    @property
    def flipped(self) -> bool: ...
    @property
    def outer_radius_px(self) -> float | None: ...
    def __getnewargs_ex__(self) -> tuple[tuple[()], dict[str, Any]]: ...

@final
class Mount:
    """How far camera and mirror sit off from where they should; without arguments, not at all.

    Pairs are along the robot's x (forward) and y (left).

    - `lean_deg`: tilt of the whole rig about the ground point below it, degrees. A positive x moves its top forward, and the
      camera sees less far ahead. `Estimate.tilt_rad` has the opposite sign (docs/methods.md 3.1).
    - `mirror_tilt_deg`: tilt of the mirror against the camera's axis about the mirror's apex, degrees. A positive x moves the
      top of the mirror's axis forward.
    - `mirror_offset_m`: offset of the mirror's axis from the camera's, metres.
    - `mirror_raise_m`: height of the mirror above the one that its profile states, metres.

    ValueError for numbers that are not finite.
    """

    def __new__(
        cls,
        *,
        lean_deg: _Vector = (0.0, 0.0),
        mirror_tilt_deg: _Vector = (0.0, 0.0),
        mirror_offset_m: _Vector = (0.0, 0.0),
        mirror_raise_m: _Number = 0.0,
    ) -> Mount: ...
    def __getnewargs_ex__(self) -> tuple[tuple[()], dict[str, Any]]: ...

@final
class GroundMap:
    """Pixel → ground point in the robot frame, rows × columns."""

    def __new__(cls, *, x_m: ArrayLike, y_m: ArrayLike) -> GroundMap: ...
    @property
    def x_m(self) -> NDArray[np.float32]: ...
    @property
    def y_m(self) -> NDArray[np.float32]: ...
    @staticmethod
    def load(path: str | PathLike[str]) -> GroundMap: ...
    def save(self, path: str | PathLike[str]) -> None: ...
    def __getnewargs_ex__(self) -> tuple[tuple[()], dict[str, Any]]: ...

def trace_rays(
    *, camera: Camera, profile: Profile, mount: Mount | None = None
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Origin (metres) and unit direction of each pixel's ray: rows × columns × 3, NaN off the mirror.

    Robot frame: x forward, y left, z up from the ground.
    """

def trace_points(
    *,
    camera: Camera,
    profile: Profile,
    u_px: ArrayLike,
    v_px: ArrayLike,
    mount: Mount | None = None,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Origin (metres) and unit direction of the rays of n image points: n × 3, NaN off the mirror.

    Robot frame: x forward, y left, z up from the ground.
    """

def ground_map(*, camera: Camera, profile: Profile, mount: Mount | None = None) -> GroundMap:
    """Where each pixel's ray meets the ground, in the robot frame: x forward, y left, metres.

    Its origin is the ground point below the pinhole of an upright rig. NaN off the mirror and where a ray meets no ground.
    """

@final
class Field:
    """A soccer field with its markings; without a path, the league's of 18 × 12 m."""

    def __new__(cls, path: str | PathLike[str] | None = None) -> Field: ...
    @staticmethod
    def from_toml(text: str) -> Field: ...
    def to_toml(self) -> str: ...
    @property
    def length_m(self) -> float: ...
    @property
    def width_m(self) -> float: ...

def render(
    *,
    camera: Camera,
    profile: Profile,
    field: Field,
    pose: _Vector,
    mount: Mount | None = None,
    ball: _Vector | None = None,
    robots: ArrayLike = (),
    own_body: bool = True,
    exposure: _Number = 1.0,
    blur_px: _Number = 1.3,
    seed: _Whole = 1,
) -> NDArray[np.uint8]:
    """Render the image from a pose (x, y in metres, θ in radians): rows × columns × (red, green, blue)."""

@final
class ColourTable:
    """A class for every colour."""

    @staticmethod
    def load(path: str | PathLike[str]) -> ColourTable: ...
    def save(self, path: str | PathLike[str]) -> None: ...
    @staticmethod
    def from_bytes(content: bytes) -> ColourTable: ...
    def to_bytes(self) -> bytes: ...
    @property
    def names(self) -> list[str]: ...
    def classify(self, image: NDArray[Any]) -> NDArray[np.uint8]: ...

@final
class Vision:
    """Vision of one camera; `mirrorball.vision.Vision` names the columns of its detections."""

    def __new__(
        cls,
        *,
        map: GroundMap,
        line_width_m: _Number,
        camera: Camera | None = None,
        mask: NDArray[np.bool_] | None = None,
        settings: str | None = None,
    ) -> Vision: ...
    @property
    def scan_pixels(self) -> int: ...
    @property
    def scan_coverage(self) -> float: ...
    def set_colour_table(self, colours: ColourTable) -> None: ...
    def reset_colour_model(self) -> None: ...
    def process(self, image: NDArray[Any]) -> dict[str, Any]: ...

def calibrate_strip(
    *,
    camera: Camera,
    images: Sequence[NDArray[Any]],
    directions_rad: ArrayLike,
    first_edge_m: _Number,
    spacing_m: _Number,
    bars: _Whole,
    width_m: _Number,
    first_bar: str,
) -> tuple[GroundMap, float, list[tuple[int, int, float, str | None]]]: ...
def calibrate_lines(
    *,
    camera: Camera,
    start: GroundMap,
    field: Field,
    images: Sequence[NDArray[Any]],
    settings: str | None = None,
) -> tuple[GroundMap, float, float, list[tuple[int, int, float, str | None]]]: ...
def calibrate_mask(*, camera: Camera, images: Sequence[NDArray[Any]]) -> NDArray[np.bool_]: ...
def calibrate_sizes(
    *,
    map: GroundMap,
    images: Sequence[NDArray[Any]],
    line_width_m: _Number,
    camera: Camera | None = None,
    settings: str | None = None,
) -> list[tuple[str, NDArray[np.float32]]]: ...
def learn_colours(
    *,
    map: GroundMap,
    images: Sequence[NDArray[Any]],
    line_width_m: _Number,
    over: str,
    camera: Camera | None = None,
    settings: str | None = None,
) -> tuple[ColourTable, list[tuple[int, int, float, str | None]]]: ...
def colours_from_labels(path: str | PathLike[str], *, over: str) -> ColourTable: ...
def simulate(
    scenario: str | PathLike[str],
    *,
    preset: str,
    images: str,
    seed: _Whole | None = None,
    duration_s: _Number | None = None,
    change: dict[str, Any] | None = None,
    config: dict[str, Any] | str | PathLike[str] | None = None,
    record: str | PathLike[str] | None = None,
    progress: Callable[[float], object] | None = None,
) -> dict[str, Any]:
    """Runs a scenario and returns its summary, the same as `mirrorball sim --json` prints."""

def scenario_files(scenario: str | PathLike[str]) -> list[Path]:
    """Every file that a scenario needs, itself first."""

@final
class Simulation:
    """A running scenario."""

    def __new__(
        cls,
        scenario: str | PathLike[str],
        *,
        images: bool,
        seed: _Whole | None = None,
        duration_s: _Number | None = None,
        change: dict[str, Any] | None = None,
    ) -> Simulation: ...
    @property
    def duration_s(self) -> float: ...
    @property
    def time_s(self) -> float: ...
    def next_sample(self) -> tuple[Any, ...]: ...
    def command(self, velocity: _Vector | None) -> None: ...
    def kidnap(self, pose: _Vector) -> None: ...
    def push(self, impulse: _Vector) -> None: ...
    def place_ball(self, position: _Vector, velocity: _Vector, height: _Number, vertical_velocity: _Number) -> None: ...
    def place_robot(self, index: _Whole, pose: _Vector) -> None: ...
    def set_light(self, level: _Number | None) -> None: ...
    def set_camera(self, exposure: _Number, gain: _Number) -> None: ...
    def apply_camera_command(self, cycle: Cycle) -> None: ...
    def pipeline(self, *, preset: str, config: dict[str, Any] | str | PathLike[str] | None = None) -> Pipeline: ...

@final
class Pipeline:
    """A robot's pipeline: vision and localization in order."""

    def __new__(
        cls,
        *,
        preset: str,
        robot: str | PathLike[str] | None = None,
        field: Field | None = None,
        map: str | PathLike[str] | None = None,
        config: dict[str, Any] | str | PathLike[str] | None = None,
    ) -> Pipeline: ...
    def odometry(self, stamp_s: _Number, motion: _Vector) -> None: ...
    def imu(
        self,
        stamp_s: _Number,
        specific_force_mps2: _Vector,
        angular_velocity_radps: _Vector,
    ) -> None: ...
    def compass(self, stamp_s: _Number, heading_rad: _Number, magnetic_field: _Vector | None = None) -> None: ...
    def command(self, stamp_s: _Number, velocity: _Vector) -> None: ...
    def set_pose(self, stamp_s: _Number, pose: _Vector, std: _Vector) -> None: ...
    def image(self, stamp_s: _Number, image: NDArray[Any]) -> Cycle: ...
    def points(self, stamp_s: _Number, points: ArrayLike, std_m: _Number) -> Cycle: ...

@final
class Cycle:
    """What is known after one image."""

    def estimate(self) -> dict[str, Any]: ...
    def line_points(self) -> dict[str, NDArray[np.float32]]: ...
    def detections(self) -> dict[str, Any] | None: ...
    def ball(self) -> dict[str, Any] | None: ...
    def robots(self) -> list[dict[str, Any]]: ...
    @property
    def image_fault(self) -> str | None: ...
    @property
    def timings_ms(self) -> tuple[float, float]: ...
    @property
    def camera_command(self) -> tuple[float, float] | None: ...

class LogError(ValueError):
    """The file is no log of mirrorball, or it is damaged."""

@final
class LogReader:
    """A log's topics. Each call reads the file anew and holds one chunk of it."""

    def __new__(cls, path: str | PathLike[str]) -> LogReader: ...
    @property
    def complete(self) -> bool: ...
    @property
    def metadata(self) -> dict[str, str]: ...
    @property
    def message_counts(self) -> dict[str, int]: ...
    @property
    def schemas(self) -> dict[str, str]: ...
    def files(self) -> dict[str, bytes]: ...
    def columns(
        self, topic: str, *, elements: Sequence[str], start_s: _Number | None = None, stop_s: _Number | None = None
    ) -> dict[str, NDArray[Any]]: ...
    def rows(
        self, topic: str, field: str, *, start_s: _Number | None = None, stop_s: _Number | None = None
    ) -> dict[str, NDArray[Any]]: ...
    def log_times(self, topic: str) -> NDArray[np.uint64]: ...
    def messages(
        self, topics: Sequence[str], *, start_s: _Number | None = None, stop_s: _Number | None = None
    ) -> Iterator[tuple[str, int, Any]]: ...
    def images(
        self, *, start_s: _Number | None = None, stop_s: _Number | None = None
    ) -> Iterator[tuple[int, NDArray[np.uint8]]]: ...

def findings(path: str | PathLike[str]) -> tuple[int, list[tuple[str, str, float, float, float, float, list[str], str]]]:
    """Number of cycles of a log, and its findings in order of time.

    Each is kind, severity, start, stop and worst stamp (s), size, causes and sentence.
    """
