//! What did an inertial unit measure between keyframes? Sums of time, turn, force, and of changes of velocity beside the wheels'.

use std::ops::AddAssign;

use localize::Stamp;
use localize::math;
use localize::robot::{ImuCalibration, OdometryCalibration};
use localize::sample::{Imu, Odometry};

use crate::setup::Setup;

/// Longest time between readings that belong together, seconds.
const GAP_MAX: f32 = 0.2;
/// Time over which wheels and accelerations are averaged, seconds: wheels are too coarse for less.
const WINDOW: f32 = 0.2;

/// Fewest changes of velocity, and their least root mean square, m/s.
const CHANGES_MIN: f32 = 25.0;
const CHANGE_MIN: f32 = 0.05;
/// Share of the wheels' squared changes of velocity that a unit without accelerometer measures at most.
const DEAD_SHARE: f32 = 0.01;
/// Correlation of the changes of velocity, above which their directions are compared.
const COHERENCE_MIN: f32 = 0.5;

/// Sums of what an inertial unit measured between two keyframes, robot frame by its calibration.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct InertialMotion {
    /// Time with readings, seconds.
    pub(super) seconds: f32,
    /// Turn about the vertical, radians.
    pub(super) turn: f32,
    /// Specific force times time, m/s.
    pub(super) force: [f32; 3],
    pub(super) changes: VelocityChanges,
}

/// Sums over changes of velocity of the unit (u) and of the wheels (w), complex numbers of x and y: ū·w, |u|², |w|², count.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct VelocityChanges {
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
    imu_calibration: ImuCalibration,
    wheel_calibration: Option<OdometryCalibration>,
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
    /// Sums nothing yet; readings are corrected by the calibrations of the set-up.
    pub(super) fn new(setup: &Setup) -> Self {
        InertialCollector {
            imu_calibration: setup.imu_calibration().unwrap_or_default(),
            wheel_calibration: setup.robot.odometry,
            ..InertialCollector::default()
        }
    }

    pub(super) fn add_imu(&mut self, imu: &Imu) {
        let imu = self.imu_calibration.apply(imu);
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
        let odometry = self
            .wheel_calibration
            .map_or(*odometry, |calibration| calibration.apply(odometry));
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

    /// True if the wheels' velocity changes, and the unit measures next to nothing of it.
    pub(super) fn is_unit_dead(&self) -> bool {
        let moves = self.wheels > self.count * CHANGE_MIN * CHANGE_MIN;
        self.count >= CHANGES_MIN && moves && self.inertial < DEAD_SHARE * self.wheels
    }

    /// Angle from the unit's changes to those of the wheels, degrees. None if they are few, small or not related.
    pub(super) fn angle_deg(&self) -> Option<f32> {
        let product = math::hypot(self.product[0], self.product[1]);
        let coherence = product / (self.inertial * self.wheels).sqrt();
        let moves = self.wheels > self.count * CHANGE_MIN * CHANGE_MIN;
        (self.count >= CHANGES_MIN && moves && coherence > COHERENCE_MIN)
            .then(|| math::atan2(self.product[1], self.product[0]).to_degrees())
    }
}
