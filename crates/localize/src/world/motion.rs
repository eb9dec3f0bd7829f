//! How did the robot itself move? Odometry added up, and where it stood at a frame's stamp between two reports.

use std::collections::VecDeque;

use super::OdometryFrame;
use crate::frame::{RobotFrame, Tf};
use crate::sample::Odometry;
use crate::stamp::Stamp;

/// Odometry from the newest frame on is kept, and no more than a second of a fast sensor.
const LONGEST: usize = 1000;
/// Beyond the last report the motion is taken to go on for no longer than this, seconds: ten reports of a slow base.
const CARRY_ON: f64 = 0.2;

type Place = Tf<OdometryFrame, RobotFrame>;
type Step = Tf<RobotFrame, RobotFrame>;

/// The robot's way in the odometry's frame.
#[derive(Debug, Clone)]
pub(super) struct Motion {
    /// Where it was at the newest frame.
    frame: Place,
    stamp: Option<Stamp>,
    /// Reports not yet passed by a frame, and the one before them: stamp and motion since the report before.
    reports: VecDeque<(Stamp, Step)>,
    /// The stamp of the report before the first of `reports`.
    before: Option<Stamp>,
    /// The last report that a frame passed, with its length in seconds: what goes on behind it.
    latest: Option<(Stamp, Step, f64)>,
}

impl Default for Motion {
    fn default() -> Self {
        Motion {
            frame: Place::new(0.0, 0.0, 0.0),
            stamp: None,
            reports: VecDeque::new(),
            before: None,
            latest: None,
        }
    }
}

impl Motion {
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
        let last = self.reports.back().map(|(stamp, _)| *stamp).or(self.before);
        if last.is_some_and(|last| stamp <= last) {
            // A clock that was set: what was reported before it has no place in time any more.
            self.reports.clear();
            self.before = None;
            self.latest = None;
        }
        self.reports.push_back((stamp, Step::new(dx, dy, dtheta)));
        if self.reports.len() > LONGEST
            && let Some((stamp, _)) = self.reports.pop_front()
        {
            self.before = Some(stamp);
        }
    }

    /// Where the robot was at the newest frame.
    pub(super) fn at_frame(&self) -> Place {
        self.frame
    }

    /// Goes on to a frame at `stamp`; false if nothing tells how the robot moved.
    ///
    /// `poses`: the motion between the frames' poses, for a robot without odometry. `scales`: metres per
    /// reported metre and radians per reported radian, as localisation estimated them.
    pub(super) fn advance(&mut self, stamp: Stamp, poses: Option<Step>, scales: [f32; 2]) -> bool {
        let since = self.stamp.replace(stamp);
        let mut place = self.frame;
        let mut told = false;
        let mut done = since;
        while let Some(&(end, step)) = self.reports.front() {
            let start = self.before.unwrap_or(end);
            if start >= stamp {
                break;
            }
            let length = start.seconds_until(end);
            let from = done.map_or(start, |done| done.max(start));
            let until = end.min(stamp);
            let part = share(from.seconds_until(until), length);
            place = place * scaled(step, part, scales);
            told |= since.is_some();
            done = Some(until);
            if end > stamp {
                break;
            }
            self.latest = Some((end, step, length));
            self.before = Some(end);
            self.reports.pop_front();
        }
        // The frame is newer than the last report: the motion goes on as it was.
        if self.reports.is_empty()
            && let (Some(from), Some((end, step, length))) = (done, self.latest)
            && stamp > from
            && end.seconds_until(stamp) <= CARRY_ON
        {
            let part = share(from.seconds_until(stamp), length);
            place = place * scaled(step, part.min(10.0), scales);
            told = true;
        }
        match (told, poses) {
            (true, _) => self.frame = place,
            (false, Some(moved)) => self.frame = self.frame * moved,
            (false, None) => {}
        }
        told || poses.is_some() || since.is_none()
    }
}

/// Which part of a report lies in so many seconds; of a report without a length (the first) all.
fn share(seconds: f64, length: f64) -> f32 {
    if length > 0.0 {
        (seconds / length).max(0.0) as f32
    } else {
        0.0
    }
}

fn scaled(step: Step, part: f32, [way, turn]: [f32; 2]) -> Step {
    let (way, turn) = (part * usable(way), part * usable(turn));
    Step::new(step.x * way, step.y * way, step.theta * turn)
}

/// A scale far from one was not learned from driving.
fn usable(scale: f32) -> f32 {
    if scale > 0.5 && scale < 2.0 {
        scale
    } else {
        1.0
    }
}
