//! How does a camera take its images? Exposure, gain and white balance, each fixed or automatic.

use localize::robot::ExposureSetting;

use crate::config::CameraDeviceConfig;

/// Settings of a camera; a value that is `None` is automatic.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct CameraSettings {
    /// Exposure, seconds.
    pub exposure: Option<f32>,
    /// Gain, unit of the driver.
    pub gain: Option<f32>,
    /// White balance, kelvin.
    pub white_balance_k: Option<i32>,
}

impl CameraSettings {
    pub(super) fn from_config(device: &CameraDeviceConfig) -> Self {
        CameraSettings {
            exposure: device.exposure,
            gain: device.gain.map(|gain| gain as f32),
            white_balance_k: device.white_balance_k,
        }
    }

    /// The same settings with another exposure and gain.
    pub(super) fn with_exposure(self, setting: ExposureSetting) -> Self {
        CameraSettings {
            exposure: Some(setting.exposure),
            gain: Some(setting.gain),
            ..self
        }
    }
}
