//! How is a ball drawn? As a sphere that is lit from above.

use super::culling::Cylinder;
use super::lanes::{BlockLight, edge_coverage};
use super::moving_rays::{MovedBlock, RayLanes};

/// A ball, robot frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sphere {
    pub(super) x: f32,
    pub(super) y: f32,
    /// Of its lowest point, metres.
    pub(super) bottom: f32,
    pub(super) radius: f32,
    pub(super) colour: [f32; 3],
}

impl Sphere {
    pub(super) fn cylinder(&self) -> Cylinder {
        Cylinder {
            x: self.x,
            y: self.y,
            radius: self.radius,
            bottom: self.bottom,
            top: self.bottom + 2.0 * self.radius,
        }
    }

    pub(super) fn draw(&self, rays: &MovedBlock, light: &mut BlockLight) {
        for (row, of_row) in rays.rows.iter().enumerate() {
            for lane in 0..of_row.slope.len() {
                let spacing = [0, 1].map(|k| rays.spacing[k][row][lane]);
                let Some((covered, colour)) = self.seen_by(of_row, lane, spacing) else {
                    continue;
                };
                for (plane, colour) in light.iter_mut().zip(colour) {
                    let light = &mut plane[row][lane];
                    *light += covered * (colour - *light);
                }
            }
        }
    }

    /// The share of a pixel that it covers, and its light there.
    fn seen_by(&self, rays: &RayLanes, lane: usize, spacing: [f32; 2]) -> Option<(f32, [f32; 3])> {
        let centre = self.bottom + self.radius;
        let slope = rays.slope[lane];
        let scale = 1.0 / (1.0 + slope * slope).sqrt();
        let [tx, ty] = rays.direction.each_ref().map(|of| of[lane]);
        let [ox, oy, oz] = rays.origin.each_ref().map(|of| of[lane]);
        let direction = [tx * scale, ty * scale, slope * scale];
        let to = [self.x - ox, self.y - oy, centre - oz];
        let along = to[0] * direction[0] + to[1] * direction[1] + to[2] * direction[2];
        if along <= 0.0 {
            return None;
        }
        let square = (to[0] * to[0] + to[1] * to[1] + to[2] * to[2] - along * along).max(0.0);
        let miss = square.sqrt();
        // Pixel width across the ray: geometric mean of the spacings in azimuth and slope.
        let (turn, rise) = (spacing[0] * scale, spacing[1] * scale * scale);
        let width = along * (turn * rise).sqrt().max(1e-4);
        let covered = edge_coverage(self.radius - miss, width);
        if covered <= 0.0 {
            return None;
        }
        let distance = along - (self.radius * self.radius - square).max(0.0).sqrt();
        let up = (oz + distance * direction[2] - centre) / self.radius;
        // Light from above, some reflected by the carpet, a highlight on top.
        let bright = 0.52 + 0.5 * up.clamp(-1.0, 1.0);
        let shine = 0.35 * (up - 0.82).max(0.0) / 0.18;
        let colour = self
            .colour
            .map(|part| part * bright.max(0.12) + shine * 0.3);
        Some((covered, colour))
    }
}
