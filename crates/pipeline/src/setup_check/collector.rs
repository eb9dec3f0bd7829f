//! Which cycles of a run become keyframes? Evenly spaced ones, few enough to keep for hours.

use localize::sample::Odometry;

use super::measurements::{KEYFRAMES_MAX, METRES_PER_RADIAN, METRES_PER_SECOND, SPACING_MIN};
use super::{MeasuredKeyframe, measurements};
use crate::cycle::Cycle;

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
    last_odometry: Option<localize::Stamp>,
    /// Rows of the odometry from which the velocity at an image follows.
    recent: Vec<Odometry>,
    last_cycle: Option<localize::Stamp>,
}

impl Default for KeyframeCollector {
    fn default() -> Self {
        KeyframeCollector {
            keyframes: Vec::new(),
            spacing: SPACING_MIN,
            path: 0.0,
            progress: f32::INFINITY,
            odometry: None,
            last_odometry: None,
            recent: Vec::new(),
            last_cycle: None,
        }
    }
}

impl KeyframeCollector {
    /// Adds a cycle.
    pub fn add_cycle(&mut self, cycle: &Cycle) {
        for row in &cycle.inputs.odometry {
            let gap = self
                .last_odometry
                .is_some_and(|last| row.stamp - last > measurements::ODOMETRY_GAP_MAX);
            if gap {
                self.odometry = None;
            }
            self.last_odometry = Some(row.stamp);
            self.recent.push(*row);
            let step = localize::math::hypot(row.dx, row.dy)
                + METRES_PER_RADIAN * row.dtheta.abs().min(0.5);
            self.progress += step;
            self.path += step;
            if let Some(rows) = &mut self.odometry {
                rows.push([row.dx, row.dy, row.dtheta]);
            }
        }
        let unused = measurements::rows_before_velocity(&self.recent, cycle.stamp);
        self.recent.drain(..unused);
        let seconds = self
            .last_cycle
            .map_or(0.0, |last| (cycle.stamp - last) as f32);
        self.last_cycle = Some(cycle.stamp);
        self.progress += METRES_PER_SECOND * seconds.clamp(0.0, 4.0);
        let connected = self
            .last_odometry
            .is_some_and(|last| (cycle.stamp - last).abs() <= measurements::ODOMETRY_GAP_MAX);
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
            compass: cycle.inputs.compass.last().map(|reading| reading.heading),
            velocity: measurements::velocity_at(&self.recent, cycle.stamp),
        });
        self.odometry = Some(Vec::new());
        self.progress = 0.0;
        if self.keyframes.len() >= 2 * KEYFRAMES_MAX {
            self.keyframes = measurements::thin_out(&self.keyframes, 2);
            self.spacing *= 2.0;
        }
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
