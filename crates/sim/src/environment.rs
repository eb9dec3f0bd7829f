//! What do the surroundings look like around and on the carpet?

use serde::{Deserialize, Serialize};

/// `[hall]` of a scenario: floor, windows, and cables on the carpet.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EnvironmentConfig {
    /// Colour of the floor around the carpet, sRGB 0 to 255. The default is wood.
    #[serde(deserialize_with = "localize::fixed_array::deserialize")]
    pub floor_rgb: [u8; 3],
    /// Largest relative deviation of a plank's brightness from the mean, 0 to 0.9.
    pub plank_contrast: f32,
    /// Number of black cables on the carpet, 0 to 20, at random places.
    pub cables: usize,
    /// Width of a cable, metres, 0.002 to 0.2.
    pub cable_width: f32,
    /// Number of windows in the walls, 0 to 40.
    pub windows: usize,
    /// Light of a window, relative to a white wall, 0 to 15.
    pub window_light: f32,
}

impl Default for EnvironmentConfig {
    fn default() -> Self {
        EnvironmentConfig {
            floor_rgb: [150, 112, 82],
            plank_contrast: 0.12,
            cables: 1,
            cable_width: 0.02,
            windows: 4,
            window_light: 3.0,
        }
    }
}

impl EnvironmentConfig {
    pub(crate) fn check(&self) -> Result<(), (String, String)> {
        for (key, value, [least, most]) in [
            ("plank_contrast", self.plank_contrast, [0.0, 0.9]),
            ("cables", self.cables as f32, [0.0, 20.0]),
            ("cable_width", self.cable_width, [0.002, 0.2]),
            ("windows", self.windows as f32, [0.0, 40.0]),
            ("window_light", self.window_light, [0.0, 15.0]),
        ] {
            if !(least <= value && value <= most) {
                return Err((
                    key.to_owned(),
                    format!("invalid value: {value} (expected {least} to {most})"),
                ));
            }
        }
        Ok(())
    }
}
