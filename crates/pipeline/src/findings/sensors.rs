//! When do the wheels slip, when does the light change, when is the map off?

use localize::math;

use super::moments::plain_findings;
use super::poses::WRONG_BY;
use super::record::CycleRecord;
use super::{Finding, FindingKind};

/// Light is compared with that of this time before, seconds.
const LIGHT_CHANGE: f64 = 1.5;
/// Ratio of the two from which on the change is a finding.
const LIGHT_RATIO: f64 = 1.5;
/// Exponent of the tone curve: sRGB's is close to a power of 2.2.
const TONE_EXPONENT: f64 = 2.2;
/// Standard deviations from which on a displacement of the map is one.
const DRIFT_SIGMA: f64 = 3.0;

fn times(run: &[CycleRecord]) -> Vec<f64> {
    run.iter().map(|record| record.time).collect()
}

/// Collisions and slip, as the filter noticed them.
pub(super) fn slip(run: &[CycleRecord]) -> Vec<Finding> {
    plain_findings(FindingKind::Slip, &times(run), |at| {
        run[at].collision.then_some(0.0)
    })
}

/// What the online correction of the map has found.
pub(super) fn map_drift(run: &[CycleRecord]) -> Vec<Finding> {
    plain_findings(FindingKind::Drift, &times(run), |at| {
        let [by, std] = run[at].displacement?;
        (by > WRONG_BY && by > DRIFT_SIGMA * std).then_some(by)
    })
}

/// Light on the field, from the image's brightness and the camera's setting, against that of [`LIGHT_CHANGE`] before.
pub(super) fn light_changes(run: &[CycleRecord]) -> Vec<Finding> {
    let measured = run.iter().filter_map(|record| {
        let share = record.brightness?.max(1.0) / 255.0;
        let light = math::powf(share, TONE_EXPONENT) / record.camera_setting;
        Some((record.time, light))
    });
    let (times, light): (Vec<f64>, Vec<f64>) = measured.unzip();
    plain_findings(FindingKind::Light, &times, |at| {
        let until = times[at] - LIGHT_CHANGE;
        let earlier = times
            .partition_point(|time| *time <= until)
            .checked_sub(1)?;
        let ratio = light[at] / light[earlier];
        let ratio = ratio.max(1.0 / ratio);
        (ratio > LIGHT_RATIO).then_some(ratio)
    })
}
