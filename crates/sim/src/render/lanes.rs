//! How are rays passed to the loops that draw? In groups of a vector's width, so that none are left for a scalar loop.

use std::ops::Range;

/// Rays of one vector. Loops over runs go on to a multiple of it, so that none are left for a slow scalar loop.
pub(super) const LANES: usize = 8;

/// Components of rays, `LANES` at a time.
pub(super) type Lanes = [f32; LANES];

/// A run of rays up to a multiple of `LANES`. The rays beyond the run are of no meaning.
#[derive(Clone, Copy)]
pub(super) struct RayRun<'a> {
    /// Rays of the run itself.
    pub(super) count: usize,
    pub(super) origin: [&'a [Lanes]; 3],
    pub(super) direction: [&'a [Lanes]; 2],
    pub(super) slope: &'a [Lanes],
    pub(super) azimuth_spacing: &'a [Lanes],
    pub(super) slope_spacing: &'a [Lanes],
}

/// `LANES` rays of a run.
#[derive(Clone, Copy)]
pub(super) struct RayLanes<'a> {
    pub(super) origin: [&'a Lanes; 3],
    pub(super) direction: [&'a Lanes; 2],
    pub(super) slope: &'a Lanes,
    pub(super) azimuth_spacing: &'a Lanes,
    pub(super) slope_spacing: &'a Lanes,
}

impl<'a> RayRun<'a> {
    /// Number of groups of `LANES` rays.
    pub(super) fn groups(&self) -> usize {
        self.slope.len()
    }

    #[inline(always)]
    pub(super) fn lanes(&self, group: usize) -> RayLanes<'a> {
        RayLanes {
            origin: self.origin.map(|of| &of[group]),
            direction: self.direction.map(|of| &of[group]),
            slope: &self.slope[group],
            azimuth_spacing: &self.azimuth_spacing[group],
            slope_spacing: &self.slope_spacing[group],
        }
    }

    /// 1 for each ray of a group that belongs to the run, else 0.
    #[inline(always)]
    pub(super) fn mask(&self, group: usize) -> Lanes {
        lane_mask(self.count, group)
    }
}

/// 1 for each of a group's lanes that is among the first `count` ones of a run, else 0.
#[inline(always)]
pub(super) fn lane_mask(count: usize, group: usize) -> Lanes {
    const MASKS: [f32; 2 * LANES] = {
        let mut masks = [0.0; 2 * LANES];
        let mut lane = 0;
        while lane < LANES {
            masks[lane] = 1.0;
            lane += 1;
        }
        masks
    };
    let left = count.saturating_sub(group * LANES).min(LANES);
    let mut mask = [0.0; LANES];
    mask.copy_from_slice(&MASKS[LANES - left..2 * LANES - left]);
    mask
}

/// A run that goes on to a multiple of `LANES`.
pub(super) fn padded(run: &Range<usize>) -> Range<usize> {
    run.start..run.start + run.len().next_multiple_of(LANES)
}
