//! Localization: from line points, wheel odometry, an IMU and a compass to a pose on the field.
//!
//! This crate also defines the types that all other crates share: stamps, coordinate frames, samples, the robot's
//! description, the field. Modules are listed in the order in which data meets them.
//!
//! No module reads a clock. Stamps are arguments. The only file access is in the `load` functions of configuration
//! files ([`Field::load`], [`robot::RobotConfig::load`]). The only random generator of the product is the particle
//! filter's ([`global_search::monte_carlo`]), part of its state and seeded by its configuration.
//!
//! Tables of a field (distance field, scan map, score tables) are built in parallel on rayon's global thread pool. Each
//! entry is computed independently, so that results do not depend on the number of threads. No other threads are used.
//!
//! The feature `synthetic` adds generated drives and the experiments on them, for evaluation, benches and tests.

#![cfg_attr(
    test,
    expect(
        clippy::disallowed_methods,
        reason = "tests may use the platform's elementary functions"
    )
)]

pub mod fixed_array;
pub mod frames;
pub mod input_file;
pub mod math;
pub mod random;
pub mod robot;
pub mod sample;
pub mod stamp;
pub mod tilt;
pub mod toml_file;
pub mod toml_location;
mod twist;

pub mod field;

pub mod omni;
pub mod sensors;

pub mod matching;

pub mod global_search;

pub mod advice;
pub mod field_mapping;
pub mod filter;

pub mod map_correction;

pub mod estimate;
pub mod localizer;

pub mod setup_check;

pub mod flight;
pub mod team;
pub mod wheel_steps;
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
