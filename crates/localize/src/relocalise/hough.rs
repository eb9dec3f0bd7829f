//! Self-localisation by the Hough transform (lima2001 4): which straight lines are seen, and which lines of the field
//! are they?
//!
//! The steps carry the numbers of lima2001 4.1. The paper works in the pixels of its isometric mirror; here points of
//! the ground are mapped to that isometric plane first, so that any map serves. Transition pixels (step 1) come from
//! vision's scan along 36 circles.

use serde::{Deserialize, Serialize};

use crate::field::{Field, Marking};
use crate::frame::{At, Pose, wrap_angle};
use crate::goals::colour_at;
use crate::sample::{GoalSight, LinePoint};
use crate::search::{HeadingPrior, half_turn};

/// The Hough transform and its correlation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct HoughConfig {
    /// Metres per pixel of the isometric plane (lima2001 4.4: 6.95 mm).
    pub pixel: f32,
    /// Points beyond this are not used, metres: the plane's edge.
    pub range: f32,
    /// Step of φ, degrees (lima2001 4.4: 0.5).
    pub step_deg: f32,
    /// Points vote for this many ρ cells on either side, since they scatter: 0 in the paper, whose points were exact
    /// to a pixel; 4 is 3 cm.
    pub vote_half_width_px: usize,
    /// Lines picked from the accumulator (lima2001 4.4: q = 6).
    pub lines: usize,
    /// Most lines per array (lima2001 4.5: n = 6).
    pub array: usize,
    /// Columns taken on either side of φ for the arrays (lima2001 4.1 step 7).
    pub columns_beside: usize,
    /// Two parameters of one line: closer than this in φ, degrees.
    pub line_width_deg: f32,
    /// And closer than this in ρ, metres.
    pub line_width: f32,
    /// A line seen and a line of the model match if they are this close, metres.
    pub tolerance: f32,
    /// Δφ this far from parallel or perpendicular is irrelevant, degrees (lima2001 fig. 9b).
    pub relevant_deg: f32,
    /// Δρ this far from every distance between lines is irrelevant, metres (lima2001 fig. 9c).
    pub relevant: f32,
    /// Orientations looked at, the most relevant pair's first; 1 looks at no other, as the paper does.
    pub orientations: usize,
    /// Maxima of the correlation kept per array.
    pub maxima: usize,
}

impl Default for HoughConfig {
    fn default() -> Self {
        HoughConfig {
            pixel: 0.00695,
            range: 5.0,
            step_deg: 0.5,
            vote_half_width_px: 4,
            lines: 6,
            array: 6,
            columns_beside: 2,
            line_width_deg: 6.0,
            line_width: 0.25,
            tolerance: 0.12,
            relevant_deg: 10.0,
            relevant: 0.3,
            orientations: 3,
            maxima: 5,
        }
    }
}

/// A straight line: normal direction (radians, in [0, π)) and signed distance from the robot, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Line {
    phi: f32,
    rho: f32,
    votes: i16,
}

/// A shift of an array over its model: where the robot is along that axis, matches counted, votes of the matched.
#[derive(Debug, Clone, Copy)]
struct Shift {
    at: f32,
    matches: usize,
    votes: i32,
}

/// Accumulator and model arrays of one field.
#[derive(Debug, Clone)]
pub struct Hough {
    config: HoughConfig,
    accumulator: Vec<i16>,
    angles: usize,
    /// ρ cells on either side of zero.
    half: usize,
    /// Positions of the field's lines across x and across y, metres (lima2001 4.1 step 8: ρ_φ and ρ_φ+90).
    model: [Vec<f32>; 2],
    /// Distances between parallel lines of the field.
    distances: Vec<f32>,
    half_x: f32,
    half_y: f32,
}

