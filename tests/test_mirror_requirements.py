"""Requirements are satisfied as claimed, and conflicts name the requirements that cause them."""

import numpy as np
import pytest

from mirrorball import Camera
from mirrorball.mirror import (
    Heights,
    MaxDiameter,
    MinCurvatureRadius,
    OptimisationResult,
    Requirement,
    Resolution,
    judge,
    optimise,
)

CAMERA = Camera(width_px=480, height_px=480, focal_px=580.0, pinhole_height_m=0.6, outer_radius_px=234.0)


def best(*requirements: Requirement) -> OptimisationResult:
    return optimise(requirements, camera=CAMERA, apex_above_pinhole_m=0.17, progress=False)


def radial_px_per_m(found: OptimisationResult, distance_m: float) -> float:
    view = judge(found.mirror, focal_px=580.0, rays_per_part=3000).views[0]
    near = np.isfinite(view.ground_m)
    return float(np.interp(distance_m, view.ground_m[near], view.radial_px_per_m[near]))


def test_single_resolution_band_uses_the_full_image_radius() -> None:
    found = best(Resolution(from_m=0.5, to_m=6.0, px_per_m=15.0))
    assert found.conflicts == ()
    # 234 px over at most 6 m, and nothing is gained by showing the first half metre larger.
    assert 2.4 < found.share <= 234.0 / 5.5 / 15.0
    for distance in (0.6, 1.0, 2.0, 3.0, 4.0, 5.9):
        assert radial_px_per_m(found, distance) >= 15.0 * found.share * 0.99


def test_feasible_requirements_are_met_by_the_built_mirror() -> None:
    found = best(
        Resolution(from_m=0.5, to_m=2.0, px_per_m=40.0),
        Resolution(from_m=2.0, to_m=8.0, px_per_m=10.0),
        Heights(at_m=9.0, to_height_m=0.8, px=20.0),
    )
    assert found.conflicts == () and found.share > 1.0
    assert all(met >= found.share - 1e-6 for _, met in found.met)
    for distance, wanted in ((0.6, 40.0), (1.9, 40.0), (2.1, 10.0), (7.9, 10.0)):
        assert radial_px_per_m(found, distance) >= wanted
    rays = found.mirror.rays(np.linspace(0.0, found.mirror.t_max, 20001))
    height = rays.height_at_m(9.0)
    seen = np.isfinite(height) & (height >= 0.0) & (height <= 0.8)
    assert np.nanmax(height) >= 0.8
    assert 580.0 * np.ptp(rays.t[seen]) >= 20.0


def test_competing_resolution_bands_are_reported_as_conflict() -> None:
    near = Resolution(from_m=0.5, to_m=2.0, px_per_m=80.0)
    far = Resolution(from_m=2.0, to_m=8.0, px_per_m=20.0)
    wide = MaxDiameter(diameter_m=0.3)
    found = best(near, far, wide)
    # 80·1.5 + 20·6 = 240 px do not fit between the first half metre and 234 px.
    assert 0.7 < found.share < 1.0
    assert set(found.conflicts) == {near, far}


def test_diameter_limit_is_reported_as_conflict() -> None:
    ground = Resolution(from_m=0.5, to_m=6.0, px_per_m=30.0)
    small = MaxDiameter(diameter_m=0.05)
    soft = MinCurvatureRadius(radius_m=0.001)
    found = best(ground, small, soft)
    assert found.share < 1.0
    assert set(found.conflicts) == {ground, small}


def test_hard_constraint_is_kept_at_the_cost_of_soft_ones() -> None:
    found = best(Resolution(from_m=0.5, to_m=6.0, px_per_m=30.0), MaxDiameter(diameter_m=0.08, hard=True))
    assert 2.0 * found.mirror.radius_m <= 0.08 * 1.001
    assert found.share < 1.0


def test_optimised_part_realises_its_target_map() -> None:
    found = best(Resolution(from_m=0.5, to_m=6.0, px_per_m=15.0), Heights(at_m=7.0, to_height_m=1.0))
    t = np.linspace(0.02, 0.98, 60) * found.mirror.t_max
    rays = found.mirror.rays(t)
    distance, height = found.part.target(t)
    passes = rays.x_m + (rays.y_m + 0.6 - height) * np.tan(rays.gamma_rad)
    assert passes == pytest.approx(distance, rel=1e-6)
    assert height.max() > 0.5 and (height[:20] == 0.0).all()


@pytest.mark.parametrize(
    ("requirements", "words"),
    [
        ([MaxDiameter(diameter_m=0.1)], "nothing says what the mirror should see"),
        ([Resolution(from_m=2.0, to_m=1.0, px_per_m=10.0)], "from_m must be less than to_m"),
        ([Heights(at_m=-1.0, to_height_m=1.0)], "at_m = -1.0"),
        (
            [Resolution(from_m=0.5, to_m=6.0, px_per_m=200.0, hard=True)],
            "no mirror .* can have: radial resolution 200 px/m",
        ),
    ],
)
def test_infeasible_requirements_raise_value_error(requirements: list[Requirement], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        best(*requirements)
