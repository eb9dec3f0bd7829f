//! What does JPEG compression leave of an image? Quantised cosine transforms, colours at half resolution.
//!
//! Only the loss is computed: entropy coding is exact.

/// Side of a block, and of the square whose colours are one block.
const BLOCK: usize = 8;
const SQUARE: usize = 16;

/// Quantisation of luminance and of colour differences at quality 50 (ITU-T T.81, annex K), row by row.
const LUMINANCE: [u8; 64] = [
    16, 11, 10, 16, 24, 40, 51, 61, 12, 12, 14, 19, 26, 58, 60, 55, 14, 13, 16, 24, 40, 57, 69, 56,
    14, 17, 22, 29, 51, 87, 80, 62, 18, 22, 37, 56, 68, 109, 103, 77, 24, 35, 55, 64, 81, 104, 113,
    92, 49, 64, 78, 87, 103, 121, 120, 101, 72, 92, 95, 98, 112, 100, 103, 99,
];
const CHROMINANCE: [u8; 64] = [
    17, 18, 24, 47, 99, 99, 99, 99, 18, 21, 26, 66, 99, 99, 99, 99, 24, 26, 56, 99, 99, 99, 99, 99,
    47, 66, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99,
    99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99,
];

type Matrix = [[f32; BLOCK]; BLOCK];

/// Steps of quantisation and their inverses.
struct Quantisation {
    step: Matrix,
    per_step: Matrix,
}

/// Compresses images with one quality.
pub(crate) struct JpegCompression {
    quality: u8,
    luminance: Quantisation,
    chrominance: Quantisation,
    cosine: Matrix,
    inverse: Matrix,
    /// Luminance of 16 rows, and the colour differences at half resolution.
    luma: Vec<f32>,
    chroma: [Vec<f32>; 2],
    /// Colour differences of one row at full resolution.
    chroma_row: [Vec<f32>; 2],
}

impl JpegCompression {
    pub(crate) fn new(quality: u8) -> Self {
        let cosine: Matrix = std::array::from_fn(|k| {
            std::array::from_fn(|n| {
                let scale = if k == 0 { 0.125f64 } else { 0.25 }.sqrt();
                let angle = std::f64::consts::PI * k as f64 * (n as f64 + 0.5) / BLOCK as f64;
                (scale * angle.cos()) as f32
            })
        });
        JpegCompression {
            quality,
            luminance: quantisation(&LUMINANCE, quality),
            chrominance: quantisation(&CHROMINANCE, quality),
            cosine,
            inverse: transposed(&cosine),
            luma: Vec::new(),
            chroma: [Vec::new(), Vec::new()],
            chroma_row: [Vec::new(), Vec::new()],
        }
    }

    /// The quality for which this was made.
    pub(crate) fn quality(&self) -> u8 {
        self.quality
    }

    /// Replaces an image by what compression leaves of it.
    pub(crate) fn compress(&mut self, pixels: &mut [[u8; 3]], width_px: usize) {
        let stride = width_px.next_multiple_of(SQUARE);
        self.luma.resize(SQUARE * stride, 0.0);
        for plane in &mut self.chroma {
            plane.resize(SQUARE * stride / 4, 0.0);
        }
        for row in &mut self.chroma_row {
            row.resize(stride, 0.0);
        }
        for band in pixels.chunks_mut(SQUARE * width_px) {
            self.separate(band, width_px, stride);
            for column in (0..stride).step_by(BLOCK) {
                for row in [0, BLOCK] {
                    let quantisation = &self.luminance;
                    code_block(
                        &mut self.luma[row * stride + column..],
                        stride,
                        quantisation,
                        &self.cosine,
                        &self.inverse,
                    );
                }
            }
            for plane in &mut self.chroma {
                for column in (0..stride / 2).step_by(BLOCK) {
                    let quantisation = &self.chrominance;
                    code_block(
                        &mut plane[column..],
                        stride / 2,
                        quantisation,
                        &self.cosine,
                        &self.inverse,
                    );
                }
            }
            self.join(band, width_px, stride);
        }
    }

