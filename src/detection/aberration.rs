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

use nalgebra::{Matrix2x3, Matrix3, RealField, RowVector4, Scalar, Vector1, Vector2, Vector3};

use super::CornerLine;
use super::seen::Seen;
use crate::numerics::NormalEquations;

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
pub(super) struct Bend<T: Scalar = f64> {
    /// h, px.
    pub field: Vector2<T>,
    /// z², px².
    pub zone2: T,
    /// S, C and T over A, px⁻².
    coefficients: Vector3<T>,
}

/// z² over the square of the pupil's radius.
const ZONE: f64 = 2.0 / 3.0;
/// Before a frame was looked at, its aberrations move nothing by more than about this, px. It holds them down
/// where a few corners say nothing about them.
const MOST_PX: f64 = 1.0;
/// Aberrations show from so many σ on.
const SHOWS: f64 = 4.0;

impl Aberration {
    /// None, about the middle of the image, for a pupil of this radius.
    pub(super) fn none(middle_px: Vector2<f64>, pupil_px: f64) -> Self {
        let zone_px2 = ZONE * pupil_px.powi(2);
        Self { middle_px, zone_px2, coefficients_per_px2: Vector3::zeros() }
    }

    /// What it does in the micro-image about `center` to a corner whose line has a slope.
    pub(super) fn bend(&self, center: &Vector2<f64>, slope: f64) -> Bend {
        Bend {
            field: center - self.middle_px,
            zone2: self.zone_px2,
            coefficients: self.coefficients_per_px2 * (slope - 1.0),
        }
    }

    /// By how much S, C and T have to change for the observations of every corner to lie on a line. Aberrations
    /// that do not show in the frame are none: they would only add noise.
    pub(super) fn change<'a>(
        &self,
        corners: impl Iterator<Item = &'a [Seen]>,
    ) -> Option<Vector3<f64>> {
        let mut equations = NormalEquations::<f64, 3, 1>::new();
        let mut largest = Vector3::<f64>::zeros();
        let (mut squares, mut freedom) = (0.0, 0.0);
        for corner in corners {
            let rows: Vec<_> = corner.iter().flat_map(rows).collect();
            let mut line = NormalEquations::<f64, 3, 4>::new();
            for (row, measured) in &rows {
                line.add(row, measured, 1.0);
            }
            // What no line explains of the places must be explained by what no line explains of the levers (Frisch,
            // Waugh and Lovell).
            let Some(explained) = line.solve() else { continue };
            for (row, measured) in &rows {
                let left = (measured - row.transpose() * explained).transpose();
                equations.add(&-left.xyz(), &Vector1::new(left.w), 1.0);
                squares += left.w * left.w;
            }
            for seen in corner {
                let by = seen.levers.by_aberration.abs();
                largest = largest.sup(&by.row(0).sup(&by.row(1)).transpose());
            }
            freedom += rows.len() as f64 - 3.0;
        }
        for (i, unit) in Matrix3::identity().column_iter().enumerate() {
            equations.add(&(unit * largest[i]), &Vector1::zeros(), MOST_PX.powi(-2));
        }
        let change = equations.solve()?;
        let normal = equations.normal();
        let left = squares - change.dot(&(normal * change));
        let variance = (left / (freedom - 3.0)).max(1.0);
        let whole = self.coefficients_per_px2 + change;
        let shows = whole.dot(&(normal * whole)) > SHOWS.powi(2) * variance;
        Some(if shows { change } else { -self.coefficients_per_px2 })
    }

    /// With S, C and T changed.
    pub(super) fn changed(self, change: &Vector3<f64>) -> Self {
        Self { coefficients_per_px2: self.coefficients_per_px2 + change, ..self }
    }
}

/// The two equations of an observation: of the line in its β and γ, with the levers of S, C and T and the straightened
/// place on their right.
fn rows(seen: &Seen) -> [(Vector3<f64>, RowVector4<f64>); 2] {
    let observation = seen.on_line();
    let design = observation.whitened(&CornerLine::design(&observation.center));
    let by = observation.whitened(&seen.levers.by_aberration);
    let place = observation.whitened(&observation.position);
    [0, 1].map(|i| {
        let measured = RowVector4::new(by[(i, 0)], by[(i, 1)], by[(i, 2)], place[i]);
        (design.row(i).transpose(), measured)
    })
}

