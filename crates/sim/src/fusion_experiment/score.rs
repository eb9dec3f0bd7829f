//! How large are the errors of an estimator, and are they consistent with its covariance? Sums over all seeds.

use localize::config::LocalizeConfig;
use localize::estimate::{Estimate, Mode};
use localize::frames::Pose;
use localize::{Field, Localizer, Stamp, Tf};
use nalgebra::{Vector2, Vector3};
use serde::Serialize;

use super::disturbance::{Disturbance, Estimator};
use super::recording::{PointObservation, RADIUS_SCALE, RecordedDrive, SensorInput};

/// Start of scoring, seconds: excludes the first search and the initial adaptation.
const SCORING_START: f64 = 2.0;
/// Start of scoring the odometry scale, seconds.
const SCALE_SCORING_START: f64 = 60.0;
/// 2.5 and 97.5 % of χ² with three degrees of freedom.
const CHI_SQUARED_BAND: [f32; 2] = [0.216, 9.348];

/// One row of the table: metres and degrees, over all seeds.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FusionScore {
    /// Disturbances of the drive.
    #[serde(rename = "course")]
    pub disturbance: Disturbance,
    /// The estimator.
    pub estimator: Estimator,
    /// Scored images with line points (from two seconds after the start).
    pub frames: usize,
    /// Mean position error in them.
    pub position: f32,
    /// Largest position error.
    pub position_max: f32,
    /// Mean absolute heading error.
    pub heading_deg: f32,
    /// Mean position error at the end of a vision loss of two seconds; `None` without one.
    pub blind: Option<f32>,
    /// Largest position error there.
    pub blind_max: Option<f32>,
    /// Largest position error in the second after a push, with line points; mean over the pushes.
    pub after_hit: Option<f32>,
    /// Mean error along the velocity, with line points; latency causes it.
    pub along: f32,
    /// Mean normalised estimation error squared over all images, those without line points included; 3 is consistent.
    pub nees: f32,
    /// The same over the images without line points; 3 is consistent. `None` if there are none.
    pub nees_blind: Option<f32>,
    /// There, the squared errors along the velocity, across it and of the heading, each over its own variance; 1 is
    /// consistent.
    pub nees_blind_by_direction: Option<[f32; 3]>,
    /// Share of all images inside the 95 % band of χ² with three degrees of freedom.
    pub nees_inside: f32,
    /// Images without a pose, or with one from a global search.
    pub searched: usize,
    /// Largest error of the estimated odometry scale, from 60 s on.
    pub scale_off: Option<f32>,
    /// Estimated latency at the end, seconds.
    pub latency: f32,
}

/// Sums of one estimator on one disturbance.
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
    nees_blind: f64,
    nees_blind_by_direction: [f64; 3],
    nees_blind_count: usize,
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
        let error = pose.difference(frame.truth);
        let distance = error[0].hypot(error[1]);
        if frame.vision_loss_end {
            self.vision_loss_errors.push(distance);
        }
        if frame.vision_lost {
            return;
        }
        self.count += 1;
        self.position += f64::from(distance);
        self.position_max = self.position_max.max(distance);
        self.heading += f64::from(error[2].abs().to_degrees());
        let [vx, vy] = frame.velocity;
        let speed = vx.hypot(vy);
        if speed > 0.5 {
            self.along_track_error += f64::from((error[0] * vx + error[1] * vy) / speed);
            self.moving += 1;
        }
    }

    fn add_nees(&mut self, frame: &PointObservation, estimate: &Estimate) {
        let Some(pose) = estimate.pose else {
            return;
        };
        let error = pose.difference(frame.truth);
        let Some(inverse) = estimate.covariance.try_inverse() else {
            return;
        };
        let squared = error.dot(&(inverse * error));
        self.nees += f64::from(squared);
        self.nees_in_band +=
            usize::from((CHI_SQUARED_BAND[0]..=CHI_SQUARED_BAND[1]).contains(&squared));
        self.nees_count += 1;
        if frame.vision_lost {
            self.nees_blind += f64::from(squared);
            self.nees_blind_count += 1;
            // A robot at rest has no direction: its x and y stand for it.
            let [vx, vy] = frame.velocity;
            let along = Vector2::new(vx, vy)
                .try_normalize(0.01)
                .unwrap_or_else(Vector2::x);
            let directions = [
                Vector3::new(along.x, along.y, 0.0),
                Vector3::new(-along.y, along.x, 0.0),
                Vector3::z(),
            ];
            for (sum, direction) in self.nees_blind_by_direction.iter_mut().zip(directions) {
                let variance = direction.dot(&(estimate.covariance * direction));
                *sum += f64::from(direction.dot(&error).powi(2) / variance);
            }
        }
    }

    pub(super) fn score(&self, disturbance: Disturbance, estimator: Estimator) -> FusionScore {
        let mean = |sum: f64, count: usize| (sum / count.max(1) as f64) as f32;
        let average =
            |all: &[f32]| (!all.is_empty()).then(|| all.iter().sum::<f32>() / all.len() as f32);
        let blind = self.nees_blind_count > 0;
        FusionScore {
            disturbance,
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
            nees_blind: blind.then(|| mean(self.nees_blind, self.nees_blind_count)),
            nees_blind_by_direction: blind.then(|| {
                self.nees_blind_by_direction
                    .map(|sum| mean(sum, self.nees_blind_count))
            }),
            nees_inside: self.nees_in_band as f32 / self.nees_count.max(1) as f32,
            searched: self.relocated,
            scale_off: self.odometry_scale_error,
            latency: self.latency,
        }
    }
}

