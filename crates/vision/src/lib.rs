//! From an image to features: what a picture under the mirror tells about the ground around the robot.

pub mod config;
pub mod error;
pub mod mirror;

pub mod camera_from_map;
pub mod ground_map;
pub mod optics;

pub mod image;

pub mod scan;

pub mod carpet;
mod classify;
pub mod colours;
pub mod labels;

mod reach;
mod read;

mod columns;
mod foot;
mod rays;

mod judge;
pub mod line_points;
mod runs;
mod transitions;

pub mod ball;
pub mod goals;
pub mod robots;

pub mod windows;

mod adapt;

pub mod eyes;

pub mod exposure;

pub mod calibrate;

pub mod overlay;

pub use config::VisionConfig;
pub use error::VisionError;
pub use eyes::{Detections, Vision};
pub use ground_map::GroundMap;
pub use image::{Image, ImageView, PixelFormat};
pub use labels::ColourTable;
pub use mirror::Profile;
pub use optics::{Mount, Ray, RayTable};
