//! Line validation of a peak: width on the ground, carpet on both sides, contrast and colour.

use localize::frames::At;
use localize::sample::LinePoint;

use crate::colour::carpet_model::CarpetModel;
use crate::colour::lookup_table::{ColourClass, ColourLookupTable};
use crate::config::LineConfig;
use crate::image::ImageView;
use crate::lines::result::{LinePointDetection, RejectedCandidate, RejectionReason};
use crate::scan::flanks::Peak;
use crate::scan::pattern::ScanSample;

/// Validates peaks of one image.
pub(crate) struct LineValidator<'a> {
    pub(crate) image: &'a ImageView<'a>,
    pub(crate) lookup_table: &'a ColourLookupTable,
    pub(crate) carpet_model: &'a CarpetModel,
    pub(crate) config: &'a LineConfig,
    pub(crate) line_width: f32,
    /// Standard deviation of the brightness on plain carpet, levels.
    pub(crate) noise: f32,
    /// Range of the carpet's boundary along each ray, metres; see [`crate::objects::radial_scan`].
    pub(crate) carpet_end: &'a [f32],
    /// How far the model's white is that of the lines.
    pub(crate) white: WhiteKnowledge,
}

/// What is known of the lines' white.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum WhiteKnowledge {
    /// Its colour and brightness.
    Full,
    /// About how bright it is: what is brighter than the carpet on both sides may be a line, whatever its colour.
    Brightness,
    /// That it is brighter than the carpet.
    Nothing,
}

/// A segment of a scan line as read.
pub(crate) struct ScanLineSlice<'a> {
    /// Column and row of each sample.
    pub(crate) pixels: &'a [[u16; 2]],
    /// Ground point of each sample, robot frame, metres.
    pub(crate) ground: &'a [[f32; 2]],
    pub(crate) values: &'a [u8],
}

impl ScanLineSlice<'_> {
    fn sample_px(&self, index: usize) -> [f32; 2] {
        self.pixels[index].map(f32::from)
    }

    fn interpolate_px(&self, index: f32) -> [f32; 2] {
        let (a, b, part) = bracket(self.pixels, index);
        let mix = |a: u16, b: u16| f32::from(a) + part * (f32::from(b) - f32::from(a));
        [mix(a[0], b[0]), mix(a[1], b[1])]
    }

    pub(crate) fn reject(&self, peak: &Peak, reason: RejectionReason) -> RejectedCandidate {
        RejectedCandidate {
            position_px: self.sample_px(peak.index),
            reason,
        }
    }

    /// A sample's column and row.
    fn sample_pixel(&self, index: usize) -> [usize; 2] {
        self.pixels[index].map(usize::from)
    }

    pub(crate) fn interpolate_ground(&self, index: f32) -> [f32; 2] {
        let (a, b, part) = bracket(self.ground, index);
        std::array::from_fn(|i| a[i] + part * (b[i] - a[i]))
    }
}

/// The entries before and after an index between samples, and the part of the way to the second.
fn bracket<T: Copy>(entries: &[T], index: f32) -> (T, T, f32) {
    let last = entries.len() - 1;
    let lower = (index.max(0.0) as usize).min(last);
    let upper = (lower + 1).min(last);
    let part = (index - lower as f32).clamp(0.0, 1.0);
    (entries[lower], entries[upper], part)
}

/// What the tables of the scan pattern hold for a peak.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PeakGround {
    /// The sample at its middle.
    pub(crate) middle: ScanSample,
    /// Ground points of its edges, robot frame, metres.
    pub(crate) edges: [[f32; 2]; 2],
}

/// A peak projected to the ground.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LineCandidate {
    point: LinePoint,
    /// Metres along the scan line.
    width: f32,
    /// Ground that one sample covers along the scan line, metres.
    sample_footprint: f32,
}

