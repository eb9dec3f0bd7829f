//! How are rays passed to the loops that draw? In rows of a vector's width, so that none are left for a scalar loop.

use wide::f32x8;

/// Rays of one vector: a row of a block.
pub(super) const LANES: usize = 8;

/// A value for each pixel of a block's row.
pub(super) type Lanes = [f32; LANES];

/// A value for each pixel of a block of `LANES` × `LANES` pixels, row by row.
pub(super) type BlockValues = [Lanes; LANES];

/// Linear light of a block, one plane per colour.
pub(super) type BlockLight = [BlockValues; 3];

/// A row as a vector, for loops that the compiler turns into shuffles.
pub(super) type Vector = f32x8;

/// All lanes of a value.
#[inline(always)]
pub(super) fn splat(value: f32) -> Vector {
    Vector::splat(value)
}

/// A share limited to 0 to 1.
#[inline(always)]
pub(super) fn shares(of: Vector) -> Vector {
    of.fast_max(splat(0.0)).fast_min(splat(1.0))
}

/// The larger of two numbers. A single instruction, since a NaN is not treated as by `max`.
#[inline(always)]
pub(super) fn larger(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// The smaller of two numbers, as `larger`.
#[inline(always)]
pub(super) fn smaller(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

/// A share limited to 0 to 1.
#[inline(always)]
pub(super) fn share(of: f32) -> f32 {
    smaller(larger(of, 0.0), 1.0)
}

/// Share of a pixel of width `width` on the inner side of an edge at distance `inside` from its centre.
#[inline(always)]
pub(super) fn edge_coverage(inside: f32, width: f32) -> f32 {
    share(inside / width + 0.5)
}

/// True if a lane is above 0.
#[inline(always)]
pub(super) fn any_positive(lanes: &Lanes) -> bool {
    let mut most = [0.0; LANES / 2];
    for i in 0..LANES / 2 {
        most[i] = larger(lanes[i], lanes[i + LANES / 2]);
    }
    larger(larger(most[0], most[1]), larger(most[2], most[3])) > 0.0
}

/// Blends a colour into the light of a block's row with weights `part`.
#[inline(always)]
pub(super) fn blend(light: &mut BlockLight, row: usize, part: &Lanes, colour: [f32; 3]) {
    for (plane, colour) in light.iter_mut().zip(colour) {
        for (light, part) in plane[row].iter_mut().zip(part) {
            *light = part.mul_add(colour - *light, *light);
        }
    }
}
