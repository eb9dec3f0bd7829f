//! Where is light accumulated during rendering? In a buffer for one tile of rays, which fits into the cache.

use super::lanes::{LANES, Lanes, padded};
use super::rays::Tile;

/// Linear light of one tile's rays, one plane per colour.
pub(super) struct LightBuffer {
    first: usize,
    planes: [Vec<f32>; 3],
}

impl LightBuffer {
    /// A buffer for tiles of at most `rays_max` rays.
    pub(super) fn new(rays_max: usize) -> Self {
        LightBuffer {
            first: 0,
            planes: [0; 3].map(|_| vec![0.0; rays_max + LANES]),
        }
    }

    /// Selects the tile.
    pub(super) fn set_tile(&mut self, tile: &Tile) {
        self.first = tile.rays.start;
    }

    /// The three planes of a run of rays.
    pub(super) fn planes(&mut self, run: &std::ops::Range<usize>) -> [&mut [f32]; 3] {
        let first = self.first;
        self.planes
            .each_mut()
            .map(|plane| &mut plane[run.start - first..run.end - first])
    }

    /// The three planes of a run of rays, which goes on to a multiple of `LANES`.
    pub(super) fn lanes(&mut self, run: &std::ops::Range<usize>) -> [&mut [Lanes]; 3] {
        self.planes(&padded(run))
            .map(|plane| plane.as_chunks_mut().0)
    }

    /// Blends a colour into one ray's light with weight `part`.
    #[inline(always)]
    pub(super) fn blend(&mut self, ray: usize, part: f32, colour: [f32; 3]) {
        for (plane, colour) in self.planes.iter_mut().zip(colour) {
            let light = &mut plane[ray - self.first];
            *light += part * (colour - *light);
        }
    }
}
