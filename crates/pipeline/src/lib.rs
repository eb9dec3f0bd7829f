//! The pipeline of a robot: stamped samples in, vision and localization in order, one [`Cycle`] per image out.
//!
//! Modules in the order in which data meets them: configuration, sources of samples, the pipeline itself, its outputs.

pub mod config;
mod presets;

pub mod csv_table;
pub mod partial_folder;
pub mod paths;
mod pose_error;
pub mod sample;
pub mod scan_map_cache;
pub mod setup;

pub mod recording;
pub mod simulation;

pub mod corrected_map;
pub mod cycle;
pub mod doubted_poses;
mod features;
mod interlace;
pub mod observations;
pub mod pipeline;
mod table_input;
mod warm_start;

pub mod feed;
pub mod findings;
pub mod image_faults;
pub mod log;
mod misplaced_images;
mod pose_leaps;

pub mod datagram;
pub mod multi_robot;

pub mod setup_check;

pub mod message_text;
mod repeated_points;
pub mod result_files;
pub mod score;

pub mod run;

// Not behind a feature: a build and its tests share one pipeline and one app.
pub mod testing;

pub use config::PipelineConfig;
pub use cycle::{Cycle, Inputs, Timings};
pub use pipeline::Pipeline;
pub use warm_start::WarmStart;
