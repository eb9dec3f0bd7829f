//! On which straight lines do the points lie? Steps 2, 3 and 7 of lima2001 4.1.

use super::{Hough, HoughConfig, HoughLine, LineOffset};
use crate::math;

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

    /// Step 3: the q highest cells; the neighbourhood of each is cleared before the next is searched.
    pub(super) fn extract_lines(&mut self) -> Vec<HoughLine> {
        let width = 2 * self.rho_half_cells + 1;
        let step = self.config.angle_step_deg.to_radians();
        let mut peaks: Vec<(i16, usize)> = self.accumulator.chunks_exact(width).map(peak).collect();
        let half_angles =
            (self.config.suppression_angle_deg / self.config.angle_step_deg).round() as i32;
        let half_cells =
            (self.config.suppression_distance / self.config.pixel_size).round() as usize;
        let mut lines = Vec::new();
        for _ in 0..self.config.lines_max {
            let Some(angle) = (0..peaks.len()).max_by_key(|&k| (peaks[k].0, std::cmp::Reverse(k)))
            else {
                break;
            };
            let (votes, cell) = peaks[angle];
            if votes < 3 {
                break;
            }
            lines.push(HoughLine {
                phi: angle as f32 * step,
                rho: (cell as f32 - self.rho_half_cells as f32) * self.config.pixel_size,
                votes,
            });
            for angle_offset in -half_angles..=half_angles {
                // Beyond 180° the same line has the opposite sign of ρ.
                let neighbour = angle as i32 + angle_offset;
                let row = neighbour.rem_euclid(self.angles as i32) as usize;
                let wrapped = neighbour < 0 || neighbour >= self.angles as i32;
                let middle = if wrapped { width - 1 - cell } else { cell };
                let cells = &mut self.accumulator[row * width..(row + 1) * width];
                let end = (middle + half_cells + 1).min(width);
                cells[middle.saturating_sub(half_cells)..end].fill(0);
                peaks[row] = peak(cells);
            }
        }
        lines
    }

    /// Step 7: up to n lines with normal `phi`, from its column and some neighbouring columns (ρ̂_φ).
    pub(super) fn lines_with_normal(&self, points: &[[f32; 2]], phi: f32) -> Vec<LineOffset> {
        let width = 2 * self.rho_half_cells + 1;
        let step = self.config.angle_step_deg.to_radians();
        let half_window = self.config.angle_half_window_steps as i32;
        let mut most = vec![0_i16; width];
        let mut row = vec![0_i16; width];
        for column in -half_window..=half_window {
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
        let half_cells =
            (self.config.suppression_distance / self.config.pixel_size).round() as usize;
        let mut offsets = Vec::new();
        for _ in 0..self.config.lines_per_direction_max {
            let (votes, cell) = peak(&most);
            if votes < 3 {
                break;
            }
            // The middle of adjacent cells with equal votes.
            let last = cell + most[cell..].iter().take_while(|&&v| v == votes).count() - 1;
            let middle = 0.5 * (cell + last) as f32 - self.rho_half_cells as f32;
            offsets.push(LineOffset {
                rho: middle * self.config.pixel_size,
                votes,
            });
            let end = (cell + half_cells + 1).min(width);
            most[cell.saturating_sub(half_cells)..end].fill(0);
        }
        offsets
    }
}

/// Adds the votes of all points to one column of φ (`direction`, radians).
fn vote_row(
    row: &mut [i16],
    points: &[[f32; 2]],
    direction: f32,
    half: usize,
    config: &HoughConfig,
) {
    let (sin, cos) = math::sin_cos(direction);
    let per_pixel = 1.0 / config.pixel_size;
    let half_width = config.vote_half_width_px;
    for [x, y] in points {
        let rho = (x * cos + y * sin) * per_pixel + half as f32;
        let first = (rho + 0.5) as usize - half_width;
        for votes in &mut row[first..=first + 2 * half_width] {
            *votes += 1;
        }
    }
}

/// Highest value and the index of its first occurrence.
fn peak(cells: &[i16]) -> (i16, usize) {
    let most = cells.iter().copied().max().unwrap_or(0);
    let at = cells.iter().position(|&votes| votes == most);
    (most, at.unwrap_or(0))
}
