//! Does another known field explain the images better? A lower mirror over a smaller field of the same shape shows nearly the
//! same, so the map that was found is tried on each other field, scaled to the size of the given one: residuals and their
//! limits are then of one scale.

use localize::Field;
use localize::robot::CameraConfig;

use crate::calibrate::CalibrationError;
use crate::calibrate::acceptance::{BETTER_FIELD_ODDS, odds};
use crate::calibrate::lines::{IMAGES_MIN, LinesCalibration, NamedImage, fit_guess};
use crate::config::VisionConfig;

/// Images of the comparison, evenly over those that the map explains.
const COMPARED_IMAGES: usize = 24;

/// Mean costs are compared in standard errors of their difference over the images.
const ERRORS_APART: f64 = 2.0;

/// Standard error of a mean cost from the fit itself: fields of one shape differ by nothing else.
const FIT_ERROR: f64 = 0.02;

/// Refuses a calibration if the map explains the same images better on one of the other fields, scaled.
///
/// `found`: the calibration of `images` on `field`, by `camera`. `other_fields`: named. `progress`: called with the work
/// done, 0 to 1.
pub(super) fn ensure_no_scaled_field_fits_better(
    found: &LinesCalibration,
    camera: &CameraConfig,
    field: &Field,
    other_fields: &[(String, Field)],
    images: &[NamedImage],
    vision_config: &VisionConfig,
    progress: &(dyn Fn(f32) + Sync),
) -> Result<(), CalibrationError> {
    let compared = compared_images(found, images);
    let fit = |field: &Field| fit_guess(camera, &found.map, field, &compared, vision_config);
    // A field on which too few images find a place explains nothing.
    let Ok(own) = fit(field) else {
        return Ok(());
    };
    let others = other_fields.iter().filter(|(_, other)| other != field);
    let better = others.enumerate().filter_map(|(tried, (name, other))| {
        progress((1 + tried) as f32 / (1 + other_fields.len()) as f32);
        let factor = size(field) / size(other);
        let scaled = Field::new(other.config.scaled(factor)).ok()?;
        let other = fit(&scaled).ok()?;
        // Costs of some images are less by chance where a map fits neither field.
        let explains_more = explained_share(&other) > explained_share(&own);
        let better = explains_more && is_cheaper(&other.costs, &own.costs);
        better.then(|| (name, explained_share(&other), factor))
    });
    match better.max_by(|a, b| a.1.total_cmp(&b.1)) {
        Some((name, other, factor)) => {
            let advice = format!(
                " (scaled by {factor:.2} to the size of this one). Use it, or measure the field"
            );
            Err(wrong_field(explained_share(&own), name, other, &advice))
        }
        None => Ok(()),
    }
}

/// Those of the used images that stand for all in a comparison.
pub(super) fn compared_images(found: &LinesCalibration, images: &[NamedImage]) -> Vec<NamedImage> {
    let used = found.used(images);
    let step = used.len().div_ceil(COMPARED_IMAGES).max(1);
    used.into_iter().step_by(step).cloned().collect()
}

/// True if the costs of images are less than other costs of the same images by more than chance. NaN: not fitted.
pub(super) fn is_cheaper(costs: &[f64], than: &[f64]) -> bool {
    let savings: Vec<f64> = costs
        .iter()
        .zip(than)
        .map(|(cost, than)| than - cost)
        .filter(|saving| saving.is_finite())
        .collect();
    if savings.len() < IMAGES_MIN {
        return false;
    }
    let count = savings.len() as f64;
    let mean = savings.iter().sum::<f64>() / count;
    let squares: f64 = savings.iter().map(|saving| (saving - mean).powi(2)).sum();
    let variance = squares / (count - 1.0) / count + FIT_ERROR * FIT_ERROR;
    mean > ERRORS_APART * variance.sqrt()
}

/// Refuses a share of points on markings if that on another field is better by far. `advice`: appended to the message.
pub(super) fn ensure_none_is_better<'a>(
    own: f64,
    others: impl Iterator<Item = (&'a str, f64)>,
    advice: &str,
) -> Result<(), CalibrationError> {
    match others.max_by(|a, b| a.1.total_cmp(&b.1)) {
        Some((name, other)) if odds(other) > BETTER_FIELD_ODDS * odds(own) => {
            Err(wrong_field(own, name, other, advice))
        }
        _ => Ok(()),
    }
}

fn wrong_field(own: f64, name: &str, other: f64, advice: &str) -> CalibrationError {
    CalibrationError::WrongField {
        share_percent: (100.0 * own) as u32,
        hint: format!("{name} fits better, with {:.0} %{advice}", 100.0 * other),
        is_known: true,
    }
}

/// Share of the line points of all images that a calibration puts on markings.
pub(super) fn explained_share(found: &LinesCalibration) -> f64 {
    let points = |used_only: bool| {
        let images = found.images.iter();
        let counted = images.filter(|image| !used_only || image.left_out.is_none());
        counted.map(|image| image.points as f64).sum::<f64>()
    };
    found.inlier_share * points(true) / points(false).max(1.0)
}

/// Side of the square with a field's area, metres.
fn size(field: &Field) -> f32 {
    (field.config.length * field.config.width).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use localize::field::FieldConfig;

    #[test]
    fn only_costs_that_differ_by_more_than_chance_count() {
        let own = [0.9, 0.7, 1.2, 0.8, 0.6];
        let less = |savings: [f64; 5]| [0, 1, 2, 3, 4].map(|i| own[i] - savings[i]);
        assert!(is_cheaper(&less([0.1, 0.2, 0.15, 0.1, 0.3]), &own));
        assert!(!is_cheaper(&less([-0.1, -0.2, -0.15, -0.1, -0.3]), &own));
        // One image decides nothing.
        assert!(!is_cheaper(&less([0.0, 0.0, 0.0, 0.0, 0.9]), &own));
        // The same field in another size: rounding saves the same in each image.
        assert!(!is_cheaper(&less([1e-6; 5]), &own));
        let unfitted = f64::NAN;
        let three = [0.1, 0.2, 0.15, unfitted, unfitted];
        assert!(!is_cheaper(&less(three), &own));
    }

    #[test]
    fn field_of_another_size_scales_to_the_same_markings() {
        let config = FieldConfig {
            extra_arcs: vec![[1.0, 0.0, 0.5, 10.0, 90.0]],
            ..FieldConfig::without_markings([18.0, 12.0], 0.125, 1.0)
        };
        let twice = config.scaled(2.0);
        assert_eq!(twice.extra_arcs, [[2.0, 0.0, 1.0, 10.0, 90.0]]);
        assert_eq!(twice.scaled(0.5), config);
    }
}
