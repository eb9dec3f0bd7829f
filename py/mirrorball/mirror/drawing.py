"""A drawing that a workshop understands: section and front view to scale with dimensions, a table of radii, what errors cost.

Lengths are millimetres, heights are above the mirror's apex, and the axis is vertical.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.interpolate import CubicSpline

from mirrorball._core import Camera
from mirrorball.arguments import checked
from mirrorball.mirror.cad_export import MM_PER_M, Export
from mirrorball.mirror.ground_costs import cost_rows, ground_costs
from mirrorball.mirror.profile_design import Mirror
from mirrorball.mirror.reflection import Array
from mirrorball.mirror.reporting import fit_camera
from mirrorball.output_file import replacing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SHEET_MM = (420.0, 297.0)
"""A3, landscape."""
MARGIN_MM = 10.0
SECTION_WIDTH_MM = 235.0
"""Width on the sheet for the section and, below it, the front view."""
SECTION_TOP_MM = 165.0
"""Lower edge of the section's half of the sheet."""
SCALES = (5.0, 2.0, 1.0, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01)
"""Of ISO 5455, from the largest; 1 is full size."""
TABLE_ROWS = 40
SHORT_MM = 14.0
"""A dimension shorter than this on the sheet has its number beside it."""
BODY_MM = 10.0
"""Drawn thickness behind the rim, as in the STL body."""
TEXT_MM = 2.6
THIN, THICK = 0.5, 1.4
POINTS_PER_MM = 72.0 / 25.4


@checked
def radius_table(mirror: Mirror, *, rows: int = TABLE_ROWS) -> Array:
    """Radius, height above the apex (both millimetres) and slope angle (degrees): even steps, and the ends of the parts."""
    apex = float(mirror.segments[0].height(np.zeros(1))[0])
    step = _round_step(MM_PER_M * mirror.radius_m / rows)
    found: list[tuple[float, float, float]] = []
    for segment in mirror.segments:
        t = np.linspace(segment.t_from, segment.t_to, 2000)
        y = segment.height(t)
        x = MM_PER_M * t * y
        slope = np.degrees(np.arctan(segment.tangent(t, y)))
        inside = np.arange(np.ceil(x[0] / step - 1e-9) * step, x[-1], step)
        at = np.unique(np.concatenate([[x[0]], inside, [x[-1]]]))
        # Part's ends that fall next to an even radius would be two rows of one place.
        keep = np.ones(at.size, dtype=bool)
        keep[1:-1] = (at[1:-1] - at[0] > 0.1 * step) & (at[-1] - at[1:-1] > 0.1 * step)
        at = at[keep]
        heights = CubicSpline(x, MM_PER_M * (y - apex))(at)
        found += list(zip(at.tolist(), heights.tolist(), np.interp(at, x, slope).tolist(), strict=True))
    # Where two parts meet with one height and slope, one row is enough.
    rows_of_table = np.array(found)
    new = np.ones(len(found), dtype=bool)
    new[1:] = np.abs(np.diff(rows_of_table, axis=0)).max(axis=1) > 5e-4
    return np.asarray(rows_of_table[new])


@checked
def drawing(mirror: Mirror, *, camera: Camera, reach_m: float = 12.0) -> Figure:
    """The sheet, A3, drawn to the largest standard scale that fits."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(SHEET_MM[0] / 25.4, SHEET_MM[1] / 25.4))
    sheet = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    sheet.set(xlim=(0.0, SHEET_MM[0]), ylim=(0.0, SHEET_MM[1]))
    sheet.set_axis_off()
    _frame(sheet)
    scale = _scale(mirror)
    _section(sheet, mirror, scale)
    _front(sheet, mirror, scale)
    _tables(sheet, mirror, camera, reach_m)
    _title(sheet, mirror, camera, scale)
    return figure


@checked
def write_pdf(mirror: Mirror, path: str | Path, *, camera: Camera | None = None, reach_m: float = 12.0) -> Export:
    """The drawing as PDF, or as PNG or SVG by the path's ending.

    `deviation_m` is that of a cubic curve laid through the rows of its table within each part, which round to a micrometre.
    """
    path = Path(path)
    figure = drawing(mirror, camera=camera or fit_camera(mirror), reach_m=reach_m)
    kind = path.suffix.removeprefix(".") or "pdf"
    with replacing(path) as part:
        figure.savefig(part, format=kind, dpi=110, metadata={"CreationDate": None} if kind == "pdf" else None)
    return Export(path, _table_deviation_m(mirror))


def _table_deviation_m(mirror: Mirror) -> float:
    table = np.round(radius_table(mirror), 3)
    apex = float(mirror.segments[0].height(np.zeros(1))[0])
    worst = 0.0
    for segment in mirror.segments:
        t = np.linspace(segment.t_from, segment.t_to, 1000)
        y = segment.height(t)
        x = MM_PER_M * t * y
        mine = table[(table[:, 0] >= x[0] - 2e-3) & (table[:, 0] <= x[-1] + 2e-3)]
        radius, first = np.unique(mine[:, 0], return_index=True)
        heights = mine[first, 1]
        curve = CubicSpline(radius, heights)(x) if radius.size > 2 else np.interp(x, radius, heights)
        worst = max(worst, float(np.abs(curve - MM_PER_M * (y - apex)).max()))
    return worst / MM_PER_M


def _round_step(step: float) -> float:
    """The next larger 1, 2 or 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(step))
    return float(next(factor * power for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= step * (1.0 - 1e-9)))


