//! Metrics of every cycle of a run of any length, for plots and the timeline.

use localize::estimate::Mode;
use localize::frames::wrap_angle;
use localize::robot::BaseConfig;
use vision::image::Image;

use super::source::decoded_cycle::rgb_image;
use pipeline::Cycle;

/// Capacity. When it is reached, every other sample is dropped and the stride of new samples doubles.
const MAX_SAMPLES: usize = 120_000;
/// One pixel in this many is used for the image's brightness and entropy.
const PIXEL_STRIDE: usize = 23;

/// Metrics of one cycle; NaN if not available.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct CycleMetrics {
    /// Stamp, seconds.
    pub(crate) time: f64,
    /// Mode of the estimate.
    pub(crate) mode: Mode,
    /// Estimated x, y (m) and heading (rad), field frame.
    pub(crate) pose: [f32; 3],
    /// True x, y (m) and heading (rad), field frame.
    pub(crate) truth: [f32; 3],
    /// Values by [`Quantity`].
    pub(crate) values: [f32; QUANTITY_COUNT],
    /// Numbers of images, odometry, compass and IMU samples in the cycle.
    pub(crate) sample_counts: [u16; 4],
    /// The image could not be used.
    pub(crate) fault: bool,
}

/// Quantities that can be plotted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(usize)]
pub(crate) enum Quantity {
    PositionError,
    HeadingError,
    StdX,
    StdY,
    StdHeading,
    Residual,
    InlierShare,
    LinePoints,
    RejectedCandidates,
    Entropy,
    Brightness,
    ExposureTime,
    Gain,
    VisionTime,
    LocalizationTime,
    Dropped,
    Wheel0,
    Wheel1,
    Wheel2,
    Wheel3,
    AccelerationX,
    AccelerationY,
    YawRate,
    PoseX,
    PoseY,
    PoseHeading,
    Speed,
    TurnRate,
    OnMarkings,
    MarkingsSeen,
    Latency,
    GyroBias,
    MapDisplacement,
    BallDistance,
    RobotCount,
    CompassHeading,
    CyclePeriod,
}

/// Number of quantities.
pub(crate) const QUANTITY_COUNT: usize = Quantity::CyclePeriod as usize + 1;

/// Samples in time order.
#[derive(Debug, Clone, Default)]
pub(crate) struct TimeSeries {
    samples: Vec<CycleMetrics>,
    stride: usize,
    skipped: usize,
    last_time: Option<f64>,
    /// Sum and number of the position errors of all cycles, metres.
    errors: (f64, u64),
}

impl TimeSeries {
    /// All stored samples.
    pub(crate) fn samples(&self) -> &[CycleMetrics] {
        &self.samples
    }

    /// Cycles per stored sample.
    pub(crate) fn stride(&self) -> usize {
        self.stride.max(1)
    }

    /// The samples of an interval, with one more on each side if there is one.
    pub(crate) fn between(&self, from: f64, to: f64) -> &[CycleMetrics] {
        let start = self.samples.partition_point(|sample| sample.time < from);
        let end = self.samples.partition_point(|sample| sample.time <= to);
        &self.samples[start.saturating_sub(1)..(end + 1).min(self.samples.len())]
    }

    /// The last sample at or before a time.
    pub(crate) fn at(&self, time: f64) -> Option<&CycleMetrics> {
        let later = self.samples.partition_point(|sample| sample.time <= time);
        self.samples.get(later.checked_sub(1)?)
    }

    /// The first sample after a time.
    pub(crate) fn after(&self, time: f64) -> Option<&CycleMetrics> {
        let later = self.samples.partition_point(|sample| sample.time <= time);
        self.samples.get(later)
    }

    /// Adds a sample; a time from the past restarts the series.
    pub(crate) fn push(&mut self, mut sample: CycleMetrics) {
        if self.last_time.is_some_and(|last| sample.time < last) {
            *self = TimeSeries::default();
        }
        if let Some(last) = self.last_time {
            sample.values[Quantity::CyclePeriod as usize] = ((sample.time - last) * 1e3) as f32;
        }
        self.last_time = Some(sample.time);
        let error = sample.value(Quantity::PositionError);
        if error.is_finite() {
            self.errors.0 += f64::from(error);
            self.errors.1 += 1;
        }
        self.skipped += 1;
        if self.skipped < self.stride {
            return;
        }
        self.skipped = 0;
        self.samples.push(sample);
        if self.samples.len() >= MAX_SAMPLES {
            let mut index = 0;
            self.samples.retain(|_| {
                index += 1;
                index % 2 == 1
            });
            self.stride = 2 * self.stride.max(1);
        }
    }

