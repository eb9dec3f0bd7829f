"""What is in a log, as tables? One row a message, one row a cycle, one row an image; all at once or piece by piece."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mirrorball.log import Log

CYCLE_NAMES = {
    "estimate_pose_x": "x_m",
    "estimate_pose_y": "y_m",
    "estimate_pose_theta": "theta_rad",
    "truth_pose_x": "true_x_m",
    "truth_pose_y": "true_y_m",
    "truth_pose_theta": "true_theta_rad",
    "estimate_mode": "mode",
    "estimate_reason": "reason",
    "estimate_residual": "residual_m",
    "estimate_inlier_share": "inlier_share",
    "points_x_count": "line_points",
}
"""Names of a cycle's columns that are used most; the others keep the names of their messages."""


def opened(log: Log | str | Path) -> Log:
    """Give the log itself, or the one at a path."""
    return log if isinstance(log, Log) else Log(log)


def table(log: Log | str | Path, topic: str, *, start_s: float | None = None, stop_s: float | None = None) -> pd.DataFrame:
    """One row a message of a topic; columns as in `Log.columns`."""
    return pd.DataFrame(opened(log).columns(topic, start_s=start_s, stop_s=stop_s))


def cycles(log: Log | str | Path, *, start_s: float | None = None, stop_s: float | None = None) -> pd.DataFrame:
    """One row a cycle: estimate, deviations, truth and errors (metres, radians; NaN where unknown), counts and times.

    A cycle holds no image: an hour at 30 Hz is 100,000 rows, some 50 MB, however large its log.
    """
    log = opened(log)
    more = {f"covariance_{row}{column}": _covariance(3 * row + column) for row in range(3) for column in range(row, 3)}
    more |= {f"lean_{axis}_rad": _listed("lean", index) for index, axis in enumerate("ab")}
    more |= {f"true_ball_{axis}_m": _true_ball(index) for index, axis in enumerate("xy")}
    found = pd.DataFrame(log.columns("/cycle", more=more, start_s=start_s, stop_s=stop_s))
    found = found.rename(columns=CYCLE_NAMES)
    found["stamp_s"] = 1e-9 * found.pop("stamp_ns")
    return with_errors(found)


def with_errors(found: pd.DataFrame) -> pd.DataFrame:
    """Adds deviations, errors against truth and the normalised error squared (3 on average, where deviations are honest)."""
    for index, name in enumerate(("x_m", "y_m", "theta_rad")):
        found[f"std_{name}"] = np.sqrt(found[f"covariance_{index}{index}"].clip(lower=0.0))
    dx, dy = found["x_m"] - found["true_x_m"], found["y_m"] - found["true_y_m"]
    turned = np.mod(found["theta_rad"] - found["true_theta_rad"] + np.pi, 2.0 * np.pi) - np.pi
    found["error_x_m"], found["error_y_m"], found["error_theta_rad"] = dx, dy, turned
    found["error_m"] = np.hypot(dx, dy)
    found["nees"] = _nees(found, np.stack([dx, dy, turned], axis=-1))
    return found.copy()


def _nees(found: pd.DataFrame, error: NDArray[Any]) -> NDArray[np.float64]:
    matrix = np.empty((len(found), 3, 3))
    for row in range(3):
        for column in range(3):
            low, high = sorted((row, column))
            matrix[:, row, column] = found[f"covariance_{low}{high}"]
    known = np.isfinite(error).all(axis=1) & np.isfinite(matrix).all(axis=(1, 2))
    known[known] &= np.linalg.det(matrix[known]) > 0.0
    nees = np.full(len(found), np.nan)
    nees[known] = np.einsum("ni,ni->n", error[known], np.linalg.solve(matrix[known], error[known][:, :, None])[:, :, 0])
    return nees


def points(log: Log | str | Path, *, start_s: float | None = None, stop_s: float | None = None) -> pd.DataFrame:
    """One row a line point, robot frame: stamp_s, x_m, y_m, std_radial_m, std_tangential_m."""
    parts = []
    for entry in opened(log).messages("/cycle", start_s=start_s, stop_s=stop_s):
        seen = entry.message.points
        stamp = np.full(len(seen.x), 1e-9 * entry.message.stamp_ns)
        parts.append(np.column_stack([stamp, seen.x, seen.y, seen.std_radial, seen.std_tangential]))
    rows = np.concatenate(parts) if parts else np.zeros((0, 5))
    return pd.DataFrame(rows, columns=["stamp_s", "x_m", "y_m", "std_radial_m", "std_tangential_m"])


def exposure(log: Log | str | Path, *, every: int = 1) -> pd.DataFrame:
    """One row an image (of each `every`-th): mean brightness 0 to 255, share of saturated and of black pixels, entropy.

    The entropy is nubot2013 eq. 5: −Σ P·ln P over 256 levels, summed over red, green and blue. The black surround of a
    mirror counts like everything else, so that values compare within one camera only.
    """
    rows = []
    for index, (stamp, image) in enumerate(opened(log).images()):
        if index % every:
            continue
        entropy = 0.0
        for channel in range(3):
            share = np.bincount(image[:, :, channel].ravel(), minlength=256) / image[:, :, channel].size
            entropy -= float(np.sum(share[share > 0.0] * np.log(share[share > 0.0])))
        brightest = image.max(axis=2)
        saturated, black = float((brightest >= 250).mean()), float((brightest <= 5).mean())
        rows.append((stamp, float(image.mean()), saturated, black, entropy))
    return pd.DataFrame(rows, columns=["stamp_s", "brightness", "saturated_share", "black_share", "entropy"])


def stream(log: Log | str | Path, topic: str, *, rows: int = 10_000) -> Iterator[pd.DataFrame]:
    """A topic's table in pieces of at most so many rows, for topics that do not fit into memory."""
    log = opened(log)
    begin: float | None = None
    stamps = _piece_starts(log, topic, rows)
    for begin, end in zip(stamps, [*stamps[1:], None], strict=True):
        piece = cycles(log, start_s=begin, stop_s=end) if topic == "/cycle" else table(log, topic, start_s=begin, stop_s=end)
        if len(piece):
            yield piece


def _piece_starts(log: Log, topic: str, rows: int) -> list[float]:
    """Stamps at which pieces begin; messages of one stamp stay together."""
    starts: list[float] = []
    count, last = rows, None
    for entry in log.messages(topic):
        if count >= rows and entry.stamp_s != last:
            starts.append(entry.stamp_s)
            count = 0
        count, last = count + 1, entry.stamp_s
    return starts


def write_parquet(log: Log | str | Path, *, folder: str | Path, topics: list[str] | None = None) -> list[Path]:
    """Writes each topic's table (but images) as Parquet, piece by piece; /cycle with its errors against truth."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    log, folder = opened(log), Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for topic in topics or [topic for topic in log.topics if not topic.startswith("/camera/")]:
        path = folder / f"{topic.strip('/').replace('/', '_')}.parquet"
        writer = None
        for piece in stream(log, topic):
            rows = pa.Table.from_pandas(piece, preserve_index=False)
            writer = writer or pq.ParquetWriter(path, rows.schema)
            writer.write_table(rows.cast(writer.schema))
        if writer is not None:
            writer.close()
            written.append(path)
    return written


def _covariance(index: int) -> Any:
    return _listed("covariance", index)


def _listed(name: str, index: int) -> Any:
    def get(message: Any) -> float:
        values = getattr(message.estimate, name)
        return values[index] if index < len(values) else float("nan")

    return get


def _true_ball(index: int) -> Any:
    def get(message: Any) -> float:
        values = message.truth.ball
        return values[index] if index < len(values) else float("nan")

    return get
