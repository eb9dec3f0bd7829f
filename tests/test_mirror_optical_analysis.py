"""The optical analysis against independent computations."""

import numpy as np
import pytest
from scipy.optimize import brentq

from mirrorball import Camera, ground_map
from mirrorball.mirror import (
    REFERENCE_DESIGNS,
    Cone,
    HorizontallyIsometric,
    Hyperboloid,
    Lens,
    Planar,
    Sphere,
    Tolerances,
    design,
    fit_camera,
    ground_costs,
    judge,
    lima2001,
    monte_carlo,
    nubot2013,
    visible_heights,
)


@pytest.mark.parametrize("name", REFERENCE_DESIGNS)
def test_radial_resolution_is_pixels_per_ground_gradient(name: str) -> None:
    for view in judge(REFERENCE_DESIGNS[name](), focal_px=500.0).views:
        near = np.isfinite(view.ground_m) & (view.ground_m < 12.0)
        if near.sum() < 10:
            continue
        ground, t = view.ground_m[near], view.rays.t[near]
        step = 500.0 * np.gradient(t) / np.gradient(ground)
        assert step[3:-3] == pytest.approx(view.radial_px_per_m[near][3:-3], rel=1e-3)


def test_isometric_part_has_equal_radial_and_tangential_resolution() -> None:
    view = judge(lima2001(), focal_px=500.0).views[0]
    assert view.radial_px_per_m == pytest.approx(500.0 * 0.22 / 6.0, rel=1e-6)
    assert view.tangential_px_per_m == pytest.approx(500.0 * 0.22 / 6.0, rel=1e-6)


def test_plane_mirror_image_lies_behind_the_surface() -> None:
    mirror = design([Planar(until_t=0.4)], pinhole_height_m=0.6, apex_above_pinhole_m=0.2)
    judged = judge(mirror, focal_px=500.0)
    view = judged.views[0]
    # The mirror image of the ground lies H + 2·Y₀ above the pinhole, and so does the mirror image of the pinhole.
    wanted = (0.6 + 2 * 0.2) * np.hypot(1.0, view.rays.t)
    assert view.image_tangential_m == pytest.approx(wanted, rel=1e-9)
    assert view.image_sagittal_m == pytest.approx(wanted, rel=1e-9)
    assert judged.viewpoint_m == pytest.approx(0.4, abs=1e-9)
    assert view.viewpoint_error_m.max() < 1e-12
    assert judged.smallest_curvature_radius_m == np.inf


def test_sphere_has_expected_curvature_and_focal_length() -> None:
    mirror = design([Sphere(radius_m=0.05, until_t=0.1)], pinhole_height_m=0.6, apex_above_pinhole_m=0.2)
    judged = judge(mirror, focal_px=500.0)
    assert judged.smallest_curvature_radius_m == pytest.approx(0.05, rel=1e-6)
    # On the axis: 1/s' = 1/s + 2/R behind the mirror.
    wanted = 0.2 + 1.0 / (1.0 / 0.8 + 2.0 / 0.05)
    assert judged.views[0].image_tangential_m[0] == pytest.approx(wanted, rel=1e-4)
    assert judged.views[0].image_sagittal_m[0] == pytest.approx(wanted, rel=1e-4)


def test_hyperboloid_caustic_is_a_point() -> None:
    mirror = design([Hyperboloid(eccentricity=1.3, until_t=0.4)], pinhole_height_m=0.6, apex_above_pinhole_m=0.2)
    judged = judge(mirror, focal_px=500.0)
    view = judged.views[0]
    assert view.viewpoint_error_m.max() < 1e-9
    assert np.abs(view.caustic_x_m[5:-5]).max() < 1e-6
    assert view.caustic_y_m[5:-5] == pytest.approx(judged.viewpoint_m, abs=1e-6)


def test_caustic_is_where_neighbouring_rays_cross() -> None:
    view = judge(lima2001(), focal_px=500.0).views[0]
    x, y, gamma = view.rays.x_m, view.rays.y_m, view.rays.gamma_rad
    for i in (100, 300, 500):
        a, b = np.array([x[i - 1], y[i - 1]]), np.array([x[i + 1], y[i + 1]])
        along_a, along_b = (np.array([np.sin(gamma[j]), -np.cos(gamma[j])]) for j in (i - 1, i + 1))
        way = np.linalg.solve(np.stack([along_a, -along_b], axis=1), b - a)[0]
        assert a + way * along_a == pytest.approx([view.caustic_x_m[i], view.caustic_y_m[i]], abs=2e-4)


