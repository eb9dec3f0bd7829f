//! Estimates: what the localizer reports for each image.

use nalgebra::Matrix3;

use super::Localizer;
use super::candidates::Candidates;
use super::match_figures::MatchFigures;
use super::state::PoseTrack;
use crate::advice::Advice;
use crate::estimate::{Estimate, Fit, Mode, Reason};
use crate::filter::PoseFilter;
use crate::frames::Pose;
use crate::global_search::branch_and_bound::Hypothesis;
use crate::math;
use crate::omni::UNCORRECTED_MOTION;
use crate::stamp::Stamp;

/// What distinguishes the estimates of the states.
struct EstimateParts<'a> {
    /// Filter of the reported pose. None when lost.
    filter: Option<&'a PoseFilter>,
    covariance: Matrix3<f32>,
    mode: Mode,
    reason: Option<Reason>,
    half_known: bool,
    figures: MatchFigures,
    runners_up: Vec<Hypothesis>,
    advice: Option<Advice>,
}

impl EstimateParts<'_> {
    /// The only place that constructs an estimate. `process_points` fills in `line_points` and `fit`.
    fn into_estimate(self, stamp: Stamp) -> Estimate {
        let filter = self.filter;
        Estimate {
            stamp,
            pose: filter.map(PoseFilter::pose),
            covariance: self.covariance,
            // `process_points` adds them.
            repeated_covariance: Matrix3::zeros(),
            mode: self.mode,
            reason: self.reason,
            inlier_rms: self.figures.residual,
            inlier_share: self.figures.inlier_share,
            line_points: 0,
            tilt: self.figures.tilt,
            half_known: self.half_known,
            odometry_scales: filter.map_or([1.0; 2], PoseFilter::scales),
            odometry_correction: filter.map_or(UNCORRECTED_MOTION, PoseFilter::odometry_correction),
            twist: filter.map(PoseFilter::twist),
            collision: filter.is_some_and(PoseFilter::in_collision),
            gyro_bias: filter.map_or(0.0, PoseFilter::gyro_bias),
            latency: filter.map_or(0.0, PoseFilter::latency),
            fit: Fit::default(),
            // `process_points` fills it in.
            map_correction: None,
            runners_up: self.runners_up,
            // `localize_globally` fills it in.
            certificate: None,
            advice: self.advice,
        }
    }
}

impl Localizer {
    pub(super) fn half_known(&self, track: &PoseTrack) -> bool {
        !self.search.is_half_turn_symmetric()
            || track.half_evidence.log_odds_with_withheld()
                >= self.config.compass.half_known_log_odds
    }

    /// Without wheels and inertial unit nothing says about which point the robot tilts. The pose then is that of the
    /// ground point below the viewpoint, which images measure whatever the tilt is (docs/methods.md 3.1).
    pub(super) fn refer_to_viewpoint(&self, estimate: &mut Estimate) {
        let moves = self.last_odometry.is_some()
            || self
                .motion_inputs
                .imu_active(estimate.stamp, &self.config.attitude);
        let Some(pose) = estimate.pose.filter(|_| !moves) else {
            return;
        };
        let height = self.config.matching.viewpoint_height;
        let [x, y] = estimate.tilt.map(|tilt| -tilt * height);
        let (sin, cos) = math::sin_cos(pose.theta);
        estimate.pose = Some(Pose::new(
            pose.x + cos * x - sin * y,
            pose.y + sin * x + cos * y,
            pose.theta,
        ));
    }

