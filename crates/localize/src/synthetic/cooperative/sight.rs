//! How does a robot see others? With errors of its mirror, its tilt and its pixels, and not behind others.

use rand::{Rng, RngExt};

use crate::frames::{At, FieldFrame, Pose};
use crate::math;
use crate::random::standard_normal;
use crate::world::{ObjectObservation, WorldObservation};

/// Height of the mirrors, metres.
pub(super) const HEIGHT: f32 = 0.75;
/// Images per second.
pub(super) const RATE: f32 = 30.0;
/// Range at which robots are detected, metres.
const RANGE_MAX: f32 = 6.0;
/// Independent error of a detection, radial and tangential, as a share of its range. Stated as such.
const WHITE_SHARE: [f32; 2] = [0.01, 0.005];
/// Error of a mirror's scale, and of its bearing in radians: constant, and not stated.
const MIRROR_STD: [f32; 2] = [0.01, 0.004];
/// Deviation of the seen side of a robot from its centre, metres: constant for a pair, and not stated.
const BODY_STD: f32 = 0.025;
/// Tilt, degrees per axis.
const TILT_STD_DEG: f32 = 0.15;
/// Time for which a tilt lasts, seconds.
const TILT_TIME: f32 = 0.6;
/// Share of missed robots.
const MISSED_SHARE: f32 = 0.1;
/// Radius in which a robot hides others, metres.
const BODY_RADIUS: f32 = 0.25;

/// A stationary error with a standard deviation of 1: half of its variance is constant, half changes over time.
#[derive(Debug, Clone)]
pub(super) struct LastingError {
    constant: f32,
    changing: f32,
}

impl LastingError {
    pub(super) fn new(rng: &mut impl Rng) -> Self {
        LastingError {
            constant: standard_normal(rng),
            changing: standard_normal(rng),
        }
    }

    /// Its value after an image. `seconds`: for which the changing half lasts.
    pub(super) fn step(&mut self, seconds: f32, rng: &mut impl Rng) -> f32 {
        let kept = math::exp(-1.0 / (RATE * seconds));
        self.changing = kept * self.changing + (1.0 - kept * kept).sqrt() * standard_normal(rng);
        (self.constant + self.changing) * std::f32::consts::FRAC_1_SQRT_2
    }
}

/// The mirror of one robot.
#[derive(Debug, Clone)]
pub(super) struct Mirror {
    scale: f32,
    bearing: f32,
    tilt: [LastingError; 2],
    /// Of each other robot.
    bodies: Vec<[f32; 2]>,
}

impl Mirror {
    pub(super) fn new(others: usize, rng: &mut impl Rng) -> Self {
        let mut normal = |std: f32| std * standard_normal(rng);
        Mirror {
            scale: 1.0 + normal(MIRROR_STD[0]),
            bearing: normal(MIRROR_STD[1]),
            bodies: (0..others)
                .map(|_| [normal(BODY_STD), normal(BODY_STD)])
                .collect(),
            tilt: [LastingError::new(rng), LastingError::new(rng)],
        }
    }

    /// The robots seen from `pose`. `others`: all other robots, always in the same order.
    pub(super) fn see(
        &mut self,
        pose: Pose,
        others: &[At<FieldFrame>],
        rng: &mut impl Rng,
    ) -> WorldObservation {
        let std = TILT_STD_DEG.to_radians();
        let tilt = self
            .tilt
            .each_mut()
            .map(|tilt| std * tilt.step(TILT_TIME, rng));
        let relative: Vec<_> = others.iter().map(|&at| pose.inverse() * at).collect();
        let mut robots = Vec::new();
        for (k, at) in relative.iter().enumerate() {
            let range = at.distance();
            let hidden = relative.iter().any(|nearer| {
                let across = (nearer.x * at.y - nearer.y * at.x).abs() / range;
                let along = (nearer.x * at.x + nearer.y * at.y) / range;
                along > 0.0 && along < range - 0.05 && across < BODY_RADIUS
            });
            if hidden || range > RANGE_MAX || rng.random::<f32>() < MISSED_SHARE {
                continue;
            }
            let [body_x, body_y] = self.bodies[k];
            let bearing = math::atan2(at.y + body_y, at.x + body_x);
            let (sin, cos) = math::sin_cos(bearing);
            let tilted = (tilt[0] * cos + tilt[1] * sin) * range * range / HEIGHT;
            let [radial, tangential] = WHITE_SHARE.map(|share| share * range);
            let seen_range = self.scale * range + tilted + radial * standard_normal(rng);
            let across = tangential * standard_normal(rng);
            let (sin, cos) = math::sin_cos(bearing + self.bearing + across / range);
            let (r, t) = (radial * radial, tangential * tangential);
            robots.push(ObjectObservation {
                at: At::new(seen_range * cos, seen_range * sin),
                covariance: [
                    r * cos * cos + t * sin * sin,
                    (r - t) * cos * sin,
                    r * sin * sin + t * cos * cos,
                ],
                score: 0.8,
                airborne: false,
                team: None,
                distance: None,
            });
        }
        WorldObservation { ball: None, robots }
    }
}
