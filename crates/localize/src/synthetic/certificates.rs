//! How low is the bound of the exact search on all other poses, and does a pose between the grid's poses exceed it?

use rand::SeedableRng;
use rand::rngs::Xoshiro256PlusPlus;
use serde::Serialize;

use super::drive::{SyntheticDriveConfig, random_pose, simulate_line_points};
use crate::config::LocalizeConfig;
use crate::field::Field;
use crate::global_search::branch_and_bound::{BranchAndBound, half_turn};
use crate::matching::Matcher;
use crate::matching::distance_field::DistanceField;

/// The certificate of one image at a random pose.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct CertificateScore {
    /// Seed of pose and points.
    pub seed: u64,
    /// Share of the points that the answer explains.
    pub answer_share: f32,
    /// Bound on the share that any other pose explains.
    pub others_share_max: f32,
    /// The bound cannot be lowered.
    pub is_attained: bool,
    /// Share that the best of many matched poses elsewhere explains.
    pub best_matched_share: f32,
    /// The answer is the true pose, or its half turn.
    pub is_right: bool,
}

/// Error of a right answer, metres.
const RIGHT_DISTANCE: f32 = 0.3;
/// Possible error of the random starts that are matched, metres.
const START_ERROR: f32 = 0.5;

/// Searches the field by the points of one image per seed, and matches `starts` random poses to look for a counterexample.
pub fn evaluate_certificates(
    field: &Field,
    config: &LocalizeConfig,
    drive: &SyntheticDriveConfig,
    seeds: std::ops::Range<u64>,
    starts: usize,
) -> Vec<CertificateScore> {
    let distances = DistanceField::new(field, &config.distance_field);
    let mut search = BranchAndBound::new(field, &distances, config.branch_and_bound.clone());
    let mut matcher = Matcher::new(config.matching.clone());
    let mut scores = Vec::new();
    for seed in seeds {
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed.wrapping_add(31_000_000));
        let truth = random_pose(field, &mut rng);
        let points = simulate_line_points(field, drive, truth, &mut rng);
        let found = search.find_certified(&distances, &mut matcher, &points, None);
        let Some((answer, certificate)) = found.hypotheses.first().zip(found.certificate) else {
            continue;
        };
        let is_answer = |pose| {
            search.is_same_hypothesis(answer.pose, pose)
                || search.is_half_turn_symmetric()
                    && search.is_same_hypothesis(answer.pose, half_turn(pose))
        };
        let best_matched_share = (0..starts)
            .map(|_| random_pose(field, &mut rng))
            .map(|start| matcher.refine(&distances, &points, start, START_ERROR).pose)
            .filter(|&pose| !is_answer(pose))
            .map(|pose| search.explained_share(&distances, pose))
            .fold(0.0, f32::max);
        let near =
            |pose: crate::frames::Pose| pose.origin().distance_to(truth.origin()) < RIGHT_DISTANCE;
        scores.push(CertificateScore {
            seed,
            answer_share: certificate.answer_share,
            others_share_max: certificate.others_share_max,
            is_attained: certificate.is_attained,
            best_matched_share,
            is_right: near(answer.pose) || near(half_turn(answer.pose)),
        });
    }
    scores
}
