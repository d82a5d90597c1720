//! The light across a micro-image of a white target, and the outer radius from it.
//!
//! On the sensor the main lens's pupil, seen through the middle of a micro-lens, is a disc of radius
//! a, and the micro-lens blurs every point of it over a disc of radius b: the light of the micro-image
//! is the overlap of these discs, flat up to |a − b| and dark from a + b on. a = |m|/N and b = |qᵢ| of
//! Eq. (miradiusfnumber), so that the outer radius is the paper's radius of the micro-image.

use nalgebra::{Matrix2, Vector1, Vector2};

use crate::numerics::{Descent, LeastSquares, NormalEquations};
use crate::vignetting::{Obliquity, Overlap, Pixel, overlap, overlap_area};

/// Mean light at distances from the middle of micro-images of one type.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Profile {
    /// The outer half of the light.
    pub bins: Vec<Bin>,
    /// The brighter rest, where it is not clipped.
    pub bright: Vec<Bin>,
}

#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Bin {
    /// Mean distance, px.
    pub radius: f64,
    pub light: f64,
    /// Standard deviation of the mean.
    pub std_dev: f64,
    /// Light over what it would be at normal incidence, and how that changes outwards, px⁻¹.
    pub fall_off: [f64; 2],
    /// Mean square of the vectors from the micro-lens to here, px², and how it grows outwards, px.
    pub square: [f64; 2],
    /// Variance of these squares, px⁴.
    pub variance: f64,
}

/// The overlap of pupil and blur fitted to a profile.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Edge {
    /// a + b, px.
    pub outer: f64,
    /// |a − b|, px.
    pub inner: f64,
    /// Light in the middle, and of the background.
    pub amplitude: f64,
    pub background: f64,
    /// Standard deviation of `outer`, px.
    pub std_dev: f64,
}

/// Width of the bins, px.
pub(super) const BIN_PX: f64 = 0.125;
/// Part of the light in the middle that the overlap of two discs does not explain: oblique rays, pixels,
/// grids.
const MODEL_ERROR: f64 = 2e-3;
/// One bin in so many shows where a descent should start.
const COARSE: usize = 4;
/// How radii are followed down. Gauss-Newton steps shrink fast: after one of a millionth of a pixel
/// nothing is left to gain. Where much is clipped the valleys are long and bent, hence many small changes
/// of the damping.
const DESCENT: Descent = Descent { steps: 60, settled: 1e-6, factor: 5.0, damping: (1e-9, 1e6) };
/// Step of the numerical derivatives, px: the light is smooth over a pixel, and rounding errors of its
/// sums are 1e-12 of it.
const STEP_PX: f64 = 1e-4;
/// Starts that are followed down.
const DESCENTS: usize = 2;
/// Overlap of the discs that a pixel at distance r sees. The light there is `fall_off[0]` of that at normal incidence, and
/// changes by `fall_off[1]` outwards, px⁻¹.
pub(super) fn seen(r: f64, outer: f64, inner: f64, pixel: &Pixel, fall_off: [f64; 2]) -> f64 {
    let along = |&(x, weight): &(f64, f64)| {
        let square = (r + x).powi(2);
        let area =
            |&(y2, weight): &(f64, f64)| weight * overlap_area((square + y2).sqrt(), outer, inner);
        weight * (fall_off[0] + fall_off[1] * x) * pixel.across.iter().map(area).sum::<f64>()
    };
    pixel.along.iter().map(along).sum()
}

/// The law of oblique light at a bin, and how that changes outwards, px⁻¹.
fn fall_off_by(law: &Obliquity, bin: &Bin) -> [f64; 2] {
    let [square, growth] = bin.square;
    let [before, here, after] = [-1.0, 0.0, 1.0]
        .map(|x| law.mean_light((square + x * BIN_PX * growth).max(0.0), bin.variance));
    [here, (after - before) / (2.0 * BIN_PX)]
}

impl Profile {
    /// Whether an edge can be fitted to it.
    pub fn shows_an_edge(&self) -> bool {
        let furthest = self.bins.last().map_or(0.0, |bin| bin.radius);
        self.fit(furthest, &Pixel::default()).is_some()
    }

