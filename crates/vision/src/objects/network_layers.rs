//! What the layers of the object networks share: their weights and sums.

/// Inputs of a layer that are added at a time.
pub(super) const LANES: usize = 4;

/// Reads weights in their order. The file is part of the executable, so a wrong size is a mistake of the build.
pub(super) struct Weights {
    bytes: &'static [u8],
}

impl Weights {
    pub(super) fn new(bytes: &'static [u8]) -> Self {
        Weights { bytes }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.bytes.is_empty()
    }

    pub(super) fn row<const N: usize>(&mut self) -> [f32; N] {
        std::array::from_fn(|_| {
            let (value, rest) = self
                .bytes
                .split_first_chunk()
                .expect("objects.weights is too short");
            self.bytes = rest;
            f32::from_le_bytes(*value)
        })
    }

    /// Boxed arrays of a known length: loops over them need no checks and keep their sums in registers.
    pub(super) fn rows<const N: usize, const ROWS: usize>(&mut self) -> Box<[[f32; N]; ROWS]> {
        Box::new(std::array::from_fn(|_| self.row()))
    }
}

/// Adds inputs times weights to the sums.
#[inline(always)]
pub(super) fn accumulate<const N: usize>(sums: &mut [f32; N], input: f32, weights: &[f32; N]) {
    for (sum, weight) in sums.iter_mut().zip(weights) {
        // One rounding: exact on every processor, and a single instruction on those of robots.
        *sum = input.mul_add(*weight, *sum);
    }
}

pub(super) fn rectify<const N: usize>(values: [f32; N]) -> [f32; N] {
    values.map(|value| value.max(0.0))
}
