//! The array with centres as they would be without oblique light.

use nalgebra::Vector2;
use rayon::prelude::*;

use super::array::{ArrayMeasurement, FoundArray, fit_found, fit_found_regular};
use super::centroid_shift::{ShiftedGrid, fit_shift, shift_moment};
use super::checks::named;
use super::grid::MicroImageArray;
use super::profile::Profile;
use super::radii::TypeRadius;
use super::samples::Samples;
use super::stage::{PrecalibrationOptions, White};
use crate::error::Result;
use crate::model::{Configuration, InternalParameters, MicroImageCenter};

/// What the moments X follow from, see [`super::centroid_shift`].
pub(super) struct Moments<'a> {
    pub internal: &'a InternalParameters,
    pub grid: &'a MicroImageArray,
    pub options: &'a PrecalibrationOptions,
}

impl Moments<'_> {
    /// Radii a and b of the discs of pupil and blur, px.
    pub fn disc_radii(&self, f_number: f64, q_prime_mm: f64) -> (f64, f64) {
        let pixel = self.options.pixel_size_mm;
        let blur = q_prime_mm / pixel - self.grid.pitch_px / 2.0;
        (self.internal.m_mm / f_number / pixel, blur.abs())
    }

    /// X by lens type, px².
    fn of_image<'p>(
        &self,
        f_number: f64,
        profiles: impl IntoIterator<Item = &'p Profile>,
    ) -> Vec<f64> {
        let obliquity = self.options.obliquity(self.internal.m_mm, self.grid.pitch_px);
        let inverted = self.options.configuration == Configuration::Keplerian;
        let of_type = |(profile, q_prime): (&Profile, &f64)| {
            let (a, b) = self.disc_radii(f_number, *q_prime);
            let peak = profile.peak(a + b, (a - b).abs()).unwrap_or(1.0);
            shift_moment(a, b, &obliquity, inverted, peak)
        };
        profiles.into_iter().zip(&self.internal.q_prime_mm).map(of_type).collect()
    }
}

/// The array of the reference with its centres less the shift that several white images show, and the
/// relative change of the pitch by that. The profiles are those of the reference by lens type.
pub(super) fn corrected_array(
    found: &FoundArray,
    samples: &Samples,
    moments: &Moments,
    radii: &[Vec<TypeRadius>],
    (reference, profiles): (&White, &[Profile]),
) -> Result<(ArrayMeasurement, f64)> {
    let grid = &found.array.grid;
    let lattice = &grid.lattice;
    let types = profiles.len();
    let shifted = samples
        .samples
        .par_iter()
        .zip(samples.whites)
        .zip(radii)
        .map(|((sample, white), radii)| {
            let of_types = moments.of_image(white.f_number, radii.iter().map(|r| &r.profile));
            let x = of_types.iter().sum::<f64>() / types as f64;
            let centers: Vec<MicroImageCenter> =
                sample.blobs.iter().map(|blob| found.center(blob)).collect();
            let fitted =
                fit_found_regular(&centers, lattice).map_err(|e| named(&white.name, &e))?;
            Ok(ShiftedGrid { x, pitch_px: fitted.pitch_px, center_px: fitted.center_px })
        })
        .collect::<Result<Vec<ShiftedGrid>>>()?;
    let shift = fit_shift(&shifted);
    let of_reference = moments.of_image(reference.f_number, profiles);
    let mut array = found.array.clone();
    for center in &mut array.centers {
        let x = of_reference[lattice.lens_type(center.k, center.l, types)];
        let measured = Vector2::new(center.u_px, center.v_px);
        let place = shift.corrected(measured, &grid.center_px, x);
        (center.u_px, center.v_px) = (place.x, place.y);
    }
    array.grid = fit_found(&array.centers, lattice)?;
    let correction = array.grid.pitch_px / grid.pitch_px - 1.0;
    Ok((array, correction))
}
