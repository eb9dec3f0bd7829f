//! Two small networks per kind of object, trained by `py/training/train_objects.py` (docs/methods.md 4.9).
//!
//! The coarse network ranks the many places that the candidate search leaves. The convolution network judges the best of
//! them by their pixels. Plain loops of fixed size let the compiler use vector instructions, and sums run in one order,
//! so results are the same on every run.

use std::sync::LazyLock;

use localize::math;

use crate::objects::patch::{CHANNELS, COARSE_SAMPLES, SAMPLES, SIDE};

/// Units of the coarse network, and inputs that a dense layer takes at a time.
const COARSE_UNITS: usize = 8;
const LANES: usize = 4;
/// Units of a dense layer that are summed at a time; it has a multiple of them.
const BLOCK: usize = 8;
/// Channels of the first and second convolution, units of the dense layer.
const CONV1: usize = 8;
const CONV2: usize = 16;
const DENSE: usize = 24;
/// Sides of the layers: each convolution halves them.
const SIDE1: usize = SIDE / 2;
const SIDE2: usize = SIDE / 4;
/// Pixels below a convolution's kernel.
const KERNEL: usize = 9;
/// Inputs of the coarse network.
const COARSE_INPUTS: usize = CHANNELS * COARSE_SAMPLES;
/// Inputs of the dense layer.
const FLAT: usize = SIDE2 * SIDE2 * CONV2;

/// Weights as little-endian float32: ball coarse, ball, obstacle coarse, obstacle.
static WEIGHTS: &[u8] = include_bytes!("objects.weights");

/// The trained networks.
pub(crate) struct ObjectNetworks {
    pub(crate) ball_coarse: CoarseNetwork,
    pub(crate) ball: PatchNetwork<1>,
    pub(crate) obstacle_coarse: CoarseNetwork,
    pub(crate) obstacle: PatchNetwork<3>,
}

/// The networks, decoded at first use.
pub(crate) static NETWORKS: LazyLock<ObjectNetworks> = LazyLock::new(|| {
    let mut weights = Weights { bytes: WEIGHTS };
    let networks = ObjectNetworks {
        ball_coarse: CoarseNetwork::read(&mut weights),
        ball: PatchNetwork::read(&mut weights),
        obstacle_coarse: CoarseNetwork::read(&mut weights),
        obstacle: PatchNetwork::read(&mut weights),
    };
    assert!(weights.bytes.is_empty(), "objects.weights has a wrong size");
    networks
});

/// Reads weights in their order. The file is part of the executable, so a wrong size is a mistake of the build.
struct Weights {
    bytes: &'static [u8],
}

