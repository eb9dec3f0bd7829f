"""Logs as tables: one row per message, cycle, line point or image; all at once or in pieces."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mirrorball.analysis.units import with_unit
from mirrorball.arguments import checked, require_at_least
from mirrorball.log import Log

CYCLE_ELEMENTS = {
    "estimate.covariance[0]": "covariance_xx_m2",
    "estimate.covariance[1]": "covariance_xy_m2",
    "estimate.covariance[2]": "covariance_xtheta_mrad",
    "estimate.covariance[4]": "covariance_yy_m2",
    "estimate.covariance[5]": "covariance_ytheta_mrad",
    "estimate.covariance[8]": "covariance_thetatheta_rad2",
    "estimate.repeated_covariance[0]": "repeated_covariance_xx_m2",
    "estimate.repeated_covariance[1]": "repeated_covariance_xy_m2",
    "estimate.repeated_covariance[2]": "repeated_covariance_xtheta_mrad",
    "estimate.repeated_covariance[4]": "repeated_covariance_yy_m2",
    "estimate.repeated_covariance[5]": "repeated_covariance_ytheta_mrad",
    "estimate.repeated_covariance[8]": "repeated_covariance_thetatheta_rad2",
    "estimate.lean[0]": "lean_a_rad",
    "estimate.lean[1]": "lean_b_rad",
    "truth.ball[0]": "true_ball_x_m",
    "truth.ball[1]": "true_ball_y_m",
}
"""Single elements of a cycle's lists, and the columns that they become; `_mrad` is metre times radian."""

CYCLE_COLUMNS = {
    **{re.sub(r"[.\[]", "_", element).rstrip("]"): name for element, name in CYCLE_ELEMENTS.items()},
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
    "estimate_gyro_bias": "gyro_bias_radps",
    "estimate_latency": "latency_s",
    "estimate_fit_residual": "fit_residual_m",
    "points_x_count": "line_points",
    "seen_refused_u_px_count": "refused",
    "seen_robots_count": "robots_seen",
    "seen_goals_count": "goals_seen",
    "world_robots_count": "robots_tracked",
    "estimate_runners_up_count": "runners_up",
    "seen_carpet_share": "carpet_share",
}
"""Names of a cycle's columns that are used most; the others keep the names of their messages, with a unit."""

COVARIANCE = (
    ("covariance_xx_m2", "covariance_xy_m2", "covariance_xtheta_mrad"),
    ("covariance_xy_m2", "covariance_yy_m2", "covariance_ytheta_mrad"),
    ("covariance_xtheta_mrad", "covariance_ytheta_mrad", "covariance_thetatheta_rad2"),
)
"""Columns of the pose's covariance, row by row."""


def as_log(log: Log | str | Path) -> Log:
    """The log itself, or the one at a path."""
    return log if isinstance(log, Log) else Log(log)


@checked
def table(log: Log | str | Path, topic: str, *, start_s: float | None = None, stop_s: float | None = None) -> pd.DataFrame:
    """One row a message of a topic; columns as in `Log.columns`, with their units. Beside each quaternion stands its yaw."""
    found = pd.DataFrame(as_log(log).columns(topic, start_s=start_s, stop_s=stop_s))
    for name in [name.removesuffix("_w") for name in found.columns if name.endswith(("orientation_w", "rotation_w"))]:
        x, y, z, w = (found[f"{name}_{part}"] for part in "xyzw")
        found[f"{name}_yaw_rad"] = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return found.rename(columns={name: with_unit(name, topic) for name in found.columns})


@checked
def cycles(
    log: Log | str | Path, *, start_s: float | None = None, stop_s: float | None = None, counts: bool = False
) -> pd.DataFrame:
    """One row a cycle: estimate, deviations, truth and errors (metres, radians; NaN where unknown), counts and times.

    `counts` adds the length of every list of the message, as `…_count`; those of use have names of their own.

    A cycle holds no image: an hour at 30 Hz is 100,000 rows, some 50 MB, however large its log.
    """
    log = as_log(log)
    columns = log.columns("/cycle", elements=list(CYCLE_ELEMENTS), start_s=start_s, stop_s=stop_s)
    run = pd.DataFrame(columns).rename(columns=CYCLE_COLUMNS)
    run = run.rename(columns={name: with_unit(name, "/cycle") for name in run.columns})
    if not counts:
        run = run.drop(columns=[name for name in run.columns if name.endswith("_count")])
    run["stamp_s"] = 1e-9 * run.pop("stamp_ns")
    return add_errors(run)


