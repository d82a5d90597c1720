//! Paraxial optics of a prescription: focal length, principal planes and pupils.

use nalgebra::{Matrix2, Vector2};

use super::prescription::Prescription;
use crate::error::{Error, Result};

/// Figures of a lens in air for rays close to the axis. Places are distances behind the first vertex, in
/// the unit of the prescription; negative in front of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Paraxial {
    pub focal_length: f64,
    /// H, from which object distances count.
    pub front_principal: f64,
    /// H', from which image distances count.
    pub rear_principal: f64,
    pub entrance_pupil: f64,
    pub exit_pupil: f64,
    /// p: diameter of the exit pupil over that of the entrance pupil.
    pub pupil_magnification: f64,
    /// Diameter of the stop over that of the entrance pupil.
    pub stop_magnification: f64,
}

impl Paraxial {
    /// An error if the lens does not form real images of far objects, or its pupil is upside down.
    pub fn of(lens: &Prescription) -> Result<Self> {
        let (stop, count) = (lens.stop(), lens.surfaces.len());
        let length: f64 =
            lens.surfaces[..count.saturating_sub(1)].iter().map(|s| s.thickness_mm).sum();
        // Matrices act on (height, index times slope): (1 t/n; 0 1) for a distance, and
        // (1 0; −(n'−n)/R 1) for a surface. The determinant is 1.
        let between = |first: usize, end: usize| {
            (first..end).fold(Matrix2::identity(), |before, i| {
                let surface = &lens.surfaces[i];
                let power = (surface.index - lens.index_before(i)) / surface.radius_mm;
                let distance =
                    if i + 1 < count { surface.thickness_mm / surface.index } else { 0.0 };
                Matrix2::new(1.0, distance, 0.0, 1.0) * Matrix2::new(1.0, 0.0, -power, 1.0) * before
            })
        };
        let (front, rear) = (between(0, stop), between(stop, count));
        let whole = rear * front;
        let focal_length = -1.0 / whole[(1, 0)];
        if !(focal_length > 0.0 && focal_length.is_finite()) {
            return Err(Error::invalid(
                "the lens does not collect light: its focal length is not positive. A radius is positive \
                 if its centre lies on the side of the image",
            ));
        }
        // The middle of the stop, seen through the rear group and through the front group.
        let seen = rear * Vector2::new(0.0, 1.0);
        let paraxial = Self {
            focal_length,
            front_principal: (1.0 - whole[(1, 1)]) * focal_length,
            rear_principal: length - (1.0 - whole[(0, 0)]) * focal_length,
            entrance_pupil: front[(0, 1)] / front[(0, 0)],
            exit_pupil: length - seen.x / seen.y,
            pupil_magnification: front[(0, 0)] / seen.y,
            stop_magnification: front[(0, 0)].abs(),
        };
        let pupil = paraxial.pupil_magnification;
        if !(pupil > 0.0 && pupil.is_finite() && paraxial.stop_magnification > 0.0) {
            return Err(Error::invalid(format!(
                "the exit pupil of the lens is {pupil} times its entrance pupil: the stop is imaged upside \
                 down or to infinity, which cannot be simulated; move it"
            )));
        }
        Ok(paraxial)
    }

    /// z of a place behind the first vertex when the lens is scaled to a focal length, mm: from H',
    /// positive towards the scene.
    pub fn z_mm(&self, place: f64, focal_length_mm: f64) -> f64 {
        (self.rear_principal - place) * focal_length_mm / self.focal_length
    }
}
