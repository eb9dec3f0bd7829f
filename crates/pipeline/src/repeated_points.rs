//! Does another vision system deliver old line points again? Its noise makes those of two images differ, wherever the robot is.

use localize::sample::LinePoint;

/// Motion in which even points without noise change, metres.
const MOTION_MIN: f64 = 0.05;

/// What a recording or a log says of an image with old points.
pub(crate) const REPEATED: &str =
    "the line points of an earlier image again, although the wheels have turned since";

/// The points that the next ones are compared with.
#[derive(Default)]
pub(crate) struct RepeatedPoints {
    last: Vec<LinePoint>,
    /// Path of the wheels when these points came first, metres.
    path: f64,
}

impl RepeatedPoints {
    /// True for the points of the image before, to the bit, if the wheels turned since. `path`: of the wheels up to now, metres.
    pub(crate) fn add(&mut self, points: &[LinePoint], path: f64) -> bool {
        if points.is_empty() {
            return false;
        }
        if points == self.last {
            return path - self.path > MOTION_MIN;
        }
        self.last.clear();
        self.last.extend_from_slice(points);
        self.path = path;
        false
    }
}
