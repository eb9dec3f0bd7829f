//! How are objects drawn? Upright prisms with antialiased edges, over what is behind them.

use super::culling::{Cylinder, Reach, ReachMargins};
use super::lanes::{
    BlockLight, LANES, Lanes, any_positive, edge_coverage, larger, set_bits, share, smaller,
};
use super::moving_rays::{MovedBlock, RayLanes};
use super::panels::Panel;
use super::spheres::Sphere;

/// An upright prism, robot frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct Solid {
    pub(super) x: f32,
    pub(super) y: f32,
    pub(super) bottom: f32,
    pub(super) top: f32,
    pub(super) outline: Outline,
    /// Linear colours.
    pub(super) side: [f32; 3],
    pub(super) cap: [f32; 3],
}

/// Outline of a solid in the ground plane.
#[derive(Debug, Clone, Copy)]
pub(super) enum Outline {
    Circle {
        radius: f32,
    },
    /// Half side lengths, and the direction of the first side.
    Box {
        half: [f32; 2],
        cos: f32,
        sin: f32,
    },
}

/// An object in the order from far to near.
#[derive(Debug, Clone, Copy)]
pub(super) enum Primitive {
    Solid(Solid),
    Sphere(Sphere),
    Panel(Panel),
}

/// Direction towards the light for shading sides: a unit vector in the robot frame.
pub(super) type LightDirection = [f32; 2];

/// Intersection of a ray with an outline: covered share of the pixel, distances of entry and exit, brightness.
#[derive(Clone, Copy)]
struct Chord {
    covered: f32,
    entry: f32,
    exit: f32,
    shading: f32,
}

/// A ray relative to a solid: vector to the centre, ray direction, centre along and across the ray, pixel width.
#[derive(Clone, Copy)]
struct RayOffset {
    dx: f32,
    dy: f32,
    tx: f32,
    ty: f32,
    along: f32,
    across: f32,
    width: f32,
}

impl Primitive {
    /// The rays that may meet it.
    pub(super) fn reach(&self, margins: &ReachMargins) -> Reach {
        let cylinder = match self {
            Primitive::Solid(solid) => Cylinder {
                x: solid.x,
                y: solid.y,
                radius: match solid.outline {
                    Outline::Circle { radius } => radius,
                    Outline::Box { half, .. } => half[0].hypot(half[1]),
                },
                bottom: solid.bottom,
                top: solid.top,
            },
            // Its footprints are as wide as the mean of both spacings, and so may reach farther than slopes tell.
            Primitive::Sphere(sphere) => sphere.cylinder(),
            Primitive::Panel(panel) => panel.cylinder(),
        };
        Reach::new(&cylinder, margins)
    }

    /// Draws over what is behind, on the rows whose bits are set.
    pub(super) fn draw(
        &self,
        rays: &MovedBlock,
        rows: u32,
        light_direction: LightDirection,
        light: &mut BlockLight,
    ) {
        match self {
            Primitive::Solid(solid) => solid.draw(rays, rows, light_direction, light),
            // Its footprints are as wide as the mean of both spacings, and so may reach farther than slopes tell.
            Primitive::Sphere(sphere) => sphere.draw(rays, light),
            Primitive::Panel(panel) => panel.draw(rays, rows, light),
        }
    }
}

impl Solid {
    fn draw(
        &self,
        rays: &MovedBlock,
        rows: u32,
        light_direction: LightDirection,
        light: &mut BlockLight,
    ) {
        match self.outline {
            Outline::Circle { radius } => self.draw_rows(rays, rows, light, |ray| {
                chord_of_circle(radius, light_direction, ray)
            }),
            Outline::Box { half, cos, sin } => {
                // The light direction in the box's axes.
                let light_direction = [
                    cos * light_direction[0] + sin * light_direction[1],
                    cos * light_direction[1] - sin * light_direction[0],
                ];
                self.draw_rows(rays, rows, light, |ray| {
                    chord_of_box(half, (sin, cos), light_direction, ray)
                });
            }
        }
    }

