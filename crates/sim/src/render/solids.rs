//! How are objects drawn? Cylinders, boxes, spheres and panels with antialiased edges, over what is behind them.

use super::lanes::{LANES, Lanes, RayLanes, lane_mask, padded};
use super::light_buffer::LightBuffer;
use super::moving_rays::MovedRays;
use super::rays::{RayRange, SortedRays, Tile};

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

/// The rays and the light for drawing.
pub(super) struct DrawContext<'a> {
    pub(super) rays: &'a SortedRays,
    pub(super) moved: &'a MovedRays,
    pub(super) tile: &'a Tile,
    pub(super) light_direction: LightDirection,
}

impl Primitive {
    /// The rays that may meet this primitive.
    pub(super) fn ray_range(&self, rays: &SortedRays) -> RayRange {
        match self {
            Primitive::Solid(solid) => {
                let radius = match solid.outline {
                    Outline::Circle { radius } => radius,
                    Outline::Box { half, .. } => half[0].hypot(half[1]),
                };
                rays.range_of_cylinder(solid.x, solid.y, radius, solid.bottom, solid.top)
            }
            Primitive::Sphere(ball) => {
                let top = ball.bottom + 2.0 * ball.radius;
                rays.range_of_cylinder(ball.x, ball.y, ball.radius, ball.bottom, top)
            }
            Primitive::Panel(Panel { from, to, top, .. }) => {
                let (mx, my) = ((from[0] + to[0]) / 2.0, (from[1] + to[1]) / 2.0);
                let half = (to[0] - from[0]).hypot(to[1] - from[1]) / 2.0;
                rays.range_of_cylinder(mx, my, half, 0.0, *top)
            }
        }
    }

    /// Draws over what is behind.
    pub(super) fn draw(
        &self,
        range: &RayRange,
        context: &DrawContext,
        light_buffer: &mut LightBuffer,
    ) {
        match self {
            Primitive::Solid(solid) => draw_solid(solid, range, context, light_buffer),
            Primitive::Sphere(sphere) => draw_sphere(sphere, range, context, light_buffer),
            Primitive::Panel(panel) => draw_panel(panel, range, context, light_buffer),
        }
    }
}

/// Share of a pixel of width `width` on the inner side of an edge at distance `inside` from its centre.
#[inline(always)]
pub(super) fn edge_coverage(inside: f32, width: f32) -> f32 {
    (inside / width + 0.5).clamp(0.0, 1.0)
}

fn draw_solid(
    solid: &Solid,
    range: &RayRange,
    context: &DrawContext,
    light_buffer: &mut LightBuffer,
) {
    let light_direction = context.light_direction;
    match solid.outline {
        Outline::Circle { radius } => draw_solid_runs(solid, range, context, light_buffer, |ray| {
            chord_of_circle(radius, light_direction, ray)
        }),
        Outline::Box { half, cos, sin } => {
            // The light direction in the box's axes.
            let light_direction = [
                cos * light_direction[0] + sin * light_direction[1],
                cos * light_direction[1] - sin * light_direction[0],
            ];
            draw_solid_runs(solid, range, context, light_buffer, |ray| {
                chord_of_box(half, (sin, cos), light_direction, ray)
            });
        }
    }
}

