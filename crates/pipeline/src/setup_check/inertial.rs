//! Does the inertial unit agree with the other sensors? Its force with gravity, its turns with the poses of the images, its
//! changes of velocity with the wheels.

use std::f32::consts::PI;
use std::ops::AddAssign;

use localize::Stamp;
use localize::math;
use localize::sample::{Imu, Odometry};
use localize::setup_check::Explanation;

use super::MeasuredKeyframe;
use super::dead_sensors::angle_apart;

/// Longest time between readings that belong together, seconds.
const GAP_MAX: f32 = 0.2;
/// Time over which wheels and accelerations are averaged, seconds: wheels are too coarse for less.
const WINDOW: f32 = 0.2;

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
/// Fewest changes of velocity, and their least root mean square, m/s.
const CHANGES_MIN: f32 = 25.0;
const CHANGE_MIN: f32 = 0.05;
/// Correlation of the changes of velocity, above which their directions are compared, and the largest angle, degrees.
const COHERENCE_MIN: f32 = 0.5;
const YAW_MAX_DEG: f32 = 30.0;

/// Sums of what an inertial unit measured between two keyframes, robot frame by its calibration.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct InertialMotion {
    /// Time with readings, seconds.
    seconds: f32,
    /// Turn about the vertical, radians.
    turn: f32,
    /// Specific force times time, m/s.
    force: [f32; 3],
    changes: VelocityChanges,
}

/// Sums over changes of velocity of the unit (u) and of the wheels (w), complex numbers of x and y: ū·w, |u|², |w|², count.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct VelocityChanges {
    product: [f32; 2],
    inertial: f32,
    wheels: f32,
    count: f32,
}

impl AddAssign for InertialMotion {
    fn add_assign(&mut self, other: Self) {
        self.seconds += other.seconds;
        self.turn += other.turn;
        for (sum, force) in self.force.iter_mut().zip(other.force) {
            *sum += force;
        }
        let (changes, more) = (&mut self.changes, other.changes);
        changes.product[0] += more.product[0];
        changes.product[1] += more.product[1];
        changes.inertial += more.inertial;
        changes.wheels += more.wheels;
        changes.count += more.count;
    }
}

/// Sums the readings of a run. Its memory does not grow.
#[derive(Debug, Clone, Default)]
pub(super) struct InertialCollector {
    motion: InertialMotion,
    last_imu: Option<Stamp>,
    last_odometry: Option<Stamp>,
    window: Window,
    /// Means of the window before.
    before: Option<WindowMeans>,
}

/// Sums over a window.
#[derive(Debug, Clone, Copy, Default)]
struct Window {
    /// By the wheels: metres, metres, radians, seconds.
    moved: [f32; 4],
    /// By the unit: m/s², and the count.
    force: [f32; 3],
}

#[derive(Debug, Clone, Copy)]
struct WindowMeans {
    velocity: [f32; 2],
    force: [f32; 2],
    turn: f32,
    seconds: f32,
}

impl InertialCollector {
    pub(super) fn add_imu(&mut self, imu: &Imu) {
        let seconds = self.last_imu.map(|last| (imu.stamp - last) as f32);
        self.last_imu = Some(imu.stamp);
        let [fx, fy, _] = imu.specific_force;
        self.window.force[0] += fx;
        self.window.force[1] += fy;
        self.window.force[2] += 1.0;
        if let Some(seconds) = seconds.filter(|seconds| (0.0..GAP_MAX).contains(seconds)) {
            self.motion.seconds += seconds;
            self.motion.turn += seconds * imu.angular_velocity[2];
            for (sum, force) in self.motion.force.iter_mut().zip(imu.specific_force) {
                *sum += seconds * force;
            }
        }
    }

    pub(super) fn add_odometry(&mut self, odometry: &Odometry) {
        let seconds = self
            .last_odometry
            .map(|last| (odometry.stamp - last) as f32);
        self.last_odometry = Some(odometry.stamp);
        let Some(seconds) = seconds.filter(|seconds| (0.0..GAP_MAX).contains(seconds)) else {
            (self.window, self.before) = (Window::default(), None);
            return;
        };
        let row = [odometry.dx, odometry.dy, odometry.dtheta, seconds];
        for (sum, value) in self.window.moved.iter_mut().zip(row) {
            *sum += value;
        }
        if self.window.moved[3] >= WINDOW {
            let means = std::mem::take(&mut self.window).means();
            if let (Some(before), Some(means)) = (self.before, means) {
                self.motion.changes.add(&before, &means);
            }
            self.before = means;
        }
    }

