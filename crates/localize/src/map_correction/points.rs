//! Points of a wrong map: displaced, and as uncertain as the map.

use super::basis::DisplacedPoint;
use super::certainty::Claim;
use super::state::{MapCorrection, NodeVariances, RawPoint};
use super::sums::TermMatrix;
use super::term::{BasisTerm, TERMS_MAX};
use crate::frames::{At, RobotFrame};
use crate::math;
use crate::sample::LinePoint;

impl RawPoint {
    /// Distance from the robot after the correction, metres.
    pub(super) fn range(&self) -> f32 {
        math::hypot(self.at[0], self.at[1])
    }

    /// A point that the map showed at `given`.
    fn new(point: &LinePoint, given: [f32; 2], displaced: &DisplacedPoint) -> Self {
        let ambiguity = displaced.ambiguity * displaced.ambiguity;
        RawPoint {
            given,
            at: displaced.at,
            radial_variance: point.std_radial * point.std_radial + ambiguity,
            tangential_variance: point.std_tangential * point.std_tangential + ambiguity,
            derivatives: displaced.derivatives,
        }
    }
}

impl MapCorrection {
    /// The ground point that the corrected map shows where the map shows `at`.
    pub fn correct_point(&self, at: At<RobotFrame>) -> At<RobotFrame> {
        let prepared = self.basis.prepare(self.single_coefficients());
        let [x, y] = prepared.displace([at.x, at.y]).at;
        At::new(x, y)
    }

    /// Covariance (xx, xy, yy; m²) of a corrected point by what is not known about the map, as far as it may be claimed.
    pub fn point_covariance(&self, at: At<RobotFrame>) -> [f32; 3] {
        let range = math::hypot(at.x, at.y).max(1e-3);
        let [radial, tangential] = self.variances_at(range, &self.claimed_variances);
        let (c, s) = (at.x / range, at.y / range);
        [
            radial * c * c + tangential * s * s,
            (radial - tangential) * s * c,
            radial * s * s + tangential * c * c,
        ]
    }

    /// Corrects the points of an image and adds to their standard deviations what learning does not know about the map.
    pub fn correct(&mut self, points: &mut [LinePoint]) {
        let prepared = self.basis.prepare(self.single_coefficients());
        self.points.clear();
        for point in points {
            let given = [point.at.x, point.at.y];
            let displaced = prepared.displace(given);
            let [x, y] = displaced.at;
            point.at = At::new(x, y);
            let raw = RawPoint::new(point, given, &displaced);
            let [radial, tangential] = self.variances_at(math::hypot(x, y), &self.variances);
            point.std_radial = (raw.radial_variance + radial).sqrt();
            point.std_tangential = (raw.tangential_variance + tangential).sqrt();
            self.points.push(raw);
        }
    }

    /// Corrects the points of a single image, if the given map proved wrong. Their standard deviations stay: the map's uncertainty is
    /// the pose's alone.
    pub fn correct_single(&mut self, points: &mut [LinePoint]) {
        let prepared = self.basis.prepare(self.single_coefficients());
        let in_use = self.is_in_use();
        self.points.clear();
        for point in points {
            let given = [point.at.x, point.at.y];
            let displaced = prepared.displace(given);
            self.points.push(RawPoint::new(point, given, &displaced));
            if in_use {
                let [x, y] = displaced.at;
                point.at = At::new(x, y);
            }
        }
    }

    fn single_coefficients(&self) -> [f32; TERMS_MAX] {
        std::array::from_fn(|k| self.applied[k] as f32)
    }

    /// Variances of a displaced point at `range` metres: radial, tangential; m².
    pub(super) fn variances_at(&self, range: f32, variances: &NodeVariances) -> [f32; 2] {
        let (node, share) = self.basis.node_at(range);
        let slope = range / self.basis.height();
        let per_radian = self.basis.height() * (1.0 + slope * slope);
        // Across the line of sight a radian of φ sin γ is as long as the ray.
        let across = self.basis.height() * (1.0 + slope * slope).sqrt();
        let between = |axis: usize| {
            let (low, high) = (variances[node][axis], variances[node + 1][axis]);
            low + share * (high - low)
        };
        [
            between(0) * per_radian * per_radian,
            between(1) * across * across,
        ]
    }

    /// What follows from the covariance: what may be claimed, and variances by node.
    pub(super) fn update_variances(&mut self) {
        let terms = self.basis.terms();
        let by_wheels = self.origin_by_wheels.information();
        self.claim = Claim::new(
            &self.prior,
            &self.covariance,
            &self.seen,
            &by_wheels,
            terms.len(),
        )
        .unwrap_or_else(|| Claim::of_new_map(&self.prior));
        self.variances = node_variances(terms, &self.deviation());
        self.claimed_variances = node_variances(terms, &self.claimed_deviation());
    }
}

/// Variances of a displaced point by node for unknowns of this covariance, means over the bearing.
fn node_variances(terms: &[BasisTerm], covariance: &TermMatrix) -> NodeVariances {
    std::array::from_fn(|node| {
        let mut sums = [0.0; 2];
        for (i, a) in terms.iter().enumerate() {
            for (j, b) in terms.iter().enumerate() {
                // Different harmonics are uncorrelated over the bearing.
                if a.harmonic != b.harmonic {
                    continue;
                }
                let covariance = covariance[(i, j)] as f32;
                let [radial, tangential] = a.harmonic.mean_squares();
                sums[0] += covariance * radial * a.radial[node] * b.radial[node];
                sums[1] += covariance * tangential * a.tangential[node] * b.tangential[node];
            }
        }
        sums.map(|sum| sum.max(0.0))
    })
}
