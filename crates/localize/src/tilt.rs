//! Where does a ground point of an upright robot's map lie when the robot is tilted, and the inverse?
//!
//! A calibrated map holds for an upright robot. With tilt (a, b), the x and y components of the vertical in the robot
//! frame (radians), the ray to map point p = (X, Y) meets the ground elsewhere (docs/methods.md 3.3). The robot tilts
//! about its foot, the robot frame's origin on the ground, so that its viewpoint at height H moves by −(a, b) H. Nothing is
//! linearised but the rotation itself, whose second-order terms are dropped: along the line of sight the tilt is a
//! tangent in place of a sine.
//!
//! The order of operations is part of the definition: poses are reproducible bit by bit.

use nalgebra::{RealField, convert};

/// Smallest depth of a ray in [`ground_from_map`], share of H: a ray that is closer to the horizon is cut off there.
const DEPTH_SHARE_MIN: f64 = 0.5;

/// Depth H − s of the ray to `map_point` below the tilted viewpoint, with s = aX + bY; 0 or less at the horizon.
#[inline]
fn ray_depth<T: RealField + Copy>([x, y]: [T; 2], [a, b]: [T; 2], height: T) -> T {
    height - a * x - b * y
}

/// The ground point (metres, robot frame) that a robot with tilt (a, b) sees at `map_point` of its upright map.
///
/// q = (p + (a, b) H) · H/(H − s) − (a, b) H. The depth H − s is bounded from below by H/2, so that the result is always
/// finite.
#[inline]
pub fn ground_from_map<T: RealField + Copy>(map_point: [T; 2], tilt: [T; 2], height: T) -> [T; 2] {
    let ([x, y], [a, b]) = (map_point, tilt);
    let depth = ray_depth(map_point, tilt, height).max(convert::<f64, T>(DEPTH_SHARE_MIN) * height);
    let stretch = height / depth;
    let (shift_x, shift_y) = (a * height, b * height);
    [
        (x + shift_x) * stretch - shift_x,
        (y + shift_y) * stretch - shift_y,
    ]
}

/// As [`ground_from_map`], but unbounded: None if the ray's depth is not above `depth_min` (metres, positive).
#[inline]
pub fn ground_above_depth<T: RealField + Copy>(
    map_point: [T; 2],
    tilt: [T; 2],
    height: T,
    depth_min: T,
) -> Option<[T; 2]> {
    let ([x, y], [a, b]) = (map_point, tilt);
    let depth = ray_depth(map_point, tilt, height);
    (depth > depth_min).then(|| {
        let stretch = height / depth;
        let (shift_x, shift_y) = (a * height, b * height);
        [
            (x + shift_x) * stretch - shift_x,
            (y + shift_y) * stretch - shift_y,
        ]
    })
}

/// A ground point with its derivatives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TiltedPoint {
    /// As [`ground_from_map`], metres.
    pub ground: [f32; 2],
    /// Derivatives of x and of y by the map point's x and y.
    pub by_point: [[f32; 2]; 2],
    /// Derivatives of x and of y by the tilt's a and b, metres per radian.
    pub by_tilt: [[f32; 2]; 2],
}

/// [`ground_from_map`] with its derivatives.
pub fn linearize(map_point: [f32; 2], tilt: [f32; 2], height: f32) -> TiltedPoint {
    let depth = ray_depth(map_point, tilt, height).max(DEPTH_SHARE_MIN as f32 * height);
    let stretch = height / depth;
    let shift = tilt.map(|part| part * height);
    let below: [f32; 2] = std::array::from_fn(|i| (map_point[i] + shift[i]) * stretch);
    let unit = |i: usize, j: usize| f32::from(u8::from(i == j));
    TiltedPoint {
        ground: std::array::from_fn(|i| below[i] - shift[i]),
        by_point: std::array::from_fn(|i| {
            std::array::from_fn(|j| stretch * (unit(i, j) + below[i] * tilt[j] / height))
        }),
        by_tilt: std::array::from_fn(|i| {
            std::array::from_fn(|j| {
                (stretch - 1.0) * height * unit(i, j) + below[i] * map_point[j] / depth
            })
        }),
    }
}

