//! Shift of the centroids of micro-images by oblique light, and the array corrected for it.
//!
//! Light falls off with its angle of incidence, by cos⁴ and by the response of the pixels. So a micro-image off the
//! optical axis is brighter on one side, and its centroid is shifted in proportion to its distance from the axis. All
//! centres together seem to have another pitch. The shift depends on the micro-image: its light Ī(r) changes by −g·L Ī,
//! with the sensitivity L(r) of [`DiscLight::sensitivity`]. The window of a centroid that is off by ε holds −ε Ī′ more
//! light on that side. In a window w(r) the two effects balance at ε = −g X with
//!
//! ```text
//!     X = Σ w L Ī r² / Σ w (−Ī′) r²
//! ```
//!
//! over the rings of the mean micro-image as the image shows it. Clipped light changes nothing, and X accounts for a
//! window that cuts some of the light.
//!
//! [`DiscLight::sensitivity`]: super::disc_geometry::DiscLight::sensitivity

use nalgebra::Vector2;

use super::array::{ArrayMeasurement, FoundArray};
use super::array_search::fit_found;
use super::centroid::WINDOW;
use super::disc_geometry::{DiscGeometry, GROWTH};
use super::rings::{Alike, Ring};
use crate::error::Result;
use crate::model::FallOff;
use crate::optics::Obliquity;

/// Computes X (px²) of micro-images with these rings, in a window by distance.
fn shift_moment(
    rings: &[Ring],
    window: impl Fn(f64) -> f64,
    sensitivity: impl Fn(f64) -> f64,
) -> f64 {
    let (mut change, mut restoring) = (0.0, 0.0);
    for ring in rings {
        let weight = window(ring.radius) * ring.radius.powi(2);
        if weight > 0.0 {
            change += weight * ring.unclipped * sensitivity(ring.radius);
            restoring -= weight * ring.slope;
        }
    }
    if restoring > 0.0 { change / restoring } else { 0.0 }
}

/// Moments of the centroid shift of one lens type.
#[derive(Debug, Clone, Copy)]
pub(super) struct Moment {
    /// Moment X in the middle of the array, px².
    x: f64,
    /// Derivative of the shift over g in the middle, by the relative growth of d, px².
    growth: f64,
}

/// Computes the moments by lens type. `light` is the light of each type where the centroids were measured, `law` the
/// angular response inside a micro-image.
pub(super) fn shift_moments(
    light: &[Alike],
    geometry: &DiscGeometry,
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
        // The discs where d is larger; there g is smaller.
        let reach = rings.iter().map(|ring| ring.radius).fold(0.0, f64::max);
        let discs = |growth: f64| geometry.light(lens_type, growth, law, reach);
        let of_discs = |growth: f64| {
            let discs = discs(growth);
            let ring = |ring: &Ring| {
                let (light, slope) = discs.with_slope(ring.radius);
                Ring { light, unclipped: light, slope, ..*ring }
            };
            let rings: Vec<Ring> = rings.iter().map(ring).collect();
            shift_moment(&rings, window, |r| discs.sensitivity(r)) / (1.0 + growth)
        };
        let as_measured = discs(0.0);
        Moment {
            x: shift_moment(rings, window, |r| as_measured.sensitivity(r)),
            // Clipped light shifts nothing.
            growth: (of_discs(GROWTH) - of_discs(-GROWTH)) / (2.0 * GROWTH) * unclipped,
        }
    };
    light.iter().enumerate().map(of_type).collect()
}

/// Corrects the centres of the reference for the shift by the angular response. Returns the array and the relative
/// change of its pitch. `growth_per_px` is the relative growth of d over the image.
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Creates rings of light that falls from full to nothing about `edge`, clipped inside `clipped`.
    fn disc(edge: f64, clipped: f64) -> Vec<Ring> {
        let ring = |i: u32| {
            let radius = (f64::from(i) + 0.5) * 0.25;
            let at = |r: f64| (edge + 1.0 - r).clamp(0.0, 2.0) / 2.0;
            let light = at(radius);
            Ring {
                radius,
                light,
                unclipped: if radius < clipped { 0.0 } else { light },
                slope: (at(radius + 0.01) - at(radius - 0.01)) / 0.02,
                ..Ring::default()
            }
        };
        (0..80).map(ring).collect()
    }

    /// A disc of radius a whose light changes by −g·y has the centroid −g a²/4. Here a is 5 to 7, in equal parts by
    /// light of the edge, and ⟨a⁴⟩/4⟨a²⟩ = 1368.2/145.3.
    #[test]
    fn an_open_window_sees_the_whole_moment() {
        let x = shift_moment(&disc(6.0, 0.0), |_| 1.0, |r| r);
        assert!((x - 9.415).abs() < 0.05, "{x}");
    }

    /// Only the fall of the window itself holds the centroid if the window ends inside the light.
    #[test]
    fn a_window_that_cuts_the_light_amplifies_the_shift() {
        let window = |r: f64| ((7.0 - r) / 2.0).clamp(0.0, 1.0);
        let x = shift_moment(&disc(6.0, 0.0), window, |r| r);
        assert!(x > 12.0, "{x}");
    }

    #[test]
    fn clipped_light_shifts_nothing() {
        let open = |_: f64| 1.0;
        let x = |clipped| shift_moment(&disc(6.0, clipped), open, |r| r);
        assert!(x(5.0) < 0.6 * x(0.0), "{} {}", x(5.0), x(0.0));
        assert!(x(8.0).abs() < 1e-12);
    }
}
