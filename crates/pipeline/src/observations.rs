//! What does vision's sight say to the world model? The same objects in localize's words.

use localize::world::{ObjectObservation, WorldObservation};
use vision::process::Detections;

/// The objects of a sight.
pub fn object_observations(seen: &Detections) -> WorldObservation {
    let ball = seen.ball.map(|ball| ObjectObservation {
        at: ball.at,
        covariance: ball.covariance,
        score: ball.score,
        airborne: !ball.on_ground,
        team: None,
    });
    let robots = seen.robots.iter().map(|robot| ObjectObservation {
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
