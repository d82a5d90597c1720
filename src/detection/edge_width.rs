//! How wide edges are, over what the blur of a corner makes them: what they say about the aperture ratio of the micro-lenses,
//! and about what makes edges wider beside blur.
//!
//! The blur radius of a corner is ρ = qᵢ + φ (1 − γ) Δc/2. White images show qᵢ, and the line of the corner its slope γ.
//! Openings that do not fill the distance between micro-lenses, φ < 1, blur less; a point spread, printed edges that are not
//! sharp and boards that move make all edges wider by the same variance v.

use nalgebra::{Matrix2, Vector2};

use crate::model::APERTURE_RATIO_MODEL;
use crate::numerics::median;
use crate::quantity::Estimate;

/// Information about a blur radius, or about ln φ, and v, near those that corners were fitted with, while their places and
/// levels are free; and that times the change.
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
    /// What the corners alone say of both, as much as their scatter allows.
    pub corners: EdgeWidth,
}

/// ln φ and v of all frames together.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct OfFrames {
    pub ratio: Estimate,
    /// v, px².
    pub wider_px2: Estimate,
    /// Which frames have that v: the others have moved.
    pub alike: Vec<bool>,
}

impl EdgeWidth {
    /// With this information, and that times the change.
    pub fn new(information: Matrix2<f64>, right: Vector2<f64>) -> Self {
        Self { information, right }
    }

    /// Whether all of it is a number.
    pub fn is_finite(&self) -> bool {
        self.information.iter().chain(&self.right).all(|x| x.is_finite())
    }

    /// The information about ln φ instead of a blur radius that grows with it by so much, px.
    pub fn of_log_ratio(self, radius_by_ratio_px: f64) -> Self {
        let by = Vector2::new(radius_by_ratio_px, 1.0);
        let scale = Matrix2::from_diagonal(&by);
        Self { information: scale * self.information * scale, right: self.right.component_mul(&by) }
    }

    /// The information about the quantities themselves, if it is about their changes from these values.
    pub fn about(self, at: &Vector2<f64>) -> Self {
        Self { right: self.right + self.information * at, ..self }
    }

    /// By how much the first quantity, found from this corner alone, changes with v.
    pub fn first_by_width(&self) -> f64 {
        -self.information[(0, 1)] / self.information[(0, 0)]
    }

    /// v with its variance if ln φ is known; `None` without information.
    fn of_width(&self, log_ratio: f64) -> Option<(f64, f64)> {
        let information = self.information[(1, 1)];
        let left = self.right.y - self.information[(0, 1)] * log_ratio;
        (information > 0.0).then(|| (left / information, 1.0 / information))
    }

    /// The information about ln φ if nothing is known about v.
    fn of_ratio_alone(&self) -> Self {
        let Self { information: n, right } = *self;
        let share = if n[(1, 1)] > 0.0 { n[(0, 1)] / n[(1, 1)] } else { 0.0 };
        Self {
            information: Matrix2::new(n[(0, 0)] - share * n[(0, 1)], 0.0, 0.0, 0.0),
            right: Vector2::new(right.x - share * right.y, 0.0),
        }
    }

    /// The change of the first quantity by this corner alone, with its variance, after `change` of both; `None` without
    /// information.
    pub fn of_first(&self, change: &Vector2<f64>) -> Option<(f64, f64)> {
        let information = self.information[(0, 0)];
        let left = self.right - self.information * change;
        (information > 0.0).then(|| (left.x / information, 1.0 / information))
    }
}

/// Corners this many times further than the typical one from all others are false, or the light of other things.
const OUTLIERS: f64 = 5.0;
/// How much the variances of edges in boards and in white images usually differ, px², and clearly, in that unit.
const AS_SHARP_PX2: f64 = 0.03;
const CLEARLY: f64 = 2.0;
/// Edges have the width that they were taken to have within this, px², or within so many standard deviations. (Lines that are
/// not known well yet make them wider.)
const SAME_PX2: f64 = 0.1;
const SIGNIFICANT: f64 = 3.0;
/// The board has moved in a frame whose edges are wider or narrower than those of the others by this, px², and by so many
/// standard deviations.
pub(super) const MOVED_PX2: f64 = 0.05;
pub(super) const MOVED: f64 = 5.0;
/// Rounds in which they are left out.
const ROUNDS: usize = 5;
/// Edges determine ln φ where its σ is below this.
const DETERMINED: f64 = 0.05;
/// How well the model of a corner tells v, as a part of the variance of the point spread: light at the rim of the pupil is
/// summed to the first order of the point spread over the radius of the pupil (`optics/rim.rs`). At 1 px², corners of
/// exact light are off by 0.005 px², at the rim by 0.04 px².
const OF_POINT_SPREAD: f64 = 0.05;

impl WidthChange {
    /// The change of ln φ with its σ, if edges determine it.
    pub fn log_ratio(&self) -> Option<(f64, f64)> {
        let std_dev = self.covariance[(0, 0)].sqrt();
        (std_dev < DETERMINED).then_some((self.change.x, std_dev))
    }

    /// Whether edges are wider or narrower than they were taken to be, by what matters and is no chance: print that is not
    /// sharp, motion, a point spread that white images show otherwise.
    pub fn edges_differ(&self) -> bool {
        let change = self.change.y.abs();
        change > SAME_PX2 && change > SIGNIFICANT * self.covariance[(1, 1)].sqrt()
    }

    /// By all corners together, of which edges are taken to be wider by `wider_px2` already; `None` if they do not determine
    /// it. The covariance is by their scatter.
    ///
    /// Where all corners have a similar blur they cannot tell both, see [`prior`].
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
            // In the standard deviations that each corner claims.
            let far = |one: &EdgeWidth| {
                one.of_first(&change).map_or(0.0, |(by, variance)| by.abs() / variance.sqrt())
            };
            let distances: Vec<f64> = all.iter().map(far).collect();
            // The median of |x| for a normal distribution.
            let typical = median(distances.iter().copied())? / 0.6745;
            kept = distances.iter().map(|far| *far <= OUTLIERS * typical.max(1.0)).collect();
            let excess = typical.powi(2).max(1.0);
            found =
                Some(Self { change, covariance: covariance * excess, corners: corners / excess });
        }
        found
    }
}

/// Edges of boards are as sharp as those of white images unless they clearly are not (a Cauchy distribution): the weight of
/// that, px⁻⁴, where they are wider by a variance.
fn prior(wider_px2: f64) -> f64 {
    1.0 / (AS_SHARP_PX2.powi(2) + (wider_px2 / CLEARLY).powi(2))
}

impl OfFrames {
    /// By what the corners of each frame say of ln φ and v, with this variance of the point spread, px²; `None` if they do not
    /// determine them. All boards have the same print and are seen by the same pixels, so they have one v, but for those
    /// that moved.
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
            // Those that the last solution is of stay.
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
        // Where blur and point spread look alike, one is as wrong as the other.
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

    /// Corners that cannot tell ln φ from v well: what is known of v beforehand counts once, however many frames there are.
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
        // A frame that moved says nothing of the others' v.
        let mut frames = vec![of_frame(truth.y); 40];
        frames[7] = of_frame(0.6);
        let found = OfFrames::fit(&frames, 0.0).unwrap();
        assert!((0..40).all(|i| found.alike[i] == (i != 7)));
        assert!((found.wider_px2.value - many.wider_px2.value).abs() < 1e-3, "{found:?}");
        assert!(OfFrames::fit(&[], 0.0).is_none());
        // A wide point spread says less of both.
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
