//! Widths of edges, relative to the expected blur of a corner: their information about the aperture ratio of the micro-lenses,
//! and about other causes of wide edges.
//!
//! The blur radius of a corner is ρ = qᵢ + φ (1 − γ) Δc/2. White images give qᵢ, and the line of the corner its slope γ.
//! Openings narrower than the pitch, φ < 1, blur less. A point spread, print that is not sharp, and motion of the board widen
//! all edges by the same variance v.

use nalgebra::{Matrix2, Vector2};

use crate::model::APERTURE_RATIO_MODEL;
use crate::numerics::median;
use crate::quantity::Estimate;

/// Information about a blur radius, or about ln φ, and v, near the values that corners were fitted with, with positions and
/// levels free; and this information times the change.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct EdgeWidth {
    information: Matrix2<f64>,
    right: Vector2<f64>,
}

/// Changes of ln φ and v with their covariance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct WidthChange {
    pub change: Vector2<f64>,
    pub covariance: Matrix2<f64>,
    /// Information of the corners alone about both, as far as their scatter allows.
    pub corners: EdgeWidth,
}

/// Aperture ratio and v of all frames together.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct OfFrames {
    pub ratio: Estimate,
    /// Excess edge variance v, px².
    pub wider_px2: Estimate,
    /// True for frames with this v: the others have moved.
    pub alike: Vec<bool>,
}

impl EdgeWidth {
    /// Creates the edge width from the information, and the information times the change.
    pub fn new(information: Matrix2<f64>, right: Vector2<f64>) -> Self {
        Self { information, right }
    }

    /// Returns true if all values are finite.
    pub fn is_finite(&self) -> bool {
        self.information.iter().chain(&self.right).all(|x| x.is_finite())
    }

    /// Returns the information about ln φ, from the information about a blur radius with this derivative by ln φ, px.
    pub fn of_log_ratio(self, radius_by_ratio_px: f64) -> Self {
        let by = Vector2::new(radius_by_ratio_px, 1.0);
        let scale = Matrix2::from_diagonal(&by);
        Self { information: scale * self.information * scale, right: self.right.component_mul(&by) }
    }

    /// Returns the information about the quantities themselves, from the information about their changes from these values.
    pub fn about(self, at: &Vector2<f64>) -> Self {
        Self { right: self.right + self.information * at, ..self }
    }

    /// Returns the derivative by v of the first quantity, as found from this corner alone.
    pub fn first_by_width(&self) -> f64 {
        -self.information[(0, 1)] / self.information[(0, 0)]
    }

    /// Returns v with its variance if ln φ is known; `None` without information.
    fn of_width(&self, log_ratio: f64) -> Option<(f64, f64)> {
        let information = self.information[(1, 1)];
        let left = self.right.y - self.information[(0, 1)] * log_ratio;
        (information > 0.0).then(|| (left / information, 1.0 / information))
    }

    /// Returns the information about ln φ if v is unknown.
    fn of_ratio_alone(&self) -> Self {
        let Self { information: n, right } = *self;
        let share = if n[(1, 1)] > 0.0 { n[(0, 1)] / n[(1, 1)] } else { 0.0 };
        Self {
            information: Matrix2::new(n[(0, 0)] - share * n[(0, 1)], 0.0, 0.0, 0.0),
            right: Vector2::new(right.x - share * right.y, 0.0),
        }
    }

    /// Returns the change of the first quantity by this corner alone, with its variance, after `change` of both; `None` without
    /// information.
    pub fn of_first(&self, change: &Vector2<f64>) -> Option<(f64, f64)> {
        let information = self.information[(0, 0)];
        let left = self.right - self.information * change;
        (information > 0.0).then(|| (left.x / information, 1.0 / information))
    }
}

/// Distance of a corner from all others, in typical distances, above which it is false, or the light of other things.
const OUTLIERS: f64 = 5.0;
/// Usual difference of the edge variances of boards and white images, px², and a clear one, in units of it.
const AS_SHARP_PX2: f64 = 0.03;
const CLEARLY: f64 = 2.0;
/// Difference of an edge variance from its assumed value, px² and in standard deviations, below which it is insignificant.
/// (Lines that are not known well yet widen edges.)
const SAME_PX2: f64 = 0.1;
const SIGNIFICANT: f64 = 3.0;
/// Difference of the edge variance of a frame from the others, px² and in standard deviations, above which its board has moved.
pub(super) const MOVED_PX2: f64 = 0.05;
pub(super) const MOVED: f64 = 5.0;
/// Number of rounds in which outliers are left out.
const ROUNDS: usize = 5;
/// Standard deviation of ln φ below which edges determine it.
const DETERMINED: f64 = 0.05;
/// Error of v due to the model of a corner, as a part of the variance of the point spread. Light at the rim of the pupil is
/// summed to the first order of the point spread over the radius of the pupil (`optics/rim.rs`). At 1 px², corners of exact
/// light are off by 0.005 px², at the rim by 0.04 px².
const OF_POINT_SPREAD: f64 = 0.05;

