"""Another camera's picture of the same patch: other colours, exposure, light, noise and contrast."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

CHANNEL_ORDERS = [(0, 1, 2), (0, 2, 1), (1, 0, 2), (2, 1, 0), (1, 2, 0), (2, 0, 1)]

Floats32 = NDArray[np.float32]


@dataclass(frozen=True)
class Variation:
    """How far other cameras' pictures differ. Ranges are of logarithms."""

    gamma: float
    gain: tuple[float, float]
    # Standard deviation of the noise at most, grey levels.
    noise: float
    # Share of veiling light at most.
    veil: float
    # Share of patches that are pale or saturated, in which light falls off, and in which it veils.
    saturated: float
    falling: float
    veiled: float
    # Objects differ from their floor by other factors.
    contrast: bool


# What a camera of the league shows in another hall.
MILD = Variation(gamma=0.3, gain=(-0.3, 0.4), noise=6, veil=0.15, saturated=0.0, falling=0.0, veiled=1.0, contrast=False)
# Misty mirrors, windows, dim halls, cameras at their defaults.
STRONG = Variation(gamma=0.4, gain=(-0.5, 0.7), noise=9, veil=0.25, saturated=0.3, falling=0.6, veiled=0.6, contrast=True)


def _blurred(planes: Floats32, rng: np.random.Generator) -> Floats32:
    """Blur of a third of the patches, along and across the view by different amounts."""
    count, side = planes.shape[1], planes.shape[2]
    for axis in (2, 3):
        share = (rng.uniform(0, 0.33, (count, 1, 1)) * (rng.random((count, 1, 1)) < 0.35)).astype(np.float32)
        padded = np.concatenate([planes.take([0], axis), planes, planes.take([-1], axis)], axis)
        around = padded.take(range(side), axis) + padded.take(range(2, side + 2), axis)
        planes = planes + share * (around - 2 * planes)
    return planes


def augment(colours: NDArray[np.generic], variation: Variation, rng: np.random.Generator) -> Floats32:
    """Patches mirrored, blurred, with other colours, saturation, exposure, falling light, noise and veiling light."""
    count = len(colours)
    each = (count, 1, 1)

    def uniform(low: float, high: float) -> Floats32:
        return rng.uniform(low, high, each).astype(np.float32)

    def some(share: float) -> Floats32:
        return (rng.random(each) < share).astype(np.float32)

    order = np.array(CHANNEL_ORDERS)[rng.integers(len(CHANNEL_ORDERS), size=count)]
    planes = np.ascontiguousarray(colours.transpose(3, 0, 1, 2), np.float32)
    planes = planes[order.T, np.arange(count)[None]]
    mirrored = rng.random(count) < 0.5
    planes[:, mirrored] = planes[:, mirrored][..., ::-1]
    planes = _blurred(planes, rng)
    grey = planes.mean(0)
    saturation = np.where(some(variation.saturated) > 0, uniform(-1.6, 0.4), uniform(-0.5, 0.4))
    planes = np.clip(grey + (planes - grey) * np.exp(saturation), 0, 255)
    planes = 255 * np.exp(np.log(np.maximum(planes, 0.1) / 255) * np.exp(uniform(-variation.gamma, variation.gamma)))
    # Light that falls off across the patch: a window, a lamp, the rim of the lens.
    places = np.linspace(-1, 1, planes.shape[2], dtype=np.float32)
    slopes = rng.normal(0, 0.3, (2, *each)).astype(np.float32) * some(variation.falling)
    planes = planes * np.exp(slopes[0] * places[:, None] + slopes[1] * places)
    # A bright picture saturates.
    cast = rng.uniform(-0.35, 0.35, (3, *each)).astype(np.float32)
    planes = np.minimum(planes * np.exp(cast + uniform(*variation.gain)), 255)
    planes += rng.standard_normal(planes.shape, np.float32) * uniform(0, variation.noise)
    veil = uniform(0, variation.veil) * some(variation.veiled)
    planes = np.clip(planes * (1 - veil) + veil * uniform(60, 255), 0, 255)
    return np.ascontiguousarray(planes.transpose(1, 2, 3, 0), np.float32)


def contrast(count: int, variation: Variation, rng: np.random.Generator) -> Floats32 | None:
    """Factors of the inputs' channels: an object that differs less or more from its floor, in brightness and in colour."""
    if not variation.contrast:
        return None
    factor = np.repeat(np.exp(rng.uniform(-0.65, 0.35, (count, 1, 1))), 3, 1)
    factor[:, 1:] *= np.exp(rng.uniform(-0.3, 0.3, (count, 1, 1)))
    return factor.astype(np.float32)
