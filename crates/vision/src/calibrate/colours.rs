//! What do the colours mean, if nobody labelled any? A table from images alone.
//!
//! In each image carpet and white are learned as while playing; the model of each then votes for every colour. What the
//! images really show decides where brightness is not looked at.

use rayon::prelude::*;

use crate::calibrate::{CalibrationError, ImageResidual, NamedImage};
use crate::colour::carpet_model::CarpetModel;
use crate::colour::colour_table::{ColourTable, TableKind};
use crate::colour::lookup_table::{CLASS_NAMES, ColourClass};
use crate::config::VisionConfig;
use crate::image::{rgb_to_yuv, yuv_to_rgb};
use crate::process::Vision;

/// The lights of some images, from which tables are made.
#[derive(Debug, Clone)]
pub struct LearnedColours {
    /// Carpet and white in each image that was used.
    pub models: Vec<CarpetModel>,
    /// How each image went: `points` are its line points, `rms_px` is 0.
    pub images: Vec<ImageResidual>,
    /// How many pixels have each colour, by the upper six bits of Y, U and V.
    counts: Vec<u32>,
}

/// Cells of six bits a channel.
const CELLS: usize = 1 << 18;
/// What a colour that no image shows counts beside those that are shown, pixels.
const UNOBSERVED_WEIGHT: f32 = 0.05;

/// Learns carpet and white from images without labels; those in which nothing can be told are left out and named.
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
                let reason = (!white_measured).then(|| "too few lines to tell white by".to_owned());
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
    /// The table over all colours, or over U and V alone.
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

    /// What most lights say of the colour in the middle of a cell.
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

    /// What most pixels of a chroma are, over all brightnesses.
    fn majority_class_over_brightness(&self, chroma: usize, cells: &[u8]) -> u8 {
        let mut votes = [0f32; CLASS_NAMES.len()];
        for y in 0..64 {
            let index = y << 12 | chroma;
            votes[usize::from(cells[index])] += UNOBSERVED_WEIGHT + self.counts[index] as f32;
        }
        argmax(&votes)
    }
}

/// The first of the classes with most votes.
fn argmax<T: PartialOrd + Copy>(votes: &[T]) -> u8 {
    let mut best = 0;
    for (class, count) in votes.iter().enumerate() {
        if *count > votes[best] {
            best = class;
        }
    }
    best as u8
}
