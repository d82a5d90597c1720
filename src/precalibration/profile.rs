//! The light across a micro-image of a white target, and the outer radius from it.
//!
//! On the sensor the main lens's pupil, seen through the middle of a micro-lens, is a disc of radius
//! a, and the micro-lens blurs every point of it over a disc of radius b: the light of the micro-image
//! is the overlap of these discs, flat up to |a − b| and dark from a + b on. a = |m|/N and b = |qᵢ| of
//! Eq. (miradiusfnumber), so that the outer radius is the paper's radius of the micro-image.

use nalgebra::{Matrix2, Vector1, Vector2};

use crate::numerics::{Descent, LeastSquares, NormalEquations};
use crate::optics::{RadialPixels, Seen, WhiteDiscs};

/// Mean light at distances from the middle of micro-images of one type.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Profile {
    /// The outer half of the light.
    pub bins: Vec<Bin>,
    /// The brighter rest, where it is not clipped.
    pub bright: Vec<Bin>,
    /// Light in the middle, clipped or not, where it is known; 0 otherwise.
    pub middle: f64,
}

#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Bin {
    /// Mean distance, px.
    pub radius: f64,
    pub light: f64,
    /// Standard deviation of the mean.
    pub std_dev: f64,
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
/// What the overlap of two discs does not explain, oblique rays, pixels, grids: a part of the brightest light that is fitted, and
/// one of the light in the middle. Where that is clipped, at 3.5 times full scale, |qᵢ| of simulated cameras with a point spread
/// of 1 px is 0.04 to 0.05 px too large, 2 σ with both.
const MODEL_ERROR: f64 = 2e-3;
const OF_MIDDLE: f64 = 1e-3;
/// One bin in so many shows where a descent should start.
const COARSE: usize = 4;
/// How radii are followed down. Gauss-Newton steps shrink fast: after one of a millionth of a pixel
/// nothing is left to gain. Where much is clipped the valleys are long and bent, hence many small changes
/// of the damping.
const DESCENT: Descent =
    Descent { steps: 60, settled: 1e-6, unseen: 0.0, factor: 5.0, damping: (1e-9, 1e6) };
/// Step of the numerical derivatives, px, px² or relative: light is smooth over a pixel, and rounding errors of its sums are
/// 1e-12 of it.
const STEP: f64 = 1e-4;
/// Starts that are followed down.
const DESCENTS: usize = 2;

/// Light this close to the edge of a neighbour may be the neighbour's, px; with a point spread, light that is nearer by so
/// many standard deviations of it.
const NEIGHBOUR_PX: f64 = 0.3;
const NEIGHBOUR_SPREADS: f64 = 2.5;

/// Distance from the centre up to which light is not that of neighbours, px, if the largest outer radius in the image is this and
/// the point spread has this standard deviation.
pub(super) fn own_light_px(pitch_px: f64, outer_px: f64, spread_px: f64) -> f64 {
    pitch_px - outer_px + NEIGHBOUR_PX - NEIGHBOUR_SPREADS * spread_px
}

/// What a profile is compared with: two discs as pixels see them, with light that falls off with the distance from the middle
/// as it does behind others of nearly their size.
struct Model<'a> {
    pixels: RadialPixels,
    fall_off: Option<&'a WhiteDiscs>,
}

impl Model<'_> {
    fn fall_off(&self, distance_px: f64) -> f64 {
        self.fall_off.map_or(1.0, |discs| discs.fall_off(distance_px))
    }

    /// The light of discs with these sum and difference of radii, px.
    fn light(&self, outer: f64, inner: f64) -> Seen {
        let discs = WhiteDiscs::plain(f64::midpoint(outer, inner), (outer - inner) / 2.0);
        let [light] = self.pixels.see(|t| [discs.light(t) * self.fall_off(t)]);
        light
    }
}

impl Profile {
    /// Whether an edge can be fitted to it.
    pub fn shows_an_edge(&self) -> bool {
        self.fit(self.furthest_px(), 0.0, None).is_some()
    }

    /// Distance of the outermost light, px.
    pub fn furthest_px(&self) -> f64 {
        self.bins.last().map_or(0.0, |bin| bin.radius)
    }

    /// All of the light that is not clipped, up to a distance from the centre, px, from there outwards.
    pub fn whole(&self, reach_px: f64) -> Self {
        let all = self.bright.iter().chain(&self.bins);
        let mut bins: Vec<Bin> = all.copied().filter(|bin| bin.radius < reach_px).collect();
        bins.sort_by(|a, b| a.radius.total_cmp(&b.radius));
        Self { bins, bright: Vec::new(), ..self.clone() }
    }

