//! The array with centres as they would be without oblique light.

use nalgebra::Vector2;

use super::array::{ArrayMeasurement, FoundArray, fit_found};
use super::centroid::WINDOW;
use super::centroid_shift::shift_moment;
use super::levers::Levers;
use super::rings::{Alike, Ring};
use crate::error::Result;
use crate::model::FallOff;

/// How far the centroids of one lens type are shifted: see [`super::centroid_shift`].
#[derive(Debug, Clone, Copy)]
pub(super) struct Moment {
    /// X in the middle of the array, px².
    x: f64,
    /// What it grows by along the perspective of the centres, over that.
    growth: f64,
}

/// The moments by lens type. `light` is that of each type where the centroids were measured, `strength` the
/// fall-off over that of cos⁴.
pub(super) fn shift_moments(
    light: &[Alike],
    levers: &Levers,
    pitch_px: f64,
    strength: f64,
) -> Vec<Moment> {
    let (inner, outer) = (WINDOW.0 * pitch_px, WINDOW.1 * pitch_px);
    let window =
        |r: f64| ((outer * outer - r * r) / (outer * outer - inner * inner)).clamp(0.0, 1.0);
    let of_type = |(lens_type, alike): (usize, &Alike)| {
        let sum = |light: fn(&Ring) -> f64| {
            alike.mean.iter().map(|ring| ring.radius * light(ring)).sum::<f64>()
        };
        let unclipped = sum(|ring| ring.unclipped) / sum(|ring| ring.light).max(1e-9);
        Moment {
            x: shift_moment(&alike.mean, window, |r| levers.lever(lens_type, r, strength)),
            // Light that is clipped shifts nothing.
            growth: levers.moment_growth(lens_type) * unclipped,
        }
    };
    light.iter().enumerate().map(of_type).collect()
}

/// The array of the reference, its centres less the shift by the fall-off, and the relative change of the
/// pitch by that.
pub(super) fn corrected_array(
    found: &FoundArray,
    fall_off: &FallOff,
    moments: &[Moment],
) -> Result<(ArrayMeasurement, f64)> {
    let grid = &found.array.grid;
    let mut array = found.array.clone();
    for center in &mut array.centers {
        let moment = &moments[grid.lattice.lens_type(center.k, center.l, moments.len())];
        let measured = Vector2::new(center.u_px, center.v_px);
        let along = grid.perspective_per_px.dot(&(measured - grid.center_px));
        let place = measured + fall_off.gradient(&measured) * (moment.x + moment.growth * along);
        (center.u_px, center.v_px) = (place.x, place.y);
    }
    array.grid = fit_found(&array.centers, &grid.lattice)?;
    let correction = array.grid.pitch_px / grid.pitch_px - 1.0;
    Ok((array, correction))
}
