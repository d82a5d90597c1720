//! Line that all observations of one corner lie on.
//!
//! Micro-lens (k, l), with its micro-image about c, shows a point at i = β + γ c. β and the slope γ = λ (1 − 1/ν), with
//! λ = D/(D + d), are the same in all micro-images. At i = c the point is seen through the middle of the main lens: this is its
//! pinhole image.

use nalgebra::{Matrix2x3, Matrix3, SMatrix, Vector1, Vector2, Vector3};

use super::CornerObservation;
use crate::model::Configuration;
use crate::numerics::{self, NormalEquations, Outliers, Reweighted, Scale, Weight, median};

/// Line i = β + γ c.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CornerLine {
    /// Offset β, px.
    pub start: Vector2<f64>,
    /// Slope γ.
    pub slope: f64,
    /// Standard deviation of γ, from the stated uncertainty of the observations or from their scatter about the line, whichever
    /// is larger.
    pub slope_std_dev: f64,
    /// Root mean square distance of the observations from the line, without outliers, px.
    pub rms_px: f64,
}

/// Outliers of a line: corners of texture, or of a neighbour. No position is measured better than `least`, px.
const OUTLIERS: Outliers = Outliers {
    weight: Weight::Biweight,
    scale: Scale::PerAxis,
    scales: 4.0,
    least: 0.03,
    slack: 0.0,
};
/// Largest number of rounds of reweighted fits, and change of slopes at which they end.
const ROUNDS: usize = 20;
const SETTLED: f64 = 1e-10;
/// Mean square distance of centres from their middle, px², below which they determine no slope.
const LEAST_SPREAD: f64 = 1e-6;
/// Range of |1 − γ|, apart from 0 and from its value for micro-images that do not overlap.
const INVERSE_DEPTHS: std::ops::Range<f64> = 0.02..0.98;

impl CornerLine {
    /// Returns the position of the point in the micro-image about `center`, px.
    #[must_use]
    pub fn at(&self, center: &Vector2<f64>) -> Vector2<f64> {
        self.start + center * self.slope
    }

    /// Returns the pinhole image of the point, px: where a ray from it through the middle of the main lens and the middle of a
    /// micro-lens would meet the sensor.
    #[must_use]
    pub fn pinhole(&self) -> Vector2<f64> {
        self.start / (1.0 - self.slope)
    }

    /// Returns 1/ν = 1 − γ/λ, Eq. (virtdepth).
    #[must_use]
    pub fn inverse_virtual_depth(&self, lambda: f64) -> f64 {
        1.0 - self.slope / lambda
    }

    /// Returns the derivatives of [`CornerLine::at`] by β and γ.
    pub(super) fn design(center: &Vector2<f64>) -> Matrix2x3<f64> {
        Matrix2x3::new(1.0, 0.0, center.x, 0.0, 1.0, center.y)
    }

    /// Creates the line through a pinhole image.
    #[must_use]
    pub fn through(pinhole: &Vector2<f64>, slope: f64) -> Self {
        Self::exact(pinhole * (1.0 - slope), slope)
    }

    /// Creates the line with these parameters.
    pub(super) fn exact(start: Vector2<f64>, slope: f64) -> Self {
        Self { start, slope, slope_std_dev: 0.0, rms_px: 0.0 }
    }

    /// Fits the line robustly; `None` if the observations are of a single micro-image.
    pub(crate) fn fit(observations: impl Iterator<Item = CornerObservation>) -> Option<Self> {
        FittedLine::fit(observations).map(|fitted| fitted.line)
    }
}

/// Line with the observations that it was fitted to.
pub(super) struct FittedLine {
    pub line: CornerLine,
    observed: Observed,
    weights: Vec<f64>,
}

