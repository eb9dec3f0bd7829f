//! What calibration measured of one robot: files that robot.toml includes, and their effect on samples.

use nalgebra::Matrix3;
use serde::{Deserialize, Serialize};

use super::value_checks::{TURN_DEG, check_finite, check_positive, check_within};
use crate::math;
use crate::sample::{Imu, Odometry};
use crate::sensors::compass_calibration::CompassCalibration;

/// Largest element of a matrix of the wheels: those of wheels five times as large as the base believes, or of a base turned on the robot.
const ELEMENT_MAX: f32 = 5.0;
/// Smallest determinant of such a matrix: that of wheels a fifth as large.
const DETERMINANT_MIN: f32 = 0.008;

/// `[odometry]`: correction of the wheels' motion, as `calibrate wheels` writes it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OdometryCalibration {
    /// Rows: true motion (forward, left, rotation; metres and radians) = matrix · measured motion.
    pub matrix: [[f32; 3]; 3],
}

/// `[imu.calibration]`, as `calibrate imu` writes it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ImuCalibration {
    /// Mounting of the unit in the robot: roll, pitch, yaw of its axes, degrees (about x, then y, then z).
    pub mount_deg: [f32; 3],
    /// Constant error of the specific force, axes of the unit, m/s².
    pub acceleration_bias: [f32; 3],
    /// Constant error of the rate, axes of the unit, degrees/s.
    pub rate_bias_deg: [f32; 3],
}

/// `[timing]`, as `calibrate latency` writes it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TimingCalibration {
    /// Time from the exposure of an image to its stamp, on the clock of the wheels, seconds. Used unless the setting
    /// `localize.filter.camera_latency` is given.
    pub camera_latency: f32,
}

