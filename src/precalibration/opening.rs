//! Shape of the openings of the micro-lenses: discs, or cells of the lattice.
//!
//! A micro-image is the image of the opening, convolved with the pupil and the point spread, which are round. Among the harmonic
//! moments ⟨zᵏ⟩ of a polygon with n sides, z = (x + iy) exp(−iθ) with θ the direction of the normal of a side, the first that is
//! not 0 is ⟨zⁿ⟩ = cₙ bⁿ, where b is half the width. All moments of round light are 0, so a convolution with it does not change
//! ⟨zⁿ⟩: it is the same at all f-numbers. Its ratio to cₙ bⁿ is the cell share: 1 for cells, 0 for discs. Integrals over the
//! polygons give c₆ = −16/189 and c₄ = −4/15.

use nalgebra::{Complex, Vector2};
use rayon::prelude::*;

use super::array::FoundArray;
use super::centroid::{measure_blob, pixels_about};
use super::radii::mean_and_scatter;
use super::samples::Samples;
use crate::model::{InternalParameters, Opening};
use crate::quantity::Estimate;

/// Distance beyond the outermost light up to which light counts, px, and in standard deviations of the point spread.
const MARGIN_PX: f64 = 1.0;
const SPREADS: f64 = 2.5;
/// Fewest micro-images.
const FEWEST: usize = 20;
/// Smallest blur radius that pixels resolve, px.
const RESOLVED_PX: f64 = 1.5;
/// Model error of the cell share: oblique light, and micro-lenses that are not ideal.
const MODEL: f64 = 0.03;

/// Measures the cell share on micro-images that do not touch; `None` if they touch at every f-number, or are too small.
/// `internal` is for discs.
pub(super) fn cell_share(
    samples: &Samples,
    found: &FoundArray,
    internal: &InternalParameters,
    pixel_size_mm: f64,
) -> Option<Estimate> {
    let grid = &found.array.grid;
    let kind = grid.lattice.kind();
    let cell = Opening::cell(kind);
    let normal_rad = Opening::normal_rad(kind, grid.rotation_rad);
    let spread_px = internal.point_spread_px2().sqrt();
    let of_white = |white: usize| {
        let pupil_px = internal.pupil_radius_mm(samples.whites[white].f_number) / pixel_size_mm;
        let of_type = move |(lens_type, q_prime): (usize, &f64)| {
            // Both shapes blur by the same standard deviation.
            let blur_px = (q_prime / pixel_size_mm - grid.pitch_px / 2.0).abs();
            let half_px = blur_px * Opening::Disc.std_dev() / cell.std_dev();
            let outer_px = pupil_px + half_px * cell.reach();
            let reach_px = outer_px + MARGIN_PX + SPREADS * spread_px;
            let apart = half_px > RESOLVED_PX && reach_px <= grid.pitch_px / 2.0;
            let single = |node: &(i32, i32)| {
                let (image, pattern) = samples.middle(white);
                let blob = measure_blob(image, pattern, *node)?;
                let (mut light, mut moment) = (0.0, 0.0);
                pixels_about(image, &blob.center, reach_px, |offset, value| {
                    light += value;
                    moment += value * harmonic(cell, normal_rad, &(offset / half_px));
                });
                (light > 0.0).then(|| moment / light / harmonic_moment(cell))
            };
            let nodes = if apart { samples.nodes[lens_type].as_slice() } else { &[] };
            let shares: Vec<f64> = nodes.par_iter().filter_map(single).collect();
            let (mean, scatter) = mean_and_scatter(&shares).filter(|_| shares.len() >= FEWEST)?;
            Some((mean, scatter * scatter / shares.len() as f64))
        };
        internal.q_prime_mm.iter().enumerate().filter_map(of_type).collect::<Vec<_>>()
    };
    let all: Vec<(f64, f64)> = (0..samples.whites.len()).flat_map(of_white).collect();
    let weights: f64 = all.iter().map(|(_, variance)| 1.0 / variance).sum();
    let value = all.iter().map(|(mean, variance)| mean / variance).sum::<f64>() / weights;
    let squares: f64 = all.iter().map(|(mean, variance)| (mean - value).powi(2) / variance).sum();
    // Sizes and types that differ by more than the noise show the error of all of them.
    let excess = (squares / (all.len() as f64 - 1.0).max(1.0)).max(1.0);
    let std_dev = (excess / weights).sqrt().hypot(MODEL);
    value.is_finite().then_some(Estimate { value, std_dev })
}

/// Returns the real part of zⁿ for a shape with n sides, of which one has a normal with this direction; 0 for a disc.
fn harmonic(opening: Opening, normal_rad: f64, place: &Vector2<f64>) -> f64 {
    let turned = Complex::new(place.x, place.y) * Complex::cis(-normal_rad);
    turned.powu(opening.sides().into()).re
}

/// Returns cₙ.
fn harmonic_moment(cell: Opening) -> f64 {
    if cell == Opening::Square { -4.0 / 15.0 } else { -16.0 / 189.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Compares with sums over points of both polygons, in the plane and after a convolution with a disc.
    #[test]
    fn moments_of_cells_are_kept_by_a_convolution() {
        for opening in [Opening::Hexagon, Opening::Square] {
            let normals = opening.normals(0.4);
            let inside = |p: &Vector2<f64>| normals.iter().all(|n| n.dot(p).abs() <= 1.0);
            let points: Vec<Vector2<f64>> = (0..160 * 160)
                .map(|i| Vector2::new(f64::from(i % 160), f64::from(i / 160)))
                .map(|p| (p - Vector2::repeat(79.5)) * 0.0185)
                .filter(inside)
                .collect();
            let shifts: Vec<Vector2<f64>> = (0..200)
                .map(|i| (((f64::from(i) + 0.5) / 200.0).sqrt(), f64::from(i) * 2.399_963_229_728))
                .map(|(r, angle)| Vector2::new(angle.cos(), angle.sin()) * r * 0.8)
                .collect();
            let mean = |shifts: &[Vector2<f64>]| {
                let pairs = points.iter().flat_map(|p| shifts.iter().map(move |s| p + s));
                let sum: f64 = pairs.map(|p| harmonic(opening, 0.4, &p)).sum();
                sum / (points.len() * shifts.len()) as f64 / harmonic_moment(opening)
            };
            let (alone, blurred) = (mean(&[Vector2::zeros()]), mean(&shifts));
            assert!((alone - 1.0).abs() < 0.02, "{opening:?}: {alone}");
            assert!((blurred - 1.0).abs() < 0.05, "{opening:?}: {blurred}");
        }
    }
}
