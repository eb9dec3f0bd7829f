//! From a camera image to features: line points, ball, robots and goals in the robot's frame.
//!
//! Modules in the order in which data meets them.

pub mod config;
pub mod error;
pub mod image;

pub mod optics;

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
pub use image::{Image, ImageView, PixelFormat};
pub use optics::ground_map::GroundMap;
pub use optics::mirror::Profile;
pub use optics::ray_tracing::{Mount, Ray, RayTable};
pub use process::{Detections, Vision};
