//! Does another mount explain image after image, from other places and headings, better than the map in use?
//!
//! A wrong pose, late samples or a turned inertial unit are as well explained by another pose and tilt under the map in use, and what misleads
//! one image does not hold for a robot that has moved on. A mount is constant in the robot's frame.

use nalgebra::Matrix3;

use super::image_fit::{ImagePrior, ImageState};
use super::learning::is_moved;
use super::mount_search::pose_information;
use super::refit::STATE_TILT_INFORMATION;
use super::state::{INITIAL_NOISE, MapCorrection, TrackedImage};
use super::sums::{PoseByTerm, TermMatrix, TermVector};
use crate::frames::{Pose, RobotFrame, Tf};
use crate::matching::MatchConfig;
use crate::matching::distance_field::DistanceField;
use crate::stamp::Stamp;

/// Lead at which a mount is taken over: independent images that it explains better by the margin.
const LEAD_MIN: f32 = 10.0;

/// Largest mean information of an image of the trial, relative to what is known already: derivatives hold roughly.
const GAIN_MAX: f64 = 1.0;

/// Factor of the unknowns' covariance at the take-over. Errors of neighbouring images are alike.
const TAKE_OVER_INFLATION: f64 = 2.0;

/// Share of the margin by which a mount must explain one image better to be tried.
const BEGIN_SHARE: f32 = 0.5;

/// Largest factor of the time between two searches over the first one's: each one that led to nothing doubles it.
const PERIOD_FACTOR_MAX: f64 = 32.0;

/// Standard deviations of the pose under the mount on trial: metres, radians.
const POSE_STD: [f64; 3] = [0.3, 0.3, 0.05];

/// Reaches of a fit from the last image's state, as shares of a new map's displacements.
const REACHES: [f32; 4] = [1.0, 0.5, 0.0, 0.0];

/// A mount on trial.
#[derive(Debug, Clone)]
pub(super) struct MountTrial {
    coefficients: TermVector,
    covariance: TermMatrix,
    /// The pose under it, seen from the tracked one.
    offset: Tf<RobotFrame, RobotFrame>,
    /// Tracked pose of the last image.
    pose: Pose,
    /// Images that it explained better by the margin, less those that it did not.
    lead: f32,
}

/// When the next search is due.
#[derive(Debug, Clone, Default)]
pub(super) struct SearchSchedule {
    last: Option<Stamp>,
    /// Searches in a row that led to nothing.
    failures: u32,
}

impl SearchSchedule {
    fn is_due(&self, stamp: Stamp, period: f64) -> bool {
        let factor = 2.0_f64
            .powi(self.failures.min(30) as i32)
            .min(PERIOD_FACTOR_MAX);
        self.last
            .is_none_or(|last| last.seconds_until(stamp) >= factor * period)
    }
}

impl MapCorrection {
    /// Searches for a mount that explains the image clearly better than the map in use, by `margin` points, or continues the trial of
    /// one. Returns the pose under a mount that was taken over.
    pub fn try_mounts(
        &mut self,
        image: &TrackedImage,
        margin: f32,
        distances: &DistanceField,
        matching: &MatchConfig,
    ) -> Option<Pose> {
        if image.points.len() != self.points.len() {
            return None;
        }
        let Some(trial) = self.trial.take() else {
            self.search_when_due(image, margin, distances, matching);
            return None;
        };
        if !is_moved(trial.pose, image.matched.pose, &self.config) {
            self.trial = Some(trial);
            return None;
        }
        self.continue_trial(trial, image, margin, distances, matching)
    }

    /// Searches for a mount that explains the image better than the map in use, at most once per period. The period doubles with each
    /// search that leads to nothing.
    pub fn search_when_due(
        &mut self,
        image: &TrackedImage,
        margin: f32,
        distances: &DistanceField,
        matching: &MatchConfig,
    ) {
        let period = self.config.knock_check_period;
        if !self.schedule.is_due(image.stamp, period) {
            return;
        }
        let margin_min = BEGIN_SHARE * margin;
        let present = self.present_score(image, distances, matching);
        if present + margin_min >= self.points.len() as f32 {
            return;
        }
        self.schedule.last = Some(image.stamp);
        self.schedule.failures += 1;
        let found = self.search_mount(image, margin_min, distances, matching);
        self.trial = found.map(|(found, lead)| MountTrial {
            coefficients: found.state.coefficients,
            // One image finds the direction. Those of the trial learn from there.
            covariance: self.prior,
            offset: image.matched.pose.inverse() * found.state.pose,
            pose: image.matched.pose,
            lead: (lead / margin).min(1.0),
        });
    }

    fn continue_trial(
        &mut self,
        mut trial: MountTrial,
        image: &TrackedImage,
        margin: f32,
        distances: &DistanceField,
        matching: &MatchConfig,
    ) -> Option<Pose> {
        let start = ImageState {
            coefficients: trial.coefficients,
            pose: image.matched.pose * trial.offset,
            tilt: image.expected_tilt,
        };
        let prior = ImagePrior {
            mean: start,
            information: pose_information(POSE_STD, STATE_TILT_INFORMATION),
            covariance: trial.covariance,
            share: self.trial_share(),
            gain_max: GAIN_MAX,
        };
        let fit = self.fit_image(start, &prior, &REACHES, distances, matching)?;
        let here = self.image_state(image);
        let in_use = self.best_in_use(&[here, fit.state], image, distances, matching);
        trial.lead += ((fit.score - in_use) / margin).clamp(-1.0, 1.0);
        if trial.lead <= 0.0 {
            return None;
        }
        trial.pose = image.matched.pose;
        trial.offset = image.matched.pose.inverse() * fit.state.pose;
        trial.coefficients = fit.state.coefficients;
        trial.covariance = fit.covariance;
        if trial.lead < LEAD_MIN {
            self.trial = Some(trial);
            return None;
        }
        self.coefficients = trial.coefficients;
        self.applied = trial.coefficients;
        self.plausible_centre = trial.coefficients;
        self.covariance = trial.covariance * TAKE_OVER_INFLATION;
        self.sensitivity = PoseByTerm::zeros();
        self.noise = INITIAL_NOISE;
        self.knocks += 1;
        self.schedule.failures = 0;
        self.restart_learning();
        Some(fit.state.pose)
    }

    /// Covariance of (x, y, θ) by a mount on trial: its pose and the tracked one count as equally probable.
    pub(super) fn trial_covariance(&self) -> Matrix3<f32> {
        self.trial.as_ref().map_or(Matrix3::zeros(), |trial| {
            let difference = (trial.pose * trial.offset).difference(trial.pose);
            difference * difference.transpose() * 0.5
        })
    }
}
