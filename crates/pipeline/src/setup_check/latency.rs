//! How old are the images at their stamps? Steps of wheels and poses then differ while the robot's velocity changes.

use localize::frames::{RobotFrame, Tf, wrap_angle};
use localize::math;
use localize::setup_check::Explanation;
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

use super::measurements::MeasuredKeyframe;
use localize::wheel_steps::{STEP_STD, spread, weight};

/// Fewer steps tell no latency.
const STEPS_MIN: usize = 12;
/// Standard deviation of the age beyond the configured one before anything is known, seconds, and of the entries of a matrix that corrects
/// the wheels: wheels of unequal radius move a robot sideways as it turns, and an older image looks alike.
const AGE_STD: f32 = 0.3;
const SCALE_STD: f32 = 0.05;
/// Metres: an entry between path and turn counts at this distance from the centre.
const LEVER: f32 = 0.25;
/// Step of the derivatives by an entry.
const ENTRY_STEP: f32 = 1e-2;
/// Passes of the reweighted fit.
const PASSES: usize = 8;
/// Steps are not more accurate than this share of their expected errors.
const STD_MIN: f32 = 0.05;

/// A smaller difference from the configured latency is no mistake, seconds, and a less certain one.
const AGE_MIN: f32 = 0.018;
/// Images that seem younger than configured are wheels that slip, as a rule.
pub(super) const YOUTH_MIN: f32 = 0.03;
const AGE_SIGMAS: f32 = 5.0;

/// A latency that differs from the configured one.
#[derive(Debug, Clone, Copy)]
pub(super) struct OtherLatency {
    /// Age of the images at their stamps, seconds. Negative if the stamps of the wheels are late.
    pub(super) age: f32,
    /// The configured one, seconds.
    pub(super) configured: f32,
    /// What the difference does to the poses: metres, metres, radians, root mean square.
    pub(super) pose_error: Vector3<f32>,
}

/// Age, and entries of the matrix less those of the identity, row by row.
type Unknowns = SVector<f32, 10>;

/// One step between keyframes: derivatives of its error (x, y, θ), and the error.
type StepError = ([Unknowns; 3], Vector3<f32>);

/// The latency that the steps show, if it differs from the configured one, by which the wheels' steps end at exposures.
/// `wheels`: the matrix of their motion.
///
/// An image that is τ older shows the pose T(t − τ) = T(t) exp(−τ v), so a step of poses is exp(τ v₀) W exp(−τ v₁), where W is that
/// of the wheels. Wheels that slip when the robot accelerates do the same to its path: the turns must show the age, too.
pub(super) fn other_latency(
    measured: &[MeasuredKeyframe],
    explanation: &Explanation,
    wheels: &Matrix3<f32>,
    configured: f32,
) -> Option<OtherLatency> {
    let velocity =
        |keyframe: &MeasuredKeyframe| keyframe.velocity.map(|v| wheels * Vector3::from(v));
    let pairs = measured.windows(2).zip(explanation.keyframes.windows(2));
    let steps: Vec<StepError> = pairs
        .filter_map(|(measured, fits)| {
            let step = fits[1].wheel_step?;
            let (before, after) = (velocity(&measured[0])?, velocity(&measured[1])?);
            let poses = fits[0].pose?.inverse() * fits[1].pose?;
            let error = step.inverse() * poses;
            let error = Vector3::new(error.x, error.y, wrap_angle(error.theta));
            let rows = match &measured[1].odometry {
                Some(rows) => rows
                    .iter()
                    .map(|row| wheels * Vector3::from(*row))
                    .collect(),
                None => vec![Vector3::new(step.x, step.y, step.theta)],
            };
            Some((derivatives(step, &rows, before, after), error))
        })
        .collect();
    if steps.len() < STEPS_MIN {
        return None;
    }
    let (excess, std) = fit_age(&steps, &[0, 1, 2])?;
    let (excess_of_turns, std_of_turns) = fit_age(&steps, &[2])?;
    let differs = |excess: f32, std: f32| excess.abs() > AGE_SIGMAS * std;
    let turns_agree = differs(excess_of_turns, std_of_turns)
        && (excess_of_turns - excess).abs() < 0.5 * excess.abs();
    if (-YOUTH_MIN..AGE_MIN).contains(&excess) || !differs(excess, std) || !turns_agree {
        return None;
    }
    Some(OtherLatency::new(
        configured + excess,
        configured,
        measured,
        wheels,
    ))
}

