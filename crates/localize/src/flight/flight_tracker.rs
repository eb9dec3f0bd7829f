//! Is the ball that one robot sees in the air? Its rays in a frame that is fixed to the ground, image by image.

use super::config::FlightConfig;
use super::motion::{BallMotionMode, BallMotionState};
use super::path_tracker::PathTracker;
use super::ray::{BallRay, RobotRay};

/// The ball's state by the probabilities of all paths.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrackedFlight {
    /// Probability that the ball is in the air.
    pub airborne_probability: f32,
    /// Mean state of the paths through the air, at the last ray's time: a ball that flies or that a hand holds.
    pub in_air: Option<BallMotionState>,
    /// Mean state of those on which it flies, if that is more probable than that a hand holds it.
    pub flight: Option<BallMotionState>,
    /// Mean state of the paths on the ground, at the last ray's time.
    pub ground: Option<BallMotionState>,
}

/// Share of the balls in the air that a hand holds.
const HELD_SHARE: f64 = 0.05;

/// Follows one ball from image to image, in a frame that is fixed to the ground.
#[derive(Debug, Clone)]
pub struct FlightTracker {
    config: FlightConfig,
    paths: PathTracker,
}

impl FlightTracker {
    /// A tracker that has seen nothing.
    pub fn new(config: FlightConfig) -> Self {
        let airborne = f64::from(config.airborne_probability);
        FlightTracker {
            paths: PathTracker::new(&[
                (BallMotionMode::Ground, 1.0 - airborne),
                (BallMotionMode::Flight, airborne * (1.0 - HELD_SHARE)),
                (BallMotionMode::Held, airborne * HELD_SHARE),
            ]),
            config,
        }
    }

    /// Forgets everything: the frame has changed.
    pub fn reset(&mut self) {
        self.paths.reset();
    }

    /// Adds the ray of an image; None if it is not finite. Rays out of order are ignored.
    pub fn update(&mut self, ray: &BallRay) -> Option<TrackedFlight> {
        if !ray.is_valid() {
            return None;
        }
        if let Some(last) = self.paths.stamp() {
            let gap = last.seconds_until(ray.stamp) as f32;
            if gap <= 0.0 && gap > -self.config.gap_max {
                return None;
            }
            if gap.abs() > self.config.gap_max {
                self.reset();
            }
        }
        let ray = RobotRay {
            robot: 0,
            ray: *ray,
            pose_std: [0.0; 2],
        };
        self.paths.update(&ray, 0, &self.config);
        let [flies, held] =
            [BallMotionMode::Flight, BallMotionMode::Held].map(|mode| self.paths.probability(mode));
        Some(TrackedFlight {
            airborne_probability: (flies + held) as f32,
            in_air: (self.paths).state(&[BallMotionMode::Flight, BallMotionMode::Held]),
            flight: (self.paths.state(&[BallMotionMode::Flight])).filter(|_| flies > held),
            ground: self.paths.state(&[BallMotionMode::Ground]),
        })
    }
}
