//! Aberrations of the main lens in micro-images.
//!
//! A micro-image is an image of the pupil: light at the position w from its centre c has passed the point of the pupil that the
//! micro-lens images there. An ideal main lens sends all light from a point to one pinhole image p, and c − p = A w, with
//! A = 1/(γ − 1) for a line of slope γ. A real lens displaces each ray by E(w) where it meets the array:
//!
//!   c − p = A w + E(w),  E(w) = S w (|w|² − z²) + C (2 w (h·w) + h |w|²) + T h (h·w),
//!
//! The terms are spherical aberration, coma and astigmatism of the third order (Seidel), where h is the position relative to
//! the middle of the image. E does not depend on the distance of the point: a ray deflected by an angle at the pupil moves by D
//! times this angle at the array. Field curvature and distortion change A and p of each corner, which are free anyway.
//!
//! Corrected positions w + E(w)/A lie on the line of a corner: the line of rays near the middle of the pupil, which are focused
//! like the rays through the zone z. The choice of the zone is free: an S with another z equals the same S with another A. With
//! z² = 2a²/3, the best focus, S and A are hardly correlated; S is often not well determined.
//!
//! E displaces each ray of the blur according to its own point of the pupil. The same blur for all rays would hide three
//! quarters of the aberration, and turn them into errors of position.

use nalgebra::{Scalar, Vector2, Vector3};

/// Aberrations of the third order, on the scale of micro-images.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Aberration {
    /// Point of the image where h = 0, px.
    pub middle_px: Vector2<f64>,
    /// Square z² of the zone, px².
    pub zone_px2: f64,
    /// Coefficients S, C and T, px⁻².
    pub coefficients_per_px2: Vector3<f64>,
}

/// Transverse aberration E(w)/A of a corner in one micro-image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Bend<T: Scalar = f64> {
    /// Position h, px.
    pub field: Vector2<T>,
    /// Square z² of the zone, px².
    pub zone2: T,
    /// Coefficients S, C and T over A, px⁻².
    pub coefficients: Vector3<T>,
}

/// z² over the squared radius of the pupil.
const ZONE: f64 = 2.0 / 3.0;
impl Aberration {
    /// Creates an ideal main lens, for a pupil of this radius, with h = 0 at `middle_px`.
    pub(crate) fn none(middle_px: Vector2<f64>, pupil_px: f64) -> Self {
        let zone_px2 = ZONE * pupil_px.powi(2);
        Self { middle_px, zone_px2, coefficients_per_px2: Vector3::zeros() }
    }

    /// Returns the aberration in the micro-image about `center`, for a corner with a line of this slope.
    pub(crate) fn bend(&self, center: &Vector2<f64>, slope: f64) -> Bend {
        Bend {
            field: center - self.middle_px,
            zone2: self.zone_px2,
            coefficients: self.coefficients_per_px2 * (slope - 1.0),
        }
    }

    /// Returns the aberrations with a change added to S, C and T.
    pub(crate) fn changed(self, change: &Vector3<f64>) -> Self {
        Self { coefficients_per_px2: self.coefficients_per_px2 + change, ..self }
    }
}

impl Bend {
    /// Creates the aberration of an ideal main lens, which is 0.
    pub fn none() -> Self {
        Self { field: Vector2::zeros(), zone2: 0.0, coefficients: Vector3::zeros() }
    }

    /// Returns the aberration in single precision, like the light.
    #[allow(clippy::cast_possible_truncation)]
    pub fn in_single(&self) -> Bend<f32> {
        Bend {
            field: self.field.map(|x| x as f32),
            zone2: self.zone2 as f32,
            coefficients: self.coefficients.map(|x| x as f32),
        }
    }
}

impl Bend<f32> {
    /// Returns an upper bound of |E(w)/A| in a pupil of this radius, px.
    pub fn largest(&self, pupil: f32) -> f32 {
        let [spherical, coma, astigmatism] = self.coefficients.map(f32::abs).into();
        let (square, field) = (pupil * pupil, self.field.norm());
        spherical * pupil * square.max(self.zone2)
            + coma * 3.0 * field * square
            + astigmatism * field * field * pupil
    }
}

#[cfg(test)]
impl Bend {
    /// Returns the derivatives of E(w)/A by S/A, C/A and T/A at the point w of the pupil, px³.
    pub fn terms(&self, pupil: &Vector2<f64>) -> nalgebra::Matrix2x3<f64> {
        let square = pupil.norm_squared();
        let along = self.field.dot(pupil);
        nalgebra::Matrix2x3::from_columns(&[
            pupil * (square - self.zone2),
            pupil * (along + along) + self.field * square,
            self.field * along,
        ])
    }

    /// Returns E(w)/A, px.
    pub fn at(&self, pupil: &Vector2<f64>) -> Vector2<f64> {
        self.terms(pupil) * self.coefficients
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix2x3;

    use super::*;

    /// Compares with terms calculated by hand: for h = (100, 0) and w = (3, 4), |w|² is 25 and h·w is 300.
    #[test]
    fn the_terms_are_those_of_seidel() {
        let aberration = Aberration::none(Vector2::zeros(), 6.0);
        let bend = aberration.bend(&Vector2::new(100.0, 0.0), 0.75);
        let terms = bend.terms(&Vector2::new(3.0, 4.0));
        let by_hand = Matrix2x3::from_columns(&[
            Vector2::new(3.0, 4.0),
            Vector2::new(600.0 * 3.0 + 2500.0, 600.0 * 4.0),
            Vector2::new(30_000.0, 0.0),
        ]);
        // z² = 2/3 · 36 = 24.
        assert!((terms - by_hand).norm() < 1e-9, "{terms}");
    }
}
