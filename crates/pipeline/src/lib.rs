//! One cycle of the robot: stamped samples in, vision and localization in order, a `Cycle` out, to whoever subscribed.
//!
//! Modules in the order in which data meets them: configuration, sources of samples, the pipeline itself, its outputs.

pub mod csv_table;
pub mod paths;
pub mod sample;
pub mod setup;

pub mod recording;
pub mod simulation;

pub mod cycle;
pub mod observations;

pub mod feed;
pub mod log;

pub mod datagram;
pub mod multi_robot;

pub mod result_files;
pub mod score;

pub mod run;

#[cfg(any(test, feature = "testing"))]
pub mod testing;
