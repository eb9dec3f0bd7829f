"""Types of the compiled half."""

from os import PathLike
from typing import final

import numpy as np
from numpy.typing import NDArray

__version__: str

@final
class Profile:
    """A mirror of revolution: height above the ground over radius, smooth between its samples."""

    def __init__(self, *, radius_m: NDArray[np.float64], height_m: NDArray[np.float64]) -> None: ...
    @staticmethod
    def load(path: str | PathLike[str]) -> Profile: ...
    @property
    def radius_m(self) -> NDArray[np.float64]: ...
    @property
    def height_m(self) -> NDArray[np.float64]: ...
    def height_and_slope(self, radius_m: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]: ...

@final
class Camera:
    """A pinhole camera looking straight up into the mirror, as `[camera]` of robot.toml states it."""

    def __init__(
        self,
        *,
        width_px: int,
        height_px: int,
        focal_px: float,
        pinhole_height_m: float,
        centre_px: tuple[float, float] | None = None,
        forward_deg: float = 90.0,
        flipped: bool = True,
        outer_radius_px: float | None = None,
    ) -> None: ...
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

@final
class Mount:
    """How far camera and mirror sit off from where they should."""

    def __init__(
        self,
        *,
        lean_deg: tuple[float, float] = (0.0, 0.0),
        mirror_tilt_deg: tuple[float, float] = (0.0, 0.0),
        mirror_offset_m: tuple[float, float] = (0.0, 0.0),
        mirror_raise_m: float = 0.0,
    ) -> None: ...

@final
class GroundMap:
    """Pixel → ground point in the robot frame, rows × columns."""

    @property
    def x_m(self) -> NDArray[np.float32]: ...
    @property
    def y_m(self) -> NDArray[np.float32]: ...
    @staticmethod
    def load(path: str | PathLike[str]) -> GroundMap: ...
    def save(self, path: str | PathLike[str]) -> None: ...

def trace_rays(
    *, camera: Camera, profile: Profile, mount: Mount | None = None
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Origin (metres) and unit direction of each pixel's ray: rows × columns × 3, NaN off the mirror."""

def trace_points(
    *,
    camera: Camera,
    profile: Profile,
    u_px: NDArray[np.float64],
    v_px: NDArray[np.float64],
    mount: Mount | None = None,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Origin (metres) and unit direction of the rays of n image points: n × 3, NaN off the mirror."""

def ground_map(*, camera: Camera, profile: Profile, mount: Mount | None = None) -> GroundMap:
    """Where each pixel's ray meets the ground."""

@final
class Field:
    """A soccer field with its markings; without a path, the league's of 18 × 12 m."""

    def __init__(self, path: str | PathLike[str] | None = None) -> None: ...
    @property
    def length_m(self) -> float: ...
    @property
    def width_m(self) -> float: ...

def render(
    *,
    camera: Camera,
    profile: Profile,
    field: Field,
    pose: tuple[float, float, float],
    mount: Mount | None = None,
    ball: tuple[float, float] | None = None,
    robots: list[tuple[float, float, float]] = ...,
    own_body: bool = True,
    exposure: float = 1.0,
    blur_px: float = 1.3,
    seed: int = 1,
) -> NDArray[np.uint8]:
    """Render the image from a pose (x, y in metres, θ in radians): rows × columns × (red, green, blue)."""
