//! How uncertain are the poses of a set-up that is probably wrong?

use localize::field::{Axis, FieldConfig, FieldSize};
use nalgebra::{Matrix3, Vector3};

use super::assess::Assessment;
use super::change::Change;
use crate::setup::Setup;

/// Position error that remains under a wrong field, metres, and heading error, radians.
const DOUBT_STD: (f32, f32) = (0.25, 0.1);

/// Covariance of a uniform distribution of poses on the carpet.
pub(super) fn unknown_pose_covariance(setup: &Setup) -> Matrix3<f32> {
    let (half_x, half_y) = setup.field.carpet_half_extent();
    let turn = std::f32::consts::PI;
    Matrix3::from_diagonal(&(Vector3::new(half_x * half_x, half_y * half_y, turn * turn) / 3.0))
}

/// How uncertain poses of the configured set-up are, if another one is better.
pub(super) fn added_pose_covariance(
    setup: &Setup,
    assessment: &Assessment,
) -> Option<Matrix3<f32>> {
    let unknown = unknown_pose_covariance(setup);
    if assessment.fits_no_better_than_random {
        return Some(unknown);
    }
    let doubtful: Vec<_> = assessment
        .edits()
        .filter(|found| {
            !matches!(
                found.change,
                // Without the table in the wrong unit the poses are right.
                Change::CompassInDegrees
                    | Change::OdometryRotationInDegrees
                    | Change::OdometryScale(_)
                    | Change::OdometryAxes { .. }
                    | Change::OdometryFixedAxes(_)
                    | Change::WheelMatrix(_)
            )
        })
        .collect();
    let last = doubtful.last()?;
    if doubtful.iter().any(|found| {
        matches!(
            found.change,
            Change::Mount { .. } | Change::CompassTurn(_) | Change::CompassMirrored(_)
        )
    }) {
        return Some(unknown);
    }
    // Mean square difference of the poses under both set-ups, the half turn aside.
    let pairs = assessment
        .configured
        .keyframes
        .iter()
        .zip(&last.explanation.keyframes);
    let (sum, count) = pairs
        .filter_map(|(now, other)| now.pose.zip(other.pose))
        .fold((Matrix3::zeros(), 0.0_f32), |(sum, count), (now, other)| {
            let turned = localize::global_search::branch_and_bound::half_turn(other);
            let offset = [other, turned]
                .map(|other| other.difference(now))
                .into_iter()
                .min_by(|a, b| a.norm().total_cmp(&b.norm()))
                .unwrap_or_default();
            (sum + offset * offset.transpose(), count + 1.0)
        });
    // Under a wrong size the poses may cling to either end.
    let (now, other) = (&setup.field.config, &last.after.field);
    let extent = |field: &FieldConfig, axis: Axis| {
        FieldSize::between_ends(field, axis).map_or(0.0, |size| size.get(field))
    };
    let resized = |axis: Axis| 0.5 * (extent(now, axis) - extent(other, axis));
    let resized = Vector3::new(resized(Axis::X), resized(Axis::Y), 0.0);
    let floor = match last.change {
        Change::Centre(_) | Change::CameraTurn(_) | Change::MeasuredTo(_) => Vector3::zeros(),
        _ => Vector3::new(DOUBT_STD.0, DOUBT_STD.0, DOUBT_STD.1),
    };
    let floor = floor.component_mul(&floor) + resized.component_mul(&resized);
    let floor = Matrix3::from_diagonal(&floor);
    Some(sum / count.max(1.0) + floor)
}
