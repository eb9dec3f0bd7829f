//! Where is the robot? From line points, wheels, an IMU and a compass to a pose on the field.
//!
//! The vocabulary that every other crate speaks (stamps, coordinate frames, samples, the robot's description, the field)
//! lives here. Modules in the order in which data meets them.

pub mod fixed_array;
pub mod frames;
pub mod random;
pub mod robot;
pub mod sample;
pub mod stamp;
pub mod tilt;
pub mod toml_location;

pub mod field;

pub mod omni;
pub mod sensors;

pub mod matching;

pub mod global_search;

pub mod filter;

pub mod estimate;
pub mod localizer;

pub mod team;
pub mod world;

pub mod config;
pub mod presets;

#[cfg(any(test, feature = "synthetic"))]
pub mod synthetic;

pub use config::LocalizeConfig;
pub use estimate::{Estimate, Mode, Reason};
pub use field::Field;
pub use frames::{At, FieldFrame, Pose, RobotFrame, Tf};
pub use localizer::Localizer;
pub use matching::distance_field::DistanceField;
pub use stamp::Stamp;