    /// Estimate of the tracked pose, or of a lost one.
    pub(super) fn estimate(
        &self,
        stamp: Stamp,
        reason: Option<Reason>,
        figures: MatchFigures,
        alternatives: Vec<Hypothesis>,
    ) -> Estimate {
        let Some(track) = self.state.track() else {
            let reason = reason.unwrap_or(Reason::DeadReckoningTimeout);
            return self.lost_estimate(stamp, reason, alternatives);
        };
        let half_known = self.half_known(track);
        let mut runners_up = alternatives;
        if !half_known {
            runners_up.insert(0, half_turn_hypothesis(track, figures));
        }
        EstimateParts {
            filter: Some(&track.filter),
            covariance: track.filter.covariance(),
            mode: if half_known {
                Mode::Tracking
            } else {
                Mode::Global
            },
            // An open half is worse than an image that hardly fits.
            reason: reason
                .filter(|reason| half_known || *reason != Reason::PoorMatch)
                .or((!half_known).then_some(Reason::Ambiguous)),
            half_known,
            figures,
            runners_up,
            advice: (!half_known).then_some(Advice::ObserveHalf),
        }
        .into_estimate(stamp)
    }

    /// Covariance of a pose that is not quite decided: with what is left of the probability, it is anywhere on the field.
    pub(super) fn or_any_place(&self, covariance: &Matrix3<f32>) -> Matrix3<f32> {
        self.with_probability(self.config.mode.decision_probability, covariance)
    }

    /// Covariance of a pose that is right with some probability, else anywhere on the field.
    pub(super) fn with_probability(&self, right: f32, covariance: &Matrix3<f32>) -> Matrix3<f32> {
        covariance * right + self.uniform_covariance * (1.0 - right)
    }

    /// Estimate of the most probable candidate. `fold_half_turn`: the candidates stand for their half turns too.
    pub(super) fn candidate_estimate(
        &self,
        stamp: Stamp,
        candidates: &Candidates,
        fold_half_turn: bool,
    ) -> Option<Estimate> {
        let (filter, best) = candidates.best()?;
        let half_known = self.is_decided(best) && !fold_half_turn;
        // Of a robot that moves the next images tell more. Single images are all that there is of others.
        let is_confirmed = self.last_odometry.is_none() || self.is_confirmed(candidates);
        let mut covariance = candidates.covariance();
        if !is_confirmed {
            covariance = self.or_any_place(&covariance);
        }
        let parts = EstimateParts {
            filter: Some(filter),
            covariance,
            mode: Mode::Global,
            reason: (!half_known || !is_confirmed).then_some(Reason::Ambiguous),
            half_known,
            figures: best.into(),
            runners_up: candidates.runners_up(fold_half_turn),
            // `localize_globally` fills in a motion.
            advice: fold_half_turn.then_some(Advice::ObserveHalf),
        };
        Some(parts.into_estimate(stamp))
    }

    /// Is this hypothesis probable enough to be tracked?
    pub(super) fn is_decided(&self, best: &Hypothesis) -> bool {
        best.probability >= self.config.mode.decision_probability
    }

    /// Did enough images support the best candidate?
    pub(super) fn is_confirmed(&self, candidates: &Candidates) -> bool {
        candidates.best_is_confirmed(self.config.mode.alternative_margin_share)
    }

    /// Estimate without a pose: the covariance is that of a uniform distribution over the field.
    pub(super) fn lost_estimate(
        &self,
        stamp: Stamp,
        reason: Reason,
        runners_up: Vec<Hypothesis>,
    ) -> Estimate {
        EstimateParts {
            filter: None,
            covariance: self.uniform_covariance,
            mode: Mode::Lost,
            reason: Some(reason),
            half_known: false,
            figures: MatchFigures {
                inlier_share: runners_up.first().map_or(0.0, |best| best.inlier_share),
                ..MatchFigures::default()
            },
            runners_up,
            advice: None,
        }
        .into_estimate(stamp)
    }
}

/// The half turn of the tracked pose, which explains the points equally well.
fn half_turn_hypothesis(track: &PoseTrack, figures: MatchFigures) -> Hypothesis {
    let half_turned = track.filter.half_turned();
    Hypothesis {
        pose: half_turned.pose(),
        covariance: half_turned.covariance(),
        score: figures.score,
        inlier_share: figures.inlier_share,
        inlier_rms: figures.residual,
        tilt: figures.tilt,
        // Without compass readings the log odds are 0, so both halves are equally probable.
        probability: 1.0 / (1.0 + math::exp(track.half_evidence.log_odds_with_withheld())),
    }
}
