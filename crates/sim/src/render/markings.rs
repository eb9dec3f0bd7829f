//! How much of a footprint is white paint? Textures of exact coverage, one per size of a pixel's footprint.

use localize::field::{Field, Marking};
use localize::frames::At;

use super::cables::Cable;

/// Ratio of footprints between two levels.
const LEVEL_STEP: f32 = std::f32::consts::SQRT_2;
/// Smallest footprint with a texture, metres: lines are five times as wide.
pub(super) const FOOTPRINT_MIN: f32 = 0.02;
/// Largest footprint with a texture, metres: beyond it a line is hardly visible.
const FOOTPRINT_MAX: f32 = 1.0;

/// Byte of a bare carpet; more is white paint, up to `FULL_MARKING` more, and less is a cable.
pub(super) const NO_MARKING: u8 = 128;
/// Steps of full coverage.
pub(super) const FULL_MARKING: f32 = 127.0;

/// Cell size over the texture's footprint: bilinear interpolation then blurs no more than the footprint.
const CELL_PER_FOOTPRINT: f32 = 0.7;

/// Coverage by white paint or black cables, averaged over square footprints of increasing size.
pub(super) struct MarkingTextures {
    pub(super) levels: Vec<Texture>,
    footprint_min: f32,
}

/// A cell without marking.
const BARE: u32 = u32::from_le_bytes([NO_MARKING; 4]);

/// A grid of bytes over the field; each entry holds the bytes of its cell's four corners, so that one load suffices.
pub(super) struct Texture {
    /// Field coordinates of the first grid point, metres.
    pub(super) left: f32,
    pub(super) bottom: f32,
    /// Cells per metre.
    pub(super) per_metre: f32,
    pub(super) columns: usize,
    pub(super) rows: usize,
    /// Corner (0,0) in the lowest byte, then (1,0), (0,1), (1,1); `index_of` is the order of the cells.
    pub(super) cells: Vec<u32>,
    /// Summed-area table of the 4 × 4 blocks that have a cell with a marking.
    marked_blocks: Vec<u32>,
}

impl Texture {
    /// Samples `value` (0 to 255) on a grid of `cell` metres over ±half_x, ±half_y.
    pub(super) fn new(half_x: f32, half_y: f32, cell: f32, value: impl Fn(f32, f32) -> u8) -> Self {
        let columns = ((2.0 * half_x / cell).ceil() as usize).max(1) + 1;
        let rows = ((2.0 * half_y / cell).ceil() as usize).max(1) + 1;
        let mut texture = Texture {
            left: -half_x,
            bottom: -half_y,
            per_metre: 1.0 / cell,
            columns,
            rows,
            cells: Vec::new(),
            marked_blocks: Vec::new(),
        };
        let grid: Vec<u8> = (0..rows * columns)
            .map(|index| {
                let (x, y) = texture.point(index % columns, index / columns);
                value(x, y)
            })
            .collect();
        texture.pack(&grid);
        texture
    }

    fn pack(&mut self, grid: &[u8]) {
        let (columns, rows, blocks) = (self.columns, self.rows, self.blocks());
        self.cells = vec![BARE; columns.next_multiple_of(4) * rows.next_multiple_of(4)];
        for row in 0..rows {
            for column in 0..columns {
                let index = row * columns + column;
                let right = usize::from(column + 1 < columns);
                let up = usize::from(row + 1 < rows) * columns;
                let corners = [
                    grid[index],
                    grid[index + right],
                    grid[index + up],
                    grid[index + up + right],
                ];
                self.cells[index_of(column as u32, row as u32, blocks) as usize] =
                    u32::from_le_bytes(corners);
            }
        }
        self.sum_marked_blocks();
    }

    fn sum_marked_blocks(&mut self) {
        let stride = self.blocks() as usize + 1;
        self.marked_blocks = vec![0; stride * (self.rows.div_ceil(4) + 1)];
        for (index, block) in self.cells.chunks_exact(16).enumerate() {
            let (column, row) = (index % (stride - 1), index / (stride - 1));
            let corner = row * stride + column;
            let left = self.marked_blocks[corner + stride] + self.marked_blocks[corner + 1];
            self.marked_blocks[corner + stride + 1] = left - self.marked_blocks[corner]
                + u32::from(block.iter().any(|&cell| cell != BARE));
        }
    }