def _scale(mirror: Mirror) -> float:
    diameter = 2.0 * MM_PER_M * mirror.radius_m
    # The front view is the tighter one: a whole circle, with a dimension beside it.
    room = min(SECTION_WIDTH_MM - 70.0, SECTION_TOP_MM - MARGIN_MM - 20.0)
    return next((scale for scale in SCALES if diameter * scale <= room), SCALES[-1])


def _frame(sheet: Axes) -> None:
    low_x, low_y = MARGIN_MM, MARGIN_MM
    high_x, high_y = SHEET_MM[0] - MARGIN_MM, SHEET_MM[1] - MARGIN_MM
    sheet.plot([low_x, high_x, high_x, low_x, low_x], [low_y, low_y, high_y, high_y, low_y], color="black", linewidth=THICK)


def _text(sheet: Axes, x: float, y: float, text: str, *, size: float = TEXT_MM, turned: bool = False, place: str = "center",
          bold: bool = False) -> None:  # fmt: skip
    sheet.text(x, y, text, fontsize=size * POINTS_PER_MM, ha=place, va="center", rotation=90 if turned else 0,
               weight="bold" if bold else "normal", bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.6})  # fmt: skip


def _dimension(sheet: Axes, start: tuple[float, float], end: tuple[float, float], text: str) -> None:
    """An arrow from start to end, horizontal or vertical, with its number in the middle."""
    sheet.annotate("", xy=end, xytext=start,
                   arrowprops={"arrowstyle": "<|-|>", "linewidth": THIN, "color": "black", "mutation_scale": 6,
                               "shrinkA": 0, "shrinkB": 0})  # fmt: skip
    upright = start[0] == end[0]
    x, y = (start[0] + end[0]) / 2.0, (start[1] + end[1]) / 2.0
    if upright and abs(end[1] - start[1]) < SHORT_MM:
        y = max(start[1], end[1]) + 0.7 * SHORT_MM
    elif not upright and abs(end[0] - start[0]) < 1.5 * SHORT_MM:
        x = max(start[0], end[0]) + 0.8 * SHORT_MM
    _text(sheet, x, y, text, turned=upright)


def _extension(sheet: Axes, x: list[float], y: list[float]) -> None:
    sheet.plot(x, y, color="black", linewidth=THIN)


