"""One's own hall in the mirror: a scenario's scene with the design, beside the floor that its ideal map makes of it."""

from __future__ import annotations

import json
import tempfile
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mirrorball._core import Camera, Field, Mount, ground_map, render
from mirrorball.arguments import checked
from mirrorball.mirror.cad_export import write_csv
from mirrorball.mirror.profile_design import Mirror
from mirrorball.mirror.reporting import fit_camera
from mirrorball.records import Record
from mirrorball.simulation import Simulation

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FLOOR_PIXEL_M = 0.03
"""Side of a pixel of the floor's picture."""
RING_M = 0.15
"""Half the width of the ring of floor whose median error stands for a distance."""
KEPT_SECTIONS = ("base", "imu", "compass", "body", "exposure")
"""Sections of the scenario's robot that do not speak of the camera."""


@dataclass(frozen=True, eq=False)
class Preview(Record):
    """A scene in a designed mirror."""

    name: str
    image: NDArray[np.uint8]
    """What the camera takes: rows × columns × (red, green, blue), with the scenario's light, robots and mount."""
    ideal: NDArray[np.uint8]
    """The same pose on an empty field, through the upright mirror that the design means."""
    floor: NDArray[np.uint8]
    """`image` laid on the floor by the ideal map, robot frame: forward is up. White where it shows no floor."""
    floor_ideal: NDArray[np.uint8]
    """`ideal` laid on the floor by the same map."""
    reach_m: float
    """The floor's pictures show this far in each direction."""
    pose: tuple[float, float, float]
    time_s: float
    map_error_m: dict[int, float]
    """By distance, metres: how far off the ideal map is (median around the robot), since the scenario mounts the mirror as it
    does."""


@checked
def preview(
    mirror: Mirror, *, scenario: str | Path, camera: Camera | None = None, time_s: float = 0.0, reach_m: float = 5.0
) -> Preview:
    """Takes the scenario's first image from `time_s` on with this mirror and camera on its robot.

    The robot keeps its wheels, sensors and body. ValueError if the scenario ends before.
    """
    if not (np.isfinite(time_s) and time_s >= 0.0):
        raise ValueError(f"time_s = {time_s:g} must not be negative")
    camera = camera or fit_camera(mirror)
    path = Path(scenario)
    plan = tomllib.loads(path.read_text(encoding="utf-8"))
    if "robot" not in plan:
        raise ValueError(f"{path} names no robot, whose mirror this could be")
    with tempfile.TemporaryDirectory(prefix="mirrorball-") as folder:
        robot = _write_robot(mirror, camera, path.parent / plan["robot"], Path(folder))
        simulation = Simulation(path, change={"robot": str(robot)})
        if time_s >= simulation.duration_s:
            raise ValueError(f"time_s = {time_s:g} is beyond the scenario, which lasts {simulation.duration_s:g} s")
        while True:
            step = simulation.step()
            if step.image is not None and step.samples[-1].stamp_s >= time_s:
                break
    image = np.ascontiguousarray(step.image[:, :, ::-1])
    truth = step.truth.pose
    pose = (truth.x_m, truth.y_m, truth.theta_rad)
    field = Field((path.parent / plan["field"]).resolve()) if isinstance(plan.get("field"), str) else Field()
    ideal = render(camera=camera, profile=mirror.profile(), field=field, pose=pose, own_body=False)
    pixels = _floor_pixels(mirror, camera, reach_m)
    return Preview(
        name=mirror.name,
        image=image,
        ideal=ideal,
        floor=_floor(image, pixels),
        floor_ideal=_floor(ideal, pixels),
        reach_m=reach_m,
        pose=pose,
        time_s=step.samples[-1].stamp_s,
        map_error_m=_map_error(mirror, camera, plan.get("mount", {}), reach_m),
    )


