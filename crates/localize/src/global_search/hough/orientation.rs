//! Which way do the field's axes run? Steps 4 to 6 of lima2001 4.1.

use super::{Hough, HoughLine};

impl Hough {
    /// Steps 4 to 6: grades every pair and takes φ, up to right angles, from the most relevant one; then, as the next
    /// maxima, from less relevant ones that say something else.
    pub(super) fn find_orientations(&self, lines: &[HoughLine]) -> Vec<f32> {
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
                off.min(quarter - off) > 0.5 * self.config.suppression_angle_deg.to_radians()
            };
            if found.len() < self.config.orientations_max && found.iter().all(new) {
                found.push(phi);
            }
        }
        found
    }

    /// Rel(Δφ) + Rel(Δρ), each in [0, 100] (eqs 5 and 6, fig. 9).
    fn relevance(&self, a: &HoughLine, b: &HoughLine) -> f32 {
        let turned = (a.phi - b.phi).abs().to_degrees();
        let parallel = turned.min(180.0 - turned);
        let across = (turned - 90.0).abs();
        let grade = |off: f32, width: f32| 100.0 * (1.0 - off / width).max(0.0);
        let by_angle = grade(parallel.min(across), self.config.relevance_width_deg);
        if parallel > self.config.relevance_width_deg {
            return by_angle;
        }
        // Past half a turn the normals are opposite.
        let apart = if turned > 90.0 {
            (a.rho + b.rho).abs()
        } else {
            (a.rho - b.rho).abs()
        };
        let off = self
            .line_spacings
            .iter()
            .map(|distance| (distance - apart).abs())
            .fold(f32::MAX, f32::min);
        by_angle + grade(off, self.config.relevance_width)
    }
}

/// The direction of a pair's lines, up to right angles: its first line's, corrected by its second's.
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
