//! Where is north by a magnetometer that rides with iron? Hard and soft iron make its circle an ellipse off the centre.
//!
//! A robot that turns once sees the horizontal field go round: magnets on it (hard iron) shift the circle, steel (soft
//! iron) stretches it. The ellipse is fitted under trace 2 of its quadratic part, which is linear and turns with the
//! data, without points that lie off it (local disturbance).

use nalgebra::{Matrix2, SMatrix, SVector, Vector2};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::frames::wrap_angle;

/// What makes a circle of a magnetometer's ellipse, and a heading of its direction.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CompassCalibration {
    /// The ellipse's centre (hard iron), the magnetometer's own unit, robot frame x and y.
    pub hard: [f32; 2],
    /// Takes what is left of a reading to the circle (soft iron), rows.
    pub soft: [[f32; 2]; 2],
    /// The circle's radius, the magnetometer's own unit.
    pub radius: f32,
    /// Direction of magnetic north on the field, degrees counter-clockwise from its x axis.
    #[serde(default)]
    pub north_deg: f32,
}

impl CompassCalibration {
    /// Heading on the field (radians) by the horizontal field in the robot's frame, and the field's strength over the
    /// usual: far from 1 something nearby disturbs it.
    pub fn heading(&self, field: [f32; 2]) -> (f32, f32) {
        let [x, y] = [field[0] - self.hard[0], field[1] - self.hard[1]];
        let [along, across] = self.soft.map(|row| row[0] * x + row[1] * y);
        let heading = wrap_angle(self.north_deg.to_radians() - across.atan2(along));
        (heading, along.hypot(across) / self.radius)
    }
}

/// A fitted calibration and how well the readings lie on it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct CompassFit {
    /// The calibration.
    pub calibration: CompassCalibration,
    /// Readings used, and left out because something nearby disturbed them.
    pub used: usize,
    /// See `used`.
    pub left_out: usize,
    /// Root mean square distance of the used ones from the circle over its radius, as a heading error, degrees.
    pub residual_deg: f32,
    /// Largest heading error that the raw readings would have had, degrees.
    pub raw_error_deg: f32,
    /// The ellipse's longer axis over its shorter one.
    pub stretch: f32,
}

/// Why there is no calibration.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum CompassError {
    /// Too few readings.
    #[error("{0} magnetometer readings: at least {READINGS_MIN} are wanted")]
    TooFew(usize),
    /// The robot did not turn all round.
    #[error("the readings leave {0:.0}° of the circle out: turn the robot once all round")]
    Gap(f32),
    /// No ellipse fits.
    #[error("the readings lie on no ellipse: does the magnetometer ride with the robot?")]
    NoEllipse,
}

const READINGS_MIN: usize = 30;
/// Largest gap in the directions, degrees: beyond it the ellipse is guessed rather than seen.
const GAP_MAX_DEG: f32 = 60.0;
/// Readings further off than so many standard deviations are disturbed.
const OUTLIER_SIGMAS: f64 = 3.5;
/// Rounds of leaving disturbed readings out.
const REJECTION_ROUNDS_MAX: usize = 10;

/// Fits the calibration to horizontal readings (robot frame) of a robot that turned all round.
pub fn fit_calibration(readings: &[[f32; 2]]) -> Result<CompassFit, CompassError> {
    let all: Vec<Vector2<f64>> = readings
        .iter()
        .map(|reading| Vector2::new(reading[0].into(), reading[1].into()))
        .filter(|reading: &Vector2<f64>| reading.iter().all(|value| value.is_finite()))
        .collect();
    let mut kept = all.clone();
    let mut ellipse = Ellipse::fit(&kept)?;
    for _ in 0..REJECTION_ROUNDS_MAX {
        let mut sizes: Vec<f64> = all.iter().map(|one| ellipse.residual(one).abs()).collect();
        let sorted = {
            sizes.sort_by(f64::total_cmp);
            &sizes
        };
        // The median of a normal deviation is 0.6745 of its standard deviation; below a thousandth all is well.
        let std = (sorted[sorted.len() / 2] / 0.6745).max(1e-3);
        let near: Vec<Vector2<f64>> = all
            .iter()
            .filter(|one| ellipse.residual(one).abs() <= OUTLIER_SIGMAS * std)
            .copied()
            .collect();
        let same = near.len() == kept.len();
        kept = near;
        ellipse = Ellipse::fit(&kept)?;
        if same {
            break;
        }
    }
    let gap = ellipse.largest_gap_deg(&kept);
    if gap > GAP_MAX_DEG {
        return Err(CompassError::Gap(gap));
    }
    let square: f64 = kept.iter().map(|one| ellipse.residual(one).powi(2)).sum();
    let calibration = ellipse.calibration();
    let raw_error = kept.iter().map(|one| {
        let (heading, _) = calibration.heading([one.x as f32, one.y as f32]);
        wrap_angle(heading + (one.y as f32).atan2(one.x as f32)).abs()
    });
    Ok(CompassFit {
        calibration,
        used: kept.len(),
        left_out: all.len() - kept.len(),
        residual_deg: (square / kept.len() as f64).sqrt().to_degrees() as f32,
        raw_error_deg: raw_error.fold(0.0_f32, f32::max).to_degrees(),
        stretch: ellipse.axis_ratio() as f32,
    })
}

