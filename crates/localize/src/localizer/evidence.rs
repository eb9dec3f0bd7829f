//! How much do the images so far speak for a hypothesis? Their log likelihoods, view by view.

use crate::frames::Pose;
use crate::global_search::branch_and_bound::half_turn;

/// Images of one view count as one: what is hidden, clutter and the errors of map and compass are the same in all of them.
/// A robot that has moved this far has another view, metres.
const VIEW_DISTANCE: f32 = 2.0;

/// Evidence for a hypothesis.
#[derive(Debug, Clone)]
pub(super) struct Evidence {
    /// Log probability by earlier views, up to a constant.
    earlier: f32,
    /// Sum of the log likelihoods of the present view's images.
    view_sum: f32,
    view_images: u32,
    /// Where the present view began.
    view_start: Pose,
}

impl Evidence {
    /// No image yet; `log_weight`: log probability without one.
    pub(super) fn new(pose: Pose, log_weight: f32) -> Self {
        Evidence {
            earlier: log_weight,
            view_sum: 0.0,
            view_images: 0,
            view_start: pose,
        }
    }

    /// Adds the log likelihood of an image taken at a pose.
    pub(super) fn add(&mut self, pose: Pose, log_likelihood: f32) {
        if pose.origin().distance_to(self.view_start.origin()) > VIEW_DISTANCE {
            *self = Evidence::new(pose, self.log_weight());
        }
        self.view_sum += log_likelihood;
        self.view_images += 1;
    }

    /// Log probability, up to a constant.
    pub(super) fn log_weight(&self) -> f32 {
        self.earlier + self.view_sum / self.view_images.max(1) as f32
    }

    /// Lowers the log probability.
    pub(super) fn lower_by(&mut self, value: f32) {
        self.earlier -= value;
    }

    /// The same for the half turn of the hypothesis.
    pub(super) fn turn_half(&mut self) {
        self.view_start = half_turn(self.view_start);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_of_a_standing_robot_count_as_one_and_those_of_two_views_as_two() {
        let at = |x: f32| Pose::new(x, 0.0, 0.0);
        let mut evidence = Evidence::new(at(0.0), -1.0);
        for _ in 0..50 {
            evidence.add(at(0.01), -3.0);
        }
        assert!((evidence.log_weight() + 4.0).abs() < 1e-4);
        evidence.add(at(2.5), -3.0);
        assert!((evidence.log_weight() + 7.0).abs() < 1e-4);
    }
}
