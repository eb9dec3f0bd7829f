//! What is the orientation of the field's axes? Steps 4 to 6 of lima2001 4.1.

use super::{Hough, HoughLine};

/// Two detected lines, with their relevance and the direction they give.
struct LinePair {
    relevance: f32,
    votes: i32,
    /// Radians, modulo 90°.
    direction: f32,
}

impl Hough {
    /// Steps 4 to 6: φ modulo 90° from the most relevant pair of lines, then from less relevant pairs that differ.
    pub(super) fn find_orientations(&self, lines: &[HoughLine]) -> Vec<f32> {
        let mut pairs: Vec<LinePair> = Vec::new();
        for (k, a) in lines.iter().enumerate() {
            for b in &lines[..k] {
                let votes = i32::from(a.votes) + i32::from(b.votes);
                pairs.push(LinePair {
                    relevance: self.relevance(a, b),
                    votes,
                    direction: mean_direction(a, b),
                });
            }
        }
        pairs.sort_by(|a, b| {
            b.relevance
                .total_cmp(&a.relevance)
                .then(b.votes.cmp(&a.votes))
        });
        let single = lines.first().map(|line| line.phi);
        let mut orientations: Vec<f32> = Vec::new();
        for phi in pairs.into_iter().map(|pair| pair.direction).chain(single) {
            let quarter = std::f32::consts::FRAC_PI_2;
            let differs = |other: &f32| {
                let off = (phi - other).rem_euclid(quarter);
                off.min(quarter - off) > 0.5 * self.config.suppression_angle_deg.to_radians()
            };
            if orientations.len() < self.config.orientations_max && orientations.iter().all(differs)
            {
                orientations.push(phi);
            }
        }
        orientations
    }

    /// Rel(Δφ) + Rel(Δρ), each in [0, 100] (eqs 5 and 6, fig. 9).
    fn relevance(&self, a: &HoughLine, b: &HoughLine) -> f32 {
        let angle = (a.phi - b.phi).abs().to_degrees();
        let parallel = angle.min(180.0 - angle);
        let perpendicular = (angle - 90.0).abs();
        let grade = |off: f32, width: f32| 100.0 * (1.0 - off / width).max(0.0);
        let by_angle = grade(parallel.min(perpendicular), self.config.relevance_width_deg);
        if parallel > self.config.relevance_width_deg {
            return by_angle;
        }
        // Beyond 90° the normals point in opposite directions.
        let spacing = if angle > 90.0 {
            (a.rho + b.rho).abs()
        } else {
            (a.rho - b.rho).abs()
        };
        let off = self
            .line_spacings
            .iter()
            .map(|distance| (distance - spacing).abs())
            .fold(f32::MAX, f32::min);
        by_angle + grade(off, self.config.relevance_width)
    }
}

/// The direction of a pair of lines modulo 90°: the mean of both, weighted by votes.
fn mean_direction(a: &HoughLine, b: &HoughLine) -> f32 {
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