/// Points x with |root (x − centre)| = radius.
struct Ellipse {
    centre: Vector2<f64>,
    shape_root: Matrix2<f64>,
    radius: f64,
}

impl Ellipse {
    /// x² + y² + p (x² − y²) + b xy + d x + e y + f = 0 by least squares, about the points' mean in their own size.
    fn fit(points: &[Vector2<f64>]) -> Result<Self, CompassError> {
        let count = points.len();
        if count < READINGS_MIN {
            return Err(CompassError::TooFew(count));
        }
        let mean = points.iter().sum::<Vector2<f64>>() / count as f64;
        let size = points.iter().map(|one| (one - mean).norm()).sum::<f64>() / count as f64;
        if !(size > 0.0) {
            return Err(CompassError::NoEllipse);
        }
        let mut normal = SMatrix::<f64, 5, 5>::zeros();
        let mut side = SVector::<f64, 5>::zeros();
        for one in points {
            let (x, y) = ((one.x - mean.x) / size, (one.y - mean.y) / size);
            let row = SVector::from([x * x - y * y, x * y, x, y, 1.0]);
            normal += row * row.transpose();
            side -= row * (x * x + y * y);
        }
        let solved = normal.cholesky().ok_or(CompassError::NoEllipse)?;
        let [p, b, d, e, f] = solved.solve(&side).into();
        let quadratic = Matrix2::new(1.0 + p, b / 2.0, b / 2.0, 1.0 - p);
        let centre =
            -quadratic.try_inverse().ok_or(CompassError::NoEllipse)? * Vector2::new(d, e) / 2.0;
        let square = (centre.transpose() * quadratic * centre)[0] - f;
        let eigen = quadratic.symmetric_eigen();
        // An ellipse more than three times as long as wide is no magnetometer on a robot.
        if !(square > 0.0 && eigen.eigenvalues.min() > 0.11 * eigen.eigenvalues.max()) {
            return Err(CompassError::NoEllipse);
        }
        // The symmetric root turns nothing: what the iron turned on the mean cannot be seen from a circle.
        let roots = Matrix2::from_diagonal(&eigen.eigenvalues.map(f64::sqrt));
        let root = eigen.eigenvectors * roots * eigen.eigenvectors.transpose();
        Ok(Ellipse {
            centre: mean + centre * size,
            shape_root: root,
            radius: square.sqrt() * size,
        })
    }

    /// Distance of a point from the circle over its radius.
    fn residual(&self, point: &Vector2<f64>) -> f64 {
        (self.shape_root * (point - self.centre)).norm() / self.radius - 1.0
    }

    /// Largest gap between neighbouring directions, degrees.
    fn largest_gap_deg(&self, points: &[Vector2<f64>]) -> f32 {
        let mut directions: Vec<f64> = points
            .iter()
            .map(|one| {
                let round = self.shape_root * (one - self.centre);
                round.y.atan2(round.x)
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

    /// A magnetometer with iron around it, while the robot heads to each of `count` directions of `share` of a turn.
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
        // The mean turn is `north_deg`'s business.
        let off = |(heading, field): &(f32, [f32; 2])| {
            wrap_angle(calibration.heading(*field).0 - heading)
        };
        let mean = readings.iter().map(off).sum::<f32>() / readings.len() as f32;
        readings
            .iter()
            .map(|one| (off(one) - mean).to_degrees())
            .collect()
    }

    #[test]
    fn calibration_removes_hard_and_soft_iron() {
        let readings = readings(200, 1.0);
        let fields: Vec<[f32; 2]> = readings.iter().map(|one| one.1).collect();
        let found = fit_calibration(&fields).expect("a calibration");
        assert!(
            found.raw_error_deg > 40.0 && found.residual_deg < 0.5,
            "{found:?}"
        );
        let worst = errors_deg(&readings, &found.calibration)
            .into_iter()
            .fold(0.0_f32, |worst, off| worst.max(off.abs()));
        assert!(worst < 0.8, "{worst}");
    }

    #[test]
    fn local_disturbance_is_rejected_as_outliers() {
        let readings = readings(200, 1.0);
        let mut fields: Vec<[f32; 2]> = readings.iter().map(|one| one.1).collect();
        for field in &mut fields[40..60] {
            field[0] += 9.0;
        }
        let found = fit_calibration(&fields).expect("a calibration");
        assert!((15..=40).contains(&found.left_out), "{found:?}");
        let worst = errors_deg(&readings, &found.calibration)
            .into_iter()
            .fold(0.0_f32, |worst, off| worst.max(off.abs()));
        assert!(worst < 1.5, "{worst}");
        let (_, strength) = found.calibration.heading(fields[50]);
        assert!((strength - 1.0).abs() > 0.1, "{strength}");
    }

    #[test]
    fn incomplete_turn_is_refused_with_a_hint() {
        let fields: Vec<[f32; 2]> = readings(100, 0.5).iter().map(|one| one.1).collect();
        let error = fit_calibration(&fields)
            .expect_err("half a turn")
            .to_string();
        assert!(error.contains("turn the robot"), "{error}");
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
