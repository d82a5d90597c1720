//! Light across a micro-image of a white target, and the outer radius from it.
//!
//! Seen through the middle of a micro-lens, the pupil of the main lens is a disc of radius a on the sensor. The
//! micro-lens blurs each of its points over a disc of radius b. The light of the micro-image is the overlap of these
//! discs: constant up to |a − b| and 0 from a + b on. a = |m|/N and b = |qᵢ| of Eq. (miradiusfnumber), so the outer
//! radius is the micro-image radius of the paper.

use nalgebra::{Matrix2, Vector1, Vector2};

use crate::model::Opening;
use crate::numerics::{Descent, LeastSquares, NormalEquations};
use crate::optics::{RadialPixels, Seen, WhiteDiscs};

/// Mean light by distance from the middle of micro-images of one type.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Profile {
    /// Bins of the outer half of the light.
    pub bins: Vec<Bin>,
    /// Brighter bins that are not clipped.
    pub bright: Vec<Bin>,
    /// Light in the middle, clipped or not, if it is known; otherwise 0.
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

/// Overlap of pupil and blur, fitted to a profile.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Edge {
    /// Outer radius a + b, px.
    pub outer: f64,
    /// Inner radius |a − b|, px.
    pub inner: f64,
    /// Light in the middle, and light of the background.
    pub amplitude: f64,
    pub background: f64,
    /// Standard deviation of `outer`, px.
    pub std_dev: f64,
}

/// Width of the bins, px.
pub(super) const BIN_PX: f64 = 0.125;
/// Model error of the overlap of two discs (oblique rays, pixels, grids), as fractions of the brightest fitted light
/// and of the light in the middle. If the middle is clipped, at 3.5 times full scale, |qᵢ| of simulated cameras with a
/// point spread of 1 px is 0.04 to 0.05 px too large, 2 σ with both.
const MODEL_ERROR: f64 = 2e-3;
const OF_MIDDLE: f64 = 1e-3;
/// Number of bins that suffice to select the starts of a descent. With a few bins there are discs that fit them exactly but
/// light only one of them, from which no descent leads anywhere.
const COARSE: usize = 24;
/// Descent of the radii. Gauss-Newton steps shrink fast: after a step of a millionth of a pixel nothing is left to
/// gain. If much is clipped, the valleys are long and bent, and need many small changes of the damping.
const DESCENT: Descent =
    Descent { steps: 60, settled: 1e-6, unseen: 0.0, factor: 5.0, damping: (1e-9, 1e6) };
/// Step of the numerical derivatives, px, px² or relative. Light is smooth over a pixel, and the rounding errors of its
/// sums are 1e-12 of it.
const STEP: f64 = 1e-4;
/// Number of starts that are followed down.
const DESCENTS: usize = 2;

/// Distance from the edge of a neighbour towards its middle up to which its light is negligible, px. A point spread
/// shortens this distance by this many of its standard deviations.
const NEIGHBOUR_PX: f64 = 0.3;
const NEIGHBOUR_SPREADS: f64 = 2.5;

/// Returns the distance from the centre up to which light is not from neighbours, px. `outer_px` is the largest outer
/// radius in the image, `spread_px` the standard deviation of the point spread.
pub(super) fn own_light_px(pitch_px: f64, outer_px: f64, spread_px: f64) -> f64 {
    pitch_px - outer_px + NEIGHBOUR_PX - NEIGHBOUR_SPREADS * spread_px
}

/// Model of a profile: two discs as pixels see them. Their light falls off with the distance from the middle like the
/// light of `fall_off`, which are discs of nearly the same size.
struct Model<'a> {
    pixels: RadialPixels,
    opening: Opening,
    fall_off: Option<&'a WhiteDiscs>,
}

impl Model<'_> {
    fn fall_off(&self, distance_px: f64) -> f64 {
        self.fall_off.map_or(1.0, |discs| discs.fall_off(distance_px))
    }

    /// Computes the light of two discs from the sum and the difference of their radii, px.
    fn light(&self, outer: f64, inner: f64) -> Seen {
        let plain = WhiteDiscs::plain(f64::midpoint(outer, inner), (outer - inner) / 2.0);
        let discs = WhiteDiscs { opening: self.opening, ..plain };
        let [light] = self.pixels.see(|t| [discs.light(t) * self.fall_off(t)]);
        light
    }
}

