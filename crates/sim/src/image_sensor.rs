//! How does the image sensor convert light to bytes? Exposure, gain, white balance, vignetting, shot and read noise.

use localize::random::standard_normal;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

/// `[film]` of a scenario: the camera's settings and its sensor.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FilmConfig {
    /// Exposure time, relative to the one that suits light of level 1.
    pub exposure: f32,
    /// Gain, which amplifies signal and noise.
    pub gain: f32,
    /// Gains of red, green and blue.
    #[serde(deserialize_with = "localize::fixed_array::deserialize")]
    pub white_balance: [f32; 3],
    /// Relative loss of light in the image's corners.
    pub vignetting: f32,
    /// Electrons of a white pixel at exposure 1 and gain 1; fewer mean more shot noise.
    pub full_well: f32,
    /// Read noise of a pixel, electrons (one sigma).
    pub read_noise: f32,
    /// Width of the optics' blur, pixels.
    pub blur_px: f32,
    /// Veiling glare: light scattered by mirror and lens over the whole image, relative to white.
    pub haze: f32,
}

impl Default for FilmConfig {
    fn default() -> Self {
        FilmConfig {
            exposure: 1.0,
            gain: 1.0,
            white_balance: [1.0; 3],
            vignetting: 0.45,
            full_well: 6000.0,
            read_noise: 15.0,
            blur_px: 1.5,
            haze: 0.008,
        }
    }
}

impl FilmConfig {
    pub(crate) fn check(&self) -> Result<(), (String, String)> {
        for (key, value) in [
            ("exposure", self.exposure),
            ("gain", self.gain),
            ("full_well", self.full_well),
            ("blur_px", self.blur_px),
        ] {
            if !(value.is_finite() && value > 0.0) {
                return Err((
                    key.to_owned(),
                    format!("invalid value: {value} (expected a number above 0)"),
                ));
            }
        }
        if !(self.read_noise >= 0.0 && self.haze >= 0.0 && (0.0..1.0).contains(&self.vignetting)) {
            let reason =
                "invalid value (expected read_noise and haze of at least 0, vignetting 0 to 1)";
            return Err(("vignetting".to_owned(), reason.to_owned()));
        }
        if !self
            .white_balance
            .iter()
            .all(|&gain| gain.is_finite() && gain > 0.0)
        {
            return Err((
                "white_balance".to_owned(),
                "invalid gains (expected three numbers above 0)".to_owned(),
            ));
        }
        Ok(())
    }
}

/// Normal random numbers, drawn once; each run of pixels starts at a random one of them.
const NOISE_SAMPLES: usize = 1 << 14;
/// Longest run that is exposed at once, pixels.
pub(crate) const RUN_PIXELS: usize = 256;
/// Steps of the linear scale: in sRGB's steepest part one step changes less than one byte.
const TONES: usize = 4096;
/// Entries of the tone table: a power of two, so that a mask replaces the bounds check.
const TONE_TABLE: usize = 8192;
/// Pixels exposed once per image, from which those outside the mirror are taken.
const DARK_PIXELS: usize = 4096;
/// Linear value of full white.
const WHITE: f32 = 1.0;

/// Converts linear light to sRGB bytes.
pub(crate) struct ImageSensor {
    noise: Vec<f32>,
    /// sRGB byte of each linear step; white beyond the last.
    tone: Box<[u8; TONE_TABLE]>,
    /// Dark pixels for the image outside the mirror, each with its own noise.
    dark_pixels: Vec<Rgbx>,
}

/// Linear values of a run of pixels, one plane per colour: indices of the tone table.
pub(crate) type ToneRun = [[u16; RUN_PIXELS]; 3];
/// An output pixel: red, green, blue, and an unused byte.
pub(crate) type Rgbx = [u8; 4];

impl ImageSensor {
    pub(crate) fn new(rng: &mut ChaCha8Rng) -> Self {
        let mut tone = Box::new([u8::MAX; TONE_TABLE]);
        for (step, byte) in tone[..=TONES].iter_mut().enumerate() {
            *byte = srgb_from_linear(step as f32 / TONES as f32);
        }
        ImageSensor {
            noise: (0..NOISE_SAMPLES + 3 * RUN_PIXELS)
                .map(|_| standard_normal(rng))
                .collect(),
            tone,
            dark_pixels: vec![[0; 4]; DARK_PIXELS + RUN_PIXELS],
        }
    }

    /// Exposes a run of at most `RUN_PIXELS` pixels. `light`: linear, per colour, under white light of level 1;
    /// `light_colour`: the actual light; `scale`: the vignetting.
    pub(crate) fn expose(
        &self,
        config: &FilmConfig,
        light: [&[f32]; 3],
        light_colour: [f32; 3],
        scale: &[f32],
        rng: &mut Pcg,
        tones: &mut ToneRun,
    ) {
        let count = scale.len().min(RUN_PIXELS);
        let start = rng.draw() as usize % NOISE_SAMPLES;
        for colour in 0..3 {
            let gain = config.gain * config.white_balance[colour];
            let exposed = config.exposure * gain * light_colour[colour];
            // Shot noise arises before the gain: the variance of v is v·gain/well + (gain·read/well)².
            let shot = gain / config.full_well;
            let read = gain * config.read_noise / config.full_well;
            let read2 = read * read;
            let noise = &self.noise[start + colour * RUN_PIXELS..][..count];
            let light = &light[colour][..count];
            let tones = &mut tones[colour][..count];
            for i in 0..count {
                let value = (light[i] + config.haze) * scale[i] * exposed;
                let noisy = value + noise[i] * (value * shot + read2).sqrt();
                let step = (noisy * (TONES as f32 / WHITE)).clamp(0.0, TONES as f32);
                // Adding 2²³ leaves the rounded value in the lowest bits, without the NaN check of a cast.
                tones[i] = (step + 8_388_608.0).to_bits() as u16;
            }
        }
    }

