//! A field in motion, and every sensor of the robot: what a real robot would sense, with the truth beside it.
//!
//! The mirror is traced as the scenario mounts it; vision measures with the map that it believes in.

mod ball;
pub mod base;
mod behaviour;
#[cfg(any(test, feature = "fusion_experiment"))]
pub mod fusion_experiment;
pub mod image_sensor;
pub mod light;
mod path_follower;
pub mod render;
pub mod scenario;
mod sensors;
pub mod simulation;
pub mod world;

pub use scenario::Scenario;
pub use simulation::{Sim, SimError, SimImage, SimSample, SimTruth};