impl LineValidator<'_> {
    /// Projects a peak to the ground; rejects it beyond the carpet or with a wrong width.
    pub(crate) fn project_candidate(
        &self,
        peak: &Peak,
        ground: &PeakGround,
    ) -> Result<LineCandidate, RejectionReason> {
        let PeakGround {
            middle: sample,
            edges: [left, right],
        } = ground;
        if is_beyond_carpet(self.carpet_end, sample) {
            return Err(RejectionReason::BeyondCarpet);
        }
        let (dx, dy) = (right[0] - left[0], right[1] - left[1]);
        let width = (dx * dx + dy * dy).sqrt();
        let width_px = (peak.right_edge - peak.left_edge).max(1e-3);
        // Sampling narrows a peak by a fraction of a pixel; blur widens it by more.
        let pixel = width / width_px.max(1.0);
        if width < self.config.width_ratio_min * self.line_width - pixel / 3.0 {
            return Err(RejectionReason::TooNarrow);
        }
        if width > self.config.width_ratio_max * self.line_width + 1.5 * pixel {
            return Err(RejectionReason::TooWide);
        }
        Ok(LineCandidate {
            point: LinePoint {
                at: At::new((left[0] + right[0]) / 2.0, (left[1] + right[1]) / 2.0),
                std_radial: self.config.position_std_px * sample.radial_footprint,
                std_tangential: self.config.position_std_px * sample.tangential_footprint,
            },
            width,
            sample_footprint: pixel,
        })
    }

    /// Checks adjacent carpet, contrast and colour of a projected peak.
    pub(crate) fn validate_candidate(
        &self,
        line: &ScanLineSlice<'_>,
        peak: &Peak,
        candidate: &LineCandidate,
    ) -> Result<LinePointDetection, RejectionReason> {
        let left_base = self.find_adjacent_carpet(line, peak, peak.left_base, -1);
        let right_base = self.find_adjacent_carpet(line, peak, peak.right_base, 1);
        let (Some(left_base), Some(right_base)) = (left_base, right_base) else {
            return Err(RejectionReason::NoAdjacentCarpet);
        };
        let peak = &Peak {
            left_base,
            right_base,
            ..*peak
        };
        let colours = PeakColours::measure(self.image, line, peak);
        if !self.has_line_contrast(line, peak, &colours, candidate.sample_footprint) {
            return Err(RejectionReason::TooFaint);
        }
        if !self.is_white(&colours) {
            return Err(RejectionReason::NotWhite);
        }
        Ok(LinePointDetection {
            point: candidate.point,
            position_px: line.interpolate_px(peak.middle()),
            contrast: peak.contrast,
            width: candidate.width,
        })
    }

    /// Start of the carpet outward of a base: the first of two carpet samples within the peak's blurred edge.
    fn find_adjacent_carpet(
        &self,
        line: &ScanLineSlice<'_>,
        peak: &Peak,
        base: usize,
        outward: isize,
    ) -> Option<usize> {
        let carpet = |step: usize| {
            let index = base.checked_add_signed(outward * step as isize)?;
            let [u, v] = line.pixels.get(index)?.map(usize::from);
            let native = self.image.native_channels(u, v);
            (self.lookup_table.class(native) == ColourClass::CARPET).then_some(index)
        };
        let reach = 1 + (peak.right_edge - peak.left_edge) as usize / 4;
        (0..=reach).find_map(|step| carpet(step).filter(|_| carpet(step + 1).is_some()))
    }

    /// True if the contrast exceeds the noise and is at least that of a line at this place.
    ///
    /// A line several pixels wide has the full contrast of white, reduced by glare. A line thinner than the image's blur
    /// (`blur_px`) has this contrast times width over blur.
    fn has_line_contrast(
        &self,
        line: &ScanLineSlice<'_>,
        peak: &Peak,
        colours: &PeakColours,
        pixel: f32,
    ) -> bool {
        let mean = |from: usize, to: usize| {
            let to = to.min(line.values.len() - 1);
            let sum: u32 = line.values[from..=to].iter().map(|&v| u32::from(v)).sum();
            sum as f32 / (to - from + 1) as f32
        };
        let left = mean(peak.left_base.saturating_sub(2), peak.left_base);
        let right = mean(
            peak.right_base.min(line.values.len() - 1),
            peak.right_base + 2,
        );
        let carpet_level = left.max(right);
        let contrast = mean(colours.first, colours.last) - carpet_level;
        let count = (colours.last - colours.first + 1) as f32;
        if contrast < self.config.contrast_sigma_min * self.noise * (1.0 / count + 1.0 / 3.0).sqrt()
        {
            return false;
        }
        if self.white == WhiteKnowledge::Nothing {
            return true;
        }
        let [carpet_light, ..] = self
            .carpet_model
            .chroma_coordinates(self.carpet_model.carpet);
        let [carpet_light_here, ..] = self.carpet_model.chroma_coordinates(colours.carpet_mean);
        let shading = (carpet_light_here / carpet_light.max(1e-6)).clamp(0.3, 1.5);
        let contrast_full = (shading * white_contrast(self.carpet_model)).min(255.0 - carpet_level);
        let blur_factor = (self.line_width / (pixel * self.config.blur_px)).min(1.0);
        contrast >= self.config.white_share_min * blur_factor * contrast_full
    }

    /// True if the peak adds light of the lamp's colour to the adjacent carpet.
    fn is_white(&self, colours: &PeakColours) -> bool {
        if self.carpet_model.is_grey() || self.white != WhiteKnowledge::Full {
            return true;
        }
        let [carpet_light, carpet_along, carpet_across] =
            self.carpet_model.chroma_coordinates(colours.carpet_mean);
        let [top_light, top_along, top_across] =
            self.carpet_model.chroma_coordinates(colours.peak_mean);
        let light = top_light - carpet_light;
        if light <= 0.0 {
            return false;
        }
        // Chroma noise of two carpet samples and the peak, in units of the carpet's chroma.
        let white = self.carpet_model.white.iter().sum::<f32>() / 3.0;
        let count = (colours.last - colours.first + 1) as f32;
        let noise =
            self.noise / white / self.carpet_model.carpet_chroma() * (0.5 + 1.0 / count).sqrt();
        let slack = self.config.hue_tolerance * light / self.carpet_model.carpet_chroma().min(1.0)
            + 2.0 * noise;
        // Brighter carpet has more of the carpet's chroma, a line has less; a ball or marker has the opposite hue.
        let brighter = carpet_along * (1.0 + 0.5 * light / carpet_light.max(1e-6));
        (top_across - carpet_across).abs() <= slack
            && top_along <= brighter + 2.0 * noise
            && top_along >= -slack
    }
}

