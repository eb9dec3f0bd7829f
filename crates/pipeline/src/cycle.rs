//! What is known after one image? Its inputs, what each stage found and refused, and how long the stages took.

use std::sync::Arc;

use localize::Stamp;
use localize::estimate::Estimate;
use localize::map_correction::MapFit;
use localize::robot::ExposureSetting;
use localize::sample::{Compass, Imu, LinePoint, Odometry, VelocityCommand};
use localize::team::{TeamReport, TeamView};
use localize::world::WorldView;
use nalgebra::Matrix3;
use vision::exposure::{ExposureCommand, ExposureStatus};
use vision::process::Detections;

use crate::sample::{GroundTruth, Sample, SourceImage};
use crate::warm_start::WarmStart;

/// One run of the pipeline: inputs, the result of each stage, refusals with reasons, durations.
#[derive(Debug, Clone)]
pub struct Cycle {
    /// Exposure time of the image.
    pub stamp: Stamp,
    /// What arrived since the previous cycle.
    pub inputs: Inputs,
    /// What vision found in the image. None if line points came in its place, or if it was unreadable.
    pub detections: Option<Detections>,
    /// The line points that localization used.
    pub line_points: Vec<LinePoint>,
    /// The robot's pose, its covariance and the mode.
    pub estimate: Estimate,
    /// Tracked ball and robots.
    pub world: WorldView,
    /// Reports of team-mates, and the ball fused from them.
    pub team: TeamView,
    /// Exposure of the image and the next camera setting. None if the image was not evaluated.
    pub exposure: Option<ExposureStatus>,
    /// Why the image could not be used.
    pub image_fault: Option<String>,
    /// Durations of the stages.
    pub timings: Timings,
}

/// What arrived between two cycles, the image included. Lists are in the order of arrival.
#[derive(Debug, Clone, Default)]
pub struct Inputs {
    /// Wheel motion.
    pub odometry: Vec<Odometry>,
    /// Compass headings.
    pub compass: Vec<Compass>,
    /// Inertial readings.
    pub imu: Vec<Imu>,
    /// Velocity commands sent to the motors.
    pub commands: Vec<VelocityCommand>,
    /// Messages of team-mates.
    pub reports: Vec<TeamReport>,
    /// The latest ground truth. No stage reads it.
    pub truth: Option<GroundTruth>,
    /// The image, if there is one.
    pub image: Option<SourceImage>,
    /// Exposure and gain with which the image was taken, if the camera reports them.
    pub exposure_setting: Option<ExposureSetting>,
    /// All settings (TOML), if they were changed during the run and hold from this cycle on.
    pub changed_config_toml: Option<Arc<str>>,
    /// The state from which a new pipeline went on at this cycle. Replay can start here.
    pub warm_start: Option<WarmStart>,
    /// What a check of the set-up found during the run, if that changes: covariance of (x, y, θ) that is added to each pose
    /// from this cycle on. Zero: the set-up is no longer doubtful.
    pub setup_doubt: Option<Matrix3<f32>>,
    /// Errors of the ground map that the images of the run told a check, and that are in use from this cycle on.
    pub map_fit: Option<Box<MapFit>>,
}

/// Durations of the stages: the only part of a cycle that differs from run to run.
#[derive(Debug, Clone, Copy, Default)]
pub struct Timings {
    /// Image to features, milliseconds.
    pub see_ms: f32,
    /// Features and motion to a pose, milliseconds.
    pub localize_ms: f32,
}

impl Cycle {
    /// Inputs before anything is computed from them; `covariance`: of a uniform distribution over the field.
    pub fn from_inputs(stamp: Stamp, inputs: Inputs, covariance: Matrix3<f32>) -> Self {
        Cycle {
            stamp,
            inputs,
            detections: None,
            line_points: Vec::new(),
            estimate: Estimate::lost(stamp, covariance),
            world: WorldView::default(),
            team: TeamView::default(),
            exposure: None,
            image_fault: None,
            timings: Timings::default(),
        }
    }

    /// The next camera setting, if it should change.
    pub fn camera_command(&self) -> Option<ExposureCommand> {
        self.exposure?.command
    }
}

impl Inputs {
    /// All samples but the image, ordered by stamp. At equal stamps: command, IMU, odometry, compass, team report, truth.
    ///
    /// A cycle is a function of its inputs alone, so the order in which threads delivered them must not matter.
    pub fn sorted_samples(&self) -> Vec<Sample> {
        let odometry = self
            .odometry
            .iter()
            .map(|odometry| (odometry.stamp, Sample::Odometry(*odometry)));
        let compass = self
            .compass
            .iter()
            .map(|compass| (compass.stamp, Sample::Compass(*compass)));
        let imu = self.imu.iter().map(|imu| (imu.stamp, Sample::Imu(*imu)));
        let commands = self
            .commands
            .iter()
            .map(|command| (command.stamp, Sample::Command(*command)));
        let reports = self
            .reports
            .iter()
            .map(|report| (report.stamp, Sample::TeamReport(report.clone())));
        let truth = self
            .truth
            .iter()
            .map(|truth| (truth.stamp, Sample::GroundTruth(truth.clone())));
        let mut samples: Vec<(Stamp, Sample)> = commands
            .chain(imu)
            .chain(odometry)
            .chain(compass)
            .chain(reports)
            .chain(truth)
            .collect();
        samples.sort_by_key(|(stamp, _)| *stamp);
        samples.into_iter().map(|(_, sample)| sample).collect()
    }
}
