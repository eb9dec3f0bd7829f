//! Compass calibration: hard and soft iron from one full rotation of the robot (docs/methods.md 9.1).
//!
//! Iron on the robot makes the circle of the horizontal field an ellipse off the origin. The fit constrains its quadratic
//! part to trace 2, which is linear and independent of the rotation. Disturbed readings are rejected as outliers.

use nalgebra::{Matrix2, SMatrix, SVector, Vector2};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::frames::wrap_angle;
use crate::math;

/// Maps a magnetometer's ellipse to a circle, and its direction to a heading.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CompassCalibration {
    /// Centre of the ellipse (hard iron), x and y, robot frame, unit of the magnetometer.
    pub hard: [f32; 2],
    /// Rows of the matrix that maps the centred ellipse to the circle (soft iron).
    pub soft: [[f32; 2]; 2],
    /// Radius of the circle, unit of the magnetometer.
    pub radius: f32,
    /// Direction of magnetic north on the field, degrees counter-clockwise from its x axis.
    #[serde(default)]
    pub north_deg: f32,
}

/// Heading by a calibrated magnetometer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MagneticHeading {
    /// On the field, radians.
    pub heading: f32,
    /// Strength of the field over that of the calibration. Far from 1 the reading is disturbed.
    pub relative_strength: f32,
}

impl CompassCalibration {
    /// Heading by the horizontal field in the robot frame.
    pub fn heading(&self, field: [f32; 2]) -> MagneticHeading {
        let [x, y] = [field[0] - self.hard[0], field[1] - self.hard[1]];
        let [along, across] = self.soft.map(|row| row[0] * x + row[1] * y);
        MagneticHeading {
            heading: wrap_angle(self.north_deg.to_radians() - math::atan2(across, along)),
            relative_strength: math::hypot(along, across) / self.radius,
        }
    }
}

/// A fitted calibration and its quality.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct CompassFit {
    /// The calibration.
    pub calibration: CompassCalibration,
    /// Number of readings used.
    pub used: usize,
    /// Number of readings rejected as disturbed.
    pub left_out: usize,
    /// Root mean square distance of the used readings from the circle over its radius, as a heading error, degrees.
    pub residual_deg: f32,
    /// Largest heading error of the uncalibrated readings, degrees.
    pub raw_error_deg: f32,
    /// Longer over shorter axis of the ellipse.
    pub stretch: f32,
}

/// Why a calibration failed.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum CompassError {
    /// Too few readings.
    #[error("too few magnetometer readings: {0} (expected at least {READINGS_MIN})")]
    TooFew(usize),
    /// The robot did not rotate by a full turn.
    #[error(
        "gap in the directions of the readings: {0:.0}° (expected at most {GAP_MAX_DEG}°). Turn the robot by a full circle"
    )]
    Gap(f32),
    /// No ellipse fits.
    #[error(
        "no ellipse fits the magnetometer readings. Check that the magnetometer is fixed to the robot"
    )]
    NoEllipse,
}

const READINGS_MIN: usize = 30;
/// Largest gap in the directions, degrees. Beyond it the ellipse is not determined.
const GAP_MAX_DEG: f32 = 60.0;
/// Readings beyond this many standard deviations count as disturbed.
const OUTLIER_SIGMAS: f64 = 3.5;
/// Maximum number of outlier rejection rounds.
const REJECTION_ROUNDS_MAX: usize = 10;

