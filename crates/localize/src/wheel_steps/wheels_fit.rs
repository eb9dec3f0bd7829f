//! By which turn and offset do the poses differ from wheels of any radii? The whole path counts, not its chord.
//!
//! Wheels of unequal radius turn the robot all along its way. Over a metre or two its chord is then turned as by another forward direction
//! of the camera. Only the motions within the step tell them apart (docs/methods.md 16.2).

use nalgebra::{Complex, SMatrix, SVector, Vector2, Vector3};

use super::step::{MeasuredStep, PASSES, STEP_STD, spread, weight};
use super::step_fit::{KNOWN_FACTOR_STD, OFFSET_STD, UNEVEN_STD};
use super::{BASE_RADIUS, OriginOffset, centre_variance, start_direction};
use crate::frames::wrap_angle;
use crate::math;

/// Derivatives of a step (metres, metres, radians) by the entries of the wheels' matrix, row by row.
pub type MatrixDerivatives = SMatrix<f32, 3, 9>;

/// A step with what the wheels' matrix changes of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DerivedStep {
    /// The step.
    pub step: MeasuredStep,
    /// Its derivatives.
    pub by_matrix: MatrixDerivatives,
}

/// What makes the wheels' steps those of the poses.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WheelsFit {
    /// Turn of the poses' axes against those of the wheels, radians.
    pub turn: f32,
    /// Its standard deviation beside wheels of any radii, radians.
    pub turn_std: f32,
    /// Where the poses' origin lies.
    pub origin: OriginOffset,
}

/// Turn, scale, two numbers of unequal directions, two of the offset, two of the turns of an uneven path, and the scale of turns.
type Unknowns = SVector<f32, 9>;

impl WheelsFit {
    /// Fits steps. None for too few that agree on a direction or turn in place.
    pub fn fit(steps: &[DerivedStep]) -> Option<Self> {
        let measured: Vec<MeasuredStep> = steps.iter().map(|step| step.step).collect();
        let (direction, std) = start_direction(&measured)?;
        let rows: Vec<FitRows> = steps
            .iter()
            .map(|step| FitRows::new(step, direction))
            .collect();
        let coupling_std = UNEVEN_STD / BASE_RADIUS;
        let prior = Unknowns::from([
            std,
            KNOWN_FACTOR_STD,
            UNEVEN_STD,
            UNEVEN_STD,
            OFFSET_STD,
            OFFSET_STD,
            coupling_std,
            coupling_std,
            KNOWN_FACTOR_STD,
        ])
        .map(|std| 1.0 / (std * std));
        // Fitted numbers make few steps look better than they are.
        let coordinates = 3.0 * steps.len() as f32;
        let freedom = coordinates / (coordinates - prior.len() as f32);
        let mut fitted = Unknowns::zeros();
        let mut covariance = SMatrix::<f32, 9, 9>::zeros();
        for _ in 0..PASSES {
            let errors: Vec<f32> = rows.iter().map(|row| row.error(&fitted).norm()).collect();
            let spread = (spread(&errors) * freedom.sqrt()).max(1.0);
            let mut information = SMatrix::<f32, 9, 9>::from_diagonal(&prior);
            let mut vector = Unknowns::zeros();
            for (row, error) in rows.iter().zip(&errors) {
                let weight = weight(error / spread) / (spread * spread);
                information += row.slopes.transpose() * row.slopes * weight;
                vector += row.slopes.transpose() * row.measured * weight;
            }
            covariance = information.try_inverse()?;
            fitted = covariance * vector;
        }
        let uneven = math::hypot(fitted[2], fitted[3]);
        let offset = Complex::new(fitted[4], fitted[5]) * direction;
        let turn = math::atan2(direction.im, direction.re) + fitted[0];
        Some(WheelsFit {
            turn: wrap_angle(turn),
            turn_std: covariance[(0, 0)].sqrt(),
            origin: OriginOffset {
                at: Vector2::new(offset.re, offset.im),
                variance: 0.5 * (covariance[(4, 4)] + covariance[(5, 5)]) + centre_variance(uneven),
            },
        })
    }
}

/// Three equations of a step, divided by its expected errors.
struct FitRows {
    slopes: SMatrix<f32, 3, 9>,
    measured: Vector3<f32>,
}

