//! Settings of the branch-and-bound search.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Settings of the exact search.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct BranchAndBoundConfig {
    /// Side of a position cell, metres. A smaller cell costs more time and memory.
    pub cell: f32,
    /// Step of headings, degrees. Half a step displaces a point at 5 m by about a cell.
    pub heading_step_deg: f32,
    /// Extent of the search beyond the boundary lines, metres.
    pub margin: f32,
    /// Largest distance of line points used, metres. Beyond it, a heading step displaces points too far.
    pub range_max: f32,
    /// Kernel scale c of the score c²/(c² + d²), metres: the discretisation error at a true pose.
    pub kernel_scale: f32,
    /// Largest number of points used. Additional points are removed evenly.
    pub points_max: usize,
    /// Largest number of distinct hypotheses. Each includes its half turn on a symmetric field.
    pub hypotheses_max: usize,
    /// Smallest score of a hypothesis, as a share of the best score.
    pub runner_up_share: f32,
    /// Largest number of blocks searched for runners-up after the best cell is found.
    pub runner_up_blocks: usize,
    /// Largest number of blocks opened for the certificate, which bounds the scores of all other poses. More blocks lower
    /// the bound.
    pub certificate_blocks: usize,
    /// Distance below which two hypotheses of similar heading are duplicates, metres.
    pub separation_min: f32,
    /// Difference in heading below which two close hypotheses are duplicates, degrees.
    pub separation_min_deg: f32,
    /// Exponent of the joint likelihood of the points. Below 1, since the points of one marking share the errors of map and
    /// tilt: a hundred points in rows decide like ten independent ones.
    pub likelihood_exponent: f32,
}

impl Default for BranchAndBoundConfig {
    fn default() -> Self {
        BranchAndBoundConfig {
            cell: 0.1,
            heading_step_deg: 2.0,
            margin: 1.0,
            range_max: 10.0,
            kernel_scale: 0.2,
            points_max: 120,
            hypotheses_max: 24,
            runner_up_share: 0.85,
            runner_up_blocks: 6000,
            certificate_blocks: 1000,
            separation_min: 0.4,
            separation_min_deg: 10.0,
            likelihood_exponent: 0.1,
        }
    }
}
