//! Are the stamps of an inertial unit or a compass late? Its turns then differ from those of the wheels while the robot's rate changes.

use localize::frames::wrap_angle;
use localize::wheel_steps::{spread, weight};
use nalgebra::{Matrix3, Vector3};

use super::measurements::MeasuredKeyframe;

/// Fewest turns that tell a lateness.
const TURNS_MIN: usize = 12;
/// Standard deviations before anything is known: lateness (seconds), scale of the sensor's turns, bias (radians per second).
const PRIOR: [f32; 3] = [0.3, 0.1, 0.1];
/// Passes of the reweighted fit.
const PASSES: usize = 8;
/// Turns are not more accurate than this, radians.
const STD_MIN: f32 = 0.005;
/// A smaller lateness is no mistake, seconds, and a less certain one.
const LATE_MIN: f32 = 0.06;
const LATE_SIGMAS: f32 = 6.0;
/// Share of the turns' spread that the lateness leaves at most.
const LEFT_MAX: f32 = 0.7;

/// A turn from one keyframe to the next, radians.
#[derive(Debug, Clone, Copy)]
struct Turn {
    /// By the sensor, less that by the wheels.
    excess: f32,
    /// By the wheels.
    wheels: f32,
    seconds: f32,
    /// By how much the rate of the wheels grows from the first keyframe to the second, radians per second.
    rate_change: f32,
}

/// Lateness of the unit's stamps beside those of the wheels, seconds, negative for early ones. None for a small or uncertain one.
/// `wheels`: the matrix of their motion.
pub(super) fn of_inertial_unit(
    measured: &[MeasuredKeyframe],
    wheels: &Matrix3<f32>,
) -> Option<f32> {
    lateness(measured, wheels, |_, after| {
        after.inertial.map(|motion| motion.turn)
    })
}

/// As [`of_inertial_unit`], for the readings of the compass.
pub(super) fn of_compass(measured: &[MeasuredKeyframe], wheels: &Matrix3<f32>) -> Option<f32> {
    lateness(measured, wheels, |before, after| {
        Some(after.compass? - before.compass?)
    })
}

fn lateness(
    measured: &[MeasuredKeyframe],
    wheels: &Matrix3<f32>,
    turned: impl Fn(&MeasuredKeyframe, &MeasuredKeyframe) -> Option<f32>,
) -> Option<f32> {
    let rate = |keyframe: &MeasuredKeyframe| {
        let velocity = keyframe.velocity?;
        Some((wheels * Vector3::from(velocity)).z)
    };
    let turns = measured.array_windows().filter_map(|[before, after]| {
        let rows = after.odometry.as_ref()?.iter();
        let by_wheels: f32 = rows.map(|row| (wheels * Vector3::from(*row)).z).sum();
        Some(Turn {
            excess: wrap_angle(turned(before, after)? - by_wheels),
            wheels: by_wheels,
            seconds: (after.stamp - before.stamp) as f32,
            rate_change: rate(after)? - rate(before)?,
        })
    });
    fit(&turns.collect::<Vec<_>>())
}

/// A sensor that is τ late shows the turn from t₀ − τ to t₁ − τ, which exceeds that from t₀ to t₁ by τ (ω₀ − ω₁).
fn fit(turns: &[Turn]) -> Option<f32> {
    if turns.len() < TURNS_MIN {
        return None;
    }
    let row = |turn: &Turn| Vector3::new(-turn.rate_change, turn.wheels, turn.seconds);
    let prior = Matrix3::from_diagonal(&Vector3::from(PRIOR.map(|std| 1.0 / (std * std))));
    // First without the lateness, which then has to explain what is left.
    let on_time = reweighted(
        turns,
        |turn| row(turn).component_mul(&Vector3::new(0.0, 1.0, 1.0)),
        &prior,
    )?;
    let late = reweighted(turns, row, &prior)?;
    let seconds = late.fitted[0];
    let is_certain = seconds.abs() > LATE_MIN.max(LATE_SIGMAS * late.covariance[(0, 0)].sqrt());
    (is_certain && late.std < LEFT_MAX * on_time.std).then_some(seconds)
}

