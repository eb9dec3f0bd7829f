//! At which foot points of a grid do the colours step, above carpet and not at a line?

use crate::colour::lookup_table::{ColourClass, ColourLookupTable};
use crate::image::{ImageView, OUTSIDE};
use crate::objects::patch::{LOG_OFFSET, logarithms};

/// Smallest step of the mean logarithm across an edge, that which remains beyond a line, and that between the farther pixels.
const EDGE_STEP_MIN: f32 = 0.25;
const BEYOND_LINE_STEP_MIN: f32 = 0.2;
const FAR_STEP_MIN: f32 = 0.08;
/// No edge has a smaller [`edge_bound`]: it is least if one channel alone steps, tanh(3 · `EDGE_STEP_MIN`) = 0.635.
const EDGE_BOUND_MIN: f32 = 0.63;
/// Places whose colours are read at a time.
const BATCH: usize = 64;

/// Where the grid looks for an edge at a foot point; the nearer pixels first.
#[derive(Debug, Clone, Copy)]
pub(crate) struct EdgePixels {
    pub(crate) below: [[u16; 2]; 2],
    pub(crate) above: [[u16; 2]; 2],
    pub(crate) beyond_line: [u16; 2],
}

/// The edges at the foot points of a grid.
///
/// Most places have none. A bound of the step shows this without logarithms.
#[derive(Debug, Clone)]
pub(crate) struct FootEdges {
    /// Of each place, the nearer and the farther pixel above the foot, and those below it; [`OUTSIDE`] if it is not visible.
    above: [Vec<[u16; 2]>; 2],
    below: [Vec<[u16; 2]>; 2],
    beyond_line: Vec<[u16; 2]>,
    /// Step of the colours at each place in the last image; 0 where there is no edge above carpet.
    pub(crate) steps: Vec<f32>,
}

impl FootEdges {
    /// `places`: None where a foot point is not visible.
    pub(crate) fn new(places: &[Option<EdgePixels>]) -> Self {
        let pixels = |pixel: &dyn Fn(&EdgePixels) -> [u16; 2]| -> Vec<[u16; 2]> {
            let of_place = |place: &Option<EdgePixels>| place.as_ref().map_or(OUTSIDE, pixel);
            places.iter().map(of_place).collect()
        };
        FootEdges {
            above: [0, 1].map(|which| pixels(&|place| place.above[which])),
            below: [0, 1].map(|which| pixels(&|place| place.below[which])),
            beyond_line: pixels(&|place| place.beyond_line),
            steps: vec![0.0; places.len()],
        }
    }

    /// Finds the steps of an image; returns the places that have one, in the order of the grid.
    pub(crate) fn find(&mut self, image: &ImageView<'_>, table: &ColourLookupTable) -> Vec<usize> {
        self.steps.fill(0.0);
        let mut steep = Vec::new();
        for first in (0..self.steps.len()).step_by(BATCH) {
            let batch = first..self.steps.len().min(first + BATCH);
            let read = |pixels: &Vec<[u16; 2]>| {
                let mut colours = [0u32; BATCH];
                image.read_rgb(&pixels[batch.clone()], &mut colours[..batch.len()]);
                colours
            };
            let [above, below] = [&self.above, &self.below].map(|both| both.each_ref().map(read));
            let mut bounds = [0.0f32; BATCH];
            for (index, bound) in bounds.iter_mut().enumerate() {
                *bound = edge_bound(
                    [above[0][index], above[1][index]],
                    [below[0][index], below[1][index]],
                );
            }
            let mut likely = [0usize; BATCH];
            let mut count = 0;
            for (index, bound) in bounds.iter().enumerate() {
                // Without a branch, which would often be foreseen wrongly.
                likely[count % BATCH] = index;
                count += usize::from(*bound >= EDGE_BOUND_MIN);
            }
            let likely = &likely[..count];
            let mut pixels = [OUTSIDE; BATCH];
            for (pixel, &index) in pixels.iter_mut().zip(likely) {
                *pixel = self.beyond_line[first + index];
            }
            let mut beyond_line = [0u32; BATCH];
            image.read_rgb(&pixels[..count], &mut beyond_line[..count]);
            for (&index, &beyond_line) in likely.iter().zip(&beyond_line) {
                let place = first + index;
                let step = edge_step(
                    [above[0][index], above[1][index]],
                    [below[0][index], below[1][index]],
                    beyond_line,
                );
                if step > 0.0 && has_carpet(image, table, self.below.each_ref().map(|it| it[place]))
                {
                    self.steps[place] = step;
                    steep.push(place);
                }
            }
        }
        steep
    }
}

/// Bound of three times the step across an edge, from below. Colours of the nearer and the farther pixel above the foot, and
/// of those below.
///
/// A channel's step is half of ln(p / q), where p and q are products of the levels above and below. This is artanh(t) with
/// t = (p - q) / (p + q), which is more than t. Vector instructions compute t for many places at once, while logarithms are
/// looked up one by one.
#[inline(always)]
fn edge_bound(above: [u32; 2], below: [u32; 2]) -> f32 {
    let mut sum = 0.0;
    for channel in 0..3 {
        let level = |colour: u32| (colour >> (8 * channel) & 0xff) as i32 as f32 + LOG_OFFSET;
        let [p, q] = [above, below].map(|[near, far]| level(near) * level(far));
        sum += (p - q).abs() / (p + q);
    }
    sum
}

