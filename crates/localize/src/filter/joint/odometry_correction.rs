//! Which linear map takes the motion that the wheels report to the true one? (docs/methods.md 8.5)
//!
//! Wheels of unequal radius, a base radius or a forward direction that is a little off: each is a linear error of the
//! measured motion (x, y, θ). A 3 × 3 matrix covers them all, also for a base whose geometry is not known; where it is
//! known, the prior says which matrices its wheels can cause.

use nalgebra::Matrix3;

use super::state::{Covariance, ODOMETRY_CORRECTION, State};
use crate::filter::FilterConfig;
use crate::omni::OmniKinematics;

/// Index of the correction's entry in row `i` and column `j`.
pub(super) const fn entry(i: usize, j: usize) -> usize {
    ODOMETRY_CORRECTION + 3 * i + j
}

/// Distance of the wheels from the centre that relates errors of rotation to errors of translation, metres.
const BASE_RADIUS: f32 = 0.25;
/// Scale of an entry: 1, m/rad or rad/m.
fn entry_scale(i: usize, j: usize) -> f32 {
    match (i, j) {
        (2, 0 | 1) => 1.0 / BASE_RADIUS,
        (0 | 1, 2) => BASE_RADIUS,
        _ => 1.0,
    }
}

/// How far may the correction be from the identity before anything was seen?
///
/// Covariance of its nine entries, row by row. What changes while driving (wear, load, carpet) has the same shape.
#[derive(Debug, Clone, PartialEq)]
pub struct OdometryPrior {
    covariance: [[f32; 9]; 9],
}

/// What a known base leaves to errors of its mount (forward direction, centre, distance of the wheels), and what to anything else (rollers
/// that slip more along one axis, the pile of the carpet), as shares of the coupling's standard deviation.
const MOUNT_SHARE: f32 = 0.5;
const REST_SHARE: f32 = 0.5;

impl OdometryPrior {
    /// For a base of unknown geometry: every entry errs by itself, but for the scales along x and y, which are alike up to
    /// the coupling's size.
    pub fn of_any_base(config: &FilterConfig) -> Self {
        let (scale, coupling) = initial_stds(config);
        let mut prior = OdometryPrior::default();
        for k in 0..9 {
            let (i, j) = (k / 3, k % 3);
            let std = if i == j { scale } else { coupling } * entry_scale(i, j);
            prior.covariance[k][k] = std * std;
        }
        let common = (scale * scale - coupling * coupling).max(0.0);
        prior.covariance[0][4] = common;
        prior.covariance[4][0] = common;
        prior
    }

    /// For known wheels: their radii err, together by the scale's and each by the coupling's standard deviation, their
    /// mount by half of it.
    ///
    /// `calibration`: the matrix by which their motion was multiplied.
    pub fn of_wheels(
        config: &FilterConfig,
        wheels: &OmniKinematics,
        calibration: Option<&[[f32; 3]; 3]>,
    ) -> Self {
        let (scale, coupling) = initial_stds(config);
        let mount = MOUNT_SHARE * coupling;
        let matrix = calibration.map_or_else(Matrix3::identity, |rows| {
            Matrix3::from_fn(|i, j| rows[i][j])
        });
        let Some(inverse) = matrix.try_inverse() else {
            return OdometryPrior::of_any_base(config);
        };
        let mut prior = OdometryPrior::default();
        for larger in wheels.motion_by_wheel() {
            prior.add(&(matrix * larger * inverse), coupling);
        }
        prior.add(&Matrix3::identity(), scale);
        let turned = Matrix3::new(0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0);
        prior.add(&turned, mount);
        for (i, j) in [(0, 2), (1, 2), (2, 2)] {
            let mut entry = Matrix3::zeros();
            entry[(i, j)] = entry_scale(i, j);
            prior.add(&entry, mount);
        }
        for k in 0..9 {
            let rest = REST_SHARE * coupling * entry_scale(k / 3, k % 3);
            prior.covariance[k][k] += rest * rest;
        }
        prior
    }

    /// Adds an error of this form and standard deviation.
    fn add(&mut self, error: &Matrix3<f32>, std: f32) {
        for k in 0..9 {
            for m in 0..9 {
                self.covariance[k][m] += error[(k / 3, k % 3)] * error[(m / 3, m % 3)] * std * std;
            }
        }
    }

