//! Is it known which half of the field the robot is on? Says so when it is no longer, and when it is again.

use localize::Stamp;
use localize::estimate::Estimate;

/// Time after which a change is said, seconds: steel turns a compass for a moment.
const SAID_AFTER: f64 = 1.0;

/// A change that is to be said.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum HalfChange {
    /// It was known and is no longer.
    Lost,
    /// It is known again.
    Found,
}

/// Watches the half of one robot. A half that was never known, as without a compass, is not missed.
#[derive(Debug, Default)]
pub(super) struct FieldHalf {
    was_known: bool,
    is_missed: bool,
    /// Since when the estimates differ from what was last said.
    differs_since: Option<Stamp>,
}

impl FieldHalf {
    /// Takes the estimate of a cycle. One without a pose says nothing about the half.
    pub(super) fn take(&mut self, estimate: &Estimate) -> Option<HalfChange> {
        estimate.pose?;
        self.was_known |= estimate.half_known;
        let is_missed = self.was_known && !estimate.half_known;
        if is_missed == self.is_missed {
            self.differs_since = None;
            return None;
        }
        let since = *self.differs_since.get_or_insert(estimate.stamp);
        if estimate.stamp - since < SAID_AFTER {
            return None;
        }
        self.is_missed = is_missed;
        Some(if is_missed {
            HalfChange::Lost
        } else {
            HalfChange::Found
        })
    }
}

impl HalfChange {
    /// Its name in the report.
    pub(super) fn state(self) -> &'static str {
        match self {
            HalfChange::Lost => "lost",
            HalfChange::Found => "found",
        }
    }

    /// The message for the operator.
    pub(super) fn text(self) -> &'static str {
        match self {
            HalfChange::Lost => {
                "the half of the field is no longer known: compass or goals contradict the pose, or nothing told since it was found \
                 anew. A given pose tells"
            }
            HalfChange::Found => "the half of the field is known again",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_that_was_known_is_missed_after_a_second_and_found_once() {
        let mut half = FieldHalf::default();
        let mut changes = Vec::new();
        for k in 0..300_i32 {
            let mut cycle = pipeline::testing::random_cycle(0);
            let estimate = &mut cycle.estimate;
            estimate.stamp = Stamp::from_seconds(f64::from(k) / 30.0);
            // Half a second beside steel, later five seconds on the wrong half, one image without a pose.
            estimate.half_known = !(k < 10 || (40..55).contains(&k) || (100..250).contains(&k));
            estimate.pose = (k != 115).then(|| localize::Pose::new(0.0, 0.0, 0.0));
            changes.extend(half.take(estimate).map(|change| (k, change)));
        }
        assert_eq!(changes, [(130, HalfChange::Lost), (280, HalfChange::Found)]);
        let mut never = FieldHalf::default();
        for k in 0..90_i32 {
            let mut cycle = pipeline::testing::random_cycle(0);
            cycle.estimate.stamp = Stamp::from_seconds(f64::from(k) / 30.0);
            cycle.estimate.half_known = false;
            assert_eq!(never.take(&cycle.estimate), None);
        }
    }
}
