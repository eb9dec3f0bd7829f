"""Figures of a run: path, errors with their stated deviations, times, counts; without pyplot."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from mirrorball.log import Log

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOURS = ("#1b6ca8", "#c8553d", "#3b8a4f", "#8a5fa8", "#b98b1d", "#4a4a4a")


def rows(count: int, *, width: float = 11.0, height: float = 2.2) -> tuple[Figure, list[Axes]]:
    """Plots over one another that share their time."""
    figure = Figure(figsize=(width, 0.6 + height * count), dpi=100)
    axes: list[Axes] = []
    for index in range(count):
        axes.append(figure.add_subplot(count, 1, index + 1, sharex=axes[0] if axes else None))
    figure.subplots_adjust(left=0.08, right=0.98, top=1.0 - 0.3 / (0.6 + height * count), bottom=0.5 / (0.6 + height * count))
    for ax in axes:
        decorate(ax)
    axes[-1].set_xlabel("time / s")
    return figure, axes


def decorate(ax: Axes) -> None:
    """A light grid, no box."""
    ax.grid(color="#e4e4e4", linewidth=0.7)
    ax.spines[["top", "right"]].set_visible(False)
    ax.set_axisbelow(True)
    ax.yaxis.set_major_locator(MaxNLocator(4))


def markings(log: Log) -> np.ndarray:
    """Points on the field's lines, n × 2, metres; empty where the log has none."""
    for entry in log.messages("/field/lines") if "/field/lines" in log.topics else ():
        cloud = entry.message
        values = np.frombuffer(cloud.data, dtype="<f4").reshape(-1, cloud.point_stride // 4)
        return values[:, :2]
    return np.zeros((0, 2))


def path(runs: dict[str, pd.DataFrame], *, lines: np.ndarray) -> Figure:
    """True and estimated paths on the field; breaks where the robot was lost or carried away."""
    figure = Figure(figsize=(11.0, 7.4), dpi=100)
    ax = figure.add_subplot()
    figure.subplots_adjust(left=0.06, right=0.98, top=0.97, bottom=0.07)
    ax.plot(lines[:, 0], lines[:, 1], ".", color="#b8b8b8", markersize=1.2)
    first = next(iter(runs.values()))
    if first["true_x_m"].notna().any():
        ax.plot(*broken(first["true_x_m"], first["true_y_m"]), color="black", linewidth=2.4, label="truth")
    for (name, run), colour in zip(runs.items(), COLOURS * 4, strict=False):
        ax.plot(*broken(run["x_m"], run["y_m"]), color=colour, linewidth=1.1, label=name)
    ax.set(xlabel="x / m", ylabel="y / m")
    ax.set_aspect("equal", adjustable="datalim")
    ax.spines[["top", "right"]].set_visible(False)
    ax.legend(frameon=False, fontsize=8, loc="upper right")
    return figure


def broken(x: pd.Series, y: pd.Series, *, jump_m: float = 0.5) -> tuple[np.ndarray, np.ndarray]:
    """A path with a gap wherever it jumps."""
    x, y = np.array(x, dtype=np.float64), np.array(y, dtype=np.float64)
    jumps = 1 + np.flatnonzero(np.hypot(np.diff(x), np.diff(y)) > jump_m)
    return np.insert(x, jumps, np.nan), np.insert(y, jumps, np.nan)


def errors(runs: dict[str, pd.DataFrame]) -> Figure:
    """Errors over time; the shade is two standard deviations as the estimate states them."""
    figure, axes = rows(3)
    for (name, run), colour in zip(runs.items(), COLOURS * 4, strict=False):
        for ax, column, scale in zip(axes, ("x_m", "y_m", "theta_rad"), (100.0, 100.0, 180.0 / np.pi), strict=True):
            wide = 2.0 * scale * run[f"std_{column}"].where(run["mode"] != "lost")
            ax.fill_between(run["stamp_s"], -wide, wide, color=colour, alpha=0.12, linewidth=0.0)
            ax.plot(run["stamp_s"], scale * run[f"error_{column}"], color=colour, linewidth=0.9, label=name)
    for ax, label in zip(axes, ("x / cm", "y / cm", "θ / °"), strict=True):
        ax.set_ylabel(f"error {label}")
        # What lies far out is a kidnap; the rest must stay readable.
        error = np.concatenate([np.asarray(line.get_ydata(), dtype=np.float64) for line in ax.get_lines()])
        known = np.abs(error[np.isfinite(error)])
        if known.size:
            reach = max(3.0 * float(np.quantile(known, 0.95)), 1e-3)
            ax.set_ylim(-reach, reach)
    axes[0].legend(frameon=False, fontsize=8, loc="upper right", ncols=4)
    return figure


def times(runs: dict[str, pd.DataFrame]) -> Figure:
    """Time of each stage, line points, and mode over time."""
    figure, axes = rows(3)
    for (name, run), colour in zip(runs.items(), COLOURS * 4, strict=False):
        axes[0].plot(run["stamp_s"], run["see_ms"], color=colour, linewidth=0.8, label=f"{name}: vision")
        axes[0].plot(run["stamp_s"], run["localize_ms"], color=colour, linewidth=0.8, linestyle=":", label="localization")
        axes[1].plot(run["stamp_s"], run["line_points"], color=colour, linewidth=0.8, label=name)
        axes[2].plot(run["stamp_s"], run["mode"].map({"tracking": 2, "global": 1, "lost": 0}), color=colour,
                     drawstyle="steps-post", linewidth=0.9)  # fmt: skip
    axes[0].set(ylabel="ms", yscale="log")
    axes[1].set_ylabel("line points")
    axes[2].set_yticks([0, 1, 2], ["lost", "global", "tracking"])
    axes[0].legend(frameon=False, fontsize=8, loc="upper right", ncols=2)
    return figure


def light(found: pd.DataFrame) -> Figure:
    """Brightness, entropy and saturation of the images over time."""
    figure, axes = rows(3)
    for ax, column, colour in zip(axes, ("brightness", "entropy", "saturated_share"), COLOURS, strict=False):
        ax.plot(found["stamp_s"], found[column], color=colour, linewidth=1.0)
        ax.set_ylabel(column.replace("_", " "))
    return figure
