"""Reads mirror designs from TOML: parts or requirements, with the camera, lens and tolerances to analyse them.

Keys are the arguments of the Python classes without their `_m`: metres are silent in files.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterator
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import scipy

from mirrorball._core import Camera
from mirrorball.arguments import checked
from mirrorball.mirror import parts, requirements
from mirrorball.mirror.optical_analysis import Lens
from mirrorball.mirror.profile_design import Mirror, design, require_readable
from mirrorball.mirror.reference_designs import REFERENCE_DESIGNS
from mirrorball.mirror.reflection import Array
from mirrorball.mirror.reporting import fit_camera
from mirrorball.mirror.requirements import OptimisationResult, optimise
from mirrorball.mirror.tolerances import Tolerances

T = TypeVar("T")

PART_KINDS: dict[str, type[Any]] = {
    "horizontally isometric": parts.HorizontallyIsometric,
    "vertically isometric": parts.VerticallyIsometric,
    "constant curvature": parts.ConstantCurvature,
    "cone": parts.Cone,
    "planar": parts.Planar,
    "sphere": parts.Sphere,
    "paraboloid": parts.Paraboloid,
    "hyperboloid": parts.Hyperboloid,
}
"""`kind` of a [[part]]; and "free", with its points."""

REQUIREMENT_KINDS: dict[str, type[Any]] = {
    "resolution": requirements.Resolution,
    "heights": requirements.Heights,
    "maximal diameter": requirements.MaxDiameter,
    "minimal curvature radius": requirements.MinCurvatureRadius,
}
"""`kind` of a [[wish]]."""

CAMERA_KEYS = {
    "width_px": True,
    "height_px": True,
    "focal_px": True,
    "height": True,
    "centre_px": False,
    "forward_deg": False,
    "flipped": False,
    "outer_radius_px": False,
}
"""Those of robot.toml; True where a mirror cannot do without."""


@dataclass(frozen=True)
class DesignSpec:
    """A mirror with what it is to be judged by."""

    mirror: Mirror
    camera: Camera
    lens: Lens
    tolerances: Tolerances
    reach_m: float
    optimised: OptimisationResult | None
    """How the requirements are satisfied, if the file states any."""


GIVEN_STREAMS = ("/dev/stdin", "/dev/null")
"""Read without being regular files, as descriptors of this process are; other devices and pipes may have no end."""


@checked
def load(source: str | Path, *, progress: bool = True) -> DesignSpec:
    """Reads a TOML design, or takes a ready-made one by name. ValueError names file, table and key that are wrong."""
    if str(source) in REFERENCE_DESIGNS:
        mirror = REFERENCE_DESIGNS[str(source)]()
        return DesignSpec(mirror, fit_camera(mirror), Lens(), Tolerances(), 12.0, None)
    path = Path(source)
    if path.exists() and not (path.is_file() or path.is_dir() or str(path) in GIVEN_STREAMS or path.parent == Path("/dev/fd")):
        raise ValueError(f"{path}: not a regular file")
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        ready = ", ".join(REFERENCE_DESIGNS)
        raise FileNotFoundError(f"{path}: no such file, and no ready-made design ({ready})") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: {error}") from error
    try:
        _reject_large_integers(table)
        return _parse_design(table, name=path.stem, progress=progress)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    except ArithmeticError as error:
        raise ValueError(f"{path}: a number is too large or too small to design with: {error}") from error


def _parse_design(table: dict[str, Any], *, name: str, progress: bool) -> DesignSpec:
    _reject_unknown_keys(table, {"name", "apex", "reach", "camera", "lens", "tolerances", "part", "wish"}, "the file")
    camera = _parse_camera(_require_table(_require_key(table, "camera", "the file"), "[camera]"))
    apex = _require_number(_require_key(table, "apex", "the file"), "apex")
    reach = _require_number(table.get("reach", 12.0), "reach")
    for key, value, most in (("apex", apex, 5.0), ("reach", reach, 1000.0)):
        if not 0.0 < value <= most:
            raise ValueError(f"{key} = {value:g} must be positive, and at most {most:g} metres")
    name = str(table.get("name", name))
    if "/" in name or "\\" in name:
        raise ValueError(f"name = {name!r} must do as a file's name")
    lens = _parse_dataclass(Lens, _require_table(table.get("lens", {}), "[lens]"), "[lens]")
    tolerances = _parse_dataclass(Tolerances, _require_table(table.get("tolerances", {}), "[tolerances]"), "[tolerances]")
    if ("part" in table) == ("wish" in table):
        raise ValueError("give either [[part]] tables or [[wish]] tables")
    optimised = None
    if "wish" in table:
        wanted = [_parse_kind(REQUIREMENT_KINDS, row, f"wish {number}") for number, row in _iter_tables(table, "wish")]
        optimised = optimise(wanted, camera=camera, apex_above_pinhole_m=apex, name=name, progress=progress)
        mirror = optimised.mirror
    else:
        half = (min(camera.width_px, camera.height_px) - 1) / 2.0
        mirror = design(
            [_parse_part(row, number) for number, row in _iter_tables(table, "part")],
            pinhole_height_m=camera.pinhole_height_m,
            apex_above_pinhole_m=apex,
            t_max=(camera.outer_radius_px or half) / camera.focal_px,
            name=name,
        )
    require_readable(mirror)
    if not np.isfinite(mirror.rays(np.linspace(0.0, mirror.t_max, 2001)).distance_at_m(0.0)).any():
        raise ValueError("the mirror shows no ground: all its rays go up (expected some that meet the floor)")
    return DesignSpec(
        mirror=mirror,
        camera=camera,
        lens=lens,
        tolerances=tolerances,
        reach_m=reach,
        optimised=optimised,
    )


def _parse_camera(row: dict[str, Any]) -> Camera:
    _reject_unknown_keys(row, set(CAMERA_KEYS), "[camera]")
    for key, needed in CAMERA_KEYS.items():
        if needed:
            _require_key(row, key, "[camera]")
    for key in set(row) & {"width_px", "height_px", "focal_px", "height", "outer_radius_px"}:
        if _require_number(row[key], f"[camera] {key}") <= 0.0:
            raise ValueError(f"[camera] {key} = {row[key]:g} must be positive")
        if key in ("width_px", "height_px") and not isinstance(row[key], int):
            raise ValueError(f"[camera] {key} = {row[key]:g} must be a whole number")
    values = dict(row)
    values["pinhole_height_m"] = values.pop("height")
    if "centre_px" in values:
        centre = values["centre_px"]
        if not isinstance(centre, list) or len(centre) != 2:
            raise ValueError(f"[camera] centre_px = {centre!r} must be two numbers")
        values["centre_px"] = tuple(_require_number(value, "[camera] centre_px") for value in centre)
    try:
        return Camera(**values)
    except (TypeError, ValueError) as error:
        raise ValueError(f"[camera]: {error}") from error


def _parse_part(row: dict[str, Any], number: int) -> parts.Part:
    place = f"part {number}"
    if row.get("kind") == "free":
        return _parse_freeform({key: value for key, value in row.items() if key != "kind"}, place)
    made: parts.Part = _parse_kind(PART_KINDS, row, place)
    return made


def _parse_freeform(row: dict[str, Any], place: str) -> parts.Free:
    """A cubic through points (t, distance, height)."""
    _reject_unknown_keys(row, {"points", "tangent_continuous"}, f"{place} (free)")
    rows = _require_key(row, "points", f"{place} (free)")
    try:
        points = np.array(rows, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"{place} (free): points = {rows!r} must be rows of three numbers") from None
    if points.ndim != 2 or points.shape[1] != 3 or points.shape[0] < 4 or (np.diff(points[:, 0]) <= 0.0).any():
        raise ValueError(f"{place} (free): points must be at least four rows [t, distance, height] with rising t")
    if not np.isfinite(points).all():
        raise ValueError(f"{place} (free): points must be finite numbers")
    target = _CubicTarget(scipy.interpolate.CubicSpline(points[:, 0], points[:, 1:]))
    return parts.Free(
        target=target,
        until_t=float(points[-1, 0]),
        tangent_continuous=bool(row.get("tangent_continuous", False)),
        known_t=(float(points[0, 0]), float(points[-1, 0])),
    )


@dataclass(frozen=True)
class _CubicTarget:
    curve: Callable[[Array], Array]

    def __call__(self, t: Array) -> tuple[Array, Array]:
        found = self.curve(t)
        return found[..., 0], found[..., 1]


def _parse_kind(kinds: dict[str, type[T]], row: dict[str, Any], place: str) -> T:
    kind = _require_key(row, "kind", place)
    further = ", free" if kinds is PART_KINDS else ""
    if not isinstance(kind, str) or kind not in kinds:
        raise ValueError(f"{place}: no kind {kind!r}; there are {', '.join(kinds)}{further}")
    return _parse_dataclass(kinds[kind], {key: value for key, value in row.items() if key != "kind"}, f"{place} ({kind})")


def _parse_dataclass(kind: type[T], row: dict[str, Any], place: str) -> T:
    """A dataclass from a table whose keys are its fields without `_m`."""
    names = {_toml_key(field.name): field for field in fields(kind)}  # type: ignore[arg-type]
    _reject_unknown_keys(row, set(names), place)
    for key, field in names.items():
        if field.default is MISSING:
            _require_key(row, key, place)
    for key, value in row.items():
        if "float" in str(names[key].type) and (isinstance(value, bool) or not isinstance(value, int | float)):
            raise ValueError(f"{place}: {key} = {value!r} must be a number")
    try:
        return kind(**{names[key].name: value for key, value in row.items()})
    except (TypeError, ValueError) as error:
        raise ValueError(f"{place}: {error}") from error


def _require_table(value: Any, place: str) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise ValueError(f"{place} = {value!r} must be a table")
    return value


def _iter_tables(table: dict[str, Any], key: str) -> Iterator[tuple[int, dict[str, Any]]]:
    rows = table[key]
    if not isinstance(rows, list):
        raise ValueError(f"{key} = {rows!r} must be [[{key}]] tables")
    for number, row in enumerate(rows, start=1):
        yield number, _require_table(row, f"{key} {number}")


def _require_number(value: Any, key: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise ValueError(f"{key} = {value!r} must be a number")
    return float(value)


def _reject_large_integers(value: Any, key: str = "the file") -> None:
    """TOML allows whole numbers of any size, arrays those of 64 bits."""
    if isinstance(value, dict):
        for name, each in value.items():
            _reject_large_integers(each, name)
    elif isinstance(value, list):
        for each in value:
            _reject_large_integers(each, key)
    elif isinstance(value, int) and abs(value) >= 1 << 63:
        raise ValueError(f"{key} is too large a number")


def _toml_key(field: str) -> str:
    return field if field.endswith("_per_m") else field.removesuffix("_m")


def _reject_unknown_keys(row: dict[str, Any], known: set[str], place: str) -> None:
    unknown = sorted(set(row) - known)
    if unknown:
        raise ValueError(f"{place}: unknown key {unknown[0]!r}; known are {', '.join(sorted(known))}")


def _require_key(row: dict[str, Any], key: str, place: str) -> Any:
    if key not in row:
        raise ValueError(f"{place} needs {key!r}")
    return row[key]
