//! The aberrations of the main lens, as micro-images show them.
//!
//! A micro-image is an image of the pupil: what it shows at w from its centre c came through the place of
//! the pupil that is seen there. An ideal main lens sends all light from a point to one pinhole image p, and
//! c − p = A w, with A = 1/(γ − 1) for a line of the slope γ. A real one moves each ray where it meets the
//! array, by E(w):
//!
//!   c − p = A w + E(w),  E(w) = S w|w|² + C (2 w (h·w) + h |w|²) + T h (h·w),
//!
//! spherical aberration, coma and astigmatism of the third order (Seidel) at the place h from the middle of the
//! image. E does not depend on the distance of the point: what turns a ray at the pupil by an angle moves it
//! at the array by D times that angle. Field curvature and distortion change A and p of each corner, which are
//! free anyway.
//!
//! Straightened places w + E(w)/A lie on the line of a corner. In the blur each ray is moved by E at its own
//! place in the pupil: with one blur radius for all, three quarters of the aberration would be hidden.

use nalgebra::{
    Matrix2x3, Matrix3, Matrix3x2, RealField, RowVector4, Scalar, Vector1, Vector2, Vector3,
};

use super::seen::Seen;
use crate::numerics::NormalEquations;

/// Aberrations of the third order.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Aberration {
    /// Where h is 0, px.
    middle: Vector2<f64>,
    /// z², px².
    zone2: f64,
    /// S, C and T, px⁻².
    coefficients: Vector3<f64>,
}

/// E(w)/A: how far the aberrations bend the line of a corner in one micro-image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Bend<T: Scalar = f64> {
    /// h, px.
    field: Vector2<T>,
    /// z², px².
    zone2: T,
    /// S, C and T over A, px⁻².
    coefficients: Vector3<T>,
}

/// Before a frame was looked at, its aberrations move nothing by more than about this, px. It holds them down
/// where a few corners say nothing about them.
const ZONE2: f64 = 2.0 / 3.0;
const MOST_PX: f64 = 1.0;
/// Rounds in which the place that is seen is found from the straightened one.
const ROUNDS: usize = 5;

impl Aberration {
    /// None, about the middle of the image.
    pub fn none(middle: Vector2<f64>, pupil_px: f64, zone: f64) -> Self {
        Self { middle, zone2: zone * pupil_px * pupil_px, coefficients: Vector3::zeros() }
    }

    /// What it does in the micro-image about `center` to a corner whose line has a slope.
    pub fn bend(&self, center: &Vector2<f64>, slope: f64) -> Bend {
        Bend {
            field: center - self.middle,
            zone2: self.zone2,
            coefficients: self.coefficients * (slope - 1.0),
        }
    }

    /// By how much its coefficients have to change for the observations of every corner to lie on a line; `None`
    /// if nothing is seen.
    pub fn change<'a>(corners: impl Iterator<Item = &'a [Seen]> + Clone) -> Option<Vector3<f64>> {
        let mut equations = NormalEquations::<f64, 3, 1>::new();
        let mut most = Vector3::<f64>::zeros();
        for corner in corners {
            // What the line itself cannot explain, by Frisch, Waugh and Lovell.
            let rows = |seen: &Seen| {
                let on_line = seen.on_line();
                let c = on_line.center;
                let rows = Matrix3x2::new(1.0, 0.0, 0.0, 1.0, c.x, c.y);
                let weight = on_line.std_dev_px.powi(-2);
                [0, 1].map(|axis| {
                    let by = seen.levers.by_aberration.row(axis);
                    let measured = RowVector4::new(by[0], by[1], by[2], on_line.position[axis]);
                    (rows.column(axis).into_owned(), measured, weight)
                })
            };
            let mut line = NormalEquations::<f64, 3, 4>::new();
            for (row, measured, weight) in corner.iter().flat_map(rows) {
                line.add(&row, &measured, weight);
            }
            let Some(explained) = line.solve() else { continue };
            for (row, measured, weight) in corner.iter().flat_map(rows) {
                let left = measured - row.transpose() * explained;
                equations.add(
                    &-left.fixed_columns::<3>(0).transpose(),
                    &Vector1::new(left[3]),
                    weight,
                );
                most = most.sup(&measured.fixed_columns::<3>(0).transpose().abs());
            }
        }
        for (size, held) in most.iter().zip(Matrix3::identity().column_iter()) {
            let f = if held[0] == 1.0 {
                std::env::var("HOLD_S").map_or(1.0, |x| x.parse().unwrap())
            } else {
                1.0
            };
            equations.add(&(held * *size * f), &Vector1::zeros(), MOST_PX.powi(-2));
        }
        equations.solve()
    }

    /// With coefficients that differ by so much.
    pub fn changed(self, change: &Vector3<f64>) -> Self {
        Self { coefficients: self.coefficients + change, ..self }
    }
}

impl<T: RealField + Copy> Bend<T> {
    /// What one unit of S/A, C/A and T/A does at a place w of the pupil, px³.
    pub fn terms(&self, pupil: &Vector2<T>) -> Matrix2x3<T> {
        let square = pupil.norm_squared();
        let along = self.field.dot(pupil);
        Matrix2x3::from_columns(&[
            pupil * (square - self.zone2),
            pupil * (along + along) + self.field * square,
            self.field * along,
        ])
    }

    /// E(w)/A, px.
    pub fn at(&self, pupil: &Vector2<T>) -> Vector2<T> {
        self.terms(pupil) * self.coefficients
    }
}

impl Bend {
    /// An ideal main lens.
    pub fn none() -> Self {
        Self { field: Vector2::zeros(), zone2: 0.0, coefficients: Vector3::zeros() }
    }

    /// Where a straightened place is seen, from the centre of the micro-image, px.
    pub fn seen(&self, straight: &Vector2<f64>) -> Vector2<f64> {
        (0..ROUNDS).fold(*straight, |seen, _| straight - self.at(&seen))
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
