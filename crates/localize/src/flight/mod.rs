//! Is the ball in the air, where is it, and where does it land? From the rays on which mirrors see its centre.
//!
//! A ray alone has no depth. Over several images gravity gives it: the path of a ball in flight is bent by a known
//! acceleration. Several robots see it from several places (docs/methods.md 17).

mod config;
mod flight_tracker;
mod landing;
mod motion;
mod path_filter;
mod path_tracker;
mod ray;
mod ray_rows;
#[cfg(test)]
mod tests;
mod triangulation;

pub use config::FlightConfig;
pub use flight_tracker::{FlightTracker, TrackedFlight};
pub use landing::{Landing, predict_landing};
pub use motion::{BallMotionMode, BallMotionState};
pub use ray::{BallRay, RobotRay, ray_from_ground_point};
pub use triangulation::{TeamFlightTracker, TriangulatedBall};
