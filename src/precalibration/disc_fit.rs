//! The descent to the discs of [`super::discs`].

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::discs::{Discs, Known, with_model_error};
use super::fall_off::WITHIN;
use super::profile::{Profile, own_light_px};
use super::seen::{Angles, Seen};
use crate::model::PointSpread;
use crate::vignetting::{Obliquity, Pixel};

/// c before anything is measured, and its standard deviation: between a thin lens and a double Gauss.
const SINE: (f64, f64) = (0.7, 0.7);
/// How well discs of even light can tell H, as a part of that of cos⁴. H bends the light by a hundredth, so that errors of
/// the model by a thousandth show: in data sets of simulated cameras H is 3 to 22 % too small.
const WITHIN_MODEL: f64 = 0.12;
/// The relative error that f-numbers are taken to have unless white images show another, and how much that
/// counts: with five of them hardly at all, with two it is all there is.
const F_NUMBERS: (f64, f64) = (0.02, 0.02);
/// What is known of the variance of the point spread beforehand: no pixels and micro-lenses are ideal, px².
const SPREAD: (f64, f64) = (0.1, 0.3);
/// How well discs tell it, px²: edges are as wide as the model of oblique light and of the pixels makes them.
const SPREAD_MODEL: f64 = 0.006;
/// How well they tell |qᵢ|, px: openings narrower than the pitch change the angles of the light a little, and they are not known
/// yet. In 14 data sets of `mini` with fill factors from 0.85 to 1, |qᵢ| is off by 0.000 to 0.007 px.
const BLUR_MODEL: f64 = 0.003;
/// Rounds of the descent; the error of the f-numbers follows in each.
const ROUNDS: usize = 16;
/// It is at its end where a round changes the sum of squares, and the error of the f-numbers relatively, by less.
const SETTLED: f64 = 1e-3;
/// Steps of the numerical derivatives, px and px²; of H, relative.
const STEP: f64 = 1e-4;
/// Where all blurs are smaller, edges are as pixels make them, px.
const RESOLVED_PX: f64 = 1.0;
/// Weight of what is held, larger than that of any light.
const HELD: f64 = 1e15;
/// Least radius of a disc, px.
const LEAST_PX: f64 = 0.05;

/// What a profile depends on: both radii, H and the point spread.
const OF_LIGHT: usize = 4;
/// The same without the point spread, which is in what pixels see.
const BESIDE_SEEN: usize = OF_LIGHT - 1;

/// The radii, H over that of cos⁴, the variance of the point spread, |m| and c, in one vector.
pub(super) struct Fit<'a> {
    known: &'a Known,
    lights: Vec<Light>,
    /// a, b, H, point spread, |m|, c.
    at: DVector<f64>,
    f_number_error: f64,
}

/// The light of the micro-images of one type in one white image.
struct Light {
    white: usize,
    lens_type: usize,
    profile: Profile,
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// A derivative by a [`STEP`].
fn by_step(moved: &[f64], residuals: &[f64]) -> Vec<f64> {
    moved.iter().zip(residuals).map(|(moved, residual)| (moved - residual) / STEP).collect()
}

impl<'a> Fit<'a> {
    /// At where the fit begins.
    pub fn new(profiles: &[Vec<&Profile>], known: &'a Known) -> Self {
        let pupils = known.f_numbers.iter().map(|n| known.m_px / n);
        let blurs = known.q_px.iter().map(|q| q.abs().max(LEAST_PX));
        let at = pupils.chain(blurs).chain([known.within, SPREAD.0, known.m_px, SINE.0]);
        let at = DVector::from_vec(at.collect());
        let mut fit = Self { known, lights: Vec::new(), at, f_number_error: F_NUMBERS.0 };
        fit.take_light(profiles, 0.0);
        fit
    }

    /// Takes the light that is not of neighbours with this point spread, px.
    pub fn take_light(&mut self, profiles: &[Vec<&Profile>], spread_px: f64) {
        let (known, whites) = (self.known, self.whites());
        let widest = self.at.rows(whites, known.q_px.len()).max();
        let lights = profiles.iter().enumerate().flat_map(|(white, profiles)| {
            let reach = own_light_px(known.pitch_px, self.at[white] + widest, spread_px);
            profiles.iter().enumerate().map(move |(lens_type, profile)| Light {
                white,
                lens_type,
                profile: profile.whole(reach),
            })
        });
        self.lights = lights.collect();
        self.light_at_angles();
        let seen = self.seen(0.0);
        let middle = |light: &Light| {
            let (discs, law) = self.discs_of(light, [0.0; BESIDE_SEEN]);
            light.profile.light_in_the_middle(discs, &law, &seen)
        };
        let middles: Vec<f64> = self.lights.iter().map(middle).collect();
        let lights = self.lights.iter_mut().zip(middles);
        lights.for_each(|(light, middle)| light.profile.middle = middle);
    }

