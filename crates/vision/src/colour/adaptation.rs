//! Slow adaptation of the colours of carpet and white to confirmed pixels, bounded around the learned colours.
//!
//! Confirmed are carpet pixels between the robot and a line point, and white pixels at line points. The tracked colours
//! are smoothed towards their medians. They stay within a brightness factor and a chroma deviation of the learned
//! colours. So goals, shirts or lamps cannot make them drift away; a very different light is learned anew instead.

use localize::math;

use crate::colour::carpet_model::{CarpetModel, median_colour};
use crate::colour::lookup_table::ColourClass;
use crate::config::ColourAdaptationConfig;
use crate::image::ImageView;
use crate::lines::detection::LinePointDetection;
use crate::optics::image_polar::azimuth;
use crate::scan::pattern::ScanSample;

/// Tracked colours of carpet and white.
#[derive(Debug, Clone)]
pub(crate) struct ColourAdaptation {
    /// The learned colours.
    prior: CarpetModel,
    carpet: [f32; 3],
    white: [f32; 3],
    /// Standard deviation of a pixel's chroma on plain carpet, divided by the brightness.
    chroma_noise: f32,
}

/// One processed image.
pub(crate) struct AdaptationInput<'a> {
    pub(crate) image: &'a ImageView<'a>,
    pub(crate) samples: &'a [CarpetSample],
    /// Their classes in the image.
    pub(crate) classes: &'a [ColourClass],
    /// Points of markings.
    pub(crate) line_points: &'a [LinePointDetection],
    /// As in the image's detections.
    pub(crate) carpet_end: &'a [f32],
    /// The colours in use.
    pub(crate) model: &'a CarpetModel,
    /// The mirror's axis in the image, pixels.
    pub(crate) centre_px: [f32; 2],
}

/// A sample of the scan pattern that may show confirmed carpet. A few hundred suffice for a median.
#[derive(Debug, Clone, Copy)]
pub(crate) struct CarpetSample {
    /// Column and row.
    pixel: [u16; 2],
    /// Metres.
    range: f32,
    /// Azimuth sector.
    sector: u8,
}

impl CarpetSample {
    pub(crate) fn new(sample: &ScanSample) -> Self {
        CarpetSample {
            pixel: [sample.u, sample.v],
            range: sample.range,
            sector: ((sample.azimuth_turns * SECTORS as f32) as usize % SECTORS) as u8,
        }
    }
}

/// Fewest confirmed pixels for a median.
const MEDIAN_PIXELS_MIN: usize = 20;
/// Share of a new measurement of the noise: it is good to a tenth, and exposure control changes the gain within seconds.
const NOISE_SMOOTHING: f32 = 0.2;
/// Change of the noise (logarithm) by which hue may count again, or no longer: less would change the rule to and fro.
const NOISE_CHANGE_MIN: f32 = 0.2;
/// A channel above this level is saturated and not compared.
const SATURATED_LEVEL: f32 = 250.0;

impl ColourAdaptation {
    pub(crate) fn new(prior: CarpetModel) -> Self {
        ColourAdaptation {
            prior,
            carpet: prior.carpet,
            white: prior.white,
            chroma_noise: prior.chroma_noise(),
        }
    }

    /// The learned colours.
    pub(crate) fn prior(&self) -> &CarpetModel {
        &self.prior
    }

    /// Updates the tracked colours; returns a new model if the one in use deviates too much.
    pub(crate) fn update(
        &mut self,
        input: &AdaptationInput<'_>,
        config: &ColourAdaptationConfig,
    ) -> Option<CarpetModel> {
        let &AdaptationInput {
            image,
            samples,
            classes,
            line_points,
            carpet_end,
            model,
            centre_px,
        } = input;
        let range_max = confirmed_carpet_range(line_points, carpet_end, centre_px);
        let carpet: Vec<[u8; 3]> = samples
            .iter()
            .zip(classes)
            .filter(|&(sample, &class)| {
                class == ColourClass::CARPET && sample.range < range_max[usize::from(sample.sector)]
            })
            .map(|(sample, _)| {
                let [u, v] = sample.pixel.map(usize::from);
                image.rgb(u, v)
            })
            .collect();
        if carpet.len() < MEDIAN_PIXELS_MIN {
            return None;
        }
        smooth_towards(
            &mut self.carpet,
            median_colour(&carpet)?,
            config.smoothing_factor,
        );
        self.carpet = clamp_to_prior(self.carpet, self.prior.carpet, &self.prior, config);
        let noise = self.prior.measure_chroma_noise(&carpet);
        self.chroma_noise += NOISE_SMOOTHING * (noise - self.chroma_noise);
        // The half of higher contrast: pixels of far lines are mixed with carpet.
        let mut points: Vec<_> = line_points.iter().collect();
        points.sort_by(|a, b| b.contrast.total_cmp(&a.contrast));
        points.truncate(points.len() / 2);
        let white: Vec<[u8; 3]> = points
            .iter()
            .map(|point| {
                let [u, v] = point.position_px.map(|at| at.round().max(0.0) as usize);
                image.rgb(u.min(image.width_px - 1), v.min(image.height_px - 1))
            })
            .collect();
        if self.prior.white_measured && white.len() >= MEDIAN_PIXELS_MIN {
            smooth_towards(
                &mut self.white,
                median_colour(&white)?,
                config.smoothing_factor,
            );
            self.white = clamp_to_prior(self.white, self.prior.white, &self.prior, config);
        }
        let off = |a: [f32; 3], b: [f32; 3]| {
            (0..3)
                .filter(|&i| a[i].max(b[i]) < SATURATED_LEVEL)
                .map(|i| math::ln(a[i].max(1.0) / b[i].max(1.0)).abs())
                .fold(0.0, f32::max)
        };
        let now = self
            .prior
            .with_colours(self.carpet, self.white)
            .with_chroma_noise(self.chroma_noise);
        // The first image may be the noisiest: the gain is high until the exposure is controlled.
        let noise_ratio = now.chroma_noise() / model.chroma_noise().max(f32::MIN_POSITIVE);
        let other_rule =
            now.is_grey() != model.is_grey() && math::ln(noise_ratio).abs() > NOISE_CHANGE_MIN;
        let rebuild = off(self.carpet, model.carpet) > config.rebuild_threshold
            || off(self.white, model.white) > config.rebuild_threshold
            || other_rule;
        rebuild.then_some(now)
    }
}