struct Fit {
    fitted: Vector3<f32>,
    covariance: Matrix3<f32>,
    /// Standard deviation of what is left, radians.
    std: f32,
}

fn reweighted(
    turns: &[Turn],
    row: impl Fn(&Turn) -> Vector3<f32>,
    prior: &Matrix3<f32>,
) -> Option<Fit> {
    let mut fit = Fit {
        fitted: Vector3::zeros(),
        covariance: Matrix3::zeros(),
        std: 0.0,
    };
    for _ in 0..PASSES {
        let left = |turn: &Turn| turn.excess - row(turn).dot(&fit.fitted);
        let deviations: Vec<f32> = turns.iter().map(|turn| left(turn).abs()).collect();
        let std = spread(&deviations).max(STD_MIN);
        let (mut information, mut vector) = (*prior, Vector3::zeros());
        for (turn, deviation) in turns.iter().zip(&deviations) {
            let weight = weight(deviation / std) / (std * std);
            let row = row(turn);
            information += row * row.transpose() * weight;
            vector += row * (turn.excess * weight);
        }
        let covariance = information.try_inverse()?;
        fit = Fit {
            fitted: covariance * vector,
            covariance,
            std,
        };
    }
    Some(fit)
}

#[cfg(test)]
mod tests {
    use localize::Stamp;
    use localize::math;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    /// Thirty keyframes of a robot whose rate changes; the compass is `late` by seconds, has noise, a scale and iron near it.
    fn drive(late: f32, noise: f32, iron: f32) -> Vec<MeasuredKeyframe> {
        let mut random = ChaCha8Rng::seed_from_u64(5);
        let heading = |t: f32| 1.1 * math::sin(1.3 * t) + 0.5 * math::sin(2.9 * t + 1.0);
        let rate = |t: f32| 1.43 * math::cos(1.3 * t) + 1.45 * math::cos(2.9 * t + 1.0);
        let keyframes = (0..30).map(|k| {
            let (t, before) = (0.6 * k as f32, 0.6 * (k - 1) as f32);
            let shown = heading(t - late);
            MeasuredKeyframe {
                stamp: Stamp::from_seconds(t.into()),
                compass: Some(wrap_angle(
                    shown + iron * math::sin(shown) + random.random_range(-noise..noise),
                )),
                odometry: Some(vec![[0.1, 0.0, heading(t) - heading(before)]]),
                velocity: Some([0.2, 0.0, rate(t)]),
                ..MeasuredKeyframe::default()
            }
        });
        keyframes.collect()
    }

    #[test]
    fn late_and_early_headings_are_found_beside_noise_and_iron() {
        for late in [-0.2_f32, -0.1, 0.1, 0.2, 0.3] {
            for (noise, iron) in [(0.01, 0.0), (0.05, 0.08), (0.02, 0.15)] {
                let found = of_compass(&drive(late, noise, iron), &Matrix3::identity());
                assert!(
                    found.is_some_and(|found| (found - late).abs() < 0.35 * late.abs()),
                    "{late} s, noise {noise}, iron {iron}: {found:?}"
                );
            }
        }
    }

    #[test]
    fn headings_in_time_are_not_late_whatever_their_noise_scale_or_sign() {
        for (noise, iron) in [
            (0.001, 0.0),
            (0.05, 0.1),
            (0.4, 0.0),
            (0.05, 0.5),
            (2.0, 0.0),
        ] {
            let on_time = drive(0.0, noise, iron);
            for wheels in [1.0_f32, 0.9, -1.0, 57.3] {
                let mut matrix = Matrix3::identity();
                matrix[(2, 2)] = wheels;
                let found = of_compass(&on_time, &matrix);
                assert_eq!(found, None, "noise {noise}, iron {iron}, wheels {wheels}");
            }
        }
    }
}
