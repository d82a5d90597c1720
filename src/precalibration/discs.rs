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
//!
//! The point spread makes all edges wider by the same amount. Where the pupil is smaller than the blur the edge is as wide
//! as the pupil, which is proportional to 1/N; where it is larger, as wide as the blur. So the edges of a few f-numbers
//! tell the variance of the point spread from the discs.

use nalgebra::DMatrix;

use super::disc_fit::Fit;
use super::profile::Profile;
use crate::model::PointSpread;

/// Pupils further from their law, relative, are not those of the light: noise that is clipped bends it.
const MOST_F_NUMBER_ERROR: f64 = 0.06;
/// Point spreads above this reach into the light of the neighbours, and the discs are fitted again without the light there,
/// px².
const REACHES_PX2: f64 = 0.02;

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
    /// H over that of cos⁴.
    pub within: f64,
}

impl Known {
    /// H of cos⁴, px⁻².
    pub fn cos4_per_px2(&self) -> f64 {
        4.0 / self.mla_to_sensor_px.powi(2)
    }
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
    /// The power of the samples that light is, less 1, and its σ: 0 for samples that are linear in
    /// light. `None` where the discs are too small to tell.
    pub exponent: Option<(f64, f64)>,
    /// The point spread.
    pub point_spread: PointSpread,
}

/// The discs of all micro-images; `profiles` by white image and lens type. `None` if the light does not
/// determine them, or pupils that no f-numbers have.
pub(super) fn fit_discs(profiles: &[Vec<&Profile>], known: &Known) -> Option<Discs> {
    let mut fit = Fit::new(profiles, known);
    let mut discs = fit.descend()?;
    if discs.point_spread.variance_px2 > REACHES_PX2 {
        fit.take_light(profiles, discs.point_spread.px()[0]);
        discs = fit.descend()?;
    }
    let possible = discs.m_px.0 > 0.0 && fit.is_finite();
    (possible && discs.f_number_error < MOST_F_NUMBER_ERROR).then_some(discs)
}

/// A covariance with an error of one quantity that is not in it: all others follow as they do in the fit, by their
/// covariance with it over its variance.
pub(super) fn with_model_error(
    mut covariance: DMatrix<f64>,
    quantity: usize,
    std_dev: f64,
) -> DMatrix<f64> {
    let follow = covariance.column(quantity) / covariance[(quantity, quantity)] * std_dev;
    covariance += &follow * follow.transpose();
    covariance
}

#[cfg(test)]
mod tests {
    use super::super::profile::Bin;
    use super::super::seen::{Angles, Seen};
    use super::*;
    use crate::vignetting::{Obliquity, Pixel};

    const STOPS: [f64; 5] = [4.0, 5.657, 8.0, 11.314, 16.0];
    const M_PX: f64 = 26.7;
    const BLUR_PX: [f64; 3] = [5.1, 4.15, 4.8];
    const D_PX: f64 = 60.0;
    const PITCH_PX: f64 = 23.3;
    const WITHIN: f64 = 2.5e-3;

    /// The light of discs of radii a and b through a Galilean micro-lens with this point spread, px², up to where it is
    /// clipped.
    fn light([a, b]: [f64; 2], spread: f64, clipped: f64) -> Profile {
        let bin =
            |i: u32| Bin { radius: 0.125 * (f64::from(i) + 0.5), std_dev: 1e-4, ..Bin::default() };
        let mut profile = Profile { bins: (0..96).map(bin).collect(), ..Profile::default() };
        let law = Obliquity::in_the_middle(WITHIN, D_PX, PITCH_PX / 2.0);
        let oblique = Angles::new(a, -b, PITCH_PX / 2.0).oblique(&law);
        let seen = Seen::new(&Pixel::new(spread), profile.furthest_px());
        let seen = seen.discs(a + b, (a - b).abs(), &oblique);
        for bin in &mut profile.bins {
            bin.light = 0.02 + 0.8 * seen.at(bin.radius);
        }
        profile.bins.retain(|bin| bin.light < clipped);
        profile
    }

    /// Of a lens with this c, at the stops times 1 + `errors`, which are not known.
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
        // As straight lines begin, which took the larger pupil for a larger slope.
        let known = Known {
            f_numbers: stops.to_vec(),
            m_px: 1.01 * M_PX,
            q_px: BLUR_PX.iter().map(|b| 0.02 - b).collect(),
            mla_to_sensor_px: D_PX,
            pitch_px: PITCH_PX,
            within: 1.8,
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
        assert!(fitted((&STOPS, &[-0.15, 0.12, -0.1, 0.15, -0.12]), 1.0, 0.0, 1.0).is_none());
    }

    /// Up to more than sensors have, also where the middle is clipped.
    #[test]
    fn point_spreads_are_told_from_discs() {
        for (spread, clipped) in [(0.0, 1.0), (0.09, 1.0), (0.25, 1.0), (1.0, 1.0), (0.25, 0.3)] {
            let discs = fitted((&STOPS, &[0.02, -0.015, 0.01, -0.02, 0.005]), 1.0, spread, clipped)
                .unwrap();
            let (of_blur, worst) = errors(&discs);
            let limit = if clipped < 1.0 { 0.03 } else { 3e-3 };
            assert!(of_blur < limit && worst < 3.0, "{spread}: {of_blur} px, {worst} σ, {discs:?}");
            let PointSpread { variance_px2, std_dev_px2 } = discs.point_spread;
            assert!((variance_px2 - spread).abs() < 3.0 * std_dev_px2, "{spread}: {discs:?}");
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

    /// The second goes half as far as the first, with scatter of its own; the third knows nothing of it.
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
