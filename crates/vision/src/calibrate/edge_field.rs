//! Edges of an image as vectors that hardly depend on its light: the gradient of brightness over that of the surroundings.

use crate::image::Image;

/// Images are reduced by a whole number, so that their shorter side has at least this many pixels and less than twice as many.
const SIDE_PX: usize = 480;

/// Standard deviation of the smoothing before the gradient, reduced pixels: edges of rods and bodies near the mirror are
/// out of focus by as much.
const SMOOTHING_PX: f32 = 2.0;

/// Standard deviation of the surroundings that a gradient is compared with, reduced pixels.
const SURROUNDINGS_PX: f32 = 6.0;

/// Gradient of noise and of compressed flat areas after smoothing, levels per pixel.
const NOISE_GRADIENT: f32 = 1.0;

/// A length of one is an edge like others of its surroundings.
pub(super) struct EdgeField {
    /// Columns of the reduced image.
    pub(super) width: usize,
    /// Rows of the reduced image.
    pub(super) height: usize,
    /// Image pixels per reduced pixel.
    pub(super) reduction: usize,
    /// Towards the brighter side; row by row.
    pub(super) vectors: Vec<[f32; 2]>,
}

impl EdgeField {
    pub(super) fn new(image: &Image) -> Self {
        let reduction = (image.width_px.min(image.height_px) / SIDE_PX).max(1);
        let grey = reduced_grey(image, reduction);
        let smooth = grey.blurred(SMOOTHING_PX);
        let (width, height) = (smooth.width, smooth.height);
        let mut vectors = Vec::with_capacity(width * height);
        for (y, x) in (0..height).flat_map(|y| (0..width).map(move |x| (y, x))) {
            vectors.push(smooth.gradient(x, y));
        }
        let surroundings = Plane {
            width,
            height,
            values: vectors.iter().map(|[u, v]| u * u + v * v).collect(),
        }
        .blurred(SURROUNDINGS_PX);
        for (vector, square) in vectors.iter_mut().zip(&surroundings.values) {
            let scale = 1.0 / (square + NOISE_GRADIENT * NOISE_GRADIENT).sqrt();
            *vector = vector.map(|component| component * scale);
        }
        EdgeField {
            width,
            height,
            reduction,
            vectors,
        }
    }
}

/// One value per pixel, row by row.
pub(super) struct Plane {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) values: Vec<f32>,
}

impl Plane {
    /// Central differences; the border repeats its pixels.
    pub(super) fn gradient(&self, x: usize, y: usize) -> [f32; 2] {
        let at = |x: usize, y: usize| self.values[y * self.width + x];
        let (left, right) = (x.saturating_sub(1), (x + 1).min(self.width - 1));
        let (up, down) = (y.saturating_sub(1), (y + 1).min(self.height - 1));
        [
            0.5 * (at(right, y) - at(left, y)),
            0.5 * (at(x, down) - at(x, up)),
        ]
    }

    /// Smoothed by a Gaussian of this standard deviation, along rows and then along columns.
    fn blurred(&self, deviation: f32) -> Plane {
        let kernel = gaussian(deviation);
        self.filtered_and_transposed(&kernel)
            .filtered_and_transposed(&kernel)
    }

    fn filtered_and_transposed(&self, kernel: &[f32]) -> Plane {
        let reach = kernel.len() / 2;
        let mut values = vec![0.0; self.values.len()];
        let mut padded = vec![0.0; self.width + 2 * reach];
        for (y, row) in self.values.chunks_exact(self.width).enumerate() {
            for (index, value) in padded.iter_mut().enumerate() {
                *value = row[index.saturating_sub(reach).min(self.width - 1)];
            }
            for (x, window) in padded.windows(kernel.len()).enumerate() {
                values[x * self.height + y] = window.iter().zip(kernel).map(|(a, b)| a * b).sum();
            }
        }
        Plane {
            width: self.height,
            height: self.width,
            values,
        }
    }
}

/// Weights up to three standard deviations; their sum is 1.
fn gaussian(deviation: f32) -> Vec<f32> {
    let reach = (3.0 * deviation).ceil() as i32;
    let weights: Vec<f32> = (-reach..=reach)
        .map(|step| {
            let x = f64::from(step) / f64::from(deviation);
            localize::math::exp(-0.5 * x * x) as f32
        })
        .collect();
    let sum: f32 = weights.iter().sum();
    weights.iter().map(|weight| weight / sum).collect()
}

/// Mean of the three channels over squares of pixels.
fn reduced_grey(image: &Image, reduction: usize) -> Plane {
    let (width, height) = (image.width_px / reduction, image.height_px / reduction);
    let mut values = vec![0.0; width * height];
    for (v, row) in image
        .rgb
        .chunks_exact(3 * image.width_px)
        .take(height * reduction)
        .enumerate()
    {
        let out = &mut values[v / reduction * width..][..width];
        for (u, rgb) in row.chunks_exact(3).take(width * reduction).enumerate() {
            out[u / reduction] += rgb.iter().map(|&level| f32::from(level)).sum::<f32>();
        }
    }
    let scale = 1.0 / (3 * reduction * reduction) as f32;
    values.iter_mut().for_each(|value| *value *= scale);
    Plane {
        width,
        height,
        values,
    }
}
