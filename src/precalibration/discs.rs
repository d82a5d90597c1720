//! Pupil and blur from the light of all micro-images at once.
//!
//! The light of a micro-image shows the radii of both discs, a + b where it ends and |a − b| where it
//! begins to fall, if it is not clipped. b = |qᵢ| is the same at all f-numbers, and a is the same for all
//! lens types. So both are fitted to all profiles together, and b needs no f-number. a follows
//!
//! a(N) = |m|/N · (1 + c/2 · (m/(N d))²)
//!
//! with c = 0 for a thin lens, which has a flat pupil, and about 1 for a lens that is free of coma: by Abbe's sine
//! condition its aperture 1/N is proportional to sin u', but a/d is tan u'. Pupils have aberrations too, so c
//! is fitted. F-numbers are not exact; by how much shows in how far the pupils are from this law.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::profile::Profile;
use crate::vignetting::Obliquity;

/// c before anything is measured, and its standard deviation: between a thin lens and a double Gauss.
const SINE: (f64, f64) = (0.7, 0.7);
/// What is known of H beforehand, and how well discs of even light can tell it: standard deviations, relative.
/// On simulated cameras H comes out 4 to 8 % too small.
const WITHIN: f64 = 0.25;
const WITHIN_MODEL: f64 = 0.06;
/// The relative error that f-numbers are taken to have unless white images show another, and how much that
/// counts: with five of them hardly at all, with two it is all there is.
const F_NUMBERS: (f64, f64) = (0.02, 0.02);
/// Pupils further from their law, relative, are not those of the light: noise that is clipped bends it.
const MOST_F_NUMBER_ERROR: f64 = 0.06;
/// Rounds of the descent; the error of the f-numbers follows in each.
const ROUNDS: usize = 16;
/// Steps of the numerical derivatives, px; of H, relative.
const STEP: f64 = 1e-4;
/// Light this close to the edge of a neighbour may be the neighbour's, px.
const NEIGHBOUR_PX: f64 = 0.3;
/// Least radius of a disc, px.
const LEAST_PX: f64 = 0.05;

/// Where the fit begins, and what it does not change.
#[derive(Debug, Clone)]
pub(super) struct Known {
    /// N by white image.
    pub f_numbers: Vec<f64>,
    /// |m|, px.
    pub m_px: f64,
    /// qᵢ by lens type, with its sign, px.
    pub q_px: Vec<f64>,
    /// d, px.
    pub mla_to_sensor_px: f64,
    /// Δc, px.
    pub pitch_px: f64,
    /// H, px⁻².
    pub within_per_px2: f64,
}

/// The discs, with standard deviations.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Discs {
    /// |m| and its σ, px.
    pub m_px: (f64, f64),
    /// a/(|m|/N) − 1, times N²: c/2 · (m/d)².
    pub pupil_growth: f64,
    /// |qᵢ| and its σ, px.
    pub blur_px: Vec<(f64, f64)>,
    /// H and its σ, px⁻².
    pub within_per_px2: (f64, f64),
    /// c and its σ.
    pub sine: (f64, f64),
    /// Relative error of the f-numbers.
    pub f_number_error: f64,
}

/// The radii, H over what was known of it, |m| and c, in one vector.
struct Fit<'a> {
    known: &'a Known,
    lights: Vec<Light>,
    /// a, b, H, |m|, c.
    at: DVector<f64>,
    f_number_error: f64,
}

/// The light of the micro-images of one type in one white image.
struct Light {
    white: usize,
    lens_type: usize,
    profile: Profile,
}

/// The discs of all micro-images; `profiles` by white image and lens type. `None` if the light does not
/// determine them, or pupils that no f-numbers have.
pub(super) fn fit_discs(profiles: &[Vec<&Profile>], known: &Known) -> Option<Discs> {
    let mut fit = Fit::new(profiles, known);
    let mut damping = 1e-6;
    let mut system = fit.system()?;
    for _ in 0..ROUNDS {
        let (normal, right) = &system;
        let damped = normal + DMatrix::from_diagonal(&(normal.diagonal() * damping));
        let step = damped.cholesky()?.solve(right);
        let cost = fit.cost()?;
        let before = fit.at.clone();
        fit.at = fit.bounded(&before + step);
        if fit.cost().is_some_and(|moved| moved <= cost) {
            damping = (damping / 10.0_f64).max(1e-9);
            fit.light_at_angles();
            system = fit.system()?;
            fit.f_number_error = fit.expected_error(&system.0)?;
            system = fit.system()?;
        } else {
            fit.at = before;
            damping = (damping * 10.0).max(1e-6);
        }
    }
    fit.discs(&system.0)
}

