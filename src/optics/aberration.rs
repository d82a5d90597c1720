//! The aberrations of the main lens, as micro-images show them.
//!
//! A micro-image is an image of the pupil: what it shows at w from its centre c came through the place of
//! the pupil that is seen there. An ideal main lens sends all light from a point to one pinhole image p, and
//! c − p = A w, with A = 1/(γ − 1) for a line of the slope γ. A real one moves each ray where it meets the
//! array, by E(w):
//!
//!   c − p = A w + E(w),  E(w) = S w (|w|² − z²) + C (2 w (h·w) + h |w|²) + T h (h·w),
//!
//! spherical aberration, coma and astigmatism of the third order (Seidel) at the place h from the middle of the
//! image. E does not depend on the distance of the point: what turns a ray at the pupil by an angle moves it
//! at the array by D times that angle. Field curvature and distortion change A and p of each corner, which are
//! free anyway.
//!
//! Straightened places w + E(w)/A lie on the line of a corner, which so is that of rays near the middle of the
//! pupil, focused as those through the zone z are. Which zone is a choice: an S with another z is the same with
//! another A. With z² = 2a²/3, the best focus, S and A are hardly correlated, and S is often not known well.
//!
//! Each ray of the blur is moved by E at its own place in the pupil. A blur that is the same for all hides three
//! quarters of the aberration, and turns them into errors of the places.

use nalgebra::{Scalar, Vector2, Vector3};

/// Aberrations of the third order, on the scale of micro-images.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Aberration {
    /// Where h is 0, px.
    pub middle_px: Vector2<f64>,
    /// z², px².
    pub zone_px2: f64,
    /// S, C and T, px⁻².
    pub coefficients_per_px2: Vector3<f64>,
}

/// E(w)/A: how far the aberrations bend the line of a corner in one micro-image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Bend<T: Scalar = f64> {
    /// h, px.
    pub field: Vector2<T>,
    /// z², px².
    pub zone2: T,
    /// S, C and T over A, px⁻².
    pub coefficients: Vector3<T>,
}

/// z² over the square of the pupil's radius.
const ZONE: f64 = 2.0 / 3.0;
impl Aberration {
    /// None, about the middle of the image, for a pupil of this radius.
    pub(crate) fn none(middle_px: Vector2<f64>, pupil_px: f64) -> Self {
        let zone_px2 = ZONE * pupil_px.powi(2);
        Self { middle_px, zone_px2, coefficients_per_px2: Vector3::zeros() }
    }

    /// What it does in the micro-image about `center` to a corner whose line has a slope.
    pub(crate) fn bend(&self, center: &Vector2<f64>, slope: f64) -> Bend {
        Bend {
            field: center - self.middle_px,
            zone2: self.zone_px2,
            coefficients: self.coefficients_per_px2 * (slope - 1.0),
        }
    }

    /// With S, C and T changed.
    pub(crate) fn changed(self, change: &Vector3<f64>) -> Self {
        Self { coefficients_per_px2: self.coefficients_per_px2 + change, ..self }
    }
}

impl Bend {
    /// An ideal main lens.
    pub fn none() -> Self {
        Self { field: Vector2::zeros(), zone2: 0.0, coefficients: Vector3::zeros() }
    }

    /// In single precision, as the light.
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
    /// A bound of |E(w)/A| in a pupil of this radius, px.
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
    /// What one unit of S/A, C/A and T/A does at a place w of the pupil, px³.
    pub fn terms(&self, pupil: &Vector2<f64>) -> nalgebra::Matrix2x3<f64> {
        let square = pupil.norm_squared();
        let along = self.field.dot(pupil);
        nalgebra::Matrix2x3::from_columns(&[
            pupil * (square - self.zone2),
            pupil * (along + along) + self.field * square,
            self.field * along,
        ])
    }

    /// E(w)/A, px.
    pub fn at(&self, pupil: &Vector2<f64>) -> Vector2<f64> {
        self.terms(pupil) * self.coefficients
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix2x3;

    use super::*;

    /// By hand: with h = (100, 0) and w = (3, 4), |w|² is 25 and h·w is 300.
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