/// Fits the calibration to horizontal readings (robot frame) of a full rotation.
pub fn fit_calibration(readings: &[[f32; 2]]) -> Result<CompassFit, CompassError> {
    let all: Vec<Vector2<f64>> = readings
        .iter()
        .map(|reading| Vector2::new(reading[0].into(), reading[1].into()))
        .filter(|reading: &Vector2<f64>| reading.iter().all(|value| value.is_finite()))
        .collect();
    let mut kept = all.clone();
    let mut ellipse = Ellipse::fit(&kept)?;
    for _ in 0..REJECTION_ROUNDS_MAX {
        let mut residuals: Vec<f64> = all
            .iter()
            .map(|reading| ellipse.residual(reading).abs())
            .collect();
        residuals.sort_by(f64::total_cmp);
        // Robust standard deviation: the median of |normal| is 0.6745 σ. The floor accepts perfect readings.
        let std = (residuals[residuals.len() / 2] / 0.6745).max(1e-3);
        let inliers: Vec<Vector2<f64>> = all
            .iter()
            .filter(|reading| ellipse.residual(reading).abs() <= OUTLIER_SIGMAS * std)
            .copied()
            .collect();
        let converged = inliers.len() == kept.len();
        kept = inliers;
        ellipse = Ellipse::fit(&kept)?;
        if converged {
            break;
        }
    }
    let gap = ellipse.largest_gap_deg(&kept);
    if gap > GAP_MAX_DEG {
        return Err(CompassError::Gap(gap));
    }
    let sum_squared: f64 = kept
        .iter()
        .map(|reading| ellipse.residual(reading).powi(2))
        .sum();
    let calibration = ellipse.calibration();
    let raw_error = kept.iter().map(|reading| {
        let (x, y) = (reading.x as f32, reading.y as f32);
        wrap_angle(calibration.heading([x, y]).heading + math::atan2(y, x)).abs()
    });
    Ok(CompassFit {
        calibration,
        used: kept.len(),
        left_out: all.len() - kept.len(),
        residual_deg: (sum_squared / kept.len() as f64).sqrt().to_degrees() as f32,
        raw_error_deg: raw_error.fold(0.0_f32, f32::max).to_degrees(),
        stretch: ellipse.axis_ratio() as f32,
    })
}

/// The points x with |shape_root (x − centre)| = radius.
struct Ellipse {
    centre: Vector2<f64>,
    shape_root: Matrix2<f64>,
    radius: f64,
}

impl Ellipse {
    /// x² + y² + p (x² − y²) + b xy + d x + e y + f = 0 by least squares, for points centred and scaled to unit size.
    fn fit(points: &[Vector2<f64>]) -> Result<Self, CompassError> {
        let count = points.len();
        if count < READINGS_MIN {
            return Err(CompassError::TooFew(count));
        }
        let mean = points.iter().sum::<Vector2<f64>>() / count as f64;
        let size = points
            .iter()
            .map(|point| (point - mean).norm())
            .sum::<f64>()
            / count as f64;
        if !(size > 0.0) {
            return Err(CompassError::NoEllipse);
        }
        let mut normal = SMatrix::<f64, 5, 5>::zeros();
        let mut right_side = SVector::<f64, 5>::zeros();
        for point in points {
            let (x, y) = ((point.x - mean.x) / size, (point.y - mean.y) / size);
            let row = SVector::from([x * x - y * y, x * y, x, y, 1.0]);
            normal += row * row.transpose();
            right_side -= row * (x * x + y * y);
        }
        let factor = normal.cholesky().ok_or(CompassError::NoEllipse)?;
        let [p, b, d, e, f] = factor.solve(&right_side).into();
        let quadratic = Matrix2::new(1.0 + p, b / 2.0, b / 2.0, 1.0 - p);
        let centre =
            -quadratic.try_inverse().ok_or(CompassError::NoEllipse)? * Vector2::new(d, e) / 2.0;
        let radius_squared = (centre.transpose() * quadratic * centre)[0] - f;
        let eigen = quadratic.symmetric_eigen();
        // An axis ratio above three is not caused by iron on a robot.
        if !(radius_squared > 0.0 && eigen.eigenvalues.min() > 0.11 * eigen.eigenvalues.max()) {
            return Err(CompassError::NoEllipse);
        }
        // The symmetric root contains no rotation, since a circle does not determine one.
        let roots = Matrix2::from_diagonal(&eigen.eigenvalues.map(f64::sqrt));
        let shape_root = eigen.eigenvectors * roots * eigen.eigenvectors.transpose();
        Ok(Ellipse {
            centre: mean + centre * size,
            shape_root,
            radius: radius_squared.sqrt() * size,
        })
    }

    /// Distance of a mapped point from the circle over the radius.
    fn residual(&self, point: &Vector2<f64>) -> f64 {
        (self.shape_root * (point - self.centre)).norm() / self.radius - 1.0
    }

