//! A cycle as the view shows it, with its image decoded.

use std::sync::Arc;

use localize::Pose;
use vision::image::Image;

use pipeline::Cycle;
use pipeline::sample::SourceImage;

/// A cycle with its image decoded.
#[derive(Debug, Clone)]
pub(crate) struct DecodedCycle {
    /// Inputs and results.
    pub(crate) cycle: Arc<Cycle>,
    /// Particles of the global search; empty if it is not running or the source does not provide them.
    pub(crate) particles: Vec<Pose>,
}

impl DecodedCycle {
    /// Converts a raw camera image to RGB, in the delivering thread.
    pub(crate) fn new(mut cycle: Arc<Cycle>, particles: Vec<Pose>) -> Self {
        if let Some(SourceImage::Raw(_)) = &cycle.inputs.image {
            let cycle = Arc::make_mut(&mut cycle);
            let rgb = cycle.inputs.image.as_ref().and_then(SourceImage::to_rgb);
            cycle.inputs.image = rgb.map(SourceImage::Rgb);
        }
        DecodedCycle { cycle, particles }
    }
}

/// The RGB image of a cycle.
pub(crate) fn rgb_image(cycle: &Cycle) -> Option<&Arc<Image>> {
    match &cycle.inputs.image {
        Some(SourceImage::Rgb(image)) => Some(image),
        _ => None,
    }
}
