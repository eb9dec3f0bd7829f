//! Which lines and arcs does a floor have? A map of an unknown line pattern from one drive (docs/methods.md 18).
//!
//! Wheels place the images roughly. `registration` matches each keyframe's line points to the points of the others,
//! `pose_graph` moves all keyframes and corrects the wheels until points and wheels agree, `elements` averages the points,
//! `shapes` fits lines and arcs to them, `layout` turns them into a field.

mod config;
mod elements;
mod fit;
mod junctions;
mod keyframes;
mod layout;
mod point_map;
mod pose_graph;
mod registration;
mod shapes;

use crate::field::FieldConfig;
use crate::frames::{FieldFrame, Pose, Tf};
use crate::sample::LinePoint;

pub use config::FieldMappingConfig;
pub use keyframes::MappingImage;

/// A field that was mapped from a drive.
#[derive(Debug, Clone, PartialEq)]
pub struct MappedField {
    /// Lines and arcs with their standard deviations.
    pub config: FieldConfig,
    /// The robot's pose at each keyframe, on the mapped field.
    pub poses: Vec<Pose>,
    /// Number of the image with which each keyframe begins.
    pub keyframe_images: Vec<usize>,
    /// Matrix from the wheels' measured motion (x, y, θ) to the true one.
    pub odometry_correction: [[f32; 3]; 3],
    /// Share of the line points on the lines and arcs found.
    pub explained_share: f32,
    /// Root mean square distance of these points from them, metres.
    pub residual: f32,
    /// Keyframes that see markings which were first seen much earlier: the loops that hold the map together.
    pub revisits: usize,
}

/// Why a drive yields no field.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum FieldMappingError {
    /// Too few images with line points.
    #[error("too few images with line points: {0} (expected at least {1}). Record a longer drive")]
    FewImages(usize, usize),
    /// The robot did not move.
    #[error("the wheels report no motion: a map needs a drive of several metres past the lines")]
    NoMotion,
    /// No line or arc.
    #[error(
        "no line or arc found in the line points of {0} images (expected straight pieces of at least half a metre)"
    )]
    NoMarkings(usize),
}

/// Maps the markings that a drive passed. Images in the order of time.
pub fn map_field(
    images: &[MappingImage],
    config: &FieldMappingConfig,
) -> Result<MappedField, FieldMappingError> {
    let mut keyframes = keyframes::select(images, config)?;
    let mut correction = registration::place_in_order(&mut keyframes, config);
    let mut revisits = 0;
    for sweep in 0..config.sweeps {
        let share = sweep as f32 / (config.sweeps - 1).max(1) as f32;
        let reach = config.reach_first + (config.reach_last - config.reach_first) * share;
        revisits = registration::relax(&mut keyframes, &mut correction, reach, config);
    }
    let elements = elements::average(&keyframes, config);
    let shapes = shapes::find(&elements, config);
    if shapes.is_empty() {
        return Err(FieldMappingError::NoMarkings(images.len()));
    }
    let (field, field_from_map) = layout::lay_out(&shapes, config);
    let (explained_share, residual) = shapes::explained(&shapes, &elements, config);
    Ok(MappedField {
        poses: keyframes
            .iter()
            .map(|keyframe| field_from_map * keyframe.pose)
            .collect(),
        keyframe_images: keyframes
            .iter()
            .map(|keyframe| keyframe.first_image)
            .collect(),
        odometry_correction: correction.rows(),
        config: field,
        explained_share,
        residual,
        revisits,
    })
}

/// A rigid motion of the map.
pub(crate) type MapMotion = Tf<FieldFrame, FieldFrame>;

/// Is a point fit for mapping?
fn is_usable(point: &LinePoint, config: &FieldMappingConfig) -> bool {
    let range = point.at.distance();
    point.at.x.is_finite()
        && point.at.y.is_finite()
        && range <= config.range_max
        && point.std_radial.is_finite()
        && point.std_tangential.is_finite()
}

#[cfg(test)]
mod tests;
