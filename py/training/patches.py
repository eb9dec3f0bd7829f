"""Patches of pixels around candidates and their normalisation: the same as crates/vision/src/objects/patch.rs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from view_angles import Floats, ViewAngles

SIDE = 12
COARSE = np.array([0, 2, 4, 7, 9, 11])
BALL_STEP = 0.4
OBSTACLE_STEP_M = 1.0 / 11.0
# Beyond this distance the patch of an obstacle keeps its angles.
OBSTACLE_RANGE_MAX_M = 6.0
FOOT_ROW = 3
LOG_OFFSET = 8.0
PLACES = np.arange(SIDE) - (SIDE - 1) / 2

Inputs = NDArray[np.float32]


def _floor(kind: str, rows: NDArray[np.int_], columns: NDArray[np.int_]) -> NDArray[np.bool_]:
    if kind == "obstacle":
        return np.broadcast_to(rows < FOOT_ROW, np.broadcast_shapes(rows.shape, columns.shape))
    return (rows < 2) | ((rows < SIDE // 2) & ((columns == 0) | (columns == SIDE - 1)))


_ALL = np.arange(SIDE)
FLOOR = {kind: _floor(kind, _ALL[:, None], _ALL[None]) for kind in ("ball", "obstacle")}
COARSE_FLOOR = {kind: _floor(kind, COARSE[:, None], COARSE[None]) for kind in ("ball", "obstacle")}


def ball_positions(
    view: ViewAngles, angle: Floats, azimuth: Floats, half_height: Floats, half_width: Floats, *, jitter: Floats | None = None
) -> tuple[Floats, Floats]:
    """Columns and rows of balls' patches; `jitter`: displacement away and aside in radii, and scale, one row each."""
    away, aside, scale = jitter.T if jitter is not None else (0 * angle, 0 * angle, 1 + 0 * angle)
    angles = angle[:, None] + (PLACES * BALL_STEP * scale[:, None] + away[:, None]) * half_height[:, None]
    azimuths = azimuth[:, None] + (PLACES * BALL_STEP * scale[:, None] + aside[:, None]) * half_width[:, None]
    radius = view.radii_of(angles, np.broadcast_to(azimuth[:, None], angles.shape))
    return _positions(view, radius, azimuths)


def obstacle_positions(
    view: ViewAngles, angle: Floats, azimuth: Floats, range_m: Floats, *, jitter: Floats | None = None
) -> tuple[Floats, Floats]:
    """Columns and rows of obstacles' patches; `jitter`: displacement in rows and metres across, and scale."""
    rows, metres, scale = jitter.T if jitter is not None else (0 * angle, 0 * angle, 1 + 0 * angle)
    range_m = np.minimum(range_m, OBSTACLE_RANGE_MAX_M)
    step = OBSTACLE_STEP_M / np.hypot(range_m, view.height_m) * scale
    angles = angle[:, None] + (rows[:, None] + np.arange(SIDE) - FOOT_ROW) * step[:, None]
    across = np.arctan2(PLACES * OBSTACLE_STEP_M * scale[:, None], range_m[:, None])
    azimuths = azimuth[:, None] + metres[:, None] / np.maximum(range_m, 0.2)[:, None] + across
    radius = view.radii_of(angles, np.broadcast_to(azimuth[:, None], angles.shape))
    return _positions(view, radius, azimuths)


def _positions(view: ViewAngles, radius: Floats, azimuths: Floats) -> tuple[Floats, Floats]:
    u = view.centre_px[0] + radius[:, :, None] * np.cos(azimuths)[:, None]
    v = view.centre_px[1] - radius[:, :, None] * np.sin(azimuths)[:, None]
    return u, v


def read(image: NDArray[np.uint8], u: Floats, v: Floats) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Nearest pixels, black outside the image, and whether they are inside."""
    height, width = image.shape[:2]
    known = np.isfinite(u) & np.isfinite(v)
    column = np.floor(np.where(known, u, -9) + 0.5).astype(int)
    row = np.floor(np.where(known, v, -9) + 0.5).astype(int)
    inside = (column >= 0) & (row >= 0) & (column < width) & (row < height)
    pixels = image[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)].copy()
    pixels[~inside] = 0
    return pixels, inside


def normalize(kind: str, colours: NDArray[np.generic], inside: NDArray[np.bool_], contrast: Inputs | None = None) -> Inputs:
    """Network inputs (n, 3, side, side) of colours (n, side, side, 3): brightness, colour difference, saturation.

    `contrast`: factors (n, 3, 1) of the channels before they are limited.
    """
    side, count = colours.shape[1], len(colours)
    floor = (FLOOR[kind] if side == SIDE else COARSE_FLOOR[kind]).ravel()
    planes = np.ascontiguousarray(colours.reshape(count, -1, 3).transpose(2, 0, 1))
    logs = np.log(np.clip(planes, 0, 255) + LOG_OFFSET).astype(np.float32)
    reference = np.median(np.ascontiguousarray(logs[:, :, floor]), 2)
    relative = logs - reference[:, :, None]
    saturation = logs.max(0) - logs.min(0) - (reference.max(0) - reference.min(0))[:, None]
    channels = np.stack([relative.mean(0), relative.max(0) - relative.min(0), saturation], 1)
    if contrast is not None:
        channels = channels * contrast
    channels = np.clip(channels, -2, 2).reshape(count, 3, side, side)
    return channels * inside[:, None] if kind == "obstacle" else channels


def coarse(patches: NDArray[np.generic]) -> NDArray[np.generic]:
    """Every second row and column."""
    return patches[:, COARSE][:, :, COARSE]