    /// Moves all samples in time, seconds.
    pub(crate) fn shift(&mut self, seconds: f64) {
        for sample in &mut self.samples {
            sample.time += seconds;
        }
        self.last_time = self.last_time.map(|last| last + seconds);
    }

    /// Sample rates of camera, wheels, compass and IMU over the last `seconds` before `time`, Hz.
    pub(crate) fn rates_hz(&self, time: f64, seconds: f64) -> [f64; 4] {
        let end = self.samples.partition_point(|sample| sample.time <= time);
        let start = self.samples.partition_point(|s| s.time <= time - seconds);
        let recent = &self.samples[start..end];
        let (Some(first), Some(last)) = (recent.first(), recent.last()) else {
            return [0.0; 4];
        };
        // The first cycle's samples arrived before the interval begins.
        let span = last.time - first.time;
        let share = self.stride.max(1) as f64 / span;
        [0, 1, 2, 3].map(|device| {
            let arrived = recent[1..]
                .iter()
                .map(|s| f64::from(s.sample_counts[device]));
            if span > 0.0 {
                arrived.sum::<f64>() * share
            } else {
                0.0
            }
        })
    }

    /// Mean position error over all cycles with ground truth, metres.
    pub(crate) fn mean_error(&self) -> Option<f32> {
        let (sum, count) = self.errors;
        (count > 0).then(|| (sum / count as f64) as f32)
    }
}

impl CycleMetrics {
    /// The value of a quantity; NaN if not available.
    pub(crate) fn value(&self, quantity: Quantity) -> f32 {
        self.values[quantity as usize]
    }

    /// Computes the metrics of a cycle; `dropped` cycles were lost before it.
    pub(crate) fn from_cycle(cycle: &Cycle, base: &BaseConfig, dropped: u64) -> Self {
        let mut values = [f32::NAN; QUANTITY_COUNT];
        let mut set = |quantity: Quantity, value: f32| values[quantity as usize] = value;
        let estimate = &cycle.estimate;
        let truth = cycle.inputs.truth.as_ref();
        if let Some(pose) = estimate.pose {
            let std = |axis: usize| estimate.covariance[(axis, axis)].max(0.0).sqrt();
            set(Quantity::StdX, std(0));
            set(Quantity::StdY, std(1));
            set(Quantity::StdHeading, std(2).to_degrees());
            set(Quantity::Residual, estimate.inlier_rms);
            set(Quantity::InlierShare, estimate.inlier_share);
            set(Quantity::PoseX, pose.x);
            set(Quantity::PoseY, pose.y);
            set(Quantity::PoseHeading, pose.theta.to_degrees());
            set(Quantity::OnMarkings, estimate.fit.on_markings);
            set(Quantity::MarkingsSeen, estimate.fit.markings_seen);
            if let Some(truth) = truth {
                set(
                    Quantity::PositionError,
                    pose.origin().distance_to(truth.pose.origin()),
                );
                let heading_error = wrap_angle(pose.theta - truth.pose.theta);
                set(Quantity::HeadingError, heading_error.to_degrees());
            }
        }
        if let Some(twist) = estimate.twist {
            set(Quantity::Speed, twist.x.hypot(twist.y));
            set(Quantity::TurnRate, twist.theta.to_degrees());
        }
        set(Quantity::Latency, estimate.latency * 1e3);
        set(Quantity::GyroBias, estimate.gyro_bias.to_degrees());
        if let Some(map) = &estimate.map_correction {
            set(Quantity::MapDisplacement, map.displacement_at_3_m);
        }
        if let Some(compass) = cycle.inputs.compass.last() {
            set(Quantity::CompassHeading, compass.heading.to_degrees());
        }
        set(Quantity::LinePoints, cycle.line_points.len() as f32);
        if let Some(detections) = &cycle.detections {
            set(Quantity::RobotCount, detections.robots.len() as f32);
            if let Some(ball) = &detections.ball {
                set(Quantity::BallDistance, ball.at.distance());
            }
            set(
                Quantity::RejectedCandidates,
                detections.rejected_candidates.len() as f32,
            );
        }
        if let Some(image) = rgb_image(cycle) {
            let (entropy, brightness) = image_statistics(image);
            set(Quantity::Entropy, entropy);
            set(Quantity::Brightness, brightness);
        }
        if let Some(reading) = &cycle.exposure {
            set(Quantity::Entropy, reading.entropy);
            set(Quantity::Brightness, reading.centre_brightness);
            if let Some(setting) = reading.applied_setting {
                set(Quantity::ExposureTime, setting.exposure);
                set(Quantity::Gain, setting.gain);
            }
        }
        set(Quantity::VisionTime, cycle.timings.see_ms);
        set(Quantity::LocalizationTime, cycle.timings.localize_ms);
        set(Quantity::Dropped, dropped as f32);
        for (wheel, speed) in wheel_rim_speeds(cycle, base)
            .into_iter()
            .enumerate()
            .take(4)
        {
            values[Quantity::Wheel0 as usize + wheel] = speed;
        }
        if let Some(imu) = cycle.inputs.imu.last() {
            values[Quantity::AccelerationX as usize] = imu.specific_force[0];
            values[Quantity::AccelerationY as usize] = imu.specific_force[1];
            values[Quantity::YawRate as usize] = imu.angular_velocity[2].to_degrees();
        }
        let coordinates = |pose: localize::Pose| [pose.x, pose.y, pose.theta];
        CycleMetrics {
            time: cycle.stamp.seconds(),
            mode: estimate.mode,
            pose: estimate.pose.map_or([f32::NAN; 3], coordinates),
            truth: truth.map_or([f32::NAN; 3], |truth| coordinates(truth.pose)),
            values,
            sample_counts: [
                usize::from(cycle.image_fault.is_none()),
                cycle.inputs.odometry.len(),
                cycle.inputs.compass.len(),
                cycle.inputs.imu.len(),
            ]
            .map(|count| count.min(usize::from(u16::MAX)) as u16),
            fault: cycle.image_fault.is_some(),
        }
    }
}

