//! The array with centres as they would be without oblique light.

use nalgebra::Vector2;

use super::array::{ArrayMeasurement, FoundArray, fit_found};
use super::centroid_shift::shift_moment;
use super::grid::MicroImageArray;
use super::profile::Profile;
use super::stage::PrecalibrationOptions;
use crate::error::Result;
use crate::model::{Configuration, FallOff, InternalParameters};
use crate::vignetting::Obliquity;

/// What the moments X follow from, see [`super::centroid_shift`].
pub(super) struct Moments<'a> {
    pub internal: &'a InternalParameters,
    pub obliquity: &'a Obliquity,
    pub grid: &'a MicroImageArray,
    pub options: &'a PrecalibrationOptions,
}

impl Moments<'_> {
    /// Radii a and b of the discs of pupil and blur, px.
    pub fn disc_radii(&self, f_number: f64, q_prime_mm: f64) -> (f64, f64) {
        let pixel = self.options.pixel_size_mm;
        let blur = q_prime_mm / pixel - self.grid.pitch_px / 2.0;
        (self.internal.pupil_radius_mm(f_number) / pixel, blur.abs())
    }

    /// X by lens type, px².
    fn of_image(&self, f_number: f64, profiles: &[Profile]) -> Vec<f64> {
        let inverted = self.options.configuration == Configuration::Keplerian;
        let of_type = |(profile, q_prime): (&Profile, &f64)| {
            let (a, b) = self.disc_radii(f_number, *q_prime);
            let peak = profile.peak(a + b, (a - b).abs()).unwrap_or(1.0);
            shift_moment(a, b, self.obliquity, inverted, peak)
        };
        profiles.iter().zip(&self.internal.q_prime_mm).map(of_type).collect()
    }
}

/// The array of the reference, its centres less the shift by the fall-off, and the relative change of the
/// pitch by that. The profiles are those of the reference by lens type.
pub(super) fn corrected_array(
    found: &FoundArray,
    fall_off: &FallOff,
    moments: &Moments,
    (f_number, profiles): (f64, &[Profile]),
) -> Result<(ArrayMeasurement, f64)> {
    let grid = &found.array.grid;
    let moments = moments.of_image(f_number, profiles);
    let mut array = found.array.clone();
    for center in &mut array.centers {
        let x = moments[grid.lattice.lens_type(center.k, center.l, profiles.len())];
        let measured = Vector2::new(center.u_px, center.v_px);
        let place = measured + fall_off.gradient(&measured) * x;
        (center.u_px, center.v_px) = (place.x, place.y);
    }
    array.grid = fit_found(&array.centers, &grid.lattice)?;
    let correction = array.grid.pitch_px / grid.pitch_px - 1.0;
    Ok((array, correction))
}