impl Profile {
    /// Returns true if the profile determines an edge, whose outer radius is at most 1.4 times `largest`, px.
    fn determines_an_edge(&self, largest: f64) -> bool {
        self.bins.len() >= FEWEST_BINS
            && self
                .fit(largest, 0.0, Opening::Disc, None)
                .is_some_and(|edge| edge.std_dev < DETERMINED_PX)
    }

    /// Returns the distance of the outermost light, px.
    pub fn furthest_px(&self) -> f64 {
        self.bins.last().map_or(0.0, |bin| bin.radius)
    }

    /// Returns all light that is not clipped and nearer to the centre than `reach_px`, from the centre outwards.
    pub fn whole(&self, reach_px: f64) -> Self {
        let all = self.bright.iter().chain(&self.bins);
        let mut bins: Vec<Bin> = all.copied().filter(|bin| bin.radius < reach_px).collect();
        bins.sort_by(|a, b| a.radius.total_cmp(&b.radius));
        Self { bins, bright: Vec::new(), ..self.clone() }
    }

    /// Returns the brightest light that is fitted.
    fn brightest(&self) -> f64 {
        self.bins.iter().map(|bin| bin.light).fold(0.0, f64::max)
    }

    /// Fits amplitude and background of the light of discs to a quantity of the bins. Returns both and the weighted
    /// residuals; `None` if they are not determined.
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

    /// Applies [`Profile::left`] to the light of the bins.
    pub fn residuals(&self, discs: &Seen) -> Option<(Vector2<f64>, Vec<f64>)> {
        self.left(discs, |bin| bin.light)
    }

    /// Computes the derivatives of the residuals by a quantity. `by` are the derivatives of the light of the discs by
    /// this quantity. Amplitude and background follow.
    pub fn derivative(&self, discs: &Seen, residuals: &[f64], by: &Seen) -> Option<Vec<f64>> {
        let (_, moved) = self.residuals(&discs.plus(by, STEP))?;
        Some(by_step(&moved, residuals))
    }

    /// Computes the derivatives of the residuals by the power of the samples to which light is proportional.
    pub fn derivative_by_exponent(&self, discs: &Seen) -> Option<Vec<f64>> {
        let brightest = self.brightest().max(f64::MIN_POSITIVE);
        let raised = |bin: &Bin| {
            let part = bin.light / brightest;
            bin.light * part.abs().max(f64::MIN_POSITIVE).ln()
        };
        self.left(discs, raised).map(|(_, residuals)| residuals)
    }