    /// The brightest light that is fitted.
    fn brightest(&self) -> f64 {
        self.bins.iter().map(|bin| bin.light).fold(0.0, f64::max)
    }

    /// Amplitude and background with which the light of discs comes nearest to a quantity of the bins, and the weighted
    /// residuals of that; `None` if they are not determined.
    pub fn left(
        &self,
        discs: &Seen,
        quantity: impl Fn(&Bin) -> f64,
    ) -> Option<(Vector2<f64>, Vec<f64>)> {
        let of_model = (MODEL_ERROR * self.brightest()).hypot(OF_MIDDLE * self.middle);
        let weight = |bin: &Bin| 1.0 / bin.std_dev.hypot(of_model);
        let shape: Vec<f64> = self.bins.iter().map(|bin| discs.at(bin.radius)).collect();
        let mut equations = NormalEquations::<f64, 2, 1>::new();
        for (bin, &shape) in self.bins.iter().zip(&shape) {
            let value = Vector1::new(quantity(bin));
            equations.add(&Vector2::new(shape, 1.0), &value, weight(bin).powi(2));
        }
        let linear = equations.solve()?;
        let residual = |(bin, shape): (&Bin, &f64)| {
            (quantity(bin) - linear.x * shape - linear.y) * weight(bin)
        };
        Some((linear, self.bins.iter().zip(&shape).map(residual).collect()))
    }

    /// The same of its light.
    pub fn residuals(&self, discs: &Seen) -> Option<(Vector2<f64>, Vec<f64>)> {
        self.left(discs, |bin| bin.light)
    }

    /// Derivatives of its residuals by a quantity that the light of discs has these derivatives by; amplitude and background
    /// follow.
    pub fn derivative(&self, discs: &Seen, residuals: &[f64], by: &Seen) -> Option<Vec<f64>> {
        let (_, moved) = self.residuals(&discs.plus(by, STEP))?;
        Some(by_step(&moved, residuals))
    }

    /// The same by the power of the samples that light is.
    pub fn derivative_by_exponent(&self, discs: &Seen) -> Option<Vec<f64>> {
        let brightest = self.brightest().max(f64::MIN_POSITIVE);
        let raised = |bin: &Bin| {
            let part = bin.light / brightest;
            bin.light * part.abs().max(f64::MIN_POSITIVE).ln()
        };
        self.left(discs, raised).map(|(_, residuals)| residuals)
    }

    /// Fits the radii of two discs to the light that pixels with this point spread see, px², the outer one up to 1.4 times
    /// `largest`, px; with the fall-off of others of nearly their size. `None` if the profile does not show an edge.
    pub fn fit(
        &self,
        largest: f64,
        point_spread_px2: f64,
        fall_off: Option<&WhiteDiscs>,
    ) -> Option<Edge> {
        let pixels = RadialPixels::new(point_spread_px2, self.furthest_px());
        let model = &Model { pixels, fall_off };
        // Where much is clipped the sum of squares has several valleys: try starts all over first, on
        // some of the bins.
        let bins = self.bins.iter().step_by(COARSE).copied().collect();
        let coarse = Self { bins, bright: Vec::new(), ..self.clone() };
        let mut starts: Vec<(f64, f64, f64)> = (9..=22)
            .map(|i| f64::from(i) * 0.05 * largest)
            .flat_map(|outer| [0.05, 0.25, 0.5, 0.75].map(|inner| (outer, inner * outer)))
            .filter_map(|(outer, inner)| {
                let (linear, residuals) = coarse.residuals(&model.light(outer, inner))?;
                let sum = residuals.iter().map(|r| r * r).sum();
                (linear.x > 0.0).then_some((sum, outer, inner))
            })
            .collect();
        starts.sort_by(|a, b| a.0.total_cmp(&b.0));
        starts
            .into_iter()
            .take(DESCENTS)
            .filter_map(|(_, outer, inner)| self.descend(outer, inner, largest, model))
            .min_by(|a, b| a.1.total_cmp(&b.1))
            .map(|(edge, _)| edge)
    }

