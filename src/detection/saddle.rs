//! Saddles of the light in a micro-image, where a corner may be.

// Only functions inlined into a dispatched function are compiled for its registers.
#![allow(clippy::inline_always)]

use nalgebra::{Matrix2, Matrix6, Vector2, Vector6};
use pulp::{Arch, Simd, WithSimd};

use super::corner::Corner;
use super::patch::Patch;
use crate::numerics::simd::{dot, sum};

/// Smallest ratio of the flatter to the steeper curvature of a saddle that may be a corner.
const SADDLE: f64 = 0.12;
/// Smallest curvature of a saddle over the smallest contrast, px⁻²: the curvature with the widest blur.
const CURVATURE: f64 = 0.03;
/// Smallest standard deviation of the light over the smallest contrast. It is the value of a corner near the edge, where one
/// quarter fills most of the micro-image.
const LEAST_STD_DEV: f64 = 0.3;
/// Contrast of a corner over the standard deviation of its light, which the blur lowers.
const CONTRAST: f64 = 1.3;
/// Half the width of steps at the start of a fit, px.
const START_WIDTH_PX: f64 = 3.0;
/// Step between the pixels in which saddles are searched for.
const FEW: usize = 2;
/// Radius of round windows in which saddles are searched for, besides the whole micro-image, and their distance from its
/// centre, px.
const WINDOW_PX: f64 = 5.5;
const WINDOWS_AT_PX: f64 = 4.5;

/// Returns the saddles of the light in windows of a micro-image, strongest first; none if the light varies less than with a
/// corner of the smallest contrast.
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
    // A fit starts at a saddle, so few pixels suffice.
    let (few, mut room) = (patch.thinned(FEW), Vec::new());
    let mut saddles: Vec<(f64, Corner)> = windows
        .filter_map(|(middle, radius)| saddle(&few, mean, std_dev, &middle, radius, &mut room))
        .collect();
    saddles.retain(|(curvature, _)| *curvature > CURVATURE * least_contrast);
    saddles.sort_by(|a, b| b.0.total_cmp(&a.0));
    saddles.into_iter().map(|(_, corner)| corner).collect()
}

/// Returns the saddle of a quadratic fitted to the light in a window, with its weaker curvature; `None` if it is no saddle, or
/// lies elsewhere.
#[allow(clippy::cast_possible_truncation)] // single precision, as the light
fn saddle(
    patch: &Patch,
    mean: f64,
    std_dev: f64,
    middle: &Vector2<f64>,
    radius: f64,
    room: &mut Vec<f32>,
) -> Option<(f64, Corner)> {
    let (moments, of_light) = Arch::new().dispatch(Moments {
        patch,
        mean: mean as f32,
        middle: [middle.x as f32, middle.y as f32],
        radius: radius as f32,
        room,
    });
    // The matrix has the products of 1, x, y, x², xy and y² with each other.
    let product = |a: usize, b: usize| {
        let [x, y] = [0, 1].map(|axis| POWERS[a][axis] + POWERS[b][axis]);
        let order = x + y;
        f64::from(moments[order * (order + 1) / 2 + y])
    };
    let normal = Matrix6::from_fn(product);
    let fit = normal.cholesky()?.solve(&Vector6::from(of_light.map(f64::from)));
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

/// Unit of coordinates in windows, px, in which they are of size one.
const SCALE: f32 = 8.0;
/// Powers of x and y in a quadratic.
const POWERS: [[usize; 2]; 6] = [[0, 0], [1, 0], [0, 1], [2, 0], [1, 1], [0, 2]];
/// Number of powers up to the fourth order, by order and power of y.
const ORDERS: usize = 15;
/// Number of rows of numbers that the sums need.
const ROWS: usize = 12;

/// Weighted sums over a round window: of powers up to the fourth order, and of the light minus its mean times [`POWERS`].
struct Moments<'a> {
    patch: &'a Patch,
    mean: f32,
    middle: [f32; 2],
    radius: f32,
    /// Buffer for [`ROWS`] rows.
    room: &'a mut Vec<f32>,
}

