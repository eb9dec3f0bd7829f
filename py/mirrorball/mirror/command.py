"""The subcommands of `mirrorball mirror`: each takes a design's name or file and returns one result to print."""

from __future__ import annotations

import dataclasses
import gc
import json
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mirrorball._core import Field
from mirrorball.mirror.cad_export import Export, write_csv, write_dxf, write_step, write_stl
from mirrorball.mirror.design_file import DesignSpec, load
from mirrorball.mirror.drawing import write_pdf
from mirrorball.mirror.optical_analysis import OpticalAnalysis, judge
from mirrorball.mirror.papers import compare_with_papers
from mirrorball.mirror.plot_worker import PlotWorker
from mirrorball.mirror.preview import plot_preview, preview
from mirrorball.mirror.rendering import view
from mirrorball.mirror.reporting import report as write_report
from mirrorball.output_file import replacing

Result = dict[str, Any]

ASSUMPTIONS = (
    "a pinhole camera without distortion that looks straight up along the mirror's axis",
    "a mirror of revolution, reflecting on its outer surface",
    "an upright robot on a flat floor",
)
"""What every design supposes; docs/calibration.md measures what a robot really has."""

WRITERS: dict[str, Callable[..., Export]] = {
    "csv": write_csv,
    "dxf": write_dxf,
    "stl": write_stl,
    "step": write_step,
    "pdf": write_pdf,
}
"""Formats of `export`."""

IMAGE_FORMATS = ("png", "jpg", "jpeg", "tif", "tiff", "webp")
"""Formats of `render`, by the file's ending."""


def design(source: str, *, out: str) -> Result:
    """Write the profile as the robot reads it."""
    plan = load(source)
    _make_folder(Path(out).parent)
    export = write_csv(plan.mirror, out)
    judged = judge(plan.mirror, focal_px=plan.camera.focal_px, lens=plan.lens, reach_m=plan.reach_m)
    return {**_design_summary(plan, judged), "profile": str(export.path)}


def report(source: str, *, out: str, mirrors: int, seed: int) -> Result:
    """Write figures and page."""
    # A command draws once and ends: looking for garbage meanwhile takes a tenth of its time.
    gc.disable()
    with PlotWorker() as drawer:
        plan = load(source)
        written = write_report(
            plan.mirror,
            folder=out,
            camera=plan.camera,
            lens=plan.lens,
            reach_m=plan.reach_m,
            tolerances=plan.tolerances,
            mirrors=mirrors,
            seed=seed,
            drawer=drawer,
        )
    result = {**_design_summary(plan, written.judgement), "page": str(written.page)}
    result["papers"] = [dataclasses.asdict(figure) for figure in compare_with_papers(written.judgement)]
    if written.errors is not None:
        errors = written.errors
        result["errors"] = [
            {
                "distance_m": float(errors.distance_m[index]),
                "radial_rms_m": float(errors.radial_rms_m[index]),
                "tangential_rms_m": float(errors.tangential_rms_m[index]),
            }
            for index in range(3, errors.distance_m.size, 4)
        ]
    return result


def render(
    source: str,
    *,
    out: str,
    field: str | None,
    pose: Sequence[float],
    ball: Sequence[float] | None,
    scenario: str | None = None,
    time_s: float = 0.0,
) -> Result:
    """Write the image that a robot with this mirror would take, or a scenario's scene beside its floor by the ideal map."""
    if scenario is not None:
        return _preview(source, out=out, scenario=scenario, time_s=time_s)
    if len(pose) != 3:
        raise ValueError(f"--pose needs x,y,heading, not {len(pose)} numbers")
    if ball is not None and len(ball) != 2:
        raise ValueError(f"--ball needs x,y, not {len(ball)} numbers")
    if _image_format(out) not in IMAGE_FORMATS:
        raise ValueError(f"{out}: no image format {_image_format(out)!r} (expected {', '.join(IMAGE_FORMATS)})")
    plan = load(source)
    image = view(
        plan.mirror,
        camera=plan.camera,
        field=Field(field),
        pose=(pose[0], pose[1], math.radians(pose[2])),
        ball=None if ball is None else (ball[0], ball[1]),
    )
    from matplotlib.image import imsave

    _make_folder(Path(out).parent)
    with replacing(out) as part:
        imsave(part, image, format=_image_format(out))
    return {"mirror": plan.mirror.name, "image": out, "width_px": image.shape[1], "height_px": image.shape[0]}


def _image_format(out: str) -> str:
    """The format that a file's name asks for; the part that is written first has another ending."""
    return Path(out).suffix.lstrip(".").lower() or "png"