/// Rim speed of each wheel from the cycle's odometry, m/s.
fn wheel_rim_speeds(cycle: &Cycle, base: &BaseConfig) -> Vec<f32> {
    let odometry = &cycle.inputs.odometry;
    let (Some(first), Some(last)) = (odometry.first(), odometry.last()) else {
        return Vec::new();
    };
    // The first increment's interval is unknown and assumed equal to the mean of the others.
    let span = match odometry.len() {
        1 => 1.0 / f64::from(base.rate_hz),
        count => (last.stamp - first.stamp) * count as f64 / (count - 1) as f64,
    };
    if !(span > 0.0) {
        return Vec::new();
    }
    let sum = |part: fn(&localize::sample::Odometry) -> f32| {
        odometry.iter().map(part).sum::<f32>() / span as f32
    };
    let (vx, vy, omega) = (sum(|o| o.dx), sum(|o| o.dy), sum(|o| o.dtheta));
    let speed = |angle: &f32| {
        let (sin, cos) = angle.to_radians().sin_cos();
        -sin * vx + cos * vy + base.wheel_distance * omega
    };
    base.wheel_angles_deg.iter().map(speed).collect()
}

/// Entropy of the image's brightness (bits, as in nubot2013) and mean brightness (0 to 255).
fn image_statistics(image: &Image) -> (f32, f32) {
    let mut counts = [0u32; 256];
    let (mut sum, mut total) = (0.0, 0u32);
    for rgb in image.rgb.chunks_exact(3).step_by(PIXEL_STRIDE) {
        let grey = (u32::from(rgb[0]) + 2 * u32::from(rgb[1]) + u32::from(rgb[2])) / 4;
        counts[grey as usize & 255] += 1;
        sum += grey as f32;
        total += 1;
    }
    let share = |count: &u32| *count as f32 / total.max(1) as f32;
    let entropy = counts.iter().filter(|&&count| count > 0).map(share);
    (
        entropy.map(|share| -share * share.log2()).sum(),
        sum / total.max(1) as f32,
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(time: f64) -> CycleMetrics {
        CycleMetrics {
            time,
            mode: Mode::Lost,
            pose: [f32::NAN; 3],
            truth: [f32::NAN; 3],
            values: [0.0; QUANTITY_COUNT],
            sample_counts: [1; 4],
            fault: false,
        }
    }

    #[test]
    fn series_memory_is_bounded_and_keeps_the_time_range() {
        let mut series = TimeSeries::default();
        for step in 0..400_000 {
            series.push(sample(f64::from(step)));
        }
        assert!(series.samples().len() < MAX_SAMPLES);
        let last = series.samples().last().expect("samples").time;
        assert!(
            last > 399_990.0 && series.samples()[0].time == 0.0,
            "{last}"
        );
    }

    #[test]
    fn range_includes_one_sample_beyond_each_end() {
        let mut series = TimeSeries::default();
        for step in 0..10 {
            series.push(sample(f64::from(step)));
        }
        let times: Vec<f64> = series.between(3.5, 5.5).iter().map(|s| s.time).collect();
        assert_eq!(times, [3.0, 4.0, 5.0, 6.0]);
        assert_eq!(series.at(3.5).map(|s| s.time), Some(3.0));
        assert_eq!(series.at(-1.0), None);
    }
}
