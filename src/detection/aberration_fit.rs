//! Estimation of the aberrations of the main lens from the bending of the lines of corners.
//!
//! A wrong blur radius bends lines too, since the rim of the pupil then moves positions like spherical aberration: an aperture
//! ratio that is 8 % too large has the effect of a double Gauss lens. The aperture ratio is therefore estimated first, from the
//! widths of edges. Positions move with it, and then give the aberrations.

use nalgebra::{Matrix3, SMatrix, Vector1, Vector3};

use super::corner_measurement::CornerMeasurement;
use super::edge_width::{EdgeWidth, WidthChange};
use super::{Aberration, CornerLine, MicroImages};
use crate::model::taken::APERTURE_RATIO;
use crate::numerics::NormalEquations;

/// Prior standard deviation of the displacement by aberrations, px. It limits them if a few corners hardly determine them.
const MOST_PX: f64 = 1.0;
/// Significance of aberrations, in σ, below which they are set to 0.
const SHOWS: f64 = 4.0;

/// Columns of the equations of an observation: its position and the derivatives of the position.
const COLUMNS: usize = 5;
const PLACE: usize = 0;
const BY_RATIO: usize = 1;
const BY_ABERRATION: usize = 2;

/// Returns the changes of S, C and T with which the observations of every corner lie on a line, px⁻². If ln φ is free, the
/// widths of edges determine it first; `wider_px2` is the assumed excess edge variance. Aberrations that are not significant in
/// the frame are set to 0, since they would only add noise.
pub(super) fn aberration_change<'a>(
    aberration: &Aberration,
    micro_images: &MicroImages,
    (free, wider_px2): (bool, f64),
    corners: impl Iterator<Item = &'a [CornerMeasurement]>,
) -> Vector3<f64> {
    let mut widths = Vec::new();
    // The lines of corners are projected out of positions and sensitivities before the latter are fitted to the former (Frisch,
    // Waugh and Lovell).
    let mut all_left = Vec::new();
    let mut largest = Vector3::<f64>::zeros();
    let mut freedom = 0.0;
    for corner in corners {
        let rows: Vec<_> = corner.iter().flat_map(rows).collect();
        let mut line = NormalEquations::<f64, 3, COLUMNS>::new();
        for (row, measured) in &rows {
            line.add(row, measured, 1.0);
        }
        let Some(explained) = line.solve() else { continue };
        all_left.extend(rows.iter().map(|(row, measured)| measured - row.transpose() * explained));
        widths.extend(corner.iter().map(|seen| {
            width_by_ratio(seen, micro_images, explained[(2, PLACE)], explained[(2, BY_RATIO)])
        }));
        for seen in corner {
            let by = seen.sensitivities.by_aberration.abs();
            largest = largest.sup(&by.row(0).sup(&by.row(1)).transpose());
        }
        freedom += rows.len() as f64 - 3.0;
    }
    let log_ratio = WidthChange::fit(&widths, wider_px2)
        .filter(|_| free)
        .and_then(|width| width.log_ratio())
        .map_or(0.0, |(change, _)| change);
    let mut equations = NormalEquations::<f64, 3, 1>::new();
    let mut squares = 0.0;
    for left in all_left {
        let place = left[PLACE] + left[BY_RATIO] * log_ratio;
        let by_aberration = left.fixed_columns::<3>(BY_ABERRATION).transpose();
        equations.add(&-by_aberration, &Vector1::new(place), 1.0);
        squares += place * place;
    }
    for (i, unit) in Matrix3::identity().column_iter().enumerate() {
        equations.add(&(unit * largest[i]), &Vector1::zeros(), MOST_PX.powi(-2));
    }
    let Some(change) = equations.solve() else { return Vector3::zeros() };
    let normal = equations.normal();
    let left = squares - change.dot(&(normal * change));
    let variance = (left / (freedom - 3.0)).max(1.0);
    let whole = aberration.coefficients_per_px2 + change;
    let shows = whole.dot(&(normal * whole)) > SHOWS.powi(2) * variance;
    if shows { change } else { -aberration.coefficients_per_px2 }
}