/// Runs a localizer over the drive with the sensors of this estimator and adds its errors to `sums`.
pub(super) fn run_localizer(
    estimator: Estimator,
    config: LocalizeConfig,
    drive: &RecordedDrive,
    field: &Field,
    sums: &mut ScoreSums,
) {
    let mut localizer = Localizer::new(field, config);
    if let Some(wheels) = &drive.wheels {
        localizer.set_wheels(wheels, None);
    }
    let wheels = !matches!(estimator, Estimator::Vision | Estimator::NoOdometry);
    let inertial = !matches!(estimator, Estimator::Vision | Estimator::NoImu);
    let mut last = None;
    let mut pushes = PushErrors::new(&drive.push_stamps);
    for input in &drive.inputs {
        match input {
            SensorInput::Odometry(odometry) if wheels => localizer.add_odometry(odometry),
            SensorInput::Imu(imu) if inertial => localizer.add_imu(imu),
            SensorInput::Command(command) if inertial || wheels => localizer.add_command(command),
            SensorInput::Compass(compass) => localizer.add_compass(compass),
            SensorInput::Points(frame) => {
                let estimate = localizer.process_points(frame.stamp, &frame.points);
                let scored = frame.stamp.seconds() >= SCORING_START;
                // Without other sensors every image needs a search.
                let searched = estimate.mode != Mode::Tracking && estimator != Estimator::Vision;
                sums.relocated += usize::from(scored && searched);
                last = estimate.pose.or(last);
                if let Some(pose) = last {
                    sums.add_pose(frame, pose);
                    pushes.add_pose(frame, pose);
                }
                if scored {
                    sums.add_nees(frame, &estimate);
                }
                if frame.stamp.seconds() > SCALE_SCORING_START && estimate.pose.is_some() && wheels
                {
                    let error = (estimate.odometry_scales[0] - RADIUS_SCALE).abs();
                    sums.odometry_scale_error =
                        Some(sums.odometry_scale_error.unwrap_or(0.0).max(error));
                }
                sums.latency = estimate.latency;
            }
            _ => {}
        }
    }
    pushes.finish(sums);
}

/// Integrates the odometry from the true start and adds its errors to `sums`.
pub(super) fn run_dead_reckoning(drive: &RecordedDrive, sums: &mut ScoreSums) {
    let mut pose = drive.start;
    let mut pushes = PushErrors::new(&drive.push_stamps);
    for input in &drive.inputs {
        match input {
            SensorInput::Odometry(odometry) => {
                pose = pose * Tf::new(odometry.dx, odometry.dy, odometry.dtheta)
            }
            SensorInput::Points(frame) => {
                sums.add_pose(frame, pose);
                pushes.add_pose(frame, pose);
            }
            _ => {}
        }
    }
    pushes.finish(sums);
}

/// The largest position error in the second after each push.
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
        let error = pose.difference(frame.truth);
        for (stamp, largest) in self.stamps.iter().zip(&mut self.largest) {
            if (0.0..1.0).contains(&stamp.seconds_until(frame.stamp)) {
                *largest = largest.max(error[0].hypot(error[1]));
            }
        }
    }

    fn finish(self, sums: &mut ScoreSums) {
        sums.post_push_errors.extend(self.largest);
    }
}
