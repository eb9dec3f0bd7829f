//! How do the eyes get used to a light? Carpet and white are learned from one frame, and followed from then on.

use crate::colour::adaptation::ColourAdaptation;
use crate::colour::carpet_model::{CarpetModel, median_colour};
use crate::colour::lookup_table::{ColourClass, ColourLookupTable};
use crate::error::VisionError;
use crate::image::{ImageView, PixelFormat, rgb_to_yuv, yuv_to_rgb};
use crate::lines::detection::{LinePointDetection, peak_thresholds};

use super::{Detections, Vision};

/// Noise of demosaiced and of compressed images is alike in neighbours; this many samples apart it no longer is.
const NOISE_LAG: usize = 4;

/// Fewer runs than this do not tell white's colour.
const WHITE_POINTS_MIN: usize = 8;

/// Colours under one light, and the table made of them.
#[derive(Debug, Clone)]
pub(super) struct ColourModel {
    pub(super) carpet_model: CarpetModel,
    pub(super) lookup_table: ColourLookupTable,
    /// Weights of the channels for telling white from carpet, of 256.
    pub(super) channel_weights: [u32; 3],
    pub(super) noise: f32,
    /// Share of the scanned pixels that were carpet when it was learned.
    pub(super) learned_carpet_share: f32,
    pub(super) format: PixelFormat,
    adaptation: ColourAdaptation,
    /// Seen in this light.
    image_count: u32,
}

impl Vision {
    /// Learns carpet and white from one frame; reads it with what was learned.
    pub(super) fn learn_colour_model(
        &mut self,
        frame: &ImageView<'_>,
    ) -> Result<(ColourModel, f32), VisionError> {
        let near: Vec<[u8; 3]> = self
            .pattern
            .samples
            .iter()
            .filter(|sample| sample.range <= self.config.colours.learning_range_max)
            .map(|sample| frame.rgb(usize::from(sample.u), usize::from(sample.v)))
            .collect();
        let brightest = brightness_percentile_95(&near);
        let black = VisionError::TooDark { brightest };
        if brightest <= self.config.colours.dark_image_level {
            return Err(black);
        }
        let carpet: Vec<[u8; 3]> = match &self.colour_table {
            Some(table) => near
                .iter()
                .filter(|&&rgb| table.class(rgb_to_yuv(rgb)) == ColourClass::CARPET)
                .copied()
                .collect(),
            None => Vec::new(),
        };
        let model = CarpetModel::learn(if carpet.is_empty() { &near } else { &carpet });
        let model = model.ok_or(black)?;
        let mut light = self.build_colour_model(model, frame.format);
        let mut share = self.read_scan(frame, &light);
        self.measure_noise(frame, &mut light);
        let mut seen = Detections::default();
        self.find_carpet_ends(&mut seen);
        self.detect_lines(frame, &light, &mut seen);
        if let Some(white) = estimate_white(frame, &seen) {
            light = self.build_colour_model(
                light.carpet_model.with_white(white, light.noise),
                frame.format,
            );
            share = self.read_scan(frame, &light);
            self.measure_noise(frame, &mut light);
        }
        light.learned_carpet_share = share;
        Ok((light, share))
    }

    fn build_colour_model(&self, model: CarpetModel, format: PixelFormat) -> ColourModel {
        ColourModel {
            lookup_table: self.build_lookup_table(format, model, model),
            channel_weights: quantize_weights(&model),
            noise: 0.0,
            learned_carpet_share: 0.0,
            carpet_model: model,
            format,
            adaptation: ColourAdaptation::new(model),
            image_count: 0,
        }
    }

    /// Classes of a camera's channels under a light that was learned as `prior` and is now `model`.
    fn build_lookup_table(
        &self,
        format: PixelFormat,
        model: CarpetModel,
        prior: CarpetModel,
    ) -> ColourLookupTable {
        let colours = self.config.colours.clone();
        let ball = self.config.objects.ball_hue_deg;
        let labelled = self.colour_table.clone();
        ColourLookupTable::new(move |native| {
            let rgb = if format.is_yuv() {
                yuv_to_rgb(native)
            } else {
                native
            };
            match &labelled {
                None => model.classify(rgb, &colours, ball),
                Some(table) if format.is_yuv() && model == prior => table.class(native),
                // People labelled what they saw in another light: the carpet tells by how much each channel changed.
                Some(table) => table.class(rgb_to_yuv(std::array::from_fn(|i| {
                    let change = prior.carpet[i].max(1.0) / model.carpet[i].max(1.0);
                    (f32::from(rgb[i]) * change).round().min(255.0) as u8
                }))),
            }
        })
    }

