"""The page of `mirrorball eval`: our results next to the papers', from results.json and its rows."""

from __future__ import annotations

import csv
import html
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mirrorball.arguments import checked
from mirrorball.html_page import picture, table, write

__all__ = ["write_page"]


def __dir__() -> list[str]:
    return __all__


COLOURS = ("#1b6ca8", "#c8553d", "#3b8a4f", "#8a5fa8", "#b98b1d", "#4a4a4a", "#6aa9c9", "#999999")
# The papers draw truth black and estimates red.
TRUTH_COLOUR, ESTIMATE_COLOUR = "black", "#d62728"

# How figures are counted whose names do not say it.
DEFINITIONS = {
    "silently wrong, % of frames": (
        "Silently wrong: tracked, no stated reason for doubt, and off by 0.5 m and three stated standard deviations or more."
    ),
}

Part = dict[str, Any]
Columns = dict[str, NDArray[Any]]


@checked
def write_page(folder: str | Path) -> Path:
    """Writes index.html into the folder of an evaluation, from results.json and the CSV files next to it."""
    folder = Path(folder)
    results = json.loads((folder / "results.json").read_text(encoding="utf-8"))
    first, last = results["seeds"]
    facts = [["Source", results["source"] or "–"], ["Seeds", f"{first} to {last - 1}"],
             ["Machine", results["machine"]], ["Mirrorball", results["version"]]]  # fmt: skip
    sections = [table(["", ""], facts)]
    if results["differs"]:
        items = "".join(f"<li>{html.escape(text)}</li>" for text in results["differs"])
        sections.append(f"<h2>Not as in the paper</h2><ul>{items}</ul>")
    with matplotlib.rc_context({"axes.titley": 1.0}):
        for part in results["parts"]:
            sections.append(f"<h2>{html.escape(part['title'])}</h2>")
            columns = read(folder / part["rows"])
            sections += [picture(figure) for figure in PLOTS[part["kind"]](columns)]
            sections.append(metrics_table(part["figures"]))
            sections += definitions(part["figures"])
    return write(folder, title=results["title"], sections=sections)


def definitions(figures: list[Part]) -> list[str]:
    """Paragraphs that say how the figures with such a name are counted."""
    names = {figure["name"] for figure in figures}
    return [f"<p>{html.escape(text)}</p>" for name, text in DEFINITIONS.items() if name in names]


def read(path: Path) -> Columns:
    """The columns of a CSV file: numbers where all are numbers (NaN where empty), else texts."""
    with path.open(newline="", encoding="utf-8") as file:
        rows = csv.reader(file)
        names = next(rows)
        lists = list(zip(*rows, strict=True)) or [()] * len(names)
    columns: Columns = {}
    for name, values in zip(names, lists, strict=True):
        try:
            columns[name] = np.array([float(value) if value else np.nan for value in values])
        except ValueError:
            columns[name] = np.array(values)
    return columns


def metrics_table(figures: list[Part]) -> str:
    """One row a figure and variant: the paper's number, then each method's with its interval."""
    methods = list(dict.fromkeys(one["method"] for one in figures))
    cells: dict[tuple[str, str], dict[str, Part]] = {}
    for one in figures:
        cells.setdefault((one["variant"], one["name"]), {})[one["method"]] = one
    rows = []
    for (variant, name), found in cells.items():
        paper = next((one["paper"] for one in found.values() if one["paper"]), None)
        rows.append([variant, name, _format_paper_value(paper), *(_format_metric(found.get(method)) for method in methods)])
    return table(["", "", "paper", *methods], rows)


def _format_paper_value(paper: Part | None) -> str:
    if paper is None:
        return ""
    until = "" if paper["until"] is None else f" to {paper['until']:g}"
    return f"{paper['value']:g}{until} ({paper['place']})"


