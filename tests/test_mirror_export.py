"""Exported files, read back by other libraries and compared with the design."""

import csv
from pathlib import Path

import ezdxf
import numpy as np
import pytest
import trimesh

from mirrorball import Profile
from mirrorball.mirror import (
    REFERENCE_DESIGNS,
    HorizontallyIsometric,
    Mirror,
    design,
    lima2001,
    read_dxf,
    read_stl,
    write_csv,
    write_dxf,
    write_step,
    write_stl,
)
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


def isometric(*, apex_m: float, pinhole_height_m: float, until_m: float) -> Mirror:
    part = HorizontallyIsometric(until_t=0.3, until_m=until_m)
    return design([part], pinhole_height_m=pinhole_height_m, apex_above_pinhole_m=apex_m)


MIRRORS = {
    "lima2001": lima2001(),
    "a millimetre above the pinhole": isometric(apex_m=0.001, pinhole_height_m=0.1, until_m=0.5),
    "ground up to a kilometre": isometric(apex_m=0.2, pinhole_height_m=0.6, until_m=1000.0),
}


@pytest.mark.parametrize("step_m", [None, 1e-3, 1e-2])
@pytest.mark.parametrize("name", MIRRORS)
def test_csv_states_the_deviation_of_the_curve_between_its_rows(name: str, step_m: float | None, tmp_path: Path) -> None:
    mirror = MIRRORS[name]
    export = write_csv(mirror, tmp_path / "mirror.csv", step_m=step_m)
    read = Profile.load(export.path)
    joints = [part.t_to + np.linspace(-2e-6, 2e-6, 401) for part in mirror.segments[:-1]]
    rays = mirror.rays(np.concatenate([np.linspace(0.0, mirror.t_max, 30_001)[1:], *joints]))
    found = np.abs(read.height_and_slope(rays.x_m)[0] - rays.y_m - mirror.pinhole_height_m).max()
    # Found at other places than those the statement rests on; 1e-15 m are the digits of the file.
    assert 0.5 * export.deviation_m - 2e-15 <= found <= 1.1 * export.deviation_m + 2e-15
    assert step_m is not None or export.deviation_m < 1e-7


@pytest.mark.parametrize("name", MIRRORS)
@pytest.mark.parametrize("source", ["file", "memory"])
def test_default_samples_keep_the_ground_of_small_and_far_seeing_mirrors(name: str, source: str, tmp_path: Path) -> None:
    mirror = MIRRORS[name]
    part = mirror.segments[0]
    read = Profile.load(write_csv(mirror, tmp_path / "mirror.csv").path) if source == "file" else mirror.profile()
    exact = mirror.rays(np.linspace(0.001, 0.99, 5000) * part.t_to)
    height, slope = read.height_and_slope(exact.x_m)
    gamma = np.arctan(exact.x_m / (height - mirror.pinhole_height_m)) + 2.0 * np.arctan(slope)
    ground, wanted = exact.x_m + height * np.tan(gamma), exact.distance_at_m(0.0)
    # A millionth of the camera ray's slope moves the ground by this much.
    per_slope = float(wanted[-1] / exact.t[-1]) * 1e-6
    assert (np.abs(ground - wanted) <= 1e-5 + 1e-5 * wanted + per_slope).all()


def test_step_that_makes_too_many_samples_is_rejected(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"invalid step_m: 1e-12 \(expected at least 5\.8e-07 m, 200000 samples\)"):
        write_csv(lima2001(), tmp_path / "no.csv", step_m=1e-12)
    with pytest.raises(ValueError, match="invalid step_m: 0"):
        lima2001().samples(step_m=0.0)


def test_profile_that_no_program_could_read_is_not_written(tmp_path: Path) -> None:
    big = design([HorizontallyIsometric(until_t=0.3, until_m=200.0)], pinhole_height_m=20.0, apex_above_pinhole_m=5.0)
    with pytest.raises(ValueError, match=r"height above the ground 26\.\d+ m is out of range \(expected at most 10 m, "):
        write_csv(big, tmp_path / "big.csv")
    assert not list(tmp_path.iterdir())


def test_negative_deviation_of_a_body_is_rejected_as_given(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"deviation_m = -1\.0 must be positive"):
        write_stl(lima2001(), tmp_path / "no.stl", deviation_m=-1.0)
