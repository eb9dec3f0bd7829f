"""Camera images with the log's own annotations, as PNG files or a video.

Needs `pip install mirrorball[video]` (opencv-python-headless).
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mirrorball.analysis.tables import as_log
from mirrorball.arguments import require_at_least
from mirrorball.log import Log

Image = NDArray[np.uint8]


def overlays(
    log: Log | str | Path, *, every: int = 1, scale: int = 2, start_s: float | None = None, stop_s: float | None = None
) -> Iterator[tuple[float, Image]]:
    """Stamps (seconds) and images (rows × columns × red, green, blue), `scale` times enlarged, with all detections.

    Annotations mark the detections, and the field lines as seen from the estimated pose.
    """
    require_at_least("every", every, 1)
    require_at_least("scale", scale, 1)
    log, image, number = as_log(log), None, 0
    topics = ("/camera/image", "/camera/annotations")
    if not set(topics) <= set(log.topics):
        return
    for entry in log.messages(*topics, start_s=start_s, stop_s=stop_s):
        if entry.topic == "/camera/image":
            image = entry
            continue
        if image is None or image.stamp_s != entry.stamp_s:
            continue
        number += 1
        if (number - 1) % every:
            continue
        pixels = cv2.imdecode(np.frombuffer(image.message.data, dtype=np.uint8), cv2.IMREAD_COLOR)
        pixels = cv2.resize(pixels, None, fx=scale, fy=scale, interpolation=cv2.INTER_NEAREST)
        draw(pixels, entry.message, scale=scale)
        yield entry.stamp_s, np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB), dtype=np.uint8)


def draw(pixels: NDArray[Any], notes: Any, *, scale: int) -> None:
    """Draws a foxglove.ImageAnnotations message onto a BGR image that was enlarged by `scale`."""

    def place(point: Any) -> tuple[int, int]:
        return round(scale * (point.x + 0.5)), round(scale * (point.y + 0.5))

    def colour(rgba: Any) -> tuple[int, int, int]:
        return round(255 * rgba.b), round(255 * rgba.g), round(255 * rgba.r)

    for circle in notes.circles:
        cv2.circle(pixels, place(circle.position), max(1, round(scale * circle.diameter / 2)),
                   colour(circle.outline_color), 1, cv2.LINE_AA)  # fmt: skip
    for group in notes.points:
        corners = [place(point) for point in group.points]
        if group.type == 1:
            for corner in corners:
                cv2.circle(pixels, corner, max(1, scale // 2), colour(group.outline_color), -1)
        elif group.type == 4:
            for begin, end in zip(corners[::2], corners[1::2], strict=False):
                cv2.line(pixels, begin, end, colour(group.outline_color), 1, cv2.LINE_AA)
        else:
            line = np.array(corners, dtype=np.int32).reshape(-1, 1, 2)
            cv2.polylines(pixels, [line], group.type == 2, colour(group.outline_color), 1, cv2.LINE_AA)
    for text in notes.texts:
        cv2.putText(pixels, text.text, place(text.position), cv2.FONT_HERSHEY_SIMPLEX, 0.4, colour(text.text_color), 1)


def write_png(log: Log | str | Path, *, folder: str | Path, every: int = 30, scale: int = 2) -> list[Path]:
    """Writes each `every`-th overlay as a PNG named by its stamp."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for stamp, image in overlays(log, every=every, scale=scale):
        path = folder / f"{stamp:09.3f}.png"
        _require_written(cv2.imwrite(str(path), cv2.cvtColor(image, cv2.COLOR_RGB2BGR)), path)
        written.append(path)
    return written


def write_video(log: Log | str | Path, path: str | Path, *, rate_hz: float = 30.0, every: int = 1, scale: int = 2) -> int:
    """Writes the overlays as a video (.mp4 or .avi by the name's end) and returns the number of its images."""
    path = Path(path)
    codec = {".mp4": "mp4v", ".avi": "MJPG"}.get(path.suffix)
    if codec is None:
        raise ValueError(f"{path}: a video ends on .mp4 or .avi")
    path.parent.mkdir(parents=True, exist_ok=True)
    writer, count = None, 0
    for _, image in overlays(log, every=every, scale=scale):
        if writer is None:
            rows, columns = image.shape[:2]
            writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*codec), rate_hz, (columns, rows))
            _require_written(writer.isOpened(), path)
        writer.write(cv2.cvtColor(image, cv2.COLOR_RGB2BGR))
        count += 1
    if writer is None:
        raise ValueError("the log holds no image")
    writer.release()
    return count


def _require_written(done: bool, path: Path) -> None:
    if not done:
        raise OSError(f"cannot write {path}")