impl Hough {
    /// Lays out accumulator and model.
    pub fn new(field: &Field, config: HoughConfig) -> Self {
        let mut model = [Vec::new(), Vec::new()];
        for marking in &field.markings {
            if let Marking::Line { from, to } = marking {
                if (from.x - to.x).abs() < 1e-3 {
                    model[0].push(from.x);
                } else if (from.y - to.y).abs() < 1e-3 {
                    model[1].push(from.y);
                }
            }
        }
        let mut distances = Vec::new();
        for lines in &mut model {
            lines.sort_by(f32::total_cmp);
            lines.dedup_by(|a, b| (*a - *b).abs() < 1e-3);
            for (k, a) in lines.iter().enumerate() {
                distances.extend(lines[..k].iter().map(|b| a - b));
            }
        }
        let angles = (180.0 / config.step_deg).round() as usize;
        let half = (config.range / config.pixel).ceil() as usize + config.vote_half_width_px + 1;
        Hough {
            accumulator: vec![0; angles * (2 * half + 1)],
            angles,
            half,
            model,
            distances,
            half_x: field.length / 2.0 + field.config.border,
            half_y: field.width / 2.0 + field.config.border,
            config,
        }
    }

    /// Memory held, bytes.
    pub fn bytes(&self) -> usize {
        self.accumulator.len() * size_of::<i16>()
    }

    /// Poses that put the lines seen onto lines of the field, best first; with a prior only those on its side of a
    /// right angle, without one also the half turns.
    pub fn find(&mut self, points: &[LinePoint], prior: Option<HeadingPrior>) -> Vec<(f32, Pose)> {
        let points: Vec<[f32; 2]> = points
            .iter()
            .filter(|point| point.at.distance() < self.config.range)
            .map(|point| [point.at.x, point.at.y])
            .collect();
        self.vote(&points);
        let lines = self.strongest();
        let mut found = Vec::new();
        for phi in self.orientations(&lines) {
            let seen = [
                self.array(&points, phi),
                self.array(&points, phi + std::f32::consts::FRAC_PI_2),
            ];
            found.extend(self.positions(phi, &seen, prior));
        }
        found.sort_by(|a, b| b.0.total_cmp(&a.0));
        found
    }

    /// Step 2: ρ = x cos φ + y sin φ (eq. 4) for every point and angle.
    fn vote(&mut self, points: &[[f32; 2]]) {
        self.accumulator.fill(0);
        let width = 2 * self.half + 1;
        let step = self.config.step_deg.to_radians();
        for (angle, row) in self.accumulator.chunks_exact_mut(width).enumerate() {
            let direction = angle as f32 * step;
            vote_row(row, points, direction, self.half, &self.config);
        }
    }