/// Logarithms of a colour whose red is in the lowest byte.
#[inline(always)]
fn log_colour(logarithms: &[f32; 256], colour: u32) -> [f32; 3] {
    let [r, g, b, _] = colour.to_le_bytes();
    [r, g, b].map(|level| logarithms[usize::from(level)])
}

/// Mean difference of two logarithmic colours.
#[inline(always)]
fn log_step(a: [f32; 3], b: [f32; 3]) -> f32 {
    ((a[0] - b[0]).abs() + (a[1] - b[1]).abs() + (a[2] - b[2]).abs()) / 3.0
}

/// Step of the logarithmic colours across an edge; 0 if there is none or it is a line's. Colours of the nearer and the farther
/// pixel above, of those below, and of that beyond a line.
#[inline(always)]
fn edge_step(above: [u32; 2], below: [u32; 2], beyond_line: u32) -> f32 {
    let logarithms = logarithms();
    let [above, below] = [above, below].map(|both| both.map(|it| log_colour(logarithms, it)));
    let beyond_line = log_colour(logarithms, beyond_line);
    let mean = |[near, far]: [[f32; 3]; 2]| [0, 1, 2].map(|it| (near[it] + far[it]) / 2.0);
    let floor = mean(below);
    let edge = log_step(mean(above), floor);
    if edge < EDGE_STEP_MIN
        || log_step(beyond_line, floor) < BEYOND_LINE_STEP_MIN
        || log_step(above[1], below[1]) < FAR_STEP_MIN
    {
        return 0.0;
    }
    edge
}

/// True if one of two pixels is carpet.
fn has_carpet(image: &ImageView<'_>, table: &ColourLookupTable, pixels: [[u16; 2]; 2]) -> bool {
    pixels.into_iter().any(|pixel| {
        let [u, v] = pixel.map(usize::from);
        table.class(image.native_channels(u, v)) == ColourClass::CARPET
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::PixelFormat;

    const SIDE_PX: usize = 60;

    fn random(state: &mut u32) -> u32 {
        *state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        *state >> 16
    }

    /// The definition, for one place: logarithms of single pixels.
    fn step_at(image: &ImageView<'_>, table: &ColourLookupTable, place: &EdgePixels) -> f32 {
        let logs = |[u, v]: [u16; 2]| {
            let rgb = image.rgb(usize::from(u), usize::from(v));
            rgb.map(|level| logarithms()[usize::from(level)])
        };
        let mean = |[a, b]: [[f32; 3]; 2]| [0, 1, 2].map(|it: usize| (a[it] + b[it]) / 2.0);
        let (above, below) = (place.above.map(logs), place.below.map(logs));
        let edge = log_step(mean(above), mean(below));
        let found = log_step(above[1], below[1]) >= FAR_STEP_MIN
            && edge >= EDGE_STEP_MIN
            && log_step(logs(place.beyond_line), mean(below)) >= BEYOND_LINE_STEP_MIN
            && has_carpet(image, table, place.below);
        if found { edge } else { 0.0 }
    }

    #[test]
    fn steps_are_those_of_single_places_and_none_is_left_out_by_the_bound() {
        let mut state = 5;
        let table = ColourLookupTable::new(|[r, ..]| match r % 8 < 6 {
            true => ColourClass::CARPET,
            false => ColourClass::OTHER,
        });
        for contrast in [10, 40, 120, 255] {
            let mut level = || (random(&mut state) % (contrast + 1)) as u8;
            let data: Vec<u8> = (0..3 * SIDE_PX * SIDE_PX).map(|_| level()).collect();
            let image = ImageView::packed(SIDE_PX, SIDE_PX, PixelFormat::Rgb8, &data);
            let mut pixel = || [0; 2].map(|_| (random(&mut state) as usize % SIDE_PX) as u16);
            let places: Vec<Option<EdgePixels>> = (0..2003)
                .map(|number| {
                    (number % 9 > 0).then(|| EdgePixels {
                        below: [pixel(), pixel()],
                        above: [pixel(), pixel()],
                        beyond_line: pixel(),
                    })
                })
                .collect();
            let mut edges = FootEdges::new(&places);
            let found = edges.find(&image, &table);
            let mut expected = Vec::new();
            for (number, place) in places.iter().enumerate() {
                let step = place
                    .as_ref()
                    .map_or(0.0, |place| step_at(&image, &table, place));
                assert_eq!(edges.steps[number].to_bits(), step.to_bits(), "{number}");
                if step > 0.0 {
                    expected.push(number);
                }
            }
            assert_eq!(found, expected);
            assert!(expected.len() > 20, "{}", expected.len());
        }
    }
}
