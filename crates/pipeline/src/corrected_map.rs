//! Which ground map did the robot end up with? The setup's map with what localization learned about its errors.

use std::path::Path;

use anyhow::{Context, Result, bail};
use localize::map_correction::{MapCorrection, MapCorrectionEstimate, TermKind};
use vision::{GroundMap, Mount, optics};

use crate::pipeline::Pipeline;
use crate::setup::Setup;

/// The setup's ground map under a correction. None without a camera.
///
/// The map of a known mirror is traced again with the estimated mounting, so that every ring of the mirror is right.
pub fn corrected_map(setup: &Setup, correction: &MapCorrection) -> Result<Option<GroundMap>> {
    let Some((camera, map)) = &setup.camera else {
        return Ok(None);
    };
    let Some(profile) = &setup.traced_mirror else {
        return Ok(Some(correct_points(map, correction)));
    };
    let estimate = correction.estimate();
    let value = |kind| f64::from(value_of(&estimate, kind));
    let mount = Mount {
        mirror_tilt_deg: [TermKind::MirrorTiltX, TermKind::MirrorTiltY]
            .map(|kind| value(kind).to_degrees()),
        mirror_offset: [TermKind::MirrorOffsetX, TermKind::MirrorOffsetY].map(value),
        ..Mount::default()
    };
    let mut camera = camera.clone();
    let zoom = 1.0 + value_of(&estimate, TermKind::FocalLength);
    camera.focal_px = camera.focal_px.map(|focal| focal * zoom);
    let rays = optics::trace_rays(&camera, profile, &mount)
        .context("cannot trace the mirror with the estimated mounting")?;
    let mut map = rays.ground_map();
    // A higher viewpoint sees every point farther away in proportion.
    let height = correction.basis().height();
    let stretch = 1.0 + value_of(&estimate, TermKind::Height) / height;
    for value in map.x.iter_mut().chain(&mut map.y) {
        *value *= stretch;
    }
    Ok(Some(map))
}

fn value_of(estimate: &MapCorrectionEstimate, kind: TermKind) -> f32 {
    let term = estimate.terms.iter().find(|term| term.kind == kind);
    term.map_or(0.0, |term| term.value)
}

/// Each ground point of a map under a correction.
fn correct_points(map: &GroundMap, correction: &MapCorrection) -> GroundMap {
    let mut corrected = map.clone();
    for row in 0..map.height_px {
        for column in 0..map.width_px {
            if let Some(at) = map.at(column, row) {
                let at = correction.correct_point(at);
                let index = row * map.width_px + column;
                (corrected.x[index], corrected.y[index]) = (at.x, at.y);
            }
        }
    }
    corrected
}

/// Writes the corrected ground map (npz).
pub fn save(setup: &Setup, pipeline: &Pipeline, path: &Path) -> Result<()> {
    if setup.camera.is_none() {
        bail!("no map to save: robot.toml has no [camera]");
    }
    let Some(correction) = pipeline.map_correction() else {
        bail!("no map to save: localize.map_correction.enabled is false");
    };
    let map = corrected_map(setup, correction)?.context("no map to save")?;
    Ok(map.save(path)?)
}
