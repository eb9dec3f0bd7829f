//! Where does light go that mirror and lens scatter? Into a halo around bright parts (bloom) and over the whole image
//! (veiling glare).
//!
//! Both point spread functions are two-sided exponentials, as those of real optics have long tails. They are applied to
//! an image of `CELL` × `CELL` pixels per value, which halos exceed in width.

use super::motion_blur::LightPixel;
use crate::image_sensor::ImageSensorConfig;

/// Pixels per side of a value.
const CELL: usize = 4;
/// Values per side of a value of the coarsest image, in which veiling glare spreads.
const GLARE_CELL: usize = 4;
/// Radius of veiling glare over the image's width.
const GLARE_RADIUS: f32 = 0.25;

/// Scattered light of an image at reduced resolution.
#[derive(Default)]
pub(super) struct Scatter {
    columns: usize,
    rows: usize,
    values: Vec<[f32; 4]>,
    coarse: Vec<[f32; 4]>,
    /// Veiling glare of one row of values at the coarse image's columns.
    coarse_row: Vec<[f32; 4]>,
    /// Where each column of values lies in that row.
    places: Vec<(usize, usize, f32)>,
    /// Interpolated values of one image row, with one more at each end.
    row: Vec<[f32; 4]>,
}

impl Scatter {
    /// Computes the scattered light of an image.
    pub(super) fn update(
        &mut self,
        light: &[LightPixel],
        width_px: usize,
        image_sensor: &ImageSensorConfig,
    ) {
        let height_px = light.len() / width_px.max(1);
        (self.columns, self.rows) = (width_px.div_ceil(CELL), height_px.div_ceil(CELL));
        self.values.resize(self.columns * self.rows, [0.0; 4]);
        for (rows, values) in light
            .chunks(CELL * width_px)
            .zip(self.values.chunks_mut(self.columns))
        {
            let full = if rows.len() == CELL * width_px {
                average_full_cells(rows, width_px, values)
            } else {
                0
            };
            average_cells(rows, width_px, values, full);
        }
        self.spread_glare(image_sensor);
        spread(
            &mut self.values,
            self.columns,
            image_sensor.bloom_radius_px / CELL as f32,
        );
        self.add_glare(image_sensor);
    }

    /// The image averaged over `GLARE_CELL` values, spread over a quarter of the image.
    fn spread_glare(&mut self, image_sensor: &ImageSensorConfig) {
        let (columns, rows) = (
            self.columns.div_ceil(GLARE_CELL),
            self.rows.div_ceil(GLARE_CELL),
        );
        self.coarse.clear();
        self.coarse.resize(columns * rows, [0.0; 4]);
        if image_sensor.glare <= 0.0 {
            return;
        }
        let per = 1.0 / (GLARE_CELL * GLARE_CELL) as f32;
        for (row, values) in self.values.chunks(self.columns).enumerate() {
            let coarse = &mut self.coarse[row / GLARE_CELL * columns..][..columns];
            for (sum, cell) in coarse.iter_mut().zip(values.chunks(GLARE_CELL)) {
                for value in cell {
                    for (sum, part) in sum.iter_mut().zip(value) {
                        *sum += per * part;
                    }
                }
            }
        }
        spread(&mut self.coarse, columns, GLARE_RADIUS * columns as f32);
    }

    /// Adds bloom and glare with their shares.
    fn add_glare(&mut self, image_sensor: &ImageSensorConfig) {
        let columns = self.columns.div_ceil(GLARE_CELL);
        let last = self.coarse.len() / columns.max(1) - 1;
        let (bloom, glare) = (image_sensor.bloom, image_sensor.glare);
        self.places.clear();
        self.places
            .extend((0..self.columns).map(|column| place_between(column, columns - 1)));
        let row_of = |row: usize| row * columns..(row + 1) * columns;
        for (row, values) in self.values.chunks_mut(self.columns).enumerate() {
            let (above, below, down) = place_between(row, last);
            self.coarse_row.clear();
            let rows = self.coarse[row_of(above)]
                .iter()
                .zip(&self.coarse[row_of(below)]);
            self.coarse_row
                .extend(rows.map(|(above, below)| -> [f32; 4] {
                    std::array::from_fn(|k| glare * down.mul_add(below[k] - above[k], above[k]))
                }));
            for (value, &(left, right, across)) in values.iter_mut().zip(&self.places) {
                let (left, right) = (self.coarse_row[left], self.coarse_row[right]);
                for k in 0..4 {
                    let veil = across.mul_add(right[k] - left[k], left[k]);
                    value[k] = bloom.mul_add(value[k], veil);
                }
            }
        }
    }