    /// This profile with the fall-off of oblique light: through a micro-lens with the blur radius `q_px`
    /// (with the sign that Eq. (radiusfinal) gives it), from a pupil of radius `pupil_px`.
    ///
    /// Where f < d the far side of the micro-lens lights the edge of the micro-image, at a steep angle;
    /// where f > d the near side does.
    pub fn oblique(&self, pupil_px: f64, q_px: f64, obliquity: &Obliquity) -> Self {
        let mut profile = self.clone();
        profile.set_angles(pupil_px, q_px, obliquity.half_pitch_px);
        for bin in &mut profile.bins {
            bin.fall_off = fall_off_by(obliquity, bin);
        }
        profile
    }

    /// Sets the angles at which light arrives, for discs as above.
    pub fn set_angles(&mut self, pupil_px: f64, q_px: f64, half_pitch_px: f64) {
        let q = q_px.abs().max(1e-6);
        for bin in &mut self.bins {
            let part = overlap(bin.radius / q, pupil_px / q);
            let part = part.unwrap_or(Overlap { mean: 1.0, along: 0.0, across: 0.0, area: 0.0 });
            let from_lens = bin.radius + part.mean * q_px.signum() * half_pitch_px;
            let [along, across] =
                [part.along, part.across].map(|of_half| (of_half * half_pitch_px / 2.0).powi(2));
            bin.square[0] = from_lens * from_lens + along + across;
            // As of a disc with these variances.
            bin.variance = 4.0 * from_lens * from_lens * along + along * along + across * across
                - 2.0 / 3.0 * along * across;
        }
        let last = self.bins.len().saturating_sub(1);
        for i in 0..self.bins.len() {
            let (before, after) = (&self.bins[i.saturating_sub(1)], &self.bins[(i + 1).min(last)]);
            let distance = (after.radius - before.radius).max(BIN_PX);
            self.bins[i].square[1] = (after.square[0] - before.square[0]) / distance;
        }
    }

    /// All of the light that is not clipped, up to a distance from the centre, px, from there outwards.
    pub fn whole(&self, reach_px: f64) -> Self {
        let all = self.bright.iter().chain(&self.bins);
        let mut bins: Vec<Bin> = all.copied().filter(|bin| bin.radius < reach_px).collect();
        bins.sort_by(|a, b| a.radius.total_cmp(&b.radius));
        Self { bins, bright: Vec::new() }
    }

    /// This profile of light that is some power of what was taken for it.
    pub fn to_the_power(&self, exponent: f64) -> Self {
        let mut raised = self.clone();
        let bins = || self.bins.iter().chain(&self.bright);
        let brightest = bins().map(|bin| bin.light).fold(f64::MIN_POSITIVE, f64::max);
        for bin in raised.bins.iter_mut().chain(&mut raised.bright) {
            let part = bin.light / brightest;
            bin.light = brightest * part.signum() * part.abs().powf(exponent);
        }
        raised
    }

    /// Weighted residuals for discs of radii a and b, px, with a fall-off at the angles that were set.
    pub fn residuals_of_discs(
        &self,
        [a, b]: [f64; 2],
        law: &Obliquity,
        pixel: &Pixel,
    ) -> Option<Vec<f64>> {
        let fall_off = |bin: &Bin| fall_off_by(law, bin);
        self.residuals_with(a + b, (a - b).abs(), pixel, fall_off).map(|(_, residuals)| residuals)
    }

    /// Fits the radii of the discs, the outer one up to 1.4 times `largest`, px; `None` if the profile
    /// does not show an edge.
    pub fn fit(&self, largest: f64, pixel: &Pixel) -> Option<Edge> {
        // Where much is clipped the sum of squares has several valleys: try starts all over first, on
        // some of the bins.
        let coarse =
            Self { bins: self.bins.iter().step_by(COARSE).copied().collect(), bright: Vec::new() };
        let mut starts: Vec<(f64, f64, f64)> = (9..=22)
            .map(|i| f64::from(i) * 0.05 * largest)
            .flat_map(|outer| [0.05, 0.25, 0.5, 0.75].map(|inner| (outer, inner * outer)))
            .filter_map(|(outer, inner)| {
                let (linear, residuals) = coarse.residuals(outer, inner, pixel)?;
                let sum = residuals.iter().map(|r| r * r).sum();
                (linear.x > 0.0).then_some((sum, outer, inner))
            })
            .collect();
        starts.sort_by(|a, b| a.0.total_cmp(&b.0));
        starts
            .into_iter()
            .take(DESCENTS)
            .filter_map(|(_, outer, inner)| self.descend(outer, inner, largest, pixel))
            .min_by(|a, b| a.1.total_cmp(&b.1))
            .map(|(edge, _)| edge)
    }

