"""What does a small imperfection of mirror or mount cost on the ground? One at a time, of a size that a workshop knows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mirrorball._core import Camera, Mount, Profile
from mirrorball.arguments import checked
from mirrorball.mirror.profile_design import Mirror
from mirrorball.mirror.reflection import Array
from mirrorball.mirror.tolerances import AZIMUTHS, PixelErrors, shows_ground
from mirrorball.records import Record

WAVES = 12
"""Waves of the surface that are averaged: where a crest lies decides what it costs."""
WAVE_LENGTH_M = 0.01
SAMPLES = 30_000
"""Interpolation mixes two parts within a few steps of their joint. These steps must be short against the distance that an
imperfection moves a ray on the mirror (some 50 µm), or the cost at a joint is wrong."""


@dataclass(frozen=True, eq=False)
class GroundCost(Record):
    """Errors on the ground that one imperfection causes."""

    imperfection: str
    distance_m: Array
    rms_m: Array
    """Over all directions around the robot."""
    largest_m: Array


@checked
def ground_costs(mirror: Mirror, *, camera: Camera, reach_m: float = 12.0) -> list[GroundCost]:
    """What 0.01 mm of the surface, 0.1° of tilt, 0.1 mm of place and 0.1 % of focal length cost at ground distances.

    Costs grow in proportion as long as they are small: 0.2° costs twice as much as 0.1°. Empty for a mirror that shows no
    ground.
    """
    if not shows_ground(mirror, reach_m=reach_m):
        return []
    errors = PixelErrors(mirror, camera=camera, reach_m=reach_m, step_m=mirror.radius_m / SAMPLES)
    radius, height = errors.radius_m, errors.height_m

    def waves() -> list[Array]:
        found = []
        for phase in np.arange(WAVES) * (2.0 * np.pi / WAVES):
            wave = 1e-5 * np.cos(2.0 * np.pi * radius / WAVE_LENGTH_M + phase)
            found.append(errors.of(Profile(radius_m=radius, height_m=height + wave)))
        return found

    causes: dict[str, Callable[[], list[Array]]] = {
        "surface wavy by ± 0.01 mm over 10 mm": waves,
        "mirror tilted by 0.1°": lambda: [errors.of(mount=Mount(mirror_tilt_deg=(0.1, 0.0)))],
        "mirror 0.1 mm off the camera's axis": lambda: [errors.of(mount=Mount(mirror_offset_m=(1e-4, 0.0)))],
        "mirror 0.1 mm too high": lambda: [errors.of(mount=Mount(mirror_raise_m=1e-4))],
        "focal length off by 0.1 %": lambda: [errors.of(focal_factor=1.001)],
    }
    costs = []
    for name, traced in causes.items():
        total = np.concatenate([np.hypot(*found.reshape(2, -1, AZIMUTHS)) for found in traced()], axis=1)
        seen = np.isfinite(total)
        squares = np.where(seen, total, 0.0) ** 2
        count = seen.sum(axis=1)
        rms = np.sqrt(squares.sum(axis=1) / np.maximum(count, 1))
        costs.append(
            GroundCost(
                imperfection=name,
                distance_m=errors.distance_m,
                rms_m=np.where(count > 0, rms, np.nan),
                largest_m=np.where(count > 0, np.where(seen, total, 0.0).max(axis=1), np.nan),
            )
        )
    return costs


def cost_rows(
    costs: list[GroundCost], distances_m: tuple[float, ...] = (1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 10.0)
) -> list[list[str]]:
    """A table for people: the distances that the mirror shows, then one row for each imperfection, millimetres rms."""
    if not costs:
        return [["The mirror shows no ground."]]
    shown = [wanted for wanted in distances_m if np.abs(costs[0].distance_m - wanted).min() < 1e-6]
    rows = [["rms error on the ground, mm, at", *(f"{wanted:.0f} m" for wanted in shown)]]
    for cost in costs:
        at = [int(np.argmin(np.abs(cost.distance_m - wanted))) for wanted in shown]
        rows.append([cost.imperfection, *(f"{1e3 * cost.rms_m[index]:.1f}" for index in at)])
    return rows
