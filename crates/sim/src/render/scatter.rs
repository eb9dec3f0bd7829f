//! Where does light go that mirror and lens scatter? Into a halo around bright parts (bloom) and over the whole image
//! (veiling glare).
//!
//! Both point spread functions are two-sided exponentials, as those of real optics have long tails. They are applied to
//! an image of `CELL` × `CELL` pixels per value, which halos exceed in width.

use wide::i16x16;

use super::image::LightImage;
use crate::image_sensor::ImageSensorConfig;

/// Pixels per side of a value.
pub(super) const CELL: usize = 4;
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
    /// Rows of values at the image's columns, for even and for odd rows of values, and which rows they are. By pattern of
    /// colours.
    wide: [[Vec<f32>; 2]; PATTERNS],
    wide_rows: [[usize; 2]; PATTERNS],
    /// One row of values, with the outermost ones repeated at both ends.
    row: Vec<[f32; 4]>,
}

/// What hides a part of a cell: the visible share of the scene, and the added light.
#[derive(Debug, Clone, Copy)]
pub(super) struct CellOverlay {
    pub(super) column: usize,
    pub(super) row: usize,
    pub(super) left: f32,
    pub(super) adds: [f32; 3],
}

/// Patterns of colours in even and odd columns.
const PATTERNS: usize = 3;

impl Scatter {
    /// Computes the scattered light of an image whose cells are overlaid by the robot's own body.
    pub(super) fn update(
        &mut self,
        image: &LightImage,
        own: &[CellOverlay],
        image_sensor: &ImageSensorConfig,
    ) {
        (self.columns, self.rows) = (image.stride / CELL, image.rows / CELL);
        self.values.resize(self.columns * self.rows, [0.0; 4]);
        for (row, values) in self.values.chunks_mut(self.columns).enumerate() {
            for colour in 0..3 {
                let rows = &image.plane(colour)[row * CELL * image.stride..][..CELL * image.stride];
                average_cells(rows, image.stride, colour, values);
            }
        }
        for overlay in own {
            let value = &mut self.values[overlay.row * self.columns + overlay.column];
            for (value, adds) in value.iter_mut().zip(overlay.adds) {
                *value = value.mul_add(overlay.left, adds);
            }
        }
        self.spread_glare(image_sensor);
        spread(
            &mut self.values,
            self.columns,
            image_sensor.bloom_radius_px / CELL as f32,
        );
        self.add_glare(image_sensor);
        self.wide_rows = [[usize::MAX; 2]; PATTERNS];
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

    /// Scattered light at a row of pixels that measure `colours` in even and odd columns, given by two rows and the place
    /// between them. `pattern`: number of this pattern of colours.
    pub(super) fn row(
        &mut self,
        row: usize,
        colours: [usize; 2],
        pattern: usize,
    ) -> ([&[f32]; 2], f32) {
        let at = ((row as f32 + 0.5) / CELL as f32 - 0.5).clamp(0.0, (self.rows - 1) as f32);
        let above = at as usize;
        let below = (above + 1).min(self.rows - 1);
        for row in [above, below] {
            if self.wide_rows[pattern][row % 2] != row {
                self.widen(row, colours, pattern);
            }
        }
        let wide = &self.wide[pattern];
        let rows = [above, below].map(|row| &wide[row % 2][..]);
        (rows, at - above as f32)
    }

    /// Interpolates a row of values at the image's columns.
    fn widen(&mut self, row: usize, colours: [usize; 2], pattern: usize) {
        let values = &self.values[row * self.columns..][..self.columns];
        self.row.clear();
        self.row.extend(values.first());
        self.row.extend(values);
        self.row.extend(values.last());
        let out = &mut self.wide[pattern][row % 2];
        out.resize(CELL * self.columns, 0.0);
        match colours {
            [0, 1] => widen_row::<0, 1>(&self.row, out),
            [1, 2] => widen_row::<1, 2>(&self.row, out),
            [0, _] => widen_row::<0, 0>(&self.row, out),
            [1, _] => widen_row::<1, 1>(&self.row, out),
            _ => widen_row::<2, 2>(&self.row, out),
        }
        self.wide_rows[pattern][row % 2] = row;
    }
}

/// The entries of the coarse image before and after a value, and the value's place between them.
fn place_between(index: usize, last: usize) -> (usize, usize, f32) {
    let at = ((index as f32 + 0.5) / GLARE_CELL as f32 - 0.5).clamp(0.0, last as f32);
    let before = (at as usize).min(last.saturating_sub(1));
    (before, (before + 1).min(last), at - before as f32)
}

/// Averages the cells of `CELL` × `CELL` pixels of `CELL` rows in one colour.
fn average_cells(rows: &[u16], stride: usize, colour: usize, values: &mut [[f32; 4]]) {
    const PIXELS: usize = 16;
    /// Signed numbers start half of the range of unsigned ones lower.
    const MOVED: f32 = 32_768.0;
    let [first, second, third, fourth] =
        [0, 1, 2, 3].map(|row: usize| rows[row * stride..][..stride].as_chunks::<PIXELS>().0);
    let pairs = first.iter().zip(second).zip(third.iter().zip(fourth));
    let cells = values.as_chunks_mut::<{ PIXELS / CELL }>().0;
    for (cells, ((first, second), (third, fourth))) in cells.iter_mut().zip(pairs) {
        // Sums of two neighbours.
        let [first, second, third, fourth] = [first, second, third, fourth].map(|pixels| {
            i16x16::new(pixels.map(|pixel| (pixel ^ 0x8000) as i16)).dot(i16x16::splat(1))
        });
        let sums = ((first + second) + (third + fourth)).to_array();
        for (k, cell) in cells.iter_mut().enumerate() {
            let sum = (sums[2 * k] + sums[2 * k + 1]) as f32;
            cell[colour] = sum.mul_add(1.0 / (CELL * CELL) as f32, MOVED);
        }
    }
}

/// Interpolates a row of values at the pixels, which measure colour `EVEN` or `ODD`.
fn widen_row<const EVEN: usize, const ODD: usize>(values: &[[f32; 4]], out: &mut [f32]) {
    /// Places of a cell's pixels between the two values around each.
    const PARTS: [f32; CELL] = [0.625, 0.875, 0.125, 0.375];
    let cells = out.as_chunks_mut::<CELL>().0;
    for (cell, around) in cells.iter_mut().zip(values.windows(3)) {
        let [left, own, right] = [around[0], around[1], around[2]];
        let before = [left[EVEN], left[ODD], own[EVEN], own[ODD]];
        let after = [own[EVEN], own[ODD], right[EVEN], right[ODD]];
        *cell = std::array::from_fn(|k| PARTS[k].mul_add(after[k] - before[k], before[k]));
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
