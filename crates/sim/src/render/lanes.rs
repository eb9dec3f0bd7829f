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

/// Reciprocal square roots of numbers above 0, with errors up to 0.065 %, in fewer cycles than a division and with the same
/// bits on every machine: Kadlec's constants for the estimate from the exponent and one step of Newton's method.
#[inline(always)]
pub(super) fn reciprocal_sqrt(of: Vector) -> Vector {
    let estimate = |number: f32| f32::from_bits(0x5f1f_fff9 - (number.to_bits() >> 1));
    let estimate = Vector::new(of.to_array().map(estimate));
    let step = (of * estimate).mul_neg_add(estimate, splat(2.389_244_6));
    splat(0.703_952_25) * estimate * step
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
    Vector::new(*lanes).simd_gt(splat(0.0)).any()
}

/// The numbers of the set bits, from the lowest on.
#[inline(always)]
pub(super) fn set_bits(mut bits: u32) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let bit = (bits != 0).then(|| bits.trailing_zeros() as usize);
        bits &= bits.wrapping_sub(1);
        bit
    })
}

/// The higher half of a number's bits, rounded.
pub(super) fn high_bits(number: f32) -> u16 {
    ((number.to_bits() + 0x8000) >> 16) as u16
}

/// The number of which the higher half of the bits is given.
#[inline(always)]
pub(super) fn from_high_bits(bits: u16) -> f32 {
    f32::from_bits(u32::from(bits) << 16)
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reciprocal_square_roots_are_within_their_stated_error() {
        for step in 0..4000 {
            let number = 1e-8 * 1.01f32.powi(step);
            let product =
                reciprocal_sqrt(splat(number)).to_array()[step as usize % LANES] * number.sqrt();
            assert!((product - 1.0).abs() < 6.6e-4, "{number}: {product}");
        }
    }

    #[test]
    fn higher_half_of_the_bits_is_exact_to_0_4_percent() {
        for number in [1e-5f32, 0.0123, 0.3, 1.99] {
            assert!((from_high_bits(high_bits(number)) / number - 1.0).abs() < 4e-3);
        }
    }
}
