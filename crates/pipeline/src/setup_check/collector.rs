//! Which cycles of a run become keyframes? Evenly spaced ones, few and small enough to keep for hours.

use localize::Stamp;
use localize::filter::FilterConfig;
use localize::math;
use localize::sample::{Compass, Imu, Odometry};
use localize::setup_check::METRES_PER_RADIAN;

use super::inertial_motion::InertialCollector;
use super::measurements::{KEYFRAMES_MAX, METRES_PER_SECOND, SPACING_MIN};
use super::{MeasuredKeyframe, measurements};
use crate::cycle::Cycle;
use crate::sample::Sample;
use crate::setup::Setup;

/// Largest turn of joined rows of odometry, radians. Their motions then differ in direction by half of it at most.
const JOINED_TURN_MAX: f32 = 0.05;
/// What was measured this long after an exposure, or less, waits for the next one, seconds: longer than a latency may be.
const LATER_MAX: f64 = 2.0;

/// Collects keyframes from the cycles of a run. When there are too many, every second one is dropped.
#[derive(Debug, Clone)]
pub struct KeyframeCollector {
    keyframes: Vec<MeasuredKeyframe>,
    spacing: f32,
    /// Motion by the wheels, metres, where a radian counts as half a metre.
    path: f32,
    /// Motion since the last keyframe, metres.
    progress: f32,
    /// Odometry since the last keyframe; None after a gap.
    odometry: Option<Vec<[f32; 3]>>,
    last_odometry: Option<Stamp>,
    /// Rows of the odometry from which the velocity at an image follows.
    recent: Vec<Odometry>,
    last_cycle: Option<Stamp>,
    inertial: InertialCollector,
    /// Age of an image at its stamp, seconds.
    latency: f64,
    /// Wheels, compass and inertial unit since the exposure of the last image, in the order of their stamps.
    later: Vec<Sample>,
}

impl KeyframeCollector {
    /// Collects nothing yet.
    pub fn new(setup: &Setup, filter: &FilterConfig) -> Self {
        KeyframeCollector {
            keyframes: Vec::new(),
            spacing: SPACING_MIN,
            path: 0.0,
            progress: f32::INFINITY,
            odometry: None,
            last_odometry: None,
            recent: Vec::new(),
            last_cycle: None,
            inertial: InertialCollector::new(setup),
            latency: setup.camera_latency(filter).into(),
            later: Vec::new(),
        }
    }

    /// Adds a cycle.
    pub fn add_cycle(&mut self, cycle: &Cycle) {
        let exposure = cycle.stamp + -self.latency;
        self.recent.extend_from_slice(&cycle.inputs.odometry);
        let mut samples = std::mem::take(&mut self.later);
        samples.extend(cycle.inputs.sorted_samples());
        let mut compass = None;
        // Stamps of another clock may be years ahead.
        let is_later = |stamp: Stamp| stamp > exposure && stamp - exposure < LATER_MAX;
        for sample in samples {
            match sample {
                Sample::Odometry(Odometry { stamp, .. })
                | Sample::Imu(Imu { stamp, .. })
                | Sample::Compass(Compass { stamp, .. })
                    if is_later(stamp) =>
                {
                    self.later.push(sample);
                }
                Sample::Odometry(row) => self.add_odometry(&row),
                Sample::Imu(imu) => self.inertial.add_imu(&imu),
                Sample::Compass(reading) => compass = Some(reading.heading),
                _ => {}
            }
        }
        let unused = measurements::rows_before_velocity(&self.recent, exposure);
        self.recent.drain(..unused);
        let seconds = self
            .last_cycle
            .map_or(0.0, |last| (cycle.stamp - last) as f32);
        self.last_cycle = Some(cycle.stamp);
        self.progress += METRES_PER_SECOND * seconds.clamp(0.0, 4.0);
        let connected = self
            .last_odometry
            .is_some_and(|last| (exposure - last).abs() <= measurements::ODOMETRY_GAP_MAX);
        if !connected {
            self.odometry = None;
        }
        // A keyframe without line points says nothing: the next image takes its place.
        if self.progress < self.spacing || cycle.line_points.is_empty() {
            return;
        }
        let detections = cycle.detections.as_ref();
        self.keyframes.push(MeasuredKeyframe {
            stamp: cycle.stamp,
            points: cycle.line_points.clone(),
            pixels: detections.map_or_else(Vec::new, |detections| {
                detections
                    .line_points
                    .iter()
                    .map(|point| point.position_px)
                    .collect()
            }),
            odometry: self.odometry.take(),
            compass,
            velocity: measurements::velocity_at(&self.recent, exposure),
            inertial: self.inertial.take_motion(),
        });
        self.odometry = Some(Vec::new());
        self.progress = 0.0;
        if self.keyframes.len() >= 2 * KEYFRAMES_MAX {
            self.keyframes = measurements::thin_out(&self.keyframes, 2);
            self.spacing *= 2.0;
        }
    }