impl<T: RealField + Copy> Bend<T> {
    /// What one unit of S/A, C/A and T/A does at a place w of the pupil, px³.
    #[inline]
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
    #[inline]
    pub fn at(&self, pupil: &Vector2<T>) -> Vector2<T> {
        self.terms(pupil) * self.coefficients
    }
}

impl Bend {
    /// An ideal main lens.
    #[cfg(test)]
    pub fn none() -> Self {
        Self { field: Vector2::zeros(), zone2: 0.0, coefficients: Vector3::zeros() }
    }

    /// Whether there is any aberration.
    pub fn bends(&self) -> bool {
        self.coefficients != Vector3::zeros()
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

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix2, SMatrix};

    use super::super::CornerObservation;
    use super::super::corner::Corner;
    use super::super::levers::Levers;
    use super::*;

    const PUPIL_PX: f64 = 6.0;
    const STD_DEV_PX: f64 = 0.05;

    /// Corners all over an image of 1000 x 800 px, each in 25 micro-images, as sharp images show them: every
    /// observation has one ray. Errors of the given size follow no pattern.
    fn seen(aberration: &Aberration, error_px: f64) -> Vec<Vec<Seen>> {
        let mut noise = 1_u32;
        let mut error = || {
            noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            error_px * (f64::from(noise >> 8) / f64::from(1 << 23) - 1.0) * 3.0_f64.sqrt()
        };
        let slope = |i: i32| 0.72 + 0.02 * f64::from(i % 7);
        (0..60)
            .map(|i| {
                let pinhole = Vector2::new(f64::from(i % 10), f64::from(i / 10)) * 100.0
                    + Vector2::new(31.0, 87.0);
                let slope = slope(i);
                (-2..=2)
                    .flat_map(|l| (-2..=2).map(move |k| Vector2::new(f64::from(k), f64::from(l))))
                    .map(|node| {
                        let center = pinhole + node * 7.0;
                        // w = (γ − 1)(c − p) − E/A, by a few rounds.
                        let straight = (center - pinhole) * (slope - 1.0);
                        let bend = aberration.bend(&center, slope);
                        let w = (0..20).fold(straight, |w, _| straight - bend.at(&w));
                        let position = center + w + Vector2::new(error(), error());
                        Seen {
                            observation: CornerObservation {
                                k: 0,
                                l: 0,
                                center,
                                position,
                                covariance: Matrix2::identity() * STD_DEV_PX.powi(2),
                                squares: Matrix2::zeros(),
                            },
                            corner: Corner {
                                place: position - center,
                                angles: [0.0, 1.5],
                                level: 0.5,
                                contrast: 0.4,
                                width: 1.0,
                                covariance: Matrix2::identity(),
                                explained: 1.0,
                            },
                            slope_before: slope,
                            levers: Levers {
                                by_slope: Vector2::zeros(),
                                by_taken: SMatrix::zeros(),
                                by_aberration: bend.terms(&w) * (slope - 1.0),
                            },
                            width: None,
                        }
                    })
                    .collect()
            })
            .collect()
    }

    fn found(seen: &[Vec<Seen>]) -> Vector3<f64> {
        let none = Aberration::none(Vector2::new(500.0, 400.0), PUPIL_PX);
        none.change(seen.iter().map(Vec::as_slice)).unwrap()
    }

    #[test]
    fn aberrations_are_found_where_lines_bend() {
        let none = Aberration::none(Vector2::new(500.0, 400.0), PUPIL_PX);
        // A double Gauss at f/4.
        let truth = Vector3::new(5e-3, 2.4e-5, 4e-7);
        let exact = found(&seen(&none.changed(&truth), 0.0));
        assert!((exact - truth).component_div(&truth).amax() < 1e-3, "{exact}");
        let noisy = found(&seen(&none.changed(&truth), STD_DEV_PX));
        assert!((noisy - truth).component_div(&truth).amax() < 0.2, "{noisy}");
    }

    #[test]
    fn noise_is_no_aberration() {
        let none = Aberration::none(Vector2::new(500.0, 400.0), PUPIL_PX);
        assert_eq!(found(&seen(&none, STD_DEV_PX)), Vector3::zeros());
    }

    /// By hand: with h = (100, 0) and w = (3, 4), |w|² is 25 and h·w is 300.
    #[test]
    fn the_terms_are_those_of_seidel() {
        let aberration = Aberration::none(Vector2::zeros(), PUPIL_PX);
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