def _section(sheet: Axes, mirror: Mirror, scale: float) -> None:
    """The meridian from rim to rim, reflecting side below; heights at the right, diameters above."""
    middle = MARGIN_MM + SECTION_WIDTH_MM / 2.0 - 12.0
    apex = float(mirror.segments[0].height(np.zeros(1))[0])
    ends = [(MM_PER_M * float(segment.t_to * segment.end()[0]), MM_PER_M * (float(segment.end()[0]) - apex))
            for segment in mirror.segments]  # fmt: skip
    # The apex is the lowest point of a convex mirror, but a planar or concave rim may lie anywhere.
    heights = [0.0, *(height for _, height in ends)]
    low, high = min(heights), max(heights) + BODY_MM
    diameters = len(ends)
    base = SHEET_MM[1] - MARGIN_MM - 14.0 - 7.0 * diameters - high * scale
    _text(sheet, MARGIN_MM + 4.0, SHEET_MM[1] - MARGIN_MM - 6.0, "SECTION THROUGH THE AXIS", size=3.2, place="left", bold=True)

    def place(x: float, height: float) -> tuple[float, float]:
        return middle + scale * x, base + scale * height

    for side in (1.0, -1.0):
        outline: list[tuple[float, float]] = []
        for segment in mirror.segments:
            t = np.linspace(segment.t_from, segment.t_to, 200)
            y = segment.height(t)
            points = [place(side * MM_PER_M * float(x), MM_PER_M * float(h - apex)) for x, h in zip(t * y, y, strict=True)]
            outline += points
            style = "-" if segment.reflects else ":"
            sheet.plot(*zip(*points, strict=True), color="black", linewidth=2.0 * THICK, linestyle=style)
        rim = place(side * ends[-1][0], ends[-1][1])
        top = place(side * ends[-1][0], max(heights) + BODY_MM)
        back = place(0.0, max(heights) + BODY_MM)
        sheet.plot([rim[0], top[0], back[0]], [rim[1], top[1], back[1]], color="black", linewidth=THIN)
        body = [*outline, top, back]
        sheet.fill(*zip(*body, strict=True), facecolor="none", edgecolor="#9a9a9a", hatch="////", linewidth=0.0)
    _axis(sheet, (middle, middle), (base + scale * low - 8.0, base + scale * high + 4.0 + 7.0 * diameters))
    for number, (radius, height) in enumerate(ends):
        line = base + scale * high + 6.0 + 7.0 * number
        for side in (1.0, -1.0):
            _extension(sheet, [middle + side * scale * radius] * 2, [base + scale * height, line + 1.5])
        _dimension(sheet, (middle - scale * radius, line), (middle + scale * radius, line), f"⌀ {2.0 * radius:.3f}")
    right = middle + scale * ends[-1][0] + 8.0
    # Ends of one height need one dimension: the outermost.
    shown = {round(height, 3): (radius, height) for radius, height in ends if abs(height) >= 5e-4}
    _extension(sheet, [middle, right + 8.0 * len(shown)], [base, base])
    for number, (radius, height) in enumerate(shown.values()):
        x = right + 8.0 * number
        _extension(sheet, [middle + scale * radius, x + 1.5], [base + scale * height] * 2)
        _dimension(sheet, (x, base), (x, base + scale * height), f"{height:.3f}")
    down = base + scale * low - 6.0
    above, floor = MM_PER_M * apex, MM_PER_M * mirror.pinhole_height_m
    black = any(not segment.reflects for segment in mirror.segments)
    notes = (
        f"apex {above:.3f} above the camera's pinhole, which is {floor:.1f} above the floor",
        "reflecting side below; dotted: black, not reflecting" if black else "reflecting side below",
    )
    for number, note in enumerate(notes):
        _text(sheet, middle, down - 4.5 * (number + 1), note)


def _front(sheet: Axes, mirror: Mirror, scale: float) -> None:
    """Seen from the camera: the rim and the circles at which parts meet."""
    middle = MARGIN_MM + SECTION_WIDTH_MM / 2.0 - 12.0
    rim = scale * MM_PER_M * mirror.radius_m
    height = MARGIN_MM + 12.0 + rim
    head = min(height + rim + 10.0, SECTION_TOP_MM)
    _text(sheet, MARGIN_MM + 4.0, head, "FRONT, SEEN FROM THE CAMERA", size=3.2, place="left", bold=True)
    turn = np.linspace(0.0, 2.0 * np.pi, 361)
    for number, segment in enumerate(mirror.segments, start=1):
        radius = scale * MM_PER_M * float(segment.t_to * segment.end()[0])
        last = number == len(mirror.segments)
        sheet.plot(middle + radius * np.cos(turn), height + radius * np.sin(turn), color="black",
                   linewidth=2.0 * THICK if last else THIN, linestyle="-" if last else "--")  # fmt: skip
        if not segment.reflects:
            inner = scale * MM_PER_M * float(segment.t_from * segment.height(np.array([segment.t_from]))[0])
            for edge in np.linspace(inner, radius, 5)[1:-1]:
                sheet.plot(middle + edge * np.cos(turn), height + edge * np.sin(turn), color="#9a9a9a", linewidth=THIN)
        # A leader from each part to its name at the right.
        inside = float(segment.t_from * segment.height(np.array([segment.t_from]))[0]) * scale * MM_PER_M
        angle = np.radians(50.0 - 100.0 * (number - 0.5) / len(mirror.segments))
        at = (inside + radius) / 2.0
        start = (middle + at * np.cos(angle), height + at * np.sin(angle))
        name_y = height + (0.5 - (number - 0.5) / len(mirror.segments)) * 1.5 * rim
        name_x = middle + rim + 8.0
        _extension(sheet, [start[0], name_x - 1.0], [start[1], name_y])
        sheet.plot([start[0]], [start[1]], ".", color="black", markersize=3)
        _text(sheet, name_x, name_y, f"{number} {segment.part}" + ("" if segment.reflects else " (black)"), place="left")
    _axis(sheet, (middle - rim - 5.0, middle + rim + 5.0), (height, height))
    _axis(sheet, (middle, middle), (height - rim - 5.0, height + rim + 5.0))


