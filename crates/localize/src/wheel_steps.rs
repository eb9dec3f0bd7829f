//! By which angle, offset and matrix do the wheels differ from the poses? Robust fits to steps of a drive (docs/methods.md 16.2).

use nalgebra::{Matrix2, Matrix3, Matrix6, RowVector6, Vector2, Vector3, Vector6};

use crate::frames::{RobotFrame, Tf, wrap_angle};
use crate::math;

/// Shorter steps say little about a direction, metres.
const STEP_MIN: f32 = 0.1;
/// Fewer steps fit anything.
const STEPS_MIN: usize = 6;
/// Expected errors of a step between two poses: metres, radians.
pub const STEP_STD: (f32, f32) = (0.03, 0.04);
/// Standard deviation of what right wheels may have: the share by which they measure one direction longer than another.
const UNEVEN_STD: f32 = 0.04;
/// Standard deviation of the offset of an origin of which nothing is known, metres.
const OFFSET_STD: f32 = 0.5;
/// Standard deviation of the elements of a matrix of wrong wheels.
const MATRIX_STD: f32 = 0.3;
/// Smallest spread of steps: that of poses on a perfect map, shares of the expected errors.
const SPREAD_MIN: f32 = 0.2;
/// Standard deviations of the factor from the wheels' motion to that of the poses: where nothing is known, and of wheels in order.
const UNKNOWN_ANGLE_STD: f32 = 10.0;
const KNOWN_ANGLE_STD: f32 = 0.2;
/// Directions that count as the same one, radians.
const SAME_DIRECTION: f32 = 0.2;
/// Passes of the reweighted fit.
const PASSES: usize = 8;

/// Standard deviation of the centre about which right wheels turn, metres.
const CENTRE_STD: f32 = 0.01;
/// Distance of the wheels from the centre, metres: what uneven wheels move it by.
const BASE_RADIUS: f32 = 0.25;

/// One motion, measured twice, in the robot frame at its start.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeasuredStep {
    /// By the wheels.
    pub wheels: Tf<RobotFrame, RobotFrame>,
    /// Between the poses that the line points give.
    pub poses: Tf<RobotFrame, RobotFrame>,
}

/// The poses' origin in the frame of the wheels, as a drive tells it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OriginOffset {
    /// From the point about which the wheels turn, robot frame, metres.
    pub at: Vector2<f32>,
    /// Covariance, m², with that of the wheels' own centre.
    pub covariance: Matrix2<f32>,
}

/// Angle from the wheels' steps to those of the poses, radians, with its standard deviation.
///
/// Unevenly long directions and an offset of the centre are fitted along with it: they turn single steps, and make the angle
/// uncertain where the robot has driven in one direction only. None for too few steps that agree on an angle.
pub fn angle_between(steps: &[MeasuredStep]) -> Option<(f32, f32)> {
    let angle = common_angle(&angles(steps))?;
    let (fitted, covariance) = fit_steps(steps, angle, UNKNOWN_ANGLE_STD)?;
    let scale = math::hypot(fitted[0], fitted[1]);
    let across = Vector6::new(-fitted[1], fitted[0], 0.0, 0.0, 0.0, 0.0) / (scale * scale);
    let std = (across.transpose() * covariance * across).x.sqrt();
    (scale > 0.3).then(|| (math::atan2(fitted[1], fitted[0]), std))
}

impl OriginOffset {
    /// Offset by steps of a drive. None for too few steps that agree on an angle or turn in place.
    pub fn measure(steps: &[MeasuredStep]) -> Option<Self> {
        let angles = angles(steps);
        let (angle, std) = if angles.len() < STEPS_MIN {
            // Turns in place tell no angle, but the offset best of all.
            let short = |step: &Tf<RobotFrame, RobotFrame>| math::hypot(step.x, step.y) <= STEP_MIN;
            let in_place = |step: &&MeasuredStep| short(&step.wheels) && short(&step.poses);
            if steps.iter().filter(in_place).count() < STEPS_MIN.max(steps.len() / 2) {
                return None;
            }
            (0.0, KNOWN_ANGLE_STD)
        } else {
            (common_angle(&angles)?, UNKNOWN_ANGLE_STD)
        };
        let (fitted, covariance) = fit_steps(steps, angle, std)?;
        // Wheels that measure one direction longer than another turn about another point, too.
        let uneven = BASE_RADIUS * math::hypot(fitted[2], fitted[3]);
        let of_centre = CENTRE_STD * CENTRE_STD + uneven * uneven;
        Some(OriginOffset {
            at: fitted.fixed_rows::<2>(4).into_owned(),
            covariance: covariance.fixed_view::<2, 2>(4, 4) + Matrix2::identity() * of_centre,
        })
    }
}

