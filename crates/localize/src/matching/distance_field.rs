//! Distance field: signed distance and direction to the nearest marking, by one look-up without interpolation.
//!
//! nubot2013 4 and minho2016 IV store the distance d(p) per cell. Here a cell stores the tangent of its nearest marking and how it bends
//! (signed distance at the cell's centre, unit normal and curvature). Distance and gradient are exact for straight lines and to second
//! order on the arcs, and the signed distance is smooth across the line's centre.
//!
//! Without the curvature the normals of an arc's points would differ from its radii by half a degree, in steps. Points on one circle say
//! nothing about a turn of the robot about its centre, but the squares of these errors would add up to a certain pose.

use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::field::{Field, Marking};
use crate::math;

/// Layout of the distance field.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct DistanceFieldConfig {
    /// Side of a cell, metres. At 0.05 the error of the tangent of the smallest arc (0.75 m) is at most 0.4 mm.
    pub cell: f32,
    /// Extent beyond the carpet's edge, metres: points farther out are outliers and need no exact distance.
    pub margin: f32,
}

impl Default for DistanceFieldConfig {
    fn default() -> Self {
        DistanceFieldConfig {
            cell: 0.05,
            margin: 0.5,
        }
    }
}

/// Tangent of the marking nearest to a cell, and how it bends.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(align(16))]
struct Cell {
    /// Signed distance at the cell's centre, metres; positive on the normal's side.
    signed_distance: f32,
    normal_x: f32,
    normal_y: f32,
    /// Turn of the normal per metre along the marking, radians: positive where the marking bends away from the normal. Zero at points,
    /// whose normals turn too fast for a cell.
    curvature: f32,
}

impl Cell {
    /// Of a field without markings.
    const NONE: Cell = Cell {
        signed_distance: f32::MAX,
        normal_x: 1.0,
        normal_y: 0.0,
        curvature: 0.0,
    };
}

/// Rows and columns of a block, whose cells are compared with the markings near it only.
const BLOCK_CELLS: usize = 16;
/// Errors of a distance by rounding, metres.
const ROUNDING: f32 = 1e-3;

/// Signed distance to the nearest marking's centre line, with its gradient.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NearestMarking {
    /// Metres; its absolute value is the distance.
    pub signed_distance: f32,
    /// The gradient of `signed_distance` (unit length), field frame.
    pub normal: [f32; 2],
}

/// Distances to the nearest marking, in cells that cover the carpet.
#[derive(Debug, Clone, PartialEq)]
pub struct DistanceField {
    cells: Vec<Cell>,
    /// 1 for each cell whose nearest place is the end of a line that meets no other, else 0. Empty on a field without such ends.
    free_ends: Vec<f32>,
    columns: usize,
    rows: usize,
    cell: f32,
    cells_per_metre: f32,
    /// Centre of cell (0, 0), metres.
    x0: f32,
    y0: f32,
}

impl DistanceField {
    /// Finds the nearest marking of each cell; blocks of rows run in parallel on rayon's global pool.
    pub fn new(field: &Field, config: &DistanceFieldConfig) -> Self {
        let (half_x, half_y) = field.carpet_half_extent();
        let cell = config.cell;
        let half_columns = ((half_x + config.margin) / cell).ceil();
        let half_rows = ((half_y + config.margin) / cell).ceil();
        let columns = 2 * half_columns as usize + 1;
        let rows = 2 * half_rows as usize + 1;
        let (x0, y0) = (-half_columns * cell, -half_rows * cell);
        let mut cells = vec![Cell::NONE; rows * columns];
        let blocks = cells.par_chunks_mut(BLOCK_CELLS * columns).enumerate();
        blocks.for_each(|(number, cells)| {
            let rows = Rows {
                columns,
                first: number * BLOCK_CELLS,
                origin: [x0, y0],
                side: cell,
            };
            rows.fill(cells, &field.markings);
        });
        let mut free_ends = Vec::new();
        let ends = find_free_ends(&field.markings);
        if !ends.is_empty() {
            free_ends.extend(cells.iter().enumerate().map(|(index, near)| {
                let centre = [
                    x0 + (index % columns) as f32 * cell,
                    y0 + (index / columns) as f32 * cell,
                ];
                f32::from(u8::from(is_at_end(near, centre, &ends)))
            }));
        }
        DistanceField {
            cells,
            free_ends,
            columns,
            rows,
            cell,
            cells_per_metre: 1.0 / cell,
            x0,
            y0,
        }
    }

