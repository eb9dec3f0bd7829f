//! How bright is the floor? A grid of light and gloss, with the strips of the carpet and the planks around it.

use localize::field::Field;

use super::lanes::{LANES, Lanes, larger, smaller};
use crate::environment::EnvironmentConfig;
use crate::light::LightConfig;

/// Margin of the grid around the carpet, metres.
const MARGIN: f32 = 4.0;
/// Cell of the grid, metres: light changes slowly.
const CELL: f32 = 0.2;
/// Width of a strip of carpet, metres, and contrast between strips.
const STRIP: f32 = 2.0;
const STRIP_CONTRAST: f32 = 0.025;
/// Width and length of a plank of the floor around the carpet, metres.
const PLANK: [f32; 2] = [0.4, 2.4];

/// Light relative to the uniform light, times the floor's relative albedo, and gloss.
pub(super) struct FloorLight {
    half: [f32; 2],
    columns: usize,
    rows: usize,
    light: Vec<f32>,
    /// Empty without gloss.
    gloss: Vec<f32>,
}

impl FloorLight {
    pub(super) fn new(field: &Field, light: &LightConfig, environment: &EnvironmentConfig) -> Self {
        let (carpet_x, carpet_y) = field.carpet_half_extent();
        let half = [carpet_x + MARGIN, carpet_y + MARGIN];
        let [columns, rows] = half.map(|half| (2.0 * half / CELL).ceil() as usize + 1);
        // The field's own walls, if any, hide what is beyond the carpet.
        let albedo = |x: f32, y: f32| {
            if x.abs() < carpet_x && y.abs() < carpet_y {
                carpet_albedo(x, y)
            } else {
                plank_albedo(x, y, environment.plank_contrast)
            }
        };
        let point = |index: usize| {
            let (column, row) = (index % columns, index / columns);
            (column as f32 * CELL - half[0], row as f32 * CELL - half[1])
        };
        let grid = |value: &dyn Fn(f32, f32) -> f32| -> Vec<f32> {
            let points = (0..rows * columns).map(point);
            points.map(|(x, y)| value(x, y)).collect()
        };
        let glossy = light.spots.iter().any(|spot| spot.gloss > 0.0);
        FloorLight {
            half,
            columns,
            rows,
            light: grid(&|x, y| light.spot_light_at(x, y).0 * albedo(x, y)),
            gloss: if glossy {
                grid(&|x, y| light.spot_light_at(x, y).1)
            } else {
                Vec::new()
            },
        }
    }

    /// True if the floor shines somewhere.
    pub(super) fn is_glossy(&self) -> bool {
        !self.gloss.is_empty()
    }

    /// Light and gloss at points of the field, interpolated; the grid's border extends outside.
    #[inline(always)]
    pub(super) fn look_up(&self, x: &Lanes, y: &Lanes, light: &mut Lanes, gloss: &mut Lanes) {
        // Adding 1.5·2²³ leaves the rounded value in the lowest bits: a floor that vectorises.
        const ROUND: f32 = 12_582_912.0;
        const BITS: u32 = 0x3f_ffff;
        let most = [(self.columns - 2) as f32, (self.rows - 2) as f32];
        let columns = self.columns as u32;
        let limited = |value: f32, most: f32| smaller(larger(value, 0.0), most);
        let (mut cell, mut part) = ([0u32; LANES], [[0.0; LANES]; 2]);
        for i in 0..LANES {
            let across = limited((x[i] + self.half[0]) * (1.0 / CELL), most[0] + 1.0);
            let up = limited((y[i] + self.half[1]) * (1.0 / CELL), most[1] + 1.0);
            let column = limited(across - 0.5, most[0]) + ROUND;
            let row = limited(up - 0.5, most[1]) + ROUND;
            (part[0][i], part[1][i]) = (across - (column - ROUND), up - (row - ROUND));
            cell[i] = (row.to_bits() & BITS) * columns + (column.to_bits() & BITS);
        }
        interpolate(&self.light, self.columns, &cell, &part, light);
        if self.is_glossy() {
            interpolate(&self.gloss, self.columns, &cell, &part, gloss);
        }
    }
}

#[inline(always)]
fn interpolate(
    grid: &[f32],
    columns: usize,
    cell: &[u32; LANES],
    [across, up]: &[Lanes; 2],
    out: &mut Lanes,
) {
    let mut corners = [[0.0; LANES]; 4];
    for i in 0..LANES {
        let cell = cell[i] as usize;
        for (corner, at) in [cell, cell + 1, cell + columns, cell + columns + 1]
            .into_iter()
            .enumerate()
        {
            corners[corner][i] = grid[at];
        }
    }
    for i in 0..LANES {
        let low = across[i].mul_add(corners[1][i] - corners[0][i], corners[0][i]);
        let high = across[i].mul_add(corners[3][i] - corners[2][i], corners[2][i]);
        out[i] = up[i].mul_add(high - low, low);
    }
}

/// Relative brightness of a wooden floor, plank by plank.
fn plank_albedo(x: f32, y: f32, contrast: f32) -> f32 {
    let row = (y / PLANK[0]).floor();
    // Planks of neighbouring rows are staggered.
    let column = (x / PLANK[1] + 0.37 * row).floor();
    let hash = (row * 12.9898 + column * 78.233).sin() * 43_758.547;
    1.0 + contrast * (2.0 * (hash - hash.floor()) - 1.0)
}

/// Relative brightness of the carpet: strips and slow variations.
fn carpet_albedo(x: f32, y: f32) -> f32 {
    let strip = if (y / STRIP).floor() as i32 % 2 == 0 {
        1.0
    } else {
        -1.0
    };
    let stains = (1.7 * x + 0.6 * (2.3 * y).sin()).sin() * (1.3 * y + 0.8 * (1.1 * x).cos()).sin();
    1.0 + STRIP_CONTRAST * strip + 0.03 * stains
}