/// Mean colours of a peak and of the adjacent carpet.
struct PeakColours {
    /// First and last sample between the edges.
    first: usize,
    last: usize,
    peak_mean: [f32; 3],
    carpet_mean: [f32; 3],
}

impl PeakColours {
    fn measure(image: &ImageView<'_>, line: &ScanLineSlice<'_>, peak: &Peak) -> Self {
        let colour = |index: usize| {
            let [u, v] = line.sample_pixel(index);
            image.rgb(u, v).map(f32::from)
        };
        let (left, right) = (colour(peak.left_base), colour(peak.right_base));
        let end = line.pixels.len() - 1;
        let first = (peak.left_edge.ceil() as usize).min(peak.index);
        let last = (peak.right_edge.floor() as usize).clamp(peak.index, end);
        let count = (last - first + 1) as f32;
        let mut top = [0.0f32; 3];
        for index in first..=last {
            let rgb = colour(index);
            for i in 0..3 {
                top[i] += rgb[i] / count;
            }
        }
        PeakColours {
            first,
            last,
            peak_mean: top,
            carpet_mean: std::array::from_fn(|i| (left[i] + right[i]) / 2.0),
        }
    }
}

/// Weighted brightness of white minus that of the carpet, levels.
pub(crate) fn white_contrast(model: &CarpetModel) -> f32 {
    let weights = model.channel_weights();
    (0..3)
        .map(|i| weights[i] * (model.white[i] - model.carpet[i]))
        .sum()
}

/// True if the carpet ends before this sample along both adjacent rays.
pub(crate) fn is_beyond_carpet(carpet_end: &[f32], sample: &ScanSample) -> bool {
    let place = sample.azimuth_turns * carpet_end.len() as f32;
    let lower = place as usize % carpet_end.len();
    let upper = (lower + 1) % carpet_end.len();
    sample.range > carpet_end[lower].max(carpet_end[upper])
}
