//! What stands in the view? Cylinders, boxes, balls and nets, drawn over what lies behind them with soft edges.

use super::ground::Ground;
use super::light_buffer::LightBuffer;
use super::rays::{RayRange, RayRun, SortedRays, Tile};

/// Something upright: the same outline from bottom to top; robot frame.
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

/// A solid's outline seen from above.
#[derive(Debug, Clone, Copy)]
pub(super) enum Outline {
    Circle {
        radius: f32,
    },
    /// Half sides, and the direction of the first.
    Box {
        half: [f32; 2],
        cos: f32,
        sin: f32,
    },
}

/// A ball on the ground, robot frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sphere {
    pub(super) x: f32,
    pub(super) y: f32,
    pub(super) radius: f32,
    pub(super) colour: [f32; 3],
}

/// An upright screen between two points, robot frame: a net, or a wall.
#[derive(Debug, Clone, Copy)]
pub(super) struct Panel {
    pub(super) from: [f32; 2],
    pub(super) to: [f32; 2],
    pub(super) top: f32,
    pub(super) colour: [f32; 3],
    /// A net's mesh and cord, metres; a wall has none.
    pub(super) mesh: Option<[f32; 2]>,
}

/// What has a place in the order from far to near.
#[derive(Debug, Clone, Copy)]
pub(super) enum Primitive {
    Solid(Solid),
    Sphere(Sphere),
    Panel(Panel),
}

/// Where a lamp's light comes from, for the shading of sides: a unit vector in the robot frame.
pub(super) type LightDirection = [f32; 2];

/// How a ray meets an outline: the covered part of the pixel, the ways in and out, and the face's brightness.
#[derive(Clone, Copy)]
struct Chord {
    covered: f32,
    entry: f32,
    exit: f32,
    shading: f32,
}

/// A ray beside a solid: the way to the centre and the distance to its left, and the ray's direction.
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

/// Where and through which rays a piece is drawn.
pub(super) struct DrawContext<'a> {
    pub(super) rays: &'a SortedRays,
    pub(super) tile: &'a Tile,
    pub(super) light_direction: LightDirection,
}

impl Primitive {
    /// The rays that may meet it.
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
                rays.range_of_cylinder(ball.x, ball.y, ball.radius, 0.0, 2.0 * ball.radius)
            }
            Primitive::Panel(Panel { from, to, top, .. }) => {
                let (mx, my) = ((from[0] + to[0]) / 2.0, (from[1] + to[1]) / 2.0);
                let half = (to[0] - from[0]).hypot(to[1] - from[1]) / 2.0;
                rays.range_of_cylinder(mx, my, half, 0.0, *top)
            }
        }
    }

    /// Draws it over what is behind it.
    pub(super) fn draw(&self, reach: &RayRange, brush: &DrawContext, plate: &mut LightBuffer) {
        match self {
            Primitive::Solid(solid) => draw_solid(solid, reach, brush, plate),
            Primitive::Sphere(sphere) => draw_sphere(sphere, reach, brush, plate),
            Primitive::Panel(screen) => draw_panel(screen, reach, brush, plate),
        }
    }
}

/// Part of a pixel of width `width` inside an edge that lies `inside` further out.
#[inline(always)]
fn edge(inside: f32, width: f32) -> f32 {
    (inside / width + 0.5).clamp(0.0, 1.0)
}

fn draw_solid(solid: &Solid, reach: &RayRange, brush: &DrawContext, plate: &mut LightBuffer) {
    let lamp = brush.light_direction;
    match solid.outline {
        Outline::Circle { radius } => draw_solid_runs(solid, reach, brush, plate, |beside| {
            chord_of_circle(radius, lamp, beside)
        }),
        Outline::Box { half, cos, sin } => {
            // The lamp in the box's own axes.
            let lamp = [cos * lamp[0] + sin * lamp[1], cos * lamp[1] - sin * lamp[0]];
            draw_solid_runs(solid, reach, brush, plate, |beside| {
                chord_of_box(half, (sin, cos), lamp, beside)
            });
        }
    }
}

