"""Metrics of a run's tables: errors, drop-outs and their durations, differences between two runs."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from mirrorball.arguments import checked, invalid, require_columns

ERROR_METRICS = {"position error, cm": ("error_m", 100.0), "heading error, °": ("error_theta_rad", 180.0 / np.pi)}
TIME_METRICS = {"vision, ms": ("see_ms", 1.0), "localization, ms": ("localize_ms", 1.0)}
OTHER_METRICS = {"line points": ("line_points", 1.0), "normalised error²": ("nees", 1.0)}


@checked
def summary(cycles: pd.DataFrame) -> pd.DataFrame:
    """Mean, median, 95 % and largest of errors, times and counts; one row each, those unknown left out."""
    metrics = ERROR_METRICS | TIME_METRICS | OTHER_METRICS
    require_columns("cycles", cycles, (column for column, _ in metrics.values()))
    rows = {}
    for name, (column, scale) in metrics.items():
        values = scale * cycles[column].abs().dropna()
        if len(values):
            rows[name] = (values.mean(), values.median(), values.quantile(0.95), values.max(), len(values))
    return pd.DataFrame.from_dict(rows, orient="index", columns=["mean", "median", "95 %", "largest", "frames"])


def shares(cycles: pd.DataFrame) -> dict[str, float]:
    """Frames in each mode and with a fault, as shares of all."""
    modes = cycles["mode"].value_counts(normalize=True)
    found = {str(mode): float(share) for mode, share in modes.items()}
    if "fault" in cycles:
        found["unusable"] = float((cycles["fault"] != "").mean())
    return found


@checked
def dropouts(cycles: pd.DataFrame, *, gap_factor: float = 1.5) -> pd.DataFrame:
    """What is missing: kind, start_s, stop_s, detail.

    `dropped`: cycles that the recorder had no room for (their numbers are missing). `gap`: no frame for more than
    `gap_factor` usual periods. `unusable`: a frame that could not be read. `lost`: no pose.
    """
    if gap_factor <= 1.0:
        raise ValueError(invalid("gap_factor", gap_factor, "more than 1"))
    require_columns("cycles", cycles, ("stamp_s", "index", "mode", "reason"))
    rows: list[tuple[str, float, float, str]] = []
    stamps, index = cycles["stamp_s"].to_numpy(), cycles["index"].to_numpy()
    periods = np.diff(stamps)
    usual = float(np.median(periods)) if periods.size else 0.0
    for at in np.flatnonzero(np.diff(index) > 1):
        rows.append(("dropped", stamps[at], stamps[at + 1], f"{int(index[at + 1] - index[at] - 1)} cycles"))
    for at in np.flatnonzero((periods > gap_factor * usual) & (np.diff(index) == 1)):
        rows.append(("gap", stamps[at], stamps[at + 1], f"{periods[at]:.3f} s between frames"))
    if "fault" in cycles:
        broken = cycles[cycles["fault"] != ""]
        rows += [("unusable", stamp, stamp, fault) for stamp, fault in zip(broken["stamp_s"], broken["fault"], strict=True)]
    for first, last in true_intervals((cycles["mode"] == "lost").to_numpy()):
        reasons = cycles["reason"].iloc[first : last + 1]
        rows.append(("lost", stamps[first], stamps[last], ", ".join(sorted({reason for reason in reasons if reason}))))
    return pd.DataFrame(sorted(rows, key=lambda row: row[1]), columns=["kind", "start_s", "stop_s", "detail"])


def true_intervals(mask: Any) -> list[tuple[int, int]]:
    """First and last index of each run of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [(int(begin), int(end) - 1) for begin, end in zip(edges[::2], edges[1::2], strict=True)]


@checked
def paired_difference(
    first: pd.DataFrame, second: pd.DataFrame, *, column: str = "error_m", resamples: int = 2000, seed: int = 1
) -> dict[str, float]:
    """Mean difference (second − first) of a column over the frames of one stamp, with its 95 % bootstrap interval.

    Frames follow one another, and so do their errors. Whole seconds are drawn, so that the interval is not too narrow.
    Keys: frames, mean_first, mean_second, difference, low, high. ValueError if no stamp agrees.
    """
    require_columns("column", first, [column])
    if resamples < 1:
        raise ValueError(invalid("resamples", resamples, "at least 1"))
    both = difference(first, second)
    both = both[both[f"{column}_1"].notna() & both[f"{column}_2"].notna()]
    if both.empty:
        raise ValueError(f"no frame of one stamp has {column} in both runs")
    apart = both[f"{column}_2"] - both[f"{column}_1"]
    blocks = apart.groupby((both["stamp_s"] // 1.0).astype(int)).agg(["sum", "count"]).to_numpy()
    drawn = np.random.default_rng(seed).integers(len(blocks), size=(resamples, len(blocks)))
    sums = blocks[drawn].sum(axis=1)
    low, high = np.percentile(sums[:, 0] / sums[:, 1], [2.5, 97.5])
    return {
        "frames": float(len(both)),
        "mean_first": float(both[f"{column}_1"].mean()),
        "mean_second": float(both[f"{column}_2"].mean()),
        "difference": float(apart.mean()),
        "low": float(low),
        "high": float(high),
    }


@checked
def difference(first: pd.DataFrame, second: pd.DataFrame, *, tolerance_s: float = 0.002) -> pd.DataFrame:
    """Two runs frame by frame, where their stamps agree: poses' distance apart, and each one's columns as `_1` and `_2`."""
    for name, run in (("first", first), ("second", second)):
        require_columns(name, run, ("stamp_s", "x_m", "y_m", "theta_rad"))
    one, two = (run.sort_values("stamp_s") for run in (first, second))
    both = pd.merge_asof(one, two.assign(stamp_2_s=two["stamp_s"]), on="stamp_s", direction="nearest",
                         tolerance=tolerance_s, suffixes=("_1", "_2"))  # fmt: skip
    both = both[both["stamp_2_s"].notna()].copy()
    both["apart_m"] = np.hypot(both["x_m_1"] - both["x_m_2"], both["y_m_1"] - both["y_m_2"])
    turned = both["theta_rad_1"] - both["theta_rad_2"]
    both["apart_rad"] = np.abs(np.mod(turned + np.pi, 2.0 * np.pi) - np.pi)
    return both