    /// The marking nearest to (x, y) on the field, metres; beyond the cells the tangents of the border are extrapolated.
    #[inline]
    pub fn nearest(&self, x: f32, y: f32) -> NearestMarking {
        let [column, row] = self.column_and_row(x, y);
        let cell = self.cells[row * self.columns + column];
        let dx = x - (self.x0 + column as f32 * self.cell);
        let dy = y - (self.y0 + row as f32 * self.cell);
        let along = cell.normal_x * dy - cell.normal_y * dx;
        let turn = cell.curvature * along;
        NearestMarking {
            signed_distance: cell.signed_distance
                + cell.normal_x * dx
                + cell.normal_y * dy
                + 0.5 * turn * along,
            normal: [
                cell.normal_x - turn * cell.normal_y,
                cell.normal_y + turn * cell.normal_x,
            ],
        }
    }

    /// Of the cell that a place lies in, or of that at the border.
    #[inline]
    fn column_and_row(&self, x: f32, y: f32) -> [usize; 2] {
        // Casts saturate: far points and NaN map to a border cell.
        let column = ((x - self.x0) * self.cells_per_metre + 0.5) as usize;
        let row = ((y - self.y0) * self.cells_per_metre + 0.5) as usize;
        [column.min(self.columns - 1), row.min(self.rows - 1)]
    }

    /// [`DistanceField::nearest`] of several places: signed distances, normals along x and along y.
    #[inline]
    pub(super) fn nearest_lanes<const N: usize>(
        &self,
        x: &[f32; N],
        y: &[f32; N],
    ) -> [[f32; N]; 3] {
        let (last_column, last_row) = ((self.columns - 1) as f32, (self.rows - 1) as f32);
        let [mut column, mut row] = [[0.0_f32; N]; 2];
        let mut index = [0_i32; N];
        for k in 0..N {
            // NaN maps to 0, as in `nearest`.
            column[k] = ((x[k] - self.x0) * self.cells_per_metre + 0.5)
                .max(0.0)
                .min(last_column)
                .trunc();
            row[k] = ((y[k] - self.y0) * self.cells_per_metre + 0.5)
                .max(0.0)
                .min(last_row)
                .trunc();
            index[k] = row[k] as i32 * self.columns as i32 + column[k] as i32;
        }
        let [mut distance, mut normal_x, mut normal_y, mut curvature] = [[0.0; N]; 4];
        for k in 0..N {
            let cell = self.cells[index[k] as usize];
            distance[k] = cell.signed_distance;
            normal_x[k] = cell.normal_x;
            normal_y[k] = cell.normal_y;
            curvature[k] = cell.curvature;
        }
        for k in 0..N {
            let dx = x[k] - (self.x0 + column[k] * self.cell);
            let dy = y[k] - (self.y0 + row[k] * self.cell);
            let along = normal_x[k] * dy - normal_y[k] * dx;
            let turn = curvature[k] * along;
            distance[k] = distance[k] + normal_x[k] * dx + normal_y[k] * dy + 0.5 * turn * along;
            let (nx, ny) = (normal_x[k], normal_y[k]);
            normal_x[k] = nx - turn * ny;
            normal_y[k] = ny + turn * nx;
        }
        [distance, normal_x, normal_y]
    }

    /// 1 for each of several places that is nearest to a free end of a line, else 0. None on a field without such ends.
    pub(super) fn free_end_lanes<const N: usize>(
        &self,
        x: &[f32; N],
        y: &[f32; N],
    ) -> Option<[f32; N]> {
        (!self.free_ends.is_empty()).then(|| {
            std::array::from_fn(|k| {
                let [column, row] = self.column_and_row(x[k], y[k]);
                self.free_ends[row * self.columns + column]
            })
        })
    }

    /// Memory held, bytes.
    pub fn memory_bytes(&self) -> usize {
        self.cells.len() * size_of::<Cell>() + self.free_ends.len() * size_of::<f32>()
    }
}

/// A block of rows of a distance field.
struct Rows {
    columns: usize,
    /// Number of the first of them.
    first: usize,
    /// Centre of the field's cell (0, 0), metres.
    origin: [f32; 2],
    /// Of a cell, metres.
    side: f32,
}

impl Rows {
    fn centre(&self, column: usize, row: usize) -> [f32; 2] {
        let [x0, y0] = self.origin;
        [
            x0 + column as f32 * self.side,
            y0 + (self.first + row) as f32 * self.side,
        ]
    }