impl WithSimd for Moments<'_> {
    type Output = ([f32; ORDERS], [f32; 6]);

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
        let Self { patch, mean, middle: [x0, y0], radius, room } = self;
        // Pixels are in the order of their rows.
        let first = patch.y.partition_point(|y| *y < y0 - radius);
        let last = patch.y.partition_point(|y| *y <= y0 + radius);
        let n = last - first;
        let (x, y) = (&patch.x[first..last], &patch.y[first..last]);
        let (light, weight) = (&patch.light[first..last], &patch.weight[first..last]);
        room.clear();
        room.resize(ROWS * n, 0.0);
        let mut rows = room.chunks_exact_mut(n.max(1));
        let [w, wx, wy, wxx, wxy, wyy, wl, xs, ys, xx, xy, yy] =
            std::array::from_fn(|_| rows.next().map_or(&mut [][..], |row| &mut row[..n]));
        let radius2 = radius * radius;
        for i in 0..n {
            let (x, y) = (x[i] - x0, y[i] - y0);
            let weight = if x * x + y * y > radius2 { 0.0 } else { weight[i] };
            let (x, y) = (x / SCALE, y / SCALE);
            (xs[i], ys[i], xx[i], xy[i], yy[i]) = (x, y, x * x, x * y, y * y);
            (w[i], wx[i], wy[i]) = (weight, weight * x, weight * y);
            (wxx[i], wxy[i], wyy[i]) = (weight * xx[i], weight * xy[i], weight * yy[i]);
            wl[i] = weight * (light[i] - mean);
        }
        let moments = [
            sum(simd, w),
            sum(simd, wx),
            sum(simd, wy),
            sum(simd, wxx),
            sum(simd, wxy),
            sum(simd, wyy),
            dot(simd, wxx, xs),
            dot(simd, wxx, ys),
            dot(simd, wyy, xs),
            dot(simd, wyy, ys),
            dot(simd, wxx, xx),
            dot(simd, wxx, xy),
            dot(simd, wxx, yy),
            dot(simd, wxy, yy),
            dot(simd, wyy, yy),
        ];
        let of_light = [
            sum(simd, wl),
            dot(simd, wl, xs),
            dot(simd, wl, ys),
            dot(simd, wl, xx),
            dot(simd, wl, xy),
            dot(simd, wl, yy),
        ];
        (moments, of_light)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Checks that the saddle of a quadratic is exact, in a window too, whatever the weights.
    #[test]
    fn the_saddle_of_a_quadratic_is_its_own() {
        let mut patch = Patch::default();
        let middle = Vector2::new(1.3, -0.7);
        for (u, v) in (-9_i16..=9).flat_map(|v| (-9_i16..=9).map(move |u| (u, v))) {
            let (x, y) = (f32::from(u) + 0.2, f32::from(v) - 0.1);
            if x.hypot(y) > 9.0 {
                continue;
            }
            let (dx, dy) = (x - 1.3, y + 0.7);
            patch.x.push(x);
            patch.y.push(y);
            patch.light.push(0.5 + 0.01 * (dx * dx - 0.5 * dy * dy) + 0.004 * dx * dy);
            patch.weight.push(1.0 - 0.05 * x.hypot(y));
        }
        let (mean, std_dev) = patch.mean_and_std_dev();
        for (window, radius) in [(Vector2::zeros(), f64::INFINITY), (Vector2::new(4.0, 1.0), 5.5)] {
            let (curvature, corner) =
                saddle(&patch, mean, std_dev, &window, radius, &mut Vec::new()).unwrap();
            assert!((corner.place - middle).norm() < 1e-3, "{}", corner.place);
            // The eigenvalues of [[0.02, 0.004], [0.004, -0.01]].
            let expected = (0.015_f64.powi(2) + 0.004_f64.powi(2)).sqrt() - 0.005;
            assert!((curvature - expected).abs() < 1e-5, "{curvature} for {expected}");
        }
        let elsewhere = Vector2::new(-4.5, 0.0);
        assert!(saddle(&patch, mean, std_dev, &elsewhere, 2.0, &mut Vec::new()).is_none());
    }
}
