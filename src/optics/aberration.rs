//! Aberrations of the main lens in micro-images.
//!
//! A micro-image is an image of the pupil: light at the position w from its centre c has passed the point of the pupil that the
//! micro-lens images there. An ideal main lens sends all light from a point to one pinhole image p, and c − p = A w, with
//! A = 1/(γ − 1) for a line of slope γ. A real lens displaces each ray by E(w) where it meets the array:
//!
//!   c − p = A w + E(w),  E(w) = S w (|w|² − z²) + 2 w (b·w) + b |w|² + M w,  b = C h,  M = T (h hᵀ − |h|²/2).
//!
//! The terms are spherical aberration, coma and astigmatism of the third order (Seidel), where h is the position relative to
//! the optical axis. E does not depend on the distance of the point: a ray deflected by an angle at the pupil moves by D times
//! this angle at the array. Field curvature and distortion change A and p of each corner, which are free anyway. M has no trace:
//! A is in the middle between sagittal and tangential focus, so that an error of T is no field curvature.
//!
//! Corrected positions w + E(w)/A lie on the line of a corner: the line of rays near the middle of the pupil, which are focused
//! like the rays through the zone z. The choice of the zone is free: an S with another z equals the same S with another A. With
//! z² = 2a²/3, the best focus, S and A are hardly correlated; S is often not well determined.
//!
//! Where the array is further from the sensor than in the middle, by the fraction g, images of the pupil are larger: w belongs to
//! the point w/(1 + g) of the pupil. So S, b and M are smaller by (1 + g)³, (1 + g)² and 1 + g, and z is larger by 1 + g.
//!
//! E displaces each ray of the blur according to its own point of the pupil. The same blur for all rays would hide three
//! quarters of the aberration, and turn them into errors of position.

use nalgebra::{SMatrix, SVector, Scalar, Vector2, Vector3, Vector5};

/// Aberrations of the third order, on the scale of micro-images.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Aberration {
    /// Optical axis: the point of the image where h = 0, px.
    pub axis_px: Vector2<f64>,
    /// Square z² of the zone, px².
    pub zone_px2: f64,
    /// Coefficients S, C and T, px⁻².
    pub coefficients_per_px2: Vector3<f64>,
}

/// Aberrations with their errors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct AberrationEstimate {
    pub aberration: Aberration,
    /// Cholesky factor of the covariance of S, C, T and the axis for known ln φ: its columns are independent errors of one
    /// standard deviation.
    pub errors: SMatrix<f64, UNKNOWNS, UNKNOWNS>,
    /// Derivatives of S, C, T and the axis by ln φ.
    pub by_log_ratio: SVector<f64, UNKNOWNS>,
}

/// Transverse aberration E(w)/A of a corner in one micro-image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Bend<T: Scalar = f64> {
    /// Square z² of the zone, px².
    pub zone2: T,
    /// S, b along u and v, and M along uu (and −vv) and uv, over A: px⁻², px⁻¹ and without unit.
    pub coefficients: Vector5<T>,
}

/// Number of unknowns of [`Aberration`]: S, C, T, and the axis along u and v.
pub(crate) const UNKNOWNS: usize = 5;
/// Number of coefficients of [`field_terms`].
pub(crate) const FIELD: usize = 9;

/// z² over the squared radius of the pupil.
const ZONE: f64 = 2.0 / 3.0;

/// Returns S, b and M at a position x of the image, in the order of [`Bend`], as a linear function of nine coefficients:
///
///   b = C x + b₀,  M = T x xᵀ + x kᵀ + k xᵀ + M₀ without its trace,
///
/// in the order S, C, b₀, T, k, M₀. Without h = x − axis, which is not linear, the sums of squares of all frames can be added.
pub(crate) fn field_terms(x: &Vector2<f64>) -> SMatrix<f64, 5, FIELD> {
    let (u, v) = (x.x, x.y);
    SMatrix::from_columns(&[
        [1.0, 0.0, 0.0, 0.0, 0.0].into(),
        [0.0, u, v, 0.0, 0.0].into(),
        [0.0, 1.0, 0.0, 0.0, 0.0].into(),
        [0.0, 0.0, 1.0, 0.0, 0.0].into(),
        [0.0, 0.0, 0.0, (u * u - v * v) / 2.0, u * v].into(),
        [0.0, 0.0, 0.0, u, v].into(),
        [0.0, 0.0, 0.0, -v, u].into(),
        [0.0, 0.0, 0.0, 1.0, 0.0].into(),
        [0.0, 0.0, 0.0, 0.0, 1.0].into(),
    ])
}

