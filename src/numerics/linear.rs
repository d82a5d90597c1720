//! Linear least squares with few unknowns.

use nalgebra::{RealField, SMatrix, SVector};

/// Normal equations of P unknowns with Q right-hand sides, summed row by row. The design matrix is never stored, so sums over
/// millions of pixels take no memory.
///
/// Sums are kept and solved in the precision T of the data.
#[derive(Debug, Clone, Copy)]
pub(crate) struct NormalEquations<T, const P: usize, const Q: usize> {
    normal: SMatrix<T, P, P>,
    right: SMatrix<T, P, Q>,
}

impl<T: RealField + Copy, const P: usize, const Q: usize> NormalEquations<T, P, Q> {
    /// Creates equations without rows.
    pub fn new() -> Self {
        Self { normal: SMatrix::zeros(), right: SMatrix::zeros() }
    }

    /// Adds a row of the design matrix with its measurement and its weight, the inverse of the variance up to a common factor.
    #[inline]
    pub fn add(&mut self, row: &SVector<T, P>, measured: &SMatrix<T, 1, Q>, weight: T) {
        let weighted = row * weight;
        // A Cholesky decomposition reads the lower triangle only.
        for j in 0..P {
            for i in j..P {
                self.normal[(i, j)] += weighted[i] * row[j];
            }
        }
        self.right += weighted * measured;
    }

    /// Returns the whole normal matrix AᵀWA.
    pub fn normal(&self) -> SMatrix<T, P, P> {
        SMatrix::from_fn(|i, j| self.normal[(i.max(j), i.min(j))])
    }

    /// Returns the unknowns; `None` if the rows do not determine them.
    pub fn solve(&self) -> Option<SMatrix<T, P, Q>> {
        Some(self.normal.cholesky()?.solve(&self.right))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Vector1, Vector2};

    #[test]
    fn a_straight_line_is_found() {
        let mut equations = NormalEquations::<f64, 2, 1>::new();
        for (x, weight) in [(0.0, 1.0), (1.0, 0.25), (5.0, 2.0)] {
            equations.add(&Vector2::new(1.0, x), &Vector1::new(3.0 - 2.0 * x), weight);
        }
        let line = equations.solve().unwrap();
        assert!((line - Vector2::new(3.0, -2.0)).norm() < 1e-12);
        assert!((equations.normal()[(0, 1)] - 10.25).abs() < 1e-12);
    }

    #[test]
    fn a_single_point_does_not_determine_a_line() {
        let mut equations = NormalEquations::new();
        equations.add(&Vector2::new(1.0_f32, 2.0), &Vector1::new(1.0), 1.0);
        assert!(equations.solve().is_none());
    }
}
