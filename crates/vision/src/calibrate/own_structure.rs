//! Edges that stand still while the robot moves: its body, rods and the mirror's rim. Where are they in an image?

use crate::calibrate::edge_field::{EdgeField, Plane};

/// Static edges are gathered in squares of this side, reduced pixels: both sides of a rod are in one.
const CELL_PX: usize = 24;

/// Fewest pixels of a cell on static edges.
const CELL_PIXELS_MIN: usize = 40;

/// Least length of the mean edge vector of a static pixel over the root mean square, and this root mean square.
const COHERENCE_MIN: f32 = 0.7;
const STRENGTH_MIN: f32 = 0.5;

/// Chance that edges of random directions in n images have a mean of the length c is exp(-n c²): at most e^-5.8 (0.3 %).
const CHANCE_EXPONENT: f32 = 5.8;

/// Least correlation with the mean over the images, and least strength, of a cell's edges; else something hides them.
const CORRELATION_MIN: f32 = 0.75;
const AMPLITUDE_MIN: f32 = 0.4;

/// Edges farther off than two standard deviations of the smoothing are not measured by a linear fit, reduced pixels.
const DISPLACEMENT_MAX: f32 = 4.0;

/// Images whose other edges correlate more than this show one place: those of the same place do by 0.5 and more, of others
/// by up to 0.36 (photographs of seven robots).
const SAME_PLACE_CORRELATION: f32 = 0.43;

/// Reduction of the comparison of places.
const PLACE_STEP: usize = 3;

/// Static edges of some images, in cells.
pub(super) struct OwnStructure {
    pub(super) cells: Vec<Cell>,
}

/// Static edges of one square, with their derivative to a displacement across their main direction.
pub(super) struct Cell {
    /// Its column and row.
    pub(super) index: [usize; 2],
    pixels: Vec<CellPixel>,
    /// Squares of the mean edges, and of their change with the displacement.
    template_squares: f32,
    change_squares: f32,
    /// Displacement of this cell per displacement of all edges towards their bright side.
    bloom: f32,
}

struct CellPixel {
    index: usize,
    /// Unit vector across the edge, towards the bright side.
    normal: [f32; 2],
    /// Mean edge along the normal.
    template: f32,
    /// Its change per pixel along the cell's main direction.
    change: f32,
}

/// Mean edges of some images and how constant they are.
struct MeanEdges {
    mean: Vec<[f32; 2]>,
    length: Plane,
    coherence: Vec<f32>,
    strength: Vec<f32>,
}

impl MeanEdges {
    fn new(fields: &[&EdgeField]) -> Self {
        let count = fields.len() as f32;
        let mut mean = vec![[0.0f32; 2]; fields[0].vectors.len()];
        let mut squares = vec![0.0f32; mean.len()];
        for field in fields {
            for ((sum, square), [u, v]) in mean.iter_mut().zip(&mut squares).zip(&field.vectors) {
                sum[0] += u / count;
                sum[1] += v / count;
                *square += (u * u + v * v) / count;
            }
        }
        let values: Vec<f32> = mean.iter().map(|[u, v]| (u * u + v * v).sqrt()).collect();
        let strength: Vec<f32> = squares.iter().map(|square| square.sqrt()).collect();
        let coherence = values
            .iter()
            .zip(&strength)
            .map(|(length, strength)| length / (strength + 1e-6))
            .collect();
        MeanEdges {
            mean,
            length: Plane {
                width: fields[0].width,
                height: fields[0].height,
                values,
            },
            coherence,
            strength,
        }
    }
}

impl OwnStructure {
    pub(super) fn find(fields: &[&EdgeField]) -> Self {
        let mean = MeanEdges::new(fields);
        let (width, height) = (fields[0].width, fields[0].height);
        let coherence_min = COHERENCE_MIN.max((CHANCE_EXPONENT / fields.len() as f32).sqrt());
        let cells = (0..height / CELL_PX)
            .flat_map(|row| (0..width / CELL_PX).map(move |column| [column, row]))
            .filter_map(|index| Cell::new(index, &mean, coherence_min))
            .collect();
        OwnStructure { cells }
    }

    /// Displacement of each cell in an image against the mean, reduced pixels; None where it is hidden.
    ///
    /// What moves all edges towards their bright or dark side is exposure, and is removed.
    pub(super) fn displacements(&self, field: &EdgeField) -> Vec<Option<f64>> {
        let mut found: Vec<Option<f64>> = self
            .cells
            .iter()
            .map(|cell| cell.displacement(field))
            .collect();
        let (mut product, mut squares) = (0.0, 1.0);
        for (cell, displacement) in self.cells.iter().zip(&found) {
            if let Some(displacement) = displacement {
                product += f64::from(cell.bloom) * displacement;
                squares += f64::from(cell.bloom * cell.bloom);
            }
        }
        let exposure = product / squares;
        for (cell, displacement) in self.cells.iter().zip(&mut found) {
            if let Some(displacement) = displacement {
                *displacement -= exposure * f64::from(cell.bloom);
            }
        }
        found
    }
}