    /// Fits the radii of pupil and opening to the light. Pixels have this point spread, px², and the outer radius is at most
    /// 1.4 times `largest`, px. The light falls off like `fall_off`, discs of nearly the same size. Returns `None` if
    /// the profile does not show an edge.
    pub fn fit(
        &self,
        largest: f64,
        point_spread_px2: f64,
        opening: Opening,
        fall_off: Option<&WhiteDiscs>,
    ) -> Option<Edge> {
        let pixels = RadialPixels::new(point_spread_px2, self.furthest_px());
        let model = &Model { pixels, opening, fall_off };
        // If much is clipped, the sum of squares has several valleys. So starts all over are tried first, on some of
        // the bins.
        let step = (self.bins.len() / COARSE).max(1);
        let bins = self.bins.iter().step_by(step).copied().collect();
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

    /// Returns the edge at the end of the descent from one start, and its sum of squares.
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

/// Sum of squares of a profile as a function of outer and inner radius. Amplitude and background are fitted.
struct Squares<'a> {
    profile: &'a Profile,
    model: &'a Model<'a>,
    largest: f64,
    trial: Option<Radii>,
    taken: Option<Radii>,
}

/// Computes a derivative from the change by a [`STEP`].
fn by_step(moved: &[f64], at: &[f64]) -> Vec<f64> {
    moved.iter().zip(at).map(|(moved, at)| (moved - at) / STEP).collect()
}

/// State of the fit at two radii.
struct Radii {
    /// Outer and inner radius.
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
        // Forward differences, since an inner radius of 0 is a bound.
        let column = |outer: f64, inner: f64| {
            let moved = self.model.light(place.x + outer, place.y + inner);
            Some(by_step(&self.profile.residuals(&moved)?.1, residuals))
        };
        let columns = [column(STEP, 0.0)?, column(0.0, STEP)?];
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let mut normal = Matrix2::from_fn(|i, j| dot(&columns[i], &columns[j]));
        let mut right = -Vector2::from_fn(|i, _| dot(&columns[i], residuals));
        // A step that would take the inner radius below 0 is repeated with the inner radius held: a step that is cut at
        // 0 need not lead down, and the descent would end short of the minimum.
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

// Collection of samples.

/// Fewest samples in a bin for a useful standard deviation.
const FEWEST: f64 = 8.0;
/// Fraction of full scale above which samples may be clipped and are left out. Bins with more than the fraction `HOT`
/// of them are left out too; fewer are hot pixels.
const CLIPPED: f64 = 0.97;
const HOT: f64 = 0.01;
/// Fraction of the samples of a bin at 0 above which the bin is left out if noise is clipped at 0: its mean is then
/// brighter than its light. An image with a black level has no such bins.
const BLACK: f64 = 0.02;
/// Fewest bins that determine an edge, which has four unknowns, and largest standard deviation of its radius, px.
const FEWEST_BINS: usize = 8;
const DETERMINED_PX: f64 = 0.3;
/// Largest increase of black by rounding, in grey levels.
const ROUNDED: f64 = 0.1;
/// Fraction of the brightest light (of full scale if light is clipped) up to which light is fitted. The outer radius
/// shows at the edge, across which the effect of oblique rays changes little.
const OUTER_LIGHT: f64 = 0.5;

/// Histogram that collects samples into a profile.
#[derive(Debug)]
pub(super) struct RadialHistogram {
    bins: Vec<Sums>,
    /// Light of a sample of 0.
    floor: f64,
    /// Smallest light above the floor: at most a grey level.
    level: f64,
}

/// Sums over the samples of a bin that are not clipped at white: number, distances, light, squared light; then the
/// number of clipped samples, and the number of samples that may be clipped at black.
type Sums = [f64; 6];

impl RadialHistogram {
    /// Creates a histogram for distances up to `reach`, px, and light that is clipped at `floor`.
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

    /// Returns the profile without bins that noise at black spoils, unless the rest determines no edge.
    pub fn profile(&self) -> Profile {
        let reach = self.bins.len() as f64 * BIN_PX;
        let without = self.noise_is_clipped().then(|| self.bins_with(BLACK));
        without
            .filter(|profile| profile.determines_an_edge(reach))
            .unwrap_or_else(|| self.bins_with(1.0))
    }

    /// Returns the bins with at most this fraction of their samples at black.
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

    /// Returns true if noise at black is clipped by enough to matter: the darkest bins are brighter than rounding makes
    /// them.
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
            Model { pixels: RadialPixels::new(0.0, 14.0), opening: Opening::Disc, fall_off: None }
                .light(outer, inner);
        for i in 0..4000_i32 {
            let radius = 14.0 * (f64::from(i) + 0.5) / 4000.0;
            let light = (0.02 + amplitude * seen.at(radius)).min(1.0);
            for _ in 0..8 {
                histogram.add(radius, light);
            }
        }
        histogram.profile()
    }

    /// An edge that is rounder than any overlap of discs pulls the inner radius below 0.
    #[test]
    fn descents_that_end_at_an_inner_radius_of_0_agree() {
        let mut profile = drawn(7.0, 0.0, 6.0);
        for bin in &mut profile.bins {
            bin.light -= 0.05 * bin.light * (1.0 - bin.light);
        }
        let pixels = RadialPixels::new(0.0, profile.furthest_px());
        let model = Model { pixels, opening: Opening::Disc, fall_off: None };
        let ends: Vec<Edge> = [(6.2, 0.3), (6.2, 1.5), (7.4, 5.0), (7.8, 2.0)]
            .iter()
            .filter_map(|&(outer, inner)| Some(profile.descend(outer, inner, 12.0, &model)?.0))
            .collect();
        assert_eq!(ends.len(), 4);
        for end in &ends {
            assert!(end.inner == 0.0 && (end.outer - ends[0].outer).abs() < 1e-4, "{ends:?}");
        }
    }

