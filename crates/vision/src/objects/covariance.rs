//! Covariance of a ground position whose errors along and across the viewing direction are independent.

/// Covariance xx, xy, yy, m²; `direction`: unit vector from the robot; deviations along and across it, metres.
pub(crate) fn covariance_from_polar(
    [ex, ey]: [f32; 2],
    std_radial: f32,
    std_tangential: f32,
) -> [f32; 3] {
    let (radial, tangential) = (std_radial * std_radial, std_tangential * std_tangential);
    [
        radial * ex * ex + tangential * ey * ey,
        (radial - tangential) * ex * ey,
        radial * ey * ey + tangential * ex * ex,
    ]
}