@checked
def plot_preview(shown: Preview) -> Figure:
    """Above the image and its floor, below what the ideal mirror shows of the empty field."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, 10.4), dpi=90)
    reach = shown.reach_m
    x, y, theta = shown.pose
    pictures = (
        ("the scene in the mirror", shown.image, None),
        ("its floor by the ideal map", shown.floor, reach),
        ("the empty field in the ideal mirror", shown.ideal, None),
        ("its floor by the ideal map", shown.floor_ideal, reach),
    )
    for number, (title, picture, extent) in enumerate(pictures):
        ax = figure.add_axes((0.03 + 0.49 * (number % 2), 0.49 - 0.47 * (number // 2), 0.44, 0.43))
        ax.set_title(title, fontsize=10)
        if extent is None:
            ax.imshow(picture)
            ax.set_axis_off()
            continue
        ax.imshow(picture, extent=(extent, -extent, -extent, extent))
        turn = np.linspace(0.0, 2.0 * np.pi, 181)
        for radius in range(1, int(reach) + 1):
            ax.plot(radius * np.cos(turn), radius * np.sin(turn), color="#c8553d", linewidth=0.6)
            if radius < reach:
                ax.text(0.0, radius, f"{radius} m", color="#c8553d", fontsize=7, ha="center", va="bottom")
        ax.plot([0.0], [0.0], "+", color="#c8553d")
        ax.set(xlim=(extent, -extent), ylim=(-extent, extent), xticks=[], yticks=[])
    errors = ", ".join(f"{100.0 * error:.0f} cm at {distance} m" for distance, error in shown.map_error_m.items())
    off = f"\nthe scenario's mount puts the floor off by {errors}" if errors else ""
    figure.text(0.5, 0.965, f"{shown.name} at {x:.2f} m, {y:.2f} m, {np.degrees(theta):.0f}°, {shown.time_s:.2f} s{off}",
                ha="center", va="center", fontsize=11)  # fmt: skip
    return figure


def _write_robot(mirror: Mirror, camera: Camera, base: Path, folder: Path) -> Path:
    """robot.toml with this camera and mirror, and what else the scenario's robot has."""
    robot = tomllib.loads(base.read_text(encoding="utf-8"))
    write_csv(mirror, folder / "mirror.csv")
    sections: dict[str, dict[str, Any]] = {
        "camera": {
            "width_px": camera.width_px,
            "height_px": camera.height_px,
            "focal_px": camera.focal_px,
            "centre_px": list(camera.centre_px),
            "height": camera.pinhole_height_m,
            "forward_deg": camera.forward_deg,
            "flipped": camera.flipped,
        },
        "mirror": {"profile": "mirror.csv"},
    }
    if camera.outer_radius_px is not None:
        sections["camera"]["outer_radius_px"] = camera.outer_radius_px
    sections |= {name: robot[name] for name in KEPT_SECTIONS if name in robot}
    lines = []
    if isinstance(robot.get("field"), str):
        lines.append(f"field = {json.dumps(str((base.parent / robot['field']).resolve()))}")
    for name, keys in sections.items():
        lines.append(f"[{name}]")
        # JSON's numbers, texts and lists of them are TOML's, too; no section that is kept holds tables.
        lines += [f"{key} = {json.dumps(value)}" for key, value in keys.items() if not isinstance(value, dict)]
    path = folder / "robot.toml"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def _floor_pixels(mirror: Mirror, camera: Camera, reach_m: float) -> NDArray[np.int64]:
    """Index of the pixel whose ground point is nearest to each place of the floor; −1 where none is close."""
    # Loading it takes a tenth of a second, which only previews should pay.
    from scipy.spatial import cKDTree

    seen = ground_map(camera=camera, profile=mirror.profile())
    x, y = seen.x_m.ravel(), seen.y_m.ravel()
    near = np.flatnonzero(np.hypot(x, y) < 1.2 * reach_m)
    if not near.size:
        raise ValueError(f"{mirror.name} shows no floor within {reach_m:g} m")
    along = np.arange(reach_m, -reach_m, -FLOOR_PIXEL_M)
    ahead, aside = np.meshgrid(along, along, indexing="ij")
    places = np.stack([ahead.ravel(), aside.ravel()], axis=1)
    apart, index = cKDTree(np.stack([x[near], y[near]], axis=1)).query(places)
    # Beyond this a picture would be smeared over what no pixel shows.
    reached = apart < 0.05 + 0.05 * np.hypot(places[:, 0], places[:, 1])
    return np.where(reached, near[index], -1).reshape(ahead.shape)


def _floor(image: NDArray[np.uint8], pixels: NDArray[np.int64]) -> NDArray[np.uint8]:
    floor = image.reshape(-1, 3)[pixels]
    floor[pixels < 0] = 255
    return floor


def _map_error(mirror: Mirror, camera: Camera, mount: dict[str, Any], reach_m: float) -> dict[int, float]:
    """Median distance, metres, between the ideal map and that of the scenario's mount, at each whole metre."""
    real_mount = Mount(
        lean_deg=_pair(mount.get("lean_deg")),
        mirror_tilt_deg=_pair(mount.get("mirror_tilt_deg")),
        mirror_offset_m=_pair(mount.get("mirror_offset")),
        mirror_raise_m=float(mount.get("mirror_raise", 0.0)),
    )
    ideal = ground_map(camera=camera, profile=mirror.profile())
    real = ground_map(camera=camera, profile=mirror.profile(), mount=real_mount)
    distance = np.hypot(ideal.x_m, ideal.y_m)
    off = np.hypot(real.x_m - ideal.x_m, real.y_m - ideal.y_m)
    errors = {}
    for metre in range(1, int(reach_m) + 1):
        around = off[np.abs(distance - metre) < RING_M]
        if np.isfinite(around).any():
            errors[metre] = float(np.nanmedian(around))
    return errors


def _pair(value: Any) -> tuple[float, float]:
    return (float(value[0]), float(value[1])) if value is not None else (0.0, 0.0)
