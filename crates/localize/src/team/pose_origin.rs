//! Does the pose rest on the own sight of the markings, so that it may correct team-mates?
//!
//! A robot that team-mates corrected must not correct others, or its own correction would return to it as news. A robot
//! that sees no markings must not either, since its error lasts longer than others assume.

use nalgebra::Matrix3;

use crate::estimate::{Estimate, Mode};
use crate::localizer::CooperativeConfig;
use crate::math;
use crate::stamp::Stamp;

/// Time without markings in sight for which the pose still rests on them, seconds.
const PAUSE_MAX: f64 = 0.5;

/// Follows from image to image what the pose rests on.
#[derive(Debug, Clone, Default)]
pub(super) struct PoseOrigin {
    /// Team-mates corrected the pose since it last rested on the markings alone.
    corrected: bool,
    /// Since when the markings determine the pose.
    since: Option<Stamp>,
    /// Last image with markings that determine the pose.
    last: Option<Stamp>,
    /// First of the tracked images whose markings do not determine the pose.
    undetermined_since: Option<Stamp>,
}

impl PoseOrigin {
    /// Team-mates corrected the pose.
    pub(super) fn mark_corrected(&mut self) {
        self.corrected = true;
        self.since = None;
        self.last = None;
    }

    /// Should team-mates correct the pose? Once they did, until it rests on the markings again.
    ///
    /// What the robot sees decides. A stated standard deviation alone does not: it is large in the first images of each
    /// track, which the markings correct at once, and small for long after the last marking.
    pub(super) fn needs_mates(&self, estimate: &Estimate, config: &CooperativeConfig) -> bool {
        if self.corrected && self.since.is_none() {
            return true;
        }
        let is_long =
            |since: Stamp| since.seconds_until(estimate.stamp) >= f64::from(config.needed_after);
        self.undetermined_since.is_some_and(is_long)
            && position_std(&estimate.covariance) >= config.own_std_min
    }

    /// Does the pose of this image rest on the markings alone?
    pub(super) fn update(&mut self, estimate: &Estimate, config: &CooperativeConfig) -> bool {
        let stamp = estimate.stamp;
        let is_tracking = estimate.mode == Mode::Tracking && estimate.pose.is_some();
        let is_matched = is_tracking && estimate.reason.is_none();
        // What all images share of the map's error leaves no direction open.
        let own = estimate.covariance - estimate.repeated_covariance;
        let is_determined = is_matched && position_std(&own) <= config.determined_std_max;
        if is_determined || !is_tracking {
            self.undetermined_since = None;
        } else {
            self.undetermined_since.get_or_insert(stamp);
        }
        let by_markings = is_matched
            && estimate.half_known
            && position_std(&estimate.covariance) <= config.helper_std_max
            && (is_determined || !self.corrected);
        if by_markings {
            self.since.get_or_insert(stamp);
            self.last = Some(stamp);
        } else if self
            .last
            .is_none_or(|last| !(0.0..=PAUSE_MAX).contains(&last.seconds_until(stamp)))
        {
            self.since = None;
        }
        let Some(since) = self.since else {
            return false;
        };
        if since.seconds_until(stamp) >= f64::from(config.independent_after) {
            self.corrected = false;
        }
        !self.corrected
    }
}

/// Largest standard deviation of the position in any direction, metres.
fn position_std(p: &Matrix3<f32>) -> f32 {
    let mean = 0.5 * (p[(0, 0)] + p[(1, 1)]);
    let half_difference = 0.5 * (p[(0, 0)] - p[(1, 1)]);
    (mean + math::hypot(half_difference, p[(0, 1)]))
        .max(0.0)
        .sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimate::Reason;
    use crate::frames::Pose;

    fn image(seconds: f64, std: f32, reason: Option<Reason>) -> Estimate {
        let covariance = Matrix3::from_diagonal_element(std * std);
        Estimate {
            reason,
            ..Estimate::tracked(
                Stamp::from_seconds(seconds),
                Pose::new(0.0, 0.0, 0.0),
                covariance,
            )
        }
    }

    #[test]
    fn corrected_robot_helps_again_after_two_seconds_of_markings() {
        let config = CooperativeConfig::default();
        let mut origin = PoseOrigin::default();
        assert!(origin.update(&image(0.0, 0.02, None), &config));
        // Without markings it helps for half a second.
        let blind = Some(Reason::FewPoints);
        assert!(origin.update(&image(0.4, 0.03, blind), &config));
        assert!(!origin.update(&image(0.6, 0.04, blind), &config));
        origin.mark_corrected();
        assert!(!origin.update(&image(1.0, 0.02, None), &config));
        assert!(!origin.update(&image(2.9, 0.02, None), &config));
        assert!(origin.update(&image(3.1, 0.02, None), &config));
    }

    #[test]
    fn robot_that_sees_markings_needs_no_mates_however_uncertain_its_first_images_are() {
        let config = CooperativeConfig::default();
        let mut origin = PoseOrigin::default();
        for (seconds, std) in [
            (0.0, 0.3),
            (0.2, 0.09),
            (0.4, 0.06),
            (0.6, 0.04),
            (2.0, 0.02),
        ] {
            let estimate = image(seconds, std, None);
            origin.update(&estimate, &config);
            assert!(!origin.needs_mates(&estimate, &config), "{seconds} s");
        }
        // A single image with many markings ends the need.
        for (seconds, reason, needs) in [
            (2.1, Some(Reason::FewPoints), false),
            (2.9, Some(Reason::FewPoints), false),
            (3.2, Some(Reason::FewPoints), true),
            (3.3, None, false),
            (3.4, Some(Reason::FewPoints), false),
        ] {
            let estimate = image(seconds, 0.03, reason);
            origin.update(&estimate, &config);
            assert_eq!(origin.needs_mates(&estimate, &config), needs, "{seconds} s");
        }
    }

    #[test]
    fn single_line_that_leaves_a_direction_open_needs_mates() {
        let config = CooperativeConfig::default();
        let mut origin = PoseOrigin::default();
        let needs = [0.0, 0.5, 1.5].map(|seconds| {
            let estimate = image(seconds, 0.07, None);
            origin.update(&estimate, &config);
            origin.needs_mates(&estimate, &config)
        });
        assert_eq!(needs, [false, false, true]);
    }

    #[test]
    fn few_markings_do_not_make_a_corrected_pose_its_own() {
        let config = CooperativeConfig::default();
        let mut origin = PoseOrigin::default();
        origin.mark_corrected();
        for k in 0..100 {
            // A single line: its images are accepted, but leave a direction to the team-mates.
            assert!(!origin.update(&image(f64::from(k) * 0.1, 0.07, None), &config));
        }
    }

    #[test]
    fn uncertain_map_alone_needs_no_mates() {
        let config = CooperativeConfig::default();
        let mut origin = PoseOrigin::default();
        for k in 0..30 {
            let estimate = Estimate {
                repeated_covariance: Matrix3::from_diagonal_element(0.068 * 0.068),
                ..image(f64::from(k) * 0.1, 0.07, None)
            };
            assert!(origin.update(&estimate, &config));
            assert!(!origin.needs_mates(&estimate, &config));
        }
    }

    #[test]
    fn pose_of_unknown_half_helps_nobody() {
        let estimate = Estimate {
            half_known: false,
            ..image(0.0, 0.02, None)
        };
        assert!(!PoseOrigin::default().update(&estimate, &CooperativeConfig::default()));
    }
}