impl WidthChange {
    /// Returns the change of ln φ with its σ, if edges determine it.
    pub fn log_ratio(&self) -> Option<(f64, f64)> {
        let std_dev = self.covariance[(0, 0)].sqrt();
        (std_dev < DETERMINED).then_some((self.change.x, std_dev))
    }

    /// Returns true if edges are wider or narrower than assumed, by an amount that matters and is not chance. Causes are print
    /// that is not sharp, motion, or another point spread than in white images.
    pub fn edges_differ(&self) -> bool {
        let change = self.change.y.abs();
        change > SAME_PX2 && change > SIGNIFICANT * self.covariance[(1, 1)].sqrt()
    }

    /// Fits the changes to all corners, whose edges are already assumed to be wider by `wider_px2`; `None` if they do not
    /// determine them. The covariance follows from their scatter.
    ///
    /// If all corners have a similar blur they cannot separate both, see [`prior`].
    pub fn fit(all: &[EdgeWidth], wider_px2: f64) -> Option<Self> {
        let mut kept = vec![true; all.len()];
        let mut found: Option<Self> = None;
        for _ in 0..ROUNDS {
            let (mut information, mut right) = (Matrix2::zeros(), Vector2::zeros());
            for (one, _) in all.iter().zip(&kept).filter(|(_, kept)| **kept) {
                information += one.information;
                right += one.right;
            }
            let corners = EdgeWidth { information, right };
            let prior = prior(wider_px2 + found.map_or(0.0, |found| found.change.y));
            information[(1, 1)] += prior;
            right.y -= prior * wider_px2;
            let covariance = information.cholesky()?.inverse();
            let change = covariance * right;
            // Distances are in the standard deviations that each corner claims.
            let far = |one: &EdgeWidth| {
                one.of_first(&change).map_or(0.0, |(by, variance)| by.abs() / variance.sqrt())
            };
            let distances: Vec<f64> = all.iter().map(far).collect();
            // The factor is the median of |x| for a normal distribution.
            let typical = median(distances.iter().copied())? / 0.6745;
            kept = distances.iter().map(|far| *far <= OUTLIERS * typical.max(1.0)).collect();
            let excess = typical.powi(2).max(1.0);
            found =
                Some(Self { change, covariance: covariance * excess, corners: corners / excess });
        }
        found
    }
}

/// Returns the weight of the prior that edges of boards are as sharp as edges of white images unless they clearly are not (a
/// Cauchy distribution), px⁻⁴, for an excess edge variance.
fn prior(wider_px2: f64) -> f64 {
    1.0 / (AS_SHARP_PX2.powi(2) + (wider_px2 / CLEARLY).powi(2))
}