/// Returns the factors of S, b and M where d is larger by the fraction `growth`.
pub(crate) fn smaller_by_growth(growth: f64) -> Vector5<f64> {
    let inverse = 1.0 / (1.0 + growth);
    let (squared, cubed) = (inverse * inverse, inverse * inverse * inverse);
    Vector5::new(cubed, squared, squared, inverse, inverse)
}

impl Aberration {
    /// Creates an ideal main lens, for a pupil of this radius, with the optical axis at `axis_px`.
    pub(crate) fn none(axis_px: Vector2<f64>, pupil_px: f64) -> Self {
        let zone_px2 = ZONE * pupil_px.powi(2);
        Self { axis_px, zone_px2, coefficients_per_px2: Vector3::zeros() }
    }

    /// Returns the aberration in the micro-image about `center`, where d is larger by the fraction `growth`, for a corner with a
    /// line of this slope.
    pub(crate) fn bend(&self, center: &Vector2<f64>, growth: f64, slope: f64) -> Bend {
        Bend {
            zone2: self.zone_px2 * (1.0 + growth).powi(2),
            coefficients: self.at(center, growth) * (slope - 1.0),
        }
    }

    /// Returns S, b and M in the micro-image about `center`, where d is larger by the fraction `growth`.
    pub(crate) fn at(&self, center: &Vector2<f64>, growth: f64) -> Vector5<f64> {
        (field_terms(center) * self.of_field()).component_mul(&smaller_by_growth(growth))
    }

    /// Returns the coefficients of [`field_terms`].
    pub(crate) fn of_field(&self) -> SVector<f64, FIELD> {
        let [s, c, t] = self.coefficients_per_px2.into();
        let (u, v) = (self.axis_px.x, self.axis_px.y);
        [s, c, -c * u, -c * v, t, -t * u, -t * v, t * (u * u - v * v) / 2.0, t * u * v].into()
    }