def _axis(sheet: Axes, x: tuple[float, float], y: tuple[float, float]) -> None:
    sheet.plot(x, y, color="black", linewidth=THIN, dashes=(12, 3, 2, 3))


def _tables(sheet: Axes, mirror: Mirror, camera: Camera, reach_m: float) -> None:
    left, right = MARGIN_MM + SECTION_WIDTH_MM, SHEET_MM[0] - MARGIN_MM
    top = SHEET_MM[1] - MARGIN_MM
    sheet.plot([left, left], [MARGIN_MM, top], color="black", linewidth=THIN)
    _text(sheet, left + 3.0, top - 6.0, "SURFACE", size=3.2, place="left", bold=True)
    rows = [["radius / mm", "above apex / mm", "slope / °"]]
    rows += [[f"{value:.3f}" for value in row] for row in radius_table(mirror)]
    bottom = _table(sheet, left + 3.0, top - 11.0, rows, widths=(32.0, 36.0, 30.0))
    off = f"a cubic curve through each part's rows errs by {1e6 * _table_deviation_m(mirror):.1f} µm at most"
    _text(sheet, left + 3.0, bottom, f"{off}; the DXF has the exact shape", size=2.2, place="left")
    bottom -= 5.0
    _text(sheet, left + 3.0, bottom - 4.0, "WHAT AN IMPERFECTION COSTS", size=3.2, place="left", bold=True)
    costs = cost_rows(ground_costs(mirror, camera=camera, reach_m=reach_m), (1.0, 2.0, 4.0, 6.0, 8.0, 10.0))
    column = (right - left - 6.0 - 66.0) / max(len(costs[0]) - 1, 1)
    _table(sheet, left + 3.0, bottom - 9.0, costs, widths=(66.0, *[column] * (len(costs[0]) - 1)), size=2.2)


def _table(sheet: Axes, x: float, y: float, rows: list[list[str]], *, widths: tuple[float, ...], size: float = 2.5) -> float:
    """Draws a table with its head in bold; its lower edge."""
    step = 1.72 * size
    for number, row in enumerate(rows):
        at = y - step * number
        edge = x
        for column, (cell, width) in enumerate(zip(row, widths, strict=True)):
            words = column == 0 and not cell.replace(".", "").isdigit()
            where, place = (edge, "left") if words else (edge + width - 3.0, "right")
            sheet.text(
                where,
                at,
                cell,
                fontsize=size * POINTS_PER_MM,
                ha=place,
                va="center",
                weight="bold" if number == 0 else "normal",
            )
            edge += width
        if number == 0:
            _extension(sheet, [x, x + sum(widths)], [at - step / 2.0] * 2)
    return y - step * len(rows)


def _title(sheet: Axes, mirror: Mirror, camera: Camera, scale: float) -> None:
    left, right, low, high = MARGIN_MM + SECTION_WIDTH_MM, SHEET_MM[0] - MARGIN_MM, MARGIN_MM, MARGIN_MM + 30.0
    sheet.fill(
        [left, right, right, left], [low, low, high, high], facecolor="white", edgecolor="black", linewidth=THICK, zorder=3
    )
    ratio = f"{scale:g} : 1" if scale >= 1.0 else f"1 : {1.0 / scale:g}"
    lines = [
        f"scale {ratio} on A3, lengths in millimetres, surface of revolution",
        f"camera {camera.width_px} × {camera.height_px} px, focal length {camera.focal_px:.1f} px, "
        f"rim at {mirror.t_max * camera.focal_px:.1f} px",
        f"pinhole {MM_PER_M * mirror.pinhole_height_m:.1f} above the floor; radii to the nearest 0.001",
    ]
    sheet.text(left + 3.0, high - 7.0, mirror.name, fontsize=5.0 * POINTS_PER_MM, va="center", weight="bold", zorder=4)
    for number, line in enumerate(lines):
        sheet.text(left + 3.0, high - 14.0 - 5.0 * number, line, fontsize=2.6 * POINTS_PER_MM, va="center", zorder=4)
