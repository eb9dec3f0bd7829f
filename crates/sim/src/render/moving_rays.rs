//! Where do the rays of a tile point at their rows' exposure? The robot drives and tilts while the rows are read out.

use std::ops::Range;

use super::lanes::{LANES, Lanes, RayRun, padded};
use super::rays::{SortedRays, Tile};
use super::row_transform::RowTransform;

/// Largest distance of a ground point, metres: beyond any hall.
pub(super) const RANGE_MAX: f32 = 60.0;
/// Slope below the horizon from which a ray is treated as horizontal.
const LEVEL_SLOPE: f32 = 1e-6;

/// The rays of one tile as they are during an image, level robot frame of the middle of the exposure.
#[derive(Debug)]
pub(super) struct MovedRays {
    first: usize,
    origin: [Vec<f32>; 3],
    direction: [Vec<f32>; 2],
    slope: Vec<f32>,
    /// Ground points; at `RANGE_MAX` if a ray does not meet the ground.
    ground: [Vec<f32>; 2],
}

impl MovedRays {
    /// Buffers for tiles of at most `rays_max` rays.
    pub(super) fn new(rays_max: usize) -> Self {
        let empty = || vec![0.0; rays_max + LANES];
        MovedRays {
            first: 0,
            origin: [0; 3].map(|_| empty()),
            direction: [0; 2].map(|_| empty()),
            slope: empty(),
            ground: [0; 2].map(|_| empty()),
        }
    }

    /// Moves the rays of a tile.
    pub(super) fn set_tile(&mut self, rays: &SortedRays, tile: &Tile, transform: &RowTransform) {
        self.first = tile.rays.start;
        if transform.rotation[1].iter().any(|&change| change != 0.0) {
            self.move_tile::<true>(rays, tile, transform);
        } else {
            self.move_tile::<false>(rays, tile, transform);
        }
    }

    /// `ROLLS`: the rotation differs from row to row.
    fn move_tile<const ROLLS: bool>(
        &mut self,
        rays: &SortedRays,
        tile: &Tile,
        transform: &RowTransform,
    ) {
        let run = padded(&tile.rays);
        let groups = run.len() / LANES;
        let input = InputLanes::new(rays, &run);
        let [ox, oy, oz] = self.origin.each_mut().map(|of| lanes_mut(of, groups));
        let [tx, ty] = self.direction.each_mut().map(|of| lanes_mut(of, groups));
        let slope = lanes_mut(&mut self.slope, groups);
        let [gx, gy] = self.ground.each_mut().map(|of| lanes_mut(of, groups));
        for group in 0..groups {
            let moved = move_lanes::<ROLLS>(&input, group, transform);
            ox[group] = moved.origin[0];
            oy[group] = moved.origin[1];
            oz[group] = moved.origin[2];
            tx[group] = moved.direction[0];
            ty[group] = moved.direction[1];
            slope[group] = moved.slope;
            gx[group] = moved.ground[0];
            gy[group] = moved.ground[1];
        }
    }

    /// A run of the tile's rays.
    pub(super) fn run<'a>(&'a self, rays: &'a SortedRays, run: &Range<usize>) -> RayRun<'a> {
        let count = run.len();
        let run = padded(run);
        let own = run.start - self.first..run.end - self.first;
        let lanes = |of: &'a [f32]| of[own.clone()].as_chunks().0;
        RayRun {
            count,
            origin: self.origin.each_ref().map(|of| lanes(of)),
            direction: self.direction.each_ref().map(|of| lanes(of)),
            slope: lanes(&self.slope),
            azimuth_spacing: rays.azimuth_spacing[run.clone()].as_chunks().0,
            slope_spacing: rays.slope_spacing[run].as_chunks().0,
        }
    }

    /// Ground points of a run.
    pub(super) fn ground(&self, run: &Range<usize>) -> [&[f32]; 2] {
        self.ground
            .each_ref()
            .map(|of| &of[run.start - self.first..run.end - self.first])
    }
}

/// The rays of a tile at rest, in groups.
struct InputLanes<'a> {
    origin: [&'a [Lanes]; 3],
    direction: [&'a [Lanes]; 2],
    slope: &'a [Lanes],
    row: &'a [Lanes],
}

impl<'a> InputLanes<'a> {
    fn new(rays: &'a SortedRays, run: &Range<usize>) -> Self {
        let groups = run.len() / LANES;
        let lanes = |of: &'a [f32]| &of[run.start..].as_chunks().0[..groups];
        InputLanes {
            origin: [
                lanes(&rays.origin_x),
                lanes(&rays.origin_y),
                lanes(&rays.origin_z),
            ],
            direction: [lanes(&rays.direction_x), lanes(&rays.direction_y)],
            slope: lanes(&rays.slope),
            row: lanes(&rays.row),
        }
    }
}

fn lanes_mut(of: &mut [f32], groups: usize) -> &mut [Lanes] {
    &mut of.as_chunks_mut().0[..groups]
}

/// Some rays that were moved, and their ground points.
struct MovedLanes {
    origin: [Lanes; 3],
    direction: [Lanes; 2],
    slope: Lanes,
    ground: [Lanes; 2],
}

/// Moves a group of rays. `ROLLS`: the rotation differs from row to row.
#[inline(always)]
fn move_lanes<const ROLLS: bool>(
    input: &InputLanes,
    group: usize,
    transform: &RowTransform,
) -> MovedLanes {
    let [x0, y0, z0] = input.origin.map(|of| &of[group]);
    let [dx, dy] = input.direction.map(|of| &of[group]);
    let (slopes, rows) = (&input.slope[group], &input.row[group]);
    let [m, n] = &transform.rotation;
    let [vx, vy] = transform.shift;
    let zero = [0.0; LANES];
    let mut out = MovedLanes {
        origin: [zero; 3],
        direction: [zero; 2],
        slope: zero,
        ground: [zero; 2],
    };
    for i in 0..LANES {
        let t = rows[i];
        let r: [f32; 9] = std::array::from_fn(|k| if ROLLS { t.mul_add(n[k], m[k]) } else { m[k] });
        let rotate = |x: f32, y: f32, z: f32| {
            [0, 3, 6].map(|k| r[k].mul_add(x, r[k + 1].mul_add(y, r[k + 2] * z)))
        };
        let [px, py, pz] = rotate(dx[i], dy[i], slopes[i]);
        let per = 1.0 / px.mul_add(px, py * py).max(1e-12).sqrt();
        let (tx, ty, slope) = (px * per, py * per, pz * per);
        let [x, y, oz] = rotate(x0[i], y0[i], z0[i]);
        let (ox, oy) = (t.mul_add(vx, x), t.mul_add(vy, y));
        let distance = (oz / (-slope).max(LEVEL_SLOPE)).min(RANGE_MAX);
        (out.origin[0][i], out.origin[1][i], out.origin[2][i]) = (ox, oy, oz);
        (out.direction[0][i], out.direction[1][i], out.slope[i]) = (tx, ty, slope);
        out.ground[0][i] = distance.mul_add(tx, ox);
        out.ground[1][i] = distance.mul_add(ty, oy);
    }
    out
}