    /// True if a lookup within ± half of a point of the field may meet a marking.
    pub(super) fn any_marking_within(&self, centre: [f32; 2], half: [f32; 2]) -> bool {
        let stride = self.blocks() as usize + 1;
        // A cell of margin, since lookups round.
        let block = |metres: f32, spare: f32, most: usize| {
            ((metres * self.per_metre + spare).max(0.0) as usize).min(most - 1) / 4
        };
        let (x, y) = (centre[0] - self.left, centre[1] - self.bottom);
        let left = block(x - half[0], -1.0, self.columns);
        let right = block(x + half[0], 1.0, self.columns) + 1;
        let bottom = block(y - half[1], -1.0, self.rows) * stride;
        let top = (block(y + half[1], 1.0, self.rows) + 1) * stride;
        let below = self.marked_blocks[bottom + right] - self.marked_blocks[bottom + left];
        self.marked_blocks[top + right] - self.marked_blocks[top + left] > below
    }

    /// Number of blocks of four columns in a row.
    #[inline(always)]
    pub(super) fn blocks(&self) -> u32 {
        self.columns.div_ceil(4) as u32
    }

    /// Field coordinates of a grid point, metres.
    pub(super) fn point(&self, column: usize, row: usize) -> (f32, f32) {
        (
            self.left + column as f32 / self.per_metre,
            self.bottom + row as f32 / self.per_metre,
        )
    }
}

/// Index of a cell: blocks of 4 × 4 fill a cache line, for any direction in which rays cross them.
#[inline(always)]
pub(super) fn index_of(column: u32, row: u32, blocks: u32) -> u32 {
    (((row >> 2) * blocks + (column >> 2)) << 4) + ((row & 3) << 2) + (column & 3)
}

impl MarkingTextures {
    /// Textures of markings and cables for footprints from `finest` (metres) upwards.
    pub(super) fn new(field: &Field, cables: &[Cable], finest: f32) -> Self {
        let finest = finest.clamp(FOOTPRINT_MIN, FOOTPRINT_MAX / 2.0);
        let mut levels = Vec::new();
        let mut width = finest;
        while width < FOOTPRINT_MAX {
            levels.push(level(field, cables, width));
            width *= LEVEL_STEP;
        }
        MarkingTextures {
            levels,
            footprint_min: finest,
        }
    }

    /// The level for a footprint, metres.
    pub(super) fn level(&self, footprint: f32) -> usize {
        let steps = (footprint / self.footprint_min).max(1.0).log(LEVEL_STEP);
        (steps.round() as usize).min(self.levels.len() - 1)
    }
}

fn level(field: &Field, cables: &[Cable], width: f32) -> Texture {
    // Markings end within the carpet; the bare border extends to everything outside.
    let (half_x, half_y) = field.carpet_half_extent();
    let (half_x, half_y) = (half_x + 2.0 * width, half_y + 2.0 * width);
    let cell = width * CELL_PER_FOOTPRINT;
    let mut texture = Texture::new(half_x, half_y, cell, |_, _| NO_MARKING);
    let mut grid = vec![NO_MARKING; texture.columns * texture.rows];
    for marking in painted_markings(field) {
        let half = field.config.line_width / 2.0;
        rasterise(
            &mut grid,
            &texture,
            &marking,
            half,
            width,
            |byte, covered| {
                // Where markings overlap, the larger coverage counts.
                let white = (f32::from(NO_MARKING) + FULL_MARKING * covered).round() as u8;
                *byte = (*byte).max(white);
            },
        );
    }
    for cable in cables {
        for segment in cable.segments() {
            let half = cable.width / 2.0;
            rasterise(
                &mut grid,
                &texture,
                &segment,
                half,
                width,
                |byte, covered| {
                    // A cable lies on the paint.
                    let under = f32::from(*byte) - f32::from(NO_MARKING);
                    let over = under.max(0.0) * (1.0 - covered) - FULL_MARKING * covered;
                    *byte = (f32::from(NO_MARKING) + over.min(under)).round() as u8;
                },
            );
        }
    }
    for column in 0..texture.columns {
        grid[column] = NO_MARKING;
        grid[(texture.rows - 1) * texture.columns + column] = NO_MARKING;
    }
    for row in 0..texture.rows {
        grid[row * texture.columns] = NO_MARKING;
        grid[(row + 1) * texture.columns - 1] = NO_MARKING;
    }
    texture.pack(&grid);
    texture
}

/// The painted markings: walls replace the boundary lines, except at the goals' mouths.
fn painted_markings(field: &Field) -> Vec<Marking> {
    if !field.config.walls {
        return field.markings.clone();
    }
    let (half_x, half_y) = (field.length / 2.0, field.width / 2.0);
    let mouth = field.config.goal.width / 2.0;
    let is_wall = |a: f32, b: f32, half: f32| a == b && a.abs() == half;
    let paint = |marking: &Marking| match *marking {
        Marking::Line { from, to } if is_wall(from.y, to.y, half_y) => None,
        Marking::Line { from, to } if is_wall(from.x, to.x, half_x) => Some(Marking::Line {
            from: At::new(from.x, -mouth),
            to: At::new(to.x, mouth),
        }),
        other => Some(other),
    };
    field.markings.iter().filter_map(paint).collect()
}

