//! At which foot points of a grid do the colours step, above carpet and not at a line?

use crate::colour::lookup_table::{ColourClass, ColourLookupTable};
use crate::image::{ImageView, OUTSIDE};
use crate::objects::patch::logarithms;

/// Smallest step of the mean logarithm across an edge, and that which remains beyond a line.
const EDGE_STEP_MIN: f32 = 0.25;
const BEYOND_LINE_STEP_MIN: f32 = 0.2;
/// Step between two pixels below which a place is not looked at further.
const PLAIN_STEP_MAX: f32 = 0.08;
/// Places whose colours are read at a time.
const BATCH: usize = 64;

/// Where the grid looks for an edge at a foot point.
#[derive(Debug, Clone, Copy)]
pub(crate) struct EdgePixels {
    pub(crate) below: [[u16; 2]; 2],
    pub(crate) above: [[u16; 2]; 2],
    pub(crate) beyond_line: [u16; 2],
}

/// Foot points whose far pixels differ, in the order of the grid.
#[derive(Debug, Clone, Default)]
struct UnevenPlaces {
    places: Vec<u32>,
    /// Colours of the farther pixels above and below each of them.
    far: Vec<[u32; 2]>,
}

/// The edges at the foot points of a grid.
///
/// Most places are plain and a look at two pixels shows it, so each array holds what one step of the search reads.
#[derive(Debug, Clone)]
pub(crate) struct FootEdges {
    /// Of each place, the farther pixels above and below the foot; [`OUTSIDE`] if it is not visible.
    far_pixels: Vec<[[u16; 2]; 2]>,
    /// The nearer pixels above and below, and that beyond a line.
    near_pixels: Vec<[[u16; 2]; 3]>,
    /// Step of the colours at each place in the last image; 0 where there is no edge above carpet.
    pub(crate) steps: Vec<f32>,
    uneven: UnevenPlaces,
}

impl FootEdges {
    /// `places`: None where a foot point is not visible.
    pub(crate) fn new(places: &[Option<EdgePixels>]) -> Self {
        let far = |it: EdgePixels| [it.above[1], it.below[1]];
        let near = |it: EdgePixels| [it.above[0], it.below[0], it.beyond_line];
        let places = places.iter();
        FootEdges {
            steps: vec![0.0; places.len()],
            uneven: UnevenPlaces::default(),
            far_pixels: places
                .clone()
                .map(|place| place.map_or([OUTSIDE; 2], far))
                .collect(),
            near_pixels: places
                .map(|place| place.map_or([OUTSIDE; 3], near))
                .collect(),
        }
    }

    /// Places at which the colours step between the far pixels.
    fn find_uneven(&mut self, image: &ImageView<'_>) {
        let logarithms = logarithms();
        let UnevenPlaces { places, far } = &mut self.uneven;
        places.resize(self.far_pixels.len(), 0);
        far.resize(self.far_pixels.len(), [0; 2]);
        let mut count = 0;
        let mut place = 0;
        for pixels in self.far_pixels.chunks(BATCH) {
            let mut colours = [[0u32; 2]; BATCH];
            let colours = &mut colours[..pixels.len()];
            image.read_rgb(pixels.as_flattened(), colours.as_flattened_mut());
            for &mut colours in colours {
                let [above, below] = colours.map(|colour| log_colour(logarithms, colour));
                // Without a branch, which would often be foreseen wrongly.
                (places[count], far[count]) = (place, colours);
                count += usize::from(log_step(above, below) >= PLAIN_STEP_MAX);
                place += 1;
            }
        }
        places.truncate(count);
        far.truncate(count);
    }

    /// Finds the steps of an image; returns the places that have one, in the order of the grid.
    pub(crate) fn find(&mut self, image: &ImageView<'_>, table: &ColourLookupTable) -> Vec<usize> {
        self.find_uneven(image);
        let logarithms = logarithms();
        self.steps.fill(0.0);
        let mut steep = Vec::new();
        let UnevenPlaces { places, far } = &self.uneven;
        for (places, far) in places.chunks(BATCH).zip(far.chunks(BATCH)) {
            let mut pixels = [[OUTSIDE; 3]; BATCH];
            for (pixels, &place) in pixels.iter_mut().zip(places) {
                *pixels = self.near_pixels[place as usize];
            }
            let pixels = &pixels[..places.len()];
            let mut near = [[0u32; 3]; BATCH];
            let near = &mut near[..places.len()];
            image.read_rgb(pixels.as_flattened(), near.as_flattened_mut());
            for ((&place, far), near) in places.iter().zip(far).zip(near) {
                let far = far.map(|colour| log_colour(logarithms, colour));
                let near = near.map(|colour| log_colour(logarithms, colour));
                let place = place as usize;
                let edge = edge_step(far, near);
                let below = [self.near_pixels[place][1], self.far_pixels[place][1]];
                if edge > 0.0 && has_carpet(image, table, &below) {
                    self.steps[place] = edge;
                    steep.push(place);
                }
            }
        }
        steep
    }
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

/// Step of the logarithmic colours across an edge; 0 if there is none or it is a line's. `far`: the farther pixels above
/// and below, `near`: the nearer ones, and that beyond a line.
#[inline(always)]
fn edge_step(
    [far_above, far_below]: [[f32; 3]; 2],
    [near_above, near_below, beyond_line]: [[f32; 3]; 3],
) -> f32 {
    let mean = |a: [f32; 3], b: [f32; 3]| [0, 1, 2].map(|channel| (a[channel] + b[channel]) / 2.0);
    let below = mean(near_below, far_below);
    let edge = log_step(mean(near_above, far_above), below);
    if edge < EDGE_STEP_MIN || log_step(beyond_line, below) < BEYOND_LINE_STEP_MIN {
        return 0.0;
    }
    edge
}

/// True if one of two pixels is carpet.
fn has_carpet(image: &ImageView<'_>, table: &ColourLookupTable, pixels: &[[u16; 2]; 2]) -> bool {
    let mut native = [0; 2];
    image.read_native(pixels, &mut native);
    native
        .iter()
        .any(|&pixel| table.cell_class(ColourLookupTable::cell_index(pixel)) == ColourClass::CARPET)
}
