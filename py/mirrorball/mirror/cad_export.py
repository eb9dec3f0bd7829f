"""Files for manufacturing: the profile as CSV and DXF, the body as STL and STEP, each with its deviation stated.

CSV is in metres as the robot reads it; drawings and bodies are in millimetres, as workshops read them, with the axis
vertical and the pinhole at the origin.
"""

from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mirrorball.arguments import checked
from mirrorball.mirror.profile_design import Mirror
from mirrorball.mirror.reflection import Array
from mirrorball.mirror.sampling import profile_deviation_m
from mirrorball.output_file import replacing

MM_PER_M = 1e3
"""Millimetres in a metre."""


@dataclass(frozen=True)
class Export:
    """A written file and how far its shape lies from the design at most."""

    path: Path
    deviation_m: float


@checked
def write_csv(mirror: Mirror, path: str | Path, *, step_m: float | None = None) -> Export:
    """`radius_m,height_m` above the ground, to the femtometre: what robot.toml's `profile` names. `step_m` as `Mirror.samples`.

    The deviation is the largest difference in height between the design and `Profile.load`, between samples and at joints.
    """
    path = Path(path)
    # Slopes are differences of heights: over a step of 10 µm a picometre is 0.2 m on the ground 1 km away.
    rows = [(f"{x:.15f}", f"{y:.15f}") for x, y in zip(*mirror.samples(step_m=step_m), strict=True)]
    with replacing(path) as part, part.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["radius_m", "height_m"])
        writer.writerows(rows)
    radius, height = np.array(rows, dtype=np.float64).T
    return Export(path, profile_deviation_m(mirror, radius, height))


@checked
def write_dxf(mirror: Mirror, path: str | Path, *, deviation_m: float = 1e-7) -> Export:
    """The meridian as polylines in millimetres, one layer for each part, chords no further off than `deviation_m`."""
    # Loading it costs a third of a second, which only drawings should pay.
    import ezdxf
    from ezdxf import units

    path = Path(path)
    drawing = ezdxf.new("R2010", units=units.MM)
    space = drawing.modelspace()
    worst = 0.0
    for index, segment in enumerate(mirror.segments, start=1):
        x, y, off = _approximate_by_chords(mirror, index - 1, deviation_m)
        worst = max(worst, off)
        layer = f"{index}_{segment.part}".replace(" ", "_")
        drawing.layers.add(layer, color=index)
        space.add_lwpolyline(np.column_stack([MM_PER_M * x, MM_PER_M * y]).tolist(), dxfattribs={"layer": layer})
    axis = drawing.layers.add("axis", color=8)
    space.add_line((0.0, 0.0), (0.0, MM_PER_M * float(y.max()) * 1.1), dxfattribs={"layer": axis.dxf.name})
    with replacing(path) as part:
        drawing.saveas(part)
    return Export(path, worst)


@checked
def write_stl(mirror: Mirror, path: str | Path, *, deviation_m: float = 1e-5, back_m: float = 0.01) -> Export:
    """The turned body as binary STL in millimetres: mirror below, a flat back `back_m` above the highest point.

    Watertight, facets no further than `deviation_m` from the surface, along the meridian and around.
    """
    path = Path(path)
    _require_positive(deviation_m)
    # Half for the chords along the meridian, half for those around the axis.
    pieces = [_approximate_by_chords(mirror, index, deviation_m / 2.0) for index in range(len(mirror.segments))]
    x = np.concatenate([pieces[0][0][:1], *[piece[0][1:] for piece in pieces]])
    y = np.concatenate([pieces[0][1][:1], *[piece[1][1:] for piece in pieces]])
    around = 4 * int(np.ceil(np.pi / np.arccos(1.0 - min(deviation_m / 2.0 / x[-1], 0.5)) / 4.0))
    sag = x[-1] * (1.0 - np.cos(np.pi / around))
    top = float(y.max()) + back_m
    facets = _revolve(np.append(x, [x[-1], 0.0]), np.append(y, [top, top]), around) * MM_PER_M
    edges = np.cross(facets[:, 1] - facets[:, 0], facets[:, 2] - facets[:, 0])
    record = np.zeros(len(facets), dtype=[("normal", "<f4", 3), ("corner", "<f4", (3, 3)), ("spare", "<u2")])
    record["normal"] = edges / np.linalg.norm(edges, axis=1, keepdims=True)
    record["corner"] = facets
    with replacing(path) as part, part.open("wb") as file:
        file.write(b"mirrorball, millimetres".ljust(80))
        file.write(np.uint32(len(facets)).tobytes())
        file.write(record.tobytes())
    # Corners are stored as 32-bit numbers.
    rounding = float(np.spacing(np.float32(MM_PER_M * max(top, x[-1])))) / MM_PER_M
    return Export(path, float(max(piece[2] for piece in pieces) + sag + rounding))


