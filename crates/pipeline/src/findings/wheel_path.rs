//! How did the robot move between two images, by its wheels alone?

use localize::math;
use localize::sample::Odometry;

/// Before the first wheel sample the robot stood, for at most this long, seconds.
const FIRST_SAMPLE: f64 = 1e-3;

/// The path of the wheels from their first sample on: time (s), x, y (m) and heading (rad).
#[derive(Debug, Clone, Default)]
pub(super) struct WheelPath(Vec<[f64; 4]>);

impl WheelPath {
    /// Adds a sample.
    pub(super) fn push(&mut self, odometry: &Odometry) {
        let stamp = odometry.stamp.seconds();
        let [before, x, y, heading] =
            *self
                .0
                .last()
                .unwrap_or(&[stamp - FIRST_SAMPLE, 0.0, 0.0, 0.0]);
        if self.0.is_empty() {
            self.0.push([before, x, y, heading]);
        }
        let (sin, cos) = math::sin_cos(heading);
        let [dx, dy, dtheta] = [odometry.dx, odometry.dy, odometry.dtheta].map(f64::from);
        // A late sample is added at the time of the one before it.
        self.0.push([
            stamp.max(before),
            x + cos * dx - sin * dy,
            y + sin * dx + cos * dy,
            heading + dtheta,
        ]);
    }

    /// True without a sample.
    pub(super) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Forgets the path before a time, but for the last place there.
    pub(super) fn forget_before(&mut self, time: f64) {
        let first = self.0.partition_point(|[at, ..]| *at < time);
        self.0.drain(..first.saturating_sub(1));
    }

    /// Motion from one time to another, metres, in the robot frame at the first.
    pub(super) fn motion(&self, from: f64, to: f64) -> [f64; 2] {
        let (Some(start), Some(end)) = (self.at(from), self.at(to)) else {
            return [0.0; 2];
        };
        let (dx, dy) = (end[0] - start[0], end[1] - start[1]);
        let (sin, cos) = math::sin_cos(start[2]);
        [cos * dx + sin * dy, cos * dy - sin * dx]
    }

    /// Place (x, y, heading) at a time, linear between samples.
    fn at(&self, time: f64) -> Option<[f64; 3]> {
        let later = self.0.partition_point(|[at, ..]| *at <= time);
        let Some(before) = later.checked_sub(1).map(|place| self.0[place]) else {
            return self.0.first().map(|[_, x, y, heading]| [*x, *y, *heading]);
        };
        let after = self.0.get(later).copied().unwrap_or(before);
        let length = after[0] - before[0];
        let share = if length > 0.0 {
            (time - before[0]) / length
        } else {
            0.0
        };
        Some([1, 2, 3].map(|axis: usize| before[axis] + share * (after[axis] - before[axis])))
    }
}
