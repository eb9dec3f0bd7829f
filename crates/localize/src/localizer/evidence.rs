//! How much do the images so far speak for a hypothesis? Their log likelihoods, view by view.

use crate::frames::Pose;
use crate::global_search::branch_and_bound::half_turn;

/// Images of one view count as one: what is hidden, clutter and the errors of map and compass are the same in all of them.
/// A robot that has moved this far has another view, metres.
const VIEW_DISTANCE: f32 = 2.0;

/// Within this distance an image shows as good as the same points, metres.
const PLACE_DISTANCE: f32 = 0.2;

/// Evidence for a hypothesis: the mean of the images of each place that the robot left, by the share of a view that it moved
/// there, and that of the present place in full, since what comes into sight may contradict a hypothesis that all images before
/// allowed.
#[derive(Debug, Clone)]
pub(super) struct Evidence {
    /// Log probability by earlier places, up to a constant.
    earlier: f32,
    /// Sum of the log likelihoods of the present place's images.
    place_sum: f32,
    place_images: u32,
    /// Where the present place began.
    place_start: Pose,
}

impl Evidence {
    /// No image yet; `log_weight`: log probability without one.
    pub(super) fn new(pose: Pose, log_weight: f32) -> Self {
        Evidence {
            earlier: log_weight,
            place_sum: 0.0,
            place_images: 0,
            place_start: pose,
        }
    }

    /// Of a hypothesis that earlier places may have supported as well as this one, but for a penalty.
    pub(super) fn of_rival(&self, pose: Pose, penalty: f32) -> Self {
        Evidence::new(pose, self.earlier - penalty)
    }

    /// Share of a view that the robot has moved since the present place began, if it is another place at `pose`.
    pub(super) fn share_at_next_place(&self, pose: Pose) -> Option<f32> {
        let moved = pose.origin().distance_to(self.place_start.origin());
        (moved > PLACE_DISTANCE).then(|| (moved / VIEW_DISTANCE).min(1.0))
    }

    /// Begins another place at `pose`; the one before counts with a share of a view.
    pub(super) fn leave_place(&mut self, pose: Pose, share: f32) {
        *self = Evidence::new(pose, self.earlier + share * self.place_mean());
    }

    /// Adds the log likelihood of an image.
    pub(super) fn add(&mut self, log_likelihood: f32) {
        self.place_sum += log_likelihood;
        self.place_images += 1;
    }

    /// Log probability, up to a constant.
    pub(super) fn log_weight(&self) -> f32 {
        self.earlier + self.place_mean()
    }

    fn place_mean(&self) -> f32 {
        self.place_sum / self.place_images.max(1) as f32
    }

    /// Lowers the log probability.
    pub(super) fn lower_by(&mut self, value: f32) {
        self.earlier -= value;
    }

    /// The same for the half turn of the hypothesis.
    pub(super) fn turn_half(&mut self) {
        self.place_start = half_turn(self.place_start);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const AT: fn(f32) -> Pose = |x| Pose::new(x, 0.0, 0.0);

    #[test]
    fn images_of_a_standing_robot_count_as_one_and_those_of_two_views_as_two() {
        let mut evidence = Evidence::new(AT(0.0), -1.0);
        for _ in 0..50 {
            assert!(evidence.share_at_next_place(AT(0.01)).is_none());
            evidence.add(-3.0);
        }
        assert!((evidence.log_weight() + 4.0).abs() < 1e-4);
        let share = evidence
            .share_at_next_place(AT(2.5))
            .expect("another place");
        evidence.leave_place(AT(2.5), share);
        evidence.add(-3.0);
        assert!((evidence.log_weight() + 7.0).abs() < 1e-4);
    }

    #[test]
    fn what_comes_into_sight_counts_in_full_and_what_was_passed_by_its_distance() {
        let mut evidence = Evidence::new(AT(0.0), 0.0);
        let mut weights = Vec::new();
        for step in 0..20 {
            let at = AT(0.25 * step as f32);
            if let Some(share) = evidence.share_at_next_place(at) {
                evidence.leave_place(at, share);
            }
            // Something contradicts over half a metre, a quarter of a view.
            evidence.add(if (8..10).contains(&step) { -20.0 } else { 0.0 });
            weights.push(evidence.log_weight());
        }
        assert!(weights[7] == 0.0 && weights[8] == -20.0);
        assert!((weights[19] + 5.0).abs() < 1e-4, "{weights:?}");
    }
}
