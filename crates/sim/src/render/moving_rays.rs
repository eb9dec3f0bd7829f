//! Where do the rays of a tile point at their rows' exposure? The robot drives and tilts while the rows are read out.

use std::ops::Range;

use super::rays::{LANES, RayRun, SortedRays, Tile, padded};
use super::row_transform::RowTransform;

/// Largest distance of a ground point, metres: beyond any hall.
pub(super) const RANGE_MAX: f32 = 60.0;
/// Slope below the horizon from which a ray is treated as horizontal.
const LEVEL_SLOPE: f32 = 1e-6;

/// Rays that are moved at once.
const BLOCK: usize = 64;

/// Components of rays that are moved at once: origin, direction, slope, ground point, displacement.
type Lanes = [[f32; BLOCK]; 10];

/// The rays of one tile as they are during an image, level robot frame of the middle of the exposure.
#[derive(Debug)]
pub(super) struct MovedRays {
    first: usize,
    /// The rays of a run, before they are copied to the tile's.
    lanes: Box<Lanes>,
    origin: [Vec<f32>; 3],
    direction: [Vec<f32>; 2],
    slope: Vec<f32>,
    /// Ground points; at `RANGE_MAX` if a ray does not meet the ground.
    ground: [Vec<f32>; 2],
    /// Displacement of each ground point against the robot at rest and upright.
    shift: [Vec<f32>; 2],
}

impl MovedRays {
    /// Buffers for tiles of at most `rays_max` rays.
    pub(super) fn new(rays_max: usize) -> Self {
        let empty = || vec![0.0; rays_max + LANES];
        MovedRays {
            first: 0,
            lanes: Box::new([[0.0; BLOCK]; 10]),
            origin: [0; 3].map(|_| empty()),
            direction: [0; 2].map(|_| empty()),
            slope: empty(),
            ground: [0; 2].map(|_| empty()),
            shift: [0; 2].map(|_| empty()),
        }
    }

    /// Moves the rays of a tile; `ground`: their ground points at rest.
    pub(super) fn set_tile(
        &mut self,
        rays: &SortedRays,
        tile: &Tile,
        transform: &RowTransform,
        ground: [&[f32]; 2],
    ) {
        self.first = tile.rays.start;
        let rolls = transform.rotation[1].iter().any(|&change| change != 0.0);
        for start in tile.rays.clone().step_by(BLOCK) {
            let run = start..(start + BLOCK).min(tile.rays.end);
            let own = run.start - self.first..run.end - self.first;
            if rolls {
                move_run::<true>(rays, run, transform, ground, &mut self.lanes);
            } else {
                move_run::<false>(rays, run, transform, ground, &mut self.lanes);
            }
            self.keep_run(own);
        }
    }

    /// Copies the moved rays to these places of the tile.
    fn keep_run(&mut self, own: Range<usize>) {
        let count = own.len().min(BLOCK);
        let [ox, oy, oz, tx, ty, slope, gx, gy, sx, sy] = &*self.lanes;
        for (values, moved) in self
            .origin
            .iter_mut()
            .chain(&mut self.direction)
            .chain([&mut self.slope])
            .chain(&mut self.ground)
            .chain(&mut self.shift)
            .zip([ox, oy, oz, tx, ty, slope, gx, gy, sx, sy])
        {
            values[own.clone()].copy_from_slice(&moved[..count]);
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

    /// Displacements of the tile's ground points, by the index of the ray in the tile.
    pub(super) fn shift(&self) -> [&[f32]; 2] {
        self.shift.each_ref().map(|of| &of[..])
    }
}

/// Moves at most `BLOCK` rays. `ROLLS`: the rotation differs from row to row.
///
/// A function of its own with a buffer as an argument: the compiler knows that results do not overlap the inputs, and
/// vectorises.
#[inline(never)]
fn move_run<const ROLLS: bool>(
    rays: &SortedRays,
    run: Range<usize>,
    transform: &RowTransform,
    ground: [&[f32]; 2],
    out: &mut Lanes,
) {
    let count = run.len().min(BLOCK);
    let [x0, y0, z0] =
        [&rays.origin_x, &rays.origin_y, &rays.origin_z].map(|of| &of[run.clone()][..count]);
    let [dx, dy] = [&rays.direction_x, &rays.direction_y].map(|of| &of[run.clone()][..count]);
    let slopes = &rays.slope[run.clone()][..count];
    let rows = &rays.row[run.clone()][..count];
    let [rest_x, rest_y] = ground.map(|of| &of[run.clone()][..count]);
    let [ox, oy, oz, tx, ty, slope, gx, gy, sx, sy] = out;
    let [m, n] = transform.rotation;
    let [vx, vy] = transform.shift;
    for i in 0..count {
        let t = rows[i];
        let r: [f32; 9] = std::array::from_fn(|k| if ROLLS { m[k] + t * n[k] } else { m[k] });
        let (x, y, z) = (dx[i], dy[i], slopes[i]);
        let (px, py, pz) = (
            r[0] * x + r[1] * y + r[2] * z,
            r[3] * x + r[4] * y + r[5] * z,
            r[6] * x + r[7] * y + r[8] * z,
        );
        let per = 1.0 / (px * px + py * py).max(1e-12).sqrt();
        (tx[i], ty[i], slope[i]) = (px * per, py * per, pz * per);
        let (x, y, z) = (x0[i], y0[i], z0[i]);
        ox[i] = r[0] * x + r[1] * y + r[2] * z + t * vx;
        oy[i] = r[3] * x + r[4] * y + r[5] * z + t * vy;
        oz[i] = r[6] * x + r[7] * y + r[8] * z;
        let distance = (oz[i] / (-slope[i]).max(LEVEL_SLOPE)).min(RANGE_MAX);
        gx[i] = ox[i] + distance * tx[i];
        gy[i] = oy[i] + distance * ty[i];
        sx[i] = gx[i] - rest_x[i];
        sy[i] = gy[i] - rest_y[i];
    }
}
