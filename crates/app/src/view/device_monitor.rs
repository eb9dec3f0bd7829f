//! How is each device? Rates, ages and errors, told from the stamps of what arrived: live, simulated or from a log.

use std::collections::VecDeque;

use localize::Stamp;

use pipeline::Cycle;

/// Rates are counted over so many seconds.
const RATE_WINDOW: f64 = 2.0;
/// So many equal readings in a row come from no living sensor.
const STUCK_REPEATS: u32 = 20;
/// A device is silent when its last sample is older than so many of its usual intervals.
const SILENT_INTERVALS: f64 = 5.0;

/// One device.
#[derive(Debug, Clone, Default)]
pub(crate) struct DeviceHealth {
    /// Camera, wheels, compass, IMU.
    pub(crate) name: &'static str,
    recent: VecDeque<Stamp>,
    /// When the last sample was taken.
    pub(crate) last: Option<Stamp>,
    /// All samples.
    pub(crate) samples: u64,
    /// Longest time between two samples, seconds.
    pub(crate) longest_gap: f64,
    /// Readings in a row that were equal to the last bit.
    repeats: u32,
    reading: [u32; 6],
    /// Faults, and the last one.
    pub(crate) fault_count: u64,
    /// What the last fault was.
    pub(crate) last_fault: Option<String>,
}

/// What a device is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum DeviceState {
    /// Nothing came yet.
    NoData,
    /// It delivers.
    Running,
    /// It delivered once.
    Silent,
    /// It repeats itself.
    Stuck,
}

impl DeviceState {
    /// In a word.
    pub(crate) fn label(self) -> &'static str {
        match self {
            DeviceState::NoData => "nothing came",
            DeviceState::Running => "running",
            DeviceState::Silent => "silent",
            DeviceState::Stuck => "stuck: repeats itself",
        }
    }
}

impl DeviceHealth {
    fn record(&mut self, stamp: Stamp, reading: [u32; 6]) {
        if let Some(last) = self.last {
            self.longest_gap = self.longest_gap.max(stamp - last);
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

    /// What it is doing as of `now`.
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

/// All devices of the robot.
#[derive(Debug, Clone)]
pub(crate) struct DeviceMonitor {
    /// One each.
    pub(crate) devices: [DeviceHealth; 4],
    /// Of the last cycle.
    pub(crate) stamp: Stamp,
    /// Cycles that did not get to the view.
    pub(crate) dropped: u64,
    /// Cycles seen.
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
    /// Takes what a cycle brought; a clock set back begins anew.
    pub(crate) fn update(&mut self, cycle: &Cycle) {
        if cycle.stamp < self.stamp {
            *self = DeviceMonitor::default();
        }
        self.stamp = cycle.stamp;
        self.cycles += 1;
        let [camera, wheels, compass, imu] = &mut self.devices;
        let bits = f32::to_bits;
        if let Some(fault) = &cycle.fault {
            camera.fault_count += 1;
            camera.last_fault = Some(fault.clone());
        } else {
            // Two images with the same line points to the last bit are one image.
            let first = cycle.line_points.first();
            let reading = first.map_or([0; 6], |point| {
                let last = cycle.line_points.last().map_or(point.at, |last| last.at);
                let count = cycle.line_points.len() as u32;
                let unlike = if count < 2 { cycle.stamp.0 as u32 } else { 0 };
                [
                    bits(point.at.x),
                    bits(point.at.y),
                    bits(last.x),
                    bits(last.y),
                    count,
                    unlike,
                ]
            });
            // Without points nothing tells one image from the next.
            let reading = if first.is_none() {
                [cycle.stamp.0 as u32; 6]
            } else {
                reading
            };
            camera.record(cycle.stamp, reading);
        }
        for one in &cycle.inputs.odometry {
            // Wheels at rest repeat themselves rightly.
            let rests = one.dx == 0.0 && one.dy == 0.0 && one.dtheta == 0.0;
            let unlike = if rests { one.stamp.0 as u32 } else { 0 };
            let reading = [bits(one.dx), bits(one.dy), bits(one.dtheta), unlike, 0, 0];
            wheels.record(one.stamp, reading);
        }
        for one in &cycle.inputs.compass {
            compass.record(one.stamp, [bits(one.heading), 0, 0, 0, 0, 0]);
        }
        for one in &cycle.inputs.imu {
            let [ax, ay, az] = one.acceleration.map(bits);
            let [rx, ry, rz] = one.rate.map(bits);
            imu.record(one.stamp, [ax, ay, az, rx, ry, rz]);
        }
    }
}
