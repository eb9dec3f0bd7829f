//! Do the team-mates contradict the pose, and which of them contradict the others?

use crate::stamp::Stamp;

/// Time without a sighting after which a mate has no say, seconds.
const SILENCE_MAX: f64 = 0.5;
/// Sightings that agree with those of others until a mate that contradicted them is believed again.
const REHABILITATION: u32 = 10;
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
    /// Sightings that have to agree until it is believed again.
    distrust: u32,
    /// Number of its sightings that were used.
    used: u32,
}

/// What became of all mates' sightings lately.
#[derive(Debug, Clone, Default)]
pub(super) struct MateRecords {
    mates: Vec<MateRecord>,
}

/// Has something happened within these seconds?
fn is_within(time: Option<Stamp>, now: Stamp, seconds: f64) -> bool {
    time.is_some_and(|time| time.seconds_until(now).abs() <= seconds)
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
                distrust: 0,
                used: 0,
            });
        }
        self.mates.get_mut(index)
    }

    /// A sighting agrees with the pose. False if the mate contradicted another one lately that is still believed.
    pub(super) fn is_believed(&mut self, robot: u32, stamp: Stamp, doubt_after: f32) -> bool {
        let doubt_after = f64::from(doubt_after);
        let others_agree = self.mates.iter().any(|mate| {
            mate.robot != robot
                && mate.distrust == 0
                && is_within(mate.last_used, stamp, doubt_after)
        });
        let Some(mate) = self.record(robot) else {
            return true;
        };
        if mate.distrust > 0 && others_agree {
            mate.distrust -= 1;
            return false;
        }
        mate.last_used = Some(stamp);
        mate.refused_since = None;
        mate.distrust = 0;
        mate.used = mate.used.saturating_add(1);
        true
    }

    /// No robot was seen where it had to be. True if more mates than not have said so for `doubt_after` seconds: the pose is
    /// doubted then, and the mates that determined it are.
    pub(super) fn mark_refused(&mut self, robot: u32, stamp: Stamp, doubt_after: f32) -> bool {
        if let Some(mate) = self.record(robot) {
            mate.last_refused = Some(stamp);
            mate.refused_since.get_or_insert(stamp);
            mate.distrust = REHABILITATION;
        }
        let doubt_after = f64::from(doubt_after);
        let contradicts = |mate: &MateRecord| {
            is_within(mate.last_refused, stamp, SILENCE_MAX)
                && mate
                    .refused_since
                    .is_some_and(|since| since.seconds_until(stamp) >= doubt_after)
        };
        let supports = |mate: &&MateRecord| {
            mate.refused_since.is_none() && is_within(mate.last_used, stamp, doubt_after)
        };
        let contradicting = self.mates.iter().filter(|mate| contradicts(mate)).count();
        if contradicting <= self.mates.iter().filter(supports).count() {
            return false;
        }
        // If they disagree among each other, those that agreed with the pose before are believed first.
        let credit = self.mates.iter().filter(|mate| contradicts(mate));
        let credit = credit.map(|mate| mate.used).max().unwrap_or(0);
        for mate in &mut self.mates {
            let is_believed = contradicts(mate) && mate.used >= credit / 2;
            mate.distrust = if is_believed { 0 } else { REHABILITATION };
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
        for k in 0..5 {
            let now = f64::from(k) * 0.1;
            // While the first one agrees, the second one is not believed.
            assert!(records.is_believed(1, at(now), 0.5));
            assert!(!records.mark_refused(2, at(now), 0.5), "{now}");
            assert!(!records.mark_refused(3, at(now), 0.5), "{now}");
        }
        // Two outvote one.
        assert!(records.is_believed(1, at(0.5), 0.5));
        assert!(records.mark_refused(3, at(0.55), 0.5));
        // The pose is doubted: now the majority is believed, and the first one is not.
        assert!(records.is_believed(2, at(0.6), 0.5));
        assert!(!records.is_believed(1, at(0.6), 0.5));
    }

    #[test]
    fn mate_that_contradicted_is_believed_again_after_it_agreed_ten_times() {
        let mut records = MateRecords::default();
        assert!(!records.mark_refused(2, at(0.0), 0.5));
        for _ in 0..REHABILITATION {
            assert!(records.is_believed(1, at(0.1), 0.5));
            assert!(!records.is_believed(2, at(0.1), 0.5));
        }
        assert!(records.is_believed(2, at(0.2), 0.5));
    }

    #[test]
    fn mate_that_agreed_before_is_believed_before_one_that_never_did() {
        let mut records = MateRecords::default();
        for k in 0..10 {
            assert!(records.is_believed(1, at(f64::from(k) * 0.1), 0.5));
        }
        // Later both contradict the pose.
        assert!(!records.mark_refused(1, at(3.0), 0.5));
        assert!(!records.mark_refused(2, at(3.0), 0.5));
        assert!(records.mark_refused(2, at(3.5), 0.5));
        // The second one comes first, but nobody else agrees with the pose.
        assert!(records.is_believed(1, at(3.6), 0.5));
        assert!(!records.is_believed(2, at(3.6), 0.5));
    }

    #[test]
    fn mate_that_contradicted_long_ago_has_no_say() {
        let mut records = MateRecords::default();
        assert!(!records.mark_refused(2, at(0.0), 0.5));
        assert!(records.is_believed(1, at(9.9), 0.5));
        assert!(!records.mark_refused(3, at(10.0), 0.5));
    }
}
