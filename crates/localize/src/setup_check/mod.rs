//! Does a set-up explain its measurements? Compares fields, camera mounts and sensor units on the same keyframes.
//!
//! For each keyframe the poses that explain its line points are searched on the whole field (`keyframe`,
//! `explanation`). Wheels and compass then select one pose per keyframe: the cheapest chain through all of them
//! (`chain`), with those to which the wheels lead (`led_by_wheels`). Its cost is a negative log likelihood, so that two set-ups can be compared (`comparison`,
//! docs/methods.md 16).

mod chain;
mod comparison;
mod explanation;
mod keyframe;
mod led_by_wheels;
mod tables;
#[cfg(test)]
mod tests;

pub use crate::twist::METRES_PER_RADIAN;
pub use comparison::{Comparison, compare};
pub use explanation::{Explanation, KeyframeFit, explain, refine};
pub use keyframe::{Keyframe, WheelMotion};
pub use tables::FieldTables;