    /// Adds this share of the prior to the correction's covariance.
    pub(super) fn add_to(&self, covariance: &mut Covariance, share: f32) {
        for (row, prior) in covariance[ODOMETRY_CORRECTION..]
            .iter_mut()
            .zip(&self.covariance)
        {
            for (value, prior) in row[ODOMETRY_CORRECTION..].iter_mut().zip(prior) {
                *value += share * prior;
            }
        }
    }
}

impl Default for OdometryPrior {
    /// No error at all.
    fn default() -> Self {
        OdometryPrior {
            covariance: [[0.0; 9]; 9],
        }
    }
}

/// Standard deviations of scales and couplings at the start. 0 if the correction is not estimated.
fn initial_stds(config: &FilterConfig) -> (f32, f32) {
    let scale = config.odometry_scale_std;
    if scale > 0.0 {
        (scale, config.odometry_coupling_std)
    } else {
        (0.0, 0.0)
    }
}

/// Sets the identity with its initial uncertainty.
pub(super) fn initialize(state: &mut State, covariance: &mut Covariance, prior: &OdometryPrior) {
    for i in 0..3 {
        for j in 0..3 {
            state[entry(i, j)] = f32::from(u8::from(i == j));
        }
    }
    prior.add_to(covariance, 1.0);
}

#[cfg(test)]
mod tests {
    use nalgebra::{SMatrix, SVector};

    use super::*;

    /// Squared distance of a correction from the identity in standard deviations of the prior.
    fn surprise(prior: &OdometryPrior, correction: &Matrix3<f32>) -> f32 {
        let covariance = SMatrix::<f32, 9, 9>::from_fn(|k, m| prior.covariance[k][m]);
        let error = correction - Matrix3::identity();
        let error = SVector::<f32, 9>::from_fn(|k, _| error[(k / 3, k % 3)]);
        let inverse = covariance.try_inverse().expect("a positive definite prior");
        (error.transpose() * inverse * error).x
    }

    /// Motion by wheels with these radii over the assumed ones, from the wheels' own equations.
    fn motion_with_radii(angles_deg: [f32; 3], ratios: [f32; 3]) -> Matrix3<f32> {
        let wheels = Matrix3::from_rows(&angles_deg.map(|angle_deg| {
            let angle = angle_deg.to_radians();
            nalgebra::RowVector3::new(-crate::math::sin(angle), crate::math::cos(angle), 0.2)
        }));
        let radii = Matrix3::from_diagonal(&ratios.into());
        wheels.try_inverse().expect("a base") * radii * wheels
    }

    #[test]
    fn prior_of_known_wheels_expects_their_radii_before_anything_else() {
        let config = FilterConfig::default();
        let angles_deg = [60.0_f32, 180.0, 300.0];
        let wheels = OmniKinematics::new(&angles_deg.map(f32::to_radians), 0.05, 0.2);
        let known = OdometryPrior::of_wheels(&config, &wheels.expect("a base"), None);
        let any = OdometryPrior::of_any_base(&config);
        let radii = motion_with_radii(angles_deg, [1.03, 1.02, 1.04]);
        assert!(
            surprise(&known, &radii) < 3.0,
            "{}",
            surprise(&known, &radii)
        );
        // Stretched along x and shortened along y: no radii cause that, but rollers may.
        let mut other = Matrix3::identity();
        (other[(0, 0)], other[(1, 1)]) = (1.02, 0.98);
        assert!(surprise(&any, &other) < 9.0);
        let [expected, possible] = [&radii, &other].map(|each| surprise(&known, each));
        assert!(
            possible > 2.0 * expected && possible < 9.0,
            "{expected} {possible}"
        );
    }

    #[test]
    fn prior_turns_with_the_axes_of_a_calibrated_base() {
        let config = FilterConfig::default();
        let angles_deg = [50.0_f32, 180.0, 310.0];
        let wheels = OmniKinematics::new(&angles_deg.map(f32::to_radians), 0.05, 0.2);
        // The board's x axis is the robot's y axis.
        let calibration = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]];
        let turn = Matrix3::from_fn(|i, j| calibration[i][j]);
        let prior = OdometryPrior::of_wheels(&config, &wheels.expect("a base"), Some(&calibration));
        let radii = motion_with_radii(angles_deg, [1.03, 1.0, 0.98]);
        let seen = turn * radii * turn.transpose();
        assert!(surprise(&prior, &seen) < 8.0, "{}", surprise(&prior, &seen));
    }
}
