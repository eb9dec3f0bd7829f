//! Is the ball in the air, where is it, and where does it land? From the rays on which mirrors see its centre.
//!
//! A ray alone has no depth. Over several images gravity gives it: the path of a ball in flight is bent by a known
//! acceleration. Several robots see it from several places (docs/methods.md 17).

mod config;
mod landing;
mod motion_fit;
mod ray;
mod segments;
#[cfg(test)]
mod tests;
mod triangulation;

pub use config::FlightConfig;
pub use landing::{Landing, predict_landing};
pub use motion_fit::{BallMotionMode, BallMotionState};
pub use ray::{BallRay, ray_from_ground_point};
pub use segments::{FlightTracker, TrackedFlight};
pub use triangulation::{RobotRay, TriangulatedBall, triangulate};
