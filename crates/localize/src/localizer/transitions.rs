//! Every transition between the states of the localizer's state machine (`state`).
//!
//! ```text
//! Lost ──hypotheses──▶ Ambiguous ──one is probable──▶ Tracking ◀──supported── Suspect
//!  ▲                       │                             │  contradicted ──▶     │
//!  └────── no match ───────┴── dead reckoning timeout ───┴── several images ─────┘
//! ```
//!
//! Tracking → Suspect → Lost follows nubot2013 4 (five cycles).

use super::Localizer;
use super::candidates::Candidates;
use super::field_half::HalfEvidence;
use super::mate_record::MateRecords;
use super::repeated_pose_error::RepeatedPoseError;
use super::state::{Alternative, PoseTrack, State, Suspicion};
use crate::filter::PoseFilter;
use crate::frames::Pose;
use crate::stamp::Stamp;

impl Localizer {
    /// Any state → Lost: the pose is given up and the global search starts anew.
    pub(super) fn lose_pose(&mut self) {
        self.state = State::Lost;
        self.global_check = None;
        self.global_search.reset();
        if let Some(snapshot) = &mut self.snapshot {
            snapshot.state = State::Lost;
        }
    }

    /// Lost or Ambiguous → Ambiguous while there are hypotheses. The global search continues.
    pub(super) fn keep_candidates(&mut self, candidates: Candidates) {
        self.state = if candidates.is_empty() {
            State::Lost
        } else {
            State::Ambiguous(candidates)
        };
    }

    /// Any state → Tracking: one pose is known at `stamp`.
    pub(super) fn start_tracking(
        &mut self,
        stamp: Stamp,
        filter: PoseFilter,
        half_evidence: HalfEvidence,
    ) {
        self.global_check = None;
        self.global_search.reset();
        self.repeated_error = RepeatedPoseError::default();
        self.state = State::Tracking(PoseTrack {
            filter,
            half_evidence,
            last_global_check: stamp,
            passed_checks: 0,
            mates: MateRecords::default(),
        });
    }

    /// Tracking or Suspect → Tracking: the image supports the pose.
    pub(super) fn confirm_pose(&mut self, track: PoseTrack) {
        self.state = State::Tracking(track);
    }

    /// Tracking or Suspect, unchanged: the image says nothing about the pose.
    pub(super) fn keep_pose(&mut self, track: PoseTrack, suspicion: Option<Suspicion>) {
        self.state = match suspicion {
            None => State::Tracking(track),
            Some(suspicion) => State::Suspect(track, suspicion),
        };
    }

    /// Tracking or Suspect → Suspect, or Lost when enough consecutive images preferred the same alternative, or twice as many
    /// any: stamps that leap, for example, move all alternatives aside.
    pub(super) fn suspect_alternative(
        &mut self,
        track: PoseTrack,
        previous: Option<Suspicion>,
        alternative: PoseFilter,
    ) {
        let same = |known: &Alternative, pose: Pose| {
            self.search.is_same_hypothesis(known.filter.pose(), pose)
        };
        let (images, contradictions) = match previous {
            Some(Suspicion::BetterAlternative(known)) => {
                let again = same(&known, alternative.pose());
                (
                    if again { known.images + 1 } else { 1 },
                    known.contradictions + 1,
                )
            }
            _ => (1, 1),
        };
        let images_max = self.config.mode.suspect_frames_max;
        if images >= images_max || contradictions >= 2 * images_max {
            self.lose_pose();
            return;
        }
        let alternative = Alternative {
            filter: alternative,
            images,
            contradictions,
        };
        self.state = State::Suspect(track, Suspicion::BetterAlternative(alternative));
    }

    /// Tracking or Suspect → Suspect, or Lost after enough consecutive images with a poor match.
    pub(super) fn suspect_poor_match(&mut self, track: PoseTrack, previous: Option<Suspicion>) {
        let images = match previous {
            Some(Suspicion::PoorMatch { images }) => images + 1,
            _ => 1,
        };
        if images >= self.config.mode.suspect_frames_max {
            self.lose_pose();
            return;
        }
        self.state = State::Suspect(track, Suspicion::PoorMatch { images });
    }
}