    /// Follows slow changes of the light by what this frame confirms.
    pub(super) fn adapt_colours(
        &mut self,
        frame: &ImageView<'_>,
        light: &mut ColourModel,
        seen: &Detections,
    ) {
        let config = &self.config.colours.adaptation;
        light.image_count += 1;
        if !config.enabled
            || seen.colours_learned
            || !light
                .image_count
                .is_multiple_of(config.interval_images.max(1))
        {
            return;
        }
        let is_carpet = |index: usize| {
            let sample = &self.pattern.samples[index];
            let native = frame.native_channels(usize::from(sample.u), usize::from(sample.v));
            light.lookup_table.class(native) == ColourClass::CARPET
        };
        let changed = light.adaptation.update(
            frame,
            &self.pattern,
            is_carpet,
            seen,
            (&light.carpet_model, self.centre_px),
            config,
        );
        if let Some(model) = changed {
            light.lookup_table =
                self.build_lookup_table(light.format, model, *light.adaptation.prior());
            light.channel_weights = quantize_weights(&model);
            light.carpet_model = model;
            self.measure_noise(frame, light);
        }
    }

    fn measure_noise(&mut self, frame: &ImageView<'_>, light: &mut ColourModel) {
        self.classify_all_samples(frame, &light.lookup_table);
        light.noise = self.estimate_noise();
        peak_thresholds(
            &self.pattern,
            &light.carpet_model,
            light.noise,
            &self.config.lines,
            self.line_width,
            &mut self.peak_thresholds,
        );
    }

    /// Standard deviation of the values on plain carpet, from differences along scan lines; edges are outliers.
    fn estimate_noise(&self) -> f32 {
        let mut counts = [0u32; 256];
        let mut values = vec![0; self.pattern.longest_segment()];
        for piece in &self.pattern.segments {
            let range = piece.start as usize..piece.end as usize;
            let values = &mut values[..range.len()];
            self.brightness.gather(range.clone(), values);
            let pairs = values.windows(1 + NOISE_LAG);
            for (values, classes) in pairs.zip(self.classes[range].windows(1 + NOISE_LAG)) {
                if classes[0] == ColourClass::CARPET && classes[NOISE_LAG] == ColourClass::CARPET {
                    counts[usize::from(values[0].abs_diff(values[NOISE_LAG]))] += 1;
                }
            }
        }
        let half = counts.iter().sum::<u32>() as f32 / 2.0;
        let mut below = 0.0;
        for (difference, &count) in counts.iter().enumerate() {
            let next = below + count as f32;
            if next >= half && count > 0 {
                let median = difference as f32 - 0.5 + (half - below) / count as f32;
                // Half of |N(0, √2 σ)| lies below 0.954 σ.
                return median.max(0.0) / 0.954;
            }
            below = next;
        }
        0.0
    }
}

/// A model's weights in whole 256ths.
fn quantize_weights(model: &CarpetModel) -> [u32; 3] {
    let weights = model.channel_weights();
    let [r, g, _] = weights.map(|weight| (256.0 * weight).round() as u32);
    [r, g, 256 - r - g]
}

/// The level that 95 % of the pixels stay below.
fn brightness_percentile_95(pixels: &[[u8; 3]]) -> u8 {
    let mut levels: Vec<u8> = pixels
        .iter()
        .map(|rgb| rgb.iter().fold(0, |a, &b| a.max(b)))
        .collect();
    if levels.is_empty() {
        return 0;
    }
    let at = levels.len() * 95 / 100;
    *levels.select_nth_unstable(at).1
}

/// White's colour: the median over the better half of the line points.
fn estimate_white(frame: &ImageView<'_>, seen: &Detections) -> Option<[f32; 3]> {
    let mut order: Vec<&LinePointDetection> = seen.line_points.iter().collect();
    if order.len() < WHITE_POINTS_MIN {
        return None;
    }
    order.sort_by(|a, b| b.contrast.total_cmp(&a.contrast));
    order.truncate(order.len() / 2);
    let colours: Vec<[u8; 3]> = order
        .iter()
        .map(|point| {
            let [u, v] = point.position_px.map(|at| at.round().max(0.0) as usize);
            frame.rgb(u, v)
        })
        .collect();
    median_colour(&colours)
}