    /// Largest gap between neighbouring directions, degrees.
    fn largest_gap_deg(&self, points: &[Vector2<f64>]) -> f32 {
        let mut directions: Vec<f64> = points
            .iter()
            .map(|point| {
                let mapped = self.shape_root * (point - self.centre);
                math::atan2(mapped.y, mapped.x)
            })
            .collect();
        directions.sort_by(f64::total_cmp);
        let wrapped = directions
            .first()
            .map(|first| first + std::f64::consts::TAU);
        let next = directions.iter().skip(1).copied().chain(wrapped);
        let gap = directions
            .iter()
            .zip(next)
            .map(|(a, b)| b - a)
            .fold(0.0, f64::max);
        gap.to_degrees() as f32
    }

    fn axis_ratio(&self) -> f64 {
        let values = self.shape_root.symmetric_eigenvalues();
        values.max() / values.min()
    }

    fn calibration(&self) -> CompassCalibration {
        let m = self.shape_root.map(|value| value as f32);
        CompassCalibration {
            hard: [self.centre.x as f32, self.centre.y as f32],
            soft: [[m[(0, 0)], m[(0, 1)]], [m[(1, 0)], m[(1, 1)]]],
            radius: self.radius as f32,
            north_deg: 0.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Headings and readings with iron on the robot: `count` directions over `share` of a full rotation.
    fn readings(count: usize, share: f32) -> Vec<(f32, [f32; 2])> {
        (0..count)
            .map(|k| {
                let heading = std::f32::consts::TAU * share * k as f32 / count as f32;
                let (x, y) = (20.0 * heading.cos(), -20.0 * heading.sin());
                let noise = 0.1 * (k as f32 * 2.4).sin();
                let (x, y) = (1.15 * x + 0.12 * y, 0.12 * x + 0.9 * y);
                (heading, [x + 14.0 + noise, y - 6.0 - noise])
            })
            .collect()
    }

    fn errors_deg(readings: &[(f32, [f32; 2])], calibration: &CompassCalibration) -> Vec<f32> {
        // `north_deg` would correct the mean error.
        let error = |(heading, field): &(f32, [f32; 2])| {
            wrap_angle(calibration.heading(*field).heading - heading)
        };
        let mean = readings.iter().map(error).sum::<f32>() / readings.len() as f32;
        readings
            .iter()
            .map(|reading| (error(reading) - mean).to_degrees())
            .collect()
    }

    #[test]
    fn calibration_removes_hard_and_soft_iron() {
        let readings = readings(200, 1.0);
        let fields: Vec<[f32; 2]> = readings.iter().map(|(_, field)| *field).collect();
        let fit = fit_calibration(&fields).expect("a calibration");
        assert!(
            fit.raw_error_deg > 40.0 && fit.residual_deg < 0.5,
            "{fit:?}"
        );
        let worst = errors_deg(&readings, &fit.calibration)
            .into_iter()
            .fold(0.0_f32, |worst, error| worst.max(error.abs()));
        assert!(worst < 0.8, "{worst}");
    }

    #[test]
    fn local_disturbance_is_rejected_as_outliers() {
        let readings = readings(200, 1.0);
        let mut fields: Vec<[f32; 2]> = readings.iter().map(|(_, field)| *field).collect();
        for field in &mut fields[40..60] {
            field[0] += 9.0;
        }
        let fit = fit_calibration(&fields).expect("a calibration");
        assert!((15..=40).contains(&fit.left_out), "{fit:?}");
        let worst = errors_deg(&readings, &fit.calibration)
            .into_iter()
            .fold(0.0_f32, |worst, error| worst.max(error.abs()));
        assert!(worst < 1.5, "{worst}");
        let strength = fit.calibration.heading(fields[50]).relative_strength;
        assert!((strength - 1.0).abs() > 0.1, "{strength}");
    }

    #[test]
    fn incomplete_turn_is_refused_with_a_hint() {
        let fields: Vec<[f32; 2]> = readings(100, 0.5)
            .into_iter()
            .map(|(_, field)| field)
            .collect();
        let error = fit_calibration(&fields)
            .expect_err("half a turn")
            .to_string();
        assert!(error.contains("Turn the robot"), "{error}");
        assert_eq!(
            fit_calibration(&fields[..10]),
            Err(CompassError::TooFew(10))
        );
        assert_eq!(
            fit_calibration(&[[1.0, 2.0]; 50]),
            Err(CompassError::NoEllipse)
        );
    }
}
