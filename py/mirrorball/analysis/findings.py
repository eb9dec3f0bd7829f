"""Where did a run go wrong, and why? Moments of a log that a person should look at, each with its likely causes.

A moment is found by what the log itself says: the stated uncertainty, the truth where there is one, the wheels between two
images. Causes are measurements that differ from those of the rest of the run at that moment, so that no threshold has to
fit a certain robot or hall.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mirrorball.analysis.metrics import dropouts, true_intervals
from mirrorball.analysis.tables import as_log, cycles
from mirrorball.log import Log

__all__ = ["Finding", "findings", "findings_table", "images_of"]

LARGE_ERROR_M = 0.15
"""Position error that a player would notice."""
NEES_MAX = 16.27
"""Squared normalised error of a pose that one consistent pose in a thousand exceeds (χ², 3 degrees of freedom)."""
WRONG_BY_M = 0.03
"""Smallest error that is worth a look, however small its stated deviation."""
LEAP_SIGMA = 4.0
LEAP_M = 0.1
LIGHT_CHANGE_S = 1.5
LIGHT_RATIO = 1.5
MERGE_S = 1.0
"""Moments of one kind that are closer together are one."""
LOOK_BACK_S = 0.5
"""A cause may precede its effect by this."""


@dataclass(frozen=True)
class Finding:
    """A moment of a run: what happened, how badly, and what was unusual."""

    kind: str
    """error, overconfident, uncertain, lost, leap, slip, light, drift, unusable, gap or dropped."""
    start_s: float
    stop_s: float
    worst_s: float
    size: float
    """Largest value in the moment, in the unit of its kind: metres, seconds for gaps, a ratio for light."""
    causes: tuple[str, ...]
    """What differed from the rest of the run, the strongest first."""

    @property
    def sentence(self) -> str:
        """The finding in one sentence."""
        text = f"{_TEXTS[self.kind].format(size=self.size, cm=100.0 * self.size, seconds=self.stop_s - self.start_s)}"
        why = f": {', '.join(self.causes)}" if self.causes else ""
        return f"{text} at {self.worst_s:.2f} s{why}"


_TEXTS = {
    "error": "{cm:.0f} cm wrong",
    "overconfident": "{cm:.1f} cm wrong, far more than stated",
    "uncertain": "uncertain by {cm:.0f} cm",
    "lost": "lost for {seconds:.2f} s",
    "leap": "pose leaps by {cm:.0f} cm",
    "slip": "collision or slip for {seconds:.2f} s",
    "light": "light changes {size:.1f}-fold",
    "drift": "map is off by {cm:.1f} cm at 3 m",
    "unusable": "image cannot be used",
    "gap": "no image for {size:.2f} s",
    "dropped": "recorder drops cycles for {size:.2f} s",
}


def findings(log: Log | str | Path) -> list[Finding]:
    """The moments of a log that deserve a look, in order of time.

    Errors need truth in the log (`sim --record`). Without truth, uncertain poses, leaps against the wheels, lost robots, slip,
    light, drift of the map, gaps and unusable images are found.
    """
    log = as_log(log)
    run = cycles(log)
    if run.empty:
        raise ValueError(f"{log.path} has no cycle")
    found = [*_pose_findings(run), *_leaps(log, run), *_sensor_findings(run), *_missing(run)]
    return sorted(found, key=lambda finding: (finding.start_s, finding.kind))


def findings_table(found: list[Finding]) -> pd.DataFrame:
    """One row a finding: kind, start_s, stop_s, worst_s, size, causes, sentence."""
    rows = [(each.kind, each.start_s, each.stop_s, each.worst_s, each.size, ", ".join(each.causes), each.sentence)
            for each in found]  # fmt: skip
    return pd.DataFrame(rows, columns=["kind", "start_s", "stop_s", "worst_s", "size", "causes", "sentence"])


def images_of(log: Log | str | Path, found: list[Finding]) -> dict[Finding, NDArray[np.uint8]]:
    """The image at the worst moment of each finding, rows × columns × (red, green, blue), where the log has one."""
    log = as_log(log)
    if not log.message_counts.get("/camera/image"):
        return {}
    pictures = {}
    # Log times of a robot are wall-clock time; stamps of cycles are not.
    run = cycles(log)
    logged = log.columns("/cycle")["stamp_s"]
    for finding in found:
        at = int(np.argmin(np.abs(run["stamp_s"].to_numpy() - finding.worst_s)))
        for _, image in log.images(start_s=logged[at] - 0.005, stop_s=logged[at] + 0.005):
            pictures[finding] = image
            break
    return pictures


def _pose_findings(run: pd.DataFrame) -> Iterator[Finding]:
    error = run["error_m"].to_numpy()
    std = np.sqrt(run["std_x_m"] ** 2 + run["std_y_m"] ** 2).to_numpy()
    known = run["mode"].to_numpy() != "lost"
    with np.errstate(invalid="ignore"):
        large = known & (error > LARGE_ERROR_M)
        confident = known & ~large & (error > WRONG_BY_M) & (run["nees"].to_numpy() > NEES_MAX)
        uncertain = known & ~large & (std > LARGE_ERROR_M)
    for kind, mask, size in (
        ("error", large, error),
        ("overconfident", confident, error),
        ("uncertain", uncertain, std),
        ("lost", ~known, np.zeros(len(run))),
    ):
        yield from _moments(run, kind, mask, size)


def _sensor_findings(run: pd.DataFrame) -> Iterator[Finding]:
    if "estimate_collision" in run:
        yield from _moments(run, "slip", run["estimate_collision"].to_numpy() > 0.0, np.zeros(len(run)), causes=False)
    yield from _light_changes(run)
    shift, deviation = "estimate_map_correction_displacement_at_3_m", "estimate_map_correction_displacement_std_at_3_m"
    if shift in run:
        by, std = run[shift].to_numpy(), run[deviation].to_numpy()
        with np.errstate(invalid="ignore"):
            yield from _moments(run, "drift", (by > WRONG_BY_M) & (by > 3.0 * std), by, causes=False)


def _light_changes(run: pd.DataFrame) -> Iterator[Finding]:
    """Light on the field, from the image's level and the camera's setting, against that of `LIGHT_CHANGE_S` before."""
    if not {"exposure_level", "exposure_exposure", "exposure_gain"} <= set(run.columns):
        return
    measured = run[run["exposure_level"].notna()].reset_index(drop=True)
    stamps = measured["stamp_s"].to_numpy()
    setting = (measured["exposure_exposure"].fillna(1.0) * measured["exposure_gain"].fillna(1.0)).to_numpy()
    # sRGB's curve is close to a power of 2.2.
    light = (measured["exposure_level"].to_numpy().clip(1.0) / 255.0) ** 2.2 / setting
    earlier = np.searchsorted(stamps, stamps - LIGHT_CHANGE_S, side="right") - 1
    ratio = np.where(earlier >= 0, light / light[earlier.clip(0)], 1.0)
    ratio = np.maximum(ratio, 1.0 / ratio)
    yield from _moments(measured, "light", ratio > LIGHT_RATIO, ratio, causes=False)


def _leaps(log: Log, run: pd.DataFrame) -> Iterator[Finding]:
    """Poses that moved otherwise than the wheels between two images, by more than both uncertainties allow."""
    if not log.message_counts.get("/odometry"):
        return
    odometry = log.columns("/odometry")
    if not {"stamp_ns", "dx", "dy", "dtheta"} <= odometry.keys():
        return
    driven = motion_between(
        1e-9 * odometry["stamp_ns"], odometry["dx"], odometry["dy"], odometry["dtheta"], run["stamp_s"].to_numpy()
    )
    x, y, theta = (run[name].to_numpy() for name in ("x_m", "y_m", "theta_rad"))
    cos, sin = np.cos(theta[:-1]), np.sin(theta[:-1])
    expected_x = x[:-1] + cos * driven[:, 0] - sin * driven[:, 1]
    expected_y = y[:-1] + sin * driven[:, 0] + cos * driven[:, 1]
    off = np.concatenate([[0.0], np.hypot(x[1:] - expected_x, y[1:] - expected_y)])
    variance = (run["std_x_m"] ** 2 + run["std_y_m"] ** 2).to_numpy()
    allowed = np.concatenate([[np.inf], np.sqrt(variance[1:] + variance[:-1])])
    with np.errstate(invalid="ignore"):
        yield from _moments(run, "leap", (off > LEAP_M) & (off > LEAP_SIGMA * allowed), off)


def motion_between(
    stamps: NDArray[Any], dx: NDArray[Any], dy: NDArray[Any], dtheta: NDArray[Any], images: NDArray[Any]
) -> NDArray[np.float64]:
    """Motion by the wheels from each image to the next, in the robot frame of the former: n − 1 × 2."""
    heading = np.concatenate([[0.0], np.cumsum(dtheta)])
    cos, sin = np.cos(heading[:-1]), np.sin(heading[:-1])
    x = np.concatenate([[0.0], np.cumsum(cos * dx - sin * dy)])
    y = np.concatenate([[0.0], np.cumsum(sin * dx + cos * dy)])
    times = np.concatenate([[stamps[0] - 1e-3 if len(stamps) else 0.0], stamps])
    at_x, at_y, at_heading = (np.interp(images, times, values) for values in (x, y, heading))
    step_x, step_y = np.diff(at_x), np.diff(at_y)
    cos, sin = np.cos(at_heading[:-1]), np.sin(at_heading[:-1])
    return np.stack([cos * step_x + sin * step_y, -sin * step_x + cos * step_y], axis=1)


def _missing(run: pd.DataFrame) -> Iterator[Finding]:
    for row in dropouts(run, gap_factor=3.0).itertuples():
        if row.kind in ("gap", "dropped", "unusable"):
            causes = (row.detail,) if row.kind == "unusable" else ()
            yield Finding(row.kind, row.start_s, row.stop_s, row.start_s, row.stop_s - row.start_s, causes)


def _moments(
    run: pd.DataFrame, kind: str, mask: NDArray[np.bool_], size: NDArray[Any], *, causes: bool = True
) -> Iterator[Finding]:
    stamps = run["stamp_s"].to_numpy()
    merged: list[tuple[int, int]] = []
    for first, last in true_intervals(mask):
        if merged and stamps[first] - stamps[merged[-1][1]] < MERGE_S:
            merged[-1] = (merged[-1][0], last)
        else:
            merged.append((first, last))
    for first, last in merged:
        worst = first + int(np.nanargmax(size[first : last + 1]))
        why = _causes(run, first, last) if causes else ()
        # The moment lasts until the next image.
        stop = stamps[min(last + 1, len(stamps) - 1)]
        yield Finding(kind, stamps[first], stop, stamps[worst], float(size[worst]), why)


def _causes(run: pd.DataFrame, first: int, last: int) -> tuple[str, ...]:
    """What differed between `first` (and shortly before) and `last` from the run's usual values, the strongest first."""
    stamps = run["stamp_s"].to_numpy()
    start = int(np.searchsorted(stamps, stamps[first] - LOOK_BACK_S))
    moment = run.iloc[start : last + 1]
    found: list[tuple[float, str]] = []

    def differs(column: str, text: str, *, below: bool) -> None:
        if column not in run or run[column].notna().sum() < 10:
            return
        usual, spread = run[column].median(), (run[column].quantile(0.9) - run[column].quantile(0.1)) / 2.56
        value = moment[column].min() if below else moment[column].max()
        score = (usual - value if below else value - usual) / max(spread, 0.05 * abs(usual), 1e-9)
        if np.isfinite(score) and score > 3.0:
            found.append((score, text.format(value=value, usual=usual)))

    differs("line_points", "few line points ({value:.0f}, usually {usual:.0f})", below=True)
    differs("inlier_share", "points off the markings ({value:.0%} on them, usually {usual:.0%})", below=True)
    differs("residual_m", "poor fit", below=False)
    differs("carpet_share", "view is blocked", below=True)
    differs("robots_seen", "many robots close by ({value:.0f})", below=False)
    differs("exposure_level", "bright light", below=False)
    differs("exposure_level", "darkness", below=True)
    if "estimate_collision" in moment and (moment["estimate_collision"] > 0.0).any():
        found.append((10.0, "collision or slip"))
    if "fault" in moment:
        found += [(20.0, f"image fault ({fault})") for fault in sorted(set(moment["fault"]) - {""})]
    reasons = [reason for reason in moment["reason"].iloc[first - start :] if reason]
    found += [(5.0, reason) for reason in sorted(set(reasons))]
    if "estimate_half_known" in moment and (moment["estimate_half_known"] == 0.0).any():
        found.append((4.0, "half of the field unknown"))
    return tuple(text for _, text in sorted(found, key=lambda cause: -cause[0]))