impl OfFrames {
    /// Fits ln φ and v to the information of the corners of each frame, with this variance of the point spread, px²; `None` if
    /// they do not determine them. All boards have the same print and are seen by the same pixels, so they have one v, except
    /// for those that moved.
    pub fn fit(frames: &[EdgeWidth], point_spread_px2: f64) -> Option<Self> {
        let mut alike = vec![true; frames.len()];
        let mut found: Option<(Vector2<f64>, Matrix2<f64>, f64)> = None;
        for round in 1..=ROUNDS {
            let (mut information, mut right) = (Matrix2::zeros(), Vector2::zeros());
            for (frame, alike) in frames.iter().zip(&alike) {
                let of_both = if *alike { *frame } else { frame.of_ratio_alone() };
                information += of_both.information;
                right += of_both.right;
            }
            information[(1, 1)] += prior(found.map_or(0.0, |(at, ..)| at.y));
            let covariance = information.cholesky()?.inverse();
            let at = covariance * right;
            found = Some((at, covariance, -information[(0, 1)] / information[(0, 0)]));
            let widths: Vec<Option<(f64, f64)>> = frames.iter().map(|f| f.of_width(at.x)).collect();
            let usual = median(widths.iter().flatten().map(|(width, _)| *width))?;
            let is_usual = |(width, variance): (f64, f64)| {
                (width - usual).abs() <= MOVED_PX2.max(MOVED * variance.sqrt())
            };
            // The last selection of frames has to match the last solution.
            if round < ROUNDS {
                alike = widths.into_iter().map(|width| width.is_some_and(is_usual)).collect();
            }
        }
        let (at, covariance, ratio_by_width) = found?;
        let scatter = |(frame, alike): (&EdgeWidth, &bool)| {
            let own = if *alike { *frame } else { frame.of_ratio_alone() };
            let (from, variance) = own.of_first(&at)?;
            Some(from * from / variance)
        };
        let scatter: f64 = frames.iter().zip(&alike).filter_map(scatter).sum();
        let excess = (scatter / (frames.len() as f64 - 1.0).max(1.0)).max(1.0);
        let std_dev = |i: usize| (excess * covariance[(i, i)]).sqrt();
        let value = at.x.exp();
        // If blur and point spread are hardly distinguishable, an error of one is an error of the other.
        let of_width = OF_POINT_SPREAD * point_spread_px2;
        let of_ratio = std_dev(0).hypot(APERTURE_RATIO_MODEL).hypot(of_width * ratio_by_width);
        let ratio = Estimate { value, std_dev: value * of_ratio };
        Some(Self { ratio, wider_px2: Estimate::new(at.y, std_dev(1).hypot(of_width)), alike })
    }
}

impl std::ops::Div<f64> for EdgeWidth {
    type Output = Self;

    fn div(self, by: f64) -> Self {
        Self { information: self.information / by, right: self.right / by }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(ratio: f64, width: f64) -> EdgeWidth {
        let information = Matrix2::new(400.0, 30.0, 30.0, 100.0);
        EdgeWidth { information, right: information * Vector2::new(ratio, width) }
    }

    #[test]
    fn one_false_corner_does_not_count() {
        let mut all: Vec<EdgeWidth> =
            (0..60).map(|i| of(-0.08 + 0.05 * f64::from(i % 3 - 1), 0.2)).collect();
        all.push(of(9.0, 0.0));
        let found = WidthChange::fit(&all, 0.0).unwrap();
        assert!((found.change - Vector2::new(-0.08, 0.2)).norm() < 0.01, "{found:?}");
        assert!(WidthChange::fit(&[], 0.0).is_none());
    }

    /// Checks corners that can hardly separate ln φ from v: the prior on v counts once, however many frames there are.
    #[test]
    fn what_is_known_beforehand_counts_once() {
        let truth = Vector2::new(-0.08, 0.06);
        let of_frame = |width: f64| {
            let information = Matrix2::new(4e4, 6e3, 6e3, 1.2e3);
            EdgeWidth { information, right: information * Vector2::new(truth.x, width) }
        };
        let of = |count: usize| OfFrames::fit(&vec![of_frame(truth.y); count], 0.0).unwrap();
        let off = |found: &OfFrames| (found.ratio.value.ln() - truth.x).abs();
        let (one, many) = (of(1), of(40));
        assert!(off(&one) > 1.5e-3 && off(&many) < 5e-4, "{one:?} {many:?}");
        assert!(many.wider_px2.std_dev < one.wider_px2.std_dev / 3.0);
        // A frame that moved has no information about the others' v.
        let mut frames = vec![of_frame(truth.y); 40];
        frames[7] = of_frame(0.6);
        let found = OfFrames::fit(&frames, 0.0).unwrap();
        assert!((0..40).all(|i| found.alike[i] == (i != 7)));
        assert!((found.wider_px2.value - many.wider_px2.value).abs() < 1e-3, "{found:?}");
        assert!(OfFrames::fit(&[], 0.0).is_none());
        // A wide point spread lowers the information about both.
        let spread = OfFrames::fit(&frames, 1.0).unwrap();
        assert!(spread.wider_px2.std_dev > OF_POINT_SPREAD);
        assert!((spread.wider_px2.value - found.wider_px2.value).abs() < 1e-12);
        let added = (spread.ratio.std_dev.powi(2) - found.ratio.std_dev.powi(2)).sqrt();
        assert!(
            (added / found.ratio.value / (0.15 * OF_POINT_SPREAD) - 1.0).abs() < 0.2,
            "{added}"
        );
    }
}