    /// Adds the scattered light of a row of pixels that measure `colours` in even and odd columns.
    pub(super) fn add_to(&mut self, row: usize, colours: [usize; 2], light: &mut [f32]) {
        let values = self.row(row);
        match colours {
            [0, 1] => add_row::<0, 1>(values, light),
            [1, 2] => add_row::<1, 2>(values, light),
            [0, _] => add_row::<0, 0>(values, light),
            [1, _] => add_row::<1, 1>(values, light),
            _ => add_row::<2, 2>(values, light),
        }
    }

    /// Scattered light of one image row at the values' columns, with the outermost ones repeated at both ends.
    fn row(&mut self, row: usize) -> &[[f32; 4]] {
        let at = ((row as f32 + 0.5) / CELL as f32 - 0.5).clamp(0.0, (self.rows - 1) as f32);
        let above = at as usize;
        let (part, below) = (at - above as f32, (above + 1).min(self.rows - 1));
        let above = &self.values[above * self.columns..][..self.columns];
        let below = &self.values[below * self.columns..][..self.columns];
        self.row.resize(self.columns + 2, [0.0; 4]);
        for ((out, above), below) in self.row[1..].iter_mut().zip(above).zip(below) {
            for k in 0..4 {
                out[k] = above[k] + part * (below[k] - above[k]);
            }
        }
        self.row[0] = self.row[1];
        self.row[self.columns + 1] = self.row[self.columns];
        &self.row
    }
}

/// The entries of the coarse image before and after a value, and the value's place between them.
fn place_between(index: usize, last: usize) -> (usize, usize, f32) {
    let at = ((index as f32 + 0.5) / GLARE_CELL as f32 - 0.5).clamp(0.0, last as f32);
    let before = (at as usize).min(last.saturating_sub(1));
    (before, (before + 1).min(last), at - before as f32)
}

/// Averages the cells of `CELL` × `CELL` pixels of `CELL` rows; returns how many there are.
fn average_full_cells(rows: &[LightPixel], width_px: usize, values: &mut [[f32; 4]]) -> usize {
    let count = width_px / CELL;
    let [first, second, third, fourth] = [0, 1, 2, 3].map(|row: usize| {
        let cells = rows[row * width_px..][..width_px].as_flattened();
        &cells.as_chunks::<{ 4 * CELL }>().0[..count]
    });
    let pairs = (first.iter().zip(second)).zip(third.iter().zip(fourth));
    for (value, ((first, second), (third, fourth))) in values[..count].iter_mut().zip(pairs) {
        // Two pixels side by side fill a vector.
        let mut sums = [0u32; 8];
        for row in [first, second, third, fourth] {
            for k in 0..8 {
                sums[k] += u32::from(row[k]) + u32::from(row[k + 8]);
            }
        }
        for k in 0..4 {
            value[k] = (sums[k] + sums[k + 4]) as f32 * (1.0 / (CELL * CELL) as f32);
        }
    }
    count
}