/// Returns the information of a corner about ln φ, if the slope of its line has the derivative `slope_by_ratio`.
fn width_by_ratio(
    seen: &CornerMeasurement,
    micro_images: &MicroImages,
    slope: f64,
    slope_by_ratio: f64,
) -> EdgeWidth {
    let optics = micro_images.optics(seen.observation.k, seen.observation.l);
    seen.width_at(slope, &optics).of_log_ratio(optics.blur_by_ratio_px(slope, slope_by_ratio))
}

/// Returns the two equations of an observation: of the line in β and γ, with the corrected position and its sensitivities to
/// ln φ, S, C and T as right-hand sides.
fn rows(seen: &CornerMeasurement) -> [(Vector3<f64>, SMatrix<f64, 1, COLUMNS>); 2] {
    let observation = seen.on_line();
    let design = observation.whitened(&CornerLine::design(&observation.center));
    let by_ratio = seen.sensitivities.by_taken.column(APERTURE_RATIO);
    let mut columns = SMatrix::<f64, 2, COLUMNS>::zeros();
    columns.set_column(PLACE, &observation.position);
    columns.set_column(BY_RATIO, &by_ratio);
    columns.fixed_columns_mut::<3>(BY_ABERRATION).copy_from(&seen.sensitivities.by_aberration);
    let columns = observation.whitened(&columns);
    [0, 1].map(|i| (design.row(i).transpose(), columns.row(i).into_owned()))
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix2, Vector2};

    use super::super::CornerObservation;
    use super::super::corner::Corner;
    use super::super::corner_fit::{ByTaken, Sensitivities};
    use super::super::micro_images::tests::micro_images;
    use super::*;

    const PUPIL_PX: f64 = 6.0;
    const STD_DEV_PX: f64 = 0.05;

    /// Apparent bending by an error of ln φ, per |w|² of spherical aberration.
    const BENT_BY_RATIO: f64 = -0.02;

    /// Returns corners all over an image of 1000 x 800 px, each in 25 micro-images. Images are sharp: every observation has one
    /// ray. Errors of the given size follow no pattern. ln φ differs from its assumed value by `log_ratio`.
    fn seen_with(
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
                        let bend = aberration.bend(&center, slope);
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

    fn found(seen: &[Vec<CornerMeasurement>], free: bool) -> Vector3<f64> {
        let none = Aberration::none(Vector2::new(500.0, 400.0), PUPIL_PX);
        aberration_change(&none, &micro_images(23.0), (free, 0.0), seen.iter().map(Vec::as_slice))
    }

    #[test]
    fn aberrations_are_found_where_lines_bend() {
        let none = Aberration::none(Vector2::new(500.0, 400.0), PUPIL_PX);
        // A double Gauss at f/4.
        let truth = Vector3::new(5e-3, 2.4e-5, 4e-7);
        let exact = found(&seen(&none.changed(&truth), 0.0), false);
        assert!((exact - truth).component_div(&truth).amax() < 1e-3, "{exact}");
        let noisy = found(&seen(&none.changed(&truth), STD_DEV_PX), true);
        assert!((noisy - truth).component_div(&truth).amax() < 0.2, "{noisy}");
    }

    /// Checks openings that are smaller than assumed.
    #[test]
    fn an_aperture_ratio_is_no_aberration() {
        let none = Aberration::none(Vector2::new(500.0, 400.0), PUPIL_PX);
        let seen = seen_with(&none, STD_DEV_PX, -0.08);
        assert_eq!(found(&seen, true), Vector3::zeros());
        let ratio_known = found(&seen, false);
        assert!(ratio_known.x.abs() > 1e-3, "{ratio_known}");
    }

    #[test]
    fn noise_is_no_aberration() {
        let none = Aberration::none(Vector2::new(500.0, 400.0), PUPIL_PX);
        assert_eq!(found(&seen(&none, STD_DEV_PX), true), Vector3::zeros());
    }
}