impl FitRows {
    /// `direction`: of the wheels' axes in those of the poses, as far as it is known.
    fn new(step: &DerivedStep, direction: Complex<f32>) -> Self {
        let MeasuredStep { wheels, poses } = step.step;
        let turned = Complex::new(poses.x, poses.y) * direction.conj();
        let measured = Vector3::new(
            turned.re - wheels.x,
            turned.im - wheels.y,
            wrap_angle(poses.theta - wheels.theta),
        );
        let [xx, xy, xt, yx, yy, yt, tx, ty, tt] =
            std::array::from_fn(|entry| step.by_matrix.column(entry).into_owned());
        // A turn leaves the rate of turning along the path as it is: the axes of step and path turn alike.
        let slopes = [yx - xy, xx + yy, xx - yy, xy + yx, yt, -xt, tx, ty, tt];
        let std = Vector3::new(STEP_STD.0, STEP_STD.0, STEP_STD.1);
        FitRows {
            slopes: SMatrix::from_columns(&slopes.map(|slope| slope.component_div(&std))),
            measured: measured.component_div(&std),
        }
    }

    fn error(&self, fitted: &Unknowns) -> Vector3<f32> {
        self.slopes * fitted - self.measured
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Complex, Matrix3};

    use super::*;
    use crate::frames::{RobotFrame, Tf};
    use crate::setup_check::WheelMotion;
    use crate::wheel_steps::angle_between;

    /// Two metres between keyframes, of a robot that goes to and fro with turns. The wheels measure `matrix`⁻¹ of the motion, the poses
    /// are those of a camera turned by `angle` whose map has its origin at `origin`. Every ninth pose is a wrong one.
    fn drive(matrix: &Matrix3<f32>, angle: f32, origin: [f32; 2]) -> Vec<DerivedStep> {
        let inverse = matrix.try_inverse().expect("a matrix");
        let step = |k: u8| {
            let at = f32::from(k);
            let row = |i: u8| {
                let along = 0.9 + 0.5 * math::sin(2.1 * at) + 0.01 * f32::from(i);
                let turn = 0.012 * math::sin(1.3 * at + 0.02 * f32::from(i)) + 0.004;
                Vector3::new(0.02 * math::cos(along), 0.02 * math::sin(along), turn)
            };
            let rows = |matrix: &Matrix3<f32>| -> Vec<[f32; 3]> {
                (0..100).map(|i| (matrix * row(i)).into()).collect()
            };
            let wheels = WheelMotion::from_increments(&rows(&inverse));
            let true_step = WheelMotion::from_increments(&rows(&Matrix3::identity())).step;
            let mount = Tf::new(origin[0], origin[1], angle);
            let seen: Tf<RobotFrame, RobotFrame> = mount.inverse() * true_step * mount;
            let off = if k % 9 == 8 {
                0.8
            } else {
                0.01 * math::sin(7.7 * at)
            };
            DerivedStep {
                step: MeasuredStep {
                    wheels: wheels.step,
                    poses: Tf::new(seen.x + off, seen.y - off, seen.theta),
                },
                by_matrix: wheels.by_matrix,
            }
        };
        (0..38).map(step).collect()
    }

    /// Wheels whose radii differ by 3 %: they turn a robot that goes straight.
    fn uneven() -> Matrix3<f32> {
        Matrix3::new(1.02, -0.003, 0.0, -0.005, 1.0, 0.0, -0.015, 0.06, 1.005)
    }

    #[test]
    fn uneven_wheels_do_not_pass_for_a_turned_camera() {
        let steps = drive(&uneven(), 0.0, [0.0; 2]);
        let fit = WheelsFit::fit(&steps).expect("a fit");
        assert!(
            fit.turn.abs() < 0.6_f32.to_radians() && fit.turn_std < 0.5_f32.to_radians(),
            "{fit:?}"
        );
        let chords: Vec<MeasuredStep> = steps.iter().map(|step| step.step).collect();
        let (angle, _) = angle_between(&chords).expect("an angle");
        assert!(
            angle.abs() > 1.5_f32.to_radians(),
            "chords are turned: {angle}"
        );
    }

    #[test]
    fn turn_and_origin_are_found_beside_uneven_wheels() {
        for (degrees, origin) in [
            (-4.0_f32, [0.0, 0.0]),
            (4.0, [0.07, -0.07]),
            (110.0, [-0.05, 0.1]),
        ] {
            let steps = drive(&uneven(), degrees.to_radians(), origin);
            let fit = WheelsFit::fit(&steps).expect("a fit");
            // The poses' axes are turned by less than the camera's mount if they are those of the mount.
            let turn = wrap_angle(fit.turn + degrees.to_radians()).to_degrees();
            assert!(turn.abs() < 0.7, "{degrees}: {fit:?}");
            let at = Complex::new(fit.origin.at.x, fit.origin.at.y)
                * Complex::from_polar(1.0, degrees.to_radians());
            let off = (at - Complex::new(origin[0], origin[1])).norm();
            assert!(
                off < 0.02 && fit.origin.variance.sqrt() < 0.03,
                "{degrees}: {fit:?}, {off} m"
            );
        }
    }
}
