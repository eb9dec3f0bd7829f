//! Do the learned colours still fit? Carpet and white, followed slowly by confirmed pixels, never far from where they
//! were learned.
//!
//! Confirmed is carpet that lies between the robot and a line point, and white that is a line point. Their medians pull
//! the tracked colours; what was learned holds them: brightness within a factor, chromaticity within a part of the
//! carpet's own chroma. So no goal, shirt or lamp can lead them away step by step, and a light that is quite another
//! is learned anew instead.

use crate::colour::carpet_model::{CarpetModel, median_colour};
use crate::config::ColourAdaptationConfig;
use crate::image::ImageView;
use crate::process::Detections;
use crate::scan::pattern::ScanPattern;

/// Colours that are followed from frame to frame.
#[derive(Debug, Clone)]
pub(crate) struct ColourAdaptation {
    /// As they were learned.
    prior: CarpetModel,
    carpet: [f32; 3],
    white: [f32; 3],
}

/// Every so many samples of the pattern is asked whether it is confirmed: a few hundred make a median.
const SAMPLE_STEP: usize = 16;
/// Fewer confirmed pixels tell no median.
const MEDIAN_PIXELS_MIN: usize = 20;
/// A channel at its upper end says only that it was at least so bright.
const SATURATED_LEVEL: f32 = 250.0;

impl ColourAdaptation {
    pub(crate) fn new(prior: CarpetModel) -> Self {
        ColourAdaptation {
            prior,
            carpet: prior.carpet,
            white: prior.white,
        }
    }

    /// The colours as they were learned.
    pub(crate) fn prior(&self) -> &CarpetModel {
        &self.prior
    }

    /// Takes in what a frame confirms; gives the colours anew if those in use no longer fit.
    pub(crate) fn update(
        &mut self,
        frame: &ImageView<'_>,
        pattern: &ScanPattern,
        is_carpet: impl Fn(usize) -> bool,
        seen: &Detections,
        (in_use, centre_px): (&CarpetModel, [f32; 2]),
        config: &ColourAdaptationConfig,
    ) -> Option<CarpetModel> {
        let reach = confirmed_carpet_range(seen, centre_px);
        let carpet: Vec<[u8; 3]> = pattern
            .samples
            .iter()
            .enumerate()
            .step_by(SAMPLE_STEP)
            .filter(|&(index, sample)| {
                let sector = (sample.azimuth_turns * SECTORS as f32) as usize % SECTORS;
                sample.range < reach[sector] && is_carpet(index)
            })
            .map(|(_, sample)| frame.rgb(usize::from(sample.u), usize::from(sample.v)))
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
        // The better half: far lines are mixed with carpet.
        let mut points: Vec<_> = seen.line_points.iter().collect();
        points.sort_by(|a, b| b.contrast.total_cmp(&a.contrast));
        points.truncate(points.len() / 2);
        let white: Vec<[u8; 3]> = points
            .iter()
            .map(|point| {
                let [u, v] = point.position_px.map(|at| at.round().max(0.0) as usize);
                frame.rgb(u.min(frame.width_px - 1), v.min(frame.height_px - 1))
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
                .map(|i| (a[i].max(1.0) / b[i].max(1.0)).ln().abs())
                .fold(0.0, f32::max)
        };
        let stale = off(self.carpet, in_use.carpet) > config.rebuild_threshold
            || off(self.white, in_use.white) > config.rebuild_threshold;
        stale.then(|| self.prior.with_colours(self.carpet, self.white))
    }
}

/// Directions in which the farthest line point is kept.
const SECTORS: usize = 36;

/// How far carpet is confirmed in each direction: up to the farthest line point there, metres.
fn confirmed_carpet_range(seen: &Detections, [cu, cv]: [f32; 2]) -> [f32; SECTORS] {
    let mut reach = [0.0f32; SECTORS];
    let count = seen.carpet_end.len();
    for point in &seen.line_points {
        let [u, v] = point.position_px;
        let turns = (cv - v).atan2(u - cu) / std::f32::consts::TAU;
        let sector = (turns.rem_euclid(1.0) * SECTORS as f32) as usize % SECTORS;
        reach[sector] = reach[sector].max(point.point.at.distance());
    }
    if count > 0 {
        for (sector, reach) in reach.iter_mut().enumerate() {
            *reach = reach.min(seen.carpet_end[sector * count / SECTORS]);
        }
    }
    reach
}

fn smooth_towards(colour: &mut [f32; 3], towards: [f32; 3], rate: f32) {
    for (channel, wanted) in colour.iter_mut().zip(towards) {
        *channel += rate * (wanted - *channel);
    }
}

/// A colour no farther from its prior than is allowed: in brightness, and in each channel's share of it.
fn clamp_to_prior(
    colour: [f32; 3],
    prior: [f32; 3],
    model: &CarpetModel,
    config: &ColourAdaptationConfig,
) -> [f32; 3] {
    let sum = |colour: [f32; 3]| colour.iter().sum::<f32>().max(1.0);
    let most = config.brightness_factor_max;
    let brightness = (sum(colour) / sum(prior)).clamp(1.0 / most, most);
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
            "no longer green: {colour:?}"
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
        let wanted = model.carpet.map(|c| c * 0.7);
        assert!(
            colour
                .iter()
                .zip(wanted)
                .all(|(a, b)| (a / b - 1.0).abs() < 0.05),
            "{colour:?}"
        );
    }
}
