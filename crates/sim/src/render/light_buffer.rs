//! Where does light gather while an image is rendered? A tile's rays at a time, so that it stays in the near cache.

use super::rays::Tile;

/// Linear light of one tile's rays, one plane a colour.
pub(super) struct LightBuffer {
    first: usize,
    planes: [Vec<f32>; 3],
}

impl LightBuffer {
    /// For tiles of at most so many rays.
    pub(super) fn new(most_rays: usize) -> Self {
        LightBuffer {
            first: 0,
            planes: [0; 3].map(|_| vec![0.0; most_rays]),
        }
    }

    /// From now on it holds this tile.
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

    /// Mixes a colour into one ray's light.
    #[inline(always)]
    pub(super) fn blend(&mut self, ray: usize, part: f32, colour: [f32; 3]) {
        for (plane, colour) in self.planes.iter_mut().zip(colour) {
            let light = &mut plane[ray - self.first];
            *light += part * (colour - *light);
        }
    }
}