impl<'a> Fit<'a> {
    fn new(profiles: &[Vec<&Profile>], known: &'a Known) -> Self {
        let pupils = known.f_numbers.iter().map(|n| known.m_px / n);
        let blurs = known.q_px.iter().map(|q| q.abs().max(LEAST_PX));
        let widest = blurs.clone().fold(0.0, f64::max);
        let lights = profiles.iter().enumerate().flat_map(|(white, profiles)| {
            let reach =
                known.pitch_px - known.m_px / known.f_numbers[white] - widest + NEIGHBOUR_PX;
            profiles.iter().enumerate().map(move |(lens_type, profile)| Light {
                white,
                lens_type,
                profile: profile.whole(reach),
            })
        });
        let lights = lights.collect();
        let at = pupils.chain(blurs).chain([1.0, known.m_px, SINE.0]).collect::<Vec<f64>>();
        let mut fit =
            Self { known, lights, at: DVector::from_vec(at), f_number_error: F_NUMBERS.0 };
        fit.light_at_angles();
        fit
    }

    /// Number of white images.
    fn whites(&self) -> usize {
        self.known.f_numbers.len()
    }

    /// Indices of H, |m| and c.
    fn law(&self) -> (usize, usize, usize) {
        let first = self.whites() + self.known.q_px.len();
        (first, first + 1, first + 2)
    }

    /// Sets the angles that light arrives at, which change little with the radii.
    fn light_at_angles(&mut self) {
        let (whites, at, known) = (self.whites(), &self.at, self.known);
        self.lights.par_iter_mut().for_each(|light| {
            let (a, b) = (at[light.white], at[whites + light.lens_type]);
            let q = b * known.q_px[light.lens_type].signum();
            light.profile.set_angles(a, q, known.pitch_px / 2.0);
        });
    }

    /// Weighted residuals of one profile, with its radii and H changed a little.
    fn residuals(&self, light: &Light, by: [f64; 3]) -> Option<Vec<f64>> {
        let a = self.at[light.white] + by[0];
        let b = self.at[self.whites() + light.lens_type] + by[1];
        let Known { within_per_px2, mla_to_sensor_px, pitch_px, .. } = self.known;
        let within = (self.at[self.law().0] + by[2]) * within_per_px2;
        let law = Obliquity::in_the_middle(within, *mla_to_sensor_px, pitch_px / 2.0);
        light.profile.residuals_of_discs(a, b, &law)
    }

    /// a by the law, and its derivatives by |m| and c.
    fn pupil(&self, f_number: f64) -> [f64; 3] {
        let (_, m, c) = self.law();
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
        let (h, m, c) = self.law();
        let of_white = |(i, f_number): (usize, &f64)| {
            let [pupil, by_m, by_c] = self.pupil(*f_number);
            let scale = 1.0 / (self.f_number_error * self.known.m_px / f_number);
            let row = vec![(i, scale), (m, -by_m * scale), (c, -by_c * scale)];
            ((self.at[i] - pupil) * scale, row)
        };
        let mut all: Vec<_> = self.known.f_numbers.iter().enumerate().map(of_white).collect();
        all.push(((self.at[h] - 1.0) / WITHIN, vec![(h, 1.0 / WITHIN)]));
        all.push(((self.at[c] - SINE.0) / SINE.1, vec![(c, 1.0 / SINE.1)]));
        all
    }

    /// Half the gradient's opposite, and the normal matrix.
    fn system(&self) -> Option<(DMatrix<f64>, DVector<f64>)> {
        let size = self.at.len();
        let of_light = |light: &Light| {
            let residuals = self.residuals(light, [0.0; 3])?;
            let places = [light.white, self.whites() + light.lens_type, self.law().0];
            let mut columns = Vec::with_capacity(3);
            for i in 0..3 {
                let mut by = [0.0; 3];
                by[i] = STEP;
                let moved = self.residuals(light, by)?;
                let column = moved.iter().zip(&residuals).map(|(m, r)| (m - r) / STEP);
                columns.push(column.collect::<Vec<f64>>());
            }
            Some((places, columns, residuals))
        };
        let parts = self.lights.par_iter().map(of_light).collect::<Option<Vec<_>>>()?;
        let (mut normal, mut right) = (DMatrix::zeros(size, size), DVector::zeros(size));
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
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
        let of_light = |light: &Light| {
            Some(self.residuals(light, [0.0; 3])?.iter().map(|r| r * r).sum::<f64>())
        };
        let light: f64 =
            self.lights.par_iter().map(of_light).collect::<Option<Vec<_>>>()?.iter().sum();
        Some(light + self.expectations().iter().map(|(r, _)| r * r).sum::<f64>())
    }

