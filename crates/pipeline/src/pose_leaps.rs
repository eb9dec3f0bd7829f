//! Where does a path leap although wheels and gyro say otherwise? Poses that are certain, far from where the motion led.

use localize::estimate::{Estimate, Mode};
use localize::frames::{RobotFrame, Tf};
use localize::robot::OdometryCalibration;
use localize::sample::Odometry;
use localize::{Pose, Stamp, math};

use crate::cycle::Cycle;

/// Standard deviation up to which a pose is certain, metres.
const CERTAIN_STD: f32 = 0.2;
/// A smaller leap may be a slip or a collision, metres.
const LEAP_MIN: f32 = 1.0;
/// Largest path between certain poses about which the wheels say anything, metres.
const PATH_MAX: f32 = 15.0;
/// Path over which the error of the wheels is measured where poses are certain, metres.
const WINDOW: f32 = 1.0;
/// Share of the path by which the wheels of a drive may be wrong before they are measured, and at most.
const WHEEL_ERROR: (f32, f32) = (0.1, 0.5);
/// Errors of the wheels beyond their mean that are expected.
const WHEEL_ERROR_FACTOR: f32 = 3.0;
/// Longest time between rows of odometry, seconds.
const ROWS_APART_MAX: f64 = 1.0;
/// Images at the new place before it counts as a leap: a single wrong match is none.
const IMAGES_MIN: usize = 5;

/// A leap of the path.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Leap {
    from: Stamp,
    to: Stamp,
    /// Metres.
    size: f32,
}

/// A leap of which it is not known whether the poses stay at its end.
#[derive(Debug, Clone, Copy)]
struct Candidate {
    leap: Leap,
    /// Since the last certain pose before it.
    motion: Motion,
    /// Images at its end.
    images: usize,
}

/// Motion by the wheels since a certain pose.
#[derive(Debug, Clone, Copy)]
struct Motion {
    since: Pose,
    stamp: Stamp,
    step: Tf<RobotFrame, RobotFrame>,
    /// Metres.
    path: f32,
}

impl Motion {
    fn since(since: Pose, stamp: Stamp) -> Self {
        Motion {
            since,
            stamp,
            step: Tf::new(0.0, 0.0, 0.0),
            path: 0.0,
        }
    }

    fn add(&mut self, row: &Odometry) {
        self.step = self.step * Tf::new(row.dx, row.dy, row.dtheta);
        self.path += math::hypot(row.dx, row.dy);
    }

    /// Distance of a pose from the one to which the wheels led, metres.
    fn error(&self, pose: Pose) -> f32 {
        let led = self.since * self.step;
        math::hypot(pose.x - led.x, pose.y - led.y)
    }
}

/// Finds the leaps of a run's path.
#[derive(Debug, Default)]
pub(crate) struct PoseLeaps {
    calibration: Option<OdometryCalibration>,
    last_row: Option<Stamp>,
    /// Since the last certain pose. None before it, and where odometry is missing.
    motion: Option<Motion>,
    /// Since the start of a window of certain poses.
    window: Option<Motion>,
    /// Sum of the wheels' errors as shares of the path, and the number of windows.
    wheel_errors: (f32, f32),
    candidate: Option<Candidate>,
    found: Vec<Leap>,
}

impl PoseLeaps {
    /// No leap yet. `calibration`: of the wheels.
    pub(crate) fn new(calibration: Option<OdometryCalibration>) -> Self {
        PoseLeaps {
            calibration,
            ..PoseLeaps::default()
        }
    }

    /// Adds the next image of the run.
    pub(crate) fn add(&mut self, cycle: &Cycle) {
        self.add_image(&cycle.inputs.odometry, &cycle.estimate);
    }

