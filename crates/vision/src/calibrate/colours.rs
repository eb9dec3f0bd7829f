//! Colour table from images without labels.
//!
//! Carpet and white are learned from each image as in play, and each model votes for the class of every colour. For a
//! table over U and V, the images' colour counts decide between brightnesses.

use rayon::prelude::*;

use crate::calibrate::{CalibrationError, ImageResidual, NamedImage};
use crate::colour::carpet_model::CarpetModel;
use crate::colour::colour_table::{ColourTable, TableKind};
use crate::colour::lookup_table::{CLASS_NAMES, ColourClass};
use crate::config::VisionConfig;
use crate::image::{rgb_to_yuv, yuv_to_rgb};
use crate::process::Vision;

/// Colour models of several images.
#[derive(Debug, Clone)]
pub struct LearnedColours {
    /// Carpet and white of each used image.
    pub models: Vec<CarpetModel>,
    /// Residual of each image: `points` are its line points, `rms_px` is 0.
    pub images: Vec<ImageResidual>,
    /// Number of pixels of each colour, by the upper six bits of Y, U and V.
    counts: Vec<u32>,
}

/// Cells of six bits per channel.
const CELLS: usize = 1 << 18;
/// Weight of a colour that no image shows, pixels.
const UNOBSERVED_WEIGHT: f32 = 0.05;

/// Learns carpet and white from images without labels; unusable images are excluded, with the reason.
pub fn learn_colours(
    vision: &mut Vision,
    images: &[NamedImage],
) -> Result<LearnedColours, CalibrationError> {
    let mut learned = LearnedColours {
        models: Vec::new(),
        images: Vec::new(),
        counts: vec![0; CELLS],
    };
    for image in images {
        vision.reset_colour_model();
        let view = image.image.view();
        let (points, left_out) = match vision.process(&view) {
            Err(error) => (0, Some(error.to_string())),
            Ok(detections) => {
                let white_measured = vision
                    .carpet_model()
                    .is_some_and(|model| model.white_measured);
                let reason = (!white_measured).then(|| "too few lines to measure white".to_owned());
                (detections.line_points.len(), reason)
            }
        };
        if let (None, Some(model)) = (&left_out, vision.carpet_model()) {
            learned.models.push(*model);
            for rgb in image.image.rgb.chunks_exact(3) {
                learned.counts[cell(rgb_to_yuv([rgb[0], rgb[1], rgb[2]]))] += 1;
            }
        }
        learned.images.push(ImageResidual {
            name: image.name.clone(),
            points,
            rms_px: 0.0,
            left_out,
        });
    }
    if learned.models.is_empty() {
        let reasons = learned.images.iter().filter_map(|image| {
            let reason = image.left_out.as_ref()?;
            Some(format!("{}: {reason}", image.name))
        });
        return Err(CalibrationError::TooFewImages {
            used: 0,
            total: images.len(),
            required: 1,
            reasons: reasons.take(3).collect::<Vec<_>>().join("; "),
        });
    }
    Ok(learned)
}

fn cell([y, u, v]: [u8; 3]) -> usize {
    usize::from(y >> 2) << 12 | usize::from(u >> 2) << 6 | usize::from(v >> 2)
}

impl LearnedColours {
    /// Builds the table over all colours, or over U and V only.
    pub fn table(&self, kind: TableKind, config: &VisionConfig) -> ColourTable {
        let names: Vec<String> = CLASS_NAMES.map(str::to_owned).to_vec();
        let cells: Vec<u8> = (0..CELLS)
            .into_par_iter()
            .map(|index| self.vote_class(index, config))
            .collect();
        let classes = match kind {
            TableKind::Yuv => (0..1usize << 24)
                .map(|index| cells[cell([(index >> 16) as u8, (index >> 8) as u8, index as u8])])
                .collect(),
            TableKind::Uv => {
                let flat: Vec<u8> = (0..1usize << 12)
                    .map(|chroma| self.majority_class_over_brightness(chroma, &cells))
                    .collect();
                let fine = 0..1usize << 16;
                fine.map(|index| flat[(index >> 10) << 6 | (index & 0xff) >> 2])
                    .collect()
            }
        };
        ColourTable::from_classes(kind, names, classes)
    }

    /// Majority class of a cell's centre over all models.
    fn vote_class(&self, index: usize, config: &VisionConfig) -> u8 {
        let middle = |shift: usize| ((index >> shift & 63) << 2 | 2) as u8;
        let rgb = yuv_to_rgb([middle(12), middle(6), middle(0)]);
        let mut votes = [0u32; CLASS_NAMES.len()];
        for model in &self.models {
            let ColourClass(class) =
                model.classify(rgb, &config.colours, config.objects.ball_hue_deg);
            votes[usize::from(class)] += 1;
        }
        argmax(&votes)
    }

    /// Majority class of a chroma over all brightnesses, weighted by pixel counts.
    fn majority_class_over_brightness(&self, chroma: usize, cells: &[u8]) -> u8 {
        let mut votes = [0f32; CLASS_NAMES.len()];
        for y in 0..64 {
            let index = y << 12 | chroma;
            votes[usize::from(cells[index])] += UNOBSERVED_WEIGHT + self.counts[index] as f32;
        }
        argmax(&votes)
    }
}

/// Index of the first maximum.
fn argmax<T: PartialOrd + Copy>(votes: &[T]) -> u8 {
    let mut best = 0;
    for (class, count) in votes.iter().enumerate() {
        if *count > votes[best] {
            best = class;
        }
    }
    best as u8
}