    /// Follows the discs down; `None` if the light does not determine them.
    pub fn descend(&mut self) -> Option<Discs> {
        let mut damping = 1e-6;
        let mut system = self.system()?;
        for _ in 0..ROUNDS {
            let step = self.step(&system, damping)?;
            let cost = self.cost()?;
            let (before, f_number_error) = (self.at.clone(), self.f_number_error);
            self.at = self.bounded(&before + step);
            if let Some(moved) = self.cost().filter(|moved| *moved <= cost) {
                damping = (damping / 10.0_f64).max(1e-9);
                self.light_at_angles();
                system = self.system()?;
                self.f_number_error = self.expected_error(&system.0)?;
                system = self.system()?;
                let change = (self.f_number_error / f_number_error - 1.0).abs();
                if cost - moved < SETTLED && change < SETTLED {
                    break;
                }
            } else {
                self.at = before;
                damping = (damping * 10.0).max(1e-6);
            }
        }
        self.discs(&system.0)
    }

    /// A damped step. Variances of point spreads end at 0, and all else moves as it does then.
    fn step(
        &self,
        (normal, right): &(DMatrix<f64>, DVector<f64>),
        damping: f64,
    ) -> Option<DVector<f64>> {
        let mut damped = normal + DMatrix::from_diagonal(&(normal.diagonal() * damping));
        let step = damped.clone().cholesky()?.solve(right);
        let [_, spread] = self.of_all();
        let to_zero = -self.at[spread];
        if step[spread] >= to_zero {
            return Some(step);
        }
        let mut right = right - damped.column(spread) * to_zero;
        damped.row_mut(spread).fill(0.0);
        damped.column_mut(spread).fill(0.0);
        (damped[(spread, spread)], right[spread]) = (1.0, to_zero);
        Some(damped.cholesky()?.solve(&right))
    }

    /// Whether the descent led somewhere.
    pub fn is_finite(&self) -> bool {
        self.at.iter().all(|x| x.is_finite())
    }

    /// Number of white images.
    fn whites(&self) -> usize {
        self.known.f_numbers.len()
    }

    /// Index of H, which all light depends on, and that of the point spread, likewise.
    fn of_all(&self) -> [usize; 2] {
        let first = self.whites() + self.known.q_px.len();
        [first, first + 1]
    }

    /// Indices of |m| and c.
    fn law(&self) -> [usize; 2] {
        self.of_all().map(|i| i + 2)
    }

    /// Sets the angles of the light, which change little with the radii.
    fn light_at_angles(&mut self) {
        let (whites, at, known) = (self.whites(), &self.at, self.known);
        self.lights.par_iter_mut().for_each(|light| {
            let (a, b) = (at[light.white], at[whites + light.lens_type]);
            let q = b * known.q_px[light.lens_type].signum();
            light.profile.angles = Angles::new(a, q, known.pitch_px / 2.0);
        });
    }

    /// Indices of what one profile depends on: its radii, H and the point spread.
    fn places(&self, light: &Light) -> [usize; OF_LIGHT] {
        let [within, spread] = self.of_all();
        [light.white, self.whites() + light.lens_type, within, spread]
    }

    /// What pixels see with the point spread, changed a little.
    fn seen(&self, by: f64) -> Seen {
        let [_, spread] = self.of_all();
        let furthest = self.lights.iter().map(|light| light.profile.furthest_px());
        Seen::new(&Pixel::new(self.at[spread] + by), furthest.fold(0.0, f64::max))
    }

    /// Weighted residuals of one profile.
    fn residuals(&self, light: &Light, seen: &Seen) -> Option<Vec<f64>> {
        self.residuals_of(light, &light.profile, [0.0; BESIDE_SEEN], seen)
    }