    /// Clipped micro-images that touch, with a point spread of 1 px: neighbours light a third of the circle.
    #[test]
    fn light_of_neighbours_does_not_move_the_outer_radius() {
        const PITCH: f64 = 23.3;
        let (outer, inner, spread) = (11.6, 1.4, 1.0);
        let mut profile = drawn(outer, inner, 3.0);
        let pixels = RadialPixels::new(spread, PITCH);
        let seen = Model { pixels, opening: Opening::Disc, fall_off: None }.light(outer, inner);
        for bin in profile.bins.iter_mut().chain(&mut profile.bright) {
            bin.light = 0.02 + 3.0 * (seen.at(bin.radius) + seen.at(PITCH - bin.radius) / 3.0);
        }
        let off = |reach: f64| {
            (profile.whole(reach).fit(12.0, spread, Opening::Disc, None).unwrap().outer - outer)
                .abs()
        };
        let (own, all) = (off(own_light_px(PITCH, outer, 1.0)), off(f64::INFINITY));
        assert!(own < 0.05 && all > 0.2, "off by {own} px, and by {all} px with all light");
    }

    #[test]
    fn the_outer_radius_comes_back_at_any_exposure() {
        for amplitude in [0.3, 0.8, 1.5, 3.0, 6.0] {
            for (outer, inner) in [(11.66, 1.1), (8.4, 1.7), (6.8, 3.7), (10.0, 0.0)] {
                let edge =
                    drawn(outer, inner, amplitude).fit(12.0, 0.0, Opening::Disc, None).unwrap();
                let off = (edge.outer - outer).abs();
                assert!(off < 0.02, "{outer}, {inner} px at {amplitude}: off by {off} px");
            }
        }
    }

    /// Checks edges of which eight bins are clean. Discs that light one of two of these bins fit the two exactly.
    #[test]
    fn starts_are_selected_on_more_than_a_few_bins() {
        for (largest, outer, inner) in [(7.8, 9.0, 4.0), (7.8, 10.0, 3.0), (12.1, 9.0, 5.5)] {
            let pixels = RadialPixels::new(0.0, 14.0);
            let seen = Model { pixels, opening: Opening::Disc, fall_off: None }.light(outer, inner);
            let amplitude = 0.47 / seen.at(6.94);
            let bin = |i: u32| {
                let radius = 6.94 + BIN_PX * f64::from(i);
                Bin { radius, light: 0.02 + amplitude * seen.at(radius), std_dev: 0.003 }
            };
            let profile = Profile { bins: (0..8).map(bin).collect(), ..Profile::default() };
            let edge = profile.fit(largest, 0.0, Opening::Disc, None).unwrap();
            assert!((edge.outer - outer).abs() < 1e-6, "{edge:?}");
        }
    }

    /// Checks light with so much noise that hardly a pixel of the edge is above black in all micro-images.
    #[test]
    fn noise_at_black_leaves_an_edge() {
        let mut histogram = RadialHistogram::new(12.1, 0.0);
        let seen =
            Model { pixels: RadialPixels::new(0.0, 12.1), opening: Opening::Disc, fall_off: None }
                .light(6.3, 2.5);
        let mut random = 1_u32;
        for i in 0..40_000_i32 {
            let radius = 12.1 * (f64::from(i % 4000) + 0.5) / 4000.0;
            let noise: f64 = (0..12)
                .map(|_| {
                    random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                    f64::from(random >> 8) / f64::from(1 << 24) - 0.5
                })
                .sum();
            let light = (3.0 * seen.at(radius) + 0.12 * noise).clamp(0.0, 1.0);
            histogram.add(radius, (light * 255.0).round() / 255.0);
        }
        let clean = histogram.bins_with(BLACK).bins.len();
        let edge = histogram.profile().fit(12.1, 0.0, Opening::Disc, None).unwrap();
        assert!(clean < FEWEST_BINS, "{clean} bins");
        assert!((edge.outer - 6.3).abs() < 0.6, "{edge:?}");
    }
}
