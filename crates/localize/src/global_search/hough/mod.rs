//! Self-localization by the Hough transform (lima2001 4): which straight lines do the points form, and which lines of
//! the field are they?
//!
//! Step numbers are those of lima2001 4.1. The paper works in the pixels of its isometric mirror. Here ground points are
//! used instead, so that any mirror works. Transition pixels (step 1) come from vision's scan along 36 circles.

mod lines;
mod orientation;
mod position;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::field::{Field, Marking};
use crate::frames::Pose;
use crate::global_search::branch_and_bound::HeadingPrior;
use crate::sample::LinePoint;

pub use position::confirm_by_goal_colours;

/// Settings of the Hough transform and its correlation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct HoughConfig {
    /// Metres per pixel of the isometric plane (lima2001 4.4: 6.95 mm).
    pub pixel_size: f32,
    /// Largest distance of points used, metres: the edge of the plane.
    pub range_max: f32,
    /// Step of φ, degrees (lima2001 4.4: 0.5).
    pub angle_step_deg: f32,
    /// Number of ρ cells on either side that a point votes for, because points scatter. 4 is 3 cm; the paper uses 0,
    /// since its points were exact to a pixel.
    pub vote_half_width_px: usize,
    /// Number of lines taken from the accumulator (lima2001 4.4: q = 6).
    pub lines_max: usize,
    /// Largest number of lines per array (lima2001 4.5: n = 6).
    pub lines_per_direction_max: usize,
    /// Number of columns on either side of φ for the arrays (lima2001 4.1 step 7).
    pub angle_half_window_steps: usize,
    /// Difference in φ below which peaks belong to one line, degrees.
    pub suppression_angle_deg: f32,
    /// Difference in ρ below which peaks belong to one line, metres.
    pub suppression_distance: f32,
    /// Largest distance of a detected line from its model line, metres.
    pub tolerance: f32,
    /// Deviation from parallel or perpendicular at which relevance is zero, degrees (lima2001 fig. 9b).
    pub relevance_width_deg: f32,
    /// Deviation from every spacing of field lines at which relevance is zero, metres (lima2001 fig. 9c).
    pub relevance_width: f32,
    /// Number of orientations tried, in order of relevance; 1 in the paper. A larger value costs more time.
    pub orientations_max: usize,
    /// Number of correlation maxima kept per array. A single detected line fits each of the field's seven equally well.
    pub correlation_peaks_max: usize,
}

impl Default for HoughConfig {
    fn default() -> Self {
        HoughConfig {
            pixel_size: 0.00695,
            range_max: 5.0,
            angle_step_deg: 0.5,
            vote_half_width_px: 4,
            lines_max: 6,
            lines_per_direction_max: 6,
            angle_half_window_steps: 2,
            suppression_angle_deg: 6.0,
            suppression_distance: 0.25,
            tolerance: 0.12,
            relevance_width_deg: 10.0,
            relevance_width: 0.3,
            orientations_max: 3,
            correlation_peaks_max: 8,
        }
    }
}

/// A straight line in the robot frame: direction of its normal (radians, in [0, π)) and signed distance, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
struct HoughLine {
    phi: f32,
    rho: f32,
    votes: i16,
}

/// A line's signed distance along a given normal, metres, and its votes.
#[derive(Debug, Clone, Copy, PartialEq)]
struct LineOffset {
    rho: f32,
    votes: i16,
}

/// A pose and its score; higher is better.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScoredPose {
    /// The pose.
    pub pose: Pose,
    /// Number of matched lines, plus 1e-4 per vote of these.
    pub score: f32,
}

/// Accumulator and model arrays of one field.
#[derive(Debug, Clone)]
pub struct Hough {
    config: HoughConfig,
    accumulator: Vec<i16>,
    angles: usize,
    /// ρ cells on either side of zero.
    rho_half_cells: usize,
    /// Positions of the field's lines across x and across y, metres (lima2001 4.1 step 8: ρ_φ and ρ_φ+90).
    model: [Vec<f32>; 2],
    /// Distances between parallel lines of the field.
    line_spacings: Vec<f32>,
    /// Half the carpet's extent, metres: positions outside are rejected.
    half_extent: [f32; 2],
}

impl Hough {
    /// Allocates the accumulator and extracts the field's lines along x and y.
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
        let mut line_spacings = Vec::new();
        for lines in &mut model {
            lines.sort_by(f32::total_cmp);
            lines.dedup_by(|a, b| (*a - *b).abs() < 1e-3);
            for (k, a) in lines.iter().enumerate() {
                line_spacings.extend(lines[..k].iter().map(|b| a - b));
            }
        }
        let angles = (180.0 / config.angle_step_deg).round() as usize;
        let half =
            (config.range_max / config.pixel_size).ceil() as usize + config.vote_half_width_px + 1;
        let (half_x, half_y) = field.carpet_half_extent();
        Hough {
            accumulator: vec![0; angles * (2 * half + 1)],
            angles,
            rho_half_cells: half,
            model,
            line_spacings,
            half_extent: [half_x, half_y],
            config,
        }
    }

    /// Memory held, bytes.
    pub fn memory_bytes(&self) -> usize {
        self.accumulator.len() * size_of::<i16>()
    }

    /// Poses that align the detected lines with lines of the field, best first. With a prior only headings within 90°
    /// of it are returned; without one also the half turns.
    pub fn find_poses(
        &mut self,
        points: &[LinePoint],
        prior: Option<HeadingPrior>,
    ) -> Vec<ScoredPose> {
        let points: Vec<[f32; 2]> = points
            .iter()
            .filter(|point| point.at.distance() < self.config.range_max)
            .map(|point| [point.at.x, point.at.y])
            .collect();
        self.vote(&points);
        let lines = self.extract_lines();
        let mut poses = Vec::new();
        for phi in self.find_orientations(&lines) {
            let offsets = [
                self.lines_with_normal(&points, phi),
                self.lines_with_normal(&points, phi + std::f32::consts::FRAC_PI_2),
            ];
            poses.extend(self.find_positions(phi, &offsets, prior));
        }
        poses.sort_by(|a, b| b.score.total_cmp(&a.score));
        poses
    }
}
