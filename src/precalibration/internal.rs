//! Internal parameters from radii at several f-numbers, Eq. (miradiusfnumber).

use nalgebra::{DMatrix, DVector};

use super::discs::Discs;
use crate::model::{Configuration, InternalParameters, Opening};

/// The radius of the micro-images of one lens type at one f-number.
#[derive(Debug, Clone, PartialEq)]
pub struct RadiusMeasurement {
    /// F-number N.
    pub f_number: f64,
    /// Lens type, from 0.
    pub lens_type: usize,
    /// Radius ϱ, px.
    pub radius_px: f64,
    /// Standard deviation of the radius, px.
    pub std_dev_px: f64,
    /// Measured minus fitted, px.
    pub residual_px: f64,
    /// Radii of single micro-images, px.
    pub single_px: Vec<f64>,
}

/// Internal parameters Ω with their uncertainty.
#[derive(Debug, Clone, PartialEq)]
pub struct InternalFit {
    /// The parameters, with their standard deviations.
    pub parameters: InternalParameters,
    /// Root mean square residual, px.
    pub rms_px: f64,
}

/// Fits straight lines ϱ = |m|/N + |qᵢ| with one slope for all types, by least squares. Fills in the residuals. Returns
/// `None` if the f-numbers do not span a line.
///
/// With f > d (Galilean) the paper's radius is negative, ϱ = −(m/N + qᵢ), hence q'ᵢ = Δc/2 − |qᵢ|;
/// with f < d it is positive and q'ᵢ = Δc/2 + |qᵢ|.
pub(super) fn fit_internal(
    measurements: &mut [RadiusMeasurement],
    types: usize,
    pixel_size_mm: f64,
    micro_image_pitch_px: f64,
    configuration: Configuration,
) -> Option<InternalFit> {
    let rows = measurements.len();
    let mut design = DMatrix::zeros(rows, types + 1);
    let mut radii = DVector::zeros(rows);
    for (row, m) in measurements.iter().enumerate() {
        design[(row, 0)] = 1.0 / m.f_number;
        design[(row, 1 + m.lens_type)] = 1.0;
        radii[row] = m.radius_px;
    }
    let normal = design.tr_mul(&design);
    let inverse = normal.clone().cholesky()?.inverse();
    // Equal f-numbers leave slope and offsets undetermined.
    if inverse[(0, 0)].is_nan() || normal.determinant().abs() < 1e-12 {
        return None;
    }
    let solution = &inverse * design.tr_mul(&radii);
    let residuals = &radii - &design * &solution;
    for (m, residual) in measurements.iter_mut().zip(residuals.iter()) {
        m.residual_px = *residual;
    }
    let freedom = rows.saturating_sub(types + 1);
    let sum = residuals.norm_squared();
    // Without redundancy the residuals do not show the errors, so σ of the measurements is used.
    let own: f64 =
        measurements.iter().map(|m| m.std_dev_px.powi(2)).sum::<f64>() / rows.max(1) as f64;
    let variance = if freedom > 0 { (sum / freedom as f64).max(own) } else { own };
    let std_dev = |i: usize| (variance * inverse[(i, i)]).sqrt() * pixel_size_mm;
    let half_pitch = micro_image_pitch_px * pixel_size_mm / 2.0;
    let side = if configuration == Configuration::Keplerian { 1.0 } else { -1.0 };
    Some(InternalFit {
        parameters: InternalParameters {
            m_mm: solution[0] * pixel_size_mm,
            q_prime_mm: (0..types)
                .map(|i| half_pitch + side * solution[1 + i] * pixel_size_mm)
                .collect(),
            micro_image_pitch_mm: Some(2.0 * half_pitch),
            m_std_dev_mm: Some(std_dev(0)),
            q_prime_std_dev_mm: (0..types).map(|i| std_dev(1 + i)).collect(),
            pupil_growth: 0.0,
            fall_off: None,
            tilt_gradient: None,
            vignetting: None,
            point_spread_px2: None,
            aperture_ratio: None,
            opening: Opening::Disc,
            levels: None,
        },
        rms_px: (sum / rows as f64).sqrt(),
    })
}

/// Computes the internal parameters from fitted discs, and fills in the residuals. `of_lenses_px` is the standard
/// deviation of the mean |qᵢ| due to differences between micro-lenses, by lens type.
pub(super) fn internal_of_discs(
    discs: &Discs,
    of_lenses_px: &[f64],
    measurements: &mut [RadiusMeasurement],
    pixel_size_mm: f64,
    micro_image_pitch_px: f64,
    configuration: Configuration,
) -> InternalFit {
    let half_pitch = micro_image_pitch_px * pixel_size_mm / 2.0;
    let side = if configuration == Configuration::Keplerian { 1.0 } else { -1.0 };
    let blurs = discs.blur_px.iter();
    let parameters = InternalParameters {
        m_mm: discs.m_px.0 * pixel_size_mm,
        q_prime_mm: blurs.clone().map(|b| half_pitch + side * b.0 * pixel_size_mm).collect(),
        micro_image_pitch_mm: Some(2.0 * half_pitch),
        m_std_dev_mm: Some(discs.m_px.1 * pixel_size_mm),
        q_prime_std_dev_mm: blurs
            .zip(of_lenses_px)
            .map(|(b, of_lenses)| b.1.hypot(*of_lenses) * pixel_size_mm)
            .collect(),
        pupil_growth: discs.pupil_growth,
        fall_off: None,
        tilt_gradient: None,
        vignetting: None,
        point_spread_px2: Some(discs.point_spread_px2),
        aperture_ratio: None,
        opening: discs.opening,
        levels: None,
    };
    for m in measurements.iter_mut() {
        let pupil = parameters.pupil_radius_mm(m.f_number) / pixel_size_mm;
        m.residual_px = m.radius_px - pupil - discs.blur_px[m.lens_type].0;
    }
    let sum: f64 = measurements.iter().map(|m| m.residual_px.powi(2)).sum();
    InternalFit { parameters, rms_px: (sum / measurements.len().max(1) as f64).sqrt() }
}