/// Averages the cells of some rows from one of them on; the last of a row may be narrower.
fn average_cells(rows: &[LightPixel], width_px: usize, values: &mut [[f32; 4]], from: usize) {
    for (cell, value) in values.iter_mut().enumerate().skip(from) {
        let columns = cell * CELL..((cell + 1) * CELL).min(width_px);
        let mut sum = [0; 4];
        for row in rows.chunks(width_px) {
            for pixel in &row[columns.clone()] {
                for k in 0..4 {
                    sum[k] += u32::from(pixel[k]);
                }
            }
        }
        let per = 1.0 / (columns.len() * (rows.len() / width_px)) as f32;
        *value = sum.map(|sum| per * sum as f32);
    }
}

/// Adds the interpolated values of a row to its pixels, which measure colour `EVEN` or `ODD`.
fn add_row<const EVEN: usize, const ODD: usize>(values: &[[f32; 4]], light: &mut [f32]) {
    /// Places of a cell's pixels between the two values around each.
    const PARTS: [f32; CELL] = [0.625, 0.875, 0.125, 0.375];
    let scattered = |around: &[[f32; 4]]| -> [f32; CELL] {
        let [left, own, right] = [around[0], around[1], around[2]];
        let before = [left[EVEN], left[ODD], own[EVEN], own[ODD]];
        let after = [own[EVEN], own[ODD], right[EVEN], right[ODD]];
        std::array::from_fn(|k| before[k] + PARTS[k] * (after[k] - before[k]))
    };
    let (cells, rest) = light.as_chunks_mut::<CELL>();
    let mut windows = values.windows(3);
    for (cell, around) in cells.iter_mut().zip(&mut windows) {
        let scattered = scattered(around);
        for k in 0..CELL {
            cell[k] += scattered[k];
        }
    }
    // The last cell of a row may be narrower. The zip above ends with the cells, before it takes another window.
    if let Some(around) = windows.next() {
        for (light, scattered) in rest.iter_mut().zip(scattered(around)) {
            *light += scattered;
        }
    }
}

/// Convolves with a two-sided exponential of a radius in values, along columns and rows.
fn spread(values: &mut [[f32; 4]], columns: usize, radius: f32) {
    // A step of the filter passes on exp(-1/radius) of its state.
    let keep = (-1.0 / radius.max(1e-3)).exp();
    let take = 1.0 - keep;
    let step = |state: &mut [f32; 4], value: &mut [f32; 4]| {
        for (state, value) in state.iter_mut().zip(value) {
            *state = keep * *state + take * *value;
            *value = *state;
        }
    };
    for row in values.chunks_mut(columns) {
        let mut state = row[0];
        row.iter_mut().for_each(|value| step(&mut state, value));
        let mut state = row[row.len() - 1];
        row.iter_mut()
            .rev()
            .for_each(|value| step(&mut state, value));
    }
    let rows = values.len() / columns;
    let flat = values.as_flattened_mut();
    let width = 4 * columns;
    let mut pass = |from: usize, to: usize| {
        let (low, high) = flat.split_at_mut(from.max(to) * width);
        let (state, value) = if from < to {
            (&low[from * width..][..width], &mut high[..width])
        } else {
            (&high[..width], &mut low[to * width..][..width])
        };
        for (value, state) in value.iter_mut().zip(state) {
            *value = keep * state + take * *value;
        }
    };
    (1..rows).for_each(|row| pass(row - 1, row));
    (1..rows).rev().for_each(|row| pass(row, row - 1));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scattering_keeps_the_light_of_an_even_image_and_widens_a_point_by_its_radius() {
        let mut even = vec![[3.0; 4]; 30 * 20];
        spread(&mut even, 30, 2.0);
        assert!(
            even.iter()
                .flatten()
                .all(|value| (value - 3.0).abs() < 1e-4)
        );
        let mut point = vec![[0.0; 4]; 61 * 61];
        point[30 * 61 + 30] = [1.0; 4];
        spread(&mut point, 61, 3.0);
        let sum: f32 = point.iter().map(|value| value[0]).sum();
        assert!((sum - 1.0).abs() < 1e-3, "{sum}");
        let ratio = point[30 * 61 + 36][0] / point[30 * 61 + 33][0];
        assert!(ratio > 0.3 && ratio < 0.6, "{ratio}");
    }
}
