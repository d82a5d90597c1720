//! Fit of pupil and blur to the light of all micro-images at once.
//!
//! The light of a micro-image shows the radii of both discs: it ends at a + b and, unless it is clipped, begins to fall
//! at |a − b|. b = |qᵢ| is the same at all f-numbers, and a is the same for all lens types. So both are fitted to all
//! profiles together, and b needs no f-number. a follows the law
//!
//! a(N) = |m|/N · (1 + c/2 · (m/(N d))²)
//!
//! with c = 0 for a thin lens, which has a flat pupil, and about 1 for a lens without coma: by Abbe's sine condition
//! its aperture 1/N is proportional to sin u', but a/d is tan u'. Pupils have aberrations too, so c is fitted. The
//! scatter of the pupils about this law shows the error of the f-numbers.
//!
//! The point spread widens all edges by the same amount. An edge is as wide as the smaller disc: the pupil, which is
//! proportional to 1/N, or the blur, which is constant. So the edges at a few f-numbers separate the variance of the
//! point spread from the discs.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::profile::{Profile, own_light_px};
use crate::model::Opening;
use crate::optics::{Obliquity, RadialPixels, Seen, WhiteDiscs};
use crate::quantity::Estimate;

/// Largest relative scatter of pupils about their law. If it is larger, clipped noise distorts the light.
const MOST_F_NUMBER_ERROR: f64 = 0.06;
/// Variance of the point spread, px², above which it reaches into the light of the neighbours. The discs are then
/// fitted again without that light.
const REACHES_PX2: f64 = 0.02;

/// Prior of c and its standard deviation: between a thin lens and a double Gauss.
const SINE: (f64, f64) = (0.7, 0.7);
/// Relative model error of H, or of cos⁴ if H is smaller. H changes the light by a hundredth, so model errors of a thousandth
/// matter: in data sets of simulated cameras H is 3 to 22 % too small.
const WITHIN_MODEL: f64 = 0.12;
/// Prior of the relative error of f-numbers, and its weight in white images. With five white images the prior hardly
/// matters, with two it is decisive.
const F_NUMBERS: (f64, f64) = (0.02, 0.02);
/// Prior of the variance of the point spread and its standard deviation, px²: pixels and micro-lenses are not ideal.
const SPREAD: (f64, f64) = (0.1, 0.3);
/// Model error of this variance, px²: edges also depend on the models of oblique light and of the pixels.
const SPREAD_MODEL: f64 = 0.006;
/// Model error of |qᵢ|, px. Openings narrower than the pitch change the angles of the light a little, and the aperture
/// ratio is not known yet. In 14 data sets of `mini` with aperture ratios from 0.85 to 1, |qᵢ| is off by 0.000 to 0.007
/// px.
const BLUR_MODEL: f64 = 0.003;
/// Rounds of the descent. Each updates the error of the f-numbers.
const ROUNDS: usize = 16;
/// Change of the sum of squares, and relative change of the error of the f-numbers, below which the descent ends.
const SETTLED: f64 = 1e-3;
/// Step of the derivative by the point spread, px².
const STEP_PX2: f64 = 1e-4;
/// Blur radius below which pixels determine the shape of edges, px.
const RESOLVED_PX: f64 = 1.0;
/// Weight that holds a parameter: larger than the weight of any light.
const HELD: f64 = 1e15;
/// Smallest radius of a disc, px.
const LEAST_PX: f64 = 0.05;

/// Number of parameters of a profile: both radii, H and the point spread.
const OF_LIGHT: usize = 4;

/// Start of the fit, and quantities that it holds.
#[derive(Debug, Clone)]
pub(super) struct Known {
    /// F-number N of each white image.
    pub f_numbers: Vec<f64>,
    /// Slope |m|, px.
    pub m_px: f64,
    /// Signed blur radius qᵢ by lens type, px.
    pub q_px: Vec<f64>,
    /// Distance d from array to sensor, px.
    pub mla_to_sensor_px: f64,
    /// Micro-image pitch Δc, px.
    pub pitch_px: f64,
    /// H relative to the H of cos⁴, from G.
    pub within: Estimate,
    /// Ratio of the distance L = D + e_z + d from exit pupil to sensor to d, as estimated from tilt and perspective.
    pub pupil_to_sensor: f64,
    /// Shape of the openings of the micro-lenses.
    pub opening: Opening,
}