    /// The bytes of an exposed run.
    pub(crate) fn tone_map(&self, tones: &ToneRun, pixels: &mut [Rgbx]) {
        let [red, green, blue] = tones;
        for (((pixel, &red), &green), &blue) in pixels.iter_mut().zip(red).zip(green).zip(blue) {
            *pixel = [
                self.tone[usize::from(red) & (TONE_TABLE - 1)],
                self.tone[usize::from(green) & (TONE_TABLE - 1)],
                self.tone[usize::from(blue) & (TONE_TABLE - 1)],
                0,
            ];
        }
    }

    /// Fills the pixels `blank`, which all get the same `light`: each run is copied from a random place of a noisy strip.
    pub(crate) fn fill_dark(
        &mut self,
        config: &FilmConfig,
        (light, light_colour, scale): ([f32; 3], [f32; 3], f32),
        rng: &mut Pcg,
        blank: &[u32],
        pixels: &mut [[u8; 3]],
    ) {
        let (light, scale) = (light.map(|part| [part; RUN_PIXELS]), [scale; RUN_PIXELS]);
        let mut tones = [[0; RUN_PIXELS]; 3];
        let mut dark = std::mem::take(&mut self.dark_pixels);
        for strip in dark[..DARK_PIXELS].chunks_exact_mut(RUN_PIXELS) {
            let light = light.each_ref().map(|plane| &plane[..]);
            self.expose(config, light, light_colour, &scale, rng, &mut tones);
            self.tone_map(&tones, strip);
        }
        dark.copy_within(..RUN_PIXELS, DARK_PIXELS);
        for run in blank.chunks(RUN_PIXELS) {
            let start = rng.draw() as usize % DARK_PIXELS;
            for (&pixel, &[red, green, blue, _]) in run.iter().zip(&dark[start..start + RUN_PIXELS])
            {
                pixels[pixel as usize] = [red, green, blue];
            }
        }
        self.dark_pixels = dark;
    }
}

/// sRGB's transfer curve, linear 0 to 1.
pub(crate) fn srgb_from_linear(linear: f32) -> u8 {
    let coded = if linear <= 0.003_130_8 {
        12.92 * linear
    } else {
        1.055 * linear.powf(1.0 / 2.4) - 0.055
    };
    (coded * 255.0).round().clamp(0.0, 255.0) as u8
}

/// The linear value of an sRGB byte.
pub(crate) fn linear_from_srgb(byte: u8) -> f32 {
    let coded = f32::from(byte) / 255.0;
    if coded <= 0.040_45 {
        coded / 12.92
    } else {
        ((coded + 0.055) / 1.055).powf(2.4)
    }
}

/// O'Neill's PCG-XSH-RR, a fast generator for the noise offsets.
pub(crate) struct Pcg(u64);

impl Pcg {
    pub(crate) fn new(rng: &mut ChaCha8Rng) -> Self {
        Pcg(rng.random())
    }

    pub(crate) fn draw(&mut self) -> u32 {
        let state = self.0;
        self.0 = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        let mixed = (((state >> 18) ^ state) >> 27) as u32;
        mixed.rotate_right((state >> 59) as u32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    #[test]
    fn srgb_bytes_round_trip() {
        assert!((0..=255).all(|byte| srgb_from_linear(linear_from_srgb(byte)) == byte));
    }

    #[test]
    fn shot_noise_grows_with_the_square_root_of_the_signal() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let film = ImageSensor::new(&mut rng);
        let mut pcg = Pcg::new(&mut rng);
        let config = FilmConfig {
            read_noise: 0.0,
            haze: 0.0,
            full_well: 500.0,
            ..FilmConfig::default()
        };
        let mut measured_std = |level: f32| {
            let light = [level; RUN_PIXELS];
            let (mut sum, mut square, mut tones) = (0.0, 0.0, [[0; RUN_PIXELS]; 3]);
            let mut pixels = [[0; 4]; RUN_PIXELS];
            for _ in 0..200 {
                film.expose(
                    &config,
                    [&light; 3],
                    [1.0; 3],
                    &[1.0; RUN_PIXELS],
                    &mut pcg,
                    &mut tones,
                );
                film.tone_map(&tones, &mut pixels);
                for &[_, byte, ..] in &pixels {
                    let value = f64::from(linear_from_srgb(byte));
                    sum += value;
                    square += value * value;
                }
            }
            let count = 200.0 * RUN_PIXELS as f64;
            (square / count - (sum / count).powi(2)).sqrt()
        };
        for level in [0.1, 0.4] {
            let expected = f64::from((level / 500.0f32).sqrt());
            let measured = measured_std(level);
            assert!(
                (measured / expected - 1.0).abs() < 0.1,
                "{measured} {expected}"
            );
        }
    }
}
