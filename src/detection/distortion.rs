//! Shear of the squares of a board by distortion. With the homography alone, the edges of a corner would have wrong directions,
//! and its position would move along them.

use nalgebra::{Matrix2, SVector, Vector1, Vector2};

use crate::numerics::{self, NormalEquations, Outliers, Reweighted, Scale, Weight};

/// Number of terms: radial distortion of the third and fifth order, tangential distortion (Brown, Conrady), and their effect on
/// the homography, which was fitted without them.
const TERMS: usize = 12;

/// Pinhole image of a corner, px: predicted by a homography, and observed.
pub(super) type Pinholes = (Vector2<f64>, Vector2<f64>);

/// Displacement of pinhole images from the prediction of a homography.
pub(super) struct Distortion {
    scale: Normalised,
    /// Coefficient of each term, px.
    coefficients: SVector<f64, TERMS>,
}

/// Normalisation of positions: multiples of `size_px` from the middle of the image.
#[derive(Clone, Copy)]
struct Normalised {
    middle_px: Vector2<f64>,
    size_px: f64,
}

/// Outliers, as for the slopes of corners, are wrong labels. Pinhole images are not known better than `least`, px.
const OUTLIERS: Outliers =
    Outliers { weight: Weight::Smooth, scale: Scale::Median, scales: 4.5, least: 0.02, slack: 0.0 };
const ROUNDS: usize = 10;
/// Weight, relative to a corner, with which terms are held at 0: with few corners, the smallest terms suffice.
const HELD: f64 = 1e-4;
/// Step of a derivative, in units of `size_px`.
const STEP: f64 = 1e-3;

impl Distortion {
    /// Fits the distortion to the corners of a board, robustly; it is 0 if there are no corners.
    pub fn fit(corners: &[Pinholes], middle_px: Vector2<f64>) -> Self {
        let scale = Normalised { middle_px, size_px: middle_px.norm() };
        let none = Self { scale, coefficients: SVector::zeros() };
        numerics::fit(&Corners { corners, scale }, None, ROUNDS, &OUTLIERS)
            .map_or(none, |fitted| fitted.model)
    }

    /// Returns the derivative of observed by predicted pinhole images at a predicted position.
    pub fn jacobian(&self, place: &Vector2<f64>) -> Matrix2<f64> {
        let step = STEP * self.scale.size_px;
        let columns = [Vector2::x(), Vector2::y()].map(|axis| {
            let side = |sign: f64| self.at(&(place + axis * (sign * step)));
            axis + (side(0.5) - side(-0.5)) / step
        });
        Matrix2::from_columns(&columns)
    }

    /// Returns the displacement of a pinhole image from its prediction, px.
    fn at(&self, place: &Vector2<f64>) -> Vector2<f64> {
        self.scale.terms(place).map(|terms| terms.dot(&self.coefficients)).into()
    }
}

impl Normalised {
    /// Returns the terms at a position, along u and v.
    fn terms(&self, place: &Vector2<f64>) -> [SVector<f64, TERMS>; 2] {
        let p = (place - self.middle_px) / self.size_px;
        let (r2, xy) = (p.norm_squared(), p.x * p.y);
        let (x2, y2) = (p.x * p.x, p.y * p.y);
        let along_u = [
            p.x * r2,
            p.x * r2 * r2,
            r2 + 2.0 * x2,
            2.0 * xy,
            1.0,
            p.x,
            p.y,
            0.0,
            0.0,
            0.0,
            x2,
            xy,
        ];
        let along_v = [
            p.y * r2,
            p.y * r2 * r2,
            2.0 * xy,
            r2 + 2.0 * y2,
            0.0,
            0.0,
            0.0,
            1.0,
            p.x,
            p.y,
            xy,
            y2,
        ];
        [along_u, along_v].map(SVector::from)
    }
}

struct Corners<'a> {
    corners: &'a [Pinholes],
    scale: Normalised,
}

impl Reweighted for Corners<'_> {
    type Model = Distortion;

    fn count(&self) -> usize {
        self.corners.len()
    }

    fn solve(&self, weights: &[f64], _: Option<&Distortion>) -> Option<Distortion> {
        let mut equations = NormalEquations::<f64, TERMS, 1>::new();
        for i in 0..TERMS {
            equations.add(&SVector::ith(i, 1.0), &Vector1::zeros(), HELD);
        }
        for ((homography, seen), weight) in self.corners.iter().zip(weights) {
            let terms = self.scale.terms(homography);
            for (terms, off) in terms.iter().zip((seen - homography).iter()) {
                equations.add(terms, &Vector1::new(*off), *weight);
            }
        }
        let coefficients = equations.solve()?;
        Some(Distortion { scale: self.scale, coefficients })
    }

    fn length(&self, model: &Distortion, datum: usize) -> f64 {
        let (homography, seen) = &self.corners[datum];
        (seen - homography - model.at(homography)).norm()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MIDDLE: Vector2<f64> = Vector2::new(500.0, 375.0);

    /// Returns the image of a position by a distorting lens, with 3 % at the corner of the image.
    fn distorted(place: &Vector2<f64>) -> Vector2<f64> {
        let p = (place - MIDDLE) / MIDDLE.norm();
        place - p * (0.03 * p.norm_squared() * MIDDLE.norm()) + Vector2::new(p.x * p.y, 0.0) * 2.0
    }

    fn board(count: i32) -> Vec<Pinholes> {
        (0..count)
            .map(|i| {
                Vector2::new(f64::from(i % 8), f64::from(i / 8)) * 95.0 + Vector2::new(140.0, 160.0)
            })
            .map(|place| (place, distorted(&place)))
            .collect()
    }

    #[test]
    fn squares_are_sheared_as_they_show() {
        let mut corners = board(40);
        // One label is wrong.
        corners[13].1.x += 30.0;
        let found = Distortion::fit(&corners, MIDDLE);
        for place in [Vector2::new(180.0, 200.0), Vector2::new(700.0, 460.0)] {
            let step = |axis: Vector2<f64>| distorted(&(place + axis)) - distorted(&(place - axis));
            let expected = Matrix2::from_columns(&[step(Vector2::x()), step(Vector2::y())]) / 2.0;
            let off = (found.jacobian(&place) - expected).amax();
            assert!(off < 2e-3, "{off} at {place}");
            assert!((expected - Matrix2::identity()).amax() > 3e-3, "{expected}");
        }
    }

    #[test]
    fn few_corners_shear_nothing() {
        let found = Distortion::fit(&board(2), MIDDLE);
        assert!((found.jacobian(&MIDDLE) - Matrix2::identity()).amax() < 0.03);
        let none = Distortion::fit(&[], MIDDLE);
        assert!((none.jacobian(&MIDDLE) - Matrix2::identity()).amax() < 1e-6);
    }
}
