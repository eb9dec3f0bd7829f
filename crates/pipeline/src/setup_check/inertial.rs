//! Does the inertial unit agree with the other sensors? Its force with gravity, its turns with the poses of the images, its
//! changes of velocity with the wheels.

use std::f32::consts::PI;

use localize::math;
use localize::setup_check::Explanation;

use super::MeasuredKeyframe;
use super::dead_sensors::angle_apart;
use super::inertial_motion::InertialMotion;

/// Readings of fewer seconds are not judged: a robot's own accelerations lean the mean force by up to eight degrees then.
const SECONDS_MIN: f32 = 3.0;
/// Mean specific force of a robot that drives on the ground, m/s²: gravity, with a wrong scale at most.
const FORCE: std::ops::Range<f32> = 7.0..13.0;
/// Largest angle of the mean specific force off up, degrees. Bias and lean of a real robot are below ten.
const LEAN_MAX_DEG: f32 = 20.0;
/// Longest time and least turn between two keyframes whose turns are compared, seconds and radians.
const PAIR_SECONDS_MAX: f32 = 5.0;
const PAIR_TURN_MIN: f32 = 0.15;
/// Turns agree within this angle (radians), this share of the turn, and this bias (radians per second).
const TURN_TOLERANCE: (f32, f32, f32) = (0.08, 0.05, 0.03);
/// Fewest pairs, and the share of them that agrees at least. Wrong poses spoil a few.
const PAIRS_MIN: usize = 6;
const AGREEMENT_MIN: f32 = 0.5;
/// Largest bias that is sought, and the steps, radians per second.
const BIAS_MAX: f32 = 1.6;
const BIAS_STEP: f32 = 0.01;
/// Share of the turns that a bias explains at least, and how far their rates are apart at least, radians per second.
const BIAS_AGREEMENT_MIN: f32 = 0.85;
const BIAS_RATES_APART_MIN: f32 = 0.3;
/// Largest angle between the changes of velocity of unit and wheels, degrees.
const YAW_MAX_DEG: f32 = 30.0;

fn motion_of_all(measured: &[MeasuredKeyframe]) -> InertialMotion {
    let mut all = InertialMotion::default();
    let motions = measured.iter().filter_map(|keyframe| keyframe.inertial);
    motions.for_each(|motion| all += motion);
    all
}

/// Do the wheels change their velocity in other directions than the inertial unit? False where they do not tell.
pub(super) fn wheels_are_turned(measured: &[MeasuredKeyframe]) -> bool {
    let angle = motion_of_all(measured).changes.angle_deg();
    angle.is_some_and(|angle| angle.abs() > YAW_MAX_DEG)
}

/// What is wrong with the inertial unit, if anything is. `explanation`: of the keyframes, without the unit. `wheels_agree`: the wheels,
/// as they were measured, agree with it.
pub(super) fn find_fault(
    measured: &[MeasuredKeyframe],
    explanation: &Explanation,
    wheels_agree: bool,
) -> Option<String> {
    let all = motion_of_all(measured);
    if all.seconds < SECONDS_MIN {
        return None;
    }
    let [x, y, z] = all.force.map(|sum| sum / all.seconds);
    let force = math::hypot(math::hypot(x, y), z);
    if !FORCE.contains(&force) {
        return Some(format!(
            "its mean specific force is {force:.1} m/s² (expected 9.8 upward): a wrong unit, or it is dead"
        ));
    }
    let lean = math::atan2(math::hypot(x, y), z).to_degrees();
    if lean > LEAN_MAX_DEG {
        return Some(format!(
            "its mean specific force is {lean:.0} degrees off up: mounted otherwise than [imu.calibration] mount_deg says \
             (`mirrorball calibrate imu` measures it)"
        ));
    }
    let turns = turns_between_keyframes(measured, explanation);
    if let Some(share) = agreement_of_turns(&turns, 0.0)
        && share < AGREEMENT_MIN
    {
        if let Some(bias) = constant_bias(&turns) {
            return Some(format!(
                "its rate about the vertical has a constant bias of about {:.0} degrees per second (`mirrorball calibrate imu` measures it)",
                bias.to_degrees()
            ));
        }
        return Some(format!(
            "it agrees with {:.0} % of the turns that the images show: a wrong sign, axis, unit or bias of its rates, or a wrong `flipped` of the camera",
            100.0 * share
        ));
    }
    if wheels_agree && all.changes.is_unit_dead() {
        return Some(
            "its accelerations do not change where the velocities of the wheels do: no accelerometer, or a dead one"
                .to_owned(),
        );
    }
    let angle = all.changes.angle_deg().filter(|_| wheels_agree)?;
    (angle.abs() > YAW_MAX_DEG).then(|| {
        format!(
            "its accelerations are turned by {angle:.0} degrees against the wheels: mounted otherwise than \
             [imu.calibration] mount_deg says (`mirrorball calibrate imu` measures it)"
        )
    })
}

