//! Which straight lines do the points lie on? Steps 2, 3 and 7 of lima2001 4.1.

use super::{Hough, HoughConfig, HoughLine};

impl Hough {
    /// Step 2: ρ = x cos φ + y sin φ (eq. 4) for every point and angle.
    pub(super) fn vote(&mut self, points: &[[f32; 2]]) {
        self.accumulator.fill(0);
        let width = 2 * self.rho_half_cells + 1;
        let step = self.config.angle_step_deg.to_radians();
        for (angle, row) in self.accumulator.chunks_exact_mut(width).enumerate() {
            let direction = angle as f32 * step;
            vote_row(row, points, direction, self.rho_half_cells, &self.config);
        }
    }

    /// Step 3: the top q cells, each with its surroundings taken out before the next.
    pub(super) fn extract_lines(&mut self) -> Vec<HoughLine> {
        let width = 2 * self.rho_half_cells + 1;
        let step = self.config.angle_step_deg.to_radians();
        let mut tops: Vec<(i16, usize)> = self.accumulator.chunks_exact(width).map(peak).collect();
        let beside =
            (self.config.suppression_angle_deg / self.config.angle_step_deg).round() as i32;
        let around = (self.config.suppression_distance / self.config.pixel_size).round() as usize;
        let mut lines = Vec::new();
        for _ in 0..self.config.lines_max {
            let Some(angle) = (0..tops.len()).max_by_key(|&k| (tops[k].0, std::cmp::Reverse(k)))
            else {
                break;
            };
            let (votes, cell) = tops[angle];
            if votes < 3 {
                break;
            }
            lines.push(HoughLine {
                phi: angle as f32 * step,
                rho: (cell as f32 - self.rho_half_cells as f32) * self.config.pixel_size,
                votes,
            });
            for turn in -beside..=beside {
                // Beyond half a turn the same line has the opposite sign.
                let turned = angle as i32 + turn;
                let row = turned.rem_euclid(self.angles as i32) as usize;
                let over = turned < 0 || turned >= self.angles as i32;
                let middle = if over { width - 1 - cell } else { cell };
                let cells = &mut self.accumulator[row * width..(row + 1) * width];
                let end = (middle + around + 1).min(width);
                cells[middle.saturating_sub(around)..end].fill(0);
                tops[row] = peak(cells);
            }
        }
        lines
    }

    /// Step 7: up to n lines with normal `phi`, from its column and some beside it (ρ̂_φ).
    pub(super) fn lines_with_normal(&self, points: &[[f32; 2]], phi: f32) -> Vec<(f32, i16)> {
        let width = 2 * self.rho_half_cells + 1;
        let step = self.config.angle_step_deg.to_radians();
        let beside = self.config.angle_half_window_steps as i32;
        let mut most = vec![0_i16; width];
        let mut row = vec![0_i16; width];
        for column in -beside..=beside {
            row.fill(0);
            let direction = phi + column as f32 * step;
            vote_row(
                &mut row,
                points,
                direction,
                self.rho_half_cells,
                &self.config,
            );
            for (most, votes) in most.iter_mut().zip(&row) {
                *most = (*most).max(*votes);
            }
        }
        let around = (self.config.suppression_distance / self.config.pixel_size).round() as usize;
        let mut found = Vec::new();
        for _ in 0..self.config.lines_per_direction_max {
            let (votes, cell) = peak(&most);
            if votes < 3 {
                break;
            }
            // The middle of equal cells.
            let last = cell + most[cell..].iter().take_while(|&&v| v == votes).count() - 1;
            let middle = 0.5 * (cell + last) as f32 - self.rho_half_cells as f32;
            found.push((middle * self.config.pixel_size, votes));
            let end = (cell + around + 1).min(width);
            most[cell.saturating_sub(around)..end].fill(0);
        }
        found
    }
}

/// Votes of all points in one column of φ.
fn vote_row(
    row: &mut [i16],
    points: &[[f32; 2]],
    direction: f32,
    half: usize,
    config: &HoughConfig,
) {
    let (sin, cos) = direction.sin_cos();
    let per_pixel = 1.0 / config.pixel_size;
    let beside = config.vote_half_width_px;
    for [x, y] in points {
        let rho = (x * cos + y * sin) * per_pixel + half as f32;
        let first = (rho + 0.5) as usize - beside;
        for votes in &mut row[first..=first + 2 * beside] {
            *votes += 1;
        }
    }
}

/// Highest value and its first place.
fn peak(cells: &[i16]) -> (i16, usize) {
    let most = cells.iter().copied().max().unwrap_or(0);
    let at = cells.iter().position(|&votes| votes == most);
    (most, at.unwrap_or(0))
}