    /// Returns the derivatives of [`Self::of_field`] by S, C, T and the axis.
    pub(crate) fn of_field_by_unknowns(&self) -> SMatrix<f64, FIELD, UNKNOWNS> {
        let [_, c, t] = self.coefficients_per_px2.into();
        let (u, v) = (self.axis_px.x, self.axis_px.y);
        SMatrix::from_columns(&[
            SVector::from([1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
            SVector::from([0.0, 1.0, -u, -v, 0.0, 0.0, 0.0, 0.0, 0.0]),
            SVector::from([0.0, 0.0, 0.0, 0.0, 1.0, -u, -v, (u * u - v * v) / 2.0, u * v]),
            SVector::from([0.0, 0.0, -c, 0.0, 0.0, -t, 0.0, t * u, t * v]),
            SVector::from([0.0, 0.0, 0.0, -c, 0.0, 0.0, -t, -t * v, t * u]),
        ])
    }
}

impl AberrationEstimate {
    /// Creates a main lens without aberrations, of which nothing was estimated.
    pub fn none(ideal: Aberration) -> Self {
        Self { aberration: ideal, errors: SMatrix::zeros(), by_log_ratio: SVector::zeros() }
    }

    /// Returns the optical axis, px, if its standard deviation along u and v is known and at most `largest_px`.
    pub fn axis_within(&self, largest_px: f64) -> Option<Vector2<f64>> {
        let std_devs = [3, 4].map(|row| self.errors.row(row).norm());
        tracing::debug!("optical axis {:?} ± {std_devs:?} px", self.aberration.axis_px);
        let is_known = std_devs.iter().all(|std_dev| *std_dev > 0.0 && *std_dev <= largest_px);
        is_known.then_some(self.aberration.axis_px)
    }
}

impl Bend {
    /// Creates the aberration of an ideal main lens, which is 0.
    pub fn none() -> Self {
        Self { zone2: 0.0, coefficients: Vector5::zeros() }
    }

    /// Returns the aberration in single precision, like the light.
    #[allow(clippy::cast_possible_truncation)]
    pub fn in_single(&self) -> Bend<f32> {
        Bend { zone2: self.zone2 as f32, coefficients: self.coefficients.map(|x| x as f32) }
    }
}

impl Bend<f32> {
    /// Returns an upper bound of |E(w)/A| in a pupil of this radius, px.
    pub fn largest(&self, pupil: f32) -> f32 {
        let [spherical, coma_u, coma_v, uu, uv] = self.coefficients.into();
        let square = pupil * pupil;
        spherical.abs() * pupil * square.max(self.zone2)
            + coma_u.hypot(coma_v) * 3.0 * square
            + uu.hypot(uv) * pupil
    }
}

#[cfg(test)]
impl Bend {
    /// Returns the derivatives of E(w)/A by its coefficients at the point w of the pupil.
    pub fn terms(&self, pupil: &Vector2<f64>) -> nalgebra::Matrix2x5<f64> {
        let square = pupil.norm_squared();
        let (x, y) = (pupil.x, pupil.y);
        nalgebra::Matrix2x5::from_columns(&[
            pupil * (square - self.zone2),
            pupil * (2.0 * x) + Vector2::new(square, 0.0),
            pupil * (2.0 * y) + Vector2::new(0.0, square),
            Vector2::new(x, -y),
            Vector2::new(y, x),
        ])
    }

    /// Returns E(w)/A, px.
    pub fn at(&self, pupil: &Vector2<f64>) -> Vector2<f64> {
        self.terms(pupil) * self.coefficients
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Compares with terms calculated by hand: for h = (100, 0) and w = (3, 4), |w|² is 25 and h·w is 300. z² = 2/3 · 36 = 24.
    #[test]
    fn the_terms_are_those_of_seidel() {
        let axis = Vector2::new(20.0, -30.0);
        let by_hand = [
            Vector2::new(3.0, 4.0),
            Vector2::new(600.0 * 3.0 + 2500.0, 600.0 * 4.0),
            // h (h·w) − |h|² w/2.
            Vector2::new(15_000.0, -20_000.0),
        ];
        for (i, expected) in by_hand.into_iter().enumerate() {
            let mut aberration = Aberration::none(axis, 6.0);
            aberration.coefficients_per_px2[i] = 1.0;
            let center = Vector2::new(120.0, -30.0);
            let bend = aberration.bend(&center, 0.0, 0.75);
            let found = bend.at(&Vector2::new(3.0, 4.0));
            assert!((found + expected * 0.25).norm() < 1e-9, "{i}: {found}");
            // Where d is larger by a fifth, the ray arrives at 1.2 w.
            let found = aberration.bend(&center, 0.2, 0.75).at(&Vector2::new(3.6, 4.8));
            assert!((found + expected * 0.25).norm() < 1e-9, "{i}: {found}");
        }
    }

    #[test]
    fn derivatives_by_coefficients_and_axis_are_those_of_the_field() {
        let center = Vector2::new(310.0, -170.0);
        let with = |x: &SVector<f64, UNKNOWNS>| Aberration {
            axis_px: x.fixed_rows::<2>(3).into_owned(),
            zone_px2: 24.0,
            coefficients_per_px2: x.fixed_rows::<3>(0).into_owned(),
        };
        let at = SVector::from([3e-3, 2e-5, -4e-7, 40.0, -25.0]);
        let steps = [1e-5, 1e-7, 1e-9, 0.5, 0.5];
        let found = field_terms(&center) * with(&at).of_field_by_unknowns();
        for (i, step) in steps.into_iter().enumerate() {
            let moved = |by: f64| {
                let mut x = at;
                x[i] += by;
                with(&x).at(&center, 0.0)
            };
            let expected = (moved(step) - moved(-step)) / (2.0 * step);
            let error = (found.column(i) - expected).norm();
            assert!(error < 1e-9 * expected.norm(), "{i}: {error}");
        }
    }

    #[test]
    fn an_axis_is_known_if_its_error_is_known_and_small() {
        let aberration = Aberration::none(Vector2::new(500.0, 400.0), 6.0);
        let none = AberrationEstimate::none(aberration);
        assert_eq!(none.axis_within(20.0), None);
        let mut errors = SMatrix::identity();
        (errors[(3, 3)], errors[(4, 3)], errors[(4, 4)]) = (15.0, 12.0, 16.0);
        let found = AberrationEstimate { errors, ..none };
        // Along v, σ is √(12² + 16²) = 20 px.
        assert_eq!(found.axis_within(20.1), Some(aberration.axis_px));
        assert_eq!(found.axis_within(19.9), None);
    }
}