def _format_metric(one: Part | None) -> str:
    if one is None or one["value"] is None:
        return "–"
    interval = one["interval"]
    if interval is None:
        return format_significant(one["value"])
    return f"{format_significant(one['value'])} [{format_significant(interval['low'])}, {format_significant(interval['high'])}]"


def format_significant(value: float) -> str:
    """Three digits that matter, no powers of ten."""
    size = abs(value)
    digits = 1 if size >= 100.0 else 2 if size >= 1.0 else 3 if size >= 0.01 or size == 0.0 else 5
    return f"{value:.{digits}f}"


def unique_in_order(values: NDArray[Any]) -> list[Any]:
    """Values in the order of their first coming."""
    return list(dict.fromkeys(values.tolist()))


def _subplots(rows: int, columns: int, *, width: float = 11.0, height: float = 3.2) -> tuple[Figure, list[list[Any]]]:
    figure = Figure(figsize=(width, height * rows + 0.3), dpi=100)
    axes = [[figure.add_subplot(rows, columns, row * columns + column + 1) for column in range(columns)]
            for row in range(rows)]  # fmt: skip
    figure.subplots_adjust(left=0.07, right=0.98, top=1.0 - 0.35 / (height * rows), bottom=0.5 / (height * rows),
                           wspace=0.25, hspace=0.45)  # fmt: skip
    for ax in (ax for line in axes for ax in line):
        ax.spines[["top", "right"]].set_visible(False)
        ax.grid(color="#e8e8e8", linewidth=0.6)
        ax.set_axisbelow(True)
    return figure, axes


def plot_single_image_errors(columns: Columns) -> list[Figure]:
    """Lima2001 figure 10: histograms of the errors with a Gaussian fitted, and all errors with the rectangle of one σ."""
    drawn = []
    for method in unique_in_order(columns["method"]):
        mine = columns["method"] == method
        error = 100.0 * np.stack([columns["error_x_m"][mine], columns["error_y_m"][mine]], axis=1)
        error = error[np.isfinite(error).all(axis=1)]
        near = error[np.hypot(error[:, 0], error[:, 1]) < 50.0]
        figure, ((left, middle, right),) = _subplots(1, 3, height=3.6)
        if len(near) < 2:
            left.set_title(f"{method}: {len(near)} located")
            drawn.append(figure)
            continue
        mean, std = near.mean(axis=0), near.std(axis=0, ddof=1)
        for ax, axis, name in ((left, 0, "x"), (middle, 1, "y")):
            reach = max(4.0 * std[axis], abs(mean[axis]) + 3.0 * std[axis])
            bins = np.linspace(-reach, reach, 25)
            ax.hist(near[:, axis], bins=bins, color=COLOURS[0], alpha=0.6)
            fine = np.linspace(-reach, reach, 200)
            bell = np.exp(-0.5 * ((fine - mean[axis]) / std[axis]) ** 2) / (std[axis] * np.sqrt(2.0 * np.pi))
            ax.plot(fine, bell * len(near) * (bins[1] - bins[0]), color=ESTIMATE_COLOUR, linewidth=1.6)
            ax.set(xlabel=f"error in {name} / cm", ylabel="images", title=f"{method}: μ {mean[axis]:.2f}, σ {std[axis]:.2f} cm")
        right.plot(near[:, 0], near[:, 1], ".", color=COLOURS[0], markersize=4.0)
        x, y = mean[0] + std[0] * np.array([-1, 1, 1, -1, -1]), mean[1] + std[1] * np.array([-1, -1, 1, 1, -1])
        right.plot(x, y, color=ESTIMATE_COLOUR, linewidth=1.4)
        right.set(xlabel="error in x / cm", ylabel="error in y / cm", title="one σ about the mean")
        drawn.append(figure)
    return drawn


