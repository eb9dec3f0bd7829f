//! Which radii of the wheels and which distance from the centre explain an odometry matrix? (docs/methods.md 7.5)

use nalgebra::{DMatrix, DVector, Matrix3};

use crate::math;
use crate::robot::BaseConfig;

/// Radii of the wheels and their distance from the centre that explain a matrix.
#[derive(Debug, Clone, PartialEq)]
pub struct WheelGeometry {
    /// Of each wheel, metres.
    pub radii: Vec<f32>,
    /// From the robot's centre, metres.
    pub distance: f32,
}

/// Steps of the fit, which finds radii and distance in turn.
const STEPS: usize = 30;

/// Largest entry of the matrix that may remain unexplained; rotation at the wheels' distance. Entries of a fit are good to
/// half a percent.
const MISFIT_MAX: f64 = 0.02;

/// The radii and the distance of three or four wheels that explain `matrix` (true motion = matrix · measured motion).
///
/// Each wheel turns as its own radius demands, and the measured motion is the least-squares one of all of them by the nominal
/// radii: four wheels that disagree slip. None if no positive radii explain the matrix, as after an exchange of axes.
pub fn wheel_geometry(matrix: &[[f32; 3]; 3], base: &BaseConfig) -> Option<WheelGeometry> {
    let nominal_distance = f64::from(base.wheel_distance);
    // In metres: rotation at the nominal distance.
    let unit = |axis: usize| if axis == 2 { nominal_distance } else { 1.0 };
    let measured_from_true =
        Matrix3::from_fn(|row, column| f64::from(matrix[row][column]) * unit(row) / unit(column))
            .try_inverse()?;
    let angles = base.wheel_angles_deg.iter();
    let directions: Vec<[f64; 2]> = angles
        .map(|angle| {
            let (sin, cos) = math::sin_cos(f64::from(*angle).to_radians());
            [-sin, cos]
        })
        .collect();
    let count = directions.len();
    let rims = |distance: f64| {
        DMatrix::from_fn(count, 3, |wheel, axis| match axis {
            2 => distance / nominal_distance,
            _ => directions[wheel][axis],
        })
    };
    let nominal = rims(nominal_distance);
    let measured_from_rims = (nominal.transpose() * &nominal).try_inverse()? * nominal.transpose();
    let wanted = DVector::from_fn(9, |entry, _| measured_from_true[(entry / 3, entry % 3)]);
    let mut distance = nominal_distance;
    // Rotation of each wheel for a motion of its rim, in that of a wheel of the nominal radius.
    let mut turns = DVector::from_element(count, 1.0);
    let mut misfit = f64::INFINITY;
    for _ in 0..STEPS {
        let rims = rims(distance);
        let of_wheels = DMatrix::from_fn(9, count, |entry, wheel| {
            measured_from_rims[(entry / 3, wheel)] * rims[(wheel, entry % 3)]
        });
        let normal = of_wheels.transpose() * &of_wheels;
        turns = normal.lu().solve(&(of_wheels.transpose() * &wanted))?;
        misfit = (&of_wheels * &turns - &wanted).amax();
        let rotation = &measured_from_rims * &turns / nominal_distance;
        distance = rotation.dot(&measured_from_true.column(2)) / rotation.norm_squared();
    }
    let radii: Vec<f32> = turns
        .iter()
        .map(|turns| base.wheel_radius / *turns as f32)
        .collect();
    let explained = misfit <= MISFIT_MAX && distance > 0.0 && radii.iter().all(|r| *r > 0.0);
    explained.then_some(WheelGeometry {
        radii,
        distance: distance as f32,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::omni::OmniKinematics;
    use crate::twist::Twist;

    /// The matrix of wheels whose radii and distance are not those of the base, by its own kinematics.
    fn matrix_of(base: &BaseConfig, radii: &[f32], distance: f32) -> [[f32; 3]; 3] {
        let real = BaseConfig {
            wheel_distance: distance,
            ..base.clone()
        };
        let [nominal, real]: [OmniKinematics; 2] =
            [base, &real].map(|base| base.kinematics().expect("kinematics"));
        let measured = Matrix3::from_columns(&[0, 1, 2].map(|axis| {
            let [x, y, theta] = [0, 1, 2].map(|other| f32::from(u8::from(other == axis)));
            let turned = real.wheel_speeds(Twist { x, y, theta });
            let turned = turned
                .zip(radii)
                .map(|(turns, r)| turns * base.wheel_radius / r);
            let (twist, _) = nominal.twist(&turned.collect::<Vec<_>>());
            nalgebra::Vector3::new(twist.x, twist.y, twist.theta)
        }));
        let matrix = measured.try_inverse().expect("a matrix");
        [0, 1, 2].map(|row| [0, 1, 2].map(|column| matrix[(row, column)]))
    }

    #[test]
    fn radii_and_distance_of_three_and_of_four_wheels_are_found_from_their_matrix() {
        let scales = [1.05, 0.97, 1.03, 0.95];
        for wheel_angles_deg in [vec![60.0, 180.0, 300.0], vec![45.0, 135.0, 225.0, 315.0]] {
            let base = BaseConfig {
                wheel_radius: 0.06,
                wheel_distance: 0.2,
                wheel_angles_deg,
                ..BaseConfig::default()
            };
            let wheels = base.wheel_angles_deg.len();
            let radii: Vec<f32> = scales[..wheels].iter().map(|scale| 0.06 * scale).collect();
            let found = wheel_geometry(&matrix_of(&base, &radii, 0.21), &base).expect("wheels");
            for (found, radius) in found.radii.iter().zip(&radii) {
                assert!((found - radius).abs() < 1e-5, "{found} {radius}");
            }
            assert!((found.distance - 0.21).abs() < 1e-4, "{}", found.distance);
        }
    }

    #[test]
    fn exchanged_axes_are_no_wheels() {
        let matrix = [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]];
        assert_eq!(wheel_geometry(&matrix, &BaseConfig::default()), None);
    }
}