impl FittedLine {
    /// Fits the line robustly; `None` if the observations are of a single micro-image.
    pub fn fit(observations: impl Iterator<Item = CornerObservation>) -> Option<Self> {
        let observations: Vec<CornerObservation> = observations.collect();
        let count = observations.len() as f64;
        let middle = observations.iter().map(|o| o.center).sum::<Vector2<f64>>() / count;
        let observed = Observed { observations, middle };
        let fitted = numerics::fit(&observed, None, ROUNDS, &OUTLIERS)?;
        let (line, inverse) = fitted.model;
        let used = || {
            let all = observed.observations.iter().zip(&fitted.lengths).zip(&fitted.weights);
            all.filter(|(_, weight)| **weight > 0.0).map(|(used, _)| used)
        };
        let square: f64 = used().map(|(_, length)| length * length).sum();
        let count = used().count() as f64;
        // Each observation has two coordinates, and three determine the line. Weights are in 1/px², so the remaining sum shows
        // how much larger the errors are.
        let freedom = (2.0 * count - 3.0).max(1.0);
        let weighted: f64 = used()
            .map(|(o, _)| o.whitened(&(o.position - line.at(&o.center))).norm_squared())
            .sum();
        // A few observations may agree by chance, which does not make them more accurate.
        let factor = (weighted / freedom).max(1.0);
        let line = CornerLine {
            slope_std_dev: (inverse[(2, 2)] * factor).max(0.0).sqrt(),
            rms_px: (square / count.max(1.0)).sqrt(),
            ..line
        };
        let finite = line.slope.is_finite() && line.start.iter().all(|x| x.is_finite());
        finite.then_some(Self { line, observed, weights: fitted.weights })
    }

    /// Returns the derivatives of β and γ by quantities, from the derivatives of the positions of its observations, with the
    /// weights of the fit.
    pub fn derivatives<const Q: usize>(
        &self,
        places: impl Iterator<Item = SMatrix<f64, 2, Q>>,
    ) -> Option<SMatrix<f64, 3, Q>> {
        let Observed { observations, middle } = &self.observed;
        let mut equations = NormalEquations::<f64, 3, Q>::new();
        for ((observation, weight), place) in observations.iter().zip(&self.weights).zip(places) {
            let rows = observation.whitened(&CornerLine::design(&(observation.center - middle)));
            let measured = observation.whitened(&place);
            for i in 0..2 {
                equations.add(&rows.row(i).transpose(), &measured.row(i).into_owned(), *weight);
            }
        }
        let mut line = equations.solve()?;
        let slope = line.row(2).into_owned();
        for i in 0..2 {
            let start = line.row(i) - slope * middle[i];
            line.set_row(i, &start);
        }
        Some(line)
    }
}

struct Observed {
    observations: Vec<CornerObservation>,
    /// Mean of their centres, px: relative to it, start and slope are nearly independent.
    middle: Vector2<f64>,
}

impl Reweighted for Observed {
    /// Line with the inverse of its normal matrix.
    type Model = (CornerLine, Matrix3<f64>);

    fn count(&self) -> usize {
        self.observations.len()
    }

    fn solve(&self, weights: &[f64], _: Option<&Self::Model>) -> Option<Self::Model> {
        let mut equations = NormalEquations::<f64, 3, 1>::new();
        for (observation, weight) in self.observations.iter().zip(weights) {
            let rows = CornerLine::design(&(observation.center - self.middle));
            let rows = observation.whitened(&rows);
            let measured = observation.whitened(&observation.position);
            for (row, measured) in rows.row_iter().zip(&measured) {
                equations.add(&row.transpose(), &Vector1::new(*measured), *weight);
            }
        }
        let normal = equations.normal();
        if normal[(2, 2)] <= LEAST_SPREAD * normal[(0, 0)] || self.count() < 2 {
            return None;
        }
        let solution: Vector3<f64> = equations.solve()?;
        let slope = solution.z;
        let start = solution.xy() - self.middle * slope;
        Some((CornerLine::exact(start, slope), normal.try_inverse()?))
    }

    fn length(&self, (line, _): &Self::Model, datum: usize) -> f64 {
        let observation = &self.observations[datum];
        (observation.position - line.at(&observation.center)).norm()
    }

    fn settled(&self, (last, _): &Self::Model, (next, _): &Self::Model) -> bool {
        (last.slope - next.slope).abs() < SETTLED
    }
}

/// Returns true for slopes that a point can have. Behind the array (Galilean), neighbouring micro-images show it closer
/// together than their centres are; in front of it (Keplerian), further apart.
pub(super) fn possible_slope(slope: f64, configuration: Configuration) -> bool {
    match configuration {
        Configuration::Galilean => INVERSE_DEPTHS.contains(&(1.0 - slope)),
        Configuration::Keplerian => INVERSE_DEPTHS.contains(&(slope - 1.0)),
        Configuration::Unfocused => INVERSE_DEPTHS.contains(&(1.0 - slope).abs()),
    }
}

