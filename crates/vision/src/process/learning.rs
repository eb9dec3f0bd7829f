//! Learns the colours of carpet and white from one image and adapts them afterwards.

use crate::colour::adaptation::{AdaptationInput, ColourAdaptation};
use crate::colour::carpet_model::{CarpetModel, median_colour};
use crate::colour::lookup_table::{ColourClass, ColourLookupTable};
use crate::error::VisionError;
use crate::image::{ImageView, PixelFormat, rgb_to_yuv, yuv_to_rgb};
use crate::lines::detection::{LinePointDetection, peak_thresholds};
use crate::lines::validator::WhiteKnowledge;
use crate::scan::pattern::ScanLines;

use super::colour_model::ColourModel;
use super::detections::Detections;
use super::{FoundLines, Vision};

/// Demosaicing and compression correlate the noise of neighbours; samples this far apart are independent.
const NOISE_LAG: usize = 4;

/// Light is coloured if so many times as many points are brighter than the carpet on both sides as are white in neutral light.
const CAST_POINTS: usize = 2;

/// Fewest line points for estimating white, and fewest that may be fainter than lines are.
const WHITE_POINTS_MIN: usize = 8;
const FAINT_POINTS_MIN: usize = 24;

impl Vision {
    /// Learns carpet and white from one image and reads it with the result; also returns its carpet share.
    pub(super) fn learn_colour_model(
        &mut self,
        image: &ImageView<'_>,
    ) -> Result<(ColourModel, f32), VisionError> {
        let near_pixels: Vec<[u8; 3]> = self
            .pattern
            .samples
            .iter()
            .filter(|sample| sample.range <= self.config.colours.learning_range_max)
            .map(|sample| image.rgb(usize::from(sample.u), usize::from(sample.v)))
            .collect();
        let brightest = brightness_percentile_95(&near_pixels);
        let too_dark = VisionError::TooDark { brightest };
        if brightest <= self.config.colours.dark_image_level {
            return Err(too_dark);
        }
        let carpet: Vec<[u8; 3]> = match &self.colour_table {
            Some(table) => near_pixels
                .iter()
                .filter(|&&rgb| table.class(rgb_to_yuv(rgb)) == ColourClass::CARPET)
                .copied()
                .collect(),
            None => Vec::new(),
        };
        let model = CarpetModel::learn(if carpet.is_empty() {
            &near_pixels
        } else {
            &carpet
        });
        let model = model.ok_or(too_dark)?;
        let mut colour_model = self.build_colour_model(model, image.format);
        let lines = ScanLines::All;
        let mut share = self.read_scan(image, &colour_model, lines);
        self.measure_noise(image, &mut colour_model, lines);
        if let Some(white) = self.measure_white(image, &colour_model) {
            colour_model = self.build_colour_model(
                colour_model
                    .carpet_model
                    .with_white(white, colour_model.brightness_noise),
                image.format,
            );
            share = self.read_scan(image, &colour_model, lines);
            self.measure_noise(image, &mut colour_model, lines);
        }
        colour_model.learned_carpet_share = share;
        Ok((colour_model, share))
    }

    /// White as the lines show it: under neutral light; if most lines are of another colour, in theirs; and if hardly any is as
    /// bright as white is beside most carpets, of what is brighter than the carpet.
    fn measure_white(
        &mut self,
        image: &ImageView<'_>,
        colour_model: &ColourModel,
    ) -> Option<[f32; 3]> {
        let mut start = Detections::default();
        self.find_carpet_ends(&mut start);
        let mut lines_with = |white: WhiteKnowledge| {
            let mut found = start.clone();
            self.detect_lines(image, colour_model, ScanLines::All, white, &mut found);
            found.line_points
        };
        let neutral = lines_with(WhiteKnowledge::Full);
        let coloured = lines_with(WhiteKnowledge::Brightness);
        let is_cast = coloured.len() > CAST_POINTS * neutral.len();
        let points = if is_cast { coloured } else { neutral };
        if points.len() >= WHITE_POINTS_MIN {
            return estimate_white(image, points);
        }
        let faint = lines_with(WhiteKnowledge::Nothing);
        (faint.len() >= FAINT_POINTS_MIN).then(|| estimate_white(image, faint))?
    }

    fn build_colour_model(&self, model: CarpetModel, format: PixelFormat) -> ColourModel {
        ColourModel {
            lookup_table: self.build_lookup_table(format, model, model),
            chroma_table: self.build_chroma_table(format, model),
            channel_weights: quantize_weights(&model),
            brightness_noise: 0.0,
            learned_carpet_share: 0.0,
            carpet_model: model,
            format,
            adaptation: ColourAdaptation::new(model),
            image_count: 0,
        }
    }