    /// What was measured since the last call. None without readings.
    pub(super) fn take_motion(&mut self) -> Option<InertialMotion> {
        let motion = std::mem::take(&mut self.motion);
        (motion.seconds > 0.0).then_some(motion)
    }
}

impl Window {
    /// None without readings of the unit.
    fn means(&self) -> Option<WindowMeans> {
        let [dx, dy, turn, seconds] = self.moved;
        let [fx, fy, count] = self.force;
        (count > 0.0).then(|| WindowMeans {
            velocity: [dx / seconds, dy / seconds],
            force: [fx / count, fy / count],
            turn,
            seconds,
        })
    }
}

impl VelocityChanges {
    /// Adds the change between the middles of two windows, in the frame of the first.
    fn add(&mut self, before: &WindowMeans, after: &WindowMeans) {
        let (sin, cos) = math::sin_cos(0.5 * (before.turn + after.turn));
        let turned = |[x, y]: [f32; 2]| [cos * x - sin * y, sin * x + cos * y];
        let (velocity, force) = (turned(after.velocity), turned(after.force));
        let seconds = 0.5 * (before.seconds + after.seconds);
        let [wx, wy] = [0, 1].map(|i| velocity[i] - before.velocity[i]);
        let [ux, uy] = [0, 1].map(|i| 0.5 * seconds * (before.force[i] + force[i]));
        self.product[0] += ux * wx + uy * wy;
        self.product[1] += ux * wy - uy * wx;
        self.inertial += ux * ux + uy * uy;
        self.wheels += wx * wx + wy * wy;
        self.count += 1.0;
    }

    /// Angle from the unit's changes to those of the wheels, degrees. None if they are few, small or not related.
    fn angle_deg(&self) -> Option<f32> {
        let product = math::hypot(self.product[0], self.product[1]);
        let coherence = product / (self.inertial * self.wheels).sqrt();
        let moves = self.wheels > self.count * CHANGE_MIN * CHANGE_MIN;
        (self.count >= CHANGES_MIN && moves && coherence > COHERENCE_MIN)
            .then(|| math::atan2(self.product[1], self.product[0]).to_degrees())
    }
}

/// What is wrong with the inertial unit, if anything is. `explanation`: of the keyframes, without the unit.
pub(super) fn find_fault(
    measured: &[MeasuredKeyframe],
    explanation: &Explanation,
    wheels_agree: bool,
) -> Option<String> {
    let mut all = InertialMotion::default();
    let motions = measured.iter().filter_map(|keyframe| keyframe.inertial);
    motions.for_each(|motion| all += motion);
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
    if let Some(share) = agreement_of_turns(measured, explanation)
        && share < AGREEMENT_MIN
    {
        return Some(format!(
            "it agrees with {:.0} % of the turns that the images show: a wrong sign, axis or unit of its rates",
            100.0 * share
        ));
    }
    let angle = all.changes.angle_deg().filter(|_| wheels_agree)?;
    (angle.abs() > YAW_MAX_DEG).then(|| {
        format!(
            "its accelerations are turned by {angle:.0} degrees against the wheels: mounted otherwise than \
             [imu.calibration] mount_deg says (`mirrorball calibrate imu` measures it)"
        )
    })
}

/// Share of the turns between keyframes by which the unit agrees with the poses, half turns aside. None for too few.
fn agreement_of_turns(measured: &[MeasuredKeyframe], explanation: &Explanation) -> Option<f32> {
    let poses: Vec<_> = explanation.keyframes.iter().map(|fit| fit.pose).collect();
    let pairs = measured.iter().skip(1).zip(poses.array_windows());
    let agree: Vec<bool> = pairs
        .filter_map(|(keyframe, &[before, after])| {
            let motion = keyframe.inertial?;
            let shown = after?.theta - before?.theta;
            let off = angle_apart(motion.turn, shown);
            let turned = motion.turn.abs().max(angle_apart(shown, 0.0));
            let (angle, share, bias) = TURN_TOLERANCE;
            (motion.seconds < PAIR_SECONDS_MAX && turned > PAIR_TURN_MIN)
                .then(|| off < angle + share * motion.turn.abs().min(PI) + bias * motion.seconds)
        })
        .collect();
    let count = agree.iter().filter(|agree| **agree).count();
    (agree.len() >= PAIRS_MIN).then(|| count as f32 / agree.len() as f32)
}

#[cfg(test)]
mod tests {
    use localize::Pose;
    use localize::setup_check::KeyframeFit;

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
