//! How does the world model receive detections? As observations of the types that localize defines.

use localize::world::{ObjectObservation, WorldObservation};
use vision::process::Detections;

/// Converts the detected ball and robots of an image to observations.
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
