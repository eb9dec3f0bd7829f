//! By which angle, offset and matrix do the wheels differ from the poses? Robust fits to steps of a drive (docs/methods.md 16.2).

mod matrix;
mod step;
mod step_fit;
mod wheels_fit;

use nalgebra::{Complex, Vector2};

pub use self::matrix::{MatrixFit, factor_between, matrix_between, matrix_gain};
use self::step::STEPS_MIN;
pub use self::step::{MeasuredStep, STEP_STD, spread, weight};
use self::step_fit::{KNOWN_FACTOR_STD, StepFit};
pub use self::wheels_fit::{DerivedStep, MatrixDerivatives, WheelsFit};
use crate::frames::{RobotFrame, Tf};
use crate::math;

/// Shorter steps say little about a direction, metres.
const STEP_MIN: f32 = 0.1;
/// Standard deviation of the factor from the wheels' motion to that of the poses, where nothing is known.
const UNKNOWN_FACTOR_STD: f32 = 10.0;
/// Directions that count as the same one, radians.
const SAME_DIRECTION: f32 = 0.2;

/// Standard deviation of the centre about which right wheels turn, metres.
const CENTRE_STD: f32 = 0.01;
/// Distance of the wheels from the centre, metres: what uneven wheels move it by.
const BASE_RADIUS: f32 = 0.25;

/// The poses' origin in the frame of the wheels, as a drive tells it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OriginOffset {
    /// From the point about which the wheels turn, robot frame, metres.
    pub at: Vector2<f32>,
    /// Variance of each coordinate, m², with that of the wheels' own centre.
    pub variance: f32,
}

/// Angle from the wheels' steps to those of the poses, radians, with its standard deviation.
///
/// Unevenly long directions and an offset of the centre are fitted along with it: they turn single steps, and make the angle
/// uncertain where the robot has driven in one direction only. None for too few steps that agree on an angle.
pub fn angle_between(steps: &[MeasuredStep]) -> Option<(f32, f32)> {
    let direction = common_direction(&directions(steps))?;
    let fit = StepFit::fit(steps, direction, UNKNOWN_FACTOR_STD)?;
    let scale = math::hypot(fit.factor.re, fit.factor.im);
    let std = fit.variances[0].sqrt() / scale;
    (scale > 0.3).then(|| (math::atan2(fit.factor.im, fit.factor.re), std))
}

impl OriginOffset {
    /// Offset by steps of a drive. None for too few steps that agree on an angle or turn in place.
    pub fn measure(steps: &[MeasuredStep]) -> Option<Self> {
        let (direction, std) = start_direction(steps)?;
        let fit = StepFit::fit(steps, direction, std)?;
        let uneven = math::hypot(fit.unevenness.re, fit.unevenness.im);
        Some(OriginOffset {
            at: Vector2::new(fit.offset.re, fit.offset.im),
            variance: fit.variances[2] + centre_variance(uneven),
        })
    }
}

/// Variance of each coordinate of the point about which right wheels turn, m². Those that measure one direction longer than another, by a
/// share of `uneven`, turn about another point, too.
fn centre_variance(uneven: f32) -> f32 {
    CENTRE_STD * CENTRE_STD + (BASE_RADIUS * uneven).powi(2)
}

/// Direction from the wheels' steps to those of the poses, and the standard deviation of the factor between them. None for too few that
/// agree on one or turn in place.
fn start_direction(steps: &[MeasuredStep]) -> Option<(Complex<f32>, f32)> {
    let directions = directions(steps);
    if directions.len() >= STEPS_MIN {
        return Some((common_direction(&directions)?, UNKNOWN_FACTOR_STD));
    }
    // Turns in place tell no angle, but the offset best of all.
    let short = |step: &Tf<RobotFrame, RobotFrame>| math::hypot(step.x, step.y) <= STEP_MIN;
    let in_place = |step: &&MeasuredStep| short(&step.wheels) && short(&step.poses);
    (steps.iter().filter(in_place).count() >= STEPS_MIN.max(steps.len() / 2))
        .then_some((Complex::ONE, KNOWN_FACTOR_STD))
}

