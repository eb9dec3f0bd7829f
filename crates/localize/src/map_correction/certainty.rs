//! How much of what images tell about a map may be claimed?
//!
//! Learning takes the errors of images for independent. Those that neighbouring points share, and those of the map beyond its unknowns, repeat in
//! all images, so what images tell of a shift of all points does not grow with their number. How large such errors are, the residuals tell.

use super::sums::TermMatrix;

/// Variance of the mean error of many images' points over that of independent ones, at least (docs/methods.md 2.13).
pub(super) const REPETITION: f64 = 10.0;

/// Points whose errors all images of a drive do not share.
const POINTS_OF_A_DRIVE: f64 = 4.0;

/// Share by which an image changes the means over a drive.
const RATE: f64 = 0.05;

/// Smallest mean square of the residuals, of the stated variances.
const SQUARES_MIN: f64 = 1e-3;

/// Sums over the images of a drive, in which earlier ones count less.
#[derive(Debug, Clone, Default)]
pub(super) struct SeenImages {
    /// Information about the unknowns that independent errors of the stated variances would give.
    information: TermMatrix,
    /// Squared residuals over the stated variances.
    squares: f64,
    /// Points less fitted values.
    freedom: f64,
}

impl SeenImages {
    /// Adds an image.
    pub(super) fn add(&mut self, information: &TermMatrix, squares: f64, freedom: f64) {
        self.information = self.information * (1.0 - RATE) + information;
        self.squares = self.squares * (1.0 - RATE) + squares;
        self.freedom = self.freedom * (1.0 - RATE) + freedom;
    }

    /// Of a point: the mean square of its residual, and what a new map lets expect. None before the first image.
    fn mean_squares(&self, prior: &TermMatrix) -> Option<(f64, f64)> {
        (self.freedom > 0.0).then(|| {
            let seen = (self.squares / self.freedom).max(SQUARES_MIN);
            let by_map = (prior * self.information).trace() / self.freedom;
            (seen, by_map)
        })
    }
}

/// What may be claimed of a map's unknowns: covariances.
#[derive(Debug, Clone)]
pub(super) struct Claim {
    /// By the images alone.
    pub(super) by_images: TermMatrix,
    /// With information from elsewhere.
    pub(super) covariance: TermMatrix,
}

impl Claim {
    /// Nothing was learned.
    pub(super) fn of_new_map(prior: &TermMatrix) -> Self {
        Claim {
            by_images: *prior,
            covariance: *prior,
        }
    }

    /// What may be claimed after learning with independent errors, and with information `other`. None if a covariance is none.
    pub(super) fn new(
        prior: &TermMatrix,
        learned: &TermMatrix,
        seen: &SeenImages,
        other: &TermMatrix,
        terms: usize,
    ) -> Option<Self> {
        let given = inverse(prior, terms)?;
        let gained = inverse(learned, terms)? - given;
        let (mut share, mut widening) = (1.0 / REPETITION, 1.0);
        if let Some((seen, by_map)) = seen.mean_squares(prior) {
            let total = (prior * gained).trace().max(f64::EPSILON);
            share = share.min(POINTS_OF_A_DRIVE * by_map / (seen * total));
            // Residuals beyond those of any expected map: its errors are larger than expected, too.
            widening = (seen / (1.0 + by_map)).max(1.0);
        }
        let information = given / widening + gained * share;
        Some(Claim {
            by_images: inverse(&information, terms)?,
            covariance: inverse(&(information + other), terms)?,
        })
    }
}

/// The covariance with which learning goes on where so much may be claimed. None if a covariance is none.
pub(super) fn learned(
    prior: &TermMatrix,
    claimed: &TermMatrix,
    terms: usize,
) -> Option<TermMatrix> {
    let given = inverse(prior, terms)?;
    let gained = inverse(claimed, terms)? - given;
    inverse(&(given + gained * REPETITION), terms)
}

/// Inverse of the part of the unknowns in use. None if it is not positive definite.
fn inverse(matrix: &TermMatrix, terms: usize) -> Option<TermMatrix> {
    let mut matrix = *matrix;
    for k in terms..matrix.nrows() {
        matrix[(k, k)] = 1.0;
    }
    let mut inverse = matrix.cholesky()?.inverse();
    for k in terms..inverse.nrows() {
        inverse[(k, k)] = 0.0;
    }
    Some(inverse)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn matrix(entries: &[(usize, usize, f64)]) -> TermMatrix {
        let mut matrix = TermMatrix::zeros();
        for (i, j, value) in entries {
            matrix[(*i, *j)] = *value;
        }
        matrix
    }

    fn prior() -> TermMatrix {
        matrix(&[(0, 0, 4.0), (1, 1, 9.0)])
    }

    fn posterior() -> TermMatrix {
        matrix(&[(0, 0, 0.02), (0, 1, 0.01), (1, 0, 0.01), (1, 1, 9.0)])
    }

    fn claim(prior: &TermMatrix, seen: &SeenImages, other: &TermMatrix) -> Option<Claim> {
        Claim::new(prior, &posterior(), seen, other, 2)
    }

    #[test]
    fn claims_lie_between_prior_and_learned_and_lead_back_to_it() {
        let (prior, posterior) = (prior(), posterior());
        let none = TermMatrix::zeros();
        let claimed = claim(&prior, &SeenImages::default(), &none).expect("a covariance");
        let covariance = claimed.covariance;
        assert_eq!(claimed.by_images, covariance);
        assert!(covariance[(0, 0)] > 8.0 * posterior[(0, 0)]);
        assert!(covariance[(0, 0)] < 0.06 * prior[(0, 0)]);
        // Nothing was learned of the second: nothing is claimed.
        assert!((covariance[(1, 1)] / prior[(1, 1)] - 1.0).abs() < 1e-3);
        let back = learned(&prior, &covariance, 2).expect("a covariance");
        assert!((back - posterior).norm() < 1e-9, "{back}");
        assert!(claim(&(prior * -1.0), &SeenImages::default(), &none).is_none());
    }

    #[test]
    fn residuals_limit_what_any_number_of_images_may_claim() {
        let (prior, none) = (prior(), TermMatrix::zeros());
        let variance = |squares: f64| {
            let mut seen = SeenImages::default();
            for _ in 0..1000 {
                // A hundred points, each as uncertain by a new map as by itself.
                seen.add(&matrix(&[(0, 0, 25.0)]), 100.0 * squares, 100.0);
            }
            let claimed = claim(&prior, &seen, &none).expect("a covariance");
            claimed.by_images[(0, 0)]
        };
        // Residuals of the stated size: as much as four points tell.
        assert!(
            (variance(1.0) / (4.0 / 5.0) - 1.0).abs() < 0.01,
            "{}",
            variance(1.0)
        );
        assert!(variance(0.01) < 0.3 * variance(1.0));
        // Ten times more than a new map lets expect: the map is more wrong than expected.
        assert!(variance(20.0) > 3.0 * prior[(0, 0)], "{}", variance(20.0));
    }

    #[test]
    fn other_information_adds_to_that_of_the_images() {
        let other = matrix(&[(1, 1, 1.0)]);
        let claimed = claim(&prior(), &SeenImages::default(), &other).expect("a covariance");
        assert!(claimed.by_images[(1, 1)] > 8.9);
        assert!((claimed.covariance[(1, 1)] - 0.9).abs() < 0.01);
    }
}
