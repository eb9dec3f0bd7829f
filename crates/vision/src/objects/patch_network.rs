//! The networks that judge a patch by its pixels. Their sums run in one order, so results are the same on every run.

use crate::objects::network_layers::{LANES, Weights, accumulate, rectify};
use crate::objects::patch::{CHANNELS, SAMPLES, SIDE};

/// Units of a dense layer and channels of the first convolution, and channels of the second one, that are summed at a time;
/// these have a multiple of them.
const BLOCK: usize = 8;
const CHANNEL_BLOCK: usize = 16;
/// Sides of the layers: each convolution halves them.
const SIDE1: usize = SIDE / 2;
const SIDE2: usize = SIDE / 4;
/// Places of the second layer.
const PLACES: usize = SIDE2 * SIDE2;

/// Two convolutions (3 × 3, stride 2, one pixel of padding) of `CONV1` and `CONV2` channels and two dense layers, of
/// `DENSE` units and of the outputs.
pub(crate) struct PatchNetwork<
    const OUT: usize,
    const CONV1: usize,
    const CONV2: usize,
    const DENSE: usize,
> {
    /// By channel, row and column of the kernel.
    conv1: Box<[[[[f32; CONV1]; 3]; 3]; CHANNELS]>,
    conv1_bias: [f32; CONV1],
    /// By row and column of the kernel, then by channel: the order of the sums.
    conv2: Box<[[[[f32; CONV2]; CONV1]; 3]; 3]>,
    conv2_bias: [f32; CONV2],
    /// By place, then by channel.
    dense: Box<[[[f32; DENSE]; CONV2]; PLACES]>,
    dense_bias: [f32; DENSE],
    output: [[f32; OUT]; DENSE],
    output_bias: [f32; OUT],
}

/// Outputs of the first convolution behind a border of zeros.
type Framed<const UNITS: usize> = [[[f32; UNITS]; SIDE1 + 1]; SIDE1 + 1];

impl<const OUT: usize, const CONV1: usize, const CONV2: usize, const DENSE: usize>
    PatchNetwork<OUT, CONV1, CONV2, DENSE>
{
    pub(super) fn read(weights: &mut Weights) -> Self {
        let mut kernels = || std::array::from_fn(|_| std::array::from_fn(|_| weights.row()));
        let conv1 = Box::new(std::array::from_fn(|_| kernels()));
        let conv1_bias = weights.row();
        // By channel and then by place of the kernel in the file.
        let by_channel: [[[[f32; CONV2]; 3]; 3]; CONV1] = std::array::from_fn(|_| {
            std::array::from_fn(|_| std::array::from_fn(|_| weights.row()))
        });
        let conv2 = std::array::from_fn(|row| {
            std::array::from_fn(|column| std::array::from_fn(|unit| by_channel[unit][row][column]))
        });
        PatchNetwork {
            conv1,
            conv1_bias,
            conv2: Box::new(conv2),
            conv2_bias: weights.row(),
            dense: Box::new(std::array::from_fn(|_| {
                std::array::from_fn(|_| weights.row())
            })),
            dense_bias: weights.row(),
            output: std::array::from_fn(|_| weights.row()),
            output_bias: weights.row(),
        }
    }

    /// Outputs before the logistic function.
    pub(crate) fn evaluate(&self, patch: &[f32; CHANNELS * SAMPLES]) -> [f32; OUT] {
        let first = self.convolve_first(patch);
        let flat = self.convolve_second(&first);
        let sums = dense_layer(
            flat.as_flattened(),
            self.dense.as_flattened(),
            self.dense_bias,
        );
        let mut output = self.output_bias;
        for (input, weights) in rectify(sums).into_iter().zip(&self.output) {
            accumulate(&mut output, input, weights);
        }
        output
    }

    /// First convolution, with a border of zeros before its rows and columns.
    ///
    /// A row of places at a time: additions to one sum wait for each other, those of six places do not. Eight channels at a
    /// time: the sums of sixteen would not stay in registers.
    fn convolve_first(&self, patch: &[f32; CHANNELS * SAMPLES]) -> Framed<CONV1> {
        let mut planes = [[[0.0; SIDE + 1]; SIDE + 1]; CHANNELS];
        for (plane, values) in planes.iter_mut().zip(patch.as_chunks::<SAMPLES>().0) {
            let rows = values.as_chunks::<SIDE>().0;
            for (framed, row) in plane[1..].iter_mut().zip(rows) {
                framed[1..].copy_from_slice(row);
            }
        }
        let mut out = [[[0.0; CONV1]; SIDE1 + 1]; SIDE1 + 1];
        let biases = self.conv1_bias.as_chunks::<BLOCK>().0;
        for (row, out) in out[1..].iter_mut().enumerate() {
            for (block, &bias) in biases.iter().enumerate() {
                let mut sums = [bias; SIDE1];
                for (plane, kernel) in planes.iter().zip(&*self.conv1) {
                    for (inputs, weights) in plane[2 * row..][..3].iter().zip(kernel) {
                        for (shift, weights) in weights.iter().enumerate() {
                            let weights = &weights.as_chunks::<BLOCK>().0[block];
                            for (column, sums) in sums.iter_mut().enumerate() {
                                accumulate(sums, inputs[2 * column + shift], weights);
                            }
                        }
                    }
                }
                for (out, sums) in out[1..].iter_mut().zip(sums) {
                    out.as_chunks_mut().0[block] = rectify(sums);
                }
            }
        }
        out
    }

    /// Second convolution, row by row. The sums of a row's places and of some channels stay in registers.
    fn convolve_second(&self, first: &Framed<CONV1>) -> [[f32; CONV2]; PLACES] {
        let mut flat = [[0.0; CONV2]; PLACES];
        let biases = self.conv2_bias.as_chunks::<CHANNEL_BLOCK>().0;
        for (row, out) in flat.as_chunks_mut::<SIDE2>().0.iter_mut().enumerate() {
            for (block, &bias) in biases.iter().enumerate() {
                let mut sums = [bias; SIDE2];
                for (inputs, weights) in first[2 * row..][..3].iter().zip(&*self.conv2) {
                    for (shift, weights) in weights.iter().enumerate() {
                        for (channel, weights) in weights.iter().enumerate() {
                            let weights = &weights.as_chunks::<CHANNEL_BLOCK>().0[block];
                            for (column, sums) in sums.iter_mut().enumerate() {
                                accumulate(sums, inputs[2 * column + shift][channel], weights);
                            }
                        }
                    }
                }
                for (out, sums) in out.iter_mut().zip(sums) {
                    out.as_chunks_mut().0[block] = rectify(sums);
                }
            }
        }
        flat
    }
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
