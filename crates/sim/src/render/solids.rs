//! What stands in the view? Cylinders, boxes, balls and nets, drawn over what lies behind them with soft edges.

use super::ground::Ground;
use super::rays::Rays;

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
pub(super) struct Screen {
    pub(super) from: [f32; 2],
    pub(super) to: [f32; 2],
    pub(super) top: f32,
    pub(super) colour: [f32; 3],
    /// A net's mesh and cord, metres; a wall has none.
    pub(super) mesh: Option<[f32; 2]>,
}

/// What has a place in the order from far to near.
#[derive(Debug, Clone, Copy)]
pub(super) enum Piece {
    Solid(Solid),
    Sphere(Sphere),
    Screen(Screen),
}

/// Where a lamp's light comes from, for the shading of sides: a unit vector in the robot frame.
pub(super) type Lamp = [f32; 2];

/// How a ray meets an outline: the covered part of the pixel, the ways in and out, and the face's brightness.
struct Chord {
    covered: f32,
    enters: f32,
    leaves: f32,
    facing: f32,
}

pub(super) fn draw(piece: &Piece, rays: &Rays, lamp: Lamp, light: &mut [Vec<f32>; 3]) {
    match piece {
        Piece::Solid(solid) => draw_solid(solid, rays, lamp, light),
        Piece::Sphere(sphere) => draw_sphere(sphere, rays, light),
        Piece::Screen(screen) => draw_screen(screen, rays, light),
    }
}

fn blend(light: &mut [Vec<f32>; 3], ray: usize, part: f32, colour: [f32; 3]) {
    for (plane, colour) in light.iter_mut().zip(colour) {
        plane[ray] += part * (colour - plane[ray]);
    }
}

/// Part of a pixel of width `width` inside an edge that lies `inside` further out.
fn edge(inside: f32, width: f32) -> f32 {
    (inside / width + 0.5).clamp(0.0, 1.0)
}

pub(super) fn draw_solid(solid: &Solid, rays: &Rays, lamp: Lamp, light: &mut [Vec<f32>; 3]) {
    let radius = match solid.outline {
        Outline::Circle { radius } => radius,
        Outline::Box { half, .. } => half[0].hypot(half[1]),
    };
    for run in rays.around(solid.x, solid.y, radius, solid.bottom, solid.top) {
        for ray in run {
            let Some(chord) = chord(solid, rays, ray, lamp) else {
                continue;
            };
            let (height, slope) = (rays.origin_z[ray], rays.slope[ray]);
            let (z_in, z_out) = (height + slope * chord.enters, height + slope * chord.leaves);
            let width = chord.enters.max(0.0) * rays.slope_spacing[ray] + 1e-4;
            let (low, high) = (z_in.min(z_out), z_in.max(z_out));
            let covered =
                chord.covered * edge(solid.top - low, width) * edge(high - solid.bottom, width);
            if covered <= 0.0 {
                continue;
            }
            let over_cap = edge(z_in - solid.top, width);
            let colour = std::array::from_fn(|c| {
                let side = solid.side[c] * chord.facing;
                side + over_cap * (solid.cap[c] - side)
            });
            blend(light, ray, covered, colour);
        }
    }
}

fn chord(solid: &Solid, rays: &Rays, ray: usize, lamp: Lamp) -> Option<Chord> {
    let (dx, dy) = (solid.x - rays.origin_x[ray], solid.y - rays.origin_y[ray]);
    let (tx, ty) = (rays.towards_x[ray], rays.towards_y[ray]);
    let (along, across) = (dx * tx + dy * ty, dx * ty - dy * tx);
    let width = along.max(0.05) * rays.spacing[ray] + 1e-4;
    match solid.outline {
        Outline::Circle { radius } => {
            let covered = edge(radius - across.abs(), width);
            let half = (radius * radius - across * across).max(0.0).sqrt();
            if covered <= 0.0 || along + half <= 0.0 {
                return None;
            }
            // The normal where the ray enters, against the lamp and against the ray.
            let (nx, ny) = (
                (-half * tx - across * ty) / radius,
                (-half * ty + across * tx) / radius,
            );
            Some(Chord {
                covered,
                enters: (along - half).max(0.0),
                leaves: along + half,
                facing: 0.72 + 0.22 * (nx * lamp[0] + ny * lamp[1]) + 0.1 * half / radius,
            })
        }
        Outline::Box { half, cos, sin } => {
            // Ray and centre in the box's own axes.
            let (px, py) = (cos * dx + sin * dy, -sin * dx + cos * dy);
            let (rx, ry) = (cos * tx + sin * ty, -sin * tx + cos * ty);
            let reach = half[0] * ry.abs() + half[1] * rx.abs();
            let covered = edge(reach - across.abs(), width);
            if covered <= 0.0 {
                return None;
            }
            let slab = |p: f32, r: f32, half: f32| {
                let r = if r.abs() < 1e-6 {
                    1e-6f32.copysign(r)
                } else {
                    r
                };
                let (a, b) = ((p - half) / r, (p + half) / r);
                (a.min(b), a.max(b))
            };
            let (in_x, out_x) = slab(px, rx, half[0]);
            let (in_y, out_y) = slab(py, ry, half[1]);
            let (mut enters, mut leaves) = (in_x.max(in_y), out_x.min(out_y));
            if enters > leaves {
                // A pixel that only touches an edge: both ways are the edge's.
                enters = (enters + leaves) / 2.0;
                leaves = enters;
            }
            if leaves <= 0.0 {
                return None;
            }
            let (nx, ny) = if in_x > in_y {
                (-rx.signum(), 0.0)
            } else {
                (0.0, -ry.signum())
            };
            let (nx, ny) = (cos * nx - sin * ny, sin * nx + cos * ny);
            Some(Chord {
                covered,
                enters: enters.max(0.0),
                leaves,
                facing: 0.77 + 0.22 * (nx * lamp[0] + ny * lamp[1]),
            })
        }
    }
}

