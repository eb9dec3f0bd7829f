//! Did something hit the camera? A large knock shows in one image, a small one in many (`block`).

use super::block::Block;
use super::origin_by_wheels::OriginByWheels;
use super::state::{MapCorrection, TrackedImage};
use super::sums::{PoseByTerm, TermMatrix};
use crate::frames::Pose;
use crate::matching::MatchConfig;
use crate::matching::distance_field::DistanceField;

/// Tests in a row that must find a large knock, half a second of images: robots beside the camera and sudden light mislead
/// some images in a row. Two tests took 24 of 360 such images of a right map for knocks.
const KNOCK_TESTS: u32 = 15;

impl MapCorrection {
    /// Tests an image for a large knock: another map explains `margin` points more than the present one does, at the
    /// present pose and at the best one near it. Half a second of such images makes a knock. Returns the pose under the new map.
    ///
    /// Tests a `poor` match at once, others once per `knock_check_period`.
    pub fn detect_knock(
        &mut self,
        image: &TrackedImage,
        poor: bool,
        margin: f32,
        distances: &DistanceField,
        matching: &MatchConfig,
    ) -> Option<Pose> {
        let elapsed = self
            .knock_checked
            .map_or(f64::INFINITY, |last| last.seconds_until(image.stamp));
        let due = poor || self.knock_tests > 0 || elapsed >= self.config.knock_check_period;
        if !due || image.points.len() != self.points.len() {
            return None;
        }
        self.knock_checked = Some(image.stamp);
        let present = self.present_score(image, distances, matching);
        let knocked = self.covariance + self.prior;
        let refit = self
            .refit(image, &knocked, distances, matching)
            .filter(|refit| refit.score - present > margin)
            .filter(|refit| {
                // Late or missing samples make the prediction wrong, and with it the present match. Another pose under the
                // present map explains the image then.
                let moved = self.refit(image, &TermMatrix::zeros(), distances, matching);
                moved.is_none_or(|moved| refit.score - moved.score > margin)
            });
        let Some(refit) = refit else {
            self.knock_tests = 0;
            return None;
        };
        self.knock_tests += 1;
        if self.knock_tests < KNOCK_TESTS {
            return None;
        }
        self.coefficients = refit.coefficients;
        self.applied = refit.coefficients;
        // One image finds the direction; the next ones learn from there.
        self.covariance = self.prior;
        self.sensitivity = PoseByTerm::zeros();
        self.knocks += 1;
        self.restart_learning();
        Some(refit.pose)
    }

    /// Forgets what was learned, as after a knock. The coefficients stay the best guess.
    pub fn forget(&mut self) {
        self.covariance = self.prior;
        self.restart_learning();
    }

    pub(super) fn restart_learning(&mut self) {
        self.knock_tests = 0;
        self.origin_by_wheels = OriginByWheels::default();
        self.trials.clear();
        self.block = Block::new(self.coefficients, self.covariance);
        self.used_pose = None;
        self.last_pose = None;
        self.update_variances();
    }
}
