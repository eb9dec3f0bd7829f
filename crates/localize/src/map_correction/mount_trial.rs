//! Does another mount explain image after image, from other places and headings, better than the map in use?
//!
//! A wrong pose, late samples or a turned inertial unit are as well explained by another pose and tilt under the map in use, and what misleads
//! one image does not hold for a robot that has moved on. A mount is constant in the robot's frame.

use nalgebra::Matrix3;

use super::far_mount::MountTrial;
use super::image_fit::{ImageFit, ImagePrior, ImageState};
use super::learning::is_moved;
use super::mount_search::pose_information;
use super::refit::STATE_TILT_INFORMATION;
use super::state::{INITIAL_NOISE, MapCorrection, TrackedImage};
use super::sums::PoseByTerm;
use crate::frames::Pose;
use crate::matching::MatchConfig;
use crate::matching::distance_field::DistanceField;

/// Lead at which a mount is taken over: independent images that it explains better by the margin.
const LEAD_MIN: f32 = 10.0;

/// Largest mean information of an image of the trial, relative to what is known already: derivatives hold roughly.
const GAIN_MAX: f64 = 1.0;

/// Factor of the unknowns' covariance at the take-over. Errors of neighbouring images are alike.
const TAKE_OVER_INFLATION: f64 = 2.0;

/// Images after which a trial ends, and with it what it adds to the covariance: learning has caught up with its mounts.
const TRIAL_IMAGES_MAX: u32 = 200;

/// Share of the points that the map in use explains, from which nothing is searched: what outliers leave. Mirrors 5 mm off their axis
/// have 0.5 to 0.7.
const EXPLAINED_SHARE: f32 = 0.75;

/// Share of the margin by which a mount must explain one image better to be tried.
const BEGIN_SHARE: f32 = 0.5;

/// Standard deviations of the pose under the mount on trial: metres, radians.
const POSE_STD: [f64; 3] = [0.3, 0.3, 0.05];

/// Reaches of a fit from the last image's state, as shares of a new map's displacements.
const REACHES: [f32; 4] = [1.0, 0.5, 0.0, 0.0];

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
        let Some(tracked) = self.trials.first().map(|trial| trial.pose) else {
            self.search_when_due(image, margin, distances, matching);
            return None;
        };
        if !is_moved(tracked, image.matched.pose, &self.config) {
            return None;
        }
        let trials = std::mem::take(&mut self.trials);
        self.continue_trials(trials, image, margin, distances, matching)
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
        self.schedule.last = Some(image.stamp);
        let margin_min = BEGIN_SHARE * margin;
        let present = self.present_score(image, distances, matching);
        let points = self.points.len() as f32;
        if present >= EXPLAINED_SHARE * points || present + margin_min >= points {
            return;
        }
        self.schedule.failures += 1;
        let found = self.search_mounts(image, margin_min, distances, matching);
        let trial = |(found, lead): (ImageFit, f32)| MountTrial {
            coefficients: found.state.coefficients,
            // One image finds the direction. Those of the trial learn from there.
            covariance: self.prior,
            offset: image.matched.pose.inverse() * found.state.pose,
            pose: image.matched.pose,
            lead: (lead / margin).min(1.0),
            explained: found.score,
            images: 1,
        };
        self.trials = found.into_iter().map(trial).collect();
    }

    fn continue_trials(
        &mut self,
        mut trials: Vec<MountTrial>,
        image: &TrackedImage,
        margin: f32,
        distances: &DistanceField,
        matching: &MatchConfig,
    ) -> Option<Pose> {
        let fits: Vec<Option<ImageFit>> = trials
            .iter()
            .map(|trial| self.fit_trial(trial, image, distances, matching))
            .collect();
        let mut starts = vec![self.image_state(image)];
        starts.extend(fits.first().and_then(|fit| Some((*fit)?.state)));
        let in_use = self.best_in_use(&starts, image, distances, matching);
        for (trial, fit) in trials.iter_mut().zip(fits) {
            let Some(fit) = fit else {
                trial.lead = 0.0;
                continue;
            };
            trial.lead += ((fit.score - in_use) / margin).clamp(-1.0, 1.0);
            trial.explained += fit.score;
            trial.images += 1;
            trial.pose = image.matched.pose;
            trial.offset = image.matched.pose.inverse() * fit.state.pose;
            trial.coefficients = fit.state.coefficients;
            trial.covariance = fit.covariance;
        }
        trials.retain(|trial| trial.lead > 0.0 && trial.images <= TRIAL_IMAGES_MAX);
        trials.sort_by(|a, b| b.explained.total_cmp(&a.explained));
        let best = trials.first()?;
        if best.lead < LEAD_MIN {
            self.trials = trials;
            return None;
        }
        self.coefficients = best.coefficients;
        self.applied = best.coefficients;
        self.plausible_centre = best.coefficients;
        self.covariance = best.covariance * TAKE_OVER_INFLATION;
        self.sensitivity = PoseByTerm::zeros();
        self.noise = INITIAL_NOISE;
        self.knocks += 1;
        self.schedule.failures = 0;
        self.restart_learning();
        Some(best.pose * best.offset)
    }

    fn fit_trial(
        &self,
        trial: &MountTrial,
        image: &TrackedImage,
        distances: &DistanceField,
        matching: &MatchConfig,
    ) -> Option<ImageFit> {
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
        self.fit_image(start, &prior, &REACHES, distances, matching)
    }

    /// Covariance of (x, y, θ) by the best mount on trial: its pose and the tracked one count as equally probable.
    pub(super) fn trial_covariance(&self) -> Matrix3<f32> {
        self.trials.first().map_or(Matrix3::zeros(), |trial| {
            let difference = (trial.pose * trial.offset).difference(trial.pose);
            difference * difference.transpose() * 0.5
        })
    }
}