def plot_trajectories(columns: Columns) -> list[Figure]:
    """Nubot2013 figures 8 and 9: true tracks black, estimates red; then each error over time, of the first seed."""
    seed = columns["seed"].min() if columns["seed"].size else 0
    variants, methods = unique_in_order(columns["variant"]), unique_in_order(columns["method"])
    cells = [(method, variant) for method in methods for variant in variants]
    # A row for each method, at most four plots wide; one variant alone has its methods side by side.
    width = max(1, min(len(variants) if len(variants) > 1 else len(methods), 4))
    paths, axes = _subplots(max(1, -(-len(cells) // width)), width, height=2.5 if width > 2 else 4.0)
    places = [ax for line in axes for ax in line]
    over_time, (ax_time,) = _subplots(1, 1, height=3.4)
    for ax in places[len(cells) :]:
        ax.set_visible(False)
    for ax, (method, variant) in zip(places, cells, strict=False):
        mine = (columns["method"] == method) & (columns["variant"] == variant) & (columns["seed"] == seed)
        ax.plot(*_break_at_jumps(columns["true_x_m"][mine], columns["true_y_m"][mine]), color=TRUTH_COLOUR, linewidth=1.8)
        ax.plot(*_break_at_jumps(columns["x_m"][mine], columns["y_m"][mine]), color=ESTIMATE_COLOUR, linewidth=0.8)
        ax.set_aspect("equal", adjustable="datalim")
        ax.set_title(f"{method}: {variant}", fontsize=8)
        ax.tick_params(labelsize=7)
    for index, (method, variant) in enumerate(cells):
        mine = (columns["method"] == method) & (columns["variant"] == variant) & (columns["seed"] == seed)
        off = np.hypot(columns["x_m"][mine] - columns["true_x_m"][mine], columns["y_m"][mine] - columns["true_y_m"][mine])
        ax_time[0].plot(columns["stamp_s"][mine], np.maximum(100.0 * off, 1e-2), linewidth=0.8,
                        color=COLOURS[index % len(COLOURS)], label=f"{method}: {variant}")  # fmt: skip
    ax_time[0].set(yscale="log", xlabel="time / s", ylabel="position error / cm", title="gaps: lost")
    if len(cells) <= 8:
        ax_time[0].legend(frameon=False, fontsize=7, ncols=2, loc="upper right")
    return [paths, over_time]


def _break_at_jumps(x: NDArray[Any], y: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    jumps = 1 + np.flatnonzero(np.hypot(np.diff(x), np.diff(y)) > 0.5)
    return np.insert(x, jumps, np.nan), np.insert(y, jumps, np.nan)


def plot_stage_times(columns: Columns) -> list[Figure]:
    """Nubot2013 figure 12: time of each cycle."""
    figure, ((ax,),) = _subplots(1, 1, height=3.6)
    for index, method in enumerate(unique_in_order(columns["method"])):
        mine = columns["method"] == method
        ax.plot(columns["cycle"][mine], columns["time_ms"][mine], linewidth=0.7, color=COLOURS[index % len(COLOURS)],
                label=f"{method}, median {np.median(columns['time_ms'][mine]):.3g} ms")  # fmt: skip
    ax.set(yscale="log", xlabel="cycle", ylabel="time / ms")
    ax.legend(frameon=False, fontsize=8, loc="upper right", ncols=3)
    return [figure]


def plot_global_search(columns: Columns) -> list[Figure]:
    """Positions where single images were localized correctly, and where not."""
    methods = unique_in_order(columns["method"])
    figure, (line,) = _subplots(1, len(methods), height=3.0)
    for ax, method in zip(line, methods, strict=True):
        mine, right = columns["method"] == method, columns["right"] == 1.0
        for which, colour, size in ((mine & right, "#9cc3dd", 3.0), (mine & ~right, ESTIMATE_COLOUR, 5.0)):
            ax.plot(columns["true_x_m"][which], columns["true_y_m"][which], ".", color=colour, markersize=size)
        ax.set_aspect("equal", adjustable="datalim")
        ax.set_title(f"{method}: {int((mine & right).sum())} of {int(mine.sum())}", fontsize=9)
    return [figure]


def plot_error_landscape(columns: Columns) -> list[Figure]:
    """Error surface over the field (from above and as a relief), and the histograms' peaks over the heading."""
    surface = columns["layer"] == "error"
    x, y = (np.unique(columns[name][surface]) for name in ("x_m", "y_m"))
    error = columns["value"][surface].reshape(y.size, x.size)
    turned = columns["layer"] == "histogram"
    truth = columns["x_m"][turned][0], columns["y_m"][turned][0]
    above, ((ax,),) = _subplots(1, 1, height=5.6)
    shade = ax.pcolormesh(x, y, error, cmap="viridis", shading="nearest", rasterized=True)
    above.colorbar(shade, ax=ax, label="mean error, eq. 5")
    ax.plot(*truth, "x", color="white", markersize=9)
    lowest = np.unravel_index(np.argmin(error), error.shape)
    ax.plot(x[lowest[1]], y[lowest[0]], "o", markerfacecolor="none", color=ESTIMATE_COLOUR, markersize=9)
    ax.set(xlabel="x / m", ylabel="y / m", title="cross: truth; circle: lowest cell")
    ax.set_aspect("equal")
    relief = Figure(figsize=(11.0, 4.4), dpi=100)
    hills = relief.add_subplot(1, 2, 1, projection="3d")
    every = (slice(None, None, 2), slice(None, None, 2))
    hills.plot_surface(*(grid[every] for grid in np.meshgrid(x, y)), 1.0 - error[every], cmap="viridis", linewidth=0.0)
    hills.set(xlabel="x / m", ylabel="y / m", zlabel="1 − error")
    peaks = relief.add_subplot(1, 2, 2)
    peaks.plot(np.degrees(columns["theta_rad"][turned]), columns["value"][turned], color=COLOURS[0])
    peaks.set(xlabel="heading / °", ylabel="points in the highest bins", title="histograms over the heading")
    peaks.grid(color="#e8e8e8")
    relief.subplots_adjust(left=0.02, right=0.98, bottom=0.14, top=0.92)
    return [above, relief]


def plot_detection_rates(columns: Columns) -> list[Figure]:
    """Share of line points that are right, and of markings, ball and robots that are found, over their distance."""
    kinds = [
        ("line point", "line points right"),
        ("marking", "markings sampled"),
        ("ball", "ball found"),
        ("robot", "robots found"),
    ]
    drawn = []
    for method in unique_in_order(columns["method"]):
        figure, axes = _subplots(2, 2, height=2.6)
        for ax, (kind, title) in zip((ax for line in axes for ax in line), kinds, strict=True):
            for index, variant in enumerate(unique_in_order(columns["variant"])):
                mine = (columns["method"] == method) & (columns["variant"] == variant) & (columns["kind"] == kind)
                # Bins with few samples are not significant.
                mine &= columns["count"] >= 10
                share = 100.0 * columns["right"][mine] / columns["count"][mine]
                ax.plot(columns["range_m"][mine] + 0.25, share, ".-", linewidth=1.2, markersize=5.0,
                        color=COLOURS[index % len(COLOURS)], label=variant)  # fmt: skip
            ax.set(xlim=(0.0, 9.0), ylim=(0.0, 104.0), xlabel="distance / m", ylabel="%", title=f"{method}: {title}")
        axes[0][0].legend(frameon=False, fontsize=7, loc="lower left")
        drawn.append(figure)
    return drawn


def plot_fusion_errors(columns: Columns) -> list[Figure]:
    """Error of each estimator on each course, and how honest each is: one dot a seed, a bar for their mean."""
    titles = [("position_m", 100.0, "mean position error / cm"), ("blind_m", 100.0, "after 2 s without vision / cm"),
              ("after_hit_m", 100.0, "in the second after a hit / cm"), ("nees", 1.0, "NEES (3 is honest)")]  # fmt: skip
    drawn = []
    for name, scale, title in titles:
        # Wheels alone state no uncertainty: NEES 0 is none.
        known = columns[name] > 0.0
        if known.any():
            drawn.append(_plot_grouped_bars(columns, known, scale * columns[name], title, log=True))
    if drawn and "nees" in columns:
        drawn[-1].axes[0].axhline(3.0, color=TRUTH_COLOUR, linewidth=0.8)
    return drawn


def plot_team_ball_errors(columns: Columns) -> list[Figure]:
    """Ball error of each robot and of the team: one dot per robot and seed, a bar for their mean."""
    known = np.isfinite(columns["error_m"])
    return (
        [_plot_grouped_bars(columns, known, 100.0 * columns["error_m"], "error of the ball / cm", log=False)]
        if known.any()
        else []
    )


def plot_certainty_times(columns: Columns) -> list[Figure]:
    """Time until a robot at an ambiguous place tracks the right pose: one dot per place, a bar for their mean."""
    known = np.isfinite(columns["seconds"])
    title = "time until the right pose is tracked for good / s (where it was)"
    return [_plot_grouped_bars(columns, known, columns["seconds"], title, log=False)] if known.any() else []


def plot_certificates(columns: Columns) -> list[Figure]:
    """Share of the points that no other pose exceeds: one dot per image, a bar for their mean."""
    known = np.isfinite(columns["others_share_max"])
    title = "no other pose explains more than / %"
    return [_plot_grouped_bars(columns, known, 100.0 * columns["others_share_max"], title, log=False)] if known.any() else []


def plot_field_errors(columns: Columns) -> list[Figure]:
    """Errors of fields mapped from drives: one dot per drive, a bar for their mean."""
    known = np.isfinite(columns["marking_error_m"])
    title = "error of the mapped markings / cm"
    return [_plot_grouped_bars(columns, known, 100.0 * columns["marking_error_m"], title, log=False)] if known.any() else []


def _plot_grouped_bars(columns: Columns, known: NDArray[Any], values: NDArray[Any], title: str, *, log: bool) -> Figure:
    figure, ((ax,),) = _subplots(1, 1, height=3.4)
    variants, methods = unique_in_order(columns["variant"][known]), unique_in_order(columns["method"][known])
    width = 0.8 / len(methods)
    for index, method in enumerate(methods):
        colour = COLOURS[index % len(COLOURS)]
        cells = [values[known & (columns["method"] == method) & (columns["variant"] == variant)] for variant in variants]
        places = np.arange(len(variants)) + width * (index - 0.5 * (len(methods) - 1))
        means = [cell.mean() if cell.size else np.nan for cell in cells]
        ax.bar(places, means, 0.9 * width, color=colour, alpha=0.55, label=method)
        for place, cell in zip(places, cells, strict=True):
            ax.plot(np.full(cell.size, place), cell, ".", color=colour, markersize=3.0)
    ax.set_xticks(np.arange(len(variants)), variants, fontsize=8)
    if log:
        ax.set_yscale("log")
    ax.set(ylabel=title, title=title)
    ax.legend(frameon=False, fontsize=8, ncols=min(6, len(methods)), loc="upper left")
    # The legend stands above the bars.
    low, high = ax.get_ylim()
    ax.set_ylim(low, high * ((high / low) ** 0.2 if log else 1.15))
    return figure


PLOTS: dict[str, Callable[[Columns], list[Figure]]] = {
    "stills": plot_single_image_errors,
    "drives": plot_trajectories,
    "times": plot_stage_times,
    "searches": plot_global_search,
    "landscape": plot_error_landscape,
    "eyes": plot_detection_rates,
    "fusion": plot_fusion_errors,
    "team": plot_team_ball_errors,
    "certainty": plot_certainty_times,
    "certificates": plot_certificates,
    "mapping": plot_field_errors,
}
"""How each kind of part is drawn."""
