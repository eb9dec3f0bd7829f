//! Are the images much older than their stamps say? Then the wheels explain the steps between poses by another time.
//!
//! Ages of some hundredths of a second are measured by `latency`, which needs velocities alone.

use localize::Stamp;
use localize::frames::{RobotFrame, Tf, wrap_angle};
use localize::global_search::branch_and_bound::half_turn;
use localize::setup_check::{Explanation, METRES_PER_RADIAN};
use nalgebra::{Matrix3, Vector3};

use super::measurements::MeasuredKeyframe;
use crate::recording::{RecordedData, Recording};

/// Ages that are tried beyond the configured one, in steps; seconds.
const AGE_RANGE: (f64, f64) = (-5.0, 5.0);
const AGE_STEP: f64 = 0.02;
/// Smaller ones are left to `latency`, seconds.
const AGE_MIN: f64 = 0.15;
/// Fewer steps tell no age.
const STEPS_MIN: usize = 12;
/// Shorter steps are noise, metres.
const STEP_MIN: f32 = 0.1;
/// The wheels explain the steps at an age that is named: at most this share of their motion remains, and this share of what
/// remained before, which is more than noise.
const REST_MAX: f32 = 0.1;
const REST_SHARE_MAX: f32 = 0.25;
const REST_MIN: f32 = 0.01;
/// Of ages that explain the steps alike, as on a path that repeats itself, the smallest one counts.
const ALIKE: f32 = 1.5;
/// A clock that leapt shows in this many steps before and after.
const STEPS_BESIDE_LEAP: usize = 5;

/// By how much the images are older than their stamps and the configured latency say.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ImageAge {
    /// Seconds. Negative if the stamps of the wheels are late.
    pub(super) seconds: f64,
    /// A clock leapt before this keyframe. None: in all images.
    pub(super) from: Option<usize>,
}

/// The age of the images by which the wheels explain the steps between poses that they otherwise contradict. None if there is no
/// such age. `wheels`: matrix of their motion.
pub(super) fn find(
    recording: &Recording,
    measured: &[MeasuredKeyframe],
    explanation: &Explanation,
    wheels: &Matrix3<f32>,
    latency: f64,
) -> Option<ImageAge> {
    let path = WheelPath::of(recording, wheels);
    let pairs = measured.windows(2).zip(explanation.keyframes.windows(2));
    let steps: Vec<PoseStep> = pairs
        .enumerate()
        .filter_map(|(start, (measured, fits))| {
            let (before, after) = (fits[0].pose?, fits[1].pose?);
            Some(PoseStep {
                start,
                from: measured[0].stamp + -latency,
                to: measured[1].stamp + -latency,
                motions: [after, half_turn(after)].map(|after| before.inverse() * after),
            })
        })
        .collect();
    find_age(&path, &steps)
}

/// Motion of the robot between two exposures.
struct PoseStep {
    /// Number of the keyframe at its start.
    start: usize,
    from: Stamp,
    to: Stamp,
    /// By its poses, and by the half turn of one: a compass or wheels of another time choose wrong halves.
    motions: [Tf<RobotFrame, RobotFrame>; 2],
}

fn find_age(path: &WheelPath, steps: &[PoseStep]) -> Option<ImageAge> {
    let count = ((AGE_RANGE.1 - AGE_RANGE.0) / AGE_STEP).round() as u32;
    let ages = (0..=count).map(|k| AGE_RANGE.0 + AGE_STEP * f64::from(k));
    let by_age: Vec<(f64, Shares)> = ages
        .map(|age| (age, path.unexplained(steps, age)))
        .collect();
    let configured = path.unexplained(steps, 0.0);
    if let Some((seconds, _)) = age_from(0, &configured, &by_age) {
        return Some(ImageAge {
            seconds,
            from: None,
        });
    }
    let leaps = STEPS_BESIDE_LEAP..steps.len().saturating_sub(STEPS_BESIDE_LEAP);
    let found = leaps.filter_map(|first| Some((first, age_from(first, &configured, &by_age)?)));
    let (first, (seconds, _)) = found.min_by(|a, b| a.1.1.total_cmp(&b.1.1))?;
    Some(ImageAge {
        seconds,
        from: Some(steps[first].start),
    })
}