    /// Amplitude and background that fit best, and the weighted residuals.
    fn residuals(&self, outer: f64, inner: f64, pixel: &Pixel) -> Option<(Vector2<f64>, Vec<f64>)> {
        self.residuals_with(outer, inner, pixel, |bin| bin.fall_off)
    }

    fn residuals_with(
        &self,
        outer: f64,
        inner: f64,
        pixel: &Pixel,
        fall_off: impl Fn(&Bin) -> [f64; 2],
    ) -> Option<(Vector2<f64>, Vec<f64>)> {
        let brightest = self.bins.iter().map(|b| b.light).fold(0.0, f64::max);
        let weight = |bin: &Bin| 1.0 / bin.std_dev.hypot(MODEL_ERROR * brightest);
        let shape = |b: &Bin| seen(b.radius, outer, inner, pixel, fall_off(b));
        let shape: Vec<f64> = self.bins.iter().map(shape).collect();
        let mut equations = NormalEquations::<f64, 2, 1>::new();
        for (bin, &shape) in self.bins.iter().zip(&shape) {
            equations.add(&Vector2::new(shape, 1.0), &Vector1::new(bin.light), weight(bin).powi(2));
        }
        let linear = equations.solve()?;
        let residual =
            |(bin, shape): (&Bin, &f64)| (bin.light - linear.x * shape - linear.y) * weight(bin);
        Some((linear, self.bins.iter().zip(&shape).map(residual).collect()))
    }

    /// The edge that a descent from one start ends at, and its sum of squares.
    fn descend(&self, outer: f64, inner: f64, largest: f64, pixel: &Pixel) -> Option<(Edge, f64)> {
        let (trial, taken) = (Radii::default(), Radii::default());
        let mut squares = Squares { profile: self, pixel, largest, trial, taken };
        let start = squares.moved(&Vector2::new(outer, inner), &Vector2::zeros());
        let (place, sum) = DESCENT.from(start, &mut squares)?;
        let (normal, _) = squares.normal_equations()?;
        let freedom = (self.bins.len() as f64 - 4.0).max(1.0);
        let variance = normal.try_inverse().map_or(f64::INFINITY, |inverse| inverse[(0, 0)]);
        let linear = squares.taken.linear;
        (linear.x > 0.0).then_some((
            Edge {
                outer: place.x,
                inner: place.y,
                amplitude: linear.x,
                background: linear.y,
                std_dev: (variance * (sum / freedom).max(1.0)).sqrt(),
            },
            sum,
        ))
    }
}

/// The sum of squares of a profile over outer and inner radius; amplitude and background are those that
/// fit best.
struct Squares<'a> {
    profile: &'a Profile,
    pixel: &'a Pixel,
    largest: f64,
    trial: Radii,
    taken: Radii,
}

/// What belongs to two radii.
#[derive(Default)]
struct Radii {
    /// Outer and inner.
    place: Vector2<f64>,
    /// Amplitude and background.
    linear: Vector2<f64>,
    /// Weighted residuals.
    residuals: Vec<f64>,
}

impl LeastSquares<2> for Squares<'_> {
    type Point = Vector2<f64>;

    fn evaluate(&mut self, at: &Self::Point) -> Option<f64> {
        let (linear, residuals) = self.profile.residuals(at.x, at.y, self.pixel)?;
        let sum = residuals.iter().map(|r| r * r).sum();
        self.trial = Radii { place: *at, linear, residuals };
        Some(sum)
    }

    fn accept(&mut self) {
        std::mem::swap(&mut self.trial, &mut self.taken);
    }

    fn normal_equations(&mut self) -> Option<(Matrix2<f64>, Vector2<f64>)> {
        let Radii { place, residuals, .. } = &self.taken;
        let derivative = |step: Vector2<f64>| {
            let (x, y) = (place.x + step.x, place.y + step.y);
            let (_, moved) = self.profile.residuals(x, y, self.pixel)?;
            let change = moved.iter().zip(residuals).map(|(m, r)| (m - r) / STEP_PX);
            Some(change.collect::<Vec<f64>>())
        };
        let columns =
            [derivative(Vector2::new(STEP_PX, 0.0))?, derivative(Vector2::new(0.0, STEP_PX))?];
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let mut normal = Matrix2::from_fn(|i, j| dot(&columns[i], &columns[j]));
        let mut right = -Vector2::from_fn(|i, _| dot(&columns[i], residuals));
        // Where a step of both would take the inner radius from 0 to below, it stays and the outer one
        // moves alone: a step that is cut at 0 need not lead down, and the descent would end short of
        // the minimum.
        let inner_step = normal[(0, 0)] * right.y - normal[(0, 1)] * right.x;
        if place.y <= 0.0 && inner_step < 0.0 {
            (normal[(0, 1)], normal[(1, 0)], right.y) = (0.0, 0.0, 0.0);
        }
        Some((normal, right))
    }

    fn moved(&self, from: &Self::Point, step: &Vector2<f64>) -> Self::Point {
        let to = from + step;
        let outer = to.x.clamp(0.5, 1.4 * self.largest);
        Vector2::new(outer, to.y.clamp(0.0, 0.98 * outer))
    }

    fn distance(&self, from: &Self::Point, to: &Self::Point) -> f64 {
        (to - from).norm()
    }
}