    fn add_odometry(&mut self, row: &Odometry) {
        let gap = self
            .last_odometry
            .is_some_and(|last| row.stamp - last > measurements::ODOMETRY_GAP_MAX);
        if gap {
            self.odometry = None;
        }
        self.last_odometry = Some(row.stamp);
        let step = math::hypot(row.dx, row.dy) + METRES_PER_RADIAN * row.dtheta.abs().min(0.5);
        self.progress += step;
        self.path += step;
        if let Some(rows) = &mut self.odometry {
            add_motion(rows, [row.dx, row.dy, row.dtheta]);
        }
        self.inertial.add_odometry(row);
    }

    /// Motion by the wheels, metres, where a radian counts as half a metre. 0 without odometry.
    pub fn path(&self) -> f32 {
        self.path
    }

    /// The keyframes, at most as many as a recording has.
    pub fn keyframes(&self) -> Vec<MeasuredKeyframe> {
        let stride = self.keyframes.len().div_ceil(KEYFRAMES_MAX).max(1);
        measurements::thin_out(&self.keyframes, stride)
    }
}

/// Adds a motion (metres, metres, radians) to those since the last keyframe. It joins the last one as long as this hardly
/// turns: a hundred rows a second over hours would be megabytes.
fn add_motion(rows: &mut Vec<[f32; 3]>, [dx, dy, turn]: [f32; 3]) {
    match rows.last_mut() {
        Some([x, y, heading]) if heading.abs() + turn.abs() <= JOINED_TURN_MAX => {
            let (sin, cos) = math::sin_cos(*heading);
            *x += cos * dx - sin * dy;
            *y += sin * dx + cos * dy;
            *heading += turn;
        }
        _ => rows.push([dx, dy, turn]),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sum(rows: &[[f32; 3]]) -> [f64; 3] {
        rows.iter().fold([0.0; 3], |[x, y, heading], row| {
            let [dx, dy, turn] = row.map(f64::from);
            let (sin, cos) = math::sin_cos(heading);
            [
                x + cos * dx - sin * dy,
                y + sin * dx + cos * dy,
                heading + turn,
            ]
        })
    }

    /// Ten minutes at 100 Hz, driving and turning to and fro, with rests.
    #[test]
    fn joined_motions_are_few_and_lead_to_the_same_pose() {
        let rows: Vec<[f32; 3]> = (0..60_000)
            .map(|index| {
                let time = 0.01 * index as f32;
                let moves = if (time as usize / 10).is_multiple_of(2) {
                    1.0
                } else {
                    0.0
                };
                [
                    0.01 * moves,
                    0.003 * moves,
                    0.005 * moves * math::sin(0.7 * time),
                ]
            })
            .collect();
        let mut joined = Vec::new();
        rows.iter().for_each(|row| add_motion(&mut joined, *row));
        assert!(joined.len() < rows.len() / 10, "{}", joined.len());
        let (all, joined) = (sum(&rows), sum(&joined));
        let off = math::hypot(joined[0] - all[0], joined[1] - all[1]);
        assert!(off < 0.01 && (joined[2] - all[2]).abs() < 1e-3, "{off} m");
    }
}
