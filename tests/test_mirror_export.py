"""Exported files, read back by other libraries and compared with the design."""

import csv
from pathlib import Path

import ezdxf
import numpy as np
import pytest
import trimesh

from mirrorball import Profile
from mirrorball.mirror import REFERENCE_DESIGNS, lima2001, read_dxf, read_stl, write_csv, write_dxf, write_step, write_stl
from mirrorball.mirror.reflection import Array


def distance_to_chords(points: Array, corners: Array) -> Array:
    """From each point to the nearest piece of a polyline."""
    begin, along = corners[:-1], np.diff(corners, axis=0)
    share = ((points[:, None] - begin) * along).sum(axis=2) / (along**2).sum(axis=1)
    nearest = begin + np.clip(share, 0.0, 1.0)[..., None] * along
    return np.asarray(np.linalg.norm(points[:, None] - nearest, axis=2).min(axis=1))


@pytest.mark.parametrize("name", REFERENCE_DESIGNS)
def test_csv_reads_back_within_a_micrometre(name: str, tmp_path: Path) -> None:
    mirror = REFERENCE_DESIGNS[name]()
    export = write_csv(mirror, tmp_path / "mirror.csv", step_m=2e-4)
    with export.path.open() as file:
        rows = list(csv.reader(file))
    assert rows[0] == ["radius_m", "height_m"]
    read = np.array(rows[1:], dtype=np.float64)
    rays = mirror.rays(np.clip(read[:, 0] / (read[:, 1] - mirror.pinhole_height_m), 0.0, mirror.t_max))
    assert np.abs(rays.y_m + mirror.pinhole_height_m - read[:, 1]).max() < 1e-11 + export.deviation_m
    # Between its rows too, as the robot reads it.
    t = np.linspace(0.0, mirror.t_max, 4000)
    rays = mirror.rays(t)
    height, _ = Profile.load(export.path).height_and_slope(rays.x_m)
    assert np.abs(height - rays.y_m - mirror.pinhole_height_m).max() < 1e-6


@pytest.mark.parametrize("deviation_m", [1e-6, 1e-8])
def test_dxf_reads_back_within_its_deviation(deviation_m: float, tmp_path: Path) -> None:
    mirror = lima2001()
    export = write_dxf(mirror, tmp_path / "mirror.dxf", deviation_m=deviation_m)
    assert export.deviation_m <= deviation_m
    lines = read_dxf(export.path)
    assert len(lines) == len(mirror.segments)
    for segment, corners in zip(mirror.segments, lines, strict=True):
        t = np.linspace(segment.t_from, segment.t_to, 3001)
        y = segment.height(t)
        off = distance_to_chords(np.column_stack([t * y, y]), corners)
        # Coordinates are written with a limited number of digits.
        assert off.max() <= export.deviation_m + 1e-12
    drawing = ezdxf.readfile(export.path)
    assert drawing.units == ezdxf.units.MM
    assert not drawing.audit().has_errors


@pytest.mark.parametrize("name", ["lima2001", "sphere_cone_1999"])
def test_stl_is_watertight_within_its_stated_deviation(name: str, tmp_path: Path) -> None:
    mirror = REFERENCE_DESIGNS[name]()
    export = write_stl(mirror, tmp_path / "mirror.stl", deviation_m=2e-5, back_m=0.01)
    assert export.deviation_m <= 2.1e-5
    body = trimesh.load_mesh(export.path)
    assert body.is_watertight and body.is_winding_consistent and body.volume > 0.0
    facets = read_stl(export.path)
    assert facets.shape == (len(body.faces), 3, 3)
    # Corners lie on the mirror, middles of facets no further off than promised.
    top = facets[..., 2].max()
    mirror_side = facets[(facets[..., 2] < top - 1e-6).all(axis=1)]
    # Corners lie on the design to what a 32-bit number of millimetres can say; the table is bent at no kink.
    ends = [part.t_to for part in mirror.segments]
    rays = mirror.rays(np.sort(np.append(np.linspace(0.0, mirror.t_max, 20001), ends)))
    for points, limit in ((mirror_side.reshape(-1, 3), 1e-7), (mirror_side.mean(axis=1), export.deviation_m)):
        radius = np.hypot(points[:, 0], points[:, 1])
        height = np.interp(radius, rays.x_m, rays.y_m)
        tangent = np.interp(radius, rays.x_m, rays.slope)
        assert (np.abs(points[:, 2] - height) / np.hypot(1.0, tangent)).max() <= limit + 1e-7


def test_invalid_stl_is_rejected(tmp_path: Path) -> None:
    path = tmp_path / "no.stl"
    path.write_bytes(b"solid nothing")
    with pytest.raises(ValueError, match="no binary STL"):
        read_stl(path)


def test_step_reads_back_within_its_deviation(tmp_path: Path) -> None:
    pytest.importorskip("OCP")
    from mirrorball.mirror.step import distances_m

    mirror = lima2001()
    export = write_step(mirror, tmp_path / "mirror.step", deviation_m=1e-7)
    assert export.deviation_m <= 1e-7
    rays = mirror.rays(np.linspace(0.003, 0.998, 60) * mirror.t_max)
    turn = np.arange(60) * 2.4
    points = np.column_stack([rays.x_m * np.cos(turn), rays.x_m * np.sin(turn), rays.y_m])
    assert distances_m(export.path, points).max() <= export.deviation_m + 1e-10
    assert distances_m(export.path, points + np.array([0.0, 0.0, -1e-4])).min() > 2e-5


def test_zero_deviation_is_rejected(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="deviation_m = 0"):
        write_dxf(lima2001(), tmp_path / "no.dxf", deviation_m=0.0)