/// Angles from the wheels' steps to those of the poses, radians, of steps that have a direction.
fn angles(steps: &[MeasuredStep]) -> Vec<f32> {
    let directed = steps.iter().filter(|step| {
        let (wheels, poses) = (step.wheels, step.poses);
        let (wheels, poses) = (
            math::hypot(wheels.x, wheels.y),
            math::hypot(poses.x, poses.y),
        );
        wheels > STEP_MIN && poses > 0.5 * wheels && poses < 2.0 * wheels
    });
    let angle = |MeasuredStep { wheels, poses }: &MeasuredStep| {
        let (across, along) = (
            wheels.x * poses.y - wheels.y * poses.x,
            wheels.x * poses.x + wheels.y * poses.y,
        );
        math::atan2(across, along)
    };
    directed.map(angle).collect()
}

/// The angle on which most agree. None for too few, and if fewer than half agree.
fn common_angle(angles: &[f32]) -> Option<f32> {
    if angles.len() < STEPS_MIN {
        return None;
    }
    let near = |one: f32| {
        let others = angles.iter();
        let same = others.filter(|other| wrap_angle(*other - one).abs() < SAME_DIRECTION);
        same.count()
    };
    let (angle, agreeing) = angles
        .iter()
        .map(|one| (*one, near(*one)))
        .max_by_key(|(_, count)| *count)?;
    (2 * agreeing >= angles.len()).then_some(angle)
}

/// Rotation and scale of the wheels' steps (two numbers, as of a complex factor), their unevenness (two), and the offset of the
/// poses' origin (two, metres) with which they become the steps of the poses, and the covariance of these numbers. The factor is
/// expected to be a turn by `angle`, up to `std`.
fn fit_steps(steps: &[MeasuredStep], angle: f32, std: f32) -> Option<(Vector6<f32>, Matrix6<f32>)> {
    let steps: Vec<([f32; 3], [f32; 2])> = steps
        .iter()
        .map(|step| {
            let (wheels, poses) = (step.wheels, step.poses);
            ([wheels.x, wheels.y, wheels.theta], [poses.x, poses.y])
        })
        .collect();
    let expected = Vector6::new(math::cos(angle), math::sin(angle), 0.0, 0.0, 0.0, 0.0);
    let mut fitted = expected;
    let prior = Vector6::new(std, std, UNEVEN_STD, UNEVEN_STD, OFFSET_STD, OFFSET_STD)
        .map(|std| 1.0 / (std * std));
    let mut covariance = Matrix6::zeros();
    for _ in 0..PASSES {
        let rows = |[wx, wy, turn]: [f32; 3]| {
            let (sin, cos) = math::sin_cos(turn);
            [
                RowVector6::new(wx, -wy, wx, wy, cos - 1.0, -sin),
                RowVector6::new(wy, wx, -wy, wx, sin, cos - 1.0),
            ]
        };
        let errors: Vec<f32> = steps
            .iter()
            .map(|(wheels, [x, y])| {
                let [row_x, row_y] = rows(*wheels);
                math::hypot((row_x * fitted).x - x, (row_y * fitted).x - y)
            })
            .collect();
        // Six fitted numbers make few steps look better than they are.
        let coordinates = 2.0 * steps.len() as f32;
        let freedom = coordinates / (coordinates - 6.0);
        let std = (spread(&errors) * freedom.sqrt()).max(STEP_STD.0);
        let mut information = Matrix6::from_diagonal(&prior);
        let mut vector = prior.component_mul(&expected);
        for ((wheels, target), error) in steps.iter().zip(&errors) {
            let weight = weight(error / std) / (std * std);
            for (row, value) in rows(*wheels).iter().zip(target) {
                information += row.transpose() * row * weight;
                vector += row.transpose() * (*value * weight);
            }
        }
        covariance = information.try_inverse()?;
        fitted = covariance * vector;
    }
    Some((fitted, covariance))
}

