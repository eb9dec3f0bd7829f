//! How far is an estimator from the truth, and does it know? Sums over the frames of all seeds.

use localize::config::LocalizeConfig;
use localize::estimate::{Estimate, Mode};
use localize::frames::Pose;
use localize::{Field, Localizer, Stamp, Tf};

use super::recording::{PointObservation, RADIUS_SCALE, RecordedDrive, SensorInput};
use super::{Course, Estimator, FusionScore};

/// Scored from here on: the first search and the first second of learning are not fusion.
const SCORING_START: f64 = 2.0;
/// The odometry's scale is judged from here on, seconds.
const SCALE_SCORING_START: f64 = 60.0;
/// 2.5 and 97.5 % of χ² with three degrees of freedom.
const CHI_SQUARED_BAND: [f32; 2] = [0.216, 9.348];

/// Sums of one estimator on one course.
#[derive(Debug, Clone, Default)]
pub(super) struct ScoreSums {
    count: usize,
    position: f64,
    position_max: f32,
    heading: f64,
    along_track_error: f64,
    moving: usize,
    nees: f64,
    nees_in_band: usize,
    nees_count: usize,
    relocated: usize,
    vision_loss_errors: Vec<f32>,
    post_push_errors: Vec<f32>,
    odometry_scale_error: Option<f32>,
    latency: f32,
}

impl ScoreSums {
    fn add_pose(&mut self, frame: &PointObservation, pose: Pose) {
        if frame.stamp.seconds() < SCORING_START {
            return;
        }
        let off = pose.difference(frame.truth);
        let distance = off[0].hypot(off[1]);
        if frame.vision_loss_end {
            self.vision_loss_errors.push(distance);
        }
        if frame.vision_lost {
            return;
        }
        self.count += 1;
        self.position += f64::from(distance);
        self.position_max = self.position_max.max(distance);
        self.heading += f64::from(off[2].abs().to_degrees());
        let [vx, vy] = frame.velocity;
        let speed = vx.hypot(vy);
        if speed > 0.5 {
            self.along_track_error += f64::from((off[0] * vx + off[1] * vy) / speed);
            self.moving += 1;
        }
    }

    fn add_nees(&mut self, frame: &PointObservation, estimate: &Estimate) {
        let (Some(pose), false) = (estimate.pose, frame.vision_lost) else {
            return;
        };
        let off = pose.difference(frame.truth);
        let Some(inverse) = estimate.covariance.try_inverse() else {
            return;
        };
        let squared = off.dot(&(inverse * off));
        self.nees += f64::from(squared);
        self.nees_in_band +=
            usize::from((CHI_SQUARED_BAND[0]..=CHI_SQUARED_BAND[1]).contains(&squared));
        self.nees_count += 1;
    }

    pub(super) fn score(&self, course: Course, estimator: Estimator) -> FusionScore {
        let mean = |sum: f64, count: usize| (sum / count.max(1) as f64) as f32;
        let average =
            |all: &[f32]| (!all.is_empty()).then(|| all.iter().sum::<f32>() / all.len() as f32);
        FusionScore {
            course,
            estimator,
            frames: self.count,
            position: mean(self.position, self.count),
            position_max: self.position_max,
            heading_deg: mean(self.heading, self.count),
            blind: average(&self.vision_loss_errors),
            blind_max: self.vision_loss_errors.iter().copied().reduce(f32::max),
            after_hit: average(&self.post_push_errors),
            along: mean(self.along_track_error, self.moving),
            nees: mean(self.nees, self.nees_count),
            nees_inside: self.nees_in_band as f32 / self.nees_count.max(1) as f32,
            searched: self.relocated,
            scale_off: self.odometry_scale_error,
            latency: self.latency,
        }
    }
}

/// Lets a localizer follow the drive with the samples that this estimator has.
pub(super) fn run_localizer(
    estimator: Estimator,
    config: LocalizeConfig,
    drive: &RecordedDrive,
    field: &Field,
    frames: &mut ScoreSums,
) {
    let mut localizer = Localizer::new(field, config);
    let wheels = !matches!(estimator, Estimator::Vision | Estimator::NoOdometry);
    let inertial = !matches!(estimator, Estimator::Vision | Estimator::NoImu);
    let mut last = None;
    let mut hits = PushErrors::new(&drive.push_stamps);
    for one in &drive.inputs {
        match one {
            SensorInput::Odometry(one) if wheels => localizer.add_odometry(one),
            SensorInput::Imu(one) if inertial => localizer.add_imu(one),
            SensorInput::Command(one) if inertial || wheels => localizer.add_command(one),
            SensorInput::Compass(one) => localizer.add_compass(one),
            SensorInput::Points(frame) => {
                let estimate = localizer.process_points(frame.stamp, &frame.points);
                let begun = frame.stamp.seconds() >= SCORING_START;
                // Alone, every frame is found by a search.
                let searched = estimate.mode != Mode::Tracking && estimator != Estimator::Vision;
                frames.relocated += usize::from(begun && searched);
                last = estimate.pose.or(last);
                if let Some(pose) = last {
                    frames.add_pose(frame, pose);
                    hits.add_pose(frame, pose);
                }
                if begun {
                    frames.add_nees(frame, &estimate);
                }
                if frame.stamp.seconds() > SCALE_SCORING_START && estimate.pose.is_some() && wheels
                {
                    let off = (estimate.odometry_scales[0] - RADIUS_SCALE).abs();
                    frames.odometry_scale_error =
                        Some(frames.odometry_scale_error.unwrap_or(0.0).max(off));
                }
                frames.latency = estimate.latency;
            }
            _ => {}
        }
    }
    hits.finish(frames);
}

/// Adds the wheels' motions up from the true start.
pub(super) fn run_dead_reckoning(drive: &RecordedDrive, frames: &mut ScoreSums) {
    let mut pose = drive.start;
    let mut hits = PushErrors::new(&drive.push_stamps);
    for one in &drive.inputs {
        match one {
            SensorInput::Odometry(one) => pose = pose * Tf::new(one.dx, one.dy, one.dtheta),
            SensorInput::Points(frame) => {
                frames.add_pose(frame, pose);
                hits.add_pose(frame, pose);
            }
            _ => {}
        }
    }
    hits.finish(frames);
}

/// The largest error in the second after each hit.
struct PushErrors<'a> {
    stamps: &'a [Stamp],
    largest: Vec<f32>,
}

impl<'a> PushErrors<'a> {
    fn new(stamps: &'a [Stamp]) -> Self {
        PushErrors {
            stamps,
            largest: vec![0.0; stamps.len()],
        }
    }

    fn add_pose(&mut self, frame: &PointObservation, pose: Pose) {
        if frame.vision_lost {
            return;
        }
        let off = pose.difference(frame.truth);
        for (stamp, largest) in self.stamps.iter().zip(&mut self.largest) {
            if (0.0..1.0).contains(&stamp.seconds_until(frame.stamp)) {
                *largest = largest.max(off[0].hypot(off[1]));
            }
        }
    }

    fn finish(self, frames: &mut ScoreSums) {
        frames.post_push_errors.extend(self.largest);
    }
}
