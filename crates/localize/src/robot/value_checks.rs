//! Which values of a robot file are refused? Each check returns the key and the reason.

use std::ops::RangeInclusive;

/// Largest angle of a direction in either sense, degrees.
pub(super) const TURN_DEG: f32 = 360.0;

pub(super) fn check_positive(key: &'static str, value: f32) -> Result<(), (&'static str, String)> {
    if value.is_finite() && value > 0.0 {
        return Ok(());
    }
    Err((key, format!("{value} must be a positive number")))
}

pub(super) fn check_not_negative(
    key: &'static str,
    value: f32,
) -> Result<(), (&'static str, String)> {
    if value.is_finite() && value >= 0.0 {
        return Ok(());
    }
    Err((key, format!("{value} must be zero or a positive number")))
}

/// Refuses a value below -`limit` or above `limit`.
pub(super) fn check_within(
    key: &'static str,
    values: &[f32],
    limit: f32,
) -> Result<(), (&'static str, String)> {
    match values.iter().find(|value| !(value.abs() <= limit)) {
        Some(value) => Err((key, format!("{value} (expected -{limit} to {limit})"))),
        None => Ok(()),
    }
}

pub(super) fn check_range(
    key: &'static str,
    value: f32,
    range: RangeInclusive<f32>,
) -> Result<(), (&'static str, String)> {
    if range.contains(&value) {
        return Ok(());
    }
    let (least, most) = range.into_inner();
    Err((key, format!("{value} (expected {least} to {most})")))
}

pub(super) fn check_finite(
    key: &'static str,
    values: &[f32],
) -> Result<(), (&'static str, String)> {
    match values.iter().find(|value| !value.is_finite()) {
        Some(value) => Err((key, format!("{value} is not a number"))),
        None => Ok(()),
    }
}