/// Draws a solid on every ray that may meet it; branch-free for vectorisation.
#[inline(always)]
fn draw_solid_runs(
    solid: &Solid,
    range: &RayRange,
    context: &DrawContext,
    light_buffer: &mut LightBuffer,
    chord: impl Fn(RayOffset) -> Chord,
) {
    for run in context.rays.runs_in(range, context.tile) {
        let rays = context.moved.run(context.rays, &run);
        let mut light = light_buffer.lanes(&run);
        for group in 0..rays.groups() {
            let RayLanes {
                origin: [ox, oy, oz],
                direction: [tx, ty],
                slope,
                azimuth_spacing: spacing,
                slope_spacing,
            } = rays.lanes(group);
            let mask = rays.mask(group);
            let (mut covered, mut side, mut cap) = ([0.0; LANES], [0.0; LANES], [0.0; LANES]);
            for i in 0..LANES {
                let (dx, dy) = (solid.x - ox[i], solid.y - oy[i]);
                let along = dx.mul_add(tx[i], dy * ty[i]);
                let chord = chord(RayOffset {
                    dx,
                    dy,
                    tx: tx[i],
                    ty: ty[i],
                    along,
                    across: dx.mul_add(ty[i], -dy * tx[i]),
                    width: along.max(0.05).mul_add(spacing[i], 1e-4),
                });
                let (z_in, z_out) = (
                    slope[i].mul_add(chord.entry, oz[i]),
                    slope[i].mul_add(chord.exit, oz[i]),
                );
                // Vertical distance between neighbouring rays at entry and exit.
                let per_metre = slope_spacing[i];
                let (w_in, w_out) = (
                    chord.entry.mul_add(per_metre, 1e-4),
                    chord.exit.mul_add(per_metre, 1e-4),
                );
                let falls = slope[i] < 0.0;
                let (low, w_low) = if falls { (z_out, w_out) } else { (z_in, w_in) };
                let (high, w_high) = if falls { (z_in, w_in) } else { (z_out, w_out) };
                let under_top = edge_coverage(solid.top - low, w_low);
                let over_bottom = edge_coverage(high - solid.bottom, w_high);
                covered[i] = mask[i] * chord.covered * under_top * over_bottom;
                cap[i] = edge_coverage(z_in - solid.top, w_in);
                side[i] = chord.shading * (1.0 - cap[i]);
            }
            for (plane, (of_side, of_cap)) in light.iter_mut().zip(solid.side.iter().zip(solid.cap))
            {
                let light = &mut plane[group];
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
    let half = (-across).mul_add(across, radius * radius).max(0.0).sqrt();
    let ahead = if along + half > 0.0 { 1.0 } else { 0.0 };
    // Scaled normal at the entry of the ray.
    let (nx, ny) = (-half * tx - across * ty, -half * ty + across * tx);
    Chord {
        covered: edge_coverage(radius - across.abs(), width) * ahead,
        entry: (along - half).max(0.0),
        exit: (along + half).max(0.0),
        shading: 0.72
            + (0.22 * (nx * light_direction[0] + ny * light_direction[1]) + 0.1 * half) / radius,
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
    let (per_x, per_y) = (1.0 / rx, 1.0 / ry);
    let (mid_x, mid_y) = (px * per_x, py * per_y);
    let (half_x, half_y) = (half[0] * per_x.abs(), half[1] * per_y.abs());
    let (in_x, in_y) = (mid_x - half_x, mid_y - half_y);
    let (first, last) = (in_x.max(in_y), (mid_x + half_x).min(mid_y + half_y));
    // For a pixel that only touches an edge, entry and exit are the same.
    let middle = (first + last) / 2.0;
    let (enters, leaves) = (first.min(middle), last.max(middle));
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
        entry: enters.max(0.0),
        exit: leaves.max(0.0),
        shading: 0.77 + 0.22 * facing,
    }
}

fn draw_sphere(
    ball: &Sphere,
    range: &RayRange,
    context: &DrawContext,
    light_buffer: &mut LightBuffer,
) {
    let centre = ball.bottom + ball.radius;
    for run in context.rays.runs_in(range, context.tile) {
        let moved = context.moved.run(context.rays, &run);
        let [ox, oy, oz] = moved.origin.map(|of| of.as_flattened());
        let [tx, ty] = moved.direction.map(|of| of.as_flattened());
        let slopes = moved.slope.as_flattened();
        let azimuth_spacing = moved.azimuth_spacing.as_flattened();
        let slope_spacing = moved.slope_spacing.as_flattened();
        for (i, ray) in run.enumerate() {
            let slope = slopes[i];
            let scale = 1.0 / (1.0 + slope * slope).sqrt();
            let direction = [tx[i] * scale, ty[i] * scale, slope * scale];
            let to = [ball.x - ox[i], ball.y - oy[i], centre - oz[i]];
            let along = to[0] * direction[0] + to[1] * direction[1] + to[2] * direction[2];
            if along <= 0.0 {
                continue;
            }
            let square = (to[0] * to[0] + to[1] * to[1] + to[2] * to[2] - along * along).max(0.0);
            let miss = square.sqrt();
            // Pixel width across the ray: geometric mean of the spacings in azimuth and slope.
            let turn = azimuth_spacing[i] * scale;
            let rise = slope_spacing[i] * scale * scale;
            let width = along * (turn * rise).sqrt().max(1e-4);
            let covered = edge_coverage(ball.radius - miss, width);
            if covered <= 0.0 {
                continue;
            }
            let distance = along - (ball.radius * ball.radius - square).max(0.0).sqrt();
            let up = (oz[i] + distance * direction[2] - centre) / ball.radius;
            // Light from above, some reflected by the carpet, a highlight on top.
            let bright = 0.52 + 0.5 * up.clamp(-1.0, 1.0);
            let shine = 0.35 * (up - 0.82).max(0.0) / 0.18;
            light_buffer.blend(
                ray,
                covered,
                ball.colour
                    .map(|part| part * bright.max(0.12) + shine * 0.3),
            );
        }
    }
}

fn draw_panel(
    panel: &Panel,
    range: &RayRange,
    context: &DrawContext,
    light_buffer: &mut LightBuffer,
) {
    match panel.mesh {
        Some([mesh, cord]) => draw_panel_runs(panel, range, context, light_buffer, |at, width| {
            1.0 - (1.0 - net_coverage(at[0], mesh, cord, width[0]))
                * (1.0 - net_coverage(at[1], mesh, cord, width[1]))
        }),
        None => draw_panel_runs(panel, range, context, light_buffer, |_, _| 1.0),
    }
}

/// Draws a panel on every ray that may meet it; branch-free for vectorisation. `solid`: share of a footprint that the
/// panel fills, by the footprint's position along and up the panel and by its sides.
#[inline(always)]
fn draw_panel_runs(
    panel: &Panel,
    range: &RayRange,
    context: &DrawContext,
    light_buffer: &mut LightBuffer,
    solid: impl Fn([f32; 2], [f32; 2]) -> f32,
) {
    let (ex, ey) = (panel.to[0] - panel.from[0], panel.to[1] - panel.from[1]);
    let length = ex.hypot(ey).max(1e-6);
    let colour = panel.colour;
    for run in context.rays.runs_in(range, context.tile) {
        let rays = context.moved.run(context.rays, &run);
        let mut light = light_buffer.lanes(&run);
        for group in 0..rays.groups() {
            let RayLanes {
                origin: [ox, oy, oz],
                direction: [tx, ty],
                slope,
                azimuth_spacing: spacing,
                slope_spacing,
            } = rays.lanes(group);
            let mask = rays.mask(group);
            let mut part = [0.0; LANES];
            for i in 0..LANES {
                let (dx, dy) = (panel.from[0] - ox[i], panel.from[1] - oy[i]);
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
                let covered = ahead
                    * inside
                    * edge_coverage(panel.top - height, rise)
                    * edge_coverage(height, rise);
                part[i] = mask[i] * covered * solid([along, height], [across, rise]);
            }
            for (plane, colour) in light.iter_mut().zip(colour) {
                blend_lanes(&mut plane[group], &part, colour);
            }
        }
    }
}

/// Blends a colour into the light of one plane with weights `part`.
#[inline(always)]
fn blend_lanes(light: &mut Lanes, part: &Lanes, colour: f32) {
    for (light, part) in light.iter_mut().zip(part) {
        *light = part.mul_add(colour - *light, *light);
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

/// A shadow on the floor: darkest at its centre, full light at twice its radius.
#[derive(Debug, Clone, Copy)]
pub(super) struct Shadow {
    pub(super) x: f32,
    pub(super) y: f32,
    pub(super) radius: f32,
    /// Share of the light that it takes at its centre.
    pub(super) depth: f32,
    /// The object's underside, which shades the floor below it.
    pub(super) underbody: Underbody,
}

/// A square above the floor: half side, direction, and height, metres.
#[derive(Debug, Clone, Copy)]
pub(super) struct Underbody {
    pub(super) half: f32,
    pub(super) cos: f32,
    pub(super) sin: f32,
    pub(super) height: f32,
}

impl Underbody {
    /// No underside, for a ball.
    pub(super) const NONE: Underbody = Underbody {
        half: 0.0,
        cos: 1.0,
        sin: 0.0,
        height: 1.0,
    };
}

impl Shadow {
    /// Share of the light that an object on the floor takes.
    pub(super) const DEPTH: f32 = 0.5;

    /// The rays that may meet it.
    pub(super) fn ray_range(&self, rays: &SortedRays) -> RayRange {
        rays.range_of_cylinder(self.x, self.y, 2.0 * self.radius, 0.0, 0.0)
    }

    /// Darkens the floor.
    pub(super) fn draw(
        &self,
        range: &RayRange,
        context: &DrawContext,
        light_buffer: &mut LightBuffer,
    ) {
        let per_square = 0.25 / (self.radius * self.radius);
        let under = self.underbody;
        let height2 = under.height * under.height;
        for run in context.rays.runs_in(range, context.tile) {
            let count = run.len();
            let ground = context.moved.ground(&padded(&run));
            let [at_x, at_y] = ground.map(|of| of.as_chunks::<LANES>().0);
            let [red, green, blue] = light_buffer.lanes(&run);
            let places = at_x.iter().zip(at_y);
            let light = red.iter_mut().zip(green).zip(blue);
            for (group, ((at_x, at_y), ((red, green), blue))) in places.zip(light).enumerate() {
                let mask = lane_mask(count, group);
                let mut left: Lanes = [0.0; LANES];
                for i in 0..LANES {
                    let (dx, dy) = (at_x[i] - self.x, at_y[i] - self.y);
                    let inside = (1.0 - dx.mul_add(dx, dy * dy) * per_square).max(0.0);
                    // Below the body, light enters only through the gap at its edge: form factor at this depth.
                    let (across, along) = (
                        under.cos.mul_add(dx, under.sin * dy).abs(),
                        under.cos.mul_add(dy, -under.sin * dx).abs(),
                    );
                    let deep = (under.half - across.max(along)).max(0.0);
                    let slit = 1.0 - deep / deep.mul_add(deep, height2).sqrt();
                    let shaded = (1.0 - self.depth * inside * inside) * slit;
                    left[i] = 1.0 + mask[i] * (shaded - 1.0);
                }
                for plane in [red, green, blue] {
                    for (light, left) in plane.iter_mut().zip(&left) {
                        *light *= left;
                    }
                }
            }
        }
    }
}