/// Returns 1/ν as in the paper, from the median of Eq. (virtdepth) over all pairs of observations, with λ = 1. For an even
/// number of pairs it is the upper of the middle two, as in COMPOTE. `None` for a single observation.
pub(super) fn median_inverse_virtual_depth(observations: &[CornerObservation]) -> Option<f64> {
    let mut depths = Vec::new();
    for (n, a) in observations.iter().enumerate() {
        for b in &observations[..n] {
            let baseline = (a.center - b.center).norm();
            let disparity = baseline - (a.position - b.position).norm();
            if baseline > 0.0 && disparity != 0.0 {
                depths.push(baseline / disparity);
            }
        }
    }
    Some(1.0 / median(depths)?)
}

#[cfg(test)]
pub(super) mod tests {
    use nalgebra::Matrix2;

    use super::*;

    /// Returns observations of a point on a square array of pitch 20, with small errors.
    pub fn observations(pinhole: Vector2<f64>, slope: f64) -> Vec<CornerObservation> {
        let line = CornerLine::through(&pinhole, slope);
        let mut observations = Vec::new();
        for (k, l) in (-2..=2).flat_map(|l| (-2..=2).map(move |k| (k, l))) {
            let center = Vector2::new(f64::from(k), f64::from(l)) * 20.0 + pinhole.map(f64::round);
            let noise =
                Vector2::new(f64::from((k * 7 + l * 3) % 5), f64::from((k + l * 4) % 3)) * 0.02;
            observations.push(CornerObservation {
                k,
                l,
                center,
                position: line.at(&center) + noise,
                covariance: Matrix2::identity() * 0.0025,
                squares: Matrix2::zeros(),
            });
        }
        observations
    }

    #[test]
    fn a_line_is_found_with_its_uncertainty() {
        let pinhole = Vector2::new(503.2, 377.9);
        let mut seen = observations(pinhole, 0.75);
        // Two outliers have no effect.
        seen[3].position += Vector2::new(4.0, -2.0);
        seen[17].position += Vector2::new(-3.0, 5.0);
        let line = CornerLine::fit(seen.iter().copied()).unwrap();
        // Errors of up to 0.08 px over 80 px.
        assert!((line.slope - 0.75).abs() < 1e-3, "{}", line.slope);
        assert!((1e-5..2e-3).contains(&line.slope_std_dev), "{}", line.slope_std_dev);
        assert!((line.pinhole() - pinhole).norm() < 0.5, "{}", line.pinhole());
        assert!((line.inverse_virtual_depth(1.0) - 0.25).abs() < 1e-3);
        assert!(CornerLine::fit(seen[..1].iter().copied()).is_none());
    }

    /// Compares with a value calculated by hand: micro-images 20 px apart that show the point 15 px apart have ν = 4.
    #[test]
    fn the_median_over_pairs_is_that_of_the_disparity() {
        let inverse = median_inverse_virtual_depth(&observations(Vector2::new(500.0, 370.0), 0.75));
        assert!((inverse.unwrap() - 0.25).abs() < 2e-3);
        assert!(median_inverse_virtual_depth(&[]).is_none());
    }

    #[test]
    fn points_behind_the_array_have_slopes_below_one() {
        assert!(possible_slope(0.75, Configuration::Galilean));
        assert!(!possible_slope(1.25, Configuration::Galilean));
        assert!(possible_slope(1.25, Configuration::Keplerian));
        assert!(!possible_slope(f64::NAN, Configuration::Unfocused));
    }

    /// Checks that two observations that happen to agree are as uncertain as they state.
    #[test]
    fn chance_agreement_is_not_certainty() {
        let mut seen = observations(Vector2::new(500.0, 370.0), 0.75);
        let line = CornerLine::through(&Vector2::new(500.0, 370.0), 0.75);
        seen.truncate(2);
        for observation in &mut seen {
            observation.position = line.at(&observation.center);
        }
        let line = CornerLine::fit(seen.iter().copied()).unwrap();
        // Errors are 0.05 px each, 20 px apart.
        assert!((line.slope_std_dev - 0.05 * 2.0_f64.sqrt() / 20.0).abs() < 1e-9);
    }
}
