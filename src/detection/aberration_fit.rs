//! Estimation of the aberrations of the main lens and its optical axis from the bending of the lines of corners.
//!
//! A wrong blur radius bends lines too, since the rim of the pupil then moves positions like spherical aberration: an aperture
//! ratio that is 8 % too large has the effect of a double Gauss lens. The aperture ratio is therefore estimated first, from the
//! widths of edges. Positions move with it, and then give the aberrations.

use nalgebra::{Matrix2x3, SMatrix, SVector, Vector2, Vector3};

use super::corner_measurement::CornerMeasurement;
use super::edge_width::EdgeWidth;
use super::{Aberration, CornerLine, MicroImages};
use crate::model::taken::APERTURE_RATIO;
use crate::numerics::NormalEquations;
use crate::optics::aberration::{AberrationEstimate, FIELD, UNKNOWNS, field_terms};

/// Prior standard deviation of the displacement by aberrations, px. It limits them if a few corners hardly determine them.
const MOST_PX: f64 = 1.0;
/// Decrease of the sum of squares, in variances, that significant aberrations exceed: the 99.3 % quantile of χ² with five
/// degrees of freedom.
const SHOWS: f64 = 16.0;
/// Largest number of Gauss-Newton steps, and change of the cost, over the variance, at which they end.
const STEPS: usize = 30;
const SETTLED: f64 = 1e-6;

/// Columns of the equations of an observation: its position, and the derivatives of the position by ln φ and by the
/// coefficients of [`field_terms`].
const COLUMNS: usize = 2 + FIELD;
const PLACE: usize = 0;
const BY_RATIO: usize = 1;
const BY_FIELD: usize = 2;

/// Information of corners about ln φ and the aberrations. The information of several frames is the sum of theirs.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct AberrationInformation {
    /// Sum of products of the equations, with their lines projected out, as a function of (1, ln φ, coefficients).
    products: SMatrix<f64, COLUMNS, COLUMNS>,
    /// Largest derivatives of a position by S, C and T, px³.
    largest: Vector3<f64>,
    /// Number of equations that are left.
    freedom: f64,
}

impl AberrationInformation {
    /// Creates information about nothing.
    pub fn none() -> Self {
        Self { products: SMatrix::zeros(), largest: Vector3::zeros(), freedom: 0.0 }
    }

