//! Automatic exposure: maximises the image's entropy along one path of exposure and gain.
//!
//! nubot2013 section 5: the entropy of an image (eq. 5) has one peak along exposure = a·gain + b. The brightness of the
//! image's centre, where the robot sees itself, triggers the search and gives its direction. There each setting is
//! tried on a new image, so the robot must stand still. Here the entropy at other settings is predicted from the
//! histogram of one image, so the robot may move and a search takes one or two commands.

use localize::robot::ExposureSetting;
use serde::{Deserialize, Serialize};

mod auto_exposure;
mod histogram;
mod optimum;
mod search;

pub use auto_exposure::{AutoExposure, ExposureState};

/// A command to the camera.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ExposureCommand {
    /// Exposure and gain to set.
    pub setting: ExposureSetting,
    /// First image taken with it; images are counted from 0 in the order of processing.
    pub from_frame: u64,
}

/// Exposure of one image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ExposureStatus {
    /// Entropy of red, green and blue together (nubot2013 eq. 5), bits: at most 24.
    pub entropy: f32,
    /// Brightness of the image's centre, own body and nearest carpet, of 255.
    pub centre_brightness: f32,
    /// Setting this image was taken with. None if the camera has no control.
    pub applied_setting: Option<ExposureSetting>,
    /// True during a search.
    pub searching: bool,
    /// Command to send now.
    pub command: Option<ExposureCommand>,
    /// True if a new setting first applies to this image and changes the brightness so much that colours must be relearned.
    pub setting_changed_brightness: bool,
    /// True once: the light changed, but the camera has no control to compensate.
    pub uncontrolled_light_change: bool,
}

#[cfg(test)]
mod tests;
