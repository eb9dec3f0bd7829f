//! Where do the rays of a block point at their rows' exposure? The robot drives and tilts while the rows are read out.

use super::blocks::{Block, BlockRays, LinearValues};
use super::field_from_robot::FieldFromRobot;
use super::lanes::{BlockValues, LANES, Lanes, Vector, from_high_bits, splat};
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
pub(super) fn move_lanes(rays: &RayLanes, r: &[f32; 9], [x, y]: [f32; 2]) -> RayLanes {
    let [dx, dy, dz] = rotate(rays.origin.map(Vector::new), r);
    let (direction, slope) = turn_lanes(&rays.direction, &rays.slope, r);
    RayLanes {
        origin: [dx + splat(x), dy + splat(y), dz].map(Vector::to_array),
        direction,
        slope,
    }
}

/// Directions and slopes of rays after a rotation.
#[inline(always)]
fn turn_lanes(direction: &[Lanes; 2], slope: &Lanes, r: &[f32; 9]) -> ([Lanes; 2], Lanes) {
    let [x, y, z] = rotate([direction[0], direction[1], *slope].map(Vector::new), r);
    let length2 = x.mul_add(x, y * y).fast_max(splat(1e-12));
    let per = splat(1.0) / length2.sqrt();
    (
        [x * per, y * per].map(Vector::to_array),
        (z * per).to_array(),
    )
}

#[inline(always)]
fn rotate([x, y, z]: [Vector; 3], r: &[f32; 9]) -> [Vector; 3] {
    [0, 3, 6].map(|k| {
        let [rx, ry, rz] = [r[k], r[k + 1], r[k + 2]].map(splat);
        rx.mul_add(x, ry.mul_add(y, rz * z))
    })
}

impl RayLanes {
    /// Falls per horizontal metre, above 0.
    #[inline(always)]
    pub(super) fn fall(&self) -> Vector {
        (-Vector::new(self.slope)).fast_max(splat(LEVEL_SLOPE))
    }

    /// Distances to the ground; `RANGE_MAX` if a ray does not meet it.
    #[inline(always)]
    pub(super) fn ground_distance(&self) -> Lanes {
        let distance = Vector::new(self.origin[2]) / self.fall();
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

    /// Ground points in the field frame, for the robot at a pose.
    #[inline(always)]
    pub(super) fn ground_in_field(&self, pose: FieldFromRobot) -> [Lanes; 2] {
        let [x, y] = self.ground().map(Vector::new);
        let [sin, cos] = [pose.sin, pose.cos].map(splat);
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

    /// Bits of the rows with footprints that reach between two slopes.
    #[inline(always)]
    pub(super) fn rows_between(&self, [low, high]: [f32; 2]) -> u32 {
        let (low, high) = (splat(low), splat(high));
        (0..LANES).fold(0, |rows, row| {
            let slope = Vector::new(self.rows[row].slope);
            let half = splat(0.5) * Vector::new(self.spacing[1][row]);
            let overlap = (slope + half - low).fast_min(high - (slope - half));
            rows | (u32::from(overlap.simd_gt(splat(0.0)).any()) << row)
        })
    }

    /// Moves the rays of a block. `ROLLS`: rows differ in their rotation.
    fn set<const ROLLS: bool>(
        &mut self,
        block: &Block,
        rest: &BlockRays,
        transform: &RowTransform,
        height_px: usize,
    ) {
        let per_height = 1.0 / height_px as f32;
        let image_row = |row: f32| row.mul_add(per_height, -0.5);
        let middle = image_row((block.row * LANES) as f32 + LANES as f32 / 2.0);
        // The rotation changes so little between a block's rows that its middle's serves all origins.
        let r = transform.rotation_at(middle);
        let shift = transform.shift_at(middle);
        let origin = [0, 1, 2].map(|k| {
            let turned = LinearValues::sum(&block.origin, [r[3 * k], r[3 * k + 1], r[3 * k + 2]]);
            match (shift.get(k), transform.shift.get(k)) {
                (Some(shift), Some(change)) => turned.shifted(*shift, change * per_height),
                _ => turned,
            }
        });
        for row in 0..LANES {
            let image_row = image_row((block.row * LANES + row) as f32 + 0.5);
            let rotation = if ROLLS {
                transform.rotation_at(image_row)
            } else {
                transform.rotation[0]
            };
            let (direction, slope) = turn_lanes(
                &rest.direction.each_ref().map(|of| of[row]),
                &rest.slope[row],
                &rotation,
            );
            self.rows[row] = RayLanes {
                origin: origin.each_ref().map(|of| of.row(row)),
                direction,
                slope,
            };
            for (spacing, rest) in self.spacing.iter_mut().zip(&rest.spacing) {
                spacing[row] = rest[row].map(from_high_bits);
            }
        }
    }
}