    fn fill(&self, cells: &mut [Cell], markings: &[Marking]) {
        // No cell of a block is farther from the block's middle than `reach`: the nearest marking of each is among those
        // that are at most twice as much farther from the middle than the nearest one there.
        let middle = 0.5 * (BLOCK_CELLS - 1) as f32 * self.side;
        let reach = std::f32::consts::SQRT_2 * middle + ROUNDING;
        let mut distances = Vec::with_capacity(markings.len());
        let mut near: Vec<&Marking> = Vec::with_capacity(markings.len());
        for first in (0..self.columns).step_by(BLOCK_CELLS) {
            let [x, y] = self.centre(first, 0).map(|corner| corner + middle);
            distances.clear();
            distances.extend(
                markings
                    .iter()
                    .map(|marking| tangent_to_marking(marking, x, y).signed_distance.abs()),
            );
            let nearest = distances.iter().copied().fold(f32::INFINITY, f32::min);
            let pairs = markings.iter().zip(&distances);
            near.clear();
            near.extend(
                pairs
                    .filter(|(_, distance)| **distance <= nearest + 2.0 * reach)
                    .map(|(marking, _)| marking),
            );
            let end = (first + BLOCK_CELLS).min(self.columns);
            for (row, cells) in cells.chunks_mut(self.columns).enumerate() {
                for (column, cell) in (first..end).zip(&mut cells[first..end]) {
                    let [x, y] = self.centre(column, row);
                    *cell = nearest_tangent(near.iter().copied(), x, y);
                }
            }
        }
    }
}

/// Ends of lines that lie on no other marking.
fn find_free_ends(markings: &[Marking]) -> Vec<[f32; 2]> {
    /// Nearer to a marking, an end lies on it, metres: drawings are as exact.
    const ON_MARKING: f32 = 0.05;
    let ends = markings.iter().enumerate().filter_map(|(index, marking)| {
        let Marking::Line { from, to } = *marking else {
            return None;
        };
        Some([from, to].map(|end| (index, [end.x, end.y])))
    });
    let meets_another = |index: usize, [x, y]: [f32; 2]| {
        let others = markings
            .iter()
            .enumerate()
            .filter(|(other, _)| *other != index);
        let mut distances = others.map(|(_, other)| tangent(other, x, y).signed_distance.abs());
        distances.any(|distance| distance < ON_MARKING)
    };
    ends.flatten()
        .filter(|(index, end)| !meets_another(*index, *end))
        .map(|(_, end)| end)
        .collect()
}

/// Is a cell's nearest place one of these ends?
fn is_at_end(cell: &Cell, [x, y]: [f32; 2], ends: &[[f32; 2]]) -> bool {
    let nearest = [
        x - cell.signed_distance * cell.normal_x,
        y - cell.signed_distance * cell.normal_y,
    ];
    let off = |end: &[f32; 2]| math::hypot(nearest[0] - end[0], nearest[1] - end[1]);
    cell.curvature == 0.0 && ends.iter().any(|end| off(end) < ROUNDING)
}

/// A marking as seen from (x, y): signed distance and normal, without cells.
pub fn tangent(marking: &Marking, x: f32, y: f32) -> NearestMarking {
    let cell = tangent_to_marking(marking, x, y);
    NearestMarking {
        signed_distance: cell.signed_distance,
        normal: [cell.normal_x, cell.normal_y],
    }
}

/// The tangent of the marking nearest to (x, y).
fn nearest_tangent<'a>(markings: impl Iterator<Item = &'a Marking>, x: f32, y: f32) -> Cell {
    let mut best = Cell::NONE;
    for marking in markings {
        let candidate = tangent_to_marking(marking, x, y);
        if candidate.signed_distance.abs() < best.signed_distance.abs() {
            best = candidate;
        }
    }
    best
}

fn tangent_to_marking(marking: &Marking, x: f32, y: f32) -> Cell {
    match *marking {
        Marking::Line { from, to } => {
            let (ux, uy) = (to.x - from.x, to.y - from.y);
            let length = math::hypot(ux, uy);
            if length == 0.0 {
                return tangent_to_point(x - from.x, y - from.y);
            }
            let (ux, uy) = (ux / length, uy / length);
            let along = (x - from.x) * ux + (y - from.y) * uy;
            if along < 0.0 {
                tangent_to_point(x - from.x, y - from.y)
            } else if along > length {
                tangent_to_point(x - to.x, y - to.y)
            } else {
                Cell {
                    signed_distance: (y - from.y) * ux - (x - from.x) * uy,
                    normal_x: -uy,
                    normal_y: ux,
                    curvature: 0.0,
                }
            }
        }
        Marking::Arc {
            centre,
            radius,
            start,
            sweep,
        } => {
            let (dx, dy) = (x - centre.x, y - centre.y);
            let turned = (math::atan2(dy, dx) - start).rem_euclid(std::f32::consts::TAU);
            if turned <= sweep {
                let out = tangent_to_point(dx, dy);
                Cell {
                    signed_distance: out.signed_distance - radius,
                    curvature: 1.0 / out.signed_distance.max(0.5 * radius),
                    ..out
                }
            } else {
                let end = |angle: f32| {
                    tangent_to_point(
                        dx - radius * math::cos(angle),
                        dy - radius * math::sin(angle),
                    )
                };
                let (first, last) = (end(start), end(start + sweep));
                if first.signed_distance < last.signed_distance {
                    first
                } else {
                    last
                }
            }
        }
        // The white run of a scan line over a spot is centred near the spot's centre.
        Marking::Spot { centre, .. } => tangent_to_point(x - centre.x, y - centre.y),
    }
}

