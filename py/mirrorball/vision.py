"""Line points, ball, robots and goals of an image as structured arrays, and the calibrations.

Images are arrays as OpenCV reads them: rows × columns × 3 (blue, green, red) or rows × columns (grey), bytes.
Positions are metres in the robot frame (x forward, y to the left); `u_px`, `v_px` are columns and rows of the image.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mirrorball import _core
from mirrorball._core import Camera, ColourTable, Field, GroundMap
from mirrorball.records import Record
from mirrorball.tables import Table, structured_array

__all__ = [
    "ColourTable",
    "Detections",
    "Residual",
    "Vision",
    "calibrate_lines",
    "calibrate_mask",
    "calibrate_sizes",
    "calibrate_strip",
    "colours_from_labels",
    "detections_from_columns",
    "learn_colours",
    "see",
]


def __dir__() -> list[str]:
    return __all__


Image = NDArray[Any]
"""Bytes. OpenCV types what it reads as integers or floats of any size, so the element type is checked when it runs."""


@dataclass(frozen=True, eq=False)
class Detections(Record):
    """Detections in one image; each table is a structured array with the fields named here.

    `points`: x_m, y_m, std_radial_m, std_tangential_m, u_px, v_px, width_m, contrast.
    `refused`: u_px, v_px, reason: rejected line candidates.
    `ball` (all balls, most certain first), `robots`, `goals`: x_m, y_m, cov_xx_m2, cov_xy_m2, cov_yy_m2, u_px, v_px, score, and
    on_ground, pixels (ball), edge_x_m, edge_y_m, width_m, marker, kind (robots), width_m, kind (goals).
    """

    points: Table
    refused: Table
    ball: Table
    robots: Table
    goals: Table
    carpet_end_m: NDArray[np.float32]
    """Where the carpet ends in each direction around the mirror's axis, from image right towards up; inf: not seen."""
    carpet_share: float
    """Fraction of the scanned pixels that are carpet."""
    bumpers: NDArray[np.bool_]
    """Something stands in the virtual bumper: from the left over the front to the right and round the back."""
    kick: bool
    """The ball touches the kicker."""
    lens_centred: bool | None
    """The camera's lens is where the mirror's axis should be; None if it cannot be determined."""


class Residual(NamedTuple):
    """How well one image agrees with a calibration."""

    image: int
    points: int
    rms_px: float
    left_out: str | None


def detections_from_columns(found: Mapping[str, Any]) -> Detections:
    """The detections of an image from the columns of the compiled half."""
    return Detections(
        points=structured_array(found["points"]),
        refused=structured_array(found["refused"]),
        ball=structured_array(found["ball"]),
        robots=structured_array(found["robots"]),
        goals=structured_array(found["goals"]),
        carpet_end_m=found["carpet_end_m"],
        carpet_share=found["carpet_share"],
        bumpers=found["bumpers"],
        kick=found["kick"],
        lens_centred=found["lens_centred"],
    )


def _load_map(source: GroundMap | str | PathLike[str]) -> GroundMap:
    # What is no path is refused where the map is used, by the name of the argument.
    return GroundMap.load(source) if isinstance(source, str | PathLike) else source


class Vision:
    """Vision of one camera for consecutive images: tables and the colour model are kept from image to image.

    `camera` is taken from the map where it is left out; `mask` is false where the robot sees itself; `settings` is the
    text of a TOML overlay's `[vision]` table, without that heading.
    """

    def __init__(
        self,
        *,
        map: GroundMap | str | PathLike[str],
        camera: Camera | None = None,
        mask: NDArray[np.bool_] | None = None,
        line_width_m: float = 0.125,
        colours: ColourTable | None = None,
        settings: str | None = None,
    ) -> None:
        self._vision = _core.Vision(map=_load_map(map), camera=camera, mask=mask, line_width_m=line_width_m, settings=settings)
        if colours is not None:
            self._vision.set_colour_table(colours)

    @property
    def scan_pixels(self) -> int:
        """Distinct pixels that the scan lines read."""
        return self._vision.scan_pixels

    @property
    def scan_coverage(self) -> float:
        """Their fraction of the image."""
        return self._vision.scan_coverage

    def reset_colour_model(self) -> None:
        """Discards the colour model; the next image gives a new one. For gaps in time and images of another place."""
        self._vision.reset_colour_model()

    def process(self, image: Image) -> Detections:
        """Detections in an image; ValueError if it has another size, or is damaged or black."""
        return detections_from_columns(self._vision.process(image))