def add_errors(found: pd.DataFrame) -> pd.DataFrame:
    """Adds standard deviations, errors against truth and their NEES (3 on average if the covariance is consistent)."""
    for index, name in enumerate(("x_m", "y_m", "theta_rad")):
        found[f"std_{name}"] = np.sqrt(found[COVARIANCE[index][index]].clip(lower=0.0))
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
            matrix[:, row, column] = found[COVARIANCE[row][column]]
    known = np.isfinite(error).all(axis=1) & np.isfinite(matrix).all(axis=(1, 2))
    known[known] &= np.linalg.det(matrix[known]) > 0.0
    nees = np.full(len(found), np.nan)
    nees[known] = np.einsum("ni,ni->n", error[known], np.linalg.solve(matrix[known], error[known][:, :, None])[:, :, 0])
    return nees


@checked
def points(log: Log | str | Path, *, start_s: float | None = None, stop_s: float | None = None) -> pd.DataFrame:
    """One row a line point, robot frame: stamp_s, x_m, y_m, std_radial_m, std_tangential_m."""
    rows = as_log(log).rows("/cycle", "points", start_s=start_s, stop_s=stop_s)
    names = {"x": "x_m", "y": "y_m", "std_radial": "std_radial_m", "std_tangential": "std_tangential_m"}
    return pd.DataFrame(rows).rename(columns=names)


@checked
def exposure(log: Log | str | Path, *, every: int = 1) -> pd.DataFrame:
    """One row an image (of each `every`-th): mean brightness 0 to 255, share of saturated and of black pixels, entropy.

    The entropy is nubot2013 eq. 5 in bits, as in the log: −Σ P·log₂ P over 256 levels, summed over red, green and blue (at most
    24). The black surround of a mirror counts like everything else, so that values compare within one camera only.
    """
    require_at_least("every", every, 1)
    rows = []
    for index, (stamp, image) in enumerate(as_log(log).images()):
        if index % every:
            continue
        entropy = 0.0
        for channel in range(3):
            share = np.bincount(image[:, :, channel].ravel(), minlength=256) / image[:, :, channel].size
            entropy -= float(np.sum(share[share > 0.0] * np.log2(share[share > 0.0])))
        brightest = image.max(axis=2)
        saturated, black = float((brightest >= 250).mean()), float((brightest <= 5).mean())
        rows.append((stamp, float(image.mean()), saturated, black, entropy))
    return pd.DataFrame(rows, columns=["stamp_s", "brightness", "saturated_share", "black_share", "entropy"])


@checked
def stream(log: Log | str | Path, topic: str, *, rows: int = 10_000) -> Iterator[pd.DataFrame]:
    """A topic's table in pieces of about `rows` rows, for topics that do not fit into memory."""
    require_at_least("rows", rows, 1)
    log = as_log(log)
    borders = _piece_borders(log.log_times_ns(topic), rows)
    for start, stop in zip([None, *borders], [*borders, None], strict=True):
        piece = cycles(log, start_s=start, stop_s=stop) if topic == "/cycle" else table(log, topic, start_s=start, stop_s=stop)
        if len(piece):
            yield piece


def _piece_borders(times_ns: NDArray[np.uint64], rows: int) -> list[float]:
    """Stamps between pieces, seconds; messages of one stamp stay together."""
    borders = []
    at = rows
    while at < len(times_ns):
        last = times_ns[at - 1]
        first = int(np.searchsorted(times_ns, last, side="right"))
        if first == len(times_ns):
            break
        # Midway: a float64 rounds seconds since the epoch to 0.2 µs.
        borders.append(1e-9 * ((int(last) + int(times_ns[first])) // 2))
        at = first + rows
    return borders


@checked
def write_parquet(log: Log | str | Path, *, folder: str | Path, topics: list[str] | None = None) -> list[Path]:
    """Writes each topic's table as Parquet, piece by piece; /cycle with its errors against truth. None: all but images."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    log, folder = as_log(log), Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    if topics is None:
        topics = [topic for topic in log.topics if not topic.startswith("/camera/")]
    for topic in topics:
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
