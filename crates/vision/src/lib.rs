//! Detects line points, ball, robots and goals in an image of a catadioptric camera; results in the robot frame.
//!
//! Modules are listed in the order in which data passes them.

#![cfg_attr(
    test,
    expect(
        clippy::disallowed_methods,
        reason = "tests may use the platform's elementary functions"
    )
)]

pub mod config;
pub mod csv_error;
pub mod error;
pub mod image;
pub mod output_file;

pub mod optics;

pub mod image_check;

pub mod scan;

pub mod colour;

pub mod lines;

pub mod objects;

pub mod process;

pub mod exposure;

pub mod calibrate;

pub mod overlay;

pub use colour::colour_table::ColourTable;
pub use config::VisionConfig;
pub use error::VisionError;
pub use image::{CommonOrientation, Image, ImageView, Orientation, PixelFormat};
pub use optics::ground_map::GroundMap;
pub use optics::mirror::Profile;
pub use optics::ray_tracing::{Mount, Ray, RayTable};
pub use process::{Detections, Vision};