/// The age of the images from the step `first` on, and the share of all motion that the wheels then do not explain. Only steps that
/// the wheels cover at both ages count: an age that carries the others past the ends of the odometry would seem to explain them.
fn age_from(first: usize, configured: &Shares, by_age: &[(f64, Shares)]) -> Option<(f64, f32)> {
    let (before, after) = configured.split_at(first);
    let before: Vec<f32> = before.iter().flatten().copied().collect();
    let steps_min = if first == 0 {
        STEPS_MIN
    } else {
        STEPS_BESIDE_LEAP
    };
    if first > 0 && (before.len() < STEPS_BESIDE_LEAP || mean(&before) > REST_MAX) {
        return None;
    }
    // Age, what remains of the steps from `first` on, and whether the age explains them.
    let rests: Vec<(f64, f32, bool)> = by_age
        .iter()
        .filter_map(|(age, later)| {
            let pairs = after.iter().zip(&later[first..]);
            let (as_configured, at_age): (Vec<f32>, Vec<f32>) =
                pairs.filter_map(|(a, b)| (*a).zip(*b)).unzip();
            if at_age.len() < steps_min || before.len() + at_age.len() < STEPS_MIN {
                return None;
            }
            let (as_configured, rest) = (mean(&as_configured), mean(&at_age));
            let explains =
                as_configured >= REST_MIN && rest <= REST_MAX.min(REST_SHARE_MAX * as_configured);
            Some((*age, rest, explains))
        })
        .collect();
    let explaining = rests.iter().filter(|(.., explains)| *explains);
    let least = explaining
        .map(|(_, rest, _)| *rest)
        .min_by(f32::total_cmp)?;
    // The bottom of the nearest valley that is deep enough.
    let bottoms = rests.array_windows().filter_map(|[before, at, after]| {
        let is_bottom = at.1 <= before.1 && at.1 <= after.1;
        (at.2 && is_bottom && at.1 <= ALIKE * least).then_some((at.0, at.1))
    });
    let (age, rest) = bottoms
        .min_by(|a, b| a.0.abs().total_cmp(&b.0.abs()))
        .filter(|(age, _)| age.abs() >= AGE_MIN)?;
    let steps = after.iter().flatten().count() as f32;
    let total = before.iter().sum::<f32>() + rest * steps;
    Some((age, total / (before.len() as f32 + steps)))
}

/// Share of each step's motion that the wheels do not explain: 0 equal, 1 unrelated. None without wheels or motion.
type Shares = Vec<Option<f32>>;

fn mean(shares: &[f32]) -> f32 {
    shares.iter().sum::<f32>() / shares.len() as f32
}

/// Where the wheels led, from the first row of the odometry on.
struct WheelPath {
    poses: Vec<(Stamp, Tf<RobotFrame, RobotFrame>)>,
}

impl WheelPath {
    fn of(recording: &Recording, wheels: &Matrix3<f32>) -> Self {
        let mut poses = Vec::new();
        let mut pose = Tf::new(0.0, 0.0, 0.0);
        for sample in recording.remaining_samples() {
            if let RecordedData::Odometry(row) = &sample.data {
                let step = wheels * Vector3::new(row.dx, row.dy, row.dtheta);
                pose = pose * Tf::new(step.x, step.y, step.z);
                poses.push((sample.stamp, pose));
            }
        }
        WheelPath { poses }
    }

    /// Pose at a time between two rows. None before the first and after the last one.
    fn at(&self, stamp: Stamp) -> Option<Tf<RobotFrame, RobotFrame>> {
        let after = self.poses.partition_point(|(row, _)| *row < stamp);
        let (end, next) = *self.poses.get(after)?;
        let (start, last) = *self.poses.get(after.checked_sub(1)?)?;
        let share = ((stamp - start) / (end - start)) as f32;
        let step: Tf<RobotFrame, RobotFrame> = last.inverse() * next;
        let turn = wrap_angle(step.theta);
        Some(last * Tf::new(step.x * share, step.y * share, turn * share))
    }

    /// What the wheels do not explain of each step if the images are older.
    fn unexplained(&self, steps: &[PoseStep], age: f64) -> Shares {
        let squared = |x: f32, y: f32, turn: f32| {
            x * x + y * y + (METRES_PER_RADIAN * wrap_angle(turn)).powi(2)
        };
        let share = |step: &PoseStep| {
            let wheels = self.at(step.from + -age)?.inverse() * self.at(step.to + -age)?;
            let by_wheels = squared(wheels.x, wheels.y, wheels.theta);
            let errors = step.motions.map(|motion| {
                let moved = by_wheels + squared(motion.x, motion.y, motion.theta);
                let (x, y) = (wheels.x - motion.x, wheels.y - motion.y);
                (squared(x, y, wheels.theta - motion.theta), moved)
            });
            let (error, moved) = errors.into_iter().min_by(|a, b| a.0.total_cmp(&b.0))?;
            (moved > STEP_MIN * STEP_MIN).then(|| (error / moved).min(1.0))
        };
        steps.iter().map(share).collect()
    }
}