    /// Returns the information of corners that were measured with an aberration, and the information of their edges about the
    /// change of ln φ.
    pub fn of<'a>(
        aberration: &Aberration,
        micro_images: &MicroImages,
        corners: impl Iterator<Item = &'a [CornerMeasurement]>,
    ) -> (Self, Vec<EdgeWidth>) {
        let mut found = Self::none();
        let mut widths = Vec::new();
        let log_ratio = micro_images.aperture_ratio().ln();
        let assumed = aberration.of_field();
        // The lines of corners are projected out of positions and sensitivities before the latter are fitted to the former
        // (Frisch, Waugh and Lovell).
        for corner in corners {
            let rows: Vec<_> = corner.iter().flat_map(rows).collect();
            let mut line = NormalEquations::<f64, 3, COLUMNS>::new();
            for (row, measured) in &rows {
                line.add(row, measured, 1.0);
            }
            let Some(explained) = line.solve() else { continue };
            for (row, measured) in &rows {
                let mut left = measured - row.transpose() * explained;
                let by_field = left.fixed_columns::<FIELD>(BY_FIELD).transpose();
                left[PLACE] -= left[BY_RATIO] * log_ratio + by_field.dot(&assumed);
                found.products += left.transpose() * left;
            }
            widths.extend(corner.iter().map(|seen| {
                width_by_ratio(seen, micro_images, explained[(2, PLACE)], explained[(2, BY_RATIO)])
            }));
            for seen in corner {
                let by = by_field(seen, &aberration.axis_px);
                let by = Matrix2x3::from_columns(&[by.column(0), by.column(1), by.column(4)]).abs();
                found.largest = found.largest.sup(&by.row(0).sup(&by.row(1)).transpose());
            }
            found.freedom += rows.len() as f64 - 3.0;
        }
        (found, widths)
    }

    /// Adds the information of another frame.
    pub fn add(&mut self, other: &Self) {
        self.products += other.products;
        self.largest = self.largest.sup(&other.largest);
        self.freedom += other.freedom;
    }

    /// Returns the sum of squares that is left, over the variance of an observation.
    fn cost(&self, log_ratio: f64, field: &SVector<f64, FIELD>) -> f64 {
        let at = Self::at(log_ratio, field);
        at.dot(&(self.products * at))
    }

    fn at(log_ratio: f64, field: &SVector<f64, FIELD>) -> SVector<f64, COLUMNS> {
        let mut at = SVector::<f64, COLUMNS>::zeros();
        (at[PLACE], at[BY_RATIO]) = (1.0, log_ratio);
        at.fixed_rows_mut::<FIELD>(BY_FIELD).copy_from(field);
        at
    }

    /// Fits S, C, T and the optical axis so that the observations of every corner lie on a line. `ideal` is the main lens
    /// without aberrations, with its axis where it is expected; `mount_px` is the standard deviation of this place.
    /// Insignificant aberrations are set to 0 to keep their noise out of the features.
    pub fn fit(&self, log_ratio: f64, ideal: &Aberration, mount_px: f64) -> AberrationEstimate {
        let none = AberrationEstimate::none(*ideal);
        let off_middle = mount_px.powi(-2);
        let of_size = self.largest.map(|largest| (largest / MOST_PX).powi(2));
        let prior = SVector::<f64, UNKNOWNS>::from([
            of_size.x, of_size.y, of_size.z, off_middle, off_middle,
        ]);
        let whole_cost = |a: &Aberration| {
            let square = |x: &SVector<f64, UNKNOWNS>| x.component_mul(x).dot(&prior);
            self.cost(log_ratio, &a.of_field()) + square(&(unknowns(a) - unknowns(ideal)))
        };
        let by_field = self.products.fixed_view::<FIELD, COLUMNS>(BY_FIELD, 0);
        let mut found = *ideal;
        let mut cost = whole_cost(&found);
        let mut solution = None;
        for _ in 0..STEPS {
            let by = found.of_field_by_unknowns();
            let gradient = by.transpose() * by_field * Self::at(log_ratio, &found.of_field())
                + prior.component_mul(&(unknowns(&found) - unknowns(ideal)));
            let normal = by.transpose() * by_field.fixed_columns::<FIELD>(BY_FIELD) * by
                + SMatrix::from_diagonal(&prior);
            let Some(factor) = normal.cholesky() else { return none };
            let by_log_ratio = -factor.solve(&(by.transpose() * by_field.column(BY_RATIO)));
            solution = Some((factor.inverse(), by_log_ratio));
            let mut step = -factor.solve(&gradient);
            let mut next = moved(&found, &step);
            // The product of aberration and axis is not linear.
            while whole_cost(&next) > cost && step.norm_squared() > 0.0 {
                step /= 2.0;
                next = moved(&found, &step);
            }
            let before = cost;
            (found, cost) = (next, whole_cost(&next));
            if before - cost < SETTLED {
                break;
            }
        }
        let Some((covariance, by_log_ratio)) = solution else { return none };
        let left = self.cost(log_ratio, &found.of_field());
        let variance = (left / (self.freedom - UNKNOWNS as f64)).max(1.0);
        let explained = self.cost(log_ratio, &ideal.of_field()) - left;
        let errors = (covariance * variance).cholesky().map(|factor| factor.l());
        match errors.filter(|_| explained > SHOWS * variance) {
            Some(errors) => AberrationEstimate { aberration: found, errors, by_log_ratio },
            None => none,
        }
    }
}

/// Returns S, C, T and the axis.
fn unknowns(a: &Aberration) -> SVector<f64, UNKNOWNS> {
    let ([s, c, t], [u, v]): ([f64; 3], [f64; 2]) =
        (a.coefficients_per_px2.into(), a.axis_px.into());
    SVector::from([s, c, t, u, v])
}

