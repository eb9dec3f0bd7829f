//! What is known about the pose: the states of the localizer's state machine (`transitions`).

use super::candidates::Candidates;
use super::field_half::HalfEvidence;
use super::mate_record::MateRecords;
use crate::filter::PoseFilter;
use crate::global_search::branch_and_bound::GradualSearch;
use crate::matching::Match;
use crate::stamp::Stamp;

/// What is known about the pose.
#[derive(Debug, Clone, Default)]
#[expect(
    clippy::large_enum_variant,
    reason = "a localizer holds one state, and boxing would allocate in every image"
)]
pub(super) enum State {
    /// No pose. A global search may have gathered images already.
    #[default]
    Lost,
    /// Several hypotheses explain the images so far.
    Ambiguous(Candidates),
    /// One pose, supported by the images.
    Tracking(PoseTrack),
    /// One pose that the last images contradict.
    Suspect(PoseTrack, Suspicion),
}

/// A tracked pose.
#[derive(Debug, Clone)]
pub(super) struct PoseTrack {
    pub(super) filter: PoseFilter,
    /// Evidence for the field half of the filter's pose.
    pub(super) half_evidence: HalfEvidence,
    /// Exposure of the last image whose pose was compared with the whole field.
    pub(super) last_global_check: Stamp,
    /// Checks since the start of the track that found no better pose.
    pub(super) passed_checks: u32,
    /// What became of team-mates' sightings.
    pub(super) mates: MateRecords,
}

/// What contradicts a tracked pose.
#[derive(Debug, Clone)]
#[expect(
    clippy::large_enum_variant,
    reason = "part of the one state of a localizer"
)]
pub(super) enum Suspicion {
    /// Rule `evidence`: another pose explains more points.
    BetterAlternative(Alternative),
    /// Rule `thresholds`: points and compass deviate too much.
    PoorMatch {
        /// Consecutive images.
        images: u32,
    },
}

/// A pose that explains the points better than the tracked one. Odometry moves it as well.
#[derive(Debug, Clone)]
pub(super) struct Alternative {
    pub(super) filter: PoseFilter,
    /// Consecutive images that preferred it.
    pub(super) images: u32,
    /// Consecutive images that preferred any other pose to the tracked one.
    pub(super) contradictions: u32,
}

/// A check of the tracked pose against the whole field, in progress (`global_check`).
#[derive(Debug, Clone)]
pub(super) struct GlobalCheck {
    pub(super) search: GradualSearch,
    /// Match of the tracked pose to the same points.
    pub(super) matched: Match,
    pub(super) count: usize,
    /// No compass reading: the half turn is no alternative.
    pub(super) fold_half_turn: bool,
}

impl State {
    /// The tracked pose.
    pub(super) fn track(&self) -> Option<&PoseTrack> {
        match self {
            State::Tracking(track) | State::Suspect(track, _) => Some(track),
            State::Lost | State::Ambiguous(_) => None,
        }
    }

    pub(super) fn track_mut(&mut self) -> Option<&mut PoseTrack> {
        match self {
            State::Tracking(track) | State::Suspect(track, _) => Some(track),
            State::Lost | State::Ambiguous(_) => None,
        }
    }

    /// Filter of the tracked pose.
    pub(super) fn filter(&self) -> Option<&PoseFilter> {
        self.track().map(|track| &track.filter)
    }

    /// Filter of the tracked pose, or of the most probable candidate.
    pub(super) fn best_filter(&self) -> Option<&PoseFilter> {
        match self {
            State::Ambiguous(candidates) => candidates.best().map(|(filter, _)| filter),
            _ => self.filter(),
        }
    }

    /// Applies `update` to the filter of each hypothesis: tracked pose, alternative, candidates.
    pub(super) fn for_each_filter(&mut self, mut update: impl FnMut(&mut PoseFilter)) {
        match self {
            State::Lost => {}
            State::Ambiguous(candidates) => candidates.filters_mut().for_each(update),
            State::Tracking(track) => update(&mut track.filter),
            State::Suspect(track, suspicion) => {
                update(&mut track.filter);
                if let Suspicion::BetterAlternative(alternative) = suspicion {
                    update(&mut alternative.filter);
                }
            }
        }
    }

    /// Is there no hypothesis?
    pub(super) fn is_lost(&self) -> bool {
        matches!(self, State::Lost)
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix3;

    use super::*;
    use crate::filter::{FilterConfig, OdometryPrior};
    use crate::frames::Pose;

    fn filter(x: f32) -> PoseFilter {
        let config = FilterConfig::default();
        PoseFilter::new(
            Pose::new(x, 0.0, 0.0),
            &Matrix3::identity(),
            None,
            &config,
            &OdometryPrior::default(),
        )
    }

    #[test]
    fn measurements_reach_the_suspected_pose_and_its_alternative() {
        let track = PoseTrack {
            filter: filter(1.0),
            half_evidence: HalfEvidence::default(),
            last_global_check: Stamp(0),
            passed_checks: 0,
            mates: MateRecords::default(),
        };
        let alternative = Alternative {
            filter: filter(2.0),
            images: 1,
            contradictions: 1,
        };
        let mut state = State::Suspect(track, Suspicion::BetterAlternative(alternative));
        let mut visited = Vec::new();
        state.for_each_filter(|filter| visited.push(filter.pose().x));
        assert_eq!(visited, [1.0, 2.0]);
        assert_eq!(state.filter().map(|filter| filter.pose().x), Some(1.0));
    }
}
