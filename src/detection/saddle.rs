//! Saddles of the light in a micro-image, where a corner may be.

use nalgebra::{Matrix2, Vector1, Vector2, Vector6};

use super::corner::Corner;
use super::patch::Patch;
use crate::numerics::NormalEquations;

/// Least saddle that may be a corner: its flatter curvature over the steeper.
const SADDLE: f64 = 0.12;
/// Least curvature of a saddle over the least contrast, 1/px²: that of the widest blur.
const CURVATURE: f64 = 0.03;
/// Least standard deviation of the light over the least contrast: of a corner near the edge, where one
/// quarter fills most of the micro-image.
const LEAST_STD_DEV: f64 = 0.3;
/// Contrast of a corner over the standard deviation of its light, which the blur lowers.
const CONTRAST: f64 = 1.3;
/// Half the width of steps that a fit starts with, px.
const START_WIDTH_PX: f64 = 3.0;
/// Saddles are searched for in all of the micro-image, and in round windows of it, px.
const WINDOW_PX: f64 = 5.5;
const WINDOWS_AT_PX: f64 = 4.5;

/// Saddles of the light in windows of a micro-image, strongest first; none where the light varies
/// less than a corner of the least contrast makes it.
pub(super) fn saddles(patch: &Patch, least_contrast: f64) -> Vec<Corner> {
    let (mean, std_dev) = patch.mean_and_std_dev();
    if std_dev < LEAST_STD_DEV * least_contrast {
        return Vec::new();
    }
    let around = (0..6).map(|i| {
        let angle = std::f64::consts::TAU * f64::from(i) / 6.0;
        (Vector2::new(angle.cos(), angle.sin()) * WINDOWS_AT_PX, WINDOW_PX)
    });
    let windows = std::iter::once((Vector2::zeros(), f64::INFINITY)).chain(around);
    let mut saddles: Vec<(f64, Corner)> = windows
        .filter_map(|(middle, radius)| saddle(patch, mean, std_dev, &middle, radius))
        .collect();
    saddles.retain(|(curvature, _)| *curvature > CURVATURE * least_contrast);
    saddles.sort_by(|a, b| b.0.total_cmp(&a.0));
    saddles.into_iter().map(|(_, corner)| corner).collect()
}

/// The saddle of a quadratic fitted to the light in a window, with its weaker curvature; `None` if it is
/// no saddle, or lies elsewhere.
#[allow(clippy::cast_possible_truncation)] // single precision, as the light
fn saddle(
    patch: &Patch,
    mean: f64,
    std_dev: f64,
    middle: &Vector2<f64>,
    radius: f64,
) -> Option<(f64, Corner)> {
    // Coordinates of size one.
    const SCALE: f32 = 8.0;
    let mut equations = NormalEquations::<f32, 6, 1>::new();
    let (x0, y0, radius2) = (middle.x as f32, middle.y as f32, (radius * radius) as f32);
    for i in 0..patch.x.len() {
        let (x, y) = (patch.x[i] - x0, patch.y[i] - y0);
        if x * x + y * y > radius2 {
            continue;
        }
        let (x, y) = (x / SCALE, y / SCALE);
        let row = Vector6::new(1.0, x, y, x * x, x * y, y * y);
        equations.add(&row, &Vector1::new(patch.light[i] - mean as f32), patch.weight[i]);
    }
    let fit = equations.in_double().solve()?;
    let scale = f64::from(SCALE);
    let hessian = Matrix2::new(2.0 * fit[3], fit[4], fit[4], 2.0 * fit[5]) / (scale * scale);
    let eigen = hessian.symmetric_eigen();
    let (up, down) = if eigen.eigenvalues[0] > eigen.eigenvalues[1] { (0, 1) } else { (1, 0) };
    let (bright, dark) = (eigen.eigenvalues[up], -eigen.eigenvalues[down]);
    if bright <= 0.0 || dark <= 0.0 || bright.min(dark) < SADDLE * bright.max(dark) {
        return None;
    }
    let from_middle = -(hessian.try_inverse()? * Vector2::new(fit[1], fit[2]) / scale);
    if from_middle.norm() > radius.min(1.5 * WINDOW_PX) {
        return None;
    }
    // The edges run where the quadratic is flat, on both sides of the bright direction.
    let tilt = (bright / dark).sqrt().atan();
    let axis = eigen.eigenvectors.column(up);
    let angle = axis.y.atan2(axis.x);
    let corner = Corner {
        place: middle + from_middle,
        angles: [angle + tilt, angle - tilt],
        level: mean,
        contrast: -CONTRAST * std_dev,
        width: START_WIDTH_PX,
        covariance: Matrix2::zeros(),
        explained: 0.0,
    };
    Some((bright.min(dark), corner))
}