impl OtherLatency {
    /// `wheels`: the matrix of their motion.
    pub(super) fn new(
        age: f32,
        configured: f32,
        measured: &[MeasuredKeyframe],
        wheels: &Matrix3<f32>,
    ) -> Self {
        let velocities = measured.iter().filter_map(|keyframe| keyframe.velocity);
        let squares: Vec<Vector3<f32>> = velocities
            .map(|velocity| (wheels * Vector3::from(velocity)).map(|v| v * v))
            .collect();
        let mean = squares.iter().sum::<Vector3<f32>>() / squares.len().max(1) as f32;
        let speed = (0.5 * (mean.x + mean.y)).sqrt();
        OtherLatency {
            age,
            configured,
            pose_error: Vector3::new(speed, speed, mean.z.sqrt()) * (age - configured).abs(),
        }
    }
}

/// Age of the images beyond the configured one and its standard deviation, seconds, fitted to some components of the steps with a matrix of the wheels.
fn fit_age(steps: &[StepError], components: &[usize]) -> Option<(f32, f32)> {
    let std_of = [STEP_STD.0, STEP_STD.0, STEP_STD.1];
    let prior = Unknowns::from_fn(|k, _| {
        let std = match k.checked_sub(1) {
            None => AGE_STD,
            Some(entry) => match (entry / 3 == 2, entry % 3 == 2) {
                (true, false) => SCALE_STD / LEVER,
                (false, true) => SCALE_STD * LEVER,
                _ => SCALE_STD,
            },
        };
        1.0 / (std * std)
    });
    let mut fitted = Unknowns::zeros();
    let mut covariance = SMatrix::<f32, 10, 10>::zeros();
    for _ in 0..PASSES {
        let deviations: Vec<f32> = steps
            .iter()
            .map(|(rows, error)| {
                let left = |&k: &usize| (error[k] - rows[k].dot(&fitted)) / std_of[k];
                components.iter().map(left).fold(0.0, math::hypot)
            })
            .collect();
        let std = spread(&deviations).max(STD_MIN);
        let mut information = SMatrix::<f32, 10, 10>::from_diagonal(&prior);
        let mut vector = Unknowns::zeros();
        for ((rows, error), deviation) in steps.iter().zip(&deviations) {
            for &k in components {
                let weight = weight(deviation / std) / (std_of[k] * std).powi(2);
                information += rows[k] * rows[k].transpose() * weight;
                vector += rows[k] * (error[k] * weight);
            }
        }
        covariance = information.try_inverse()?;
        fitted = covariance * vector;
    }
    Some((fitted[0], covariance[(0, 0)].sqrt()))
}

/// Derivatives of a step's error (x, y, θ at its end) by age and by the entries of the wheels' matrix, row by row. `rows`: the motion of the
/// wheels in the step.
fn derivatives(
    step: Tf<RobotFrame, RobotFrame>,
    rows: &[Vector3<f32>],
    before: Vector3<f32>,
    after: Vector3<f32>,
) -> [Unknowns; 3] {
    let (sin, cos) = (math::sin(step.theta), math::cos(step.theta));
    // The velocity at the step's start, at its end.
    let (x, y) = (before.x - before.z * step.y, before.y + before.z * step.x);
    let moved = [cos * x + sin * y, cos * y - sin * x, before.z];
    let mut derivatives: [Unknowns; 3] = std::array::from_fn(|k| {
        let mut row = Unknowns::zeros();
        row[0] = moved[k] - after[k];
        row
    });
    let as_measured = joined(rows, &Matrix3::identity()).inverse();
    for entry in 0..9 {
        let mut matrix = Matrix3::identity();
        matrix[(entry / 3, entry % 3)] += ENTRY_STEP;
        let change = as_measured * joined(rows, &matrix);
        let change = [change.x, change.y, wrap_angle(change.theta)];
        for (row, change) in derivatives.iter_mut().zip(change) {
            row[1 + entry] = change / ENTRY_STEP;
        }
    }
    derivatives
}

/// The motion of rows after a matrix.
fn joined(rows: &[Vector3<f32>], matrix: &Matrix3<f32>) -> Tf<RobotFrame, RobotFrame> {
    rows.iter().fold(Tf::new(0.0, 0.0, 0.0), |path, row| {
        let row = matrix * row;
        path * Tf::new(row.x, row.y, row.z)
    })
}

#[cfg(test)]
mod tests {
    use localize::Pose;
    use localize::setup_check::KeyframeFit;

    use super::*;

