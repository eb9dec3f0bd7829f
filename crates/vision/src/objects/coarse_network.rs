//! The network that ranks the many places of the candidate search, by every second row and column of their patches.

use crate::objects::network_layers::{LANES, Weights, accumulate, rectify};
use crate::objects::patch::{CHANNELS, COARSE_SAMPLES};

/// Units of the hidden layer.
const UNITS: usize = 8;
const INPUTS: usize = CHANNELS * COARSE_SAMPLES;

/// One hidden layer over a coarse patch.
pub(crate) struct CoarseNetwork {
    hidden: Box<[[f32; UNITS]; INPUTS]>,
    hidden_bias: [f32; UNITS],
    output: [f32; UNITS],
    output_bias: f32,
}

impl CoarseNetwork {
    pub(super) fn read(weights: &mut Weights) -> Self {
        CoarseNetwork {
            hidden: weights.rows(),
            hidden_bias: weights.row(),
            output: weights.row(),
            output_bias: weights.row::<1>()[0],
        }
    }

    /// Log odds of the object in each lane.
    ///
    /// Two units at a time, each by four sums: additions to one sum wait for each other, and more would not stay in registers.
    #[inline(never)]
    pub(crate) fn log_odds<const N: usize>(&self, inputs: &[[f32; N]]) -> [f32; N] {
        let mut odds = [self.output_bias; N];
        let (inputs, _) = inputs.as_chunks::<LANES>();
        let (rows, _) = self.hidden.as_chunks::<LANES>();
        for unit in (0..UNITS).step_by(2) {
            let mut sums = [[[0.0; N]; LANES]; 2];
            for (inputs, rows) in inputs.iter().zip(rows) {
                for ((lane, input), row) in inputs.iter().enumerate().zip(rows) {
                    accumulate(&mut sums[0][lane], row[unit], input);
                    accumulate(&mut sums[1][lane], row[unit + 1], input);
                }
            }
            for (unit, lanes) in (unit..).zip(sums) {
                let mut hidden = [self.hidden_bias[unit]; N];
                for lane in lanes {
                    accumulate(&mut hidden, 1.0, &lane);
                }
                for (odds, value) in odds.iter_mut().zip(rectify(hidden)) {
                    *odds += value * self.output[unit];
                }
            }
        }
        odds
    }
}