impl Known {
    /// Returns H of cos⁴, px⁻².
    pub fn cos4_per_px2(&self) -> f64 {
        4.0 / self.mla_to_sensor_px.powi(2)
    }
}

/// Fitted discs, with standard deviations.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Discs {
    /// Shape of the openings of the micro-lenses.
    pub opening: Opening,
    /// Slope |m| and its σ, px.
    pub m_px: (f64, f64),
    /// Growth of the pupil (a/(|m|/N) − 1) N² = c/2 · (m/d)².
    pub pupil_growth: f64,
    /// Blur radii |qᵢ| and their σ, px.
    pub blur_px: Vec<(f64, f64)>,
    /// H and its σ, px⁻².
    pub within_per_px2: (f64, f64),
    /// Coefficient c and its σ.
    pub sine: (f64, f64),
    /// Relative error of the f-numbers.
    pub f_number_error: f64,
    /// Power of the samples to which light is proportional, less 1, and its σ; 0 for samples that are linear in light.
    /// `None` if the discs are too small to show it.
    pub exponent: Option<(f64, f64)>,
    /// Variance of the point spread, px².
    pub point_spread_px2: Estimate,
}

/// Fits the discs of all micro-images to `profiles`, by white image and lens type. Returns `None` if the light does not
/// determine them, or if no f-numbers explain the pupils.
pub(super) fn fit_discs(profiles: &[Vec<&Profile>], known: &Known) -> Option<Discs> {
    let mut fit = Fit::new(profiles, known);
    let mut discs = fit.descend()?;
    if discs.point_spread_px2.value > REACHES_PX2 {
        fit.take_light(profiles, discs.point_spread_px2.square_root().value);
        discs = fit.descend()?;
    }
    let possible = discs.m_px.0 > 0.0 && fit.is_finite();
    (possible && discs.f_number_error < MOST_F_NUMBER_ERROR).then_some(discs)
}

/// Adds a model error of one quantity to a covariance. All other quantities follow as they do in the fit: by their
/// covariance with it over its variance.
fn with_model_error(mut covariance: DMatrix<f64>, quantity: usize, std_dev: f64) -> DMatrix<f64> {
    let follow = covariance.column(quantity) / covariance[(quantity, quantity)] * std_dev;
    covariance += &follow * follow.transpose();
    covariance
}

/// State of the fit: the radii, H relative to cos⁴, the variance of the point spread, |m| and c in one vector.
struct Fit<'a> {
    known: &'a Known,
    lights: Vec<Light>,
    /// Parameters a, b, H, point spread, |m|, c.
    at: DVector<f64>,
    f_number_error: f64,
}

/// The light of the micro-images of one type in one white image.
struct Light {
    white: usize,
    lens_type: usize,
    profile: Profile,
}

/// Weighted residuals of a profile, and their derivatives.
struct Rows {
    residuals: Vec<f64>,
    columns: Vec<Vec<f64>>,
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

impl<'a> Fit<'a> {
    /// Creates the fit at its start.
    fn new(profiles: &[Vec<&Profile>], known: &'a Known) -> Self {
        let pupils = known.f_numbers.iter().map(|n| known.m_px / n);
        let blurs = known.q_px.iter().map(|q| q.abs().max(LEAST_PX));
        let at = pupils.chain(blurs).chain([known.within.value, SPREAD.0, known.m_px, SINE.0]);
        let at = DVector::from_vec(at.collect());
        let mut fit = Self { known, lights: Vec::new(), at, f_number_error: F_NUMBERS.0 };
        fit.take_light(profiles, 0.0);
        fit
    }

    /// Selects the light that does not come from neighbours, with a point spread of this standard deviation, px.
    fn take_light(&mut self, profiles: &[Vec<&Profile>], spread_px: f64) {
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
        let pixels = self.pixels(0.0);
        let middle = |light: &Light| {
            let seen = self.light(light, &pixels);
            light.profile.residuals(&seen).map_or(0.0, |(linear, _)| linear.x * seen.at(0.0))
        };
        let middles: Vec<f64> = self.lights.iter().map(middle).collect();
        let lights = self.lights.iter_mut().zip(middles);
        lights.for_each(|(light, middle)| light.profile.middle = middle);
    }

