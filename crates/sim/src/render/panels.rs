//! How are nets and low walls drawn? As upright rectangles.

use super::culling::Cylinder;
use super::lanes::{BlockLight, LANES, any_positive, blend, edge_coverage, set_bits};
use super::moving_rays::{MovedBlock, RayLanes};

/// An upright rectangle between two points, robot frame: a net or a wall.
#[derive(Debug, Clone, Copy)]
pub(super) struct Panel {
    pub(super) from: [f32; 2],
    pub(super) to: [f32; 2],
    pub(super) top: f32,
    pub(super) colour: [f32; 3],
    /// Mesh and cord of a net, metres; `None` for a wall.
    pub(super) mesh: Option<[f32; 2]>,
}

impl Panel {
    pub(super) fn cylinder(&self) -> Cylinder {
        let Panel { from, to, top, .. } = self;
        Cylinder {
            x: (from[0] + to[0]) / 2.0,
            y: (from[1] + to[1]) / 2.0,
            radius: (to[0] - from[0]).hypot(to[1] - from[1]) / 2.0,
            bottom: 0.0,
            top: *top,
        }
    }

    pub(super) fn draw(&self, rays: &MovedBlock, rows: u32, light: &mut BlockLight) {
        match self.mesh {
            Some([mesh, cord]) => self.draw_rows(rays, rows, light, |at, width| {
                1.0 - (1.0 - net_coverage(at[0], mesh, cord, width[0]))
                    * (1.0 - net_coverage(at[1], mesh, cord, width[1]))
            }),
            None => self.draw_rows(rays, rows, light, |_, _| 1.0),
        }
    }

    /// Draws the panel on a block. `solid`: share of a footprint that the panel fills, by the footprint's position along
    /// and up the panel and by its sides.
    #[inline(always)]
    fn draw_rows(
        &self,
        rays: &MovedBlock,
        rows: u32,
        light: &mut BlockLight,
        solid: impl Fn([f32; 2], [f32; 2]) -> f32,
    ) {
        let (ex, ey) = (self.to[0] - self.from[0], self.to[1] - self.from[1]);
        let length = ex.hypot(ey).max(1e-6);
        for row in set_bits(rows) {
            let RayLanes {
                origin: [ox, oy, oz],
                direction: [tx, ty],
                slope,
            } = &rays.rows[row];
            let [spacing, slope_spacing] = rays.spacing.each_ref().map(|of| &of[row]);
            let (mut part, mut at, mut width) =
                ([0.0; LANES], [[0.0; LANES]; 2], [[0.0; LANES]; 2]);
            for i in 0..LANES {
                let (dx, dy) = (self.from[0] - ox[i], self.from[1] - oy[i]);
                let cross = tx[i].mul_add(ey, -ty[i] * ex);
                // Avoids division by zero for a ray parallel to the panel.
                let per_cross = 1.0 / cross.abs().max(1e-6).copysign(cross);
                let distance = dx.mul_add(ey, -dy * ex) * per_cross;
                let ahead = if distance > 0.0 { 1.0 } else { 0.0 };
                let distance = distance.max(0.0);
                let along = dx.mul_add(ty[i], -dy * tx[i]) * per_cross * length;
                let height = slope[i].mul_add(distance, oz[i]);
                // The footprint grows with the angle of incidence.
                let across = distance * spacing[i] * length * per_cross.abs() + 1e-4;
                let rise = distance.mul_add(slope_spacing[i], 1e-4);
                let inside = edge_coverage(along, across) * edge_coverage(length - along, across);
                part[i] = ahead
                    * inside
                    * edge_coverage(self.top - height, rise)
                    * edge_coverage(height, rise);
                (at[0][i], at[1][i], width[0][i], width[1][i]) = (along, height, across, rise);
            }
            if !any_positive(&part) {
                continue;
            }
            for i in 0..LANES {
                part[i] *= solid([at[0][i], at[1][i]], [width[0][i], width[1][i]]);
            }
            blend(light, row, &part, self.colour);
        }
    }
}

/// Share of a footprint that the cords of a net cover.
#[inline(always)]
fn net_coverage(at: f32, mesh: f32, cord: f32, width: f32) -> f32 {
    let meshes = at / mesh;
    let off = (meshes - meshes.round_ties_even()).abs() * mesh;
    // Not `clamp`: its check of the limits keeps the compiler from vectorising.
    let fine = ((cord / 2.0 + width / 2.0 - off) / width)
        .max(0.0)
        .min((cord / width).min(1.0));
    if width >= mesh { cord / mesh } else { fine }
}