/// Directions from the wheels' steps to those of the poses, as unit complex numbers, of steps that have one.
fn directions(steps: &[MeasuredStep]) -> Vec<Complex<f32>> {
    let direction = |MeasuredStep { wheels, poses }: &MeasuredStep| {
        let wheels = Complex::new(wheels.x, wheels.y);
        let quotient = Complex::new(poses.x, poses.y) * wheels.conj();
        let squared = wheels.norm_sqr();
        let length = quotient.norm_sqr().sqrt();
        let directed = squared > STEP_MIN * STEP_MIN;
        (directed && length > 0.5 * squared && length < 2.0 * squared).then(|| quotient / length)
    };
    steps.iter().filter_map(direction).collect()
}

/// The direction on which most agree. None for too few, and if fewer than half agree.
fn common_direction(directions: &[Complex<f32>]) -> Option<Complex<f32>> {
    if directions.len() < STEPS_MIN {
        return None;
    }
    let same = math::cos(SAME_DIRECTION);
    let near = |one: Complex<f32>| {
        let others = directions.iter();
        let near = others.filter(|other| one.re * other.re + one.im * other.im > same);
        near.count()
    };
    let (direction, agreeing) = directions
        .iter()
        .map(|one| (*one, near(*one)))
        .max_by_key(|(_, count)| *count)?;
    (2 * agreeing >= directions.len()).then_some(direction)
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix3, Vector3};

    use super::*;

    /// Steps in many directions of wheels that measure `matrix`⁻¹ of the motion and of poses turned by `angle`, with noise;
    /// every sixth pose is a wrong one.
    fn steps(angle: f32, matrix: Matrix3<f32>) -> Vec<MeasuredStep> {
        let inverse = matrix.try_inverse().expect("a matrix");
        (0..36)
            .map(|k| {
                let at = k as f32;
                let direction = 2.1 * at;
                let true_step = Vector3::new(
                    0.4 * math::cos(direction),
                    0.4 * math::sin(direction),
                    0.3 * math::sin(1.3 * at),
                );
                let wheels = inverse * true_step;
                let noise = 0.01 * math::sin(7.7 * at);
                let (s, c) = (math::sin(angle), math::cos(angle));
                let (x, y) = (true_step.x, true_step.y);
                let jump = if k % 6 == 5 { 0.5 } else { 0.0 };
                MeasuredStep {
                    wheels: Tf::new(wheels.x, wheels.y, wheels.z),
                    poses: Tf::new(
                        c * x - s * y + noise + jump,
                        s * x + c * y - noise,
                        true_step.z,
                    ),
                }
            })
            .collect()
    }

    #[test]
    fn angle_of_a_turned_camera_is_found_beside_outliers() {
        for degrees in [-170.0_f32, -45.0, 0.0, 3.0, 10.0] {
            let (angle, std) =
                angle_between(&steps(degrees.to_radians(), Matrix3::identity())).expect("an angle");
            let error = angle.to_degrees() - degrees;
            assert!(error.abs() < 1.0, "{degrees}: {error} off");
            assert!(std.to_degrees() < 1.5, "{degrees}: +-{}", std.to_degrees());
        }
    }

    #[test]
    fn angle_of_one_direction_of_driving_is_uncertain() {
        let straight: Vec<_> = (0..30)
            .map(|_| MeasuredStep {
                wheels: Tf::new(0.4, 0.0, 0.0),
                poses: Tf::new(0.4, 0.016, 0.0),
            })
            .collect();
        let (angle, std) = angle_between(&straight).expect("an angle");
        assert!(
            angle.abs() < 2.0 * std,
            "{angle} +- {std}: uneven wheels would do the same"
        );
    }

    #[test]
    fn offset_of_the_poses_origin_is_found_in_turns_beside_uneven_wheels_and_outliers() {
        let uneven = Matrix3::from_diagonal(&Vector3::new(1.03, 0.98, 1.0));
        for offset in [[0.0, 0.0], [0.12, -0.05], [0.0, 0.04]] {
            let origin = Tf::new(offset[0], offset[1], 0.0);
            let moved = steps(0.0, uneven).into_iter().map(|step| MeasuredStep {
                poses: origin.inverse() * step.poses * origin,
                ..step
            });
            let found = OriginOffset::measure(&moved.collect::<Vec<_>>()).expect("an offset");
            let error = found.at - Vector2::from(offset);
            assert!(error.norm() < 0.02, "{offset:?}: {found:?}");
            // Half of it is that of the centre about which uneven wheels turn.
            assert!((2.0 * found.variance).sqrt() < 0.06, "{found:?}");
        }
    }

    #[test]
    fn turns_in_place_tell_the_offset_and_wheels_that_stand_still_do_not() {
        let circling = |origin: f32| {
            (0..20).map(move |k| {
                let turn = if k % 7 == 0 { -0.4_f32 } else { 0.4 };
                let (sin, cos) = math::sin_cos(turn);
                MeasuredStep {
                    wheels: Tf::new(0.0, 0.001, turn),
                    poses: Tf::new(origin * (cos - 1.0), origin * sin, turn),
                }
            })
        };
        let found = OriginOffset::measure(&circling(0.05).collect::<Vec<_>>()).expect("an offset");
        assert!(
            (found.at - Vector2::new(0.05, 0.0)).norm() < 0.003,
            "{found:?}"
        );
        assert!((2.0 * found.variance).sqrt() < 0.04, "{found:?}");
        // A robot that drives circles of half a metre.
        assert!(OriginOffset::measure(&circling(0.5).collect::<Vec<_>>()).is_none());
    }

    #[test]
    fn turns_show_slip_that_passes_for_an_offset_by_positions() {
        let slipping = |seen: bool| {
            let steps = steps(0.0, Matrix3::identity()).into_iter().enumerate();
            let steps = steps.map(|(k, mut step)| {
                // Wheels that spin while the robot turns: the more it turns, the farther aside.
                if k % 2 == 0 {
                    step.wheels.x = 1.4 * step.poses.x - 0.2 * step.poses.theta;
                    step.wheels.y = 1.4 * step.poses.y + 0.2 * step.poses.theta;
                    step.wheels.theta -= if seen { 0.3 } else { 0.0 };
                }
                step
            });
            OriginOffset::measure(&steps.collect::<Vec<_>>()).expect("an offset")
        };
        let beside = |found: &OriginOffset| found.at.norm() / found.variance.sqrt();
        let (found, misled) = (slipping(true), slipping(false));
        assert!(beside(&found) < 1.0, "{found:?}");
        assert!(beside(&misled) > 1.5, "positions tell it: {misled:?}");
    }

    #[test]
    fn offset_is_uncertain_without_turns() {
        let straight: Vec<_> = (0..30)
            .map(|_| MeasuredStep {
                wheels: Tf::new(0.4, 0.0, 0.0),
                poses: Tf::new(0.4, 0.016, 0.0),
            })
            .collect();
        let found = OriginOffset::measure(&straight).expect("an offset");
        assert!((2.0 * found.variance).sqrt() > 0.5, "{found:?}");
    }

    #[test]
    fn matrix_of_wrong_wheels_is_found_beside_outliers() {
        let wrong = Matrix3::new(1.2, 0.1, 0.02, -0.08, 0.8, 0.0, 0.1, 0.0, 0.9);
        let found = matrix_between(&steps(0.0, wrong)).expect("a matrix");
        assert!((found.matrix - wrong).norm() < 0.08, "{found:?}");
    }

    #[test]
    fn factor_of_wheels_of_another_size_is_found_beside_outliers() {
        for factor in [0.5, 1.0, 2.0] {
            let steps = steps(0.0, Matrix3::from_diagonal_element(factor));
            let found = factor_between(&steps).expect("a factor");
            let error = found.matrix[(2, 2)] - factor;
            assert!(error.abs() < 3.0 * found.std && found.std < 0.03 * factor);
        }
    }

    #[test]
    fn matrix_of_one_direction_of_driving_is_uncertain_and_its_factor_is_not() {
        let straight: Vec<_> = (0..30)
            .map(|_| MeasuredStep {
                wheels: Tf::new(0.4, 0.0, 0.0),
                poses: Tf::new(0.2, 0.0, 0.0),
            })
            .collect();
        let [matrix, factor] = [matrix_between, factor_between].map(|fit| fit(&straight));
        assert!(matrix.expect("a matrix").std > 0.2);
        let factor = factor.expect("a factor");
        assert!(factor.std < 0.02 && (factor.matrix[(1, 1)] - 0.5).abs() < 0.01);
    }
}
