//! Polar coordinates in the image about the mirror's axis: radius in pixels, azimuth from image right towards image up.

use localize::math;

/// Azimuth of a pixel, radians in (−π, π].
pub(crate) fn azimuth([cu, cv]: [f32; 2], [u, v]: [f32; 2]) -> f32 {
    math::atan2(cv - v, u - cu)
}

/// The pixel (column, row, rounded to its centre) at a radius in pixels; `sin` and `cos` of its azimuth.
pub(crate) fn nearest_pixel(
    [cu, cv]: [f32; 2],
    radius_px: f32,
    (sin, cos): (f32, f32),
) -> [f32; 2] {
    [
        (cu + radius_px * cos).round(),
        (cv - radius_px * sin).round(),
    ]
}

/// Part of a turn, 0 to 1, of any number of turns. The remainder of a division would take twenty times as long.
#[inline]
pub(crate) fn wrap_turns(turns: f32) -> f32 {
    turns - turns.floor()
}