    /// Draws the solid on a block, row by row.
    #[inline(always)]
    fn draw_rows(
        &self,
        rays: &MovedBlock,
        rows: u32,
        light: &mut BlockLight,
        chord: impl Fn(RayOffset) -> Chord,
    ) {
        for row in set_bits(rows) {
            let RayLanes {
                origin: [ox, oy, oz],
                direction: [tx, ty],
                slope,
            } = &rays.rows[row];
            let [spacing, slope_spacing] = rays.spacing.each_ref().map(|of| &of[row]);
            let (mut covered, mut entry, mut exit): (Lanes, Lanes, Lanes) = Default::default();
            let mut shading = [0.0; LANES];
            for i in 0..LANES {
                let (dx, dy) = (self.x - ox[i], self.y - oy[i]);
                let along = dx.mul_add(tx[i], dy * ty[i]);
                let chord = chord(RayOffset {
                    dx,
                    dy,
                    tx: tx[i],
                    ty: ty[i],
                    along,
                    across: dx.mul_add(ty[i], -dy * tx[i]),
                    width: larger(along, 0.05).mul_add(spacing[i], 1e-4),
                });
                covered[i] = chord.covered;
                (entry[i], exit[i], shading[i]) = (chord.entry, chord.exit, chord.shading);
            }
            if !any_positive(&covered) {
                continue;
            }
            let (mut side, mut cap) = ([0.0; LANES], [0.0; LANES]);
            for i in 0..LANES {
                let (z_in, z_out) = (
                    slope[i].mul_add(entry[i], oz[i]),
                    slope[i].mul_add(exit[i], oz[i]),
                );
                // Over the vertical distance between neighbouring rays at entry and exit.
                let per_metre = slope_spacing[i];
                let (per_in, per_out) = (
                    1.0 / entry[i].mul_add(per_metre, 1e-4),
                    1.0 / exit[i].mul_add(per_metre, 1e-4),
                );
                let falls = slope[i] < 0.0;
                let (low, per_low) = if falls {
                    (z_out, per_out)
                } else {
                    (z_in, per_in)
                };
                let (high, per_high) = if falls {
                    (z_in, per_in)
                } else {
                    (z_out, per_out)
                };
                let under_top = share((self.top - low).mul_add(per_low, 0.5));
                let over_bottom = share((high - self.bottom).mul_add(per_high, 0.5));
                covered[i] *= under_top * over_bottom;
                cap[i] = share((z_in - self.top).mul_add(per_in, 0.5));
                side[i] = shading[i] * (1.0 - cap[i]);
            }
            for (plane, (of_side, of_cap)) in light.iter_mut().zip(self.side.iter().zip(self.cap)) {
                let light = &mut plane[row];
                for i in 0..LANES {
                    let colour = side[i].mul_add(*of_side, cap[i] * of_cap);
                    light[i] = covered[i].mul_add(colour - light[i], light[i]);
                }
            }
        }
    }
}

#[inline(always)]
fn chord_of_circle(radius: f32, light_direction: LightDirection, ray: RayOffset) -> Chord {
    let RayOffset {
        tx,
        ty,
        along,
        across,
        width,
        ..
    } = ray;
    let half = larger((-across).mul_add(across, radius * radius), 0.0).sqrt();
    let ahead = if along + half > 0.0 { 1.0 } else { 0.0 };
    // Scaled normal at the entry of the ray.
    let (nx, ny) = (-half * tx - across * ty, -half * ty + across * tx);
    Chord {
        covered: edge_coverage(radius - across.abs(), width) * ahead,
        entry: larger(along - half, 0.0),
        exit: larger(along + half, 0.0),
        shading: 0.72
            + (0.22 * (nx * light_direction[0] + ny * light_direction[1]) + 0.1 * half)
                * (1.0 / radius),
    }
}

/// `(sin, cos)`: of the box's direction; `light_direction`: in the box's axes.
#[inline(always)]
fn chord_of_box(
    half: [f32; 2],
    (sin, cos): (f32, f32),
    light_direction: LightDirection,
    ray: RayOffset,
) -> Chord {
    let RayOffset {
        dx,
        dy,
        tx,
        ty,
        across,
        width,
        ..
    } = ray;
    // Ray and centre in the box's axes; avoids division by zero for a ray parallel to a side.
    let (px, py) = (cos.mul_add(dx, sin * dy), cos.mul_add(dy, -sin * dx));
    let slanted = |rate: f32| if rate.abs() < 1e-6 { 1e-6 } else { rate };
    let (rx, ry) = (
        slanted(cos.mul_add(tx, sin * ty)),
        slanted(cos.mul_add(ty, -sin * tx)),
    );
    let per_both = 1.0 / (rx * ry);
    let (per_x, per_y) = (ry * per_both, rx * per_both);
    let (mid_x, mid_y) = (px * per_x, py * per_y);
    let (half_x, half_y) = (half[0] * per_x.abs(), half[1] * per_y.abs());
    let (in_x, in_y) = (mid_x - half_x, mid_y - half_y);
    let (first, last) = (larger(in_x, in_y), smaller(mid_x + half_x, mid_y + half_y));
    // For a pixel that only touches an edge, entry and exit are the same.
    let middle = (first + last) / 2.0;
    let (enters, leaves) = (smaller(first, middle), larger(last, middle));
    let ahead = if leaves > 0.0 { 1.0 } else { 0.0 };
    let facing = if in_x > in_y {
        -light_direction[0].copysign(light_direction[0] * rx)
    } else {
        -light_direction[1].copysign(light_direction[1] * ry)
    };
    Chord {
        covered: edge_coverage(
            half[0] * ry.abs() + half[1] * rx.abs() - across.abs(),
            width,
        ) * ahead,
        entry: larger(enters, 0.0),
        exit: larger(leaves, 0.0),
        shading: 0.77 + 0.22 * facing,
    }
}
