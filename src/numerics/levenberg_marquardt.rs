//! The Levenberg-Marquardt method for small problems (Marquardt, J. SIAM 11, 1963). An image takes millions of them, so nothing
//! is allocated between steps.

use nalgebra::{SMatrix, SVector};

/// Sum of squares to minimise over P parameters.
pub(crate) trait LeastSquares<const P: usize> {
    /// Type of the parameters.
    type Point: Copy;

    /// Returns the weighted sum of squares at a point, which becomes the trial point; `None` if the model is not defined there.
    fn evaluate(&mut self, at: &Self::Point) -> Option<f64>;

    /// Accepts the trial point.
    fn accept(&mut self);

    /// Returns JᵀWJ and JᵀWr at the point accepted last, where r is the measurement minus the model; `None` if the descent has
    /// failed.
    fn normal_equations(&mut self) -> Option<(SMatrix<f64, P, P>, SVector<f64, P>)>;

    /// Returns the point a step away, kept within the permitted range.
    fn moved(&self, from: &Self::Point, step: &SVector<f64, P>) -> Self::Point;

    /// Returns the distance between two points, in the unit of [`Descent::settled`].
    fn distance(&self, from: &Self::Point, to: &Self::Point) -> f64;
}

/// Settings of the minimisation.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Descent {
    /// Largest number of steps.
    pub steps: usize,
    /// Length of a step below which it is the last one, if it lowers the sum.
    pub settled: f64,
    /// Length of a step below which it is the last one and is taken without evaluating the sum, since the remaining error is of
    /// the second order. It does not apply after a step that did not lower the sum.
    pub unseen: f64,
    /// Factor by which a step that lowers the sum divides the damping, and any other multiplies it.
    pub factor: f64,
    /// Smallest and largest damping. If even the largest does not lower the sum, the descent ends.
    pub damping: (f64, f64),
}

/// Damping of the first step, relative to the diagonal: nearly a Gauss-Newton step, as the start is
/// near the minimum.
const FIRST_DAMPING: f64 = 1e-3;

impl Descent {
    /// Returns the lowest point found from a start, and its sum of squares; `None` if the model is not defined at the start or
    /// at a trial point.
    #[inline]
    pub fn from<const P: usize, S: LeastSquares<P>>(
        &self,
        start: S::Point,
        sum: &mut S,
    ) -> Option<(S::Point, f64)> {
        let (mut point, mut cost) = (start, sum.evaluate(&start)?);
        sum.accept();
        let (mut normal, mut right) = sum.normal_equations()?;
        let mut damping = FIRST_DAMPING;
        for _ in 0..self.steps {
            let mut damped = normal;
            for i in 0..P {
                damped[(i, i)] *= 1.0 + damping;
            }
            // If the equations have no solution, no step is possible with this damping.
            let step = damped.cholesky().map(|factors| factors.solve(&right));
            if let Some(step) = step {
                let next = sum.moved(&point, &step);
                if damping <= FIRST_DAMPING && sum.distance(&point, &next) < self.unseen {
                    // The linear model gives the sum; rounding must not make it negative.
                    return Some((next, (cost - right.dot(&step)).max(f64::EPSILON * cost)));
                }
                let next_cost = sum.evaluate(&next)?;
                if next_cost < cost {
                    let length = sum.distance(&point, &next);
                    (point, cost) = (next, next_cost);
                    sum.accept();
                    damping = (damping / self.factor).max(self.damping.0);
                    if length < self.settled {
                        break;
                    }
                    (normal, right) = sum.normal_equations()?;
                    continue;
                }
            }
            damping *= self.factor;
            if damping > self.damping.1 {
                break;
            }
        }
        Some((point, cost))
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix2, Vector2};

    use super::*;

    /// Rosenbrock's valley, as a sum of two squares.
    struct Valley {
        trial: Vector2<f64>,
        taken: Vector2<f64>,
    }

    fn residuals(at: &Vector2<f64>) -> Vector2<f64> {
        Vector2::new(at.x - 1.0, 10.0 * (at.y - at.x * at.x))
    }

    impl LeastSquares<2> for Valley {
        type Point = Vector2<f64>;

        fn evaluate(&mut self, at: &Self::Point) -> Option<f64> {
            self.trial = *at;
            Some(residuals(at).norm_squared())
        }

        fn accept(&mut self) {
            self.taken = self.trial;
        }

        fn normal_equations(&mut self) -> Option<(Matrix2<f64>, Vector2<f64>)> {
            let jacobian = Matrix2::new(1.0, 0.0, -20.0 * self.taken.x, 10.0);
            let right = -jacobian.transpose() * residuals(&self.taken);
            Some((jacobian.transpose() * jacobian, right))
        }

        fn moved(&self, from: &Self::Point, step: &Vector2<f64>) -> Self::Point {
            from + step
        }

        fn distance(&self, from: &Self::Point, to: &Self::Point) -> f64 {
            (to - from).norm()
        }
    }

    #[test]
    fn the_minimum_of_a_curved_valley_is_reached() {
        let mut valley = Valley { trial: Vector2::zeros(), taken: Vector2::zeros() };
        let descent =
            Descent { steps: 100, settled: 1e-10, unseen: 0.0, factor: 5.0, damping: (1e-9, 1e6) };
        let (end, cost) = descent.from(Vector2::new(-1.2, 1.0), &mut valley).unwrap();
        assert!((end - Vector2::new(1.0, 1.0)).norm() < 1e-9 && cost < 1e-18, "{end} {cost}");
    }

    /// Checks that one step reaches the bottom of a straight valley without an evaluation there, and gives its sum.
    #[test]
    fn a_short_last_step_is_taken_unseen() {
        struct Straight {
            trial: f64,
            taken: f64,
            evaluations: usize,
        }
        impl LeastSquares<1> for Straight {
            type Point = f64;
            fn evaluate(&mut self, at: &f64) -> Option<f64> {
                self.evaluations += 1;
                self.trial = *at;
                // Residuals 1 − x and −0.4 − x.
                Some((1.0 - at).powi(2) + (-0.4 - at).powi(2))
            }
            fn accept(&mut self) {
                self.taken = self.trial;
            }
            fn normal_equations(&mut self) -> Option<(SMatrix<f64, 1, 1>, SVector<f64, 1>)> {
                Some((SMatrix::from([[2.0]]), SVector::from([0.6 - 2.0 * self.taken])))
            }
            fn moved(&self, from: &f64, step: &SVector<f64, 1>) -> f64 {
                from + step[0]
            }
            fn distance(&self, from: &f64, to: &f64) -> f64 {
                (to - from).abs()
            }
        }
        let settings =
            Descent { steps: 9, settled: 1e-3, unseen: 0.1, factor: 9.0, damping: (1e-9, 1e6) };
        for (start, evaluations) in [(0.25, 1), (2.0, 2)] {
            let mut valley = Straight { trial: 0.0, taken: 0.0, evaluations: 0 };
            let (end, sum) = settings.from(start, &mut valley).unwrap();
            assert!((end - 0.3).abs() < 1e-4 && (sum - 0.98).abs() < 1e-4, "{end} {sum}");
            assert_eq!(valley.evaluations, evaluations);
        }
        // The linear model agrees with the evaluated sum, apart from the damping of the first step.
        let mut seen = Straight { trial: 0.0, taken: 0.0, evaluations: 0 };
        let (_, sum) = Descent { unseen: 0.0, ..settings }.from(0.25, &mut seen).unwrap();
        assert!(seen.evaluations > 1 && (sum - 0.98).abs() < 1e-6, "{sum}");
    }
}