/// An included file: the sections that calibration writes, and no others.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CalibrationFile {
    pub(super) odometry: Option<OdometryCalibration>,
    pub(super) imu: Option<ImuSection>,
    pub(super) timing: Option<TimingCalibration>,
    pub(super) camera: Option<RimSection>,
    pub(super) compass: Option<CompassSection>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ImuSection {
    pub(super) calibration: ImuCalibration,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CompassSection {
    pub(super) calibration: CompassCalibration,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RimSection {
    pub(super) centre_px: [f32; 2],
    pub(super) outer_radius_px: f32,
}

impl Default for ImuCalibration {
    fn default() -> Self {
        ImuCalibration {
            mount_deg: [0.0; 3],
            acceleration_bias: [0.0; 3],
            rate_bias_deg: [0.0; 3],
        }
    }
}

impl OdometryCalibration {
    /// The corrected motion.
    pub fn apply(&self, odometry: &Odometry) -> Odometry {
        let measured = [odometry.dx, odometry.dy, odometry.dtheta];
        let [dx, dy, dtheta] = multiply(&self.matrix, measured);
        Odometry {
            dx,
            dy,
            dtheta,
            ..*odometry
        }
    }

    pub(super) fn check(&self) -> Result<(), (&'static str, String)> {
        let refuse = |reason: String| Err(("odometry.matrix", reason));
        let range = -ELEMENT_MAX..=ELEMENT_MAX;
        for (row, values) in self.matrix.iter().enumerate() {
            for (column, value) in values.iter().enumerate() {
                if !range.contains(value) {
                    return refuse(format!(
                        "row {}, column {}: {value} (expected {} to {ELEMENT_MAX})",
                        row + 1,
                        column + 1,
                        -ELEMENT_MAX
                    ));
                }
            }
        }
        let matrix = Matrix3::from_fn(|row, column| self.matrix[row][column]);
        if matrix.determinant().abs() < DETERMINANT_MIN {
            return refuse("a motion is lost (expected rows that differ and are not 0)".to_owned());
        }
        Ok(())
    }
}

impl ImuCalibration {
    /// The corrected reading, robot frame.
    pub fn apply(&self, imu: &Imu) -> Imu {
        let robot_from_unit = rotation_from_rpy(self.mount_deg.map(f32::to_radians));
        let correct = |values: [f32; 3], bias: [f32; 3]| {
            multiply(
                &robot_from_unit,
                [0, 1, 2].map(|axis| values[axis] - bias[axis]),
            )
        };
        Imu {
            stamp: imu.stamp,
            specific_force: correct(imu.specific_force, self.acceleration_bias),
            angular_velocity: correct(
                imu.angular_velocity,
                self.rate_bias_deg.map(f32::to_radians),
            ),
        }
    }

    pub(super) fn check(&self) -> Result<(), (&'static str, String)> {
        check_within("imu.calibration.mount_deg", &self.mount_deg, TURN_DEG)?;
        check_within(
            "imu.calibration.acceleration_bias",
            &self.acceleration_bias,
            20.0,
        )?;
        check_within("imu.calibration.rate_bias_deg", &self.rate_bias_deg, 90.0)
    }
}

/// Refuses a calibration that gives no heading.
pub(super) fn check_compass(
    calibration: &CompassCalibration,
) -> Result<(), (&'static str, String)> {
    let CompassCalibration {
        hard,
        soft: [[a, b], [c, d]],
        radius,
        north_deg,
    } = *calibration;
    check_positive("compass.calibration.radius", radius)?;
    check_finite("compass.calibration.hard", &hard)?;
    check_within("compass.calibration.north_deg", &[north_deg], TURN_DEG)?;
    check_finite("compass.calibration.soft", &[a, b, c, d])?;
    if (a * d - b * c).abs() > 1e-3 {
        return Ok(());
    }
    let reason = format!("[[{a}, {b}], [{c}, {d}]] maps all directions to one line");
    Err(("compass.calibration.soft", reason))
}

impl TimingCalibration {
    pub(super) fn check(&self) -> Result<(), (&'static str, String)> {
        if (0.0..=1.0).contains(&self.camera_latency) {
            return Ok(());
        }
        let reason = format!("{} s (expected 0 to 1)", self.camera_latency);
        Err(("timing.camera_latency", reason))
    }
}

/// Rz(yaw)·Ry(pitch)·Rx(roll), rows; angles in radians.
pub fn rotation_from_rpy([roll, pitch, yaw]: [f32; 3]) -> [[f32; 3]; 3] {
    let (sr, cr) = math::sin_cos(roll);
    let (sp, cp) = math::sin_cos(pitch);
    let (sy, cy) = math::sin_cos(yaw);
    [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
}

fn multiply(rows: &[[f32; 3]; 3], vector: [f32; 3]) -> [f32; 3] {
    rows.map(|row| row[0] * vector[0] + row[1] * vector[1] + row[2] * vector[2])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refusal(matrix: [[f32; 3]; 3]) -> Option<String> {
        let refused = OdometryCalibration { matrix }.check().err();
        refused.map(|(_, reason)| reason)
    }

    #[test]
    fn matrix_of_wheels_of_half_and_of_twice_the_size_and_of_a_turned_base_is_accepted() {
        for [x, y, turn] in [[2.07; 3], [0.48; 3], [-1.0, -1.0, 1.0]] {
            let matrix = [[x, 0.02, 0.0], [0.01, y, 0.0], [0.0, 0.0, turn]];
            assert_eq!(refusal(matrix), None);
        }
        let exchanged = [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]];
        assert_eq!(refusal(exchanged), None);
    }

    #[test]
    fn matrix_that_loses_a_motion_or_is_in_another_unit_is_refused() {
        let lost = [[1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]];
        assert!(refusal(lost).is_some_and(|reason| reason.contains("a motion is lost")));
        let degrees = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 57.3]];
        let reason = refusal(degrees).expect("degrees");
        assert_eq!(reason, "row 3, column 3: 57.3 (expected -5 to 5)");
    }
}