    /// Step 3: the top q cells, each with its surroundings taken out before the next.
    fn strongest(&mut self) -> Vec<Line> {
        let width = 2 * self.half + 1;
        let step = self.config.step_deg.to_radians();
        let mut tops: Vec<(i16, usize)> = self.accumulator.chunks_exact(width).map(top).collect();
        let beside = (self.config.line_width_deg / self.config.step_deg).round() as i32;
        let around = (self.config.line_width / self.config.pixel).round() as usize;
        let mut lines = Vec::new();
        for _ in 0..self.config.lines {
            let Some(angle) = (0..tops.len()).max_by_key(|&k| (tops[k].0, std::cmp::Reverse(k)))
            else {
                break;
            };
            let (votes, cell) = tops[angle];
            if votes < 3 {
                break;
            }
            lines.push(Line {
                phi: angle as f32 * step,
                rho: (cell as f32 - self.half as f32) * self.config.pixel,
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
                tops[row] = top(cells);
            }
        }
        lines
    }

    /// Steps 4 to 6: grades every pair and takes φ, up to right angles, from the most relevant one; then, as the next
    /// maxima, from less relevant ones that say something else.
    fn orientations(&self, lines: &[Line]) -> Vec<f32> {
        let mut pairs: Vec<(f32, i32, f32)> = Vec::new();
        for (k, a) in lines.iter().enumerate() {
            for b in &lines[..k] {
                let votes = i32::from(a.votes) + i32::from(b.votes);
                pairs.push((self.relevance(a, b), votes, mean_direction(a, b)));
            }
        }
        pairs.sort_by(|a, b| b.0.total_cmp(&a.0).then(b.1.cmp(&a.1)));
        let single = lines.first().map(|line| line.phi);
        let mut found: Vec<f32> = Vec::new();
        for phi in pairs.into_iter().map(|pair| pair.2).chain(single) {
            let quarter = std::f32::consts::FRAC_PI_2;
            let new = |other: &f32| {
                let off = (phi - other).rem_euclid(quarter);
                off.min(quarter - off) > 0.5 * self.config.line_width_deg.to_radians()
            };
            if found.len() < self.config.orientations && found.iter().all(new) {
                found.push(phi);
            }
        }
        found
    }

    /// Rel(Δφ) + Rel(Δρ), each in [0, 100] (eqs 5 and 6, fig. 9).
    fn relevance(&self, a: &Line, b: &Line) -> f32 {
        let turned = (a.phi - b.phi).abs().to_degrees();
        let parallel = turned.min(180.0 - turned);
        let across = (turned - 90.0).abs();
        let grade = |off: f32, width: f32| 100.0 * (1.0 - off / width).max(0.0);
        let by_angle = grade(parallel.min(across), self.config.relevant_deg);
        if parallel > self.config.relevant_deg {
            return by_angle;
        }
        // Past half a turn the normals are opposite.
        let apart = if turned > 90.0 {
            (a.rho + b.rho).abs()
        } else {
            (a.rho - b.rho).abs()
        };
        let off = self
            .distances
            .iter()
            .map(|distance| (distance - apart).abs())
            .fold(f32::MAX, f32::min);
        by_angle + grade(off, self.config.relevant)
    }

    /// Step 7: up to n lines with normal `phi`, from its column and some beside it (ρ̂_φ).
    fn array(&self, points: &[[f32; 2]], phi: f32) -> Vec<(f32, i16)> {
        let width = 2 * self.half + 1;
        let step = self.config.step_deg.to_radians();
        let beside = self.config.columns_beside as i32;
        let mut most = vec![0_i16; width];
        let mut row = vec![0_i16; width];
        for column in -beside..=beside {
            row.fill(0);
            let direction = phi + column as f32 * step;
            vote_row(&mut row, points, direction, self.half, &self.config);
            for (most, votes) in most.iter_mut().zip(&row) {
                *most = (*most).max(*votes);
            }
        }
        let around = (self.config.line_width / self.config.pixel).round() as usize;
        let mut found = Vec::new();
        for _ in 0..self.config.array {
            let (votes, cell) = top(&most);
            if votes < 3 {
                break;
            }
            // The middle of equal cells.
            let last = cell + most[cell..].iter().take_while(|&&v| v == votes).count() - 1;
            let middle = 0.5 * (cell + last) as f32 - self.half as f32;
            found.push((middle * self.config.pixel, votes));
            let end = (cell + around + 1).min(width);
            most[cell.saturating_sub(around)..end].fill(0);
        }
        found
    }

    /// Step 8 and lima2001 4.5: correlates both arrays with both model arrays. The pair (ρ_φ, ρ̂_φ) with its companion
    /// (ρ_φ+90, ρ̂_φ+90), or (ρ_φ, ρ̂_φ+90) with (ρ_φ+90, ρ̂_φ), fixes the orientation; a line of each, the reference
    /// point and with it the position; positions off the field are rejected.
    fn positions(
        &self,
        phi: f32,
        seen: &[Vec<(f32, i16)>; 2],
        prior: Option<HeadingPrior>,
    ) -> Vec<(f32, Pose)> {
        use std::f32::consts::FRAC_PI_2;
        let mut found: Vec<(usize, i32, Pose)> = Vec::new();
        for quarter in 0..4_u8 {
            // The field's x axis lies `quarter` right angles on from φ in the robot's frame.
            let theta = wrap_angle(-phi - f32::from(quarter) * FRAC_PI_2);
            if prior.is_some_and(|prior| wrap_angle(theta - prior.heading).abs() > FRAC_PI_2) {
                continue;
            }
            let (along, across) = match quarter {
                0 => (signed(&seen[0], 1.0), signed(&seen[1], 1.0)),
                1 => (signed(&seen[1], 1.0), signed(&seen[0], -1.0)),
                2 => (signed(&seen[0], -1.0), signed(&seen[1], -1.0)),
                _ => (signed(&seen[1], -1.0), signed(&seen[0], 1.0)),
            };
            for x in self.correlate(&self.model[0], &along) {
                for y in self.correlate(&self.model[1], &across) {
                    if x.at.abs() > self.half_x || y.at.abs() > self.half_y {
                        continue;
                    }
                    found.push((
                        x.matches + y.matches,
                        x.votes + y.votes,
                        Pose::new(x.at, y.at, theta),
                    ));
                }
            }
        }
        found.sort_by_key(|&(matches, votes, _)| std::cmp::Reverse((matches, votes)));
        found
            .into_iter()
            .map(|(matches, votes, pose)| (matches as f32 + 1e-4 * votes as f32, pose))
            .collect()
    }

    /// Shifts the array over the model and counts the pairs that match; the best shifts.
    fn correlate(&self, model: &[f32], seen: &[(f32, i16)]) -> Vec<Shift> {
        let mut shifts: Vec<Shift> = Vec::new();
        for line in model {
            for (rho, _) in seen {
                let at = line - rho;
                let (mut matches, mut votes, mut off) = (0, 0, 0.0);
                for (rho, strength) in seen {
                    let Some(deviation) = model
                        .iter()
                        .map(|line| line - rho - at)
                        .min_by(|a, b| a.abs().total_cmp(&b.abs()))
                    else {
                        continue;
                    };
                    if deviation.abs() < self.config.tolerance {
                        matches += 1;
                        votes += i32::from(*strength);
                        off += deviation;
                    }
                }
                shifts.push(Shift {
                    at: at + off / matches.max(1) as f32,
                    matches,
                    votes,
                });
            }
        }
        shifts.sort_by_key(|shift| std::cmp::Reverse((shift.matches, shift.votes)));
        let mut best: Vec<Shift> = Vec::new();
        for shift in shifts {
            let new = |other: &Shift| (other.at - shift.at).abs() > self.config.line_width;
            if best.len() < self.config.maxima && best.iter().all(new) {
                best.push(shift);
            }
        }
        best
    }
}

/// The goal test (lima2001 4.5): walks through `candidates` (best first) and looks at points inside the goal nearest
/// to each. The goal's own colour confirms; the other goal's gives the half turn; carpet green, or anything else,
/// means the next maximum. None if no candidate is confirmed, or if the goals look alike.
pub fn settle(field: &Field, candidates: &[Pose], goals: &[GoalSight]) -> Option<Pose> {
    let goal = &field.config.goal;
    let [ahead, behind] = goal.colours;
    if ahead == behind {
        return None;
    }
    candidates.iter().find_map(|&pose| {
        let side = if pose.x >= 0.0 { 1.0 } else { -1.0 };
        let (own, other) = if side > 0.0 {
            (ahead, behind)
        } else {
            (behind, ahead)
        };
        let robot_from_field = pose.inverse();
        let (mut right, mut turned, mut all) = (0, 0, 0);
        for deep in [0.25, 0.5, 0.75] {
            for wide in [-0.35, -0.2, 0.0, 0.2, 0.35] {
                let x = side * (field.length / 2.0 + deep * goal.depth);
                let seen = colour_at(robot_from_field * At::new(x, wide * goal.width), goals);
                right += usize::from(seen == Some(own));
                turned += usize::from(seen == Some(other));
                all += 1;
            }
        }
        if 2 * right > all {
            Some(pose)
        } else if 2 * turned > all {
            Some(half_turn(pose))
        } else {
            None
        }
    })
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
    let per_pixel = 1.0 / config.pixel;
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
fn top(cells: &[i16]) -> (i16, usize) {
    let most = cells.iter().copied().max().unwrap_or(0);
    let at = cells.iter().position(|&votes| votes == most);
    (most, at.unwrap_or(0))
}

fn signed(array: &[(f32, i16)], sign: f32) -> Vec<(f32, i16)> {
    array
        .iter()
        .map(|&(rho, votes)| (sign * rho, votes))
        .collect()
}

/// The direction of a pair's lines, up to right angles: its first line's, corrected by its second's.
fn mean_direction(a: &Line, b: &Line) -> f32 {
    let quarter = std::f32::consts::FRAC_PI_2;
    let off = (b.phi - a.phi).rem_euclid(quarter);
    let off = if off > 0.5 * quarter {
        off - quarter
    } else {
        off
    };
    let share = f32::from(b.votes) / (f32::from(a.votes) + f32::from(b.votes)).max(1.0);
    a.phi + off * share
}
