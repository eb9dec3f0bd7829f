"""Candidates and their labels from labelled photographs and from simulated recordings."""

from __future__ import annotations

import csv
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import patches
from matplotlib import image as image_file
from numpy.typing import NDArray
from view_angles import BALL_RADIUS, Floats, ViewAngles

VIEWPOINT_HEIGHT_M = 0.78
BALL_RANGES_M = (0.35, 6.5)
OBSTACLE_RANGES_M = (0.35, 5.5)
ROBOT_RADIUS_M = 0.25
NEGATIVE, ROBOT, PERSON, IGNORED = 0, 1, 2, -1

Pixels = NDArray[np.uint8]


@dataclass
class Ball:
    """A ball in view angles."""

    angle: float
    azimuth: float
    half_height: float
    half_width: float
    range_m: float
    usable: bool = True


@dataclass
class Obstacle:
    """Outline of a robot or person about its middle azimuth: near edge in view angle by azimuth."""

    kind: int
    azimuth: float
    offsets: Floats
    near_angles: Floats


@dataclass
class Samples:
    """Patches of one image."""

    camera: str
    balls: list[Pixels] = field(default_factory=list)
    ball_negatives: Pixels = field(default_factory=lambda: np.zeros((0, patches.SIDE, patches.SIDE, 3), np.uint8))
    ball_backgrounds: Pixels = field(default_factory=lambda: np.zeros((0, patches.SIDE, patches.SIDE, 3), np.uint8))
    obstacles: list[tuple[int, int, Pixels, NDArray[np.bool_]]] = field(default_factory=list)
    obstacle_negatives: Pixels = field(default_factory=lambda: np.zeros((0, patches.SIDE, patches.SIDE, 3), np.uint8))
    obstacle_inside: NDArray[np.bool_] = field(default_factory=lambda: np.zeros((0, patches.SIDE, patches.SIDE), bool))


class Camera:
    """A recording folder with a ground map (its own, or a similar robot's)."""

    def __init__(self, folder: Path, *, map_file: Path | None = None, centre_px: tuple[float, float] | None = None) -> None:
        self.folder = folder
        robot = tomllib.loads((folder / "robot.toml").read_text())
        camera = robot["camera"]
        with np.load(map_file or folder / "map.npz") as arrays:
            x, y = arrays["x_m"].astype(float), arrays["y_m"].astype(float)
        self.ranges = np.hypot(x, y)
        centre = centre_px or tuple(camera["centre_px"])
        rim = camera.get("outer_radius_px", 0.98 * min(x.shape) / 2)
        self.view = ViewAngles(x, y, centre, rim, _viewpoint_height(folder))
        with (folder / "frames.csv").open() as file:
            self.frames = [(row["stamp_s"], row["file"]) for row in csv.DictReader(file)]

    def image(self, file: str) -> Pixels:
        """Red, green and blue of a picture."""
        pixels = image_file.imread(self.folder / file)[:, :, :3]
        return pixels if pixels.dtype == np.uint8 else np.round(255 * pixels).astype(np.uint8)

    def ball_grid(self) -> NDArray[np.float64]:
        """Angle, azimuth, half height and width of places in steps of 0.7 radii, one row each."""
        rows = []
        angle, last = (self.view.ball_angles(np.array(r))[0] for r in BALL_RANGES_M)
        while angle < last:
            _, half_height, half_width = self.view.ball_angles(np.tan(angle) * (self.view.height_m - BALL_RADIUS))
            count = int(np.ceil(2 * np.pi / (0.7 * half_width)))
            rows += [(angle, 2 * np.pi * n / count, half_height, half_width) for n in range(count)]
            angle = angle + 0.7 * half_height
        return self._visible(np.array(rows))

    def obstacle_grid(self) -> NDArray[np.float64]:
        """Angle, azimuth and distance of foot points, one row each."""
        rows = []
        angle, last = (np.arctan2(r, self.view.height_m) for r in OBSTACLE_RANGES_M)
        while angle < last:
            range_m = self.view.height_m * np.tan(angle)
            count = int(np.ceil(2 * np.pi * range_m / 0.12))
            rows += [(angle, 2 * np.pi * n / count, range_m) for n in range(count)]
            angle += 0.08 / np.hypot(range_m, self.view.height_m)
        return self._visible(np.array(rows))

    def _visible(self, grid: NDArray[np.float64]) -> NDArray[np.float64]:
        radius = self.view.radii_of(grid[:, 0], grid[:, 1])
        return grid[np.isfinite(radius) & (radius < self.view.rim_px - 2)]


def _viewpoint_height(folder: Path) -> float:
    """Height of the mirror at its mean radius, as the pipeline takes it; the default without a profile."""
    profile = folder / "mirror.csv"
    if not profile.exists():
        return VIEWPOINT_HEIGHT_M
    table = np.loadtxt(profile, delimiter=",", skiprows=1)
    return float(np.interp((table[0, 0] + table[-1, 0]) / 2, table[:, 0], table[:, 1]))


