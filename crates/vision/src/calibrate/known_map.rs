//! Calibration of the ground map from the field's lines and a prior map.

use localize::Field;
use localize::robot::CameraConfig;

use crate::calibrate::CalibrationError;
use crate::calibrate::acceptance::{
    ensure_field_explains, ensure_halves_agree, ensure_most_images_count, is_doubtful,
};
use crate::calibrate::field_sizes::find_better_size;
use crate::calibrate::halves::compare_halves;
use crate::calibrate::lines::{LinesCalibration, NamedImage, fit_guess};
use crate::calibrate::map_continuation::continue_map;
use crate::calibrate::rival_fields::{
    ensure_no_scaled_field_fits_better, ensure_none_is_better, explained_share,
};
use crate::calibrate::two_robots::ensure_one_robot;
use crate::config::VisionConfig;
use crate::optics::ground_map::GroundMap;

/// Share of the work that is done after the fit, after its comparison by halves, and after that of fields; that of sizes is the last.
const FIT_WORK: f32 = 0.25;
const HALVES_WORK: f32 = 0.4;
const FIELDS_WORK: f32 = 0.8;

/// Calibrates the map from images anywhere on the field.
///
/// `start`: a prior map, may be a fifth off and end before the outermost lines. `other_fields`: named fields that must not
/// explain the images better. `progress` is called with the work done, 0 to 1. Errors if the images show another field, are of
/// two robots, or do not decide the map.
pub fn calibrate_lines(
    camera: &CameraConfig,
    start: &GroundMap,
    field: &Field,
    other_fields: &[(String, Field)],
    images: &[NamedImage],
    vision_config: &VisionConfig,
    progress: &(dyn Fn(f32) + Sync),
) -> Result<LinesCalibration, CalibrationError> {
    let calibrate = |start: &GroundMap| {
        let fit = |field: &Field| fit_guess(camera, start, field, images, vision_config);
        let mut found = fit(field)?;
        ensure_one_robot(images)?;
        progress(FIT_WORK);
        found.disagreement =
            compare_halves(camera, &found.map, field, images, vision_config, &found);
        progress(HALVES_WORK);
        if is_doubtful(&found) {
            ensure_no_field_fits_better(&found, other_fields, fit)?;
        }
        ensure_field_explains(&found)?;
        ensure_no_scaled_field_fits_better(
            &found,
            camera,
            field,
            other_fields,
            images,
            vision_config,
            &|done| progress(HALVES_WORK + (FIELDS_WORK - HALVES_WORK) * done),
        )?;
        ensure_halves_agree(found.disagreement).map_err(|refused| match refused {
            CalibrationError::Undecided(text) => CalibrationError::Undecided(format!(
                "{text}. If the initial map may be off by more than a fifth, or tilted, try --from-nothing"
            )),
            other => other,
        })?;
        found.better_size = find_better_size(&found, camera, field, images, vision_config);
        progress(1.0);
        ensure_most_images_count(found.used_count(), images.len(), found.disagreement)?;
        Ok(found)
    };
    match continue_map(start, camera) {
        // The continuation is a guess: images that do not confirm it may confirm the map alone.
        Some(continued) => calibrate(&continued).or_else(|_refused| calibrate(start)),
        None => calibrate(start),
    }
}

/// Refuses images that another field explains better. `fit`: the calibration on a field.
fn ensure_no_field_fits_better(
    found: &LinesCalibration,
    other_fields: &[(String, Field)],
    fit: impl Fn(&Field) -> Result<LinesCalibration, CalibrationError>,
) -> Result<(), CalibrationError> {
    let own = explained_share(found);
    // A field on which too few images find a place explains nothing.
    let others = other_fields
        .iter()
        .filter_map(|(name, other)| Some((name.as_str(), explained_share(&fit(other).ok()?))));
    let advice =
        ". If the field file is right, the initial map is of another mirror: try --from-nothing";
    ensure_none_is_better(own, others, advice)
}