/// The matrix by which the wheels' motion (metres, metres, radians) becomes that of the poses. None for too few steps.
pub fn matrix_between(steps: &[MeasuredStep]) -> Option<Matrix3<f32>> {
    if steps.len() < STEPS_MIN {
        return None;
    }
    let pairs = motions(steps);
    let mut matrix = Matrix3::identity();
    for _ in 0..PASSES {
        let errors = matrix_errors(&pairs, &matrix);
        let std = spread(&errors).max(1.0);
        let mut information = Matrix3::identity() / (MATRIX_STD * MATRIX_STD);
        let mut products = information;
        for ((wheels, poses), error) in pairs.iter().zip(&errors) {
            let weight = weight(error / std) / (STEP_STD.0 * std).powi(2);
            information += wheels * wheels.transpose() * weight;
            products += poses * wheels.transpose() * weight;
        }
        matrix = products * information.try_inverse()?;
    }
    Some(matrix)
}

/// Log likelihood that a matrix gains at the steps, whose spread is estimated with it and without it.
pub fn matrix_gain(steps: &[MeasuredStep], matrix: &Matrix3<f32>) -> f32 {
    let pairs = motions(steps);
    let [before, after] = [Matrix3::identity(), *matrix]
        .map(|matrix| spread(&matrix_errors(&pairs, &matrix)).max(SPREAD_MIN));
    // Two coordinates of each step: the turns rarely differ.
    2.0 * steps.len() as f32 * math::ln(before / after)
}

/// Each step by the wheels and by the poses: metres, metres, radians.
fn motions(steps: &[MeasuredStep]) -> Vec<(Vector3<f32>, Vector3<f32>)> {
    let vector = |x: f32, y: f32, turn: f32| Vector3::new(x, y, turn);
    let pairs = steps.iter().map(|MeasuredStep { wheels, poses }| {
        (
            vector(wheels.x, wheels.y, wheels.theta),
            vector(poses.x, poses.y, poses.theta),
        )
    });
    pairs.collect()
}

/// Errors of steps with a matrix of the wheels, in their expected standard deviations.
fn matrix_errors(pairs: &[(Vector3<f32>, Vector3<f32>)], matrix: &Matrix3<f32>) -> Vec<f32> {
    let errors = pairs.iter().map(|(wheels, poses)| {
        let error = matrix * wheels - poses;
        let (position, turn) = (math::hypot(error.x, error.y), error.z);
        math::hypot(position / STEP_STD.0, turn / STEP_STD.1)
    });
    errors.collect()
}

/// Standard deviation of errors by their median, so that outliers do not count.
pub fn spread(errors: &[f32]) -> f32 {
    let mut sorted = errors.to_vec();
    sorted.sort_by(f32::total_cmp);
    sorted
        .get(sorted.len() / 2)
        .map_or(0.0, |median| 1.2 * median)
}

/// Weight of an error in standard deviations: an outlier has next to none.
pub fn weight(deviation: f32) -> f32 {
    (1.0 + (deviation / 2.0).powi(2)).powi(-2)
}

#[cfg(test)]
mod tests {
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
            assert!(found.covariance.trace().sqrt() < 0.06, "{found:?}");
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
        assert!(found.covariance.trace().sqrt() < 0.04, "{found:?}");
        // A robot that drives circles of half a metre.
        assert!(OriginOffset::measure(&circling(0.5).collect::<Vec<_>>()).is_none());
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
        assert!(found.covariance.trace().sqrt() > 0.5, "{found:?}");
    }

    #[test]
    fn matrix_of_wrong_wheels_is_found_beside_outliers() {
        let wrong = Matrix3::new(1.2, 0.1, 0.02, -0.08, 0.8, 0.0, 0.1, 0.0, 0.9);
        let found = matrix_between(&steps(0.0, wrong)).expect("a matrix");
        assert!((found - wrong).norm() < 0.08, "{found}");
    }
}