    /// Luminance and mean colour differences of a band; its last row and column are repeated to full blocks.
    fn separate(&mut self, band: &[[u8; 3]], width_px: usize, stride: usize) {
        let last_row = band.len() / width_px - 1;
        let [blue_plane, red_plane] = &mut self.chroma;
        blue_plane.fill(0.0);
        red_plane.fill(0.0);
        let [blue_row, red_row] = &mut self.chroma_row;
        let (blue_row, red_row) = (&mut blue_row[..stride], &mut red_row[..stride]);
        for row in 0..SQUARE {
            let pixels = &band[row.min(last_row) * width_px..][..width_px];
            let luma = &mut self.luma[row * stride..][..stride];
            let differences = blue_row.iter_mut().zip(&mut *red_row);
            for ((luma, (blue_row, red_row)), pixel) in luma.iter_mut().zip(differences).zip(pixels)
            {
                let [red, green, blue] = pixel.map(f32::from);
                let light = 0.299 * red + 0.587 * green + 0.114 * blue;
                *luma = light - 128.0;
                (*blue_row, *red_row) = (blue - light, red - light);
            }
            for plane in [luma, &mut *blue_row, &mut *red_row] {
                let last = plane[width_px - 1];
                plane[width_px..].fill(last);
            }
            let half = row / 2 * (stride / 2)..(row / 2 + 1) * (stride / 2);
            for (plane, differences, share) in [
                (&mut blue_plane[half.clone()], &*blue_row, 0.25 * 0.564),
                (&mut red_plane[half], &*red_row, 0.25 * 0.713),
            ] {
                for (sum, [left, right]) in plane.iter_mut().zip(differences.as_chunks().0) {
                    *sum += share * (left + right);
                }
            }
        }
    }

    fn join(&mut self, band: &mut [[u8; 3]], width_px: usize, stride: usize) {
        // Adding 2²³ leaves the rounded value in the lowest bits, without the NaN check of a cast.
        let byte = |value: f32| (value.clamp(0.0, 255.0) + 8_388_608.0).to_bits() as u8;
        for (row, pixels) in band.chunks_mut(width_px).enumerate() {
            let luma = &self.luma[row * stride..][..width_px];
            let half = row / 2 * (stride / 2)..(row / 2 + 1) * (stride / 2);
            for (wide, plane) in self.chroma_row.iter_mut().zip(&self.chroma) {
                let pairs = wide[..stride].as_chunks_mut().0;
                for (pair, difference) in pairs.iter_mut().zip(&plane[half.clone()]) {
                    *pair = [*difference; 2];
                }
            }
            let [blues, reds] = &self.chroma_row;
            let differences = blues.iter().zip(reds);
            for ((pixel, luma), (blue, red)) in pixels.iter_mut().zip(luma).zip(differences) {
                let light = luma + 128.0;
                *pixel = [
                    byte(light + 1.402 * red),
                    byte(light - 0.344 * blue - 0.714 * red),
                    byte(light + 1.772 * blue),
                ];
            }
        }
    }
}

fn quantisation(table: &[u8; 64], quality: u8) -> Quantisation {
    let quality = f32::from(quality.clamp(1, 100));
    let percent = if quality < 50.0 {
        5000.0 / quality
    } else {
        200.0 - 2.0 * quality
    };
    let step: Matrix = std::array::from_fn(|row| {
        std::array::from_fn(|column| {
            let base = f32::from(table[row * BLOCK + column]);
            ((base * percent + 50.0) / 100.0).floor().clamp(1.0, 255.0)
        })
    });
    Quantisation {
        step,
        per_step: step.map(|row| row.map(|step| 1.0 / step)),
    }
}

/// Transforms a block, rounds its coefficients to steps and transforms it back. `inverse`: the cosines transposed.
fn code_block(
    plane: &mut [f32],
    stride: usize,
    quantisation: &Quantisation,
    cosine: &Matrix,
    inverse: &Matrix,
) {
    /// Adding 1.5·2²³ and subtracting it rounds to a whole number.
    const ROUND: f32 = 12_582_912.0;
    let mut block: Matrix = [[0.0; BLOCK]; BLOCK];
    for (row, values) in block.iter_mut().enumerate() {
        values.copy_from_slice(&plane[row * stride..][..BLOCK]);
    }
    let mut coefficients = product::<BLOCK>(&product::<BLOCK>(cosine, &block), inverse);
    for ((values, steps), per_steps) in coefficients
        .iter_mut()
        .zip(&quantisation.step)
        .zip(&quantisation.per_step)
    {
        for ((value, step), per) in values.iter_mut().zip(steps).zip(per_steps) {
            *value = (*value * per + ROUND - ROUND) * step;
        }
    }
    // Most blocks keep only slow waves.
    let block = if has_waves_from::<4>(&coefficients) {
        waves::<BLOCK>(&coefficients, cosine, inverse)
    } else if has_waves_from::<2>(&coefficients) {
        waves::<4>(&coefficients, cosine, inverse)
    } else {
        waves::<2>(&coefficients, cosine, inverse)
    };
    for (row, values) in block.iter().enumerate() {
        plane[row * stride..][..BLOCK].copy_from_slice(values);
    }
}

