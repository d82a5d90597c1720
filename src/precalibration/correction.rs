//! The array with centres as they would be without oblique light.

use nalgebra::Vector2;

use super::array::{ArrayMeasurement, FoundArray, fit_found};
use super::centroid::WINDOW;
use super::centroid_shift::shift_moment;
use super::discs::Discs;
use super::rings::Alike;
use crate::error::Result;
use crate::model::FallOff;

/// X by lens type, px²: see [`super::centroid_shift`]. `light` is that of each type where the centroids
/// were measured, `strength` the fall-off over that of cos⁴.
pub(super) fn shift_moments(
    light: &[Alike],
    discs: &Discs,
    pitch_px: f64,
    strength: f64,
) -> Vec<f64> {
    let (inner, outer) = (WINDOW.0 * pitch_px, WINDOW.1 * pitch_px);
    let window =
        |r: f64| ((outer * outer - r * r) / (outer * outer - inner * inner)).clamp(0.0, 1.0);
    let of_type = |(lens_type, alike): (usize, &Alike)| {
        shift_moment(&alike.mean, window, |r| discs.lever(lens_type, r, strength))
    };
    light.iter().enumerate().map(of_type).collect()
}

/// The array of the reference, its centres less the shift by the fall-off, and the relative change of the
/// pitch by that. The moments X are those of the lens types.
pub(super) fn corrected_array(
    found: &FoundArray,
    fall_off: &FallOff,
    moments: &[f64],
) -> Result<(ArrayMeasurement, f64)> {
    let grid = &found.array.grid;
    let mut array = found.array.clone();
    for center in &mut array.centers {
        let x = moments[grid.lattice.lens_type(center.k, center.l, moments.len())];
        let measured = Vector2::new(center.u_px, center.v_px);
        let place = measured + fall_off.gradient(&measured) * x;
        (center.u_px, center.v_px) = (place.x, place.y);
    }
    array.grid = fit_found(&array.centers, &grid.lattice)?;
    let correction = array.grid.pitch_px / grid.pitch_px - 1.0;
    Ok((array, correction))
}