def see(
    image: Image,
    *,
    map: GroundMap | str | PathLike[str],
    camera: Camera | None = None,
    mask: NDArray[np.bool_] | None = None,
    line_width_m: float = 0.125,
    colours: ColourTable | None = None,
    settings: str | None = None,
) -> Detections:
    """Detections in one image. For many images of one camera, `Vision` builds its tables only once."""
    vision = Vision(map=map, camera=camera, mask=mask, line_width_m=line_width_m, colours=colours, settings=settings)
    return vision.process(image)


def calibrate_strip(
    *,
    camera: Camera,
    images: Sequence[Image],
    directions_rad: ArrayLike,
    first_edge_m: float,
    spacing_m: float,
    bars: int,
    width_m: float,
    first_bar: str = "black",
) -> tuple[GroundMap, float, list[Residual]]:
    """The ground map from images next to a radial strip of bars: the map, its residual in pixels, and each image's.

    `directions_rad`: where the strip lies in the robot frame in each image.
    """
    found, rms_px, images_found = _core.calibrate_strip(
        camera=camera,
        images=images,
        directions_rad=directions_rad,
        first_edge_m=first_edge_m,
        spacing_m=spacing_m,
        bars=bars,
        width_m=width_m,
        first_bar=first_bar,
    )
    return found, rms_px, [Residual(*row) for row in images_found]


def calibrate_lines(
    *,
    camera: Camera,
    start: GroundMap | str | PathLike[str],
    field: Field,
    images: Sequence[Image],
    settings: str | None = None,
) -> tuple[GroundMap, float, float, list[Residual]]:
    """The ground map from images anywhere on the field, without a strip; `start` may be a fifth off.

    Gives the map, its residual in metres, the share of line points on markings, and each image's residual. ValueError: too few
    different images, images of another field, or images that do not decide the map.
    """
    found, rms_m, share, images_found = _core.calibrate_lines(
        camera=camera, start=_load_map(start), field=field, images=images, settings=settings
    )
    return found, rms_m, share, [Residual(*row) for row in images_found]


def calibrate_mask(*, camera: Camera, images: Sequence[Image]) -> NDArray[np.bool_]:
    """Where the robot does not see itself, from at least six images of it turning in place: rows × columns."""
    return _core.calibrate_mask(camera=camera, images=images)


def calibrate_sizes(
    *,
    map: GroundMap | str | PathLike[str],
    images: Sequence[Image],
    camera: Camera | None = None,
    line_width_m: float = 0.125,
    settings: str | None = None,
) -> Table:
    """Widths of lines and ball in pixels over distance: distance_m, line_px, line_px_by_map, lines, and so of the ball."""
    columns = _core.calibrate_sizes(
        map=_load_map(map), images=images, camera=camera, line_width_m=line_width_m, settings=settings
    )
    return structured_array(dict(columns))


def learn_colours(
    *,
    map: GroundMap | str | PathLike[str],
    images: Sequence[Image],
    camera: Camera | None = None,
    line_width_m: float = 0.125,
    over: str = "yuv",
    settings: str | None = None,
) -> tuple[ColourTable, list[Residual]]:
    """A table of colour classes from images without labels; `over` is "yuv" (16 MiB) or "uv" (64 KiB)."""
    table, images_found = _core.learn_colours(
        map=_load_map(map), images=images, camera=camera, line_width_m=line_width_m, over=over, settings=settings
    )
    return table, [Residual(*row) for row in images_found]


def colours_from_labels(path: str | PathLike[str], *, over: str = "yuv") -> ColourTable:
    """A table of colour classes from labels.csv (file,u,v,class; files relative to it)."""
    return _core.colours_from_labels(path, over=over)