/// True if a coefficient in row or column `FIRST` or beyond is not zero.
#[inline(always)]
fn has_waves_from<const FIRST: usize>(coefficients: &Matrix) -> bool {
    let mut sums = [0.0; BLOCK];
    for (row, values) in coefficients.iter().enumerate() {
        for (column, (sum, value)) in sums.iter_mut().zip(values).enumerate() {
            if row >= FIRST || column >= FIRST {
                *sum += value.abs();
            }
        }
    }
    sums.iter().sum::<f32>() > 0.0
}

/// The block of which only the first `USED` rows and columns of coefficients are not zero.
#[inline(always)]
fn waves<const USED: usize>(coefficients: &Matrix, cosine: &Matrix, inverse: &Matrix) -> Matrix {
    product::<USED>(&product::<USED>(inverse, coefficients), cosine)
}

fn transposed(matrix: &Matrix) -> Matrix {
    std::array::from_fn(|row| std::array::from_fn(|column| matrix[column][row]))
}

/// Product of the first `USED` columns of a matrix with the first rows of another; each row of the result is a sum of rows,
/// which vectorises.
#[inline(always)]
fn product<const USED: usize>(left: &Matrix, right: &Matrix) -> Matrix {
    let mut out = [[0.0; BLOCK]; BLOCK];
    for row in 0..BLOCK {
        let mut sum = [0.0; BLOCK];
        for k in 0..USED {
            for i in 0..BLOCK {
                // One rounding: exact on every processor, and a single instruction on those of robots.
                sum[i] = left[row][k].mul_add(right[k][i], sum[i]);
            }
        }
        out[row] = sum;
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A slanted bright line on green, 40 × 24 pixels.
    fn picture() -> Vec<[u8; 3]> {
        (0..40 * 24)
            .map(|pixel| {
                let (column, row) = (pixel % 40, pixel / 40);
                let line = (column + row) % 24 < 4;
                if line { [220, 225, 215] } else { [60, 130, 80] }
            })
            .collect()
    }

    /// Root mean square error of green.
    fn error(quality: u8) -> f32 {
        let (before, mut after) = (picture(), picture());
        JpegCompression::new(quality).compress(&mut after, 40);
        let sum: f32 = before
            .iter()
            .zip(&after)
            .map(|(a, b)| (f32::from(a[1]) - f32::from(b[1])).powi(2))
            .sum();
        (sum / before.len() as f32).sqrt()
    }

    #[test]
    fn compression_loses_more_at_a_lower_quality_and_little_at_the_best() {
        let errors = [100, 90, 40].map(error);
        assert!(
            errors[0] < 6.0 && errors[0] < errors[1] && errors[1] < errors[2],
            "{errors:?}"
        );
    }

    #[test]
    fn fast_waves_that_are_zero_need_not_be_summed() {
        let jpeg = JpegCompression::new(75);
        let (cosine, inverse) = (&jpeg.cosine, &jpeg.inverse);
        let slow = |used: usize| -> Matrix {
            std::array::from_fn(|row| {
                std::array::from_fn(|column| {
                    if row.max(column) < used {
                        12.5 * (row as f32 - 1.5) + 7.0 * column as f32
                    } else {
                        // A negative number that was rounded to zero.
                        -0.0
                    }
                })
            })
        };
        let bits = |block: Matrix| block.map(|row| row.map(f32::to_bits));
        let (two, four) = (slow(2), slow(4));
        assert!(!has_waves_from::<2>(&two) && has_waves_from::<2>(&four));
        assert!(!has_waves_from::<4>(&four) && has_waves_from::<4>(&slow(BLOCK)));
        let all = [two, four].map(|of| bits(waves::<BLOCK>(&of, cosine, inverse)));
        assert_eq!(bits(waves::<2>(&two, cosine, inverse)), all[0]);
        assert_eq!(bits(waves::<4>(&four, cosine, inverse)), all[1]);
    }

    #[test]
    fn even_image_survives_compression() {
        let mut pixels = vec![[90, 140, 100]; 33 * 17];
        JpegCompression::new(75).compress(&mut pixels, 33);
        let near = |a: u8, b: u8| a.abs_diff(b) <= 3;
        assert!(
            pixels
                .iter()
                .all(|&[r, g, b]| near(r, 90) && near(g, 140) && near(b, 100))
        );
    }
}