    fn bounded(&self, mut at: DVector<f64>) -> DVector<f64> {
        let discs = self.law().0;
        at.rows_mut(0, discs).iter_mut().for_each(|x| *x = x.clamp(LEAST_PX, self.known.pitch_px));
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
        let covariance = normal.clone().cholesky()?.inverse();
        let of = |i: usize| (self.at[i], covariance[(i, i)].sqrt());
        let (h, m, c) = self.law();
        let within = of(h);
        let known = self.known.within_per_px2;
        let discs = Discs {
            m_px: of(m),
            pupil_growth: self.at[c] / 2.0 * (self.at[m] / self.known.mla_to_sensor_px).powi(2),
            blur_px: (self.whites()..h).map(of).collect(),
            within_per_px2: (within.0 * known, within.1.hypot(WITHIN_MODEL) * known.abs()),
            sine: of(c),
            f_number_error: self.f_number_error,
        };
        let possible = discs.m_px.0 > 0.0 && self.at.iter().all(|x| x.is_finite());
        (possible && discs.f_number_error < MOST_F_NUMBER_ERROR).then_some(discs)
    }
}

#[cfg(test)]
mod tests {
    use super::super::profile::{Bin, seen};
    use super::*;

    const STOPS: [f64; 5] = [4.0, 5.657, 8.0, 11.314, 16.0];
    const M_PX: f64 = 26.7;
    const BLUR_PX: [f64; 3] = [5.1, 4.15, 4.8];
    const D_PX: f64 = 60.0;
    const PITCH_PX: f64 = 23.3;
    const WITHIN: f64 = 2.5e-3;

    /// The light of discs of radii a and b through a Galilean micro-lens, up to where it is clipped.
    fn light(a: f64, b: f64, clipped: f64) -> Profile {
        let bin = |i: u32| Bin {
            radius: 0.125 * (f64::from(i) + 0.5),
            std_dev: 1e-4,
            fall_off: 1.0,
            ..Bin::default()
        };
        let mut profile = Profile { bins: (0..96).map(bin).collect(), bright: Vec::new() };
        profile.set_angles(a, -b, PITCH_PX / 2.0);
        for bin in &mut profile.bins {
            let fall_off = Obliquity::in_the_middle(WITHIN, D_PX, PITCH_PX / 2.0)
                .mean_light(bin.square, bin.variance);
            bin.light = 0.02 + 0.8 * seen(bin.radius, a + b, (a - b).abs()) * fall_off;
        }
        profile.bins.retain(|bin| bin.light < clipped);
        profile
    }

    /// Of a lens with this c, at the stops times 1 + `errors`, which are not known.
    fn found(stops: &[f64], sine: f64, errors: &[f64], clipped: f64) -> Discs {
        fitted(stops, sine, errors, clipped).unwrap()
    }

    fn fitted(stops: &[f64], sine: f64, errors: &[f64], clipped: f64) -> Option<Discs> {
        let whites: Vec<Vec<Profile>> = stops
            .iter()
            .zip(errors)
            .map(|(stop, error)| {
                let paraxial = M_PX / (stop * (1.0 + error));
                let a = paraxial * (1.0 + sine / 2.0 * (paraxial / D_PX).powi(2));
                BLUR_PX.iter().map(|b| light(a, *b, clipped)).collect()
            })
            .collect();
        // As straight lines begin, which took the larger pupil for a larger slope.
        let known = Known {
            f_numbers: stops.to_vec(),
            m_px: 1.01 * M_PX,
            q_px: BLUR_PX.iter().map(|b| 0.02 - b).collect(),
            mla_to_sensor_px: D_PX,
            pitch_px: PITCH_PX,
            within_per_px2: 2e-3,
        };
        let profiles: Vec<Vec<&Profile>> = whites.iter().map(|of| of.iter().collect()).collect();
        fit_discs(&profiles, &known)
    }

    /// The largest error of |qᵢ|, px, and the largest of m and all of them over its σ.
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

    /// As clipped noise makes them.
    #[test]
    fn pupils_that_no_f_numbers_have_are_none() {
        assert!(fitted(&STOPS, 1.0, &[-0.15, 0.12, -0.1, 0.15, -0.12], 1.0).is_none());
    }

    #[test]
    fn two_f_numbers_leave_the_law_to_what_is_known_of_lenses() {
        for (sine, of_stops) in [(0.0, [0.0; 2]), (1.4, [0.0; 2]), (1.0, [0.02, -0.02])] {
            let discs = found(&[4.0, 8.0], sine, &of_stops, 1.0);
            let (of_blur, worst) = errors(&discs);
            assert!(of_blur < 2e-3 && worst < 3.0, "{of_blur} px, {worst} σ, {discs:?}");
        }
    }

    /// Without plateaus |qᵢ| rests on the f-numbers, and its σ says so.
    #[test]
    fn clipped_light_says_less() {
        let clipped = found(&STOPS, 1.0, &[0.0; 5], 0.2);
        let (of_blur, worst) = errors(&clipped);
        assert!(of_blur < 0.02 && worst < 2.0, "{of_blur} px, {worst} σ, {clipped:?}");
        let two = found(&[4.0, 8.0], 1.0, &[0.02, -0.02], 0.2);
        assert!(errors(&two).1 < 3.0, "{two:?}");
        assert!(two.blur_px[0].1 > 3.0 * clipped.blur_px[0].1, "{two:?} {clipped:?}");
    }
}