    /// Runs the descent. Returns `None` if the light does not determine the discs.
    fn descend(&mut self) -> Option<Discs> {
        let mut damping = 1e-6;
        let mut system = self.system()?;
        for _ in 0..ROUNDS {
            let step = self.step(&system, damping)?;
            let cost = self.cost()?;
            let (before, f_number_error) = (self.at.clone(), self.f_number_error);
            self.at = self.bounded(&before + step);
            if let Some(moved) = self.cost().filter(|moved| *moved <= cost) {
                damping = (damping / 10.0_f64).max(1e-9);
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

    /// Solves for a damped step. If it would take the variance of the point spread below 0, this ends at 0, and all
    /// other parameters follow.
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

    /// Returns true if all parameters are finite.
    fn is_finite(&self) -> bool {
        self.at.iter().all(|x| x.is_finite())
    }

    /// Returns the number of white images.
    fn whites(&self) -> usize {
        self.known.f_numbers.len()
    }

    /// Returns the indices of H and of the point spread, on which all light depends.
    fn of_all(&self) -> [usize; 2] {
        let first = self.whites() + self.known.q_px.len();
        [first, first + 1]
    }

    /// Returns the indices of |m| and c.
    fn law(&self) -> [usize; 2] {
        self.of_all().map(|i| i + 2)
    }

    /// Returns the indices of the parameters of one profile: its radii, H and the point spread.
    fn places(&self, light: &Light) -> [usize; OF_LIGHT] {
        let [within, spread] = self.of_all();
        [light.white, self.whites() + light.lens_type, within, spread]
    }

    /// Creates pixels with the point spread of the fit plus `by`, px².
    fn pixels(&self, by: f64) -> RadialPixels {
        let [_, spread] = self.of_all();
        let furthest = self.lights.iter().map(|light| light.profile.furthest_px());
        RadialPixels::new(self.at[spread] + by, furthest.fold(0.0, f64::max))
    }

    /// Returns the discs of one profile.
    fn discs_of(&self, light: &Light) -> WhiteDiscs {
        let [pupil_px, blur, within, _] = self.places(light).map(|i| self.at[i]);
        let Known { mla_to_sensor_px, pitch_px, pupil_to_sensor, .. } = *self.known;
        let within = within * self.known.cos4_per_px2();
        let law = Obliquity::in_the_middle(within, mla_to_sensor_px, pitch_px / 2.0);
        // The micro-image pitch is the lens pitch projected from the pupil.
        let opening_px = pitch_px / 2.0 * (1.0 - 1.0 / pupil_to_sensor);
        let q_px = blur * self.known.q_px[light.lens_type].signum();
        WhiteDiscs { pupil_px, q_px, opening_px, opening: self.known.opening, law }
    }

    /// Computes the light of one profile from its discs.
    fn light(&self, light: &Light, pixels: &RadialPixels) -> Seen {
        let discs = self.discs_of(light);
        let [seen] = pixels.see(|t| [discs.light(t)]);
        seen
    }

    /// Computes the weighted residuals of one profile and their derivatives by its parameters and, with `power`, by the
    /// power of the samples. The second pixels have a point spread that is larger by [`STEP_PX2`].
    fn rows(
        &self,
        light: &Light,
        [pixels, wider]: [&RadialPixels; 2],
        power: bool,
    ) -> Option<Rows> {
        let (discs, cos4) = (self.discs_of(light), self.known.cos4_per_px2());
        let [seen, by_pupil, by_blur, by_within] = pixels.see(|t| {
            let (point, [by_pupil, by_blur]) = (discs.point(t), discs.by_radii(t));
            [point.light, by_pupil, by_blur, point.by_within * cos4]
        });
        let by_spread = self.light(light, wider).change(&seen, STEP_PX2);
        let (_, residuals) = light.profile.residuals(&seen)?;
        let column = |by: &Seen| light.profile.derivative(&seen, &residuals, by);
        let mut columns = Vec::new();
        for by in [&by_pupil, &by_blur, &by_within, &by_spread] {
            columns.push(column(by)?);
        }
        if power {
            columns.push(light.profile.derivative_by_exponent(&seen)?);
        }
        Some(Rows { residuals, columns })
    }

    /// Computes a by the law, and its derivatives by |m| and c.
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

    /// Computes the residuals of the law and of the priors over their standard deviations, with their derivatives.
    fn expectations(&self) -> Vec<(f64, Vec<(usize, f64)>)> {
        let ([h, spread], [m, c]) = (self.of_all(), self.law());
        let of_white = |(i, f_number): (usize, &f64)| {
            let [pupil, by_m, by_c] = self.pupil(*f_number);
            let scale = 1.0 / (self.f_number_error * self.known.m_px / f_number);
            let row = vec![(i, scale), (m, -by_m * scale), (c, -by_c * scale)];
            ((self.at[i] - pupil) * scale, row)
        };
        let mut all: Vec<_> = self.known.f_numbers.iter().enumerate().map(of_white).collect();
        let within = (self.known.within.value, self.known.within.std_dev);
        for (i, (value, std_dev)) in [(h, within), (spread, SPREAD), (c, SINE)] {
            all.push(((self.at[i] - value) / std_dev, vec![(i, 1.0 / std_dev)]));
        }
        all
    }

    /// Estimates the power of the samples to which light is proportional, less 1, and its σ, by one step of a fit with
    /// a free power. Returns `None` if pixels hide it.
    fn exponent(&self) -> Option<(f64, f64)> {
        let blurs = self.at.rows(self.whites(), self.known.q_px.len());
        if blurs.max() < RESOLVED_PX {
            return None;
        }
        let (mut normal, mut right) = self.system_with(true)?;
        let power = right.len() - 1;
        let [_, spread] = self.of_all();
        if self.at[spread] <= 0.0 {
            // The point spread stays at 0.
            normal[(spread, spread)] += HELD;
            right[spread] = 0.0;
        }
        let (squares, count) = self.squares()?;
        let covariance = normal.cholesky()?.inverse();
        let excess = (squares / count).max(1.0);
        Some(((&covariance * right)[power], (excess * covariance[(power, power)]).sqrt()))
    }

    /// Computes the normal matrix and half the negative gradient.
    fn system(&self) -> Option<(DMatrix<f64>, DVector<f64>)> {
        self.system_with(false)
    }

    /// Computes [`Fit::system`]; with `power`, the power of the samples is the last parameter.
    fn system_with(&self, power: bool) -> Option<(DMatrix<f64>, DVector<f64>)> {
        let size = self.at.len() + usize::from(power);
        let pixels = [&self.pixels(0.0), &self.pixels(STEP_PX2)];
        let of_light = |light: &Light| Some((self.places(light), self.rows(light, pixels, power)?));
        let parts = self.lights.par_iter().map(of_light).collect::<Option<Vec<_>>>()?;
        let (mut normal, mut right) = (DMatrix::zeros(size, size), DVector::zeros(size));
        for (places, Rows { residuals, columns }) in &parts {
            let places = || places.iter().copied().chain([size - 1]);
            for (i, own) in places().zip(columns) {
                right[i] -= dot(own, residuals);
                for (j, other) in places().zip(columns) {
                    normal[(i, j)] += dot(own, other);
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

    /// Computes the sum of squares of all light, and the number of its bins.
    fn squares(&self) -> Option<(f64, f64)> {
        let pixels = self.pixels(0.0);
        let of_light = |light: &Light| {
            let (_, residuals) = light.profile.residuals(&self.light(light, &pixels))?;
            Some((dot(&residuals, &residuals), residuals.len() as f64))
        };
        let all = self.lights.par_iter().map(of_light).collect::<Option<Vec<_>>>()?;
        Some(all.iter().fold((0.0, 0.0), |sum, one| (sum.0 + one.0, sum.1 + one.1)))
    }

    fn cost(&self) -> Option<f64> {
        let (light, _) = self.squares()?;
        Some(light + self.expectations().iter().map(|(r, _)| r * r).sum::<f64>())
    }

    fn bounded(&self, mut at: DVector<f64>) -> DVector<f64> {
        let [discs, spread] = self.of_all();
        at.rows_mut(0, discs).iter_mut().for_each(|x| *x = x.clamp(LEAST_PX, self.known.pitch_px));
        at[spread] = at[spread].clamp(0.0, self.known.pitch_px);
        at
    }

    /// Estimates the error of the f-numbers from the scatter of the pupils about the law: the expected mean square,
    /// with the uncertainty of the pupils (the step of an expectation maximisation).
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
        let within_model = WITHIN_MODEL * self.at[h].abs().max(1.0);
        for (quantity, std_dev) in [(spread, SPREAD_MODEL), (h, within_model)] {
            covariance = with_model_error(covariance, quantity, std_dev);
        }
        let of = |i: usize| (self.at[i], covariance[(i, i)].sqrt());
        let (within, spread) = (of(h), of(spread));
        let cos4 = self.known.cos4_per_px2();
        Some(Discs {
            opening: self.known.opening,
            m_px: of(m),
            pupil_growth: self.at[c] / 2.0 * (self.at[m] / self.known.mla_to_sensor_px).powi(2),
            blur_px: (self.whites()..h).map(of).map(|(b, sd)| (b, sd.hypot(BLUR_MODEL))).collect(),
            within_per_px2: (within.0 * cos4, within.1 * cos4),
            sine: of(c),
            f_number_error: self.f_number_error,
            exponent: self.exponent(),
            point_spread_px2: Estimate::new(spread.0, spread.1),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::profile::Bin;
    use super::*;

    const STOPS: [f64; 5] = [4.0, 5.657, 8.0, 11.314, 16.0];
    const M_PX: f64 = 26.7;
    const BLUR_PX: [f64; 3] = [5.1, 4.15, 4.8];
    const D_PX: f64 = 60.0;
    const PITCH_PX: f64 = 23.3;
    const WITHIN: f64 = 2.5e-3;

    /// Computes the light of discs of radii a and b through a Galilean micro-lens, with this point spread, px², and
    /// without clipped bins.
    fn light([a, b]: [f64; 2], spread: f64, clipped: f64) -> Profile {
        let bin =
            |i: u32| Bin { radius: 0.125 * (f64::from(i) + 0.5), std_dev: 1e-4, ..Bin::default() };
        let mut profile = Profile { bins: (0..96).map(bin).collect(), ..Profile::default() };
        let law = Obliquity::in_the_middle(WITHIN, D_PX, PITCH_PX / 2.0);
        let discs = WhiteDiscs {
            pupil_px: a,
            q_px: -b,
            opening_px: PITCH_PX / 2.0,
            opening: Opening::Disc,
            law,
        };
        let [seen] = RadialPixels::new(spread, profile.furthest_px()).see(|t| [discs.light(t)]);
        for bin in &mut profile.bins {
            bin.light = 0.02 + 0.8 * seen.at(bin.radius);
        }
        profile.bins.retain(|bin| bin.light < clipped);
        profile
    }

    /// Fits a lens with this c. Its true f-numbers are the stops times 1 + `errors`; the fit assumes the stops.
    fn found(stops: &[f64], sine: f64, errors: &[f64], clipped: f64) -> Discs {
        fitted((stops, errors), sine, 0.0, clipped).unwrap()
    }

    fn fitted(
        (stops, errors): (&[f64], &[f64]),
        sine: f64,
        spread: f64,
        clipped: f64,
    ) -> Option<Discs> {
        let whites: Vec<Vec<Profile>> = stops
            .iter()
            .zip(errors)
            .map(|(stop, error)| {
                let paraxial = M_PX / (stop * (1.0 + error));
                let a = paraxial * (1.0 + sine / 2.0 * (paraxial / D_PX).powi(2));
                BLUR_PX.iter().map(|b| light([a, *b], spread, clipped)).collect()
            })
            .collect();
        // The start by straight lines, which take the larger pupil for a larger slope.
        let known = Known {
            f_numbers: stops.to_vec(),
            m_px: 1.01 * M_PX,
            q_px: BLUR_PX.iter().map(|b| 0.02 - b).collect(),
            mla_to_sensor_px: D_PX,
            pitch_px: PITCH_PX,
            opening: Opening::Disc,
            within: Estimate::new(1.8, 0.5),
            pupil_to_sensor: f64::INFINITY,
        };
        let profiles: Vec<Vec<&Profile>> = whites.iter().map(|of| of.iter().collect()).collect();
        fit_discs(&profiles, &known)
    }

    /// Returns the largest error of |qᵢ|, px, and the largest error of m and all |qᵢ| over its σ.
    fn errors(discs: &Discs) -> (f64, f64) {
        let blurs =
            || discs.blur_px.iter().zip(BLUR_PX).map(|(b, truth)| ((b.0 - truth).abs(), b.1));
        let of_m = ((discs.m_px.0 - M_PX).abs(), discs.m_px.1);
        let over = blurs().chain([of_m]).map(|(error, std_dev)| error / std_dev);
        (blurs().map(|(error, _)| error).fold(0.0, f64::max), over.fold(0.0, f64::max))
    }

    #[test]
    fn the_pupil_of_any_lens_is_found() {
        for sine in [0.0, 1.0, 1.4] {
            let discs = found(&STOPS, sine, &[0.0; 5], 1.0);
            let (of_blur, worst) = errors(&discs);
            assert!(
                of_blur < 1e-3 && worst < 2.0,
                "c = {sine}: {of_blur} px, {worst} σ, {discs:?}"
            );
            assert!((discs.sine.0 - sine).abs() < 0.35, "{discs:?}");
            assert!((discs.m_px.0 / M_PX - 1.0).abs() < 1e-3, "{discs:?}");
            assert!((discs.within_per_px2.0 / WITHIN - 1.0).abs() < 0.02, "{discs:?}");
        }
    }

    #[test]
    fn wrong_f_numbers_do_not_reach_the_blur() {
        let discs = found(&STOPS, 1.0, &[0.02, -0.015, 0.01, -0.02, 0.005], 1.0);
        let (of_blur, worst) = errors(&discs);
        assert!(of_blur < 1e-3 && worst < 3.0, "{of_blur} px, {worst} σ, {discs:?}");
        assert!((0.005..0.03).contains(&discs.f_number_error), "{discs:?}");
    }

    /// Clipped noise gives such pupils.
    #[test]
    fn pupils_that_no_f_numbers_have_are_none() {
        assert!(fitted((&STOPS, &[-0.15, 0.12, -0.1, 0.15, -0.12]), 1.0, 0.0, 1.0).is_none());
    }

    /// The range includes more than sensors have, and a clipped middle.
    #[test]
    fn point_spreads_are_told_from_discs() {
        for (spread, clipped) in [(0.0, 1.0), (0.09, 1.0), (0.25, 1.0), (1.0, 1.0), (0.25, 0.3)] {
            let discs = fitted((&STOPS, &[0.02, -0.015, 0.01, -0.02, 0.005]), 1.0, spread, clipped)
                .unwrap();
            let (of_blur, worst) = errors(&discs);
            let limit = if clipped < 1.0 { 0.03 } else { 3e-3 };
            assert!(of_blur < limit && worst < 3.0, "{spread}: {of_blur} px, {worst} σ, {discs:?}");
            let Estimate { value, std_dev } = discs.point_spread_px2;
            assert!((value - spread).abs() < 3.0 * std_dev, "{spread}: {discs:?}");
        }
    }

    #[test]
    fn two_f_numbers_leave_the_law_to_what_is_known_of_lenses() {
        for (sine, of_stops) in [(0.0, [0.0; 2]), (1.4, [0.0; 2]), (1.0, [0.02, -0.02])] {
            let discs = found(&[4.0, 8.0], sine, &of_stops, 1.0);
            let (of_blur, worst) = errors(&discs);
            assert!(of_blur < 2e-3 && worst < 3.0, "{of_blur} px, {worst} σ, {discs:?}");
        }
    }

    /// Without plateaus |qᵢ| depends on the f-numbers, and its σ includes this.
    #[test]
    fn clipped_light_says_less() {
        let clipped = found(&STOPS, 1.0, &[0.0; 5], 0.2);
        let (of_blur, worst) = errors(&clipped);
        assert!(of_blur < 0.02 && worst < 2.0, "{of_blur} px, {worst} σ, {clipped:?}");
        let two = found(&[4.0, 8.0], 1.0, &[0.02, -0.02], 0.2);
        assert!(errors(&two).1 < 3.0, "{two:?}");
        assert!(two.blur_px[0].1 > 3.0 * clipped.blur_px[0].1, "{two:?} {clipped:?}");
    }

    /// The second quantity follows the first by half, with scatter of its own; the third does not depend on it.
    #[test]
    fn what_follows_a_quantity_has_its_error() {
        let covariance = DMatrix::from_row_slice(
            3,
            3,
            &[
                0.04, 0.02, 0.0, //
                0.02, 0.02, 0.0, //
                0.0, 0.0, 1.0,
            ],
        );
        let found = with_model_error(covariance, 0, 0.3);
        let variances: Vec<f64> = found.diagonal().iter().copied().collect();
        for (found, expected) in variances.iter().zip([0.04 + 0.09, 0.02 + 0.0225, 1.0]) {
            assert!((found - expected).abs() < 1e-12, "{variances:?}");
        }
    }
}
