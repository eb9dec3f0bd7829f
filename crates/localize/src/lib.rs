//! Where things are: from features and motion to a pose on the field.
//!
//! The vocabulary that every other crate speaks (stamps, frames, the field, samples) lives here, because where
//! things are is its language. No I/O, clock, thread or randomness of its own: stamps and generators are arguments.

pub mod attitude;
mod candidates;
pub mod collision;
pub mod compass;
pub mod config;
pub mod distance;
pub mod drive;
pub mod estimate;
pub mod exactly;
pub mod experiment;
pub mod field;
pub mod filter;
pub mod frame;
mod goals;
pub mod heading;
pub mod localizer;
pub mod matching;
pub mod omni;
pub mod presets;
pub mod relocalise;
pub mod robot;
pub mod sample;
pub mod search;
pub mod stamp;
pub mod team;
pub mod toml_place;
pub mod world;

pub use config::LocalizeConfig;
pub use distance::DistanceField;
pub use estimate::{Estimate, Mode, Reason};
pub use field::Field;
pub use frame::{At, FieldFrame, Pose, RobotFrame, Tf};
pub use localizer::Localizer;
pub use stamp::Stamp;
