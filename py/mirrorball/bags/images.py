"""What pixels does an image message hold? Every common encoding as red, green and blue; JPEG and PNG as they are."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["encoded_image"]

Rgb = NDArray[np.uint8]

# Channels of one byte, as they lie in memory, by the names of sensor_msgs/image_encodings.hpp.
CHANNELS = {
    "mono8": (0, 0, 0),
    "8UC1": (0, 0, 0),
    "rgb8": (0, 1, 2),
    "bgr8": (2, 1, 0),
    "8UC3": (2, 1, 0),
    "rgba8": (0, 1, 2),
    "bgra8": (2, 1, 0),
    "8UC4": (2, 1, 0),
}
BYTES_PER_PIXEL = {"mono8": 1, "8UC1": 1, "rgb8": 3, "bgr8": 3, "8UC3": 3, "rgba8": 4, "bgra8": 4, "8UC4": 4}
BAYER = {"bayer_rggb8": "rggb", "bayer_bggr8": "bggr", "bayer_gbrg8": "gbrg", "bayer_grbg8": "grbg"}
# Columns of Y and places of U and V in four bytes of two pixels.
YUV422 = {"yuv422": (1, 0, 2), "uyvy": (1, 0, 2), "yuv422_yuy2": (0, 1, 3), "yuyv": (0, 1, 3)}


def encoded_image(message: Any) -> tuple[bytes, str]:
    """The image as a file: bytes, and the ending of its name. ValueError: an encoding or size that is not usable."""
    if hasattr(message, "encoding"):
        return _png(_pixels(message)), "png"
    data = bytes(message.data)
    if data.startswith(b"\xff\xd8"):
        return data, "jpg"
    if data.startswith(b"\x89PNG\r\n\x1a\n"):
        return data, "png"
    raise ValueError(f"format {message.format!r} (expected jpeg or png)")


def _png(pixels: Rgb) -> bytes:
    from PIL import Image

    file = io.BytesIO()
    Image.fromarray(pixels).save(file, format="png", compress_level=3)
    return file.getvalue()


def _pixels(message: Any) -> Rgb:
    encoding, width, height, step = str(message.encoding), int(message.width), int(message.height), int(message.step)
    data = np.frombuffer(message.data, dtype=np.uint8)
    if encoding == "mono16":
        samples = _rows(data, height, step, 2 * width)
        # The high byte: as an 8-bit camera would see it.
        return _grey(samples[:, 0::2] if message.is_bigendian else samples[:, 1::2])
    if encoding in CHANNELS:
        count = BYTES_PER_PIXEL[encoding]
        samples = _rows(data, height, step, count * width).reshape(height, width, count)
        return np.ascontiguousarray(samples[:, :, CHANNELS[encoding]])
    if encoding in BAYER:
        return _demosaic(_rows(data, height, step, width), BAYER[encoding])
    if encoding in YUV422:
        return _yuv422(_rows(data, height, step, 2 * width), YUV422[encoding])
    raise ValueError(
        f"encoding {encoding!r} (expected mono8, mono16, rgb8, bgr8, rgba8, bgra8, bayer_*8, yuv422 or yuv422_yuy2)"
    )


def _rows(data: Rgb, height: int, step: int, used: int) -> Rgb:
    if height <= 0 or used <= 0 or step < used or data.size < step * (height - 1) + used:
        raise ValueError(f"{data.size} bytes for {height} rows of {step} bytes, of which pixels take {used}")
    padded = np.zeros(step * height, dtype=np.uint8)
    padded[: min(data.size, padded.size)] = data[: padded.size]
    return padded.reshape(height, step)[:, :used]


def _grey(samples: Rgb) -> Rgb:
    return np.ascontiguousarray(np.repeat(samples[:, :, None], 3, axis=2))


def _demosaic(samples: Rgb, pattern: str) -> Rgb:
    """Bilinear: the mean of the nearest samples of a channel, weighted by their distance."""
    height, width = samples.shape
    pixels = np.empty((height, width, 3), dtype=np.uint8)
    for channel, letter in enumerate("rgb"):
        known = np.zeros((height, width))
        for place, name in enumerate(pattern):
            if name == letter:
                known[place // 2 :: 2, place % 2 :: 2] = 1.0
        weights = np.maximum(_smoothed(known), 1e-9)
        interpolated = _smoothed(known * samples) / weights
        pixels[:, :, channel] = np.round(np.where(known > 0.0, samples, interpolated)).astype(np.uint8)
    return pixels


def _smoothed(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """The kernel (1 2 1)ᵀ(1 2 1)."""
    padded = np.pad(values, 1)
    rows = padded[:-2] + 2.0 * padded[1:-1] + padded[2:]
    return np.asarray(rows[:, :-2] + 2.0 * rows[:, 1:-1] + rows[:, 2:])


def _yuv422(samples: Rgb, places: tuple[int, int, int]) -> Rgb:
    """ITU-R BT.601 in full range, as in the pipeline."""
    if samples.shape[1] % 4:
        raise ValueError("a YUV image with an odd width")
    first, u_place, v_place = places
    y = samples[:, first::2].astype(np.float64)
    u, v = (np.repeat(samples[:, place::4], 2, axis=1) - 128.0 for place in (u_place, v_place))
    rgb = np.stack([y + 1.402 * v, y - 0.344136 * u - 0.714136 * v, y + 1.772 * u], axis=2)
    return np.clip(np.round(rgb), 0.0, 255.0).astype(np.uint8)
