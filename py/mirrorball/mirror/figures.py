"""Figures of an optical analysis, without pyplot: independent of a display and of a notebook's state."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.ticker import FormatStrFormatter, LogLocator, MaxNLocator, NullLocator

from mirrorball.mirror.heights import visible_heights
from mirrorball.mirror.optical_analysis import BALL_RADIUS_M, ROBOT_HEIGHT_M, OpticalAnalysis
from mirrorball.mirror.reflection import Array
from mirrorball.mirror.tolerances import GroundErrors

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis


PART_COLOURS = ("#1b6ca8", "#c8553d", "#3b8a4f", "#8a5fa8", "#b98b1d", "#4a4a4a")
"""One for each part, in order from the axis."""
Place = Literal["best", "upper left", "upper right", "lower right"]
GREY = "#8c8c8c"


def _subplots(count: int, *, width: float = 11.0, height: float = 4.2) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(width, height), dpi=100)
    axes = [figure.add_subplot(1, count, index + 1) for index in range(count)]
    # Fixed margins: constrained layout would draw every figure twice.
    figure.subplots_adjust(left=0.07, right=0.98, top=0.89, bottom=0.15, wspace=0.26)
    for ax in axes:
        ax.spines[["top", "right"]].set_visible(False)
        ax.xaxis.set_major_locator(MaxNLocator(6))
        ax.yaxis.set_major_locator(MaxNLocator(5))
    return figure, axes


def _draw_light_axes(figure: Figure) -> Figure:
    """Draws grid, numbers and labels as a few things in place of matplotlib's ticks.

    A tick is a dozen things, each laid out anew for every file: two thirds of the time that all of a page's figures take.
    """
    for ax in figure.axes:
        # An aspect that is kept changes the limits when drawn; numbers must fit what will be shown.
        ax.apply_aspect()
        _draw_axis(ax, ax.xaxis, upright=False)
        _draw_axis(ax, ax.yaxis, upright=True)
    return figure


def _draw_axis(ax: Axes, axis: Axis, *, upright: bool) -> None:
    def place(along: float, across: float) -> tuple[float, float]:
        return (across, along) if upright else (along, across)

    low, high = sorted(axis.get_view_interval())
    margin = 1e-9 * (high - low)
    marks = [float(at) for at in axis.get_majorticklocs() if low - margin <= at <= high + margin]
    mixed = ax.get_yaxis_transform() if upright else ax.get_xaxis_transform()
    grid = [[place(at, 0.0), place(at, 1.0)] for at in marks]
    ax.add_collection(LineCollection(grid, colors="#e4e4e4", linewidths=0.7, transform=mixed, zorder=0.5), autolim=False)
    aligned: dict[str, Any] = {"ha": "right", "va": "center"} if upright else {"ha": "center", "va": "top"}
    said = axis.get_major_formatter().format_ticks(marks)
    for at, number in zip(marks, said, strict=True):
        ax.text(*place(at, -0.01 if upright else -0.02), number, transform=mixed, **aligned)
    # Distances beside a plot are shares of its own width.
    beside = -0.075 * 0.5 / ax.get_position().width if upright else -0.1
    ax.text(*place(0.5, beside), axis.get_label_text(), transform=ax.transAxes, rotation=90 if upright else 0, **aligned)
    axis.set_visible(False)


def _set_log_scale(ax: Axes) -> None:
    if not any((np.nan_to_num(np.asarray(line.get_ydata(), dtype=np.float64)) > 0.0).any() for line in ax.lines):
        return
    # Plain numbers at 1, 2, 5: the usual powers of ten go through the formula typesetter, ten times slower.
    ax.set_yscale("log")
    ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0), numticks=9))
    ax.yaxis.set_major_formatter(FormatStrFormatter("%g"))
    ax.yaxis.set_minor_locator(NullLocator())


def _add_legend(ax: Axes, place: Place = "best") -> None:
    # "best" searches all points of all lines; a named place costs nothing.
    ax.legend(frameon=False, fontsize=8, loc=place)


def profile(judged: OpticalAnalysis) -> Figure:
    """The meridian with a few rays, and the whole rig over the ground."""
    figure, (near, far) = _subplots(2)
    for index, ring in enumerate(outline for outline in judged.outlines if not outline.reflects):
        label = ring.part if index == 0 else None
        near.plot(1e3 * ring.x_m, 1e3 * ring.y_m, color="black", linewidth=3.0, label=label)
    for view, colour in zip(judged.views, PART_COLOURS * 4, strict=False):
        rays = view.rays
        near.plot(1e3 * rays.x_m, 1e3 * rays.y_m, color=colour, linewidth=2.2, label=view.part)
        shown = np.linspace(0, rays.t.size - 1, 6).astype(int)
        x, y, gamma, ground = rays.x_m[shown], rays.y_m[shown], rays.gamma_rad[shown], view.ground_m[shown]
        zero, height, way = np.zeros(x.size), y + judged.pinhole_height_m, 0.09
        bent = np.stack([zero, x, x + way * np.sin(gamma), zero, y, y - way * np.cos(gamma)]).reshape(2, 3, -1)
        near.add_collection(LineCollection(list(1e3 * bent.T), colors=colour, linewidths=0.6))
        lands = np.isfinite(ground)
        end_x = np.where(lands, ground, x + 60.0 * np.sin(gamma))
        end_y = np.where(lands, 0.0, height - 60.0 * np.cos(gamma))
        down = np.stack([x, end_x, height, end_y]).reshape(2, 2, -1)
        far.add_collection(LineCollection(list(down.T), colors=colour, linewidths=0.8))
    radius = 1e3 * judged.radius_m
    low, high = 1e3 * float(judged.outlines[0].y_m[0]), 1e3 * float(judged.outlines[-1].y_m[-1])
    near.set(
        xlim=(-0.08 * radius, 2.1 * radius),
        ylim=(low - 0.75 * radius, max(high, low) + 0.15 * radius),
        xlabel="radius / mm",
        ylabel="above the pinhole / mm",
        title="Profile",
    )
    near.set_aspect("equal", adjustable="box")
    _add_legend(near, "lower right")
    far.axhline(0.0, color="#3b8a4f", linewidth=1.5)
    far.set(xlim=(0.0, judged.reach_m), ylim=(-0.05, 1.6), xlabel="distance / m", ylabel="height / m", title="Where rays go")
    return _draw_light_axes(figure)


def ground(judged: OpticalAnalysis) -> Figure:
    """Ground distance over image radius, and resolution over distance."""
    figure, (left, right) = _subplots(2)
    highest = 0.0
    for view, colour in zip(judged.views, PART_COLOURS * 4, strict=False):
        radius = judged.focal_px * view.rays.t
        left.plot(radius, np.where(view.ground_m <= 1.25 * judged.reach_m, view.ground_m, np.nan), color=colour,
                  linewidth=2.0, label=view.part)  # fmt: skip
        inside = view.ground_m <= judged.reach_m
        right.plot(view.ground_m[inside], view.radial_px_per_m[inside], color=colour, linewidth=2.0, label=view.part)
        right.plot(view.ground_m[inside], view.tangential_px_per_m[inside], color=colour, linewidth=1.2, linestyle="--")
        highest = max(highest, float(np.nanmax(view.radial_px_per_m[inside], initial=0.0)))
    for low, high in judged.blind_m:
        right.axvspan(low, high, color="#dddddd")
        left.axhspan(low, high, color="#dddddd")
    left.set(ylim=(0.0, judged.reach_m), xlabel="image radius / px", ylabel="ground distance / m", title="Ground over image")
    right.set(xlim=(0.0, judged.reach_m), xlabel="ground distance / m", ylabel="px/m",
              title="Resolution: radial —, tangential – –; grey: blind")  # fmt: skip
    if highest > 0.0:
        _set_log_scale(right)
    _add_legend(left, "upper left")
    return _draw_light_axes(figure)


def heights(judged: OpticalAnalysis) -> Figure:
    """Which heights are seen at which distance."""
    figure, (ax,) = _subplots(1)
    for seen, colour in zip(visible_heights(judged), PART_COLOURS * 4, strict=False):
        ax.fill_between(
            seen.distance_m, seen.lowest_m, seen.highest_m, color=colour, alpha=0.35, linewidth=0.0, label=seen.part
        )
        for curve in (seen.lowest_m, seen.highest_m):
            ax.plot(seen.distance_m, curve, color=colour, linewidth=1.0)
    ax.axhline(2.0 * BALL_RADIUS_M, color=GREY, linewidth=0.8, linestyle=":")
    ax.axhline(ROBOT_HEIGHT_M, color=GREY, linewidth=0.8, linestyle=":")
    for height, name in ((2.0 * BALL_RADIUS_M, "ball"), (ROBOT_HEIGHT_M, "robot")):
        ax.annotate(name, (judged.reach_m, height), xytext=(-4, 3), textcoords="offset points", ha="right", fontsize=8)
    for low_m, high_m in judged.blind_m:
        ax.plot([low_m, high_m], [0.0, 0.0], color="black", linewidth=5.0, solid_capstyle="butt", label="blind ground")
    ax.set(xlim=(0.0, judged.reach_m), ylim=(0.0, 1.6), xlabel="distance / m", ylabel="height / m", title="Heights seen")
    _add_legend(ax, "upper right")
    return _draw_light_axes(figure)


def surface(judged: OpticalAnalysis) -> Figure:
    """Slope and curvature over the radius, and the caustic."""
    figure, (left, middle, right) = _subplots(3)
    for view, colour in zip(judged.views, PART_COLOURS * 4, strict=False):
        radius = 1e3 * view.rays.x_m
        left.plot(radius, view.rays.slope, color=colour, linewidth=2.0, label=view.part)
        middle.plot(radius, view.curvature_per_m, color=colour, linewidth=2.0)
        near = np.hypot(view.caustic_x_m, view.caustic_y_m - judged.viewpoint_m) < 3.0 * judged.radius_m
        right.plot(1e3 * view.caustic_x_m[near], 1e3 * view.caustic_y_m[near], ".", color=colour, markersize=1.5)
        right.plot(radius, 1e3 * view.rays.y_m, color=colour, linewidth=1.0)
    right.plot([0.0], [1e3 * judged.viewpoint_m], "k+", markersize=9)
    worst = max(float(view.viewpoint_error_m.max()) for view in judged.views)
    smallest = 1e3 * judged.smallest_curvature_radius_m
    left.set(xlabel="radius / mm", ylabel="slope", title="Slope")
    middle.set(xlabel="radius / mm", ylabel="curvature · m", title=f"Curvature (smallest radius {smallest:.1f} mm)")
    error = f"{1e3 * worst:.1f} mm" if worst > 1e-6 else f"{worst:.0e} m"
    right.set(xlabel="radius / mm", ylabel="above the pinhole / mm", title=f"Caustic (viewpoint error {error})")
    _add_legend(left, "lower right")
    return _draw_light_axes(figure)


def sharpness(judged: OpticalAnalysis) -> Figure:
    """Where the virtual image lies, and the blur that one focus leaves."""
    figure, (left, right) = _subplots(2)
    for view, colour in zip(judged.views, PART_COLOURS * 4, strict=False):
        radius = judged.focal_px * view.rays.t
        left.plot(radius, 1.0 / view.image_tangential_m, color=colour, linewidth=2.0, label=view.part)
        left.plot(radius, 1.0 / view.image_sagittal_m, color=colour, linewidth=1.2, linestyle="--")
        meridional, sagittal = judged.blur_px(view)
        right.plot(radius, meridional, color=colour, linewidth=2.0)
        right.plot(radius, sagittal, color=colour, linewidth=1.2, linestyle="--")
    left.axhline(1.0 / judged.focus_m, color="black", linewidth=0.8, linestyle=":")
    left.set(xlabel="image radius / px", ylabel="1/distance / (1/m)",
             title="Virtual image: meridional —, sagittal – –; ··· focus")  # fmt: skip
    lens = f"f = {1e3 * judged.lens.focal_length_m:.1f} mm, f/{judged.lens.f_number:g}, focus {judged.focus_m:.2f} m"
    right.set(xlabel="image radius / px", ylabel="blur diameter / px", title=f"Blur ({lens})", ylim=(0.0, None))
    _add_legend(left)
    return _draw_light_axes(figure)


def sizes(judged: OpticalAnalysis) -> Figure:
    """Pixels of ball, line and robot over distance."""
    figure, (left, right) = _subplots(2)
    found = judged.sizes
    things: tuple[tuple[str, Array, Array], ...] = (
        ("ball", found.ball_radial_px, found.ball_tangential_px),
        ("line", found.line_radial_px, found.line_tangential_px),
        ("robot", found.robot_radial_px, found.robot_tangential_px),
    )
    for (name, radial, tangential), colour in zip(things, PART_COLOURS, strict=False):
        for ax, size in ((left, radial), (right, tangential)):
            ax.plot(found.distance_m, np.where(size > 0.0, size, np.nan), color=colour, linewidth=2.0, label=name)
    for ax, title in ((left, "Radial size"), (right, "Tangential size")):
        ax.set(xlim=(0.0, judged.reach_m), xlabel="distance / m", ylabel="px", title=title)
        _set_log_scale(ax)
    _add_legend(left, "upper right")
    return _draw_light_axes(figure)


def tolerances(errors: GroundErrors) -> Figure:
    """Errors on the ground over distance, all together and each cause alone."""
    figure, (left, right) = _subplots(2)
    left.plot(errors.distance_m, 1e3 * errors.radial_rms_m, color=PART_COLOURS[0], linewidth=2.0, label="radial rms")
    left.plot(errors.distance_m, 1e3 * errors.tangential_rms_m, color=PART_COLOURS[2], linewidth=2.0, label="tangential rms")
    seen = np.where(np.isfinite(errors.total_95_m), errors.total_95_m, np.nan)
    left.plot(errors.distance_m, 1e3 * seen, color=PART_COLOURS[1], linewidth=1.2, linestyle="--", label="95 % stay below")
    for (cause, error), colour in zip(errors.by_cause_rms_m.items(), PART_COLOURS, strict=False):
        right.plot(errors.distance_m, 1e3 * error, color=colour, linewidth=1.8, label=cause)
    left.set(xlabel="ground distance / m", ylabel="error / mm", title=f"{errors.count} imperfect mirrors", ylim=(0.0, None))
    right.set(xlabel="ground distance / m", ylabel="rms error / mm", title="Each cause alone (one deviation)")
    _set_log_scale(right)
    _add_legend(left, "upper left")
    _add_legend(right, "lower right")
    return _draw_light_axes(figure)
