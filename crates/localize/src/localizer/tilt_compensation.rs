//! Tilt of the robot in an image by the inertial unit (docs/methods.md 7.4), and the points compensated for it.
//!
//! A joint filter with an inertial unit estimates the tilt itself. Its tilt is used then.

use super::Localizer;
use super::tilt_bias::ImuTilt;
use crate::estimate::Estimate;
use crate::filter::{PoseFilter, TiltPrior};
use crate::frames::At;
use crate::matching::Match;
use crate::math;
use crate::sample::LinePoint;
use crate::stamp::Stamp;
use crate::tilt::ground_from_map;

/// Standard deviation of the pose by an uncertain map above which no unmeasured tilt is sought, metres.
const MAP_STD_MAX: f32 = 0.03;

impl Localizer {
    /// Compensates the points for the tilt at the exposure and sets the prior of the remaining tilt.
    ///
    /// None without an inertial unit, or with compensation switched off.
    pub(super) fn compensate_tilt(
        &mut self,
        exposed: Stamp,
        points: &mut [LinePoint],
    ) -> Option<ImuTilt> {
        let (config, matching) = (&self.config.attitude, &self.config.matching);
        self.expected_tilt = [0.0; 2];
        let prior_std = self
            .tilt_spread
            .tilt_std(matching.tilt_std_deg.to_radians());
        let measured = self.motion_inputs.tilt_at(exposed, config);
        let measured = measured.filter(|_| config.tilt_compensation && prior_std > 0.0);
        let Some(measured) = measured else {
            self.matcher.set_tilt_std(prior_std);
            self.tilt_prior = TiltPrior::Independent(self.matcher.tilt_std());
            return None;
        };
        let filter_tilt = self.state.filter().and_then(PoseFilter::tilt);
        let expected =
            filter_tilt.unwrap_or_else(|| self.tilt_bias.correct_tilt(measured, prior_std));
        compensate_points(points, expected.mean, matching.viewpoint_height);
        self.expected_tilt = expected.mean;
        self.tilt_prior = if filter_tilt.is_some() {
            let unmeasured_std = if self.knows_map() {
                self.tilt_spread.unmeasured_std()
            } else {
                0.0
            };
            self.matcher
                .set_tilt_std(math::hypot(expected.std, unmeasured_std));
            TiltPrior::FromState { unmeasured_std }
        } else {
            self.matcher.set_tilt_std(expected.std);
            TiltPrior::Independent(self.matcher.tilt_std())
        };
        Some(ImuTilt { measured, expected })
    }

    /// False while the set-up is doubted, or the map's errors may be as large as tilts that no unit reports: both move points alike.
    fn knows_map(&self) -> bool {
        if self.setup_is_doubted {
            return false;
        }
        let by_map = self.map_pose_covariance();
        by_map[(0, 0)].max(by_map[(1, 1)]) < MAP_STD_MAX * MAP_STD_MAX
    }

    /// Learns the spread of tilt and points from the last match, of a tracked image that most points support.
    pub(super) fn learn_spread(&mut self, stamp: Stamp, matched: &Match, filter: &PoseFilter) {
        let seconds = self.tilt_spread.advance_to(stamp);
        match self.tilt_prior {
            TiltPrior::Independent(std) => self.tilt_spread.update_tilt(matched, std, seconds),
            TiltPrior::FromState { unmeasured_std } => {
                // The image that widened the spread was matched under another one.
                if unmeasured_std == self.tilt_spread.unmeasured_std() {
                    let prior = filter.pose_prior(self.tilt_prior);
                    self.tilt_spread.update_unmeasured(matched, &prior, seconds);
                }
            }
        }
        self.matcher
            .learn_spread(&self.distance_field, matched, seconds);
    }

    /// Updates the constant tilt error after an image that was tracked without doubt.
    pub(super) fn update_tilt_bias(
        &mut self,
        imu_tilt: &ImuTilt,
        estimate: &Estimate,
        seconds: f32,
    ) {
        if let (Some(posterior), None) = (self.tilt_variances.take(), estimate.reason) {
            let config = &self.config.attitude;
            self.tilt_bias
                .update(imu_tilt, estimate.tilt, posterior, seconds, config);
        }
    }
}

/// Moves points of the upright map to their ground points for tilt (a, b) (docs/methods.md 3.3).
pub(super) fn compensate_points(points: &mut [LinePoint], [a, b]: [f32; 2], height: f32) {
    for point in points {
        let At { x, y, .. } = point.at;
        let [x, y] = ground_from_map([x, y], [a, b], height);
        point.at = At::new(x, y);
    }
}