/// Returns an aberration with S, C, T and the axis changed.
pub(super) fn moved(a: &Aberration, by: &SVector<f64, UNKNOWNS>) -> Aberration {
    Aberration {
        axis_px: a.axis_px + by.fixed_rows::<2>(3),
        coefficients_per_px2: a.coefficients_per_px2 + by.fixed_rows::<3>(0),
        ..*a
    }
}

/// Returns the information of a corner about ln φ, if its line has this slope with the derivative `slope_by_ratio`.
pub(super) fn width_by_ratio(
    seen: &CornerMeasurement,
    micro_images: &MicroImages,
    slope: f64,
    slope_by_ratio: f64,
) -> EdgeWidth {
    let optics = micro_images.optics(seen.observation.k, seen.observation.l);
    seen.width_at(slope, &optics).of_log_ratio(optics.blur_by_ratio_px(slope, slope_by_ratio))
}

/// Returns the derivatives of the position by the coefficients of [`field_terms`] about `origin`.
fn by_field(seen: &CornerMeasurement, origin: &Vector2<f64>) -> SMatrix<f64, 2, FIELD> {
    seen.sensitivities.by_aberration * field_terms(&(seen.observation.center - origin))
}

/// Returns the two equations of an observation: of the line in β and γ, with the corrected position and its sensitivities to
/// ln φ and the aberrations as right-hand sides.
fn rows(seen: &CornerMeasurement) -> [(Vector3<f64>, SMatrix<f64, 1, COLUMNS>); 2] {
    let observation = seen.on_line();
    let design = observation.whitened(&CornerLine::design(&observation.center));
    let by_ratio = seen.sensitivities.by_taken.column(APERTURE_RATIO);
    let mut columns = SMatrix::<f64, 2, COLUMNS>::zeros();
    columns.set_column(PLACE, &observation.position);
    columns.set_column(BY_RATIO, &by_ratio);
    columns.fixed_columns_mut::<FIELD>(BY_FIELD).copy_from(&by_field(seen, &Vector2::zeros()));
    let columns = observation.whitened(&columns);
    [0, 1].map(|i| (design.row(i).transpose(), columns.row(i).into_owned()))
}

#[cfg(test)]
pub(super) mod tests {
    use nalgebra::Matrix2;

    use super::super::CornerObservation;
    use super::super::corner::Corner;
    use super::super::corner_fit::{ByTaken, Sensitivities};
    use super::super::edge_width::WidthChange;
    use super::super::micro_images::tests::micro_images;
    use super::*;

    const PUPIL_PX: f64 = 6.0;
    const STD_DEV_PX: f64 = 0.05;
    const MOUNT_PX: f64 = 90.0;

    /// Apparent bending by an error of ln φ, per |w|² of spherical aberration.
    const BENT_BY_RATIO: f64 = -0.02;