/// Adds the coverage of a footprint by a marking to each byte of the grid around it.
fn rasterise(
    grid: &mut [u8],
    texture: &Texture,
    marking: &Marking,
    half_line: f32,
    width: f32,
    add: impl Fn(&mut u8, f32),
) {
    let (x0, y0, x1, y1) = bounds(marking);
    let margin = half_line + width;
    let cell = |metres: f32, origin: f32, most: usize| {
        (((metres - origin) * texture.per_metre).max(0.0) as usize).min(most - 1)
    };
    let columns = cell(x0 - margin, texture.left, texture.columns)
        ..=cell(x1 + margin, texture.left, texture.columns);
    let rows = cell(y0 - margin, texture.bottom, texture.rows)
        ..=cell(y1 + margin, texture.bottom, texture.rows);
    for row in rows {
        for column in columns.clone() {
            let (x, y) = texture.point(column, row);
            let covered = coverage(marking, half_line, x, y, width);
            if covered > 0.0 {
                add(&mut grid[row * texture.columns + column], covered);
            }
        }
    }
}

fn bounds(marking: &Marking) -> (f32, f32, f32, f32) {
    match *marking {
        Marking::Line { from, to } => (
            from.x.min(to.x),
            from.y.min(to.y),
            from.x.max(to.x),
            from.y.max(to.y),
        ),
        Marking::Arc { centre, radius, .. } | Marking::Spot { centre, radius } => (
            centre.x - radius,
            centre.y - radius,
            centre.x + radius,
            centre.y + radius,
        ),
    }
}

/// Share of a footprint of `width` around (x, y) that a marking covers: exact for a straight line across it.
pub(super) fn coverage(marking: &Marking, half_line: f32, x: f32, y: f32, width: f32) -> f32 {
    match *marking {
        Marking::Line { from, to } => {
            let (along_x, along_y) = (to.x - from.x, to.y - from.y);
            let length = along_x.hypot(along_y).max(1e-6);
            let (ux, uy) = (along_x / length, along_y / length);
            let (dx, dy) = (x - from.x, y - from.y);
            let along = dx * ux + dy * uy - length / 2.0;
            let across = dy * ux - dx * uy;
            // Corners are full: each line extends by half a line width beyond its end point.
            interval_coverage(across, half_line, width)
                * interval_coverage(along, length / 2.0 + half_line, width)
        }
        Marking::Arc {
            centre,
            radius,
            start,
            sweep,
        } => {
            let (dx, dy) = (x - centre.x, y - centre.y);
            let turned = (dy.atan2(dx) - start).rem_euclid(std::f32::consts::TAU);
            let beyond = (turned - sweep).min(std::f32::consts::TAU - turned) * radius;
            let inside = if turned <= sweep {
                1.0
            } else {
                (0.5 - beyond / width).max(0.0)
            };
            interval_coverage(dx.hypot(dy) - radius, half_line, width) * inside
        }
        Marking::Spot { centre, radius } => {
            let (dx, dy) = (x - centre.x, y - centre.y);
            interval_coverage(dx.hypot(dy), radius, width)
        }
    }
}

/// Share of [offset − width/2, offset + width/2] within ± half.
fn interval_coverage(offset: f32, half: f32, width: f32) -> f32 {
    let from = (offset - width / 2.0).max(-half);
    let to = (offset + width / 2.0).min(half);
    ((to - from) / width).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn walls_replace_boundary_lines_except_at_goal_mouths() {
        let text = include_str!("../../../../config/fields/msl_2001.toml");
        let field = Field::new(toml::from_str(text).expect("a field")).expect("a field");
        let white = |x, y| {
            let of = |marking: &Marking| coverage(marking, 0.025, x, y, 0.01);
            painted_markings(&field).iter().map(of).fold(0.0, f32::max)
        };
        assert_eq!([white(2.0, 2.24), white(4.49, 2.0)], [0.0, 0.0]);
        assert!(white(4.5, 0.5) > 0.999 && white(0.0, 2.2) > 0.999);
    }

    #[test]
    fn narrow_line_covers_its_fraction_of_the_footprint() {
        let line = Marking::Line {
            from: At::new(-5.0, 0.0),
            to: At::new(5.0, 0.0),
        };
        assert!((coverage(&line, 0.05, 0.0, 0.1, 0.5) - 0.2).abs() < 1e-6);
        assert!((coverage(&line, 0.05, 0.0, 0.05, 0.02) - 0.5).abs() < 1e-6);
        assert_eq!(coverage(&line, 0.05, 0.0, 0.2, 0.02), 0.0);
    }
}
