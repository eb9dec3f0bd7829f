"""Reports of designs: figures as PNG and SVG, and one self-contained HTML page."""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from mirrorball._core import Camera
from mirrorball.arguments import checked
from mirrorball.html_page import inline, table, whole
from mirrorball.mirror.ground_costs import GroundCost, cost_rows, ground_costs
from mirrorball.mirror.heights import visible_heights
from mirrorball.mirror.optical_analysis import Lens, OpticalAnalysis, judge
from mirrorball.mirror.papers import compare_with_papers
from mirrorball.mirror.plot_worker import PlotWorker, draw
from mirrorball.mirror.profile_design import Mirror
from mirrorball.mirror.tolerances import GroundErrors, Tolerances, monte_carlo
from mirrorball.output_file import replacing
from mirrorball.records import Record

FIGURES = {
    "profile": "Profile and rays",
    "ground": "Ground and resolution",
    "heights": "Heights and blind zones",
    "surface": "Slope, curvature and caustic",
    "sharpness": "Defocus",
    "sizes": "Ball, line and robot",
}
"""Name of file and drawing function, and heading, in the order of the page."""

WORKER_FIGURES = 4
"""So many of them are drawn by a second process: it is ready before this one has loaded matplotlib."""


@dataclass(frozen=True, eq=False)
class Report(Record):
    """What was found and where it was written."""

    folder: Path
    page: Path
    judgement: OpticalAnalysis
    errors: GroundErrors | None


@checked
def fit_camera(mirror: Mirror, *, size_px: int = 480, margin_px: int = 6) -> Camera:
    """A square camera that the mirror's rim fills but for a margin."""
    rim = (size_px - 1) / 2.0 - margin_px
    return Camera(
        width_px=size_px,
        height_px=size_px,
        focal_px=rim / mirror.t_max,
        pinhole_height_m=mirror.pinhole_height_m,
        outer_radius_px=rim,
    )


@checked
def report(
    mirror: Mirror,
    *,
    folder: str | Path,
    camera: Camera | None = None,
    lens: Lens | None = None,
    reach_m: float = 12.0,
    tolerances: Tolerances | None = None,
    mirrors: int = 0,
    seed: int = 1,
    progress: bool = True,
    drawer: PlotWorker | None = None,
) -> Report:
    """Judges a design and writes its figures, their numbers (CSV) and `index.html` into a folder (made if missing).

    `mirrors` imperfect mirrors are tried against `tolerances`; 0 leaves that out. A `drawer`, begun before the design, is a
    second process that draws a share.
    """
    final = Path(folder)
    final.mkdir(parents=True, exist_ok=True)
    camera = camera or fit_camera(mirror)
    judged = judge(mirror, focal_px=camera.focal_px, lens=lens, reach_m=reach_m)
    # A report appears complete or not at all.
    with tempfile.TemporaryDirectory(prefix=".report-", dir=final) as unfinished, _abandoned_on_error(drawer):
        errors = _write_report(
            mirror,
            judged,
            folder=Path(unfinished),
            camera=camera,
            drawer=drawer,
            errors=partial(
                monte_carlo,
                mirror,
                camera=camera,
                tolerances=tolerances,
                count=mirrors,
                reach_m=reach_m,
                seed=seed,
                progress=progress,
            )
            if mirrors
            else None,
        )
        for file in Path(unfinished).iterdir():
            file.replace(final / file.name)
    return Report(folder=final, page=final / "index.html", judgement=judged, errors=errors)


@contextmanager
def _abandoned_on_error(drawer: PlotWorker | None) -> Iterator[None]:
    """Stops the drawing after an error: a folder cannot be removed while a process writes to it."""
    try:
        yield
    except BaseException:
        if drawer is not None:
            drawer.abandon()
        raise


def _write_report(
    mirror: Mirror,
    judged: OpticalAnalysis,
    *,
    folder: Path,
    camera: Camera,
    drawer: PlotWorker | None,
    errors: Callable[[], GroundErrors] | None,
) -> GroundErrors | None:
    names = list(FIGURES)
    if drawer is not None:
        # Imperfect mirrors take longer than all figures.
        beside = len(names) if errors else WORKER_FIGURES
        drawer.draw(judged, names[:beside], folder)
        names = names[beside:]
    found = errors() if errors else None
    if found is not None:
        draw(found, ["tolerances"], folder)
    draw(judged, names, folder)
    costs = ground_costs(mirror, camera=camera, reach_m=judged.reach_m)
    if drawer is not None:
        drawer.finish()
    sections = [_section(name, heading, folder) for name, heading in FIGURES.items()]
    if costs:
        sections += ["<h2>What an imperfection costs</h2>", table(cost_rows(costs)[0], cost_rows(costs)[1:])]
    sections += ["<h2>The papers' mirrors</h2>", _paper_table(judged)]
    if found is not None:
        sections += [_section("tolerances", "Tolerances", folder), _error_table(found)]
    _write_tables(judged, folder)
    _write_costs(costs, folder)
    with replacing(folder / "index.html") as part:
        part.write_text(_page(judged, camera, sections), encoding="utf-8")
    return found