    fn add_image(&mut self, odometry: &[Odometry], estimate: &Estimate) {
        for row in odometry {
            let is_gap = self
                .last_row
                .is_some_and(|last| row.stamp - last > ROWS_APART_MAX);
            self.last_row = Some(row.stamp);
            if is_gap {
                (self.motion, self.window) = (None, None);
            }
            let row = self
                .calibration
                .map_or(*row, |calibration| calibration.apply(row));
            let candidate = self
                .candidate
                .as_mut()
                .map(|candidate| &mut candidate.motion);
            let motions = [self.motion.as_mut(), self.window.as_mut(), candidate];
            for motion in motions.into_iter().flatten() {
                motion.add(&row);
            }
        }
        let is_covered = self
            .last_row
            .is_some_and(|last| estimate.stamp - last <= ROWS_APART_MAX);
        if !is_covered {
            (self.motion, self.window) = (None, None);
        }
        let Some(pose) = certain_pose(estimate) else {
            return;
        };
        let wheel_error = self.wheel_error();
        let leaps = |motion: &Motion| {
            motion.path < PATH_MAX
                && motion.error(pose) > LEAP_MIN + WHEEL_ERROR_FACTOR * wheel_error * motion.path
        };
        if let Some(motion) = self.motion.filter(leaps) {
            // A leap back to where the wheels led ends a wrong match.
            let is_back = self.candidate.is_some_and(|before| !leaps(&before.motion));
            self.candidate = (!is_back).then_some(Candidate {
                leap: Leap {
                    from: motion.stamp,
                    to: estimate.stamp,
                    size: motion.error(pose),
                },
                motion,
                images: 0,
            });
            self.window = None;
        } else if let Some(candidate) = &mut self.candidate {
            candidate.images += 1;
            if candidate.images >= IMAGES_MIN {
                self.found.push(candidate.leap);
                self.candidate = None;
            }
        }
        self.measure_wheels(pose, estimate.stamp);
        self.motion = is_covered.then(|| Motion::since(pose, estimate.stamp));
    }

    fn measure_wheels(&mut self, pose: Pose, stamp: Stamp) {
        match self.window {
            Some(window) if window.path < WINDOW => {}
            Some(window) => {
                let (sum, count) = &mut self.wheel_errors;
                *sum += window.error(pose) / window.path;
                *count += 1.0;
                self.window = Some(Motion::since(pose, stamp));
            }
            None => self.window = Some(Motion::since(pose, stamp)),
        }
    }

    /// Mean error of the wheels as a share of the path.
    fn wheel_error(&self) -> f32 {
        let (sum, count) = self.wheel_errors;
        // One window with the error that is expected anyway.
        ((sum + WHEEL_ERROR.0) / (count + 1.0)).min(WHEEL_ERROR.1)
    }

    /// The warning, if the path leaps.
    pub(crate) fn warning(&self) -> Option<String> {
        let leap = self.found.first()?;
        let others = match self.found.len() - 1 {
            0 => String::new(),
            more => format!(" (and {more} more later)"),
        };
        Some(format!(
            "the path leaps by {:.1} m against the wheels between {:.3} and {:.3} s, and stays there{others}: perhaps the field file is \
             wrong there (markings missing, or elsewhere), or the robot was carried",
            leap.size,
            leap.from.seconds(),
            leap.to.seconds()
        ))
    }
}

/// The pose of an image that matched, if there is no doubt about it.
fn certain_pose(estimate: &Estimate) -> Option<Pose> {
    let variance = estimate.covariance[(0, 0)].max(estimate.covariance[(1, 1)]);
    let is_matched = estimate.mode == Mode::Tracking && !estimate.is_predicted();
    estimate
        .pose
        .filter(|_| is_matched && variance < CERTAIN_STD * CERTAIN_STD)
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix3;

    use super::*;

    /// The warning after a straight drive at 1 m/s of which the poses have an error along y at each time.
    fn warning(wheel_scale: f32, error: impl Fn(f32) -> f32) -> Option<String> {
        let mut leaps = PoseLeaps::new(None);
        for image in 0..100 {
            let time = 0.1 * image as f32;
            let stamp = Stamp::from_seconds(f64::from(time));
            let row = Odometry {
                stamp,
                dx: 0.1 * wheel_scale,
                dy: 0.0,
                dtheta: 0.0,
                slip: 0.0,
            };
            let pose = Pose::new(time - 5.0, error(time), 0.0);
            let covariance = Matrix3::from_diagonal_element(1e-4);
            leaps.add_image(&[row], &Estimate::tracked(stamp, pose, covariance));
        }
        leaps.warning()
    }

    #[test]
    fn leap_against_the_wheels_is_named_with_times_and_size() {
        let text = warning(1.0, |time| if time > 6.05 { 3.0 } else { 0.0 }).expect("a leap");
        assert!(text.contains("leaps by 3.0 m"), "{text}");
        assert!(text.contains("between 6.000 and 6.100 s"), "{text}");
    }

    #[test]
    fn single_wrong_matches_and_wrong_wheels_are_no_leaps() {
        assert_eq!(warning(1.0, |_| 0.0), None);
        assert_eq!(warning(1.5, |_| 0.0), None);
        assert_eq!(warning(0.0, |_| 0.0), None);
        assert_eq!(
            warning(1.0, |time| if (5.95..6.25).contains(&time) {
                3.0
            } else {
                0.0
            }),
            None
        );
    }
}