/// A turn from one keyframe to the next, radians: by the unit, and by the poses, of which half turns are unknown.
struct Turn {
    seconds: f32,
    measured: f32,
    shown: f32,
}

fn turns_between_keyframes(measured: &[MeasuredKeyframe], explanation: &Explanation) -> Vec<Turn> {
    let poses: Vec<_> = explanation.keyframes.iter().map(|fit| fit.pose).collect();
    let pairs = measured.iter().skip(1).zip(poses.array_windows());
    let turns = pairs.filter_map(|(keyframe, &[before, after])| {
        let motion = keyframe.inertial?;
        let shown = after?.theta - before?.theta;
        (motion.seconds < PAIR_SECONDS_MAX).then_some(Turn {
            seconds: motion.seconds,
            measured: motion.turn,
            shown,
        })
    });
    turns.collect()
}

/// Share of the turns by which the unit, less a bias in radians per second, agrees with the poses, half turns aside. None for too few.
fn agreement_of_turns(turns: &[Turn], bias: f32) -> Option<f32> {
    let agree = turns.iter().filter_map(|turn| {
        let measured = turn.measured - bias * turn.seconds;
        let off = angle_apart(measured, turn.shown);
        let turned = measured.abs().max(angle_apart(turn.shown, 0.0));
        let (angle, share, rate) = TURN_TOLERANCE;
        (turned > PAIR_TURN_MIN)
            .then(|| off < angle + share * measured.abs().min(PI) + rate * turn.seconds)
    });
    let agree: Vec<bool> = agree.collect();
    let count = agree.iter().filter(|agree| **agree).count();
    (agree.len() >= PAIRS_MIN).then(|| count as f32 / agree.len() as f32)
}

/// The bias with which the unit agrees with turns of different rates, radians per second. None if no constant explains them.
fn constant_bias(turns: &[Turn]) -> Option<f32> {
    let rates = turns
        .iter()
        .map(|turn| angle_apart(turn.shown, 0.0) / turn.seconds);
    let (least, most) = rates.fold((f32::INFINITY, 0.0_f32), |(least, most), rate| {
        (least.min(rate), most.max(rate))
    });
    // Of a robot that always turns alike, a dead unit looks like a biased one.
    if most - least < BIAS_RATES_APART_MIN {
        return None;
    }
    let steps = (BIAS_MAX / BIAS_STEP) as i32;
    let biases = (-steps..=steps).map(|step| step as f32 * BIAS_STEP);
    let agreements: Vec<(f32, f32)> = biases
        .filter_map(|bias| Some((bias, agreement_of_turns(turns, bias)?)))
        .collect();
    let most = agreements
        .iter()
        .map(|(_, share)| *share)
        .fold(0.0, f32::max);
    // Neighbouring biases agree as well: the middle one is meant.
    let best: Vec<f32> = agreements
        .iter()
        .filter(|(_, share)| *share >= most)
        .map(|(bias, _)| *bias)
        .collect();
    (most >= BIAS_AGREEMENT_MIN).then(|| best[best.len() / 2])
}

#[cfg(test)]
mod tests {
    use localize::sample::{Imu, Odometry};
    use localize::setup_check::KeyframeFit;
    use localize::{Pose, Stamp};

    use super::super::inertial_motion::InertialCollector;
    use super::*;

