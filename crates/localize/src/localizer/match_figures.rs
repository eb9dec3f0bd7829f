//! How well an image fits the reported pose.

use crate::global_search::branch_and_bound::Hypothesis;
use crate::matching::Match;

/// How well the points fit the reported pose. Zero without a match.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct MatchFigures {
    pub(super) score: f32,
    pub(super) inlier_share: f32,
    pub(super) residual: f32,
    pub(super) tilt: [f32; 2],
}

impl From<&Match> for MatchFigures {
    fn from(matched: &Match) -> Self {
        MatchFigures {
            score: matched.score,
            inlier_share: matched.inlier_share,
            residual: matched.inlier_rms,
            tilt: matched.tilt,
        }
    }
}

impl From<&Hypothesis> for MatchFigures {
    fn from(hypothesis: &Hypothesis) -> Self {
        MatchFigures {
            score: hypothesis.score,
            inlier_share: hypothesis.inlier_share,
            residual: hypothesis.inlier_rms,
            tilt: hypothesis.tilt,
        }
    }
}
