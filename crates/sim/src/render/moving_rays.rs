//! Where do the rays of a block point at their rows' exposure? The robot drives and tilts while the rows are read out.

use localize::frames::Pose;

use super::blocks::{Block, BlockRays, LinearValues};
use super::lanes::{BlockValues, LANES, Lanes, Vector, larger, splat};
use super::row_transform::RowTransform;

/// Largest distance of a ground point, metres: beyond any hall.
pub(super) const RANGE_MAX: f32 = 60.0;
/// Slope below the horizon from which a ray is treated as horizontal.
const LEVEL_SLOPE: f32 = 1e-6;

/// `LANES` rays.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct RayLanes {
    pub(super) origin: [Lanes; 3],
    /// Horizontal direction, unit length.
    pub(super) direction: [Lanes; 2],
    /// Height per horizontal metre.
    pub(super) slope: Lanes,
}

/// The rays of a block as they are during an image, level robot frame of the middle of the exposure.
pub(super) struct MovedBlock {
    pub(super) rows: [RayLanes; LANES],
    /// Azimuth and slope between neighbouring pixels' rays times the blur.
    pub(super) spacing: [BlockValues; 2],
    is_set: bool,
}

/// Moves rays of one image row.
#[inline(always)]
pub(super) fn move_lanes(rays: &RayLanes, r: &[f32; 9], shift: [f32; 2]) -> RayLanes {
    let mut out = RayLanes::default();
    for i in 0..LANES {
        let rotate = |x: f32, y: f32, z: f32| {
            [0, 3, 6].map(|k| r[k].mul_add(x, r[k + 1].mul_add(y, r[k + 2] * z)))
        };
        let [px, py, pz] = rotate(rays.direction[0][i], rays.direction[1][i], rays.slope[i]);
        let per = 1.0 / larger(px.mul_add(px, py * py), 1e-12).sqrt();
        let [x, y, z] = rotate(rays.origin[0][i], rays.origin[1][i], rays.origin[2][i]);
        (out.direction[0][i], out.direction[1][i]) = (px * per, py * per);
        out.slope[i] = pz * per;
        (out.origin[0][i], out.origin[1][i]) = (x + shift[0], y + shift[1]);
        out.origin[2][i] = z;
    }
    out
}

impl RayLanes {
    /// Distances to the ground; `RANGE_MAX` if a ray does not meet it.
    #[inline(always)]
    pub(super) fn ground_distance(&self) -> Lanes {
        let fall = (-Vector::new(self.slope)).fast_max(splat(LEVEL_SLOPE));
        let distance = Vector::new(self.origin[2]) / fall;
        distance.fast_min(splat(RANGE_MAX)).to_array()
    }

    /// Ground points.
    #[inline(always)]
    pub(super) fn ground(&self) -> [Lanes; 2] {
        let distance = Vector::new(self.ground_distance());
        [0, 1].map(|k| {
            let (direction, origin) = (Vector::new(self.direction[k]), Vector::new(self.origin[k]));
            distance.mul_add(direction, origin).to_array()
        })
    }

    /// Ground points in the field frame, for the robot at a pose, and sine and cosine of its direction.
    #[inline(always)]
    pub(super) fn ground_in_field(&self, pose: Pose, (sin, cos): (f32, f32)) -> [Lanes; 2] {
        let [x, y] = self.ground().map(Vector::new);
        let [sin, cos] = [sin, cos].map(splat);
        [
            cos.mul_add(x, splat(pose.x) - sin * y).to_array(),
            sin.mul_add(x, cos.mul_add(y, splat(pose.y))).to_array(),
        ]
    }
}

impl MovedBlock {
    /// Buffers without content.
    pub(super) fn new() -> Self {
        MovedBlock {
            rows: [RayLanes::default(); LANES],
            spacing: [[[0.0; LANES]; LANES]; 2],
            is_set: false,
        }
    }

    /// Forgets the rays, for another block.
    pub(super) fn clear(&mut self) {
        self.is_set = false;
    }

    /// The rays of a block of an image of `height_px` rows. They are moved once.
    #[inline(always)]
    pub(super) fn of(
        &mut self,
        block: &Block,
        rays: &BlockRays,
        transform: &RowTransform,
        height_px: usize,
    ) -> &Self {
        if !self.is_set {
            if transform.is_constant() {
                self.set::<false>(block, rays, transform, height_px);
            } else {
                self.set::<true>(block, rays, transform, height_px);
            }
            self.is_set = true;
        }
        self
    }

    /// Moves the rays of a block. `ROLLS`: rows differ in their rotation.
    fn set<const ROLLS: bool>(
        &mut self,
        block: &Block,
        rest: &BlockRays,
        transform: &RowTransform,
        height_px: usize,
    ) {
        let lanes = |values: &LinearValues, row: usize| -> Lanes {
            let (middle, step) = values.row(row);
            let mut lanes = [0.0; LANES];
            for (lane, value) in lanes.iter_mut().enumerate() {
                *value = step.mul_add(lane as f32 - (LANES - 1) as f32 / 2.0, middle);
            }
            lanes
        };
        self.spacing = rest.spacing;
        for row in 0..LANES {
            let rays = RayLanes {
                origin: block.origin.each_ref().map(|of| lanes(of, row)),
                direction: rest.direction.each_ref().map(|of| of[row]),
                slope: rest.slope[row],
            };
            let image_row = ((block.row * LANES + row) as f32 + 0.5) / height_px as f32 - 0.5;
            let rotation = if ROLLS {
                transform.rotation_at(image_row)
            } else {
                transform.rotation[0]
            };
            self.rows[row] = move_lanes(&rays, &rotation, transform.shift_at(image_row));
        }
    }
}
