//! Result of the localization for one image: pose, covariance, mode and alternatives.

use nalgebra::Matrix3;

use crate::advice::Advice;
use crate::frames::Pose;
use crate::global_search::branch_and_bound::{Certificate, Hypothesis};
use crate::map_correction::MapCorrectionEstimate;
use crate::omni::{Twist, UNCORRECTED_MOTION};
use crate::stamp::Stamp;

/// How an image's pose was found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mode {
    /// Tracked from the previous image by odometry and matching.
    Tracking,
    /// Found on the whole field in this image, or tracked while the field half is unknown.
    Global,
    /// Unknown.
    Lost,
}

/// Why an image's pose is not simply tracked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reason {
    /// Too few line points: the pose is predicted by odometry alone.
    FewPoints,
    /// The points fit the markings worse than usual, but no other pose fits better.
    PoorMatch,
    /// Another pose explains the points better.
    BetterAlternative,
    /// The compass contradicted the pose, which was turned to the other field half.
    CompassConflict,
    /// Odometry alone until the pose was too uncertain.
    DeadReckoningTimeout,
    /// The global search needs further images.
    Searching,
    /// No pose on the whole field explains the points.
    NoMatch,
    /// Several poses explain the points, see `runners_up`.
    Ambiguous,
    /// Another mounting of camera and mirror explains the points better: the map's correction begins anew.
    CameraKnocked,
    /// The image is older than the filter and was not used.
    OutOfOrder,
    /// The set-up (field, camera mount, units) contradicts the measurements, see `fit`.
    DoubtfulSetup,
}

/// How well the set-up fits the measurements of the last seconds (docs/methods.md 16.3).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Fit {
    /// Share of the line points on markings.
    pub on_markings: f32,
    /// Root mean square distance of these points from the markings, metres.
    pub inlier_rms: f32,
    /// Share of the markings in sight at which a line point was seen.
    pub markings_seen: f32,
    /// Agreement of the wheels with the poses: 1 if equal, 0 if unrelated, −1 if opposite. None before enough motion.
    pub wheel_agreement: Option<f32>,
    /// Mean cosine of the compass's deviation from the heading. None before enough readings.
    pub compass_agreement: Option<f32>,
}

/// Localization result of one image.
#[derive(Debug, Clone, PartialEq)]
pub struct Estimate {
    /// The image's stamp.
    pub stamp: Stamp,
    /// The pose. None when lost.
    pub pose: Option<Pose>,
    /// Of (x, y, θ), metres and radians, including the spread of possible alternatives, but not the half turn. When lost,
    /// that of a uniform distribution over the field.
    pub covariance: Matrix3<f32>,
    /// Share of it by errors that no number of images averages away: of map, camera mount and measured field. They are
    /// constant in the robot's frame while it sees the same markings.
    pub repeated_covariance: Matrix3<f32>,
    /// How the pose was found.
    pub mode: Mode,
    /// Why it is not simply tracked.
    pub reason: Option<Reason>,
    /// Root mean square distance of the inliers from the markings, metres.
    pub inlier_rms: f32,
    /// Share of the points on markings.
    pub inlier_share: f32,
    /// Line points used.
    pub line_points: usize,
    /// Tilt (a, b) of the robot in this image, radians (docs/methods.md 3.1).
    pub tilt: [f32; 2],
    /// Is the field half known (from compass, goals, a given pose, or an asymmetric field)?
    pub half_known: bool,
    /// Estimated true over measured motion of the wheels: translation, rotation.
    pub odometry_scales: [f32; 2],
    /// Estimated matrix from the measured motion (x, y, θ) of the wheels to the true one: 1, m/rad, rad/m.
    pub odometry_correction: [[f32; 3]; 3],
    /// Estimated velocity, robot frame. None when lost.
    pub twist: Option<Twist>,
    /// Are wheel samples skipped because of a collision or of slip?
    pub collision: bool,
    /// Estimated gyro bias about z, rad/s.
    pub gyro_bias: f32,
    /// Estimated time from the image's exposure to its stamp, seconds.
    pub latency: f32,
    /// How well the set-up fits.
    pub fit: Fit,
    /// What is known about the ground map's errors. None if the correction is switched off.
    pub map_correction: Option<MapCorrectionEstimate>,
    /// Alternative poses that explain the points, with their probabilities. Excludes `pose`.
    pub runners_up: Vec<Hypothesis>,
    /// What all other poses of the field explain at most. None unless this image was searched exactly on the whole field
    /// without a tracked pose.
    pub certificate: Option<Certificate>,
    /// What would tell the pose from its alternatives. None unless the reason is `Ambiguous`.
    pub advice: Option<Advice>,
}

impl Estimate {
    /// A tracked pose of good quality, as generated drives and tests need it.
    #[cfg(any(test, feature = "synthetic"))]
    pub fn tracked(stamp: Stamp, pose: Pose, covariance: Matrix3<f32>) -> Self {
        Estimate {
            pose: Some(pose),
            mode: Mode::Tracking,
            inlier_share: 1.0,
            line_points: 50,
            half_known: true,
            ..Estimate::lost(stamp, covariance)
        }
    }

    /// Is the pose predicted by the motion alone, because no line point of this image lies on a marking at it?
    pub fn is_predicted(&self) -> bool {
        self.pose.is_some() && self.inlier_share == 0.0
    }

    /// No pose; `covariance` of a uniform distribution over the field.
    pub fn lost(stamp: Stamp, covariance: Matrix3<f32>) -> Self {
        Estimate {
            stamp,
            pose: None,
            covariance,
            repeated_covariance: Matrix3::zeros(),
            mode: Mode::Lost,
            reason: None,
            inlier_rms: 0.0,
            inlier_share: 0.0,
            line_points: 0,
            tilt: [0.0; 2],
            half_known: false,
            odometry_scales: [1.0; 2],
            odometry_correction: UNCORRECTED_MOTION,
            twist: None,
            collision: false,
            gyro_bias: 0.0,
            latency: 0.0,
            fit: Default::default(),
            map_correction: None,
            runners_up: Vec::new(),
            certificate: None,
            advice: None,
        }
    }

    /// Marks the pose as that of a doubtful set-up: it is not tracked, and `covariance` is added to its own.
    pub fn mark_setup_doubtful(&mut self, covariance: &Matrix3<f32>) {
        if self.pose.is_none() {
            return;
        }
        self.covariance += covariance;
        self.reason = Some(Reason::DoubtfulSetup);
        if self.mode == Mode::Tracking {
            self.mode = Mode::Global;
        }
    }
}