def test_blind_zones_are_ground_without_rays() -> None:
    ring = design(
        [HorizontallyIsometric(until_t=0.1, until_m=1.0), Cone(slope=0.75, until_ground_m=5.0)],
        pinhole_height_m=0.6,
        apex_above_pinhole_m=0.2,
    )
    cone_begins = float(ring.segment("cone").rays(np.array([0.1]), 0.6).distance_at_m(0.0)[0])
    judged = judge(ring, focal_px=500.0, reach_m=10.0)
    assert np.ravel(judged.blind_m) == pytest.approx([1.0, cone_begins, 5.0, 10.0], abs=1e-4)
    assert judge(lima2001(), focal_px=500.0).blind_m == ()


def test_self_occlusion_is_detected() -> None:
    cup = design(
        [HorizontallyIsometric(until_t=0.2, until_m=8.0), Cone(slope=-0.5, until_t=0.3)],
        pinhole_height_m=0.6,
        apex_above_pinhole_m=0.2,
    )
    judged = judge(cup, focal_px=500.0)
    assert judged.views[0].blocked[-1] and not judged.views[0].blocked[0]
    assert not any(view.blocked.any() for view in judge(lima2001(), focal_px=500.0).views)


def test_line_width_px_is_constant_on_isometric_part() -> None:
    sizes = judge(lima2001(), focal_px=500.0, reach_m=12.0).sizes
    inside = (sizes.distance_m > 0.7) & (sizes.distance_m < 5.9)
    assert sizes.line_radial_px[inside] == pytest.approx(0.125 * 500.0 * 0.22 / 6.0, rel=1e-4)


def test_ball_size_matches_its_tangent_rays() -> None:
    mirror = lima2001()
    sizes = judge(mirror, focal_px=500.0, reach_m=12.0).sizes
    index = int(np.argmin(np.abs(sizes.distance_m - 3.0)))
    centre = np.array([sizes.distance_m[index], 0.11 - 0.6])
    rays = mirror.rays(np.linspace(0.0, 0.3, 20000))
    along = np.stack([np.sin(rays.gamma_rad), -np.cos(rays.gamma_rad)])
    to_centre = centre[:, None] - np.stack([rays.x_m, rays.y_m])
    hit = np.abs(along[0] * to_centre[1] - along[1] * to_centre[0]) <= 0.11
    assert sizes.ball_radial_px[index] == pytest.approx(500.0 * np.ptp(rays.t[hit]), abs=0.5)


def test_defocus_vanishes_at_the_focus_distance() -> None:
    judged = judge(lima2001(), focal_px=500.0, lens=Lens(focus_m=0.21))
    meridional, _ = judged.blur_px(judged.views[0])
    index = int(np.argmin(np.abs(judged.views[0].image_tangential_m - 0.21)))
    assert meridional[index] < 0.2 < meridional[-1]


ONLY_FOCAL = Tolerances(form_m=0.0, tilt_deg=0.0, offset_m=0.0, height_m=0.0, focal_share=0.01)
ONLY_HEIGHT = Tolerances(form_m=0.0, tilt_deg=0.0, offset_m=0.0, height_m=0.002, focal_share=0.0)


def camera() -> Camera:
    return fit_camera(lima2001())


def test_focal_length_error_scales_isometric_range() -> None:
    errors = monte_carlo(lima2001(), camera=camera(), tolerances=ONLY_FOCAL, count=400, reach_m=5.5, progress=False)
    assert errors.radial_rms_m == pytest.approx(0.01 * errors.distance_m, rel=0.15)
    assert errors.tangential_rms_m.max() < 1e-5


def test_mirror_height_error_matches_reflection_law() -> None:
    mirror = lima2001()
    errors = monte_carlo(mirror, camera=camera(), tolerances=ONLY_HEIGHT, count=400, reach_m=5.5, progress=False)
    lifted = 1e-5
    for index in (3, 9, 15):
        t = errors.distance_m[index] * 0.22 / 6.0
        # The same pixel meets a profile that hangs higher: Y(X) + lift, at X = t·(Y + lift).
        x = t * float(mirror.rays(np.array([t])).y_m[0])
        for _ in range(30):
            inner = x / float(mirror.rays(np.array([t])).y_m[0])
            u = inner
            for _ in range(30):
                u = x / float(mirror.rays(np.array([u])).y_m[0])
            rays = mirror.rays(np.array([u]))
            x = t * (float(rays.y_m[0]) + lifted)
        gamma = np.arctan(t) + 2.0 * np.arctan(float(rays.slope[0]))
        ground = x + (float(rays.y_m[0]) + lifted + 0.6) * np.tan(gamma)
        slope = (ground - errors.distance_m[index]) / lifted
        assert errors.radial_rms_m[index] == pytest.approx(0.002 * abs(slope), rel=0.15)