#[cfg(test)]
mod tests {
    use super::super::stack::Stack;
    use super::*;

    fn drawn(outer: f64, inner: f64, amplitude: f64) -> Profile {
        let (mut stack, pixel) = (Stack::new(14.0, 0.0), Pixel::default());
        for i in 0..4000_i32 {
            let radius = 14.0 * (f64::from(i) + 0.5) / 4000.0;
            let light =
                (0.02 + amplitude * seen(radius, outer, inner, &pixel, [1.0, 0.0])).min(1.0);
            for _ in 0..8 {
                stack.add(radius, light);
            }
        }
        stack.profile()
    }

    /// An edge that is rounder than any overlap of discs draws the inner radius below 0.
    #[test]
    fn descents_that_end_at_an_inner_radius_of_0_agree() {
        let mut profile = drawn(7.0, 0.0, 6.0);
        for bin in &mut profile.bins {
            bin.light -= 0.05 * bin.light * (1.0 - bin.light);
        }
        let ends: Vec<Edge> = [(6.2, 0.3), (6.2, 1.5), (7.4, 5.0), (7.8, 2.0)]
            .iter()
            .filter_map(|&(outer, inner)| {
                Some(profile.descend(outer, inner, 12.0, &Pixel::default())?.0)
            })
            .collect();
        assert_eq!(ends.len(), 4);
        for end in &ends {
            assert!(end.inner == 0.0 && (end.outer - ends[0].outer).abs() < 1e-4, "{ends:?}");
        }
    }

    /// Against sums over a pixel's square and a normal spread, with light that falls off outwards.
    #[test]
    fn pixels_see_what_falls_into_them() {
        let fall_off = [0.8, -0.02];
        for (spread, outer, inner) in [(0.0, 10.0, 1.4), (0.25, 9.2, 4.0), (1.0, 6.8, 3.7)] {
            let pixel = Pixel::new(spread);
            for r in [0.6, 2.9, 4.5, 6.4, 8.1, 9.6] {
                let (mut sum, mut weights) = (0.0, 0.0);
                let places = || (-60..=60).map(|i| f64::from(i) / 12.0);
                let weight = |x: f64| {
                    if spread == 0.0 {
                        f64::from(u8::from(x.abs() < 0.46))
                    } else {
                        // A square and a normal spread, by its steps.
                        (-6..=6)
                            .map(|i| (x - f64::from(i) / 13.0).powi(2))
                            .map(|d2| (-d2 / 2.0 / spread).exp())
                            .sum()
                    }
                };
                for (x, y) in places().flat_map(|x| places().map(move |y| (x, y))) {
                    let weight = weight(x) * weight(y);
                    weights += weight;
                    sum += weight
                        * (fall_off[0] + fall_off[1] * x)
                        * overlap_area((r + x).hypot(y), outer, inner);
                }
                let (found, expected) = (seen(r, outer, inner, &pixel, fall_off), sum / weights);
                assert!(
                    (found - expected).abs() < 2e-3,
                    "{spread}, {r} px: {found} for {expected}"
                );
            }
        }
    }

    #[test]
    fn the_outer_radius_comes_back_at_any_exposure() {
        for amplitude in [0.3, 0.8, 1.5, 3.0, 6.0] {
            for (outer, inner) in [(11.66, 1.1), (8.4, 1.7), (6.8, 3.7), (10.0, 0.0)] {
                let edge = drawn(outer, inner, amplitude).fit(12.0, &Pixel::default()).unwrap();
                let off = (edge.outer - outer).abs();
                assert!(off < 0.02, "{outer}, {inner} px at {amplitude}: off by {off} px");
            }
        }
    }
}
