//! Slope of corners over the image, which is linear for a plane board, by Eq. (virtdepth).

use nalgebra::{Vector1, Vector2, Vector3};

use super::CornerLine;
use crate::numerics::{self, NormalEquations, Outliers, Reweighted, Scale, Weight};

/// γ as a linear function of the pinhole image: derivatives by u and v, px⁻¹, and value at (0, 0).
pub(super) struct SlopeField(Vector3<f64>);

/// Outliers of the field: corners with wrong labels. There are too few corners to drop any, so the weights decrease smoothly.
/// Slopes are not known better than `least`.
const OUTLIERS: Outliers =
    Outliers { weight: Weight::Smooth, scale: Scale::Median, scales: 4.5, least: 1e-6, slack: 0.0 };
/// Number of rounds, in which the weights settle; a field takes microseconds.
const ROUNDS: usize = 10;

impl SlopeField {
    /// Fits the field to the lines of corners, robustly; `None` if they do not span the plane.
    pub fn fit(lines: &[CornerLine]) -> Option<Self> {
        numerics::fit(&Lines(lines), None, ROUNDS, &OUTLIERS).map(|fitted| fitted.model)
    }

    /// Returns the slope of a corner with its pinhole image at a position.
    pub fn at(&self, place: &Vector2<f64>) -> f64 {
        self.gradient().dot(place) + self.0.z
    }

    /// Returns the gradient of the slope by the pinhole image, px⁻¹.
    pub fn gradient(&self) -> Vector2<f64> {
        self.0.xy()
    }
}

struct Lines<'a>(&'a [CornerLine]);

impl Reweighted for Lines<'_> {
    type Model = SlopeField;

    fn count(&self) -> usize {
        self.0.len()
    }

    fn solve(&self, weights: &[f64], _: Option<&SlopeField>) -> Option<SlopeField> {
        let mut equations = NormalEquations::<f64, 3, 1>::new();
        for (line, weight) in self.0.iter().zip(weights) {
            let p = line.pinhole();
            equations.add(&Vector3::new(p.x, p.y, 1.0), &Vector1::new(line.slope), *weight);
        }
        equations.solve().map(SlopeField)
    }

    fn length(&self, field: &SlopeField, datum: usize) -> f64 {
        let line = &self.0[datum];
        (line.slope - field.at(&line.pinhole())).abs()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wrong_corner_does_not_bend_the_field() {
        let place = |i: i32| Vector2::new(f64::from(i % 5), f64::from(i / 5)) * 100.0;
        let slope = |p: &Vector2<f64>| 0.8 + 1e-5 * p.x - 2e-5 * p.y;
        let mut lines: Vec<CornerLine> =
            (0..20).map(|i| CornerLine::through(&place(i), slope(&place(i)))).collect();
        lines[7] = CornerLine::through(&place(7), 0.9);
        let field = SlopeField::fit(&lines).unwrap();
        assert!((field.at(&place(7)) - slope(&place(7))).abs() < 1e-6);
        assert!((field.gradient() - Vector2::new(1e-5, -2e-5)).norm() < 1e-8);
        assert!(SlopeField::fit(&lines[..2]).is_none());
    }
}
