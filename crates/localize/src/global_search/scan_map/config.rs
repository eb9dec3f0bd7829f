//! Settings of the scan map, and the steps and blocks in which its cells are stored.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Settings of the scan map.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ScanMapConfig {
    /// Side of a cell, metres (minho2016 IV: 0.1). A smaller cell is more accurate and costs more memory.
    pub cell: f32,
    /// Extent of the cells beyond the boundary lines, metres (minho2016 IV: 1).
    pub margin: f32,
    /// Largest distance used, metres ("the maximum robot visualization distance").
    pub range_max: f32,
    /// Smallest distance used, metres: the robot's own radius ("MASK").
    pub range_min: f32,
    /// Rotation of a spiral from the smallest to the largest distance, degrees.
    pub spiral_turn_deg: f32,
    /// Kernel scale c of eq. 5, metres.
    pub kernel_scale: f32,
    /// Distance at which the weight of a point is one half, metres.
    pub half_weight_range: f32,
    /// Half the side of the square of the local search, metres (minho2016 VI: 4 m²).
    pub local_half: f32,
}

impl Default for ScanMapConfig {
    fn default() -> Self {
        ScanMapConfig {
            cell: 0.1,
            margin: 1.0,
            range_max: 6.0,
            range_min: 0.3,
            spiral_turn_deg: 120.0,
            kernel_scale: 0.25,
            half_weight_range: 4.0,
            local_half: 1.0,
        }
    }
}

/// Distances are stored in steps of 1/180 of the range. `NO_HIT` means none and differs much from every step.
pub(super) const DISTANCE_STEPS: f32 = 180.0;
pub(super) const NO_HIT: u8 = 255;

/// Side of a block in cells, and the number of its cells.
pub(super) const BLOCK: usize = 4;
pub(super) const BLOCK_CELLS: usize = BLOCK * BLOCK;
