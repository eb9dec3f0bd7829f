//! The range of the camera's exposure and gain: `[exposure]` of robot.toml.

use serde::{Deserialize, Serialize};

use crate::math;

/// A camera's exposure and gain, in the camera's units.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ExposureSetting {
    /// Exposure time.
    pub exposure: f32,
    /// Gain.
    pub gain: f32,
}

/// `[exposure]` of robot.toml: the camera's settings. Without it, exposure is monitored but not controlled.
///
/// Exposure and gain are in the camera's units: for exposure, seconds with the drivers and multiples of the default
/// with the simulator.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraControl {
    /// Initial exposure.
    pub exposure: f32,
    /// Initial gain.
    pub gain: f32,
    /// Shortest exposure.
    pub exposure_min: f32,
    /// Longest exposure. A longer one blurs more: at 360°/s, 10 ms blur the image by 3.6°.
    pub exposure_max: f32,
    /// Smallest gain.
    pub gain_min: f32,
    /// Largest gain. More gain only adds noise.
    pub gain_max: f32,
    /// a of exposure = a·gain + b, the path of settings. A larger a gives less noise and more motion blur. Beyond the
    /// limits of one setting, only the other changes.
    pub path_slope: f32,
    /// b of exposure = a·gain + b.
    #[serde(default)]
    pub path_offset: f32,
    /// Decibels per unit of gain. 0 means that gain is a factor.
    #[serde(default)]
    pub gain_db_per_unit: f32,
    /// Number of images from a command to the first image exposed with it. With 2, a command after image k applies to
    /// image k + 2.
    #[serde(default = "usual_delay")]
    pub delay_frames: u64,
}

/// While a command arrives, one image is being exposed and one is being read out.
fn usual_delay() -> u64 {
    2
}

impl CameraControl {
    /// The first key with an invalid value, and the reason.
    pub fn check(&self) -> Result<(), (&'static str, String)> {
        let numbers = [
            ("exposure.exposure_min", self.exposure_min),
            ("exposure.exposure_max", self.exposure_max),
            ("exposure.path_slope", self.path_slope),
            ("exposure.exposure", self.exposure),
        ];
        for (key, value) in numbers {
            if !(value.is_finite() && value > 0.0) {
                return Err((key, format!("{value} must be a positive number")));
            }
        }
        let gain_floor = if self.gain_db_per_unit > 0.0 {
            f32::NEG_INFINITY
        } else {
            f32::MIN_POSITIVE
        };
        let finite = |value: f32| value.is_finite();
        if !([self.gain, self.gain_max, self.path_offset].map(finite) == [true; 3]
            && self.gain_min.is_finite()
            && self.gain_min >= gain_floor)
        {
            let reason = "gains are numbers; those that are factors are positive";
            return Err(("exposure.gain_min", reason.to_owned()));
        }
        if !(self.gain_db_per_unit.is_finite() && self.gain_db_per_unit >= 0.0) {
            let reason = "must be 0 (gain is a factor) or decibels per unit".to_owned();
            return Err(("exposure.gain_db_per_unit", reason));
        }
        if self.exposure_min > self.exposure_max || self.gain_min > self.gain_max {
            let reason = "the least of a setting must not be above its most".to_owned();
            return Err(("exposure.exposure_min, exposure.gain_min", reason));
        }
        if self.delay_frames > 30 {
            let reason = format!("{} frames: at most 30", self.delay_frames);
            return Err(("exposure.delay_frames", reason));
        }
        Ok(())
    }

    /// Brightness of a setting: exposure times the gain's factor.
    pub fn light(&self, setting: ExposureSetting) -> f32 {
        setting.exposure * self.gain_factor(setting.gain)
    }

    /// Factor of brightness of a gain.
    pub fn gain_factor(&self, gain: f32) -> f32 {
        if self.gain_db_per_unit > 0.0 {
            math::powf(10f32, gain * self.gain_db_per_unit / 20.0)
        } else {
            gain
        }
    }

    /// The setting at a position of the path, which equals the gain within the limits.
    pub fn on_path(&self, position: f32) -> ExposureSetting {
        ExposureSetting {
            exposure: (self.path_slope * position + self.path_offset)
                .clamp(self.exposure_min, self.exposure_max),
            gain: position.clamp(self.gain_min, self.gain_max),
        }
    }

    /// The setting on the path with brightness `light`, or the nearest one within the limits.
    pub fn setting(&self, light: f32) -> ExposureSetting {
        let at_exposure = |exposure: f32| (exposure - self.path_offset) / self.path_slope;
        let mut low = self.gain_min.min(at_exposure(self.exposure_min));
        let mut high = self.gain_max.max(at_exposure(self.exposure_max));
        // Brightness increases along the path. Bisecting 40 times reaches the resolution of f32.
        for _ in 0..40 {
            let middle = 0.5 * (low + high);
            if self.light(self.on_path(middle)) < light {
                low = middle;
            } else {
                high = middle;
            }
        }
        self.on_path(0.5 * (low + high))
    }
}