#[cfg(test)]
mod tests {
    use localize::math;

    use super::*;

    /// Forward and turning velocity of a drive in which nothing repeats, or which turns evenly.
    fn velocity(time: f64, is_even: bool) -> (f32, f32) {
        let time = time as f32;
        if is_even {
            return (1.0, 0.8);
        }
        (
            1.2 * math::sin(0.9 * time) + 0.5 * math::cos(2.3 * time),
            1.1 * math::sin(1.7 * time) + 0.6 * math::cos(0.61 * time),
        )
    }

    /// Wheels at 100 Hz that read `scale` of the motion, and steps of a second, of images that are `age` old from step `first` on.
    fn drive(age: f64, first: usize, scale: f32, is_even: bool) -> (WheelPath, Vec<PoseStep>) {
        let mut path = WheelPath { poses: Vec::new() };
        let mut truth = WheelPath { poses: Vec::new() };
        let (mut pose, mut by_wheels) = (Tf::new(0.0, 0.0, 0.0), Tf::new(0.0, 0.0, 0.0));
        for k in 0..4000 {
            let stamp = Stamp::from_seconds(0.01 * f64::from(k));
            truth.poses.push((stamp, pose));
            path.poses.push((stamp, by_wheels));
            let (forward, turn) = velocity(0.01 * f64::from(k), is_even);
            pose = pose * Tf::new(0.01 * forward, 0.0, 0.01 * turn);
            by_wheels = by_wheels * Tf::new(0.01 * scale * forward, 0.0, 0.01 * scale * turn);
        }
        let stamp = |k: usize| Stamp::from_seconds(4.0 + k as f64);
        let shown = |k: usize| {
            let age = if k < first { 0.0 } else { age };
            truth.at(stamp(k) + -age).expect("a pose")
        };
        let steps = (0..30).map(|k| PoseStep {
            start: k,
            from: stamp(k),
            to: stamp(k + 1),
            // One of the halves may be the right one.
            motions: {
                let right = shown(k).inverse() * shown(k + 1);
                let wrong = Tf::new(5.0, -3.0, 1.0);
                if k % 3 == 0 {
                    [wrong, right]
                } else {
                    [right, wrong]
                }
            },
        });
        let steps = steps.collect();
        (path, steps)
    }

    fn found(age: f64, scale: f32, is_even: bool) -> Option<f64> {
        let (path, steps) = drive(age, 0, scale, is_even);
        let found = find_age(&path, &steps)?;
        assert_eq!(found.from, None);
        Some(found.seconds)
    }

    #[test]
    fn ages_of_tenths_of_a_second_to_seconds_are_found() {
        for age in [-2.4, -0.3, 0.2, 0.5, 1.3, 2.7] {
            for scale in [1.0, 0.95] {
                let found = found(age, scale, false).expect("an age");
                assert!((found - age).abs() < 0.03, "{age}, {scale}: {found}");
            }
        }
    }

    #[test]
    fn right_stamps_wrong_wheels_and_even_drives_have_no_age() {
        assert_eq!(found(0.0, 1.0, false), None);
        assert_eq!(found(0.05, 1.0, false), None);
        assert_eq!(found(0.0, -1.0, false), None);
        assert_eq!(found(0.0, 0.01, false), None);
        assert_eq!(found(1.0, 1.0, true), None);
    }

    #[test]
    fn clock_that_leaps_is_found_with_its_keyframe() {
        for (age, first) in [(1.0, 15), (-0.5, 8), (2.5, 22)] {
            let (path, steps) = drive(age, first, 1.0, false);
            let found = find_age(&path, &steps).expect("a leap");
            assert!((found.seconds - age).abs() < 0.03, "{age}: {found:?}");
            assert!(
                found.from.expect("a keyframe").abs_diff(first) <= 1,
                "{first}: {found:?}"
            );
        }
        // Steps that nothing explains, so near to the end of the odometry that a later time leaves few of them.
        let (mut path, mut steps) = drive(0.0, 0, 1.0, false);
        path.poses.truncate(3450);
        for (k, step) in steps.iter_mut().enumerate().skip(22) {
            let k = k as f32;
            step.motions = [Tf::new(1.5 * math::sin(k), math::cos(3.0 * k), 0.5); 2];
        }
        assert_eq!(find_age(&path, &steps), None);
        // One step that nothing explains is a kidnap.
        let (path, mut steps) = drive(0.0, 0, 1.0, false);
        steps[12].motions = [Tf::new(3.0, -2.0, 1.0); 2];
        assert_eq!(find_age(&path, &steps), None);
    }
}
