//! How do the eyes get used to a light? Carpet and white are learned from one frame, and followed from then on.

use crate::adapt::Adaptation;
use crate::carpet::{CarpetModel, median_colour};
use crate::colours::{Class, NativeTable};
use crate::error::VisionError;
use crate::image::{Frame, PixelFormat, rgb_of_yuv, yuv_of_rgb};
use crate::line_points::{SeenLinePoint, thresholds};

use super::{Eyes, Seen};

/// Noise of demosaiced and of compressed images is alike in neighbours; this many samples apart it no longer is.
const NOISE_LAG: usize = 4;

/// Fewer runs than this do not tell white's colour.
const FEWEST_WHITE_RUNS: usize = 8;

/// Colours under one light, and the table made of them.
#[derive(Debug, Clone)]
pub(super) struct Light {
    pub(super) model: CarpetModel,
    pub(super) table: NativeTable,
    /// Weights of the channels for telling white from carpet, of 256.
    pub(super) weights: [u32; 3],
    pub(super) noise: f32,
    /// Share of the scanned pixels that were carpet when it was learned.
    pub(super) carpet_share: f32,
    pub(super) format: PixelFormat,
    adaptation: Adaptation,
    /// Seen in this light.
    frames: u32,
}

impl Eyes {
    /// Learns carpet and white from one frame; reads it with what was learned.
    pub(super) fn learn(&mut self, frame: &Frame<'_>) -> Result<(Light, f32), VisionError> {
        let near: Vec<[u8; 3]> = self
            .pattern
            .samples
            .iter()
            .filter(|sample| sample.range <= self.config.colours.carpet_range)
            .map(|sample| frame.rgb(usize::from(sample.u), usize::from(sample.v)))
            .collect();
        let brightest = brightest(&near);
        let black = VisionError::Black { brightest };
        if brightest <= self.config.colours.black_frame_level {
            return Err(black);
        }
        let carpet: Vec<[u8; 3]> = match &self.labelled {
            Some(table) => near
                .iter()
                .filter(|&&rgb| table.class(yuv_of_rgb(rgb)) == Class::CARPET)
                .copied()
                .collect(),
            None => Vec::new(),
        };
        let model = CarpetModel::learn(if carpet.is_empty() { &near } else { &carpet });
        let model = model.ok_or(black)?;
        let mut light = self.light_of(model, frame.format);
        let mut share = self.read(frame, &light);
        self.measure_noise(frame, &mut light);
        let mut seen = Seen::default();
        self.sights(&mut seen);
        self.find_lines(frame, &light, &mut seen);
        if let Some(white) = white_of(frame, &seen) {
            light = self.light_of(light.model.with_white(white, light.noise), frame.format);
            share = self.read(frame, &light);
            self.measure_noise(frame, &mut light);
        }
        light.carpet_share = share;
        Ok((light, share))
    }

    fn light_of(&self, model: CarpetModel, format: PixelFormat) -> Light {
        Light {
            table: self.table_of(format, model, model),
            weights: weights_of(&model),
            noise: 0.0,
            carpet_share: 0.0,
            model,
            format,
            adaptation: Adaptation::new(model),
            frames: 0,
        }
    }

    /// Classes of a camera's channels under a light that was learned as `prior` and is now `model`.
    fn table_of(&self, format: PixelFormat, model: CarpetModel, prior: CarpetModel) -> NativeTable {
        let colours = self.config.colours.clone();
        let ball = self.config.objects.ball_hue_deg;
        let labelled = self.labelled.clone();
        NativeTable::new(move |native| {
            let rgb = if format.is_yuv() {
                rgb_of_yuv(native)
            } else {
                native
            };
            match &labelled {
                None => model.class(rgb, &colours, ball),
                Some(table) if format.is_yuv() && model == prior => table.class(native),
                // People labelled what they saw in another light: the carpet tells by how much each channel changed.
                Some(table) => table.class(yuv_of_rgb(std::array::from_fn(|i| {
                    let change = prior.carpet[i].max(1.0) / model.carpet[i].max(1.0);
                    (f32::from(rgb[i]) * change).round().min(255.0) as u8
                }))),
            }
        })
    }

    /// Follows slow changes of the light by what this frame confirms.
    pub(super) fn follow(&mut self, frame: &Frame<'_>, light: &mut Light, seen: &Seen) {
        let config = &self.config.colours.adapt;
        light.frames += 1;
        if !config.enabled || seen.learned || !light.frames.is_multiple_of(config.every.max(1)) {
            return;
        }
        let is_carpet = |index: usize| {
            let sample = &self.pattern.samples[index];
            let native = frame.native(usize::from(sample.u), usize::from(sample.v));
            light.table.class(native) == Class::CARPET
        };
        let changed = light.adaptation.follow(
            frame,
            &self.pattern,
            is_carpet,
            seen,
            (&light.model, self.centre_px),
            config,
        );
        if let Some(model) = changed {
            light.table = self.table_of(light.format, model, *light.adaptation.prior());
            light.weights = weights_of(&model);
            light.model = model;
            self.measure_noise(frame, light);
        }
    }

    fn measure_noise(&mut self, frame: &Frame<'_>, light: &mut Light) {
        self.read_every(frame, &light.table);
        light.noise = self.noise();
        thresholds(
            &self.pattern,
            &light.model,
            light.noise,
            &self.config.lines,
            self.line_width,
            &mut self.thresholds,
        );
    }

    /// Standard deviation of the values on plain carpet, from differences along scan lines; edges are outliers.
    fn noise(&self) -> f32 {
        let mut counts = [0u32; 256];
        let mut values = vec![0; self.pattern.longest()];
        for piece in &self.pattern.pieces {
            let range = piece.start as usize..piece.end as usize;
            let values = &mut values[..range.len()];
            self.brightness.pick(range.clone(), values);
            let pairs = values.windows(1 + NOISE_LAG);
            for (values, classes) in pairs.zip(self.classes[range].windows(1 + NOISE_LAG)) {
                if classes[0] == Class::CARPET && classes[NOISE_LAG] == Class::CARPET {
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
fn weights_of(model: &CarpetModel) -> [u32; 3] {
    let weights = model.weights();
    let [r, g, _] = weights.map(|weight| (256.0 * weight).round() as u32);
    [r, g, 256 - r - g]
}

/// The level that 95 % of the pixels stay below.
fn brightest(pixels: &[[u8; 3]]) -> u8 {
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
fn white_of(frame: &Frame<'_>, seen: &Seen) -> Option<[f32; 3]> {
    let mut order: Vec<&SeenLinePoint> = seen.line_points.iter().collect();
    if order.len() < FEWEST_WHITE_RUNS {
        return None;
    }
    order.sort_by(|a, b| b.contrast.total_cmp(&a.contrast));
    order.truncate(order.len() / 2);
    let colours: Vec<[u8; 3]> = order
        .iter()
        .map(|point| {
            let [u, v] = point.at_px.map(|at| at.round().max(0.0) as usize);
            frame.rgb(u, v)
        })
        .collect();
    median_colour(&colours)
}