def _outline(camera: Camera, text: str) -> tuple[Floats, Floats]:
    """Image radius and azimuth of points along an outline."""
    corners = np.array([[float(part) for part in corner.split(":")] for corner in text.split()])
    after = np.roll(corners, -1, 0)
    parts = np.linspace(0, 1, 12, endpoint=False)[:, None, None]
    points = (corners + parts * (after - corners)).reshape(-1, 2)
    du, dv = points[:, 0] - camera.view.centre_px[0], camera.view.centre_px[1] - points[:, 1]
    return np.hypot(du, dv), np.arctan2(dv, du)


def labelled_objects(camera: Camera) -> dict[str, tuple[list[Ball], list[Obstacle]]]:
    """Balls and obstacles of object_labels.csv by stamp."""
    objects: dict[str, tuple[list[Ball], list[Obstacle]]] = {}
    view = camera.view
    with (camera.folder / "object_labels.csv").open() as file:
        for row in csv.DictReader(file):
            balls, obstacles = objects.setdefault(row["stamp_s"], ([], []))
            radius, azimuth = _outline(camera, row["polygon_px"])
            middle = float(np.angle(np.exp(1j * azimuth).mean()))
            offset = np.angle(np.exp(1j * (azimuth - middle)))
            middle += float(offset.max() + offset.min()) / 2
            offset = np.angle(np.exp(1j * (azimuth - middle)))
            if row["class"] == "ball":
                near, far = (view.angle_at(float(r), middle) for r in (radius.min(), radius.max()))
                distances = np.linspace(0.2, 12, 3000)
                centres, heights, widths = view.ball_angles(distances)
                best = int(np.argmin(np.abs(centres - heights - near)))
                angle = 0.5 * (centres[best] + (near + far) / 2)
                usable = distances[best] <= 6.3
                balls.append(Ball(angle, middle, heights[best], widths[best], distances[best], usable))
            elif row["class"] in ("robot", "person"):
                offsets = np.linspace(offset.min(), offset.max(), 25)
                reach = max(1.01 * (offsets[1] - offsets[0]), 0.01)
                near_px = [radius[np.abs(offset - place) <= reach].min(initial=1e3) for place in offsets]
                near = np.array([view.angle_at(r, middle + o) for r, o in zip(near_px, offsets, strict=True)])
                obstacles.append(Obstacle(ROBOT if row["class"] == "robot" else PERSON, middle, offsets, near))
    return objects


def simulated_objects(camera: Camera) -> dict[str, tuple[list[Ball], list[Obstacle]]]:
    """Balls and robots of an exported simulation (truth.csv, objects.csv) by stamp; hidden ones are not usable."""
    with (camera.folder / "truth.csv").open() as file:
        poses = {row["stamp_s"]: [float(row[key]) for key in ("x_m", "y_m", "theta_rad")] for row in csv.DictReader(file)}
    bodies: dict[str, list[tuple[str, float, float]]] = {}
    with (camera.folder / "objects.csv").open() as file:
        for row in csv.DictReader(file):
            x, y, heading = poses[row["stamp_s"]]
            dx, dy = float(row["x_m"]) - x, float(row["y_m"]) - y
            cos, sin = np.cos(heading), np.sin(heading)
            bodies.setdefault(row["stamp_s"], []).append((row["kind"], cos * dx + sin * dy, cos * dy - sin * dx))
    forward = _azimuth_of_robot_frame(camera)
    objects: dict[str, tuple[list[Ball], list[Obstacle]]] = {}
    view = camera.view
    for stamp, seen in bodies.items():
        polar = [(kind, float(np.hypot(x, y)), forward(np.arctan2(y, x))) for kind, x, y in seen]
        balls, obstacles = objects.setdefault(stamp, ([], []))
        for index, (kind, range_m, azimuth) in enumerate(polar):
            others = [entry for number, entry in enumerate(polar) if number != index and entry[0] != "ball"]
            hidden = any(r - 0.25 < range_m and _apart(a, azimuth) < 0.33 / r + 0.1 / range_m for _, r, a in others)
            if kind == "ball":
                angle, height, width = (float(part) for part in view.ball_angles(np.array(range_m)))
                balls.append(Ball(angle, azimuth, height, width, range_m, range_m < 6.3 and not hidden))
            elif kind == "robot" and range_m < 9:
                half = 0.19 / range_m
                near = np.arctan2(max(range_m - ROBOT_RADIUS_M, 0.1), view.height_m)
                usable = ROBOT if not hidden and range_m < 6 else IGNORED
                obstacles.append(Obstacle(usable, azimuth, np.linspace(-half, half, 25), np.full(25, near)))
    return objects


def _apart(first: float, second: float) -> float:
    """Difference of two azimuths, radians."""
    return float(np.abs(np.angle(np.exp(1j * (first - second)))))


def _azimuth_of_robot_frame(camera: Camera) -> Callable[[float], float]:
    """Function from a direction in the robot frame to the image azimuth."""
    robot = tomllib.loads((camera.folder / "robot.toml").read_text())["camera"]
    forward, side = np.radians(robot["forward_deg"]), -1.0 if robot["flipped"] else 1.0
    return lambda direction: float(forward + side * direction)
