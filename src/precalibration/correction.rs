//! The array with centres as they would be without oblique light.

use nalgebra::Vector2;

use super::array::{ArrayMeasurement, FoundArray, fit_found};
use super::centroid::WINDOW;
use super::centroid_shift::shift_moment;
use super::levers::{GROWTH, Levers};
use super::rings::{Alike, Ring};
use crate::error::Result;
use crate::model::FallOff;
use crate::vignetting::Obliquity;

/// How far the centroids of one lens type are shifted: see [`super::centroid_shift`].
#[derive(Debug, Clone, Copy)]
pub(super) struct Moment {
    /// X in the middle of the array, px².
    x: f64,
    /// What the shift over g in the middle grows by where d grows, over the relative growth of d, px².
    growth: f64,
}

/// Step of the slope of light, px.
const STEP_PX: f64 = 0.1;

/// The moments by lens type. `light` is that of each type where the centroids were measured, `law` how
/// it falls off inside a micro-image.
pub(super) fn shift_moments(
    light: &[Alike],
    levers: &Levers,
    pitch_px: f64,
    law: &Obliquity,
) -> Vec<Moment> {
    let (inner, outer) = (WINDOW.0 * pitch_px, WINDOW.1 * pitch_px);
    let window =
        |r: f64| ((outer * outer - r * r) / (outer * outer - inner * inner)).clamp(0.0, 1.0);
    let of_type = |(lens_type, alike): (usize, &Alike)| {
        let rings = &alike.mean;
        let sum = |light: fn(&Ring) -> f64| rings.iter().map(|r| r.radius * light(r)).sum::<f64>();
        let unclipped = sum(|ring| ring.unclipped) / sum(|ring| ring.light).max(1e-9);
        // As the discs have it where d is larger: there g is smaller.
        let of_discs = |growth: f64| {
            let at = |r: f64| levers.light_and_lever(lens_type, r, growth, law);
            let ring = |ring: &Ring| {
                let (light, _) = at(ring.radius);
                let slope = at(ring.radius + STEP_PX).0 - at(ring.radius - STEP_PX).0;
                Ring { light, unclipped: light, slope: slope / (2.0 * STEP_PX), ..*ring }
            };
            let rings: Vec<Ring> = rings.iter().map(ring).collect();
            shift_moment(&rings, window, |r| at(r).1) / (1.0 + growth)
        };
        Moment {
            x: shift_moment(rings, window, |r| levers.lever(lens_type, r, law)),
            // Light that is clipped shifts nothing.
            growth: (of_discs(GROWTH) - of_discs(-GROWTH)) / (2.0 * GROWTH) * unclipped,
        }
    };
    light.iter().enumerate().map(of_type).collect()
}

/// The array of the reference, its centres less the shift by the fall-off, and the relative change of the
/// pitch by that. d grows over the image by `growth_per_px`.
pub(super) fn corrected_array(
    found: &FoundArray,
    fall_off: &FallOff,
    moments: &[Moment],
    growth_per_px: &Vector2<f64>,
) -> Result<(ArrayMeasurement, f64)> {
    let grid = &found.array.grid;
    let mut array = found.array.clone();
    for center in &mut array.centers {
        let moment = &moments[grid.lattice.lens_type(center.k, center.l, moments.len())];
        let measured = Vector2::new(center.u_px, center.v_px);
        let growth = growth_per_px.dot(&(measured - grid.center_px));
        let place = measured + fall_off.gradient(&measured) * (moment.x + moment.growth * growth);
        (center.u_px, center.v_px) = (place.x, place.y);
    }
    array.grid = fit_found(&array.centers, &grid.lattice)?;
    let correction = array.grid.pitch_px / grid.pitch_px - 1.0;
    Ok((array, correction))
}
