//! Which strokes of paint may a footprint meet? A grid of the field's strokes.

use super::strokes::{Area, Stroke};

/// Cell of the grid, metres.
const CELL: f32 = 0.8;

/// The strokes in each cell.
pub(super) struct StrokeGrid {
    left: f32,
    bottom: f32,
    columns: usize,
    rows: usize,
    /// Where the strokes of each cell start in `strokes`.
    starts: Vec<u32>,
    strokes: Vec<u32>,
    /// The search that last found each stroke.
    found_by: Vec<u32>,
    search: u32,
}

impl StrokeGrid {
    /// A grid over ± half of the carpet, and what is painted beyond.
    pub(super) fn new((half_x, half_y): (f32, f32), strokes: &[Stroke]) -> Self {
        let (mut low, mut high) = ([-half_x, -half_y], [half_x, half_y]);
        for [least, most] in strokes.iter().map(Stroke::bounds) {
            for k in 0..2 {
                (low[k], high[k]) = (low[k].min(least[k]), high[k].max(most[k]));
            }
        }
        let count = |k: usize| ((high[k] - low[k]) / CELL).ceil().max(1.0) as usize;
        let mut grid = StrokeGrid {
            left: low[0],
            bottom: low[1],
            columns: count(0),
            rows: count(1),
            starts: vec![0],
            strokes: Vec::new(),
            found_by: vec![0; strokes.len()],
            search: 0,
        };
        for index in 0..grid.columns * grid.rows {
            let centre = [
                grid.left + ((index % grid.columns) as f32 + 0.5) * CELL,
                grid.bottom + ((index / grid.columns) as f32 + 0.5) * CELL,
            ];
            let area = Area {
                centre,
                axis: [1.0, 0.0],
                half: [0.51 * CELL; 2],
            };
            let touching = (strokes.iter().enumerate()).filter(|(_, stroke)| stroke.touches(&area));
            grid.strokes
                .extend(touching.map(|(stroke, _)| stroke as u32));
            grid.starts.push(grid.strokes.len() as u32);
        }
        grid
    }

    /// The strokes that may touch an area; `half`: half sides of a box along the field's axes around it.
    pub(super) fn find(
        &mut self,
        strokes: &[Stroke],
        area: &Area,
        half: [f32; 2],
        found: &mut Vec<u32>,
    ) {
        found.clear();
        self.search = self.search.wrapping_add(1);
        let cell = |metres: f32, origin: f32| (metres - origin) * (1.0 / CELL);
        let range = |k: usize, origin: f32, count: usize| {
            let first = cell(area.centre[k] - half[k], origin).max(0.0) as usize;
            // A cast of a negative number gives 0.
            let end = (cell(area.centre[k] + half[k], origin) + 1.0) as usize;
            first..end.min(count)
        };
        let columns = range(0, self.left, self.columns);
        for row in range(1, self.bottom, self.rows) {
            if columns.is_empty() {
                break;
            }
            let first = self.starts[row * self.columns + columns.start] as usize;
            let end = self.starts[row * self.columns + columns.end] as usize;
            for &stroke in &self.strokes[first..end] {
                let by = &mut self.found_by[stroke as usize];
                if *by != self.search {
                    *by = self.search;
                    if strokes[stroke as usize].touches(area) {
                        found.push(stroke);
                    }
                }
            }
        }
    }
}
