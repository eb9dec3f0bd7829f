//! What images told of a map's errors: handed from a check of the set-up, from another localizer or from a log to a localizer.

use serde::{Deserialize, Serialize};

use super::certainty::learned;
use super::state::MapCorrection;
use super::sums::{TermMatrix, TermVector};
use crate::matching::PARAMETERS;

/// Estimated errors of a map, and how far the viewpoint may lie beside the robot's centre.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MapFit {
    /// The unknowns of the map's basis, each in its unit.
    unknowns: Vec<f64>,
    /// Their covariance, as far as it may be claimed, row by row.
    covariance: Vec<Vec<f64>>,
    /// How far a leaning rig may hold the viewpoint beside the robot's centre, metres: images do not tell whether the robot leans.
    viewpoint_shift: f32,
}

impl MapFit {
    pub(super) fn new(
        terms: usize,
        unknowns: &TermVector,
        covariance: &TermMatrix,
        viewpoint_shift: f32,
    ) -> Self {
        let row = |i| (0..terms).map(|j| covariance[(i, j)]).collect();
        MapFit {
            unknowns: (0..terms).map(|i| unknowns[i]).collect(),
            covariance: (0..terms).map(row).collect(),
            viewpoint_shift,
        }
    }

    /// How far the viewpoint may lie beside the robot's centre, metres.
    pub fn viewpoint_shift(&self) -> f32 {
        self.viewpoint_shift
    }

    /// Errors of a map with so many unknowns. None if it is of another map, or if the covariance is none.
    fn read(&self, prior: &TermMatrix, terms: usize) -> Option<(TermVector, TermMatrix)> {
        let rows = std::iter::once(&self.unknowns).chain(&self.covariance);
        let is_full =
            |row: &Vec<f64>| row.len() == terms && row.iter().all(|value| value.is_finite());
        if self.covariance.len() != terms || !rows.clone().all(is_full) {
            return None;
        }
        let mut unknowns = TermVector::zeros();
        let mut covariance = *prior;
        for (i, row) in self.covariance.iter().enumerate() {
            unknowns[i] = self.unknowns[i];
            for (j, value) in row.iter().enumerate() {
                covariance[(i, j)] = *value;
            }
        }
        let used = covariance.view((0, 0), (terms, terms)).into_owned();
        used.cholesky().map(|_| (unknowns, covariance))
    }
}

impl MapCorrection {
    /// Takes over what images told of this map. Returns the change of (x, y, θ, a, b) that follows for the pose of the last image. None, and
    /// nothing changes, if it is of a map with other unknowns.
    pub fn adopt(&mut self, fit: &MapFit) -> Option<[f32; PARAMETERS]> {
        let terms = self.basis.terms().len();
        let (unknowns, claimed) = fit.read(&self.prior, terms)?;
        let covariance = learned(&self.prior, &claimed, terms).unwrap_or(claimed);
        let shift = self.sensitivity * (unknowns - self.applied);
        self.coefficients = unknowns;
        self.applied = unknowns;
        self.covariance = covariance;
        self.restart_learning();
        Some(std::array::from_fn(|k| shift[k] as f32))
    }

    /// What was learned about the map. None while the map as given is in use.
    pub fn fit(&self, viewpoint_shift: f32) -> Option<MapFit> {
        let terms = self.basis.terms().len();
        self.is_in_use().then(|| {
            MapFit::new(
                terms,
                &self.applied,
                &self.claimed_deviation(),
                viewpoint_shift,
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::map_correction::{MapBasis, MapCorrectionConfig, smooth_terms};

    fn map() -> MapCorrection {
        let config = MapCorrectionConfig::default();
        MapCorrection::new(MapBasis::new(smooth_terms(config.smooth_std), 0.7), config)
    }

    #[test]
    fn map_goes_on_from_what_another_one_learned() {
        let mut learned = map();
        assert_eq!(learned.fit(0.0), None, "the map as given");
        let terms = learned.basis.terms().len();
        for k in 0..terms {
            learned.applied[k] = 0.3 * learned.prior[(k, k)].sqrt();
        }
        learned.coefficients = learned.applied;
        learned.covariance *= 0.01;
        learned.update_variances();
        let fit = learned.fit(0.02).expect("in use");
        let text = toml::to_string(&fit).expect("TOML");
        let read: MapFit = toml::from_str(&text).expect("read");
        assert_eq!(read, fit, "every bit");
        let mut next = map();
        assert!(next.adopt(&read).is_some());
        let again = next.fit(0.02).expect("in use");
        assert_eq!(again.unknowns, fit.unknowns);
        for (row, same) in again.covariance.iter().zip(&fit.covariance) {
            assert!(
                row.iter()
                    .zip(same)
                    .all(|(a, b)| (a - b).abs() <= 1e-9 * a.abs())
            );
        }
    }

    #[test]
    fn fits_of_other_maps_and_broken_ones_change_nothing() {
        let mut learned = map();
        learned.applied[0] = 0.01;
        learned.coefficients = learned.applied;
        let fit = learned.fit(0.0).expect("in use");
        let mut fewer = fit.clone();
        fewer.unknowns.pop();
        let mut infinite = fit.clone();
        infinite.covariance[1][0] = f64::NAN;
        let mut indefinite = fit.clone();
        indefinite.covariance[0][0] = -1.0;
        let mut map = map();
        for broken in [fewer, infinite, indefinite] {
            assert!(map.adopt(&broken).is_none());
            assert!(!map.is_in_use());
        }
        assert!(map.adopt(&fit).is_some());
    }
}
