//! Which camera takes the images? Its settings, its optics and its sensor.

use serde::{Deserialize, Serialize};

/// `[film]` of a scenario: the camera's settings, its optics and its sensor. The defaults resemble photographs of
/// league robots: soft lines, noise that demosaicing correlates, a slight colour cast.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ImageSensorConfig {
    /// Exposure time, relative to the one that suits light of level 1.
    pub exposure: f32,
    /// Gain, which amplifies signal and noise.
    pub gain: f32,
    /// Gains of red, green and blue, 0.01 to 100. Unequal gains are a colour cast.
    #[serde(deserialize_with = "localize::fixed_array::deserialize")]
    pub white_balance: [f32; 3],
    /// Relative loss of light in the image's corners.
    pub vignetting: f32,
    /// Electrons of a white pixel at exposure 1 and gain 1; fewer mean more shot noise.
    pub full_well: f32,
    /// Read noise of a pixel, electrons (one sigma).
    pub read_noise: f32,
    /// Width of the optics' blur, pixels, above 0 to 20.
    pub blur_px: f32,
    /// Defocus: additional width of the blur in the image's centre, pixels, 0 to 20. It decreases towards the rim, since
    /// the focus suits distant ground.
    pub defocus_px: f32,
    /// Veiling glare of a constant level, relative to white.
    pub haze: f32,
    /// Share of the light that mirror and lens scatter over the whole image (veiling glare of bright parts), 0 to 0.9.
    pub glare: f32,
    /// Share of the light in a halo around each point (bloom), 0 to 0.9; glare and bloom below 0.95 together.
    pub bloom: f32,
    /// Distance at which the halo has decayed to 1/e, pixels, 0.5 to 100.
    pub bloom_radius_px: f32,
    /// Exposure time at exposure 1, seconds, 0 to 1. The image smears while the robot moves; 0 is no motion blur.
    pub shutter: f32,
    /// Rolling shutter: time between the exposures of the first and the last row, seconds, 0 to 1; 0 is a global shutter.
    /// The image's stamp is the middle row's. Objects are drawn where they are in the middle.
    pub rolling_shutter: f32,
    /// True if each pixel measures one colour behind a Bayer mosaic, and the others are interpolated.
    pub bayer: bool,
    /// Quality of JPEG compression with halved colour resolution, 1 to 100; 0 is no compression.
    pub jpeg_quality: u8,
}

impl Default for ImageSensorConfig {
    fn default() -> Self {
        ImageSensorConfig {
            exposure: 1.0,
            gain: 1.0,
            white_balance: [0.75, 1.0, 0.88],
            vignetting: 0.45,
            full_well: 6000.0,
            read_noise: 15.0,
            blur_px: 2.6,
            defocus_px: 2.0,
            haze: 0.004,
            glare: 0.06,
            bloom: 0.12,
            bloom_radius_px: 6.0,
            shutter: 0.008,
            rolling_shutter: 0.0,
            bayer: true,
            jpeg_quality: 0,
        }
    }
}

impl ImageSensorConfig {
    /// Settings of an ideal camera: sharp, without noise, scattering, vignetting, mosaic and motion blur. For tests.
    pub fn ideal() -> Self {
        ImageSensorConfig {
            white_balance: [1.0; 3],
            vignetting: 0.0,
            full_well: 1e9,
            read_noise: 0.0,
            blur_px: 1.0,
            defocus_px: 0.0,
            haze: 0.0,
            glare: 0.0,
            bloom: 0.0,
            shutter: 0.0,
            bayer: false,
            ..ImageSensorConfig::default()
        }
    }

    /// Width of the blur at a share of the way from the image's centre to its rim, pixels.
    pub(crate) fn blur_at(&self, radius_share: f32) -> f32 {
        self.blur_px
            .hypot(self.defocus_px * (1.0 - radius_share).max(0.0))
    }

    pub(crate) fn check(&self) -> Result<(), (String, String)> {
        let refuse = |key: &str, value: f32, expected: &str| {
            Err((
                key.to_owned(),
                format!("invalid value: {value} (expected {expected})"),
            ))
        };
        for (key, value, [least, most]) in [
            ("exposure", self.exposure, [1e-6, 1e4]),
            ("gain", self.gain, [1e-3, 1e4]),
            ("full_well", self.full_well, [1.0, 1e9]),
        ] {
            if !(least..=most).contains(&value) {
                return refuse(key, value, &format!("{least} to {most}"));
            }
        }
        if !(self.blur_px > 0.0 && self.blur_px <= 20.0) {
            return refuse("blur_px", self.blur_px, "a number above 0 to 20");
        }
        for (key, value, [least, most]) in [
            ("read_noise", self.read_noise, [0.0, 1e6]),
            ("haze", self.haze, [0.0, 1e3]),
            ("vignetting", self.vignetting, [0.0, 0.999]),
            ("defocus_px", self.defocus_px, [0.0, 20.0]),
            ("glare", self.glare, [0.0, 0.9]),
            ("bloom", self.bloom, [0.0, 0.9]),
            ("bloom", self.bloom + self.glare, [0.0, 0.95]),
            ("bloom_radius_px", self.bloom_radius_px, [0.5, 100.0]),
            ("shutter", self.shutter, [0.0, 1.0]),
            ("rolling_shutter", self.rolling_shutter, [0.0, 1.0]),
            ("jpeg_quality", self.jpeg_quality.into(), [0.0, 100.0]),
        ] {
            if !(least <= value && value <= most) {
                return refuse(key, value, &format!("{least} to {most}"));
            }
        }
        for gain in self.white_balance {
            if !(0.01..=100.0).contains(&gain) {
                return refuse("white_balance", gain, "three numbers from 0.01 to 100");
            }
        }
        Ok(())
    }
}