@checked
def write_step(mirror: Mirror, path: str | Path, *, deviation_m: float = 1e-7, back_m: float = 0.01) -> Export:
    """The turned body as STEP AP214 in millimetres: a smooth surface of revolution for each part.

    Needs OpenCASCADE (`pip install mirrorball[step]`); ImportError without it.
    """
    from mirrorball.mirror import step

    with replacing(path) as part:
        deviation = step.write(mirror, part, deviation_m=deviation_m, back_m=back_m)
    return Export(Path(path), deviation)


@checked
def read_stl(path: str | Path) -> Array:
    """Facets of a binary STL in metres: n × 3 corners × 3; ValueError if the file is none."""
    raw = Path(path).read_bytes()
    count = int(np.frombuffer(raw, "<u4", 1, 80)[0]) if len(raw) >= 84 else -1
    if len(raw) != 84 + 50 * count:
        raise ValueError(f"{path}: {len(raw)} bytes are no binary STL")
    record = np.frombuffer(raw, [("normal", "<f4", 3), ("corner", "<f4", (3, 3)), ("spare", "<u2")], count, 84)
    return np.asarray(record["corner"], dtype=np.float64) / MM_PER_M


@checked
def read_dxf(path: str | Path) -> list[Array]:
    """The polylines of a drawing that `write_dxf` made: radius and height above the pinhole, metres."""
    import ezdxf

    space = ezdxf.readfile(path).modelspace()
    return [np.array(line.get_points("xy")) / MM_PER_M for line in space.query("LWPOLYLINE")]


def _require_positive(deviation_m: float) -> None:
    if not deviation_m > 0.0:
        raise ValueError(f"deviation_m = {deviation_m} must be positive")


def _approximate_by_chords(mirror: Mirror, index: int, deviation_m: float) -> tuple[Array, Array, float]:
    """Points of one segment (above the pinhole) whose chords stay within the deviation, and what they do reach.

    A chord of length l leaves its arc by κ·l²/8, so points are spread evenly in ∫√κ ds.
    """
    _require_positive(deviation_m)
    segment = mirror.segments[index]
    t = np.linspace(segment.t_from, segment.t_to, 2001)
    y = segment.height(t)
    x = t * y
    length = np.hypot(np.diff(x), np.diff(y))
    bend = np.abs(segment.curvature_per_m(t))
    share = np.concatenate([[0.0], np.cumsum(np.sqrt((bend[1:] + bend[:-1]) / 2.0) * length)])
    # A straight stretch still gets its ends; the floor keeps an inflection from swallowing all of it.
    share += np.concatenate([[0.0], np.cumsum(length)]) * 1e-2
    count = max(int(np.ceil(share[-1] / np.sqrt(8.0 * deviation_m))), 1)
    while True:
        at = np.interp(np.linspace(0.0, share[-1], count + 1), share, t)
        y = segment.height(at)
        x = at * y
        off = _chord_error(segment.height, at, x, y)
        if off <= deviation_m:
            return x, y, off
        count = int(np.ceil(count * 1.2)) + 1


def _chord_error(height: Callable[[Array], Array], at: Array, x: Array, y: Array) -> float:
    """How far the curve leaves its chords, tried so finely inside each that a half per cent covers what lies between."""
    chord_x, chord_y = np.diff(x), np.diff(y)
    worst = 0.0
    for share in np.arange(1, 16) / 16.0:
        t = at[:-1] + share * np.diff(at)
        inner_y = height(t)
        off = (t * inner_y - x[:-1]) * chord_y - (inner_y - y[:-1]) * chord_x
        worst = max(worst, float(np.abs(off / np.hypot(chord_x, chord_y)).max()))
    return 1.005 * worst


def _revolve(radius: Array, height: Array, around: int) -> Array:
    """Triangles of the body turned from a meridian that begins and ends on the axis; normals point outwards."""
    angle = np.arange(around + 1) * (2.0 * np.pi / around)
    angle[-1] = 0.0
    ring = np.stack(
        [
            radius[:, None] * np.cos(angle),
            radius[:, None] * np.sin(angle),
            np.broadcast_to(height[:, None], (radius.size, around + 1)),
        ],
        axis=-1,
    )
    a, b = ring[:-1, :-1], ring[:-1, 1:]
    c, d = ring[1:, :-1], ring[1:, 1:]
    inner = np.stack([a, d, c], axis=-2)[radius[1:] > 0.0]
    outer = np.stack([a, b, d], axis=-2)[radius[:-1] > 0.0]
    return np.concatenate([inner.reshape(-1, 3, 3), outer.reshape(-1, 3, 3)])