/// Draws a solid over every ray that may meet it; without branches, so that eight rays go at once.
#[inline(always)]
fn draw_solid_runs(
    solid: &Solid,
    reach: &RayRange,
    brush: &DrawContext,
    plate: &mut LightBuffer,
    chord: impl Fn(RayOffset) -> Chord,
) {
    for run in brush.rays.runs_in(reach, brush.tile) {
        let [red, green, blue] = plate.planes(&run);
        let RayRun {
            origin: [ox, oy, oz],
            direction: [tx, ty],
            slope,
            azimuth_spacing: spacing,
            slope_spacing,
        } = brush.rays.run(&run);
        for i in 0..slope.len() {
            let (dx, dy) = (solid.x - ox[i], solid.y - oy[i]);
            let along = dx * tx[i] + dy * ty[i];
            let chord = chord(RayOffset {
                dx,
                dy,
                tx: tx[i],
                ty: ty[i],
                along,
                across: dx * ty[i] - dy * tx[i],
                width: along.max(0.05) * spacing[i] + 1e-4,
            });
            let (z_in, z_out) = (
                oz[i] + slope[i] * chord.entry,
                oz[i] + slope[i] * chord.exit,
            );
            // How far apart neighbouring rays are in height, where they go in and where they come out.
            let per_way = slope_spacing[i];
            let (w_in, w_out) = (chord.entry * per_way + 1e-4, chord.exit * per_way + 1e-4);
            let falls = slope[i] < 0.0;
            let (low, w_low) = if falls { (z_out, w_out) } else { (z_in, w_in) };
            let (high, w_high) = if falls { (z_in, w_in) } else { (z_out, w_out) };
            let under_top = edge(solid.top - low, w_low);
            let covered = chord.covered * under_top * edge(high - solid.bottom, w_high);
            let cap = edge(z_in - solid.top, w_in);
            let side = chord.shading * (1.0 - cap);
            red[i] += covered * (side * solid.side[0] + cap * solid.cap[0] - red[i]);
            green[i] += covered * (side * solid.side[1] + cap * solid.cap[1] - green[i]);
            blue[i] += covered * (side * solid.side[2] + cap * solid.cap[2] - blue[i]);
        }
    }
}

#[inline(always)]
fn chord_of_circle(radius: f32, lamp: LightDirection, beside: RayOffset) -> Chord {
    let RayOffset {
        tx,
        ty,
        along,
        across,
        width,
        ..
    } = beside;
    let half = (radius * radius - across * across).max(0.0).sqrt();
    let ahead = if along + half > 0.0 { 1.0 } else { 0.0 };
    // The normal where the ray enters, against the lamp and against the ray.
    let (nx, ny) = (-half * tx - across * ty, -half * ty + across * tx);
    Chord {
        covered: edge(radius - across.abs(), width) * ahead,
        entry: (along - half).max(0.0),
        exit: (along + half).max(0.0),
        shading: 0.72 + (0.22 * (nx * lamp[0] + ny * lamp[1]) + 0.1 * half) / radius,
    }
}

/// `axes`: sine and cosine of the box's direction; `lamp`: in the box's own axes.
#[inline(always)]
fn chord_of_box(
    half: [f32; 2],
    (sin, cos): (f32, f32),
    lamp: LightDirection,
    beside: RayOffset,
) -> Chord {
    let RayOffset {
        dx,
        dy,
        tx,
        ty,
        across,
        width,
        ..
    } = beside;
    // Ray and centre in the box's own axes; a ray along a side still has some slant.
    let (px, py) = (cos * dx + sin * dy, cos * dy - sin * dx);
    let slanted = |rate: f32| if rate.abs() < 1e-6 { 1e-6 } else { rate };
    let (rx, ry) = (slanted(cos * tx + sin * ty), slanted(cos * ty - sin * tx));
    let (per_x, per_y) = (1.0 / rx, 1.0 / ry);
    let (mid_x, mid_y) = (px * per_x, py * per_y);
    let (half_x, half_y) = (half[0] * per_x.abs(), half[1] * per_y.abs());
    let (in_x, in_y) = (mid_x - half_x, mid_y - half_y);
    let (first, last) = (in_x.max(in_y), (mid_x + half_x).min(mid_y + half_y));
    // A pixel that only touches an edge: both ways are the edge's.
    let middle = (first + last) / 2.0;
    let (enters, leaves) = (first.min(middle), last.max(middle));
    let ahead = if leaves > 0.0 { 1.0 } else { 0.0 };
    let facing = if in_x > in_y {
        -lamp[0].copysign(lamp[0] * rx)
    } else {
        -lamp[1].copysign(lamp[1] * ry)
    };
    Chord {
        covered: edge(
            half[0] * ry.abs() + half[1] * rx.abs() - across.abs(),
            width,
        ) * ahead,
        entry: enters.max(0.0),
        exit: leaves.max(0.0),
        shading: 0.77 + 0.22 * facing,
    }
}