    /// Derivatives of weighted residuals by what one profile depends on. `seen` is what pixels see, and with a point spread
    /// that is larger by [`STEP`].
    fn derivatives(
        &self,
        light: &Light,
        residuals: &[f64],
        seen: [&Seen; 2],
    ) -> Option<[Vec<f64>; OF_LIGHT]> {
        let mut columns: [Vec<f64>; OF_LIGHT] = Default::default();
        for (i, column) in columns.iter_mut().enumerate() {
            let mut by = [0.0; BESIDE_SEEN];
            by.iter_mut().skip(i).take(1).for_each(|by| *by = STEP);
            let seen = seen[usize::from(i == BESIDE_SEEN)];
            let moved = self.residuals_of(light, &light.profile, by, seen)?;
            *column = by_step(&moved, residuals);
        }
        Some(columns)
    }

    /// The same of another profile in its place, with radii and H changed a little.
    fn residuals_of(
        &self,
        light: &Light,
        profile: &Profile,
        by: [f64; BESIDE_SEEN],
        seen: &Seen,
    ) -> Option<Vec<f64>> {
        let (discs, law) = self.discs_of(light, by);
        profile.residuals_of_discs(discs, &law, seen)
    }

    /// Both radii of one profile and the law of its light, changed a little.
    fn discs_of(&self, light: &Light, by: [f64; BESIDE_SEEN]) -> ([f64; 2], Obliquity) {
        let places = self.places(light);
        let [a, b, within] = std::array::from_fn(|i| self.at[places[i]] + by[i]);
        let Known { mla_to_sensor_px, pitch_px, .. } = self.known;
        let within = within * self.known.cos4_per_px2();
        let law = Obliquity::in_the_middle(within, *mla_to_sensor_px, pitch_px / 2.0);
        ([a, b], law)
    }

    /// a by the law, and its derivatives by |m| and c.
    fn pupil(&self, f_number: f64) -> [f64; 3] {
        let [m, c] = self.law();
        let (paraxial, sine) = (self.at[m] / f_number, self.at[c]);
        let square = (paraxial / self.known.mla_to_sensor_px).powi(2) / 2.0;
        [
            paraxial * (1.0 + sine * square),
            (1.0 + 3.0 * sine * square) / f_number,
            paraxial * square,
        ]
    }

    /// Residuals of the law and of what is known beforehand over their standard deviations, with their
    /// derivatives.
    fn expectations(&self) -> Vec<(f64, Vec<(usize, f64)>)> {
        let ([h, spread], [m, c]) = (self.of_all(), self.law());
        let of_white = |(i, f_number): (usize, &f64)| {
            let [pupil, by_m, by_c] = self.pupil(*f_number);
            let scale = 1.0 / (self.f_number_error * self.known.m_px / f_number);
            let row = vec![(i, scale), (m, -by_m * scale), (c, -by_c * scale)];
            ((self.at[i] - pupil) * scale, row)
        };
        let mut all: Vec<_> = self.known.f_numbers.iter().enumerate().map(of_white).collect();
        let known = self.known.within;
        let within = (known, WITHIN * known.abs().max(1.0));
        for (i, (value, std_dev)) in [(h, within), (spread, SPREAD), (c, SINE)] {
            all.push(((self.at[i] - value) / std_dev, vec![(i, 1.0 / std_dev)]));
        }
        all
    }

    /// The power of the samples that light is, less 1, and its σ: what one step of the fit finds where
    /// that is free too. `None` where pixels hide it.
    fn exponent(&self) -> Option<(f64, f64)> {
        let blurs = self.at.rows(self.whites(), self.known.q_px.len());
        if blurs.max() < RESOLVED_PX {
            return None;
        }
        let (normal, right) = self.system()?;
        let size = self.at.len();
        let (mut normal, mut right) =
            (normal.resize(size + 1, size + 1, 0.0), right.resize_vertically(size + 1, 0.0));
        let (mut squares, mut count) = (0.0, 0.0);
        let seen = [&self.seen(0.0), &self.seen(STEP)];
        for light in &self.lights {
            let residuals = self.residuals(light, seen[0])?;
            let raised = light.profile.to_the_power(1.0 + STEP);
            let raised = self.residuals_of(light, &raised, [0.0; BESIDE_SEEN], seen[0])?;
            let own = by_step(&raised, &residuals);
            let others = self.derivatives(light, &residuals, seen)?;
            for (place, other) in self.places(light).into_iter().zip(&others) {
                normal[(place, size)] += dot(&own, other);
                normal[(size, place)] = normal[(place, size)];
            }
            normal[(size, size)] += dot(&own, &own);
            right[size] -= dot(&own, &residuals);
            squares += dot(&residuals, &residuals);
            count += residuals.len() as f64;
        }
        let [_, spread] = self.of_all();
        if self.at[spread] <= 0.0 {
            // It stays at its end.
            normal[(spread, spread)] += HELD;
            right[spread] = 0.0;
        }
        let covariance = normal.cholesky()?.inverse();
        let excess = (squares / count).max(1.0);
        Some(((&covariance * right)[size], (excess * covariance[(size, size)]).sqrt()))
    }