    /// Returns corners all over an image of 1000 x 800 px, each in 25 micro-images. Images are sharp: every observation has one
    /// ray. Errors of the given size follow no pattern. ln φ differs from its assumed value by `log_ratio`.
    pub fn seen_with(
        aberration: &Aberration,
        error_px: f64,
        log_ratio: f64,
    ) -> Vec<Vec<CornerMeasurement>> {
        let optics = micro_images(23.0).optics(0, 0);
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
                        // A few rounds solve w = (γ − 1)(c − p) − E/A.
                        let straight = (center - pinhole) * (slope - 1.0);
                        let bend = aberration.bend(&center, 0.0, slope);
                        let w = (0..20).fold(straight, |w, _| straight - bend.at(&w));
                        let by_ratio = bend.terms(&w).column(0) * BENT_BY_RATIO;
                        let moved = by_ratio * log_ratio;
                        let position = center + w - moved + Vector2::new(error(), error());
                        let mut by_taken = ByTaken::zeros();
                        by_taken.set_column(APERTURE_RATIO, &by_ratio);
                        let wider_px = optics.blur_by_ratio_px(slope, 0.0) * log_ratio;
                        CornerMeasurement {
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
                            sensitivities: Sensitivities {
                                by_slope: Vector2::zeros(),
                                by_taken,
                                by_aberration: bend.terms(&w) * (slope - 1.0),
                            },
                            width: EdgeWidth::new(
                                Matrix2::identity() * 400.0,
                                Vector2::new(400.0 * wider_px, 0.0),
                            ),
                        }
                    })
                    .collect()
            })
            .collect()
    }

    fn seen(aberration: &Aberration, error_px: f64) -> Vec<Vec<CornerMeasurement>> {
        seen_with(aberration, error_px, 0.0)
    }

    /// Returns a lens with S, C and T of a double Gauss at f/4, and with its axis off the middle of the image.
    fn double_gauss(off_middle: Vector2<f64>) -> Aberration {
        moved(&ideal(), &SVector::from([5e-3, 2.4e-5, 4e-7, off_middle.x, off_middle.y]))
    }

    fn ideal() -> Aberration {
        Aberration::none(Vector2::new(500.0, 400.0), PUPIL_PX)
    }

    fn found(seen: &[Vec<CornerMeasurement>], free: bool) -> AberrationEstimate {
        let micro_images = micro_images(23.0);
        let seen = seen.iter().map(Vec::as_slice);
        let (information, widths) = AberrationInformation::of(&ideal(), &micro_images, seen);
        let change = WidthChange::fit(&widths, 0.0).and_then(|width| width.log_ratio());
        let change = change.filter(|_| free).map_or(0.0, |(change, _)| change);
        information.fit(micro_images.aperture_ratio().ln() + change, &ideal(), MOUNT_PX)
    }

    #[test]
    fn aberrations_and_axis_are_found_where_lines_bend() {
        for off_middle in [Vector2::zeros(), Vector2::new(150.0, -40.0)] {
            let truth = double_gauss(off_middle);
            let exact = found(&seen(&truth, 0.0), false).aberration;
            let part = (unknowns(&exact) - unknowns(&truth)).component_div(&unknowns(&truth));
            // The position w that E displaces is known to first order.
            assert!(part.amax() < 0.01, "{exact:?}");
            let noisy = found(&seen(&truth, STD_DEV_PX), true);
            let distance = noisy.errors.try_inverse().unwrap()
                * (unknowns(&noisy.aberration) - unknowns(&truth));
            println!("{noisy:?}: {distance}");
            assert!(distance.amax() < 3.0, "{noisy:?}: {distance}");
        }
    }

    /// Checks that two halves of the corners together determine the same as all of them.
    #[test]
    fn information_of_frames_adds_up() {
        let truth = double_gauss(Vector2::new(60.0, 30.0));
        let seen = seen(&truth, STD_DEV_PX);
        let micro_images = micro_images(23.0);
        let information = |seen: &[Vec<CornerMeasurement>]| {
            AberrationInformation::of(&ideal(), &micro_images, seen.iter().map(Vec::as_slice)).0
        };
        let mut both = information(&seen[..30]);
        both.add(&information(&seen[30..]));
        let log_ratio = micro_images.aperture_ratio().ln();
        let [both, all] = [both, information(&seen)].map(|i| i.fit(log_ratio, &ideal(), MOUNT_PX));
        let distance = unknowns(&both.aberration) - unknowns(&all.aberration);
        assert!(distance.component_div(&unknowns(&all.aberration)).amax() < 1e-6, "{distance}");
    }

    /// Checks openings that are smaller than assumed.
    #[test]
    fn an_aperture_ratio_is_no_aberration() {
        let seen = seen_with(&ideal(), STD_DEV_PX, -0.08);
        assert_eq!(found(&seen, true).aberration, ideal());
        let ratio_known = found(&seen, false).aberration;
        assert!(ratio_known.coefficients_per_px2.x.abs() > 1e-3, "{ratio_known:?}");
    }

    #[test]
    fn noise_is_no_aberration() {
        assert_eq!(found(&seen(&ideal(), STD_DEV_PX), true).aberration, ideal());
    }
}