impl Cell {
    fn new(index: [usize; 2], mean: &MeanEdges, coherence_min: f32) -> Option<Cell> {
        let width = mean.length.width;
        let [left, top] = index.map(|i| i * CELL_PX);
        let places: Vec<[usize; 2]> = (top..top + CELL_PX)
            .flat_map(|y| (left..left + CELL_PX).map(move |x| [x, y]))
            .filter(|[x, y]| {
                let pixel = y * width + x;
                mean.coherence[pixel] > coherence_min && mean.strength[pixel] > STRENGTH_MIN
            })
            .collect();
        if places.len() < CELL_PIXELS_MIN {
            return None;
        }
        let across = main_direction(places.iter().map(|[x, y]| mean.mean[y * width + x]));
        let (mut bloom, mut change_squares, mut template_squares) = (0.0, 0.0, 0.0);
        let pixels = places
            .iter()
            .map(|&[x, y]| {
                let index = y * width + x;
                let template = mean.length.values[index];
                let normal = mean.mean[index].map(|component| component / template);
                let along_normal = dot(mean.length.gradient(x, y), normal);
                let change = along_normal * dot(normal, across);
                bloom += change * along_normal;
                change_squares += change * change;
                template_squares += template * template;
                CellPixel {
                    index,
                    normal,
                    template,
                    change,
                }
            })
            .collect();
        (change_squares > 0.0).then(|| Cell {
            index,
            pixels,
            template_squares,
            change_squares,
            bloom: bloom / change_squares,
        })
    }

    fn displacement(&self, field: &EdgeField) -> Option<f64> {
        let (mut with_template, mut with_change, mut squares) = (0.0, 0.0, 0.0);
        let mut template_with_change = 0.0;
        for pixel in &self.pixels {
            let edge = dot(field.vectors[pixel.index], pixel.normal);
            with_template += edge * pixel.template;
            with_change += edge * pixel.change;
            template_with_change += pixel.template * pixel.change;
            squares += edge * edge;
        }
        let amplitude = with_template / self.template_squares;
        let correlation = with_template / (squares * self.template_squares + 1e-9).sqrt();
        let moved =
            (amplitude * template_with_change - with_change) / (self.change_squares * amplitude);
        (amplitude >= AMPLITUDE_MIN && correlation >= CORRELATION_MIN)
            .then(|| f64::from(moved.clamp(-DISPLACEMENT_MAX, DISPLACEMENT_MAX)))
    }
}

/// The first image of each place: what images of one place share may be the hall instead of the robot.
pub(super) fn distinct_places(fields: &[EdgeField]) -> Vec<usize> {
    let mut kept: Vec<usize> = (0..fields.len()).collect();
    // Edges of a place that many images share are static only until those are gone.
    for _ in 0..2 {
        let chosen: Vec<&EdgeField> = kept.iter().map(|&index| &fields[index]).collect();
        let mean = MeanEdges::new(&chosen);
        let moving: Vec<Vec<f32>> = chosen
            .iter()
            .map(|field| moving_edges(field, &mean))
            .collect();
        let mut places: Vec<usize> = Vec::new();
        for index in 0..kept.len() {
            let is_new = |&place: &usize| {
                let products = moving[index].iter().zip(&moving[place]);
                products.map(|(a, b)| a * b).sum::<f32>() < SAME_PLACE_CORRELATION
            };
            if places.iter().all(is_new) {
                places.push(index);
            }
        }
        kept = places.into_iter().map(|index| kept[index]).collect();
    }
    kept
}

/// Edges that are not static, of squares of pixels, as a unit vector.
fn moving_edges(field: &EdgeField, mean: &MeanEdges) -> Vec<f32> {
    let columns = field.width.div_ceil(PLACE_STEP);
    let mut sums = vec![0.0f32; 2 * columns * field.height.div_ceil(PLACE_STEP)];
    for (pixel, vector) in field.vectors.iter().enumerate() {
        if mean.coherence[pixel] < COHERENCE_MIN {
            let (x, y) = (pixel % field.width, pixel / field.width);
            let square = y / PLACE_STEP * columns + x / PLACE_STEP;
            sums[2 * square] += vector[0];
            sums[2 * square + 1] += vector[1];
        }
    }
    let length = sums.iter().map(|value| value * value).sum::<f32>().sqrt();
    sums.iter_mut().for_each(|value| *value /= length + 1e-6);
    sums
}

/// Direction in which the vectors are longest, as a unit vector.
fn main_direction(vectors: impl Iterator<Item = [f32; 2]>) -> [f32; 2] {
    let [mut xx, mut xy, mut yy] = [0.0f32; 3];
    for [x, y] in vectors {
        xx += x * x;
        xy += x * y;
        yy += y * y;
    }
    // Eigenvector of the larger eigenvalue, from the row that is not small.
    let half = 0.5 * (xx - yy);
    let root = (half * half + xy * xy).sqrt();
    let [x, y] = if half >= 0.0 {
        [half + root, xy]
    } else {
        [xy, root - half]
    };
    let length = (x * x + y * y).sqrt().max(1e-12);
    [x / length, y / length]
}

fn dot(a: [f32; 2], b: [f32; 2]) -> f32 {
    a[0] * b[0] + a[1] * b[1]
}