    /// Lookup table from the camera's channels to classes; learned as `prior`, adapted to `model`.
    fn build_lookup_table(
        &self,
        format: PixelFormat,
        model: CarpetModel,
        prior: CarpetModel,
    ) -> ColourLookupTable {
        let colours = self.config.colours.clone();
        let ball = self.config.objects.ball_hue_deg;
        let table = self.colour_table.clone();
        ColourLookupTable::new(move |native| {
            let rgb = to_rgb(native, format);
            match &table {
                None => model.classify(rgb, &colours, ball),
                Some(table) if format.is_yuv() && model == prior => table.class(native),
                // The labels belong to the prior's light: the carpet's change scales each channel.
                Some(table) => table.class(rgb_to_yuv(std::array::from_fn(|i| {
                    let change = prior.carpet[i].max(1.0) / model.carpet[i].max(1.0);
                    (f32::from(rgb[i]) * change).round().min(255.0) as u8
                }))),
            }
        })
    }

    /// See [`ColourModel::chroma_table`]. A wrong cluster may pass for the carpet in noise, so rays and lines do without it.
    fn build_chroma_table(
        &self,
        format: PixelFormat,
        model: CarpetModel,
    ) -> Option<ColourLookupTable> {
        if !model.is_grey() || self.colour_table.is_some() {
            return None;
        }
        let colours = self.config.colours.clone();
        let ball = self.config.objects.ball_hue_deg;
        Some(ColourLookupTable::new(move |native| {
            let rgb = to_rgb(native, format);
            match model.is_coloured(rgb) {
                true => ColourClass::OTHER,
                false => model.classify(rgb, &colours, ball),
            }
        }))
    }

    /// Adapts the colours to slow changes of the light, from pixels confirmed by this image.
    pub(super) fn adapt_colours(
        &mut self,
        image: &ImageView<'_>,
        colour_model: &mut ColourModel,
        found: &FoundLines,
    ) {
        let config = &self.config.colours.adaptation;
        let detections = &found.detections;
        colour_model.image_count += 1;
        if !config.enabled
            || detections.colours_learned
            || !colour_model
                .image_count
                .is_multiple_of(config.interval_images.max(1))
        {
            return;
        }
        let input = AdaptationInput {
            image,
            samples: &self.carpet_samples,
            classes: &self.subsample_classes,
            line_points: &detections.line_points[..found.marking_points],
            carpet_end: &detections.carpet_end,
            model: &colour_model.carpet_model,
            centre_px: self.centre_px,
        };
        let changed = colour_model.adaptation.update(&input, config);
        if let Some(model) = changed {
            colour_model.lookup_table = self.build_lookup_table(
                colour_model.format,
                model,
                *colour_model.adaptation.prior(),
            );
            colour_model.chroma_table = self.build_chroma_table(colour_model.format, model);
            colour_model.channel_weights = quantize_weights(&model);
            colour_model.carpet_model = model;
            self.measure_noise(image, colour_model, found.lines);
            self.fill_lookup_table(image, &colour_model.lookup_table);
        }
    }

    /// Fills the cells of a new table that the next image will need before its pose is known: mostly those of this image.
    fn fill_lookup_table(&mut self, image: &ImageView<'_>, table: &ColourLookupTable) {
        let all = 0..image.height_px;
        let classes = &mut self.subsample_classes;
        self.subsample_classifier
            .classify_rows(image, table, &all, classes);
        self.radial_scan.read(image, table, &all);
    }

    /// `lines`: those whose brightness was read from the image.
    fn measure_noise(
        &mut self,
        image: &ImageView<'_>,
        colour_model: &mut ColourModel,
        lines: ScanLines,
    ) {
        self.classify_all_samples(image, &colour_model.lookup_table);
        colour_model.brightness_noise = self.estimate_noise(lines);
        peak_thresholds(
            &self.pattern,
            &colour_model.carpet_model,
            colour_model.brightness_noise,
            &self.config.lines,
            self.line_width,
            &mut self.peak_thresholds,
        );
    }

    /// Standard deviation of the brightness on plain carpet, from the median difference along scan lines (robust to edges).
    fn estimate_noise(&self, lines: ScanLines) -> f32 {
        let mut counts = [0u32; 256];
        let mut values = vec![0; self.pattern.longest_segment()];
        for segment in self.pattern.segments_of(lines) {
            let range = segment.samples();
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

/// Red, green, blue of a pixel in the camera's own channels.
fn to_rgb(native: [u8; 3], format: PixelFormat) -> [u8; 3] {
    match format.is_yuv() {
        true => yuv_to_rgb(native),
        false => native,
    }
}

/// Channel weights in 256ths that sum to 256.
fn quantize_weights(model: &CarpetModel) -> [u32; 3] {
    let weights = model.channel_weights();
    let [r, g, _] = weights.map(|weight| (256.0 * weight).round() as u32);
    [r, g, 256 - r - g]
}

/// 95th percentile of the pixels' brightest channel.
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

/// Colour of white: median over the line points of the higher contrast half.
fn estimate_white(image: &ImageView<'_>, mut points: Vec<LinePointDetection>) -> Option<[f32; 3]> {
    points.sort_by(|a, b| b.contrast.total_cmp(&a.contrast));
    points.truncate(points.len() / 2);
    let colours: Vec<[u8; 3]> = points
        .iter()
        .map(|point| {
            let [u, v] = point.position_px.map(|at| at.round().max(0.0) as usize);
            image.rgb(u, v)
        })
        .collect();
    median_colour(&colours)
}
