//! Colours of carpet and white under the present light.

use crate::colour::adaptation::ColourAdaptation;
use crate::colour::carpet_model::CarpetModel;
use crate::colour::lookup_table::ColourLookupTable;
use crate::image::PixelFormat;

/// Colours under one light, and the lookup table derived from them.
#[derive(Debug, Clone)]
pub(super) struct ColourModel {
    pub(super) carpet_model: CarpetModel,
    pub(super) lookup_table: ColourLookupTable,
    /// The same where brightness decides, but what has another chroma is no carpet; for the search for balls. None elsewhere.
    pub(super) chroma_table: Option<ColourLookupTable>,
    /// Channel weights that separate white from carpet, of 256.
    pub(super) channel_weights: [u32; 3],
    /// Standard deviation of the weighted brightness on plain carpet, levels.
    pub(super) brightness_noise: f32,
    /// Fraction of the scanned pixels that were carpet when the model was learned.
    pub(super) learned_carpet_share: f32,
    pub(super) format: PixelFormat,
    pub(super) adaptation: ColourAdaptation,
    /// Images processed with this model.
    pub(super) image_count: u32,
}
