//! What does vision's sight say to the world model? The same objects in localize's words.

use localize::world::{Sight, Sighting, Team};
use vision::eyes::Seen;
use vision::robots::Marker;

/// The objects of a sight.
pub fn sight(seen: &Seen) -> Sight {
    let ball = seen.ball.map(|ball| Sighting {
        at: ball.at,
        covariance: ball.covariance,
        score: ball.score,
        flying: !ball.on_ground,
        team: None,
    });
    let robots = seen.robots.iter().map(|robot| Sighting {
        at: robot.at,
        covariance: robot.covariance,
        score: robot.score,
        flying: false,
        team: robot.marker.map(|marker| match marker {
            Marker::Cyan => Team::Cyan,
            Marker::Magenta => Team::Magenta,
        }),
    });
    Sight {
        ball,
        robots: robots.collect(),
    }
}