fn draw_sphere(ball: &Sphere, reach: &RayRange, brush: &DrawContext, plate: &mut LightBuffer) {
    let rays = brush.rays;
    for run in rays.runs_in(reach, brush.tile) {
        for ray in run {
            let slope = rays.slope[ray];
            let scale = 1.0 / (1.0 + slope * slope).sqrt();
            let direction = [
                rays.direction_x[ray] * scale,
                rays.direction_y[ray] * scale,
                slope * scale,
            ];
            let to = [
                ball.x - rays.origin_x[ray],
                ball.y - rays.origin_y[ray],
                ball.radius - rays.origin_z[ray],
            ];
            let along = to[0] * direction[0] + to[1] * direction[1] + to[2] * direction[2];
            if along <= 0.0 {
                continue;
            }
            let square = (to[0] * to[0] + to[1] * to[1] + to[2] * to[2] - along * along).max(0.0);
            let miss = square.sqrt();
            // The pixel's width across the ray: between its spacings in azimuth and in slope.
            let turn = rays.azimuth_spacing[ray] * scale;
            let rise = rays.slope_spacing[ray] * scale * scale;
            let width = along * (turn * rise).sqrt().max(1e-4);
            let covered = edge(ball.radius - miss, width);
            if covered <= 0.0 {
                continue;
            }
            let way = along - (ball.radius * ball.radius - square).max(0.0).sqrt();
            let up = (rays.origin_z[ray] + way * direction[2] - ball.radius) / ball.radius;
            // Light from above, some back from the carpet, a highlight on top.
            let bright = 0.52 + 0.5 * up.clamp(-1.0, 1.0);
            let shine = 0.35 * (up - 0.82).max(0.0) / 0.18;
            plate.blend(
                ray,
                covered,
                ball.colour
                    .map(|part| part * bright.max(0.12) + shine * 0.3),
            );
        }
    }
}

fn draw_panel(screen: &Panel, reach: &RayRange, brush: &DrawContext, plate: &mut LightBuffer) {
    match screen.mesh {
        Some([mesh, cord]) => draw_panel_runs(screen, reach, brush, plate, |at, width| {
            1.0 - (1.0 - net_coverage(at[0], mesh, cord, width[0]))
                * (1.0 - net_coverage(at[1], mesh, cord, width[1]))
        }),
        None => draw_panel_runs(screen, reach, brush, plate, |_, _| 1.0),
    }
}