fn draw_sphere(ball: &Sphere, rays: &Rays, light: &mut [Vec<f32>; 3]) {
    for run in rays.around(ball.x, ball.y, ball.radius, 0.0, 2.0 * ball.radius) {
        for ray in run {
            let slope = rays.slope[ray];
            let scale = 1.0 / (1.0 + slope * slope).sqrt();
            let direction = [
                rays.towards_x[ray] * scale,
                rays.towards_y[ray] * scale,
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
            let turn = rays.spacing[ray] * scale;
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
            blend(
                light,
                ray,
                covered,
                ball.colour
                    .map(|part| part * bright.max(0.12) + shine * 0.3),
            );
        }
    }
}

fn draw_screen(screen: &Screen, rays: &Rays, light: &mut [Vec<f32>; 3]) {
    let (ex, ey) = (screen.to[0] - screen.from[0], screen.to[1] - screen.from[1]);
    let length = ex.hypot(ey).max(1e-6);
    let (mx, my) = (
        (screen.from[0] + screen.to[0]) / 2.0,
        (screen.from[1] + screen.to[1]) / 2.0,
    );
    for run in rays.around(mx, my, length / 2.0, 0.0, screen.top) {
        for ray in run {
            let (dx, dy) = (
                screen.from[0] - rays.origin_x[ray],
                screen.from[1] - rays.origin_y[ray],
            );
            let (tx, ty) = (rays.towards_x[ray], rays.towards_y[ray]);
            let cross = tx * ey - ty * ex;
            if cross.abs() < 1e-6 {
                continue;
            }
            let way = (dx * ey - dy * ex) / cross;
            if way <= 0.0 {
                continue;
            }
            let along = (dx * ty - dy * tx) / cross * length;
            let height = rays.origin_z[ray] + rays.slope[ray] * way;
            // Seen at a slant the screen's own metres are longer.
            let across = way * rays.spacing[ray] * length / cross.abs() + 1e-4;
            let rise = way * rays.slope_spacing[ray] + 1e-4;
            let inside = edge(along, across) * edge(length - along, across);
            let covered = inside * edge(screen.top - height, rise) * edge(height, rise);
            if covered <= 0.0 {
                continue;
            }
            let solid = screen.mesh.map_or(1.0, |[mesh, cord]| {
                1.0 - (1.0 - cords(along, mesh, cord, across))
                    * (1.0 - cords(height, mesh, cord, rise))
            });
            blend(light, ray, covered * solid, screen.colour);
        }
    }
}

/// The part of a footprint that cords of a net cover.
fn cords(at: f32, mesh: f32, cord: f32, width: f32) -> f32 {
    if width >= mesh {
        return cord / mesh;
    }
    let off = (at / mesh - (at / mesh).round()).abs() * mesh;
    ((cord / 2.0 + width / 2.0 - off) / width).clamp(0.0, (cord / width).min(1.0))
}

/// Darkens the floor about something that stands there: half the light in its middle, none lost at twice its radius.
pub(super) fn draw_shadow(
    x: f32,
    y: f32,
    radius: f32,
    rays: &Rays,
    ground: &Ground,
    light: &mut [Vec<f32>; 3],
) {
    let far = 2.0 * radius;
    for run in rays.around(x, y, far, 0.0, 0.0) {
        for ray in run {
            let (dx, dy) = (ground.x[ray] - x, ground.y[ray] - y);
            let distance2 = (dx * dx + dy * dy) / (far * far);
            if distance2 < 1.0 {
                let left = 1.0 - 0.5 * (1.0 - distance2).powi(2);
                for plane in light.iter_mut() {
                    plane[ray] *= left;
                }
            }
        }
    }
}
