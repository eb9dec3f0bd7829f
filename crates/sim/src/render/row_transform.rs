//! How does the camera move while an image is exposed? Rotation and translation of each row.

/// Motion of the robot during one image.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct CameraMotion {
    /// Velocity along the robot's x and y axes, m/s.
    pub velocity: [f32; 2],
    /// Yaw rate, rad/s counter-clockwise.
    pub yaw_rate: f32,
    /// Tilt in the middle of the exposure: x and y components of the vertical in the robot frame.
    pub tilt: [f32; 2],
    /// Its rate of change, 1/s.
    pub tilt_rate: [f32; 2],
    /// Time between the exposures of the first and the last row, seconds.
    pub readout: f32,
    /// Exposure time of a row, seconds.
    pub shutter: f32,
}

/// The transform from the camera as mounted to the level robot frame in the middle of the image, linear over the rows.
#[derive(Debug, Clone, Copy)]
pub(super) struct RowTransform {
    /// Rotation in the middle row, row by row, and its change over the whole image.
    pub(super) rotation: [[f32; 9]; 2],
    /// Translation over the whole image, metres.
    pub(super) shift: [f32; 2],
    /// Largest tilt of a row, radians, and largest translation of an origin, metres: margins for lookups.
    pub(super) tilt_max: f32,
    pub(super) shift_max: f32,
}

impl Default for RowTransform {
    fn default() -> Self {
        RowTransform::new(&CameraMotion::default(), 0.0)
    }
}

impl RowTransform {
    /// `height`: largest height of a ray's origin, metres.
    pub(super) fn new(motion: &CameraMotion, height: f32) -> Self {
        let half = motion.readout / 2.0;
        let at = |time: f32| {
            let [a, b] = [0, 1].map(|k| motion.tilt[k] + time * motion.tilt_rate[k]);
            rotated_by(level_from_body(a, b), time * motion.yaw_rate)
        };
        let (first, last) = (at(-half), at(half));
        let [a, b] = motion.tilt;
        let rocks = half * motion.tilt_rate[0].hypot(motion.tilt_rate[1]);
        let tilt_max = a.hypot(b) + rocks;
        let shift = motion.velocity.map(|part| part * motion.readout);
        RowTransform {
            rotation: [
                std::array::from_fn(|k| (first[k] + last[k]) / 2.0),
                std::array::from_fn(|k| last[k] - first[k]),
            ],
            shift,
            tilt_max,
            shift_max: 0.5 * shift[0].hypot(shift[1]) + tilt_max * height,
        }
    }
}

impl RowTransform {
    /// True if all rows have the same rotation.
    pub(super) fn is_constant(&self) -> bool {
        self.rotation[1] == [0.0; 9]
    }

    /// Rotation of a row: -0.5 at the top of the image, 0.5 at the bottom.
    #[inline(always)]
    pub(super) fn rotation_at(&self, row: f32) -> [f32; 9] {
        let [middle, change] = &self.rotation;
        std::array::from_fn(|k| row.mul_add(change[k], middle[k]))
    }

    /// Translation of a row, metres.
    #[inline(always)]
    pub(super) fn shift_at(&self, row: f32) -> [f32; 2] {
        self.shift.map(|shift| row * shift)
    }
}

/// The smallest rotation that turns the vertical (a, b, c) of the body to (0, 0, 1), row by row.
pub(crate) fn level_from_body(a: f32, b: f32) -> [f32; 9] {
    let c = (1.0 - a * a - b * b).max(0.0).sqrt();
    let per = 1.0 / (1.0 + c);
    [
        1.0 - a * a * per,
        -a * b * per,
        -a,
        -a * b * per,
        1.0 - b * b * per,
        -b,
        a,
        b,
        c,
    ]
}

/// A rotation followed by one about the vertical.
fn rotated_by(matrix: [f32; 9], yaw: f32) -> [f32; 9] {
    let (sin, cos) = yaw.sin_cos();
    let m = matrix;
    [
        cos * m[0] - sin * m[3],
        cos * m[1] - sin * m[4],
        cos * m[2] - sin * m[5],
        sin * m[0] + cos * m[3],
        sin * m[1] + cos * m[4],
        sin * m[2] + cos * m[5],
        m[6],
        m[7],
        m[8],
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use localize::tilt::ground_from_map;

    #[test]
    fn level_from_body_turns_the_measured_vertical_upright() {
        let (a, b) = (0.03f32, -0.05f32);
        let m = level_from_body(a, b);
        let c = (1.0 - a * a - b * b).sqrt();
        let up: [f32; 3] =
            std::array::from_fn(|k| m[3 * k] * a + m[3 * k + 1] * b + m[3 * k + 2] * c);
        assert!(
            (up[0].abs() + up[1].abs() + (up[2] - 1.0).abs()) < 1e-6,
            "{up:?}"
        );
    }

    #[test]
    fn tilted_ray_meets_the_ground_where_the_localizer_expects_it() {
        let (height, tilt, map) = (0.7f32, [0.012f32, -0.02f32], [2.0f32, -1.0f32]);
        let m = level_from_body(tilt[0], tilt[1]);
        let apply = |v: [f32; 3]| -> [f32; 3] {
            std::array::from_fn(|k| m[3 * k] * v[0] + m[3 * k + 1] * v[1] + m[3 * k + 2] * v[2])
        };
        let (origin, ray) = (apply([0.0, 0.0, height]), apply([map[0], map[1], -height]));
        let distance = origin[2] / -ray[2];
        let at = [origin[0] + distance * ray[0], origin[1] + distance * ray[1]];
        let expected = ground_from_map(map, tilt, height);
        for k in 0..2 {
            assert!((at[k] - expected[k]).abs() < 2e-3, "{at:?} {expected:?}");
        }
    }
}
