"""Designed mirrors against independent ray tracing and published numbers."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from mirrorball import Camera, Profile, trace_points
from mirrorball.mirror import (
    REFERENCE_DESIGNS,
    Cone,
    ConstantCurvature,
    Free,
    HorizontallyIsometric,
    Hyperboloid,
    Mirror,
    Paraboloid,
    Planar,
    Sphere,
    VerticallyIsometric,
    design,
    lima2001,
    minho_like,
    nubot2013,
    sphere_cone_1999,
)
from mirrorball.mirror.reflection import Array


def retraced_ground_m(mirror: Mirror, t: Array, part: str) -> Array:
    """Ground distances from the samples alone: a spline's tangents, vectors reflected, no angle of the design's own law."""
    segment = mirror.segment(part)
    radius, height = mirror.samples(step_m=2e-5)
    ends = [u * float(segment.height(np.array([u]))[0]) for u in (segment.t_from, segment.t_to)]
    inside = (radius >= ends[0] - 1e-9) & (radius <= ends[1] + 1e-9)
    curve = CubicSpline(radius[inside], height[inside] - mirror.pinhole_height_m)
    x = np.array([brentq_radius(curve, u, ends) for u in t])
    y, slope = curve(x), curve(x, 1)
    incoming = np.stack([x, y]) / np.hypot(x, y)
    normal = np.stack([slope, -np.ones_like(slope)]) / np.hypot(slope, 1.0)
    outgoing = incoming - 2.0 * (incoming * normal).sum(axis=0) * normal
    return np.asarray(x - (y + mirror.pinhole_height_m) * outgoing[0] / outgoing[1])


def brentq_radius(curve: CubicSpline, t: float, ends: list[float]) -> float:
    """Bisection: where the camera ray t meets the spline."""
    low, high = ends[0], ends[1]
    for _ in range(70):
        middle = (low + high) / 2.0
        if middle < t * float(curve(middle)):
            low = middle
        else:
            high = middle
    return (low + high) / 2.0


@pytest.mark.parametrize(
    ("mirror", "from_m", "until_m"), [(lima2001(), 0.0, 6.0), (nubot2013(), 1.0, 8.0)], ids=["lima2001", "nubot2013"]
)
def test_isometric_part_is_linear_to_a_tenth_of_a_millimetre(mirror: Mirror, from_m: float, until_m: float) -> None:
    part = mirror.segment("horizontally isometric")
    share = np.linspace(0.001, 0.999, 200)
    wanted = from_m + share * (until_m - from_m)
    found = retraced_ground_m(mirror, part.t_from + share * (part.t_to - part.t_from), "horizontally isometric")
    assert (np.abs(found - wanted) <= 1e-4 + 1e-4 * wanted).all(), np.abs(found - wanted).max()


def test_profile_agrees_with_independent_ode_solver() -> None:
    mirror = lima2001()
    part = mirror.segment("horizontally isometric")
    eta = 6.0 / 0.22

    def slope(x: float, y: Array) -> Array:
        t = x / y
        return np.asarray(np.tan((np.arctan((eta * t - x) / (y + 0.6)) - np.arctan(t)) / 2.0))

    x_end = part.t_to * part.end()[0]
    for method, step in (("Radau", 1e-4), ("RK45", 1e-5)):
        other = solve_ivp(slope, (0.0, x_end), [0.2], method=method, rtol=1e-10, atol=1e-12, max_step=step, dense_output=True)
        t = np.linspace(0.0, part.t_to, 50)
        y = part.height(t)
        assert np.abs(other.sol(t * y)[0] - y).max() < 1e-9


def test_ray_tracer_reproduces_isometric_ground_map() -> None:
    mirror = lima2001()
    camera = Camera(width_px=480, height_px=480, focal_px=500.0, pinhole_height_m=0.6, centre_px=(0.0, 0.0))
    radius, height = mirror.samples()
    t = np.linspace(0.005, 0.2195, 100)
    origin, direction = trace_points(
        camera=camera, profile=Profile(radius_m=radius, height_m=height), u_px=t * 500.0, v_px=np.zeros_like(t)
    )
    way = -origin[:, 2] / direction[:, 2]
    ground = np.hypot(*(origin[:, :2] + way[:, None] * direction[:, :2]).T)
    wanted = 6.0 / 0.22 * t
    assert (np.abs(ground - wanted) <= 1e-4 + 1e-4 * wanted).all(), np.abs(ground - wanted).max()


def test_lima2001_profile_matches_published_coordinates() -> None:
    mirror = lima2001()
    isometric, curved = mirror.segment("horizontally isometric"), mirror.segment("constant curvature")
    for part, x, y, slope in ((isometric, 0.0508, 0.2307, 0.6956), (curved, 0.0742, 0.2474, 0.7269)):
        height, tangent = part.end()
        assert (round(part.t_to * height, 4), round(height, 4), round(tangent, 4)) == (x, y, slope)


def test_constant_curvature_part_passes_target_within_1_mm() -> None:
    mirror = lima2001()
    part = mirror.segment("constant curvature")
    height = part.rays(np.array([part.t_to]), mirror.pinhole_height_m).height_at_m(11.2)
    assert abs(float(height[0]) - 0.6) < 1e-6
    radius, heights = mirror.samples(step_m=2e-5)
    x_end = part.t_to * part.end()[0]
    index = int(np.argmin(np.abs(radius - x_end)))
    last = slice(index - 5, index + 1)
    curve = CubicSpline(radius[last], heights[last] - 0.6)
    gamma = np.arctan(part.t_to) + 2.0 * np.arctan(float(curve(x_end, 1)))
    assert abs(0.6 + float(curve(x_end)) - (11.2 - x_end) / np.tan(gamma) - 0.6) < 1e-3


def test_planar_part_covers_0_39_to_0_51_m() -> None:
    mirror = lima2001()
    part = mirror.segment("planar")
    ground = part.rays(np.array([part.t_from, part.t_to]), mirror.pinhole_height_m).distance_at_m(0.0)
    assert ground == pytest.approx([0.39, 0.51], abs=1e-9)


@pytest.mark.parametrize("name", REFERENCE_DESIGNS)
def test_tangent_is_continuous_where_declared(name: str) -> None:
    mirror = REFERENCE_DESIGNS[name]()
    for before, after in pairwise(mirror.segments):
        y_before, slope_before = before.end()
        t = np.array([after.t_from])
        y_after = after.height(t)
        assert abs(float(y_after[0]) - y_before) < 1e-12
        if after.tangent_continuous:
            assert abs(float(after.tangent(t, y_after)[0]) - slope_before) < 1e-9


def test_tangent_continuity_flags_of_reference_designs() -> None:
    assert [part.tangent_continuous for part in lima2001().segments] == [True, True, False, True]
    assert [part.tangent_continuous for part in nubot2013().segments] == [True, True, True]
    assert [part.tangent_continuous for part in sphere_cone_1999().segments] == [True, True]
    assert minho_like().segments[0].tangent_continuous


def test_sphere_cone_1999_matches_published_dimensions() -> None:
    mirror = sphere_cone_1999()
    sphere, cone = mirror.segments
    assert 2.0 * mirror.radius_m == pytest.approx(0.185, abs=1e-9)
    ends = [part.rays(np.array([part.t_to]), 0.6).distance_at_m(0.0)[0] for part in (sphere, cone)]
    assert ends == pytest.approx([1.5, 6.0], abs=1e-9)


def test_hyperboloid_has_a_single_viewpoint() -> None:
    mirror = design([Hyperboloid(eccentricity=1.3, until_t=0.4)], pinhole_height_m=0.6, apex_above_pinhole_m=0.2)
    rays = mirror.rays(np.linspace(1e-3, 0.4, 300))
    # The other focus of the conic: apex at a + c, foci 2c apart.
    focus = 2.0 * 1.3 * 0.2 / 2.3
    past = rays.x_m * np.cos(rays.gamma_rad) + (rays.y_m - focus) * np.sin(rays.gamma_rad)
    assert np.abs(past).max() < 1e-9
    # On the conic by its definition, and its tangent by differences of its heights.
    assert np.hypot(rays.x_m, rays.y_m) - np.hypot(rays.x_m, rays.y_m - focus) == pytest.approx(2.0 * 0.2 / 2.3, abs=1e-12)
    tangent = CubicSpline(rays.x_m, rays.y_m)(rays.x_m, 1)
    assert np.abs(tangent - rays.slope)[5:-5].max() < 1e-7


def test_paraboloid_approaches_single_viewpoint_for_distant_camera() -> None:
    def spread(apex: float) -> float:
        part = Paraboloid(focal_length_m=0.02, until_radius_m=0.05)
        mirror = design([part], pinhole_height_m=0.6, apex_above_pinhole_m=apex)
        rays = mirror.rays(np.linspace(1e-4, 1.0, 50) * mirror.t_max)
        crossing = rays.y_m + rays.x_m / np.tan(rays.gamma_rad)
        return float(np.ptp(crossing))

    near, far, further = spread(0.2), spread(20.0), spread(2000.0)
    assert near > 1e-3 and far < near / 50.0 and further < far / 50.0


def test_conics_continue_the_previous_tangent() -> None:
    cone = Cone(slope=0.3, until_t=0.1)
    for part in (Sphere(until_t=0.2), Paraboloid(until_t=0.2), Hyperboloid(until_t=0.2), Cone(until_t=0.2)):
        mirror = design([cone, part], pinhole_height_m=0.6, apex_above_pinhole_m=0.2)
        t = np.array([0.1])
        second = mirror.segments[1]
        y = second.height(t)
        assert float(y[0]) == pytest.approx(mirror.segments[0].end()[0], abs=1e-14)
        assert float(second.tangent(t, y)[0]) == pytest.approx(0.3, abs=1e-12)


def test_vertically_isometric_part_is_linear_in_height() -> None:
    mirror = nubot2013()
    part = mirror.segment("vertically isometric")
    t = np.linspace(part.t_from, part.t_to, 50)
    height = part.rays(t, mirror.pinhole_height_m).height_at_m(8.0)
    assert height == pytest.approx(1.2 * (t - part.t_from) / (part.t_to - part.t_from), abs=1e-9)


def test_freeform_part_follows_arbitrary_target_map() -> None:
    def target(t: Array) -> tuple[Array, Array]:
        return 20.0 * t + 10.0 * t**2, 0.3 * t

    mirror = design([Free(target=target, until_t=0.2)], pinhole_height_m=0.5, apex_above_pinhole_m=0.15)
    rays = mirror.rays(np.linspace(0.01, 0.2, 20))
    met = rays.x_m + (rays.y_m + 0.5 - 0.3 * rays.t) * np.tan(rays.gamma_rad)
    assert met == pytest.approx(20.0 * rays.t + 10.0 * rays.t**2, abs=1e-9)


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        # The mirror climbs after a point that climbs faster, until both meet.
        ([Free(target=lambda t: (20.0 * t, 60.0 * t), until_t=0.5)], ["part 1 (free)", "at t =", "runs into"]),
        # A tangent that would have to lie along the camera's ray.
        (
            [
                Cone(slope=-2.0, until_t=0.4),
                VerticallyIsometric(distance_m=0.2, from_height_m=9.0, until_height_m=30.0, until_t=0.5),
            ],
            ["part 2 (vertically isometric)", "at t =", "behind"],
        ),
        ([HorizontallyIsometric(until_t=0.2, until_m=6.0), Planar(until_t=0.6)], ["part 2 (planar)", "0.6", "lens"]),
        ([HorizontallyIsometric(until_t=0.55, until_m=6.0)], ["part 1 (horizontally isometric)", "lens"]),
        ([Sphere(radius_m=0.03, until_t=0.4)], ["part 1 (sphere)", "at t =", "bends away"]),
        ([Cone(slope=0.2, until_ground_m=50.0)], ["part 1 (cone)", "never reaches", "50"]),
        (
            [
                HorizontallyIsometric(until_t=0.2, until_m=6.0),
                Free(target=lambda t: (7.0 + t, 0 * t), until_t=0.3, tangent_continuous=True),
            ],
            ["part 2 (free)", "at t = 0.2000", "tangent would jump"],
        ),
        (
            [Cone(slope=0.5, until_t=0.2), ConstantCurvature(until_t=0.1, through_distance_m=3.0, through_height_m=0.0)],
            ["part 2 (constant curvature)", "at t = 0.2000", "earlier"],
        ),
        ([Free(target=lambda t: (np.nan * t, 0 * t), until_t=0.2)], ["part 1 (free)", "not a number"]),
        (
            [Free(target=lambda t: (20.0 * t, 0 * t), until_t=0.3, known_t=(0.0, 0.2))],
            ["part 1 (free)", "the points end at t = 0.2, but the part ends at t = 0.3"],
        ),
        ([Cone(slope=1.0, until_t=0.2), HorizontallyIsometric(until_t=0.3, until_m=6.0)], ["part 2", "does not come down"]),
        ([Hyperboloid(eccentricity=1.05, until_t=0.45)], ["part 1 (hyperboloid)", "asymptote"]),
        ([Sphere(radius_m=0.05, until_t=0.1, until_ground_m=1.0)], ["part 1 (sphere)", "exactly one"]),
        (
            [VerticallyIsometric(distance_m=0.001, from_height_m=0.0, until_height_m=2.0, until_t=0.2)],
            ["part 1 (vertically isometric)", "at t =", "without bound"],
        ),
    ],
)
def test_infeasible_parts_report_part_slope_and_reason(parts: list[Cone], words: list[str]) -> None:
    with pytest.raises(ValueError, match="part") as caught:
        design(parts, pinhole_height_m=0.6, apex_above_pinhole_m=0.2, t_max=0.5)
    for word in words:
        assert word in str(caught.value), str(caught.value)


def test_samples_include_joints_and_lie_on_the_profile() -> None:
    mirror = lima2001()
    radius, height = mirror.samples(step_m=1e-4)
    assert radius[0] == 0.0 and height[0] == pytest.approx(0.8, abs=1e-15)
    assert (np.diff(radius) > 0.0).all() and np.diff(radius).max() <= 1.0001e-4
    for part in mirror.segments:
        assert np.abs(radius - part.t_to * part.end()[0]).min() < 1e-15
    rays = mirror.rays(np.clip(radius[1:] / (height[1:] - 0.6), 0.0, mirror.t_max))
    assert rays.y_m == pytest.approx(height[1:] - 0.6, abs=1e-12)