/// The point of the upright map (metres, robot frame) at which a robot with tilt (a, b) sees `ground_point`.
///
/// The exact inverse of [`ground_from_map`]: p = w · H (1 + a² + b²)/(H + s′) − (a, b) H, with w = q + (a, b) H as seen from
/// below the viewpoint, and s′ = (a, b)·w. None if the upright map does not show the point, because the ray to it lies above the map's horizon.
#[inline]
pub fn map_from_ground<T: RealField + Copy>(
    ground_point: [T; 2],
    tilt: [T; 2],
    height: T,
) -> Option<[T; 2]> {
    let ([x, y], [a, b]) = (ground_point, tilt);
    let (shift_x, shift_y) = (a * height, b * height);
    let (x, y) = (x + shift_x, y + shift_y);
    let along = height + a * x + b * y;
    (along > T::zero()).then(|| {
        let shrink = height * (T::one() + a * a + b * b) / along;
        [x * shrink - shift_x, y * shrink - shift_y]
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Rotation3, Vector3};
    use proptest::prelude::*;

    const HEIGHT: f64 = 0.75;

    /// The upright map's ray to a point, seen from the viewpoint (0, 0, H).
    fn map_ray([x, y]: [f64; 2]) -> Vector3<f64> {
        Vector3::new(x, y, -HEIGHT)
    }

    /// Where a ray from `origin` meets the ground plane z = 0.
    fn ground_intersection(origin: Vector3<f64>, ray: Vector3<f64>) -> [f64; 2] {
        let scale = origin.z / -ray.z;
        [origin.x + scale * ray.x, origin.y + scale * ray.y]
    }

    /// The viewpoint of an upright robot, whose foot is the origin.
    fn viewpoint() -> Vector3<f64> {
        Vector3::new(0.0, 0.0, HEIGHT)
    }

    /// The axis and size of the rotation that takes the tilted vertical to the vertical, as a vector.
    fn rotation_vector([a, b]: [f64; 2]) -> Vector3<f64> {
        Vector3::new(b, -a, 0.0)
    }

    fn distance([ax, ay]: [f64; 2], [bx, by]: [f64; 2]) -> f64 {
        (ax - bx).hypot(ay - by)
    }

    prop_compose! {
        /// A tilt up to 5° in any direction.
        fn tilts()(size in 0.0..5f64.to_radians(), direction in 0.0..std::f64::consts::TAU)
            -> [f64; 2] { [size * direction.cos(), size * direction.sin()] }
    }

    prop_compose! {
        /// A point up to 12 m away in any direction.
        fn points()(range in 0.0..12.0, bearing in 0.0..std::f64::consts::TAU)
            -> [f64; 2] { [range * bearing.cos(), range * bearing.sin()] }
    }

    proptest! {
        #[test]
        fn map_from_ground_inverts_ground_from_map(tilt in tilts(), point in points()) {
            // Beyond the bounded depth the forward formula is cut off on purpose.
            prop_assume!(ray_depth(point, tilt, HEIGHT) > 0.5 * HEIGHT);
            let ([x, y], [a, b]) = (point.map(|v| v as f32), tilt.map(|v| v as f32));
            let ground = ground_from_map([x, y], [a, b], HEIGHT as f32);
            let [u, v] = map_from_ground(ground, [a, b], HEIGHT as f32).expect("a visible point");
            // Rounding of a point at 24 m (the stretch is at most 2), a few operations long.
            prop_assert!((u - x).hypot(v - y) < 24.0 * 8.0 * f32::EPSILON, "({u}, {v}) for ({x}, {y})");
        }

        #[test]
        fn ground_from_map_equals_a_ray_plane_intersection(tilt in tilts(), point in points()) {
            prop_assume!(ray_depth(point, tilt, HEIGHT) > 0.5 * HEIGHT);
            // Ray and viewpoint under the rotation without its second-order terms: v + ω × v.
            let turned = |v: Vector3<f64>| v + rotation_vector(tilt).cross(&v);
            let exact = ground_intersection(turned(viewpoint()), turned(map_ray(point)));
            prop_assert!(distance(ground_from_map(point, tilt, HEIGHT), exact) < 1e-9);
            let single = ground_from_map(point.map(|v| v as f32), tilt.map(|v| v as f32), HEIGHT as f32);
            prop_assert!(distance(single.map(f64::from), exact) < 24.0 * 8.0 * f64::from(f32::EPSILON));
        }

        #[test]
        fn ground_from_map_differs_from_a_full_rotation_by_second_order_terms(
            tilt in tilts(), point in points(),
        ) {
            prop_assume!(ray_depth(point, tilt, HEIGHT) > 0.5 * HEIGHT);
            let size = tilt[0].hypot(tilt[1]);
            // The tilt (a, b) is a tangent along the line of sight.
            let axis = rotation_vector(tilt) * (size.atan() / size.max(1e-12));
            let rotation = Rotation3::new(axis);
            let exact = ground_intersection(rotation * viewpoint(), rotation * map_ray(point));
            let stretch = HEIGHT / ray_depth(point, tilt, HEIGHT);
            // Across the tilt's direction a full rotation shrinks the point by cos φ, 1 − φ²/2, and lowers the viewpoint
            // by the same share.
            let range = point[0].hypot(point[1]) + size * HEIGHT;
            let bound = size * size * stretch * range + 1e-9;
            prop_assert!(distance(ground_from_map(point, tilt, HEIGHT), exact) <= bound);
        }
    }

    #[test]
    fn derivatives_equal_differences() {
        let (point, tilt, height) = ([3.0_f32, -1.5], [0.02_f32, -0.01], 0.8_f32);
        let here = linearize(point, tilt, height);
        assert_eq!(here.ground, ground_from_map(point, tilt, height));
        const STEP: f32 = 1e-3;
        for j in 0..2 {
            let (mut moved, mut tilted) = (point, tilt);
            moved[j] += STEP;
            tilted[j] += STEP;
            let by_point = ground_from_map(moved, tilt, height);
            let by_tilt = ground_from_map(point, tilted, height);
            for i in 0..2 {
                let difference = (by_point[i] - here.ground[i]) / STEP;
                assert!((difference - here.by_point[i][j]).abs() < 5e-3, "{i} {j}");
                let difference = (by_tilt[i] - here.ground[i]) / STEP;
                assert!(
                    (difference - here.by_tilt[i][j]).abs() < 0.1,
                    "{i} {j} {difference}"
                );
            }
        }
    }

    #[test]
    fn positive_a_makes_the_robot_see_farther_ahead() {
        let [x, y] = ground_from_map([3.0_f32, 0.0], [0.01, 0.0], 0.75);
        assert!(x > 3.0 && y == 0.0, "{x} {y}");
    }

    #[test]
    fn points_at_or_above_the_horizon_have_no_counterpart() {
        assert_eq!(
            ground_above_depth([100.0, 0.0], [0.02, 0.0], 0.75, 0.0375),
            None
        );
        assert_eq!(map_from_ground([-100.0, 0.0], [0.02, 0.0], 0.75), None);
        let bounded = ground_from_map([100.0_f64, 0.0], [0.02, 0.0], 0.75);
        assert!(bounded.iter().all(|v| v.is_finite()));
    }
}
