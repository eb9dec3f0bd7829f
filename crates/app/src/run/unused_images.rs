//! Are the camera's images used? Says so once when none was for a second, when another reason holds, and when they are again.

use localize::Stamp;
use pipeline::Cycle;

/// Time without a usable image until that is said, and time for which another reason holds until it is, seconds.
const REPORTED_AFTER: f64 = 1.0;

/// The fault of a cycle for which the camera delivered nothing.
pub(super) const NO_IMAGE: &str = "no image from the camera";

/// Counts images that could not be used.
#[derive(Debug, Default)]
pub(super) struct UnusedImages {
    /// Number of them.
    pub(super) count: u64,
    since: Option<Stamp>,
    /// Reason of the last image, and since when it holds.
    reason: Option<(String, Stamp)>,
    /// The reason that was said.
    reported: Option<String>,
}

/// A change that is to be said.
#[derive(Debug, PartialEq)]
pub(super) enum Change {
    /// For this reason.
    NotUsed(String),
    UsedAgain,
}

impl UnusedImages {
    /// Takes a cycle. Cycles without an image change nothing.
    pub(super) fn count_cycle(&mut self, cycle: &Cycle) -> Option<Change> {
        let Some(fault) = &cycle.image_fault else {
            let is_used = cycle.detections.is_some();
            let was_reported = is_used && self.reported.take().is_some();
            if is_used {
                self.since = None;
                self.reason = None;
            }
            return was_reported.then_some(Change::UsedAgain);
        };
        self.count += u64::from(fault != NO_IMAGE);
        let mut since = *self.since.get_or_insert(cycle.stamp);
        if self
            .reason
            .as_ref()
            .is_none_or(|(reason, _)| reason != fault)
        {
            self.reason = Some((fault.clone(), cycle.stamp));
        }
        if let (Some(reported), Some((_, reason_since))) = (&self.reported, &self.reason) {
            if reported == fault {
                return None;
            }
            // A reason with numbers may differ with each image.
            since = *reason_since;
        }
        if cycle.stamp - since < REPORTED_AFTER {
            return None;
        }
        self.reported = Some(fault.clone());
        Some(Change::NotUsed(fault.clone()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cycle(seconds: f64, fault: Option<&str>) -> Cycle {
        let mut cycle = pipeline::testing::random_cycle(0);
        cycle.stamp = Stamp::from_seconds(seconds);
        cycle.image_fault = fault.map(str::to_owned);
        cycle.detections = fault.is_none().then(Default::default);
        cycle
    }

    #[test]
    fn images_of_a_wrong_size_are_said_once_after_a_second_and_their_end_too() {
        let mut images = UnusedImages::default();
        let mut changes = Vec::new();
        for k in 0..90 {
            let fault = (10..60).contains(&k).then_some("480 x 480 pixels");
            if let Some(change) = images.count_cycle(&cycle(f64::from(k) / 30.0, fault)) {
                changes.push((k, change));
            }
        }
        let said = Change::NotUsed("480 x 480 pixels".to_owned());
        assert_eq!(changes, [(40, said), (60, Change::UsedAgain)]);
        assert_eq!(images.count, 50);
    }

    #[test]
    fn another_reason_is_said_once_it_has_held_for_a_second() {
        let mut images = UnusedImages::default();
        let mut changes = Vec::new();
        for k in 0..150 {
            let fault = match k {
                0..40 => "dark".to_owned(),
                40..80 => format!("{k} torn lines"),
                _ => "640 x 360 pixels".to_owned(),
            };
            if let Some(change) = images.count_cycle(&cycle(f64::from(k) / 30.0, Some(&fault))) {
                changes.push((k, change));
            }
        }
        let said = |reason: &str| Change::NotUsed(reason.to_owned());
        let expected = [(30, said("dark")), (110, said("640 x 360 pixels"))];
        assert_eq!(changes, expected);
    }

    #[test]
    fn images_that_never_came_are_said_and_not_counted() {
        let mut images = UnusedImages::default();
        let changes: Vec<Change> = (0..60)
            .filter_map(|k| images.count_cycle(&cycle(f64::from(k) / 30.0, Some(NO_IMAGE))))
            .collect();
        assert_eq!(changes, [Change::NotUsed(NO_IMAGE.to_owned())]);
        assert_eq!(images.count, 0);
    }

    #[test]
    fn single_unusable_images_are_counted_alone() {
        let mut images = UnusedImages::default();
        let changes: usize = (0..300)
            .filter_map(|k| {
                let fault = (k % 2 == 0).then_some("torn");
                images.count_cycle(&cycle(f64::from(k) / 30.0, fault))
            })
            .count();
        assert_eq!((changes, images.count), (0, 150));
    }
}
