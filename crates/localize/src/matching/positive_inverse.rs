//! Inverse of a small symmetric matrix with positive eigenvalues, in 64 bits.

use nalgebra::SMatrix;

/// The inverse by exchange of rows and columns (Gauss and Jordan), in place. None if a pivot is not positive: the matrix has an eigenvalue
/// that is not, but for rounding.
///
/// A tracked image needs several of them, and loops of known size are much faster than a decomposition column by column
/// (docs/performance.md).
pub(crate) fn positive_inverse<const N: usize>(
    matrix: &SMatrix<f64, N, N>,
) -> Option<SMatrix<f64, N, N>> {
    let mut rows: [[f64; N]; N] = matrix.transpose().into();
    for k in 0..N {
        if !(rows[k][k] > 0.0 && rows[k][k].is_finite()) {
            return None;
        }
        let inverse = 1.0 / rows[k][k];
        let mut pivot = rows[k].map(|value| value * inverse);
        pivot[k] = inverse;
        for (i, row) in rows.iter_mut().enumerate() {
            if i == k {
                continue;
            }
            let factor = row[k];
            row[k] = 0.0;
            for j in 0..N {
                row[j] -= factor * pivot[j];
            }
        }
        rows[k] = pivot;
    }
    Some(SMatrix::from_fn(|i, j| 0.5 * (rows[i][j] + rows[j][i])))
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix3;

    use super::*;

    #[test]
    fn matrix_a_million_million_times_longer_than_wide_is_inverted() {
        let (sin, cos) = (0.6, 0.8);
        let turn = Matrix3::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0);
        let of =
            |values: [f64; 3]| turn * Matrix3::from_diagonal(&values.into()) * turn.transpose();
        let inverse = positive_inverse(&of([1e6, 1e-6, 1.0])).expect("an inverse");
        let expected = of([1e-6, 1e6, 1.0]);
        assert!((inverse - expected).amax() < 1e-3 * expected.amax());
    }

    #[test]
    fn matrix_with_a_negative_eigenvalue_or_a_nan_has_none() {
        let saddle = Matrix3::new(1.0, 2.0, 0.0, 2.0, 1.0, 0.0, 0.0, 0.0, 1.0);
        assert_eq!(positive_inverse(&saddle), None);
        assert_eq!(positive_inverse(&Matrix3::from_element(f64::NAN)), None);
    }
}
