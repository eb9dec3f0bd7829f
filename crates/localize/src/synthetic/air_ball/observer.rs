//! In which direction does a robot believe to see the ball? Errors that last and errors of each image.

use rand::{Rng, RngExt};

use super::settings::{AirExperiment, HEIGHT, RATE};
use crate::flight::BallRay;
use crate::math;
use crate::random::standard_normal;
use crate::stamp::Stamp;

/// Standard deviations of lasting errors.
const TILT_STD_DEG: f32 = 0.15;
pub(super) const POSITION_STD: f32 = 0.03;
pub(super) const HEADING_STD: f32 = 0.008;
pub(super) const CLOCK_STD: f32 = 0.003;
/// Errors of a distance by the apparent size, shares of it: lasting, and of each image.
pub(super) const SIZE_BIAS: f32 = 0.1;
const SIZE_STD: f32 = 0.08;
/// Error of a faulty robot's directions, radians.
pub(super) const FAULT: f32 = 0.3;

/// Errors of a robot that last, in units of their standard deviations.
pub(super) struct LastingErrors(pub(super) [f32; 6]);

impl LastingErrors {
    pub(super) fn new(rng: &mut impl Rng) -> Self {
        LastingErrors(std::array::from_fn(|_| standard_normal(rng)))
    }

    /// `time`: for which they last, seconds.
    pub(super) fn step(&mut self, time: f64, rng: &mut impl Rng) {
        let decay = math::exp(-1.0 / (RATE * time)) as f32;
        // The clock's error stays.
        for value in &mut self.0[..5] {
            *value = decay * *value + (1.0 - decay * decay).sqrt() * standard_normal(rng);
        }
    }
}

/// A robot that sees the ball.
pub(super) struct Observer {
    pub(super) at: [f64; 2],
    pub(super) errors: LastingErrors,
    /// True over measured distance, by the size.
    pub(super) size_scale: f32,
}

impl Observer {
    /// The ray as this robot believes it: in the field frame by its erroneous pose, or by its true one.
    pub(super) fn ray(
        &self,
        ball: [f64; 3],
        stamp: Stamp,
        trial: &AirExperiment,
        with_pose_error: bool,
        rng: &mut impl Rng,
    ) -> BallRay {
        let offset = [ball[0] - self.at[0], ball[1] - self.at[1], ball[2] - HEIGHT];
        let level = math::hypot(offset[0], offset[1]);
        let azimuth = math::atan2(offset[1], offset[0]) as f32;
        let elevation = math::atan2(offset[2], level) as f32;
        let std = trial.ray_std_deg.to_radians();
        let [tilt_x, tilt_y, x, y, heading, _] = self.errors.0;
        let tilt = TILT_STD_DEG.to_radians();
        let (sin, cos) = math::sin_cos(azimuth);
        // A tilt raises the view on one side and turns it sideways in proportion to the elevation.
        let raised = tilt * (tilt_x * cos + tilt_y * sin);
        let aside = tilt * (tilt_y * cos - tilt_x * sin) * math::tan(elevation);
        let (mut azimuth, mut elevation) = (
            azimuth + aside + std * standard_normal(rng),
            elevation + raised + std * standard_normal(rng),
        );
        if rng.random::<f32>() < trial.outlier_share {
            azimuth += 2.0 * rng.random::<f32>() - 1.0;
            elevation -= 0.5 * rng.random::<f32>();
        }
        let wrong = if with_pose_error { 1.0 } else { 0.0 };
        BallRay {
            stamp,
            origin: [
                self.at[0] as f32 + wrong * POSITION_STD * x,
                self.at[1] as f32 + wrong * POSITION_STD * y,
                HEIGHT as f32,
            ],
            azimuth: azimuth + wrong * HEADING_STD * heading,
            elevation,
            azimuth_std: std,
            elevation_std: std,
            distance: trial.sized.then(|| {
                let distance = math::hypot(level, offset[2]) as f32;
                let measured = distance * self.size_scale * (1.0 + SIZE_STD * standard_normal(rng));
                [measured.max(0.2), 0.1 * measured.max(0.2)]
            }),
        }
    }
}