/// Number of azimuth sectors.
const SECTORS: usize = 36;

/// Range of confirmed carpet in each sector: its farthest line point, metres.
fn confirmed_carpet_range(
    line_points: &[LinePointDetection],
    carpet_end: &[f32],
    centre_px: [f32; 2],
) -> [f32; SECTORS] {
    let mut range_max = [0.0f32; SECTORS];
    let count = carpet_end.len();
    for point in line_points {
        let turns = azimuth(centre_px, point.position_px) / std::f32::consts::TAU;
        let sector = (turns.rem_euclid(1.0) * SECTORS as f32) as usize % SECTORS;
        range_max[sector] = range_max[sector].max(point.point.at.distance());
    }
    if count > 0 {
        for (sector, range_max) in range_max.iter_mut().enumerate() {
            *range_max = range_max.min(carpet_end[sector * count / SECTORS]);
        }
    }
    range_max
}

fn smooth_towards(colour: &mut [f32; 3], towards: [f32; 3], rate: f32) {
    for (channel, target) in colour.iter_mut().zip(towards) {
        *channel += rate * (target - *channel);
    }
}

/// Limits a colour's deviation from its prior, in brightness and in each channel's share.
fn clamp_to_prior(
    colour: [f32; 3],
    prior: [f32; 3],
    model: &CarpetModel,
    config: &ColourAdaptationConfig,
) -> [f32; 3] {
    let sum = |colour: [f32; 3]| colour.iter().sum::<f32>().max(1.0);
    let factor_max = config.brightness_factor_max;
    let brightness = (sum(colour) / sum(prior)).clamp(1.0 / factor_max, factor_max);
    let slack = config.chroma_deviation_max * model.carpet_chroma();
    std::array::from_fn(|i| {
        let share = 3.0 * colour[i] / sum(colour);
        let usual = 3.0 * prior[i] / sum(prior);
        let share = share.clamp(usual * (1.0 - slack), usual * (1.0 + slack));
        (share * brightness * sum(prior) / 3.0).min(255.0)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn model() -> CarpetModel {
        let carpet = vec![[60, 140, 70]; 500];
        let model = CarpetModel::learn(&carpet).expect("a carpet");
        model.with_white([220.0, 225.0, 215.0], 2.0)
    }

    #[test]
    fn adaptation_stays_bounded_under_constant_pull() {
        let (model, config) = (model(), ColourAdaptationConfig::default());
        let mut colour = model.carpet;
        for _ in 0..10_000 {
            smooth_towards(&mut colour, [250.0, 60.0, 20.0], config.smoothing_factor);
            colour = clamp_to_prior(colour, model.carpet, &model, &config);
        }
        let share = |colour: [f32; 3], i: usize| colour[i] / colour.iter().sum::<f32>();
        for i in 0..3 {
            let moved = share(colour, i) / share(model.carpet, i);
            assert!((0.8..1.25).contains(&moved), "{colour:?}");
        }
        assert!(
            colour[1] > colour[0] && colour[1] > colour[2],
            "carpet is not green: {colour:?}"
        );
    }

    #[test]
    fn adaptation_tracks_slow_dimming() {
        let (model, config) = (model(), ColourAdaptationConfig::default());
        let mut colour = model.carpet;
        for step in 0..600 {
            let light = 1.0 - 0.3 * step as f32 / 600.0;
            smooth_towards(
                &mut colour,
                model.carpet.map(|c| c * light),
                config.smoothing_factor,
            );
            colour = clamp_to_prior(colour, model.carpet, &model, &config);
        }
        let target = model.carpet.map(|c| c * 0.7);
        assert!(
            colour
                .iter()
                .zip(target)
                .all(|(a, b)| (a / b - 1.0).abs() < 0.05),
            "{colour:?}"
        );
    }
}