/// Draws a screen over every ray that may meet it; without branches, so that eight rays go at once. `solid`: how much
/// of a footprint the screen fills, by its place along and up the screen and by its sides.
#[inline(always)]
fn draw_panel_runs(
    screen: &Panel,
    reach: &RayRange,
    brush: &DrawContext,
    plate: &mut LightBuffer,
    solid: impl Fn([f32; 2], [f32; 2]) -> f32,
) {
    let (ex, ey) = (screen.to[0] - screen.from[0], screen.to[1] - screen.from[1]);
    let length = ex.hypot(ey).max(1e-6);
    let colour = screen.colour;
    for run in brush.rays.runs_in(reach, brush.tile) {
        let [red, green, blue] = plate.planes(&run);
        let RayRun {
            origin: [ox, oy, oz],
            direction: [tx, ty],
            slope,
            azimuth_spacing: spacing,
            slope_spacing,
        } = brush.rays.run(&run);
        for i in 0..slope.len() {
            let (dx, dy) = (screen.from[0] - ox[i], screen.from[1] - oy[i]);
            let cross = tx[i] * ey - ty[i] * ex;
            // A ray along the screen misses it.
            let per_cross = 1.0 / cross.abs().max(1e-6).copysign(cross);
            let way = (dx * ey - dy * ex) * per_cross;
            let ahead = if way > 0.0 { 1.0 } else { 0.0 };
            let way = way.max(0.0);
            let along = (dx * ty[i] - dy * tx[i]) * per_cross * length;
            let height = oz[i] + slope[i] * way;
            // Seen at a slant the screen's own metres are longer.
            let across = way * spacing[i] * length * per_cross.abs() + 1e-4;
            let rise = way * slope_spacing[i] + 1e-4;
            let inside = edge(along, across) * edge(length - along, across);
            let covered = ahead * inside * edge(screen.top - height, rise) * edge(height, rise);
            let part = covered * solid([along, height], [across, rise]);
            red[i] += part * (colour[0] - red[i]);
            green[i] += part * (colour[1] - green[i]);
            blue[i] += part * (colour[2] - blue[i]);
        }
    }
}

/// The part of a footprint that cords of a net cover.
#[inline(always)]
fn net_coverage(at: f32, mesh: f32, cord: f32, width: f32) -> f32 {
    let meshes = at / mesh;
    let off = (meshes - meshes.round_ties_even()).abs() * mesh;
    let fine = ((cord / 2.0 + width / 2.0 - off) / width).clamp(0.0, (cord / width).min(1.0));
    if width >= mesh { cord / mesh } else { fine }
}

/// Something's shadow on the floor: half the light in its middle, none lost at twice its radius.
#[derive(Debug, Clone, Copy)]
pub(super) struct Shadow {
    pub(super) x: f32,
    pub(super) y: f32,
    pub(super) radius: f32,
    /// What stands this low above the floor takes the light from beneath itself too.
    pub(super) underbody: Underbody,
}

/// A square that hangs above the floor: half its side, its direction, and its height above the floor, metres.
#[derive(Debug, Clone, Copy)]
pub(super) struct Underbody {
    pub(super) half: f32,
    pub(super) cos: f32,
    pub(super) sin: f32,
    pub(super) height: f32,
}

impl Underbody {
    /// A ball rolls on a point.
    pub(super) const NONE: Underbody = Underbody {
        half: 0.0,
        cos: 1.0,
        sin: 0.0,
        height: 1.0,
    };
}

impl Shadow {
    /// The rays that may meet it.
    pub(super) fn ray_range(&self, rays: &SortedRays) -> RayRange {
        rays.range_of_cylinder(self.x, self.y, 2.0 * self.radius, 0.0, 0.0)
    }

    /// Darkens the floor.
    pub(super) fn draw(
        &self,
        reach: &RayRange,
        brush: &DrawContext,
        ground: &Ground,
        plate: &mut LightBuffer,
    ) {
        let per_square = 0.25 / (self.radius * self.radius);
        let under = self.underbody;
        let height2 = under.height * under.height;
        for run in brush.rays.runs_in(reach, brush.tile) {
            let [red, green, blue] = plate.planes(&run);
            let (at_x, at_y) = (&ground.x[run.clone()], &ground.y[run]);
            for i in 0..at_x.len() {
                let (dx, dy) = (at_x[i] - self.x, at_y[i] - self.y);
                let inside = (1.0 - (dx * dx + dy * dy) * per_square).max(0.0);
                // Beneath, light comes in through the slit between the edge and the floor alone: a far wall's form
                // factor seen from so deep inside.
                let (across, along) = (
                    (under.cos * dx + under.sin * dy).abs(),
                    (under.cos * dy - under.sin * dx).abs(),
                );
                let deep = (under.half - across.max(along)).max(0.0);
                let slit = 1.0 - deep / (deep * deep + height2).sqrt();
                let left = (1.0 - 0.5 * inside * inside) * slit;
                red[i] *= left;
                green[i] *= left;
                blue[i] *= left;
            }
        }
    }
}