/// Tangent at (dx, dy) from a point marking: distance to the point.
fn tangent_to_point(dx: f32, dy: f32) -> Cell {
    let distance = math::hypot(dx, dy);
    if distance < 1e-6 {
        return Cell {
            signed_distance: 0.0,
            normal_x: 1.0,
            normal_y: 0.0,
            curvature: 0.0,
        };
    }
    Cell {
        signed_distance: distance,
        normal_x: dx / distance,
        normal_y: dy / distance,
        curvature: 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::tests::league_18x12;

    #[test]
    fn signed_distance_is_within_a_millimetre_of_the_nearest_marking() {
        let field = league_18x12("centres");
        let distances = DistanceField::new(&field, &DistanceFieldConfig::default());
        for step in 0..4000 {
            // Quasi-random points on the carpet (golden ratio in both coordinates).
            let x = (step as f32 * 0.618_034).fract() * 19.0 - 9.5;
            let y = (step as f32 * 0.754_877_7).fract() * 13.0 - 6.5;
            let mut by_marking: Vec<f32> = field
                .markings
                .iter()
                .map(|marking| tangent_to_marking(marking, x, y).signed_distance.abs())
                .collect();
            by_marking.sort_by(f32::total_cmp);
            let truth = by_marking[0];
            let distance = distances.nearest(x, y).signed_distance.abs();
            // Between two equally near markings a cell stores either, so that the error is up to a cell's diagonal.
            // Spots and line ends have more curvature than a cell's tangent represents.
            let unambiguous = by_marking[1] - truth > 0.08 && truth < 0.3;
            let spot = [0.0, 6.0_f32].map(|at| (x.abs() - at).hypot(y) < 0.3);
            let bound = if unambiguous && spot == [false; 2] {
                0.001
            } else {
                0.05
            };
            assert!(
                (distance - truth).abs() < bound,
                "({x}, {y}): {distance} for {truth}"
            );
        }
    }

    #[test]
    fn every_cell_has_the_nearest_of_all_markings() {
        let field = league_18x12("centres");
        for cell in [0.05, 0.13] {
            let config = DistanceFieldConfig { cell, margin: 2.0 };
            let distances = DistanceField::new(&field, &config);
            for (index, stored) in distances.cells.iter().enumerate() {
                let (row, column) = (index / distances.columns, index % distances.columns);
                let x = distances.x0 + column as f32 * cell;
                let y = distances.y0 + row as f32 * cell;
                assert_eq!(*stored, nearest_tangent(field.markings.iter(), x, y));
            }
        }
    }

    #[test]
    fn ends_are_free_that_lie_on_no_other_marking() {
        assert_eq!(
            find_free_ends(&league_18x12("centres").markings),
            Vec::<[f32; 2]>::new()
        );
        let line = |from: [f32; 2], to: [f32; 2]| {
            let point = |[x, y]: [f32; 2]| crate::frames::At::new(x, y);
            Marking::Line {
                from: point(from),
                to: point(to),
            }
        };
        // A T whose stem ends at 3 m.
        let markings = [line([0.0, -2.0], [0.0, 2.0]), line([0.0, 0.0], [3.0, 0.0])];
        let expected = vec![[0.0, -2.0], [0.0, 2.0], [3.0, 0.0]];
        assert_eq!(find_free_ends(&markings), expected);
        let beyond = nearest_tangent(markings.iter(), 3.2, 0.1);
        assert!(is_at_end(&beyond, [3.2, 0.1], &expected));
        let beside = nearest_tangent(markings.iter(), 2.8, 0.1);
        assert!(!is_at_end(&beside, [2.8, 0.1], &expected));
    }

    #[test]
    fn gradient_points_away_from_the_line() {
        let field = league_18x12("centres");
        let distances = DistanceField::new(&field, &DistanceFieldConfig::default());
        let near = distances.nearest(4.0, 5.9);
        let toward = near.signed_distance * near.normal[1];
        assert!((toward + 0.1).abs() < 1e-5 && near.normal[0].abs() < 1e-6);
    }

    #[test]
    fn far_points_and_nan_do_not_panic() {
        let field = league_18x12("centres");
        let distances = DistanceField::new(&field, &DistanceFieldConfig::default());
        assert!(distances.nearest(100.0, -100.0).signed_distance.abs() > 50.0);
        assert!(distances.nearest(f32::NAN, 0.0).signed_distance.is_nan());
    }
}
