//! The shift and rotation between two maps: the robot frame of a calibration from lines is arbitrary.

use localize::Pose;
use localize::math;
use localize::robot::CameraConfig;

use crate::optics::ground_map::GroundMap;

/// Farther ground does not take part, metres.
const RANGE_MAX: f64 = 5.0;

/// Pixels up to this share of the rim's radius define the robot frame.
const INNER_SHARE: f32 = 0.4;

/// A rotation about the origin, then a shift.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct PlanarTransform {
    sin: f64,
    cos: f64,
    shift: [f64; 2],
}

impl PlanarTransform {
    /// The transform that moves the ground points of one map to those of another, in weighted least squares.
    pub(super) fn between(from: &GroundMap, to: &GroundMap) -> Self {
        let pairs: Vec<[[f64; 2]; 2]> = ground_pairs(from, to).collect();
        // An error of a map grows with the range.
        PlanarTransform::fit(&pairs, |[p, _]| {
            1.0 / (0.05 + 0.02 * math::hypot(p[0], p[1])).powi(2)
        })
    }

    /// The transform after which a map's ground points surround the origin as their pixels surround the mirror's centre.
    ///
    /// `camera`: with the rim's centre. Uses the inner pixels: an image tilt moves the outer ones.
    pub(super) fn to_mirror_centre(map: &GroundMap, camera: &CameraConfig) -> Self {
        let radius_max = INNER_SHARE * camera.outer_radius_px.unwrap_or(map.width_px as f32 / 2.0);
        let mut pairs = Vec::new();
        for (row, column) in (0..map.height_px).flat_map(|v| (0..map.width_px).map(move |u| (v, u)))
        {
            let direction = camera.robot_direction_px(column as f32, row as f32);
            if math::hypot(direction[0], direction[1]) > radius_max {
                continue;
            }
            if let Some(ground) = map.at(column, row) {
                pairs.push([
                    [ground.x, ground.y].map(f64::from),
                    direction.map(f64::from),
                ]);
            }
        }
        let mut transform = PlanarTransform::fit(&pairs, |_| 1.0);
        // The pixels' mean is the centre but for rounding; their scale differs from the ground's.
        let count = pairs.len().max(1) as f64;
        let mean = [0, 1].map(|axis| pairs.iter().map(|[p, _]| p[axis]).sum::<f64>() / count);
        transform.shift = [0.0; 2];
        transform.shift = transform.apply(mean).map(|axis| -axis);
        transform
    }

    /// Weighted least squares over pairs of points (from, to).
    fn fit(pairs: &[[[f64; 2]; 2]], weight: impl Fn(&[[f64; 2]; 2]) -> f64) -> Self {
        let sum: f64 = pairs.iter().map(&weight).sum::<f64>().max(1e-9);
        let mean = |which: usize, axis: usize| {
            let parts = pairs.iter().map(|pair| weight(pair) * pair[which][axis]);
            parts.sum::<f64>() / sum
        };
        let (pm, qm) = ([mean(0, 0), mean(0, 1)], [mean(1, 0), mean(1, 1)]);
        let (mut along, mut across) = (0.0, 0.0);
        for pair in pairs {
            let [p, q] = pair;
            let (px, py, qx, qy) = (p[0] - pm[0], p[1] - pm[1], q[0] - qm[0], q[1] - qm[1]);
            along += weight(pair) * (px * qx + py * qy);
            across += weight(pair) * (px * qy - py * qx);
        }
        let (sin, cos) = math::sin_cos(math::atan2(across, along));
        PlanarTransform {
            sin,
            cos,
            shift: [
                qm[0] - cos * pm[0] + sin * pm[1],
                qm[1] - sin * pm[0] - cos * pm[1],
            ],
        }
    }

    pub(super) fn apply(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        [
            self.shift[0] + self.cos * x - self.sin * y,
            self.shift[1] + self.sin * x + self.cos * y,
        ]
    }

    pub(super) fn apply_to_map(&self, map: &mut GroundMap) {
        for (x, y) in map.x.iter_mut().zip(&mut map.y) {
            [*x, *y] = self
                .apply([f64::from(*x), f64::from(*y)])
                .map(|axis| axis as f32);
        }
    }

    /// The pose of the moved robot frame for the same ground points: pose ∘ transform⁻¹.
    pub(super) fn apply_to_pose(&self, pose: Pose) -> Pose {
        let theta = f64::from(pose.theta) - math::atan2(self.sin, self.cos);
        let (sin, cos) = math::sin_cos(theta);
        let [x, y] = self.shift;
        Pose::new(
            (f64::from(pose.x) - cos * x + sin * y) as f32,
            (f64::from(pose.y) - sin * x - cos * y) as f32,
            theta as f32,
        )
    }
}

/// Ground points of the pixels that show ground within range in both maps.
pub(super) fn ground_pairs<'a>(
    a: &'a GroundMap,
    b: &'a GroundMap,
) -> impl Iterator<Item = [[f64; 2]; 2]> + 'a {
    (0..a.x.len())
        .map(|i| [[a.x[i], a.y[i]], [b.x[i], b.y[i]]].map(|at| at.map(f64::from)))
        .filter(|[p, q]| p.iter().chain(q).all(|value| value.is_finite()))
        .filter(|[p, _]| math::hypot(p[0], p[1]) < RANGE_MAX)
}

#[cfg(test)]
mod tests {
    use super::*;
    use localize::frames::At;

    #[test]
    fn field_points_stay_where_they_are_when_the_robot_frame_moves() {
        let (width_px, height_px) = (40, 40);
        let at = |i: usize| [(i % 40) as f32 / 10.0 - 2.0, (i / 40) as f32 / 10.0 - 2.0];
        let from = GroundMap {
            width_px,
            height_px,
            x: (0..1600).map(|i| at(i)[0]).collect(),
            y: (0..1600).map(|i| at(i)[1]).collect(),
        };
        let wanted = Pose::new(0.3, -0.1, 0.2);
        let mut to = from.clone();
        for i in 0..1600 {
            let [x, y] = at(i);
            let moved = wanted * At::new(x, y);
            (to.x[i], to.y[i]) = (moved.x, moved.y);
        }
        let transform = PlanarTransform::between(&from, &to);
        let pose = Pose::new(1.0, 2.0, -0.7);
        let moved = transform.apply_to_pose(pose);
        for i in [0, 777, 1599] {
            let before = pose * At::new(from.x[i], from.y[i]);
            let after = moved * At::new(to.x[i], to.y[i]);
            assert!(before.distance_to(after) < 1e-4, "{before:?} {after:?}");
        }
    }
}