def _write_tables(judged: OpticalAnalysis, folder: Path) -> None:
    """The figures' numbers: heights.csv, resolution.csv and sizes.csv, lengths in metres, NaN where nothing is seen."""
    heights: list[tuple[str, ...]] = [("part", "distance_m", "lowest_m", "highest_m")]
    for seen in visible_heights(judged):
        bounds = zip(seen.distance_m, seen.lowest_m, seen.highest_m, strict=True)
        heights += [(seen.part, *(f"{value:.6g}" for value in row)) for row in bounds]
    resolution: list[tuple[str, ...]] = [("part", "image_radius_px", "ground_m", "radial_px_per_m", "tangential_px_per_m")]
    for view in judged.views:
        columns = (judged.focal_px * view.rays.t, view.ground_m, view.radial_px_per_m, view.tangential_px_per_m)
        resolution += [(view.part, *(f"{value:.6g}" for value in row)) for row in zip(*columns, strict=True)]
    names = [field.name for field in dataclasses.fields(judged.sizes)]
    sizes: list[tuple[str, ...]] = [tuple(names)]
    sizes += [tuple(f"{v:.6g}" for v in row) for row in zip(*(getattr(judged.sizes, name) for name in names), strict=True)]
    for name, rows in (("heights", heights), ("resolution", resolution), ("sizes", sizes)):
        text = "".join(",".join(row) + "\n" for row in rows)
        with replacing(folder / f"{name}.csv") as part:
            part.write_text(text, encoding="utf-8")


def _write_costs(costs: list[GroundCost], folder: Path) -> None:
    """costs.csv: imperfection, distance_m, rms_m, largest_m."""
    lines = ["imperfection,distance_m,rms_m,largest_m"]
    for cost in costs:
        columns = zip(cost.distance_m, cost.rms_m, cost.largest_m, strict=True)
        lines += [f"{cost.imperfection},{distance:.6g},{rms:.6g},{largest:.6g}" for distance, rms, largest in columns]
    with replacing(folder / "costs.csv") as part:
        part.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _paper_table(judged: OpticalAnalysis) -> str:
    rows = [[figure.source, figure.quantity, figure.paper, figure.design] for figure in compare_with_papers(judged)]
    return table(["Paper", "", "its mirror", judged.name], rows)


def _section(name: str, heading: str, folder: Path) -> str:
    return inline((folder / f"{name}.png").read_bytes(), heading)


def _format_metres(value: float, digits: int = 3) -> str:
    return f"{value:.{digits}f} m" if np.isfinite(value) else "–"


def _part_table(judged: OpticalAnalysis) -> str:
    rows = []
    views = iter(judged.views)
    for outline in judged.outlines:
        row = [
            f"{outline.number}. {outline.part}",
            f"{1e3 * outline.x_m[0]:.2f} to {1e3 * outline.x_m[-1]:.2f} mm",
            f"{outline.t[0] * judged.focal_px:.1f} to {outline.t[-1] * judged.focal_px:.1f} px",
        ]
        if outline.reflects:
            view = next(views)
            row += [
                f"{_format_metres(view.ground_m[0])} to {_format_metres(view.ground_m[-1])}",
                f"{view.viewpoint_error_m.max():.1e} m",
            ]
        else:
            row += ["–", "–"]
        rows.append(row)
    return table(["Part", "Radius", "Image radius", "Ground", "Viewpoint error"], rows)


def _error_table(errors: GroundErrors) -> str:
    rows = []
    for index in range(3, errors.distance_m.size, 4):
        limit = errors.total_95_m[index]
        rows.append(
            [
                f"{errors.distance_m[index]:.2f} m",
                f"{1e3 * errors.radial_rms_m[index]:.1f} mm",
                f"{1e3 * errors.tangential_rms_m[index]:.1f} mm",
                f"{1e3 * limit:.1f} mm" if np.isfinite(limit) else "lost",
                f"{100.0 * errors.lost_share[index]:.2f} %",
            ]
        )
    return table(["Distance", "Radial rms", "Tangential rms", "95 % stay below", "Pixels lost"], rows)


def _page(judged: OpticalAnalysis, camera: Camera, sections: list[str]) -> str:
    blind = ", ".join(f"{low:.2f} to {high:.2f} m" for low, high in judged.blind_m) or "none"
    facts = table(
        ["", ""],
        [
            ["Diameter", f"{2e3 * judged.radius_m:.2f} mm"],
            ["Pinhole above the ground", _format_metres(judged.pinhole_height_m)],
            ["Apex above the pinhole", _format_metres(float(judged.outlines[0].y_m[0]))],
            ["Camera", f"{camera.width_px} × {camera.height_px} px, focal length {camera.focal_px:.1f} px"],
            ["Blind ground", blind],
            ["Smallest radius of curvature", f"{1e3 * judged.smallest_curvature_radius_m:.2f} mm"],
            ["Steepest slope", f"{judged.steepest_slope:.3f}"],
        ],
    )
    return whole(judged.name, [facts, _part_table(judged), *sections])
