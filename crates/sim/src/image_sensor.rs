//! How does the image sensor convert light to bytes? Exposure, gain, white balance, shot and read noise, tone curve.

mod config;
mod jpeg;
mod mosaic;

use localize::random::standard_normal;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

pub use config::ImageSensorConfig;
pub(crate) use jpeg::JpegCompression;
pub(crate) use mosaic::{Raw, demosaic_row, site_colours};

/// Normal random numbers, drawn once; each row of pixels starts at a random one of them.
const NOISE_SAMPLES: usize = 1 << 14;
/// Steps of the linear scale up to white: in sRGB's steepest part one step changes less than one byte.
pub(crate) const TONES: usize = 4096;
/// Entries of the tone table: one for each `u16`, which needs no bounds check. Those beyond white are never read.
const TONE_TABLE: usize = 1 << 16;

/// Converts linear light to sRGB bytes.
pub(crate) struct ImageSensor {
    noise: Vec<f32>,
    /// sRGB byte of each linear step; white beyond the last.
    tone: Box<[u8; TONE_TABLE]>,
}

/// Gain and noise of the pixels of a row.
pub(crate) struct SiteGains {
    /// Value of a pixel per light.
    exposed: Vec<f32>,
    /// Variance of a value per value: shot noise.
    shot: Vec<f32>,
    /// Variance of read noise.
    read2: Vec<f32>,
}

impl SiteGains {
    /// Gains of a row whose even and odd columns measure two colours, under light of a colour.
    pub(crate) fn new(
        image_sensor: &ImageSensorConfig,
        light_colour: [f32; 3],
        colours: [usize; 2],
        width_px: usize,
    ) -> Self {
        let gain =
            |column: usize| image_sensor.gain * image_sensor.white_balance[colours[column & 1]];
        let row = |of: &dyn Fn(usize) -> f32| (0..width_px).map(of).collect();
        SiteGains {
            exposed: row(&|column| {
                image_sensor.exposure * gain(column) * light_colour[colours[column & 1]]
            }),
            // Shot noise arises before the gain: the variance of v is v·gain/well + (gain·read/well)².
            shot: row(&|column| gain(column) / image_sensor.full_well),
            read2: row(&|column| {
                (gain(column) * image_sensor.read_noise / image_sensor.full_well).powi(2)
            }),
        }
    }
}

impl ImageSensor {
    /// A sensor with rows of `width_px` pixels.
    pub(crate) fn new(width_px: usize, rng: &mut ChaCha8Rng) -> Self {
        let mut tone = Box::new([u8::MAX; TONE_TABLE]);
        for (step, byte) in tone[..=TONES].iter_mut().enumerate() {
            *byte = srgb_from_linear(step as f32 / TONES as f32);
        }
        ImageSensor {
            noise: (0..NOISE_SAMPLES + width_px)
                .map(|_| standard_normal(rng))
                .collect(),
            tone,
        }
    }

    /// Exposes a row. `light`: linear, `TONES` for white, under white light of level 1; `scale`: the vignetting;
    /// `tones`: indices of the tone table.
    pub(crate) fn expose_row(
        &self,
        haze: f32,
        gains: &SiteGains,
        light: &[f32],
        scale: &[f32],
        rng: &mut Pcg,
        tones: &mut [u16],
    ) {
        let count = light.len().min(tones.len());
        let start = rng.draw() as usize % NOISE_SAMPLES;
        let noise = &self.noise[start..][..count];
        let (light, scale) = (&light[..count], &scale[..count]);
        let (exposed, shot) = (&gains.exposed[..count], &gains.shot[..count]);
        let read2 = &gains.read2[..count];
        let tones = &mut tones[..count];
        for i in 0..count {
            let value = (light[i] * (1.0 / TONES as f32) + haze) * scale[i] * exposed[i];
            let noisy = value + noise[i] * (value * shot[i] + read2[i]).sqrt();
            let step = (noisy * TONES as f32).clamp(0.0, TONES as f32);
            // Adding 2²³ leaves the rounded value in the lowest bits, without the NaN check of a cast.
            tones[i] = (step + 8_388_608.0).to_bits() as u16;
        }
    }

    /// The bytes of a row of tones.
    pub(crate) fn tone_map(&self, tones: [&[u16]; 3], pixels: &mut [[u8; 3]]) {
        let [red, green, blue] = tones;
        for (((pixel, &red), &green), &blue) in pixels.iter_mut().zip(red).zip(green).zip(blue) {
            *pixel = [
                self.tone[usize::from(red)],
                self.tone[usize::from(green)],
                self.tone[usize::from(blue)],
            ];
        }
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
        const WIDTH: usize = 256;
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let sensor = ImageSensor::new(WIDTH, &mut rng);
        let mut pcg = Pcg::new(&mut rng);
        let image_sensor = ImageSensorConfig {
            full_well: 500.0,
            ..ImageSensorConfig::ideal()
        };
        let gains = SiteGains::new(&image_sensor, [1.0; 3], [0, 0], WIDTH);
        let mut measured_std = |level: f32| {
            let light = [level * TONES as f32; WIDTH];
            let (mut sum, mut square, mut tones) = (0.0, 0.0, [0; WIDTH]);
            for _ in 0..200 {
                sensor.expose_row(0.0, &gains, &light, &[1.0; WIDTH], &mut pcg, &mut tones);
                for tone in tones {
                    let value = f64::from(tone) / TONES as f64;
                    sum += value;
                    square += value * value;
                }
            }
            let count = 200.0 * WIDTH as f64;
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
