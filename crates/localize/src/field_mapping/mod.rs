//! Which lines and arcs does a floor have? A map of an unknown line pattern from one drive (docs/methods.md 18).
//!
//! Wheels place the images roughly. `registration` matches each keyframe's line points to the points of the others,
//! `pose_graph` moves all keyframes and corrects the wheels until points and wheels agree, `elements` averages the points,
//! `shapes` fits lines and arcs to them, `layout` turns them into a field.

mod config;
mod copies;
mod elements;
mod error;
mod fit;
mod junctions;
mod keyframes;
mod layout;
mod map_motion;
mod point_map;
mod pose_graph;
mod registration;
mod shape;
mod shapes;

use keyframes::Keyframe;
use pose_graph::OdometryCorrection;

use crate::field::FieldConfig;
use crate::frames::Pose;

pub use config::FieldMappingConfig;
pub use error::FieldMappingError;
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
    /// Lines with a longer parallel one close beside them: mostly one line that was mapped twice.
    pub copies: usize,
    /// Arcs that are too short to tell centre and radius, left out.
    pub uncertain_arcs: usize,
}

/// The keyframes of a drive on one map.
struct Placed {
    keyframes: Vec<Keyframe>,
    correction: OdometryCorrection,
    revisits: usize,
    /// Of the points over small cells.
    entropy: f32,
}

/// By how much more compact the map with slipping wheels must be: a tenth fewer cells.
const ENTROPY_ADVANTAGE: f32 = 0.1;

/// Maps the markings that a drive passed. Images in the order of time.
pub fn map_field(
    images: &[MappingImage],
    config: &FieldMappingConfig,
) -> Result<MappedField, FieldMappingError> {
    let selected = keyframes::select(images, config)?;
    let [rolling, slipping] = config
        .corrected_odometry_noise
        .map(|wheel_noise| place(selected.clone(), wheel_noise, config));
    // Poses that the wheels hold less follow the noise of the points, which makes a map a little more compact too.
    let is_slipping = slipping.entropy + ENTROPY_ADVANTAGE < rolling.entropy;
    let Placed {
        keyframes,
        correction,
        revisits,
        ..
    } = if is_slipping { slipping } else { rolling };
    let elements = elements::average(&keyframes, config);
    let (shapes, uncertain_arcs) = shapes::find(&elements, config);
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
        copies: copies::count(&shapes),
        uncertain_arcs,
    })
}

/// Places the keyframes of a drive, with wheels of this noise after their correction.
fn place(mut keyframes: Vec<Keyframe>, wheel_noise: f32, config: &FieldMappingConfig) -> Placed {
    let mut correction = registration::place_in_order(&mut keyframes, wheel_noise, config);
    let mut revisits = 0;
    for sweep in 0..config.sweeps {
        let share = sweep as f32 / (config.sweeps - 1).max(1) as f32;
        let reach = config.reach_first + (config.reach_last - config.reach_first) * share;
        revisits = registration::relax(&mut keyframes, &mut correction, reach, wheel_noise, config);
    }
    Placed {
        entropy: elements::entropy(&keyframes, config),
        keyframes,
        correction,
        revisits,
    }
}

#[cfg(test)]
mod tests;
