//! How does the world model receive detections? As observations in the types of localize.

use localize::world::{ObjectObservation, WorldObservation};
use vision::process::Detections;

/// Ball and robots of an image as observations.
pub fn object_observations(detections: &Detections) -> WorldObservation {
    let ball = detections.ball.map(|ball| ObjectObservation {
        at: ball.at,
        covariance: ball.covariance,
        score: ball.score,
        airborne: !ball.on_ground,
        team: None,
    });
    let robots = detections.robots.iter().map(|robot| ObjectObservation {
        at: robot.at,
        covariance: robot.covariance,
        score: robot.score,
        airborne: false,
        team: robot.marker,
    });
    WorldObservation {
        ball,
        robots: robots.collect(),
    }
}
