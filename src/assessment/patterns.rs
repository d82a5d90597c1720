//! Systematic patterns in the residuals: over the image, over the micro-images, by lens type.

use std::collections::BTreeMap;

use nalgebra::Vector2;

use crate::calibration::Calibration;
use crate::error::Result;
use crate::model::{FeatureResidual, Sensor};
use crate::numerics::median;
use crate::solver;

/// Numbers of cells of the image along u and along v.
const CELLS: (u32, u32) = (8, 6);
/// Fewest features of a cell whose mean is used.
const MIN_FEATURES: usize = 20;

/// The systematic parts of the residuals of (u, v).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Patterns {
    /// Root mean square of the means over cells of the image, less the part that scatter explains, as a fraction
    /// of the root mean square of all residuals.
    pub image: f64,
    /// Root mean square of the parts of the residuals that are proportional to the distance from the centre of the micro-image,
    /// by lens type, less the part that scatter explains, as the same fraction.
    pub micro_image: f64,
    /// Ratio of the typical residuals, over σ if stated, of the worst lens type and the best.
    pub lens_types: f64,
    /// Fraction of the cells with micro-images that have features.
    pub coverage: f64,
}

pub(super) fn patterns(calibration: &Calibration) -> Result<Patterns> {
    let rms = rms_px(&calibration.reprojection.features);
    let residuals = &calibration.reprojection.features;
    let of_type =
        |i: usize| median(residuals.iter().filter(|r| r.lens_type == i).map(FeatureResidual::norm));
    let by_type: Vec<f64> = (0..calibration.camera.lens_types())
        .filter_map(of_type)
        .filter(|typical| *typical > 0.0)
        .collect();
    let lens_types = by_type.iter().copied().fold(0.0, f64::max)
        / by_type.iter().copied().fold(f64::INFINITY, f64::min);
    Ok(Patterns {
        image: image_pattern(&calibration.camera.sensor, &calibration.reprojection.features),
        micro_image: over_micro_images(calibration)? / rms,
        lens_types: if by_type.is_empty() { 1.0 } else { lens_types },
        coverage: coverage(calibration),
    })
}

fn rms_px(residuals: &[FeatureResidual]) -> f64 {
    let total: f64 = residuals.iter().map(|r| r.du_px.powi(2) + r.dv_px.powi(2)).sum();
    (total / residuals.len().max(1) as f64).sqrt()
}

fn cell(sensor: &Sensor, u_px: f64, v_px: f64) -> (u32, u32) {
    let part = |value: f64, size: u32, cells: u32| {
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // within 0 to cells
        let cell = (value / f64::from(size) * f64::from(cells)).max(0.0) as u32;
        cell.min(cells - 1)
    };
    (part(u_px, sensor.width_px, CELLS.0), part(v_px, sensor.height_px, CELLS.1))
}

/// Computes [`Patterns::image`] of some residuals.
#[must_use]
pub fn image_pattern(sensor: &Sensor, residuals: &[FeatureResidual]) -> f64 {
    let mut cells: BTreeMap<(u32, u32), Vec<Vector2<f64>>> = BTreeMap::new();
    for r in residuals {
        let place = cell(sensor, r.feature.u_px, r.feature.v_px);
        cells.entry(place).or_default().push(Vector2::new(r.du_px, r.dv_px));
    }
    let (mut systematic, mut count) = (0.0, 0.0);
    for of_cell in cells.values().filter(|c| c.len() >= MIN_FEATURES) {
        let n = of_cell.len() as f64;
        let mean = of_cell.iter().sum::<Vector2<f64>>() / n;
        let scatter = of_cell.iter().map(|r| (r - mean).norm_squared()).sum::<f64>() / (n - 1.0);
        systematic += n * (mean.norm_squared() - scatter / n);
        count += n;
    }
    (systematic.max(0.0) / f64::max(count, 1.0)).sqrt() / rms_px(residuals)
}

/// Computes the root mean square, px, of the parts of the residuals that are proportional to the distance from the centre of
/// the micro-image. A detector that ignores the shading by the pupil causes such shifts.
fn over_micro_images(calibration: &Calibration) -> Result<f64> {
    let residuals = &calibration.reprojection.features;
    let named = residuals.iter().map(|r| (r.feature.k, r.feature.l));
    let centers = solver::project_centers(&calibration.camera, named)?;
    let mut by_type: BTreeMap<usize, [f64; 4]> = BTreeMap::new();
    let offset = |r: &FeatureResidual, [u, v]: &[f64; 2]| (r.feature.u_px - u, r.feature.v_px - v);
    for (r, center) in residuals.iter().zip(&centers) {
        let (u, v) = offset(r, center);
        let sums = by_type.entry(r.lens_type).or_default();
        sums[0] += u * u + v * v;
        sums[1] += u * r.du_px + v * r.dv_px;
        sums[2] += r.du_px.powi(2) + r.dv_px.powi(2);
        sums[3] += 1.0;
    }
    let explained = |[square, product, all, count]: &[f64; 4]| {
        let explained = if *square > 0.0 { product * product / square } else { 0.0 };
        // Of scatter alone, the slope explains one of 2n residuals.
        explained - all / (2.0 * count)
    };
    let sum: f64 = by_type.values().map(explained).map(|part| part.max(0.0)).sum();
    Ok((sum / residuals.len().max(1) as f64).sqrt())
}

fn coverage(calibration: &Calibration) -> f64 {
    let sensor = &calibration.camera.sensor;
    let mut seen = BTreeMap::new();
    for r in &calibration.reprojection.centers {
        seen.entry(cell(sensor, r.center.u_px, r.center.v_px)).or_insert(false);
    }
    for r in &calibration.reprojection.features {
        seen.insert(cell(sensor, r.feature.u_px, r.feature.v_px), true);
    }
    seen.values().filter(|seen| **seen).count() as f64 / seen.len().max(1) as f64
}