impl Weights {
    fn row<const N: usize>(&mut self) -> [f32; N] {
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
    fn rows<const N: usize, const ROWS: usize>(&mut self) -> Box<[[f32; N]; ROWS]> {
        Box::new(std::array::from_fn(|_| self.row()))
    }
}

/// Adds inputs times weights to the sums.
#[inline(always)]
fn accumulate<const N: usize>(sums: &mut [f32; N], input: f32, weights: &[f32; N]) {
    for (sum, weight) in sums.iter_mut().zip(weights) {
        // One rounding: exact on every processor, and a single instruction on those of robots.
        *sum = input.mul_add(*weight, *sum);
    }
}

fn rectify<const N: usize>(values: [f32; N]) -> [f32; N] {
    values.map(|value| value.max(0.0))
}

/// Inputs, a multiple of [`LANES`] in number, times a layer's weights, plus its bias.
///
/// Four sums at a time: additions to one sum wait for each other. Eight units at a time: their sums stay in registers.
#[inline(always)]
fn dense_layer<const UNITS: usize>(
    inputs: &[f32],
    weights: &[[f32; UNITS]],
    bias: [f32; UNITS],
) -> [f32; UNITS] {
    let (inputs, _) = inputs.as_chunks::<LANES>();
    let (rows, _) = weights.as_chunks::<LANES>();
    let mut sums = bias;
    for (block, sums) in sums.as_chunks_mut::<BLOCK>().0.iter_mut().enumerate() {
        let [mut a, mut b, mut c, mut d] = [[0.0; BLOCK]; LANES];
        for (inputs, rows) in inputs.iter().zip(rows) {
            let of_block = |row: usize| &rows[row].as_chunks::<BLOCK>().0[block];
            accumulate(&mut a, inputs[0], of_block(0));
            accumulate(&mut b, inputs[1], of_block(1));
            accumulate(&mut c, inputs[2], of_block(2));
            accumulate(&mut d, inputs[3], of_block(3));
        }
        for lane in [a, b, c, d] {
            accumulate(sums, 1.0, &lane);
        }
    }
    sums
}

/// One hidden layer over a coarse patch.
pub(crate) struct CoarseNetwork {
    hidden: Box<[[f32; COARSE_UNITS]; COARSE_INPUTS]>,
    hidden_bias: [f32; COARSE_UNITS],
    output: [f32; COARSE_UNITS],
    output_bias: f32,
}

impl CoarseNetwork {
    fn read(weights: &mut Weights) -> Self {
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
        for unit in 0..COARSE_UNITS {
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

/// Two convolutions (3 × 3, stride 2, one pixel of padding) and two dense layers.
pub(crate) struct PatchNetwork<const OUT: usize> {
    conv1: Box<[[f32; CONV1]; CHANNELS * KERNEL]>,
    conv1_bias: [f32; CONV1],
    /// By place of the kernel, then by channel: the order of the sums.
    conv2: Box<[[f32; CONV2]; CONV1 * KERNEL]>,
    conv2_bias: [f32; CONV2],
    dense: Box<[[f32; DENSE]; FLAT]>,
    dense_bias: [f32; DENSE],
    output: Box<[[f32; OUT]; DENSE]>,
    output_bias: [f32; OUT],
}

impl<const OUT: usize> PatchNetwork<OUT> {
    fn read(weights: &mut Weights) -> Self {
        PatchNetwork {
            conv1: weights.rows(),
            conv1_bias: weights.row(),
            conv2: by_kernel(&weights.rows()),
            conv2_bias: weights.row(),
            dense: weights.rows(),
            dense_bias: weights.row(),
            output: weights.rows(),
            output_bias: weights.row(),
        }
    }

    /// Outputs before the logistic function.
    pub(crate) fn evaluate(&self, patch: &[f32; CHANNELS * SAMPLES]) -> [f32; OUT] {
        let first = self.convolve_first(patch);
        let flat = self.convolve_second(&first);
        let sums = dense_layer(&flat, &*self.dense, self.dense_bias);
        let mut output = self.output_bias;
        for (input, weights) in rectify(sums).into_iter().zip(&*self.output) {
            accumulate(&mut output, input, weights);
        }
        output
    }

    /// First convolution, with a border of zeros before its rows and columns.
    ///
    /// A row of places at a time: additions to one sum wait for each other, those of six places do not.
    fn convolve_first(&self, patch: &[f32; CHANNELS * SAMPLES]) -> Framed<CONV1> {
        let mut planes = [[[0.0; SIDE + 1]; SIDE + 1]; CHANNELS];
        for (plane, values) in planes.iter_mut().zip(patch.as_chunks::<SAMPLES>().0) {
            let rows = values.as_chunks::<SIDE>().0;
            for (framed, row) in plane[1..].iter_mut().zip(rows) {
                framed[1..].copy_from_slice(row);
            }
        }
        let mut out = [[[0.0; CONV1]; SIDE1 + 1]; SIDE1 + 1];
        for (row, out) in out[1..].iter_mut().enumerate() {
            let mut sums = [self.conv1_bias; SIDE1];
            for (plane, weights) in planes.iter().zip(self.conv1.as_chunks::<KERNEL>().0) {
                for (inputs, weights) in
                    plane[2 * row..][..3].iter().zip(weights.as_chunks::<3>().0)
                {
                    for (shift, weights) in weights.iter().enumerate() {
                        for (column, sums) in sums.iter_mut().enumerate() {
                            accumulate(sums, inputs[2 * column + shift], weights);
                        }
                    }
                }
            }
            for (out, sums) in out[1..].iter_mut().zip(sums) {
                *out = rectify(sums);
            }
        }
        out
    }

    /// Second convolution; place by place, row by row.
    fn convolve_second(&self, first: &Framed<CONV1>) -> [f32; FLAT] {
        let mut flat = [0.0; FLAT];
        for (row, out) in flat
            .as_chunks_mut::<{ SIDE2 * CONV2 }>()
            .0
            .iter_mut()
            .enumerate()
        {
            let mut sums = [self.conv2_bias; SIDE2];
            let weights = self.conv2.as_chunks::<{ 3 * CONV1 }>().0;
            for (inputs, weights) in first[2 * row..][..3].iter().zip(weights) {
                for (shift, weights) in weights.as_chunks::<CONV1>().0.iter().enumerate() {
                    for (channel, weights) in weights.iter().enumerate() {
                        for (column, sums) in sums.iter_mut().enumerate() {
                            accumulate(sums, inputs[2 * column + shift][channel], weights);
                        }
                    }
                }
            }
            for (out, sums) in out.as_chunks_mut::<CONV2>().0.iter_mut().zip(sums) {
                *out = rectify(sums);
            }
        }
        flat
    }
}

/// Weights of the second convolution, given by channel and then by place of the kernel, by place and then by channel.
fn by_kernel(by_channel: &[[f32; CONV2]; CONV1 * KERNEL]) -> Box<[[f32; CONV2]; CONV1 * KERNEL]> {
    Box::new(std::array::from_fn(|index| {
        by_channel[index % CONV1 * KERNEL + index / CONV1]
    }))
}

/// Outputs of the first convolution behind a border of zeros.
type Framed<const UNITS: usize> = [[[f32; UNITS]; SIDE1 + 1]; SIDE1 + 1];

/// Probability of log odds.
pub(crate) fn logistic(log_odds: f32) -> f32 {
    1.0 / (1.0 + math::exp(-log_odds))
}

/// Probabilities of exclusive classes.
pub(crate) fn softmax<const N: usize>(outputs: [f32; N]) -> [f32; N] {
    let largest = outputs.into_iter().fold(f32::NEG_INFINITY, f32::max);
    let shares = outputs.map(|output| math::exp(output - largest));
    let sum: f32 = shares.iter().sum();
    shares.map(|share| share / sum)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::objects::patch::{PatchColours, PatchKind, normalize_patch};

    fn probability(colour: impl Fn(f32, f32) -> [u8; 3]) -> f32 {
        let colours = PatchColours::of(|row, column| {
            let [row, column] = [row, column].map(|at| 0.4 * (at as f32 - 5.5));
            colour(row, column)
        });
        let [log_odds] = NETWORKS
            .ball
            .evaluate(&normalize_patch(PatchKind::Ball, &colours));
        logistic(log_odds)
    }

    #[test]
    fn discs_of_any_colour_are_balls_and_a_line_or_plain_carpet_is_none() {
        let carpet = [40, 110, 70];
        for ball in [
            [230, 130, 40],
            [235, 235, 220],
            [60, 70, 200],
            [200, 40, 60],
        ] {
            let disc = probability(|row, column| {
                if row * row + column * column < 1.0 {
                    // The upper side is lit.
                    ball.map(|level: u8| (f32::from(level) * (0.85 + 0.15 * row)) as u8)
                } else {
                    carpet
                }
            });
            assert!(disc > 0.5, "{ball:?}: {disc}");
        }
        let line = probability(|row, _| {
            if row.abs() < 0.5 {
                [230, 232, 228]
            } else {
                carpet
            }
        });
        assert!(line < 0.2, "line: {line}");
        let plain = probability(|_, _| carpet);
        assert!(plain < 0.2, "carpet: {plain}");
    }

    /// Input that `reference_outputs` of py/training/networks.py takes.
    fn reference_input<const N: usize>() -> [f32; N] {
        std::array::from_fn(|index| ((index * 37 % 101) as f64 / 50.0 - 1.0) as f32)
    }

    #[test]
    fn inference_gives_what_training_computed() {
        let coarse = reference_input::<COARSE_INPUTS>().map(|value| [value]);
        let mut outputs = NETWORKS.ball_coarse.log_odds(&coarse).to_vec();
        outputs.extend(NETWORKS.ball.evaluate(&reference_input()));
        outputs.extend(NETWORKS.obstacle_coarse.log_odds(&coarse));
        outputs.extend(NETWORKS.obstacle.evaluate(&reference_input()));
        let expected = include_str!("objects.reference").lines();
        let expected: Vec<f32> = expected.map(|line| line.parse().unwrap()).collect();
        assert_eq!(outputs.len(), expected.len());
        for (output, expected) in outputs.iter().zip(&expected) {
            assert!((output - expected).abs() < 1e-3, "{outputs:?} {expected}");
        }
    }

    #[test]
    fn probabilities_of_exclusive_classes_sum_to_one() {
        let shares = softmax([1.0, -2.0, 30.0]);
        assert!((shares.iter().sum::<f32>() - 1.0).abs() < 1e-6 && shares[2] > 0.99);
    }
}
