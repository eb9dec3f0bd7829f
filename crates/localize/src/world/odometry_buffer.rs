//! The robot's own motion: odometry integrated to each image's stamp, between two increments.

use std::collections::VecDeque;

use super::observation::OdometryFrame;
use crate::frames::{RobotFrame, Tf};
use crate::omni::UNCORRECTED_MOTION;
use crate::sample::Odometry;
use crate::stamp::Stamp;

/// Largest number of increments after the newest image: a second of a fast sensor.
const INCREMENTS_MAX: usize = 1000;
/// The last increment is extrapolated for no longer than this, seconds: ten increments of a slow base.
const EXTRAPOLATION_MAX: f64 = 0.2;

type OdometryPose = Tf<OdometryFrame, RobotFrame>;
type PoseIncrement = Tf<RobotFrame, RobotFrame>;

/// A motion of the robot between two stamps.
#[derive(Debug, Clone, Copy)]
struct OdometryIncrement {
    /// End of the motion.
    stamp: Stamp,
    motion: PoseIncrement,
}

/// The last increment before an image, to extrapolate from.
#[derive(Debug, Clone, Copy)]
struct LastIncrement {
    increment: OdometryIncrement,
    /// Seconds.
    duration: f64,
}

/// The robot's pose in the odometry frame.
#[derive(Debug, Clone)]
pub(super) struct OdometryBuffer {
    /// At the newest image.
    pose_at_image: OdometryPose,
    image_stamp: Option<Stamp>,
    /// Increments that end after the newest image.
    increments: VecDeque<OdometryIncrement>,
    /// Start of the first of `increments`.
    previous_stamp: Option<Stamp>,
    /// The last increment that ends before an image.
    last_increment: Option<LastIncrement>,
}

impl Default for OdometryBuffer {
    fn default() -> Self {
        OdometryBuffer {
            pose_at_image: OdometryPose::new(0.0, 0.0, 0.0),
            image_stamp: None,
            increments: VecDeque::new(),
            previous_stamp: None,
            last_increment: None,
        }
    }
}

impl OdometryBuffer {
    /// Adds an increment; one that is not finite is ignored.
    pub(super) fn add(&mut self, odometry: &Odometry) {
        let &Odometry {
            stamp,
            dx,
            dy,
            dtheta,
            ..
        } = odometry;
        if ![dx, dy, dtheta].iter().all(|value| value.is_finite()) {
            return;
        }
        let last = self
            .increments
            .back()
            .map(|increment| increment.stamp)
            .or(self.previous_stamp);
        if last.is_some_and(|last| stamp <= last) {
            // The clock was reset: earlier stamps are meaningless.
            self.increments.clear();
            self.previous_stamp = None;
            self.last_increment = None;
        }
        let motion = PoseIncrement::new(dx, dy, dtheta);
        self.increments
            .push_back(OdometryIncrement { stamp, motion });
        if self.increments.len() > INCREMENTS_MAX
            && let Some(dropped) = self.increments.pop_front()
        {
            self.previous_stamp = Some(dropped.stamp);
        }
    }

    /// The robot's pose at the newest image.
    pub(super) fn pose_at_image(&self) -> OdometryPose {
        self.pose_at_image
    }

    /// Replaces the integrated pose at the newest image by one that is known better.
    pub(super) fn set_pose_at_image(&mut self, pose: OdometryPose) {
        self.pose_at_image = pose;
    }

    /// Integrates the motion up to an image at `stamp`; false if the motion is unknown.
    ///
    /// `pose_increment`: the motion between the images' poses, for a robot without odometry. `correction`: matrix
    /// from the reported to the true motion (x, y, θ), as estimated by localization.
    pub(super) fn advance_to(
        &mut self,
        stamp: Stamp,
        pose_increment: Option<PoseIncrement>,
        correction: [[f32; 3]; 3],
    ) -> bool {
        let correction = plausible_correction(correction);
        let last_image = self.image_stamp.replace(stamp);
        let mut pose = self.pose_at_image;
        let mut has_odometry = false;
        let mut integrated_to = last_image;
        while let Some(&increment) = self.increments.front() {
            let OdometryIncrement { stamp: end, motion } = increment;
            let start = self.previous_stamp.unwrap_or(end);
            if start >= stamp {
                break;
            }
            let duration = start.seconds_until(end);
            let from = integrated_to.map_or(start, |stamp| stamp.max(start));
            let until = end.min(stamp);
            let part = fraction(from.seconds_until(until), duration);
            pose = pose * correct_increment(motion, part, &correction);
            has_odometry |= last_image.is_some();
            integrated_to = Some(until);
            if end > stamp {
                break;
            }
            self.last_increment = Some(LastIncrement {
                increment,
                duration,
            });
            self.previous_stamp = Some(end);
            self.increments.pop_front();
        }
        // The image is newer than the last increment, which is extrapolated.
        if self.increments.is_empty()
            && let (Some(from), Some(last)) = (integrated_to, self.last_increment)
            && stamp > from
            && last.increment.stamp.seconds_until(stamp) <= EXTRAPOLATION_MAX
        {
            let part = fraction(from.seconds_until(stamp), last.duration);
            pose = pose * correct_increment(last.increment.motion, part.min(10.0), &correction);
            has_odometry = true;
        }
        match (has_odometry, pose_increment) {
            (true, _) => self.pose_at_image = pose,
            (false, Some(motion)) => self.pose_at_image = self.pose_at_image * motion,
            (false, None) => {}
        }
        has_odometry || pose_increment.is_some() || last_image.is_none()
    }
}

/// Share of an increment that lies within `seconds`; 0 for an increment without duration (the first).
fn fraction(seconds: f64, duration: f64) -> f32 {
    if duration > 0.0 {
        (seconds / duration).max(0.0) as f32
    } else {
        0.0
    }
}

/// `part` of a motion, corrected.
fn correct_increment(
    motion: PoseIncrement,
    part: f32,
    correction: &[[f32; 3]; 3],
) -> PoseIncrement {
    let [x, y, theta] =
        correction.map(|[a, b, c]| part * (a * motion.x + b * motion.y + c * motion.theta));
    PoseIncrement::new(x, y, theta)
}

/// A correction with a scale far from 1 is an estimation error and is replaced by none.
fn plausible_correction(correction: [[f32; 3]; 3]) -> [[f32; 3]; 3] {
    let is_plausible = (0..3).all(|k| correction[k][k] > 0.5 && correction[k][k] < 2.0);
    if is_plausible
        && correction
            .as_flattened()
            .iter()
            .all(|value| value.is_finite())
    {
        correction
    } else {
        UNCORRECTED_MOTION
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wheels_of_unequal_radius_do_not_turn_a_straight_way() {
        let mut buffer = OdometryBuffer::default();
        // 0.03 rad/m too much, and 2 % too short.
        let correction = [[1.02, 0.0, 0.0], [0.0, 1.02, 0.0], [-0.03, 0.0, 1.0]];
        assert!(buffer.advance_to(Stamp(0), None, correction));
        for k in 1..=100_i64 {
            buffer.add(&Odometry {
                stamp: Stamp(k * 10_000_000),
                dx: 0.01,
                dy: 0.0,
                dtheta: 0.0003,
                slip: 0.0,
            });
        }
        assert!(buffer.advance_to(Stamp(1_000_000_000), None, correction));
        let pose = buffer.pose_at_image();
        assert!((pose.x - 1.02 * 0.99).abs() < 0.011, "{pose:?}");
        assert!(pose.y.abs() < 1e-3 && pose.theta.abs() < 1e-3, "{pose:?}");
    }
}