def _preview(source: str, *, out: str, scenario: str, time_s: float) -> Result:
    plan = load(source)
    shown = preview(plan.mirror, scenario=scenario, camera=plan.camera, time_s=time_s)
    _make_folder(Path(out).parent)
    with replacing(out) as part:
        plot_preview(shown).savefig(part, format=_image_format(out))
    return {
        "mirror": plan.mirror.name,
        "image": out,
        "time_s": shown.time_s,
        "pose": list(shown.pose),
        "map_errors": [{"distance_m": metre, "median_m": _round_or_none(error)} for metre, error in shown.map_error_m.items()],
    }


def export(source: str, *, out: str, formats: Sequence[str]) -> Result:
    """Write the workshop's files, each with its deviation."""
    plan = load(source)
    folder = _make_folder(Path(out))
    files = []
    for name in formats:
        options = {"camera": plan.camera, "reach_m": plan.reach_m} if name == "pdf" else {}
        try:
            written = WRITERS[name](plan.mirror, folder / f"{plan.mirror.name}.{name}", **options)
        except ImportError as error:
            raise ValueError(f"{name} needs cadquery-ocp-novtk: pip install it into this environment") from error
        files.append({"file": str(written.path), "deviation_m": written.deviation_m})
    return {"mirror": plan.mirror.name, "files": files}


def as_json(result: Result) -> str:
    """Give one line, for programs; what is not a number is null."""
    return json.dumps(result, ensure_ascii=False, allow_nan=False)


def as_text(result: Result) -> str:
    """Give lines, for people."""
    lines = []
    for key, value in result.items():
        rows = value if isinstance(value, list) and value and isinstance(value[0], dict) else None
        if rows is None:
            lines.append(f"{key}: {_format_value(value)}")
        else:
            lines.append(f"{key}:")
            lines.extend("  " + ", ".join(f"{name} {_format_value(entry)}" for name, entry in row.items()) for row in rows)
    return "\n".join(lines)


def _format_value(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, dict):
        return ", ".join(f"{name} {_format_value(entry)}" for name, entry in value.items())
    if isinstance(value, (list, tuple)):
        return ", ".join(_format_value(entry) for entry in value) or "none"
    return "–" if value is None else str(value)


def _make_folder(folder: Path) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def _round_or_none(value: float) -> float | None:
    # To the micrometre: parts are traced a billionth inside their ends.
    return round(float(value), 6) if np.isfinite(value) else None


def _design_summary(plan: DesignSpec, judged: OpticalAnalysis) -> Result:
    mirror = plan.mirror
    views = iter(judged.views)
    apex_m = float(mirror.segments[0].height(np.zeros(1))[0])
    camera = plan.camera
    parts = []
    for segment in mirror.segments:
        view = next(views) if segment.reflects else None
        ends_m, tangents = segment.height(np.array([segment.t_from, segment.t_to])), segment.end()[1]
        parts.append(
            {
                "part": segment.part,
                "until_t": segment.t_to,
                "until_radius_m": segment.t_to * segment.end()[0],
                "above_apex_m": round(float(ends_m[0] - apex_m), 6),
                "until_above_apex_m": round(float(ends_m[1] - apex_m), 6),
                "surface_angle_at_end_deg": round(math.degrees(math.atan(tangents)), 4),
                "ground_from_m": None if view is None else _round_or_none(view.ground_m[0]),
                "ground_to_m": None if view is None else _round_or_none(view.ground_m[-1]),
            }
        )
    result: Result = {
        "mirror": mirror.name,
        "assumes": ASSUMPTIONS,
        "camera": {
            "image_px": f"{camera.width_px} × {camera.height_px}",
            "focal_px": camera.focal_px,
            "pinhole_height_m": mirror.pinhole_height_m,
            "rim_radius_px": round(mirror.t_max * camera.focal_px, 2),
        },
        "apex_above_pinhole_m": round(apex_m, 6),
        "apex_above_ground_m": round(apex_m + mirror.pinhole_height_m, 6),
        "rim_above_ground_m": round(mirror.segments[-1].end()[0] + mirror.pinhole_height_m, 6),
        "diameter_m": 2.0 * mirror.radius_m,
        "smallest_curvature_radius_m": _round_or_none(judged.smallest_curvature_radius_m),
        "blind_m": [f"{low:.3f} to {high:.3f}" for low, high in judged.blind_m],
        "parts": parts,
    }
    if plan.optimised is not None:
        result["share"] = plan.optimised.share
        result["wishes"] = [{"wish": str(requirement), "met": met} for requirement, met in plan.optimised.met]
        result["conflicts"] = [str(requirement) for requirement in plan.optimised.conflicts]
    return result