def test_monte_carlo_is_deterministic() -> None:
    first, second = (monte_carlo(lima2001(), camera=camera(), count=20, seed=seed, progress=False) for seed in (7, 7))
    assert (first.total_95_m == second.total_95_m).all()
    other = monte_carlo(lima2001(), camera=camera(), count=20, seed=8, progress=False)
    assert (first.radial_rms_m != other.radial_rms_m).any()


def test_variances_of_sources_add_up_to_total() -> None:
    errors = monte_carlo(lima2001(), camera=camera(), count=600, reach_m=6.0, progress=False)
    whole = np.hypot(errors.radial_rms_m, errors.tangential_rms_m)
    parts = np.sqrt(sum(part**2 for part in errors.by_cause_rms_m.values()))
    assert parts == pytest.approx(whole, rel=0.25)


def test_visible_heights_match_the_design_target() -> None:
    # lima2001: the curved part ends on the point 0.6 m high at 11.2 m; the isometric part's last ray is down at 6 m.
    judged = judge(lima2001(), focal_px=731.25)
    isometric, curved, planar = visible_heights(judged, distance_m=np.array([3.0, 5.9, 6.1, 11.2]))
    assert curved.highest_m[3] == pytest.approx(0.6, abs=1e-3) and curved.lowest_m[3] == 0.0
    assert curved.shows(distance_m=11.2, height_m=0.59) and not curved.shows(distance_m=11.2, height_m=0.61)
    assert np.isfinite(isometric.highest_m[:2]).all() and np.isnan(isometric.highest_m[2:]).all()
    assert np.isnan(planar.highest_m).all()


def test_ground_across_the_axis_is_where_the_ground_map_has_it() -> None:
    inverted = design([Cone(slope=-0.5, until_t=0.3)], pinhole_height_m=0.6, apex_above_pinhole_m=0.2)
    camera = Camera(width_px=201, height_px=201, focal_px=500.0, pinhole_height_m=0.6)
    traced = ground_map(camera=camera, profile=inverted.profile())
    judged = judge(inverted, focal_px=500.0)
    ground = judged.views[0].ground_m
    column = 160
    found = float(np.hypot(traced.x_m[100, column], traced.y_m[100, column]))
    t = (column - camera.centre_px[0]) / 500.0
    assert found == pytest.approx(float(np.interp(t, judged.views[0].rays.t, ground)), abs=1e-4)
    assert np.ravel(judged.blind_m) == pytest.approx([0.0, ground.min(), ground.max(), 12.0], abs=1e-6)
    assert ground_costs(inverted, camera=camera)


def test_ground_costs_at_a_joint_match_the_reflection_law() -> None:
    mirror = nubot2013()
    camera = fit_camera(mirror)
    isometric = mirror.segment("horizontally isometric")
    costs = {cost.imperfection: cost for cost in ground_costs(mirror, camera=camera)}
    at = int(np.argmin(np.abs(costs["focal length off by 0.1 %"].distance_m - 8.0)))

    def ground(t: float, lift: float = 0.0) -> float:
        # The ray t meets the lifted profile where the design has the slope u.
        def miss(u: float) -> float:
            y = float(mirror.rays(np.array([u])).y_m[0])
            return u * y - t * (y + lift)

        rays = mirror.rays(np.array([brentq(miss, t - 1e-3, t + 1e-3, xtol=1e-15)]))
        gamma = np.arctan(t) + 2.0 * np.arctan(rays.slope[0])
        return float(rays.x_m[0] + (rays.y_m[0] + lift + mirror.pinhole_height_m) * np.tan(gamma))

    t = isometric.t_to
    assert ground(t) == pytest.approx(8.0, abs=1e-9)
    focal, raised = costs["focal length off by 0.1 %"], costs["mirror 0.1 mm too high"]
    assert focal.rms_m[at] == pytest.approx(abs(ground(t / 1.001) - 8.0), rel=0.1)
    assert raised.rms_m[at] == pytest.approx(abs(ground(t, 1e-4) - 8.0), rel=0.1)


@pytest.mark.parametrize("rays", [0, 1])
def test_too_few_rays_are_rejected(rays: int) -> None:
    with pytest.raises(ValueError, match=rf"invalid rays_per_part: {rays} \(expected at least 2\)"):
        judge(lima2001(), focal_px=500.0, rays_per_part=rays)
