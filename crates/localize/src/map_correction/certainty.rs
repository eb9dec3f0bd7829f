//! How much of what images tell about a map may be claimed?
//!
//! Learning takes the errors of images for independent. Those that neighbouring points share, and those of the map beyond its unknowns, repeat in
//! all images, so what images tell of a shift of all points does not grow with their number.

use super::sums::TermMatrix;

/// Variance of the mean error of many images' points over that of independent ones (docs/methods.md 2.13).
pub(super) const REPETITION: f64 = 10.0;

/// The covariance that may be claimed after learning with independent errors. None if a covariance is none.
pub(super) fn claimed(
    prior: &TermMatrix,
    learned: &TermMatrix,
    terms: usize,
) -> Option<TermMatrix> {
    weigh_information(prior, learned, terms, 1.0 / REPETITION)
}

/// The covariance with which learning goes on where so much may be claimed. None if a covariance is none.
pub(super) fn learned(
    prior: &TermMatrix,
    claimed: &TermMatrix,
    terms: usize,
) -> Option<TermMatrix> {
    weigh_information(prior, claimed, terms, REPETITION)
}

/// Multiplies the information that was gained on the prior.
fn weigh_information(
    prior: &TermMatrix,
    covariance: &TermMatrix,
    terms: usize,
    factor: f64,
) -> Option<TermMatrix> {
    let inverse = |matrix: &TermMatrix| {
        let mut matrix = *matrix;
        for k in terms..matrix.nrows() {
            matrix[(k, k)] = 1.0;
        }
        matrix.cholesky().map(|cholesky| cholesky.inverse())
    };
    let prior = inverse(prior)?;
    let gained = inverse(covariance)? - prior;
    let mut weighed = inverse(&(prior + gained * factor))?;
    for k in terms..weighed.nrows() {
        weighed[(k, k)] = 0.0;
    }
    Some(weighed)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn claims_lie_between_prior_and_learned_and_lead_back_to_it() {
        let mut prior = TermMatrix::zeros();
        prior[(0, 0)] = 4.0;
        prior[(1, 1)] = 9.0;
        let mut posterior = TermMatrix::zeros();
        for (i, j, value) in [(0, 0, 0.02), (0, 1, 0.01), (1, 0, 0.01), (1, 1, 9.0)] {
            posterior[(i, j)] = value;
        }
        let claim = claimed(&prior, &posterior, 2).expect("a covariance");
        assert!(claim[(0, 0)] > 8.0 * posterior[(0, 0)] && claim[(0, 0)] < 0.06 * prior[(0, 0)]);
        // Nothing was learned of the second: nothing is claimed.
        assert!((claim[(1, 1)] / prior[(1, 1)] - 1.0).abs() < 1e-3);
        let back = learned(&prior, &claim, 2).expect("a covariance");
        assert!((back - posterior).norm() < 1e-9, "{back}");
        assert!(claimed(&prior, &(prior * -1.0), 2).is_none());
    }
}
