//! Do the team-mates contradict the pose? Most of those that saw something must, for some time.

use crate::stamp::Stamp;

/// Time without a sighting after which a mate has no say, seconds.
const SILENCE_MAX: f64 = 0.5;
/// Most mates.
const MATES_MAX: usize = 12;

/// What became of a mate's sightings lately.
#[derive(Debug, Clone, Copy)]
struct MateRecord {
    robot: u32,
    last_used: Option<Stamp>,
    last_refused: Option<Stamp>,
    /// First refusal since it was last used.
    refused_since: Option<Stamp>,
}

/// What became of all mates' sightings lately.
#[derive(Debug, Clone, Default)]
pub(super) struct MateRecords {
    mates: Vec<MateRecord>,
}

impl MateRecords {
    fn record(&mut self, robot: u32) -> Option<&mut MateRecord> {
        let known = self.mates.iter().position(|mate| mate.robot == robot);
        let index = known.unwrap_or(self.mates.len());
        if known.is_none() && self.mates.len() < MATES_MAX {
            self.mates.push(MateRecord {
                robot,
                last_used: None,
                last_refused: None,
                refused_since: None,
            });
        }
        self.mates.get_mut(index)
    }

    /// A sighting corrected the pose.
    pub(super) fn mark_used(&mut self, robot: u32, stamp: Stamp) {
        if let Some(mate) = self.record(robot) {
            mate.last_used = Some(stamp);
            mate.refused_since = None;
        }
    }

    /// No robot was seen where it had to be. True if more mates than not have said so for `doubt_after` seconds: then the
    /// count begins anew.
    pub(super) fn mark_refused(&mut self, robot: u32, stamp: Stamp, doubt_after: f32) -> bool {
        if let Some(mate) = self.record(robot) {
            mate.last_refused = Some(stamp);
            mate.refused_since.get_or_insert(stamp);
        }
        let is_within = |time: Option<Stamp>, seconds: f64| {
            time.is_some_and(|time| time.seconds_until(stamp).abs() <= seconds)
        };
        let doubt_after = f64::from(doubt_after);
        let contradicts = |mate: &&MateRecord| {
            is_within(mate.last_refused, SILENCE_MAX)
                && mate
                    .refused_since
                    .is_some_and(|since| since.seconds_until(stamp) >= doubt_after)
        };
        let supports = |mate: &&MateRecord| is_within(mate.last_used, doubt_after);
        let contradicting = self.mates.iter().filter(contradicts).count();
        if contradicting <= self.mates.iter().filter(supports).count() {
            return false;
        }
        for mate in &mut self.mates {
            mate.refused_since = None;
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(seconds: f64) -> Stamp {
        Stamp::from_seconds(seconds)
    }

    #[test]
    fn majority_of_the_mates_decides_after_a_while() {
        let mut records = MateRecords::default();
        for k in 0..7 {
            let now = f64::from(k) * 0.1;
            // The second one is a liar: while the first one agrees, it is not believed.
            records.mark_used(1, at(now));
            assert!(!records.mark_refused(2, at(now), 0.5), "{now}");
            // A third one outvotes the first.
            assert_eq!(records.mark_refused(3, at(now), 0.5), now >= 0.5, "{now}");
            if now >= 0.5 {
                break;
            }
        }
    }

    #[test]
    fn mate_that_contradicted_long_ago_has_no_say() {
        let mut records = MateRecords::default();
        assert!(!records.mark_refused(2, at(0.0), 0.5));
        records.mark_used(1, at(9.9));
        assert!(!records.mark_refused(3, at(10.0), 0.5));
    }
}
