//! Simulation of a game and of every sensor of the robot, together with the true state.
//!
//! The simulator traces rays through the mirror as the scenario mounts it; vision uses the map of its own configuration.

mod ball;
mod ball_flight;
pub mod base;
mod behaviour;
pub mod environment;
#[cfg(any(test, feature = "fusion_experiment"))]
pub mod fusion_experiment;
pub mod image_sensor;
pub mod light;
mod path_follower;
pub mod people;
pub mod render;
pub mod rocking;
pub mod scenario;
pub mod sector;
mod sensors;
pub mod simulation;
pub mod world;

pub use scenario::Scenario;
pub use sector::Sector;
pub use simulation::{SimError, SimImage, SimSample, SimTruth, Simulator};
