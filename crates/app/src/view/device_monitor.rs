//! State of each device from the stamps of its samples: age, gaps and faults. Sources: live, simulated or a log.

use std::collections::VecDeque;

use localize::Stamp;

use pipeline::Cycle;

/// Averaging window of the sample rate, seconds.
const RATE_WINDOW: f64 = 2.0;
/// Identical readings in a row after which a sensor counts as stuck.
const STUCK_REPEATS: u32 = 20;
/// A device is silent if its last sample is older than this many of its usual intervals.
const SILENT_INTERVALS: f64 = 5.0;

/// Statistics of one device.
#[derive(Debug, Clone, Default)]
pub(crate) struct DeviceHealth {
    /// Camera, wheels, compass, IMU.
    pub(crate) name: &'static str,
    recent: VecDeque<Stamp>,
    /// Stamp of the last sample.
    pub(crate) last: Option<Stamp>,
    /// Number of samples.
    pub(crate) samples: u64,
    /// Longest time between two samples, seconds, and when it ended.
    pub(crate) longest_gap: f64,
    pub(crate) longest_gap_end: Stamp,
    /// Bit-identical readings in a row.
    repeats: u32,
    reading: [u32; 6],
    /// Number of faults.
    pub(crate) fault_count: u64,
    /// Description of the last fault.
    pub(crate) last_fault: Option<String>,
}

/// State of a device.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum DeviceState {
    /// No sample has arrived.
    NoData,
    /// Samples arrive.
    Running,
    /// Samples arrived, but have stopped.
    Silent,
    /// Readings repeat bit for bit.
    Stuck,
}

impl DeviceState {
    /// Label in tables and reports.
    pub(crate) fn label(self) -> &'static str {
        match self {
            DeviceState::NoData => "no data",
            DeviceState::Running => "running",
            DeviceState::Silent => "silent",
            DeviceState::Stuck => "stuck: readings repeat",
        }
    }
}

impl DeviceHealth {
    fn record(&mut self, stamp: Stamp, reading: [u32; 6]) {
        if let Some(last) = self.last.filter(|last| stamp - *last > self.longest_gap) {
            self.longest_gap = stamp - last;
            self.longest_gap_end = stamp;
        }
        self.repeats = if self.samples > 0 && reading == self.reading {
            self.repeats + 1
        } else {
            0
        };
        self.reading = reading;
        self.samples += 1;
        self.last = Some(stamp);
        self.recent.push_back(stamp);
        while (self.recent.front()).is_some_and(|first| stamp - *first > RATE_WINDOW) {
            self.recent.pop_front();
        }
    }

    /// Seconds since the last sample.
    pub(crate) fn age(&self, now: Stamp) -> Option<f64> {
        self.last.map(|last| now - last)
    }

    /// State at `now`.
    pub(crate) fn state(&self, now: Stamp) -> DeviceState {
        let Some(age) = self.age(now) else {
            return DeviceState::NoData;
        };
        let usual = self.recent.len().max(2) as f64 / RATE_WINDOW;
        if age > (SILENT_INTERVALS / usual).max(0.2) {
            DeviceState::Silent
        } else if self.repeats >= STUCK_REPEATS {
            DeviceState::Stuck
        } else {
            DeviceState::Running
        }
    }
}

/// Statistics of all devices of the robot.
#[derive(Debug, Clone)]
pub(crate) struct DeviceMonitor {
    /// Camera, wheels, compass, IMU.
    pub(crate) devices: [DeviceHealth; 4],
    /// Stamp of the last cycle.
    pub(crate) stamp: Stamp,
    /// Cycles dropped before they reached the view.
    pub(crate) dropped: u64,
    /// Cycles received.
    pub(crate) cycles: u64,
}

impl Default for DeviceMonitor {
    fn default() -> Self {
        let device = |name| DeviceHealth {
            name,
            ..DeviceHealth::default()
        };
        DeviceMonitor {
            devices: ["camera", "wheels", "compass", "IMU"].map(device),
            stamp: Stamp::default(),
            dropped: 0,
            cycles: 0,
        }
    }
}

impl DeviceMonitor {
    /// Adds a cycle's samples; a stamp from the past resets all statistics.
    pub(crate) fn update(&mut self, cycle: &Cycle) {
        if cycle.stamp < self.stamp {
            *self = DeviceMonitor::default();
        }
        self.stamp = cycle.stamp;
        self.cycles += 1;
        let [camera, wheels, compass, imu] = &mut self.devices;
        let bits = f32::to_bits;
        if let Some(fault) = &cycle.image_fault {
            camera.fault_count += 1;
            camera.last_fault = Some(fault.clone());
        } else {
            // Bit-identical line points mean a repeated image.
            let first = cycle.line_points.first();
            let reading = first.map_or([0; 6], |point| {
                let last = cycle.line_points.last().map_or(point.at, |last| last.at);
                let count = cycle.line_points.len() as u32;
                let unique = if count < 2 { cycle.stamp.0 as u32 } else { 0 };
                [
                    bits(point.at.x),
                    bits(point.at.y),
                    bits(last.x),
                    bits(last.y),
                    count,
                    unique,
                ]
            });
            // Without line points, images cannot be compared: the stamp makes each reading unique.
            let reading = if first.is_none() {
                [cycle.stamp.0 as u32; 6]
            } else {
                reading
            };
            camera.record(cycle.stamp, reading);
        }
        for sample in &cycle.inputs.odometry {
            // Equal readings are correct for wheels at rest: the stamp makes each reading unique.
            let at_rest = sample.dx == 0.0 && sample.dy == 0.0 && sample.dtheta == 0.0;
            let unique = if at_rest { sample.stamp.0 as u32 } else { 0 };
            let reading = [
                bits(sample.dx),
                bits(sample.dy),
                bits(sample.dtheta),
                unique,
                0,
                0,
            ];
            wheels.record(sample.stamp, reading);
        }
        for sample in &cycle.inputs.compass {
            compass.record(sample.stamp, [bits(sample.heading), 0, 0, 0, 0, 0]);
        }
        for sample in &cycle.inputs.imu {
            let [ax, ay, az] = sample.specific_force.map(bits);
            let [rx, ry, rz] = sample.angular_velocity.map(bits);
            imu.record(sample.stamp, [ax, ay, az, rx, ry, rz]);
        }
    }
}