    /// The edge that a descent from one start ends at, and its sum of squares.
    fn descend(&self, outer: f64, inner: f64, largest: f64, model: &Model) -> Option<(Edge, f64)> {
        let mut squares = Squares { profile: self, model, largest, trial: None, taken: None };
        let start = squares.moved(&Vector2::new(outer, inner), &Vector2::zeros());
        let (place, sum) = DESCENT.from(start, &mut squares)?;
        let (normal, _) = squares.normal_equations()?;
        let freedom = (self.bins.len() as f64 - 4.0).max(1.0);
        let variance = normal.try_inverse().map_or(f64::INFINITY, |inverse| inverse[(0, 0)]);
        let linear = squares.taken?.linear;
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
    model: &'a Model<'a>,
    largest: f64,
    trial: Option<Radii>,
    taken: Option<Radii>,
}

/// A derivative by a [`STEP`].
fn by_step(moved: &[f64], at: &[f64]) -> Vec<f64> {
    moved.iter().zip(at).map(|(moved, at)| (moved - at) / STEP).collect()
}

/// What belongs to two radii.
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
        let light = self.model.light(at.x, at.y);
        let (linear, residuals) = self.profile.residuals(&light)?;
        let sum = residuals.iter().map(|r| r * r).sum();
        self.trial = Some(Radii { place: *at, linear, residuals });
        Some(sum)
    }

    fn accept(&mut self) {
        std::mem::swap(&mut self.trial, &mut self.taken);
    }

    fn normal_equations(&mut self) -> Option<(Matrix2<f64>, Vector2<f64>)> {
        let Radii { place, residuals, .. } = self.taken.as_ref()?;
        // Forwards: radii of the same size are at the end of what is possible.
        let column = |outer: f64, inner: f64| {
            let moved = self.model.light(place.x + outer, place.y + inner);
            Some(by_step(&self.profile.residuals(&moved)?.1, residuals))
        };
        let columns = [column(STEP, 0.0)?, column(0.0, STEP)?];
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

// How samples are collected.

/// Fewest samples in a bin for a standard deviation worth having.
const FEWEST: f64 = 8.0;
/// Samples above this part of full scale may be clipped and are left out, and so are bins with more than
/// this part of them: fewer are hot pixels.
const CLIPPED: f64 = 0.97;
const HOT: f64 = 0.01;
/// Where noise is clipped at 0, bins with more than this part of their samples there are brighter than
/// their light, and left out. An image with a black level has none.
const BLACK: f64 = 0.02;
/// Rounding makes black brighter by less than this part of a grey level.
const ROUNDED: f64 = 0.1;
/// Only light up to this part of the brightest is fitted: the outer radius shows at the edge, across
/// which the effect of oblique rays changes little.
const OUTER_LIGHT: f64 = 0.5;

/// Collects samples into a profile.
#[derive(Debug)]
pub(super) struct RadialHistogram {
    bins: Vec<Sums>,
    /// The light of a sample of 0.
    floor: f64,
    /// The smallest light above it: a grey level, at most.
    level: f64,
}

/// Sums over the samples of a bin that are not clipped at white: their number, distances, light, its
/// square; the number of the others; and of those that may be clipped at black.
type Sums = [f64; 6];

impl RadialHistogram {
    /// For distances up to `reach`, px, of light that is clipped at `floor`.
    pub fn new(reach: f64, floor: f64) -> Self {
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a few pixels
        let bins = (reach / BIN_PX).ceil() as usize;
        Self { bins: vec![[0.0; 6]; bins], floor, level: f64::INFINITY }
    }

    #[inline]
    pub fn add(&mut self, radius: f64, light: f64) {
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a distance
        let bin = (radius / BIN_PX) as usize;
        let above = light - self.floor;
        if above > 0.0 && above < self.level {
            self.level = above;
        }
        if let Some(bin) = self.bins.get_mut(bin) {
            if light > CLIPPED {
                bin[4] += 1.0;
                return;
            }
            bin[0] += 1.0;
            bin[1] += radius;
            bin[2] += light;
            bin[3] += light * light;
            bin[5] += f64::from(u8::from(above <= 0.0));
        }
    }

    /// The profile, without what noise about black spoils unless no edge is left then.
    pub fn profile(&self) -> Profile {
        let without = self.noise_is_clipped().then(|| self.bins_with(BLACK));
        without.filter(Profile::shows_an_edge).unwrap_or_else(|| self.bins_with(1.0))
    }

    /// The bins with at most this part of their samples at black.
    fn bins_with(&self, most_black: f64) -> Profile {
        let bin = |&[count, radius, light, square, white, black]: &Sums| {
            let mean = light / count;
            let variance = (square / count - mean * mean).max(0.0);
            let hot = HOT * (count + white);
            (count >= FEWEST && white <= hot && black <= most_black * count).then(|| Bin {
                radius: radius / count,
                light: mean,
                std_dev: (variance / count).sqrt(),
            })
        };
        let bins: Vec<Bin> = self.bins.iter().filter_map(bin).collect();
        let clipped = self.bins.iter().any(|bin| bin[4] > HOT * (bin[0] + bin[4]));
        let brightest = bins.iter().map(|bin| bin.light).fold(0.0, f64::max);
        let limit = OUTER_LIGHT * if clipped { 1.0 } else { brightest };
        let (bins, bright) = bins.into_iter().partition(|bin| bin.light <= limit);
        Profile { bins, bright, ..Profile::default() }
    }

    /// Whether noise about black is clipped by enough to matter: the darkest bins are brighter than rounding makes them.
    fn noise_is_clipped(&self) -> bool {
        let filled = || self.bins.iter().filter(|bin| bin[0] >= FEWEST);
        let darkest = filled().map(|bin| bin[2] / bin[0]).fold(f64::INFINITY, f64::min);
        let clipped = filled().any(|bin| (BLACK..1.0 - BLACK).contains(&(bin[5] / bin[0])));
        clipped && darkest - self.floor > ROUNDED * self.level
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drawn(outer: f64, inner: f64, amplitude: f64) -> Profile {
        let mut histogram = RadialHistogram::new(14.0, 0.0);
        let seen =
            Model { pixels: RadialPixels::new(0.0, 14.0), fall_off: None }.light(outer, inner);
        for i in 0..4000_i32 {
            let radius = 14.0 * (f64::from(i) + 0.5) / 4000.0;
            let light = (0.02 + amplitude * seen.at(radius)).min(1.0);
            for _ in 0..8 {
                histogram.add(radius, light);
            }
        }
        histogram.profile()
    }

    /// An edge that is rounder than any overlap of discs draws the inner radius below 0.
    #[test]
    fn descents_that_end_at_an_inner_radius_of_0_agree() {
        let mut profile = drawn(7.0, 0.0, 6.0);
        for bin in &mut profile.bins {
            bin.light -= 0.05 * bin.light * (1.0 - bin.light);
        }
        let pixels = RadialPixels::new(0.0, profile.furthest_px());
        let model = Model { pixels, fall_off: None };
        let ends: Vec<Edge> = [(6.2, 0.3), (6.2, 1.5), (7.4, 5.0), (7.8, 2.0)]
            .iter()
            .filter_map(|&(outer, inner)| Some(profile.descend(outer, inner, 12.0, &model)?.0))
            .collect();
        assert_eq!(ends.len(), 4);
        for end in &ends {
            assert!(end.inner == 0.0 && (end.outer - ends[0].outer).abs() < 1e-4, "{ends:?}");
        }
    }

    /// Micro-images that touch, clipped, with a point spread of 1 px: neighbours light a third of the circle.
    #[test]
    fn light_of_neighbours_does_not_move_the_outer_radius() {
        const PITCH: f64 = 23.3;
        let (outer, inner, spread) = (11.6, 1.4, 1.0);
        let mut profile = drawn(outer, inner, 3.0);
        let pixels = RadialPixels::new(spread, PITCH);
        let seen = Model { pixels, fall_off: None }.light(outer, inner);
        for bin in profile.bins.iter_mut().chain(&mut profile.bright) {
            bin.light = 0.02 + 3.0 * (seen.at(bin.radius) + seen.at(PITCH - bin.radius) / 3.0);
        }
        let off = |reach: f64| {
            (profile.whole(reach).fit(12.0, spread, None).unwrap().outer - outer).abs()
        };
        let (own, all) = (off(own_light_px(PITCH, outer, 1.0)), off(f64::INFINITY));
        assert!(own < 0.05 && all > 0.2, "off by {own} px, and by {all} px with all light");
    }

    #[test]
    fn the_outer_radius_comes_back_at_any_exposure() {
        for amplitude in [0.3, 0.8, 1.5, 3.0, 6.0] {
            for (outer, inner) in [(11.66, 1.1), (8.4, 1.7), (6.8, 3.7), (10.0, 0.0)] {
                let edge = drawn(outer, inner, amplitude).fit(12.0, 0.0, None).unwrap();
                let off = (edge.outer - outer).abs();
                assert!(off < 0.02, "{outer}, {inner} px at {amplitude}: off by {off} px");
            }
        }
    }
}