    /// A drive of 30 s that turns and accelerates; `unit` changes the readings.
    fn drive(
        unit: impl Fn([f32; 3], f32) -> ([f32; 3], f32),
    ) -> (Vec<MeasuredKeyframe>, Explanation) {
        let mut collector = InertialCollector::default();
        let (mut measured, mut explanation) = (
            Vec::new(),
            Explanation {
                keyframes: Vec::new(),
            },
        );
        let velocity = |time: f32| 0.8 * math::sin(1.3 * time);
        let heading = |time: f32| 1.5 * math::sin(0.5 * time);
        for step in 1..3000 {
            let (time, before) = (0.01 * step as f32, 0.01 * (step - 1) as f32);
            let stamp = Stamp::from_seconds(f64::from(time));
            let rate = (heading(time) - heading(before)) / 0.01;
            let force = [
                (velocity(time) - velocity(before)) / 0.01,
                velocity(time) * rate,
                9.81,
            ];
            let (specific_force, rate) = unit(force, rate);
            collector.add_imu(&Imu {
                stamp,
                specific_force,
                angular_velocity: [0.0, 0.0, rate],
            });
            collector.add_odometry(&Odometry {
                stamp,
                dx: 0.01 * velocity(time),
                dy: 0.0,
                dtheta: heading(time) - heading(before),
                slip: 0.0,
            });
            if step % 100 == 0 {
                measured.push(MeasuredKeyframe {
                    inertial: collector.take_motion(),
                    ..MeasuredKeyframe::default()
                });
                // Every second pose is half a turn off: the field is symmetric.
                let half = PI * (step / 100 % 2) as f32;
                explanation.keyframes.push(KeyframeFit {
                    pose: Some(Pose::new(0.0, 0.0, heading(time) + half)),
                    cost: 0.0,
                    points: 100,
                    on_markings: 1.0,
                    residual: 0.02,
                    wheel_step: None,
                    by_matrix: None,
                    wheels_agree: Some(true),
                    compass_agrees: None,
                });
            }
        }
        (measured, explanation)
    }

    fn fault(unit: impl Fn([f32; 3], f32) -> ([f32; 3], f32)) -> Option<String> {
        let (measured, explanation) = drive(unit);
        find_fault(&measured, &explanation, true)
    }

    #[test]
    fn a_right_unit_with_bias_and_lean_has_no_fault() {
        let biased = |[x, y, z]: [f32; 3], rate: f32| ([x + 0.6, y - 0.4, z + 0.2], rate + 0.02);
        assert_eq!(fault(biased), None);
    }

    #[test]
    fn wheels_that_are_turned_against_a_right_unit_are_told_from_wheels_that_are_not() {
        let turned = |[x, y, z]: [f32; 3], rate: f32| ([-x, -y, z], rate);
        assert!(wheels_are_turned(&drive(turned).0));
        let (measured, _) = drive(|force, rate| (force, rate));
        assert!(!wheels_are_turned(&measured));
        assert!(!wheels_are_turned(&[]), "nothing is known");
    }

    #[test]
    fn constant_bias_of_the_rates_is_told_from_a_wrong_sign() {
        let biased = |force: [f32; 3], rate: f32| (force, rate + 20.0_f32.to_radians());
        let text = fault(biased).expect("a fault");
        assert!(
            text.contains("bias of about 20 degrees") || text.contains("bias of about 19"),
            "{text}"
        );
        let text = fault(|force, rate| (force, -rate)).expect("a fault");
        assert!(text.contains("a wrong sign"), "{text}");
    }

    #[test]
    fn wrong_mounts_units_and_dead_units_are_named() {
        let upside_down = |[x, y, z]: [f32; 3], rate: f32| ([x, -y, -z], -rate);
        assert!(fault(upside_down).is_some_and(|text| text.contains("180 degrees off up")));
        let dead = |_: [f32; 3], _: f32| ([0.0; 3], 0.0);
        assert!(fault(dead).is_some_and(|text| text.contains("0.0 m/s²")));
        for rates in [-1.0, 0.0, 57.3] {
            let wrong = |force: [f32; 3], rate: f32| (force, rates * rate);
            assert!(
                fault(wrong).is_some_and(|text| text.contains("turns")),
                "{rates}"
            );
        }
        let turned = |[x, y, z]: [f32; 3], rate: f32| ([y, -x, z], rate);
        assert!(fault(turned).is_some_and(|text| text.contains("turned by 90 degrees")));
    }
}
