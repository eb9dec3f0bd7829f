//! How did the robot itself move? Odometry added up, and where it stood at a frame's stamp between two reports.

use std::collections::VecDeque;

use super::OdometryFrame;
use crate::frames::{RobotFrame, Tf};
use crate::sample::Odometry;
use crate::stamp::Stamp;

/// Odometry from the newest frame on is kept, and no more than a second of a fast sensor.
const INCREMENTS_MAX: usize = 1000;
/// Beyond the last report the motion is taken to go on for no longer than this, seconds: ten reports of a slow base.
const EXTRAPOLATION_MAX: f64 = 0.2;

type OdometryPose = Tf<OdometryFrame, RobotFrame>;
type PoseIncrement = Tf<RobotFrame, RobotFrame>;

/// The robot's way in the odometry's frame.
#[derive(Debug, Clone)]
pub(super) struct OdometryBuffer {
    /// Where it was at the newest frame.
    pose_at_image: OdometryPose,
    image_stamp: Option<Stamp>,
    /// Reports not yet passed by a frame, and the one before them: stamp and motion since the report before.
    increments: VecDeque<(Stamp, PoseIncrement)>,
    /// The stamp of the report before the first of `reports`.
    previous_stamp: Option<Stamp>,
    /// The last report that a frame passed, with its length in seconds: what goes on behind it.
    last_increment: Option<(Stamp, PoseIncrement, f64)>,
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
    /// Takes a report.
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
            .map(|(stamp, _)| *stamp)
            .or(self.previous_stamp);
        if last.is_some_and(|last| stamp <= last) {
            // A clock that was set: what was reported before it has no place in time any more.
            self.increments.clear();
            self.previous_stamp = None;
            self.last_increment = None;
        }
        self.increments
            .push_back((stamp, PoseIncrement::new(dx, dy, dtheta)));
        if self.increments.len() > INCREMENTS_MAX
            && let Some((stamp, _)) = self.increments.pop_front()
        {
            self.previous_stamp = Some(stamp);
        }
    }

    /// Where the robot was at the newest frame.
    pub(super) fn pose_at_image(&self) -> OdometryPose {
        self.pose_at_image
    }

    /// Goes on to a frame at `stamp`; false if nothing tells how the robot moved.
    ///
    /// `poses`: the motion between the frames' poses, for a robot without odometry. `scales`: metres per
    /// reported metre and radians per reported radian, as localisation estimated them.
    pub(super) fn advance_to(
        &mut self,
        stamp: Stamp,
        poses: Option<PoseIncrement>,
        scales: [f32; 2],
    ) -> bool {
        let since = self.image_stamp.replace(stamp);
        let mut place = self.pose_at_image;
        let mut told = false;
        let mut done = since;
        while let Some(&(end, step)) = self.increments.front() {
            let start = self.previous_stamp.unwrap_or(end);
            if start >= stamp {
                break;
            }
            let length = start.seconds_until(end);
            let from = done.map_or(start, |done| done.max(start));
            let until = end.min(stamp);
            let part = fraction(from.seconds_until(until), length);
            place = place * scale_increment(step, part, scales);
            told |= since.is_some();
            done = Some(until);
            if end > stamp {
                break;
            }
            self.last_increment = Some((end, step, length));
            self.previous_stamp = Some(end);
            self.increments.pop_front();
        }
        // The frame is newer than the last report: the motion goes on as it was.
        if self.increments.is_empty()
            && let (Some(from), Some((end, step, length))) = (done, self.last_increment)
            && stamp > from
            && end.seconds_until(stamp) <= EXTRAPOLATION_MAX
        {
            let part = fraction(from.seconds_until(stamp), length);
            place = place * scale_increment(step, part.min(10.0), scales);
            told = true;
        }
        match (told, poses) {
            (true, _) => self.pose_at_image = place,
            (false, Some(moved)) => self.pose_at_image = self.pose_at_image * moved,
            (false, None) => {}
        }
        told || poses.is_some() || since.is_none()
    }
}

/// Which part of a report lies in so many seconds; of a report without a length (the first) all.
fn fraction(seconds: f64, length: f64) -> f32 {
    if length > 0.0 {
        (seconds / length).max(0.0) as f32
    } else {
        0.0
    }
}

fn scale_increment(step: PoseIncrement, part: f32, [way, turn]: [f32; 2]) -> PoseIncrement {
    let (way, turn) = (part * plausible_scale(way), part * plausible_scale(turn));
    PoseIncrement::new(step.x * way, step.y * way, step.theta * turn)
}

/// A scale far from one was not learned from driving.
fn plausible_scale(scale: f32) -> f32 {
    if scale > 0.5 && scale < 2.0 {
        scale
    } else {
        1.0
    }
}