    /// A drive whose velocity changes all the time; the images are `age` seconds older than configured, the wheels slip by
    /// `slip` of each change of their speed and measure the motion after `wheels`.
    fn drive(
        age: f32,
        slip: f32,
        turns: f32,
        wheels: &Matrix3<f32>,
    ) -> (Vec<MeasuredKeyframe>, Explanation) {
        const STEP: f32 = 0.002;
        let velocity = |t: f32| {
            let (x, y) = (1.5 * math::sin(1.7 * t), 1.2 * math::cos(1.1 * t));
            [x, y, turns * math::sin(2.3 * t)]
        };
        let count = (24.0 / STEP) as usize;
        let path = |matrix: &Matrix3<f32>| {
            let mut path = vec![Tf::<RobotFrame, RobotFrame>::new(0.0, 0.0, 0.0)];
            for k in 0..count {
                let step = matrix * Vector3::from(velocity(k as f32 * STEP)) * STEP;
                path.push(path[k] * Tf::<RobotFrame, RobotFrame>::new(step.x, step.y, step.z));
            }
            path
        };
        let (path, by_wheels) = (path(&Matrix3::identity()), path(wheels));
        let index = |t: f32| ((t / STEP).round() as usize).min(count);
        let at = |t: f32| path[index(t)];
        let (mut measured, mut explanation) = (Vec::new(), Explanation::default());
        let mut last = 0.5_f32;
        for k in 0..45 {
            let t = 0.5 + 0.5 * k as f32;
            let noise = 0.01 * math::sin(7.7 * k as f32);
            let shown = at(t - age);
            let wheels = by_wheels[index(last)].inverse() * by_wheels[index(t)];
            let changed = [0, 1].map(|axis| velocity(t)[axis] - velocity(last)[axis]);
            measured.push(MeasuredKeyframe {
                velocity: Some(velocity(t)),
                ..MeasuredKeyframe::default()
            });
            explanation.keyframes.push(KeyframeFit {
                pose: Some(Pose::new(shown.x + noise, shown.y - noise, shown.theta)),
                cost: 0.0,
                points: 100,
                on_markings: 1.0,
                residual: 0.02,
                wheel_step: (k > 0).then(|| {
                    Tf::new(
                        wheels.x + slip * changed[0],
                        wheels.y + slip * changed[1],
                        wheels.theta,
                    )
                }),
                by_matrix: None,
                wheels_agree: Some(true),
                compass_agrees: None,
            });
            last = t;
        }
        (measured, explanation)
    }

    fn found(age: f32, slip: f32, turns: f32, configured: f32) -> Option<OtherLatency> {
        let identity = Matrix3::identity();
        let (measured, explanation) = drive(age - configured, slip, turns, &identity);
        other_latency(&measured, &explanation, &identity, configured)
    }

    #[test]
    fn age_is_found_beside_wheels_of_unequal_radius_which_are_none() {
        let mut wheels = Matrix3::identity();
        for (entry, value) in [
            ((0, 2), 0.012),
            ((1, 2), -0.01),
            ((2, 0), 0.15),
            ((0, 1), 0.04),
        ] {
            wheels[entry] = value;
        }
        for age in [0.0_f32, 0.04, 0.08] {
            let (measured, explanation) = drive(age, 0.0, 1.0, &wheels);
            let found = other_latency(&measured, &explanation, &Matrix3::identity(), 0.0);
            match found {
                Some(found) => assert!((found.age - age).abs() < 0.012, "{age}: {found:?}"),
                None => assert_eq!(age, 0.0),
            }
        }
    }

    #[test]
    fn age_of_images_is_found_and_a_right_one_is_not_doubted() {
        for age in [0.05_f32, 0.08, 0.15] {
            let latency = found(age, 0.0, 1.0, 0.0).expect("a latency");
            assert!((latency.age - age).abs() < 0.01, "{age}: {latency:?}");
            assert!(found(age, 0.0, 1.0, age).is_none(), "{age} is configured");
        }
        assert!(found(0.0, 0.0, 1.0, 0.0).is_none());
        let wrong = found(0.0, 0.0, 1.0, 0.1).expect("no latency");
        assert!(wrong.age.abs() < 0.01, "{wrong:?}");
    }

    #[test]
    fn stamps_of_the_wheels_that_are_late_are_images_from_the_future() {
        for late in [0.05_f32, 0.1, 0.2] {
            let latency = found(-late, 0.0, 1.0, 0.0).expect("a latency");
            assert!(
                (latency.age + late).abs() < 0.2 * late,
                "{late}: {latency:?}"
            );
        }
        assert!(found(-0.02, 0.0, 1.0, 0.0).is_none());
    }

    #[test]
    fn slip_and_drives_without_turns_are_not_taken_for_an_age() {
        assert!(found(0.0, 0.06, 1.0, 0.0).is_none());
        assert!(found(0.08, 0.0, 0.0, 0.0).is_none());
    }
}
