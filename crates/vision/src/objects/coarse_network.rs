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
    /// A unit at a time, by four sums: additions to one sum wait for each other.
    #[inline(never)]
    pub(crate) fn log_odds<const N: usize>(&self, inputs: &[[f32; N]]) -> [f32; N] {
        let mut odds = [self.output_bias; N];
        for unit in 0..UNITS {
            let [mut a, mut b, mut c, mut d] = [[0.0; N]; LANES];
            let (inputs, _) = inputs.as_chunks::<LANES>();
            let (rows, _) = self.hidden.as_chunks::<LANES>();
            for (inputs, rows) in inputs.iter().zip(rows) {
                accumulate(&mut a, rows[0][unit], &inputs[0]);
                accumulate(&mut b, rows[1][unit], &inputs[1]);
                accumulate(&mut c, rows[2][unit], &inputs[2]);
                accumulate(&mut d, rows[3][unit], &inputs[3]);
            }
            let mut hidden = [self.hidden_bias[unit]; N];
            for lane in [a, b, c, d] {
                accumulate(&mut hidden, 1.0, &lane);
            }
            for (odds, value) in odds.iter_mut().zip(rectify(hidden)) {
                *odds += value * self.output[unit];
            }
        }
        odds
    }
}