    /// Half the gradient's opposite, and the normal matrix.
    fn system(&self) -> Option<(DMatrix<f64>, DVector<f64>)> {
        let size = self.at.len();
        let seen = [&self.seen(0.0), &self.seen(STEP)];
        let of_light = |light: &Light| {
            let residuals = self.residuals(light, seen[0])?;
            let columns = self.derivatives(light, &residuals, seen)?;
            Some((self.places(light), columns, residuals))
        };
        let parts = self.lights.par_iter().map(of_light).collect::<Option<Vec<_>>>()?;
        let (mut normal, mut right) = (DMatrix::zeros(size, size), DVector::zeros(size));
        for (places, columns, residuals) in &parts {
            for (i, own) in places.iter().zip(columns) {
                right[*i] -= dot(own, residuals);
                for (j, other) in places.iter().zip(columns) {
                    normal[(*i, *j)] += dot(own, other);
                }
            }
        }
        for (residual, row) in self.expectations() {
            for &(i, own) in &row {
                right[i] -= own * residual;
                for &(j, other) in &row {
                    normal[(i, j)] += own * other;
                }
            }
        }
        Some((normal, right))
    }

    fn cost(&self) -> Option<f64> {
        let seen = self.seen(0.0);
        let of_light =
            |light: &Light| Some(self.residuals(light, &seen)?.iter().map(|r| r * r).sum::<f64>());
        let light: f64 =
            self.lights.par_iter().map(of_light).collect::<Option<Vec<_>>>()?.iter().sum();
        Some(light + self.expectations().iter().map(|(r, _)| r * r).sum::<f64>())
    }

    fn bounded(&self, mut at: DVector<f64>) -> DVector<f64> {
        let [discs, spread] = self.of_all();
        at.rows_mut(0, discs).iter_mut().for_each(|x| *x = x.clamp(LEAST_PX, self.known.pitch_px));
        at[spread] = at[spread].clamp(0.0, self.known.pitch_px);
        at
    }

    /// The error of f-numbers by how far pupils are from the law: the mean square that is expected, with what
    /// is not known of the pupils (the step of an expectation maximisation).
    fn expected_error(&self, normal: &DMatrix<f64>) -> Option<f64> {
        let covariance = normal.clone().cholesky()?.inverse();
        let whites = self.whites() as f64;
        let square = |(residual, row): &(f64, Vec<(usize, f64)>)| {
            let pairs = row.iter().flat_map(|x| row.iter().map(move |y| (x, y)));
            let variance: f64 = pairs.map(|(x, y)| x.1 * y.1 * covariance[(x.0, y.0)]).sum();
            residual * residual + variance
        };
        let squares: f64 = self.expectations()[..self.whites()].iter().map(square).sum();
        let (least, count) = F_NUMBERS;
        let sum = squares * self.f_number_error.powi(2) + count * least * least;
        Some((sum / (whites + count)).sqrt())
    }

    fn discs(&self, normal: &DMatrix<f64>) -> Option<Discs> {
        let ([h, spread], [m, c]) = (self.of_all(), self.law());
        let mut covariance = normal.clone().cholesky()?.inverse();
        for (quantity, std_dev) in [(spread, SPREAD_MODEL), (h, WITHIN_MODEL)] {
            covariance = with_model_error(covariance, quantity, std_dev);
        }
        let of = |i: usize| (self.at[i], covariance[(i, i)].sqrt());
        let (within, spread) = (of(h), of(spread));
        let cos4 = self.known.cos4_per_px2();
        Some(Discs {
            m_px: of(m),
            pupil_growth: self.at[c] / 2.0 * (self.at[m] / self.known.mla_to_sensor_px).powi(2),
            blur_px: (self.whites()..h).map(of).map(|(b, sd)| (b, sd.hypot(BLUR_MODEL))).collect(),
            within_per_px2: (within.0 * cos4, within.1 * cos4),
            sine: of(c),
            f_number_error: self.f_number_error,
            exponent: self.exponent(),
            point_spread: PointSpread { variance_px2: spread.0, std_dev_px2: spread.1 },
        })
    }
}
