//! The micro-image array as a regular grid, fitted to observed centres (paper, "Features
//! extraction": pitch δc, rotation ϑ_z and offset τ).

use nalgebra::{Matrix4, Rotation2, Vector2, Vector4};
use rayon::prelude::*;

use super::statistics::median;
use crate::error::{Error, Result};
use crate::lattice::{Lattice, LatticeKind, Parity};
use crate::observations::MicroImageCenter;

/// A grid of micro-image centres: c(k, l) = center + pitch · R(rotation) · node(k, l).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MicroImageArray {
    /// Indices, packing, and which rows are shifted.
    pub lattice: Lattice,
    /// Distance δc of neighbouring centres, px.
    pub pitch_px: f64,
    /// Rotation ϑ_z in the image, rad, from u towards v.
    pub rotation_rad: f64,
    /// Position of the middle of the lattice, px.
    pub center_px: Vector2<f64>,
    /// Root mean square distance of the centres that agree with the grid, px.
    pub rms_px: f64,
    /// Number of centres further than six robust standard deviations from the grid.
    pub outliers: usize,
}

impl MicroImageArray {
    /// Position of the centre of micro-image (k, l), px.
    #[must_use]
    pub fn center_of(&self, k: i32, l: i32) -> Vector2<f64> {
        let turn = Rotation2::new(self.rotation_rad);
        self.center_px + self.pitch_px * (turn * self.lattice.node(k, l))
    }
}

/// Fewest centres for the four parameters of the grid with redundancy.
const MIN_CENTERS: usize = 8;
/// Centres beyond this many robust standard deviations count as outliers and lose their weight.
const OUTLIER_SCALES: f64 = 6.0;
/// The scale is not taken below this, px, so that perfect grids work.
const MIN_SCALE_PX: f64 = 1e-9;
/// Reweighted fits settle in a few rounds; this many is for stubborn data.
const MAX_ROUNDS: usize = 50;
/// A lattice whose typical distance to the centres is beyond this part of the pitch is not theirs:
/// a wrong parity alone gives about half a pitch, the centroid noise of real cameras a hundredth.
const MAX_RELATIVE_SCALE: f64 = 0.15;
/// Median of the length of a 2-D Gaussian vector over its per-axis standard deviation.
const MEDIAN_LENGTH_2D: f64 = 1.177_410_022_515_474_7;

/// Fits the grid robustly; which rows (columns) are shifted is found by trying both.
///
/// An error if there are too few centres, if they do not span the plane, or if they do not lie on a
/// lattice of this kind (then the kinds on which they do are named).
pub fn fit_grid(
    centers: &[MicroImageCenter],
    kind: LatticeKind,
    columns: i32,
    rows: i32,
) -> Result<MicroImageArray> {
    if centers.len() < MIN_CENTERS {
        return Err(Error::invalid(format!(
            "{} micro-image centres are too few for a grid; it takes at least {MIN_CENTERS}",
            centers.len()
        )));
    }
    let all_fits = |kind: LatticeKind| -> Vec<Fit> {
        let parities: &[Parity] = match kind {
            LatticeKind::Orthogonal => &[Parity::Even],
            _ => &[Parity::Even, Parity::Odd],
        };
        parities
            .par_iter()
            .filter_map(|&shifted| fit(centers, Lattice { kind, columns, rows, shifted }))
            .collect()
    };
    let best_of =
        |fits: Vec<Fit>| fits.into_iter().min_by(|a, b| a.scale_px.total_cmp(&b.scale_px));
    let fits = all_fits(kind);
    if fits.len() > 1 && fits.iter().all(Fit::fits) {
        return Err(Error::invalid(
            "the micro-image centres lie in one row, or are so few that one cannot tell which rows \
             are shifted; give centres from all over the image",
        ));
    }
    let Some(best) = best_of(fits) else {
        return Err(Error::invalid(
            "the micro-image centres do not span a grid: they lie in one row or in one place",
        ));
    };
    if best.fits() {
        return Ok(best.grid);
    }
    let others: Vec<&str> =
        [LatticeKind::HexagonalRows, LatticeKind::HexagonalColumns, LatticeKind::Orthogonal]
            .into_iter()
            .filter(|&other| {
                other != kind && best_of(all_fits(other)).is_some_and(|fit| fit.fits())
            })
            .map(LatticeKind::name)
            .collect();
    let remedy = if others.is_empty() {
        "nor on any other lattice; check their indices".to_owned()
    } else {
        format!("but on the lattice '{}'; set that in the camera's file", others.join("' and '"))
    };
    Err(Error::invalid(format!(
        "the micro-image centres do not lie on a '{}' lattice: they are typically {:.2} px away at \
         a pitch of {:.2} px, {remedy}",
        kind.name(),
        best.scale_px,
        best.grid.pitch_px
    )))
}

struct Fit {
    grid: MicroImageArray,
    /// Robust standard deviation per axis, px.
    scale_px: f64,
}

impl Fit {
    fn fits(&self) -> bool {
        self.scale_px < MAX_RELATIVE_SCALE * self.grid.pitch_px
    }
}

/// Iteratively reweighted least squares with Tukey's weight. The parameters (center, a, b) with
/// a + ib = pitch · exp(i rotation) enter linearly. `None` where they are not determined.
fn fit(centers: &[MicroImageCenter], lattice: Lattice) -> Option<Fit> {
    let nodes: Vec<Vector2<f64>> = centers.iter().map(|c| lattice.node(c.k, c.l)).collect();
    let observed: Vec<Vector2<f64>> =
        centers.iter().map(|c| Vector2::new(c.u_px, c.v_px)).collect();
    let mut weights = vec![1.0; centers.len()];
    let mut parameters: Option<Vector4<f64>> = None;
    let mut scale_px = f64::INFINITY;
    for _ in 0..MAX_ROUNDS {
        let next = solve(&nodes, &observed, &weights)?;
        let lengths: Vec<f64> =
            nodes.iter().zip(&observed).map(|(g, c)| (c - place(&next, g)).norm()).collect();
        scale_px = (median(lengths.iter().copied())? / MEDIAN_LENGTH_2D).max(MIN_SCALE_PX);
        for (weight, length) in weights.iter_mut().zip(&lengths) {
            let x = length / (OUTLIER_SCALES * scale_px);
            *weight = if x < 1.0 { (1.0 - x * x).powi(2) } else { 0.0 };
        }
        let settled = parameters.is_some_and(|last| (next - last).norm() <= 1e-13 * next.norm());
        parameters = Some(next);
        if settled {
            break;
        }
    }
    let p = parameters?;
    let inliers: Vec<f64> = nodes
        .iter()
        .zip(&observed)
        .zip(&weights)
        .filter(|&(_, &weight)| weight > 0.0)
        .map(|((g, c), _)| (c - place(&p, g)).norm_squared())
        .collect();
    Some(Fit {
        grid: MicroImageArray {
            lattice,
            pitch_px: p[2].hypot(p[3]),
            rotation_rad: p[3].atan2(p[2]),
            center_px: Vector2::new(p[0], p[1]),
            rms_px: (inliers.iter().sum::<f64>() / inliers.len() as f64).sqrt(),
            outliers: centers.len() - inliers.len(),
        },
        scale_px,
    })
}

fn place(p: &Vector4<f64>, g: &Vector2<f64>) -> Vector2<f64> {
    Vector2::new(p[0] + p[2] * g.x - p[3] * g.y, p[1] + p[3] * g.x + p[2] * g.y)
}

fn solve(
    nodes: &[Vector2<f64>],
    observed: &[Vector2<f64>],
    weights: &[f64],
) -> Option<Vector4<f64>> {
    let mut normal = Matrix4::zeros();
    let mut right = Vector4::zeros();
    for ((g, c), &w) in nodes.iter().zip(observed).zip(weights) {
        for (row, value) in
            [(Vector4::new(1.0, 0.0, g.x, -g.y), c.x), (Vector4::new(0.0, 1.0, g.y, g.x), c.y)]
        {
            normal += w * row * row.transpose();
            right += w * value * row;
        }
    }
    // Nodes all in one place leave pitch and rotation open.
    let solution = normal.cholesky()?.solve(&right);
    let spread = normal[(2, 2)] * normal[(0, 0)] - normal[(0, 2)].powi(2) - normal[(0, 3)].powi(2);
    (spread > 1e-9 * normal[(0, 0)].powi(2) && solution.iter().all(|v| v.is_finite()))
        .then_some(solution)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Linear least squares on perfect data: rounding only.
    const EXACT: f64 = 1e-9;

    fn centers_of(grid: &MicroImageArray) -> Vec<MicroImageCenter> {
        let Lattice { columns, rows, .. } = grid.lattice;
        let indices = (0..rows).flat_map(|l| (0..columns).map(move |k| (k, l)));
        indices
            .map(|(k, l)| {
                let c = grid.center_of(k, l);
                MicroImageCenter { k, l, u_px: c.x, v_px: c.y }
            })
            .collect()
    }

    fn grid(
        kind: LatticeKind,
        shifted: Parity,
        pitch_px: f64,
        rotation_rad: f64,
    ) -> MicroImageArray {
        MicroImageArray {
            lattice: Lattice { kind, columns: 13, rows: 11, shifted },
            pitch_px,
            rotation_rad,
            center_px: Vector2::new(160.25, 140.5),
            rms_px: 0.0,
            outliers: 0,
        }
    }

    proptest! {
        #[test]
        fn any_grid_is_found_again(
            kind in prop_oneof![
                Just(LatticeKind::HexagonalRows),
                Just(LatticeKind::HexagonalColumns),
                Just(LatticeKind::Orthogonal)
            ],
            odd in any::<bool>(),
            pitch in 7.0..60.0,
            rotation in -3.0..3.0,
        ) {
            let shifted =
                if odd && kind != LatticeKind::Orthogonal { Parity::Odd } else { Parity::Even };
            let truth = grid(kind, shifted, pitch, rotation);
            let mut centers = centers_of(&truth);
            // One in ten is somewhere else altogether.
            for (i, c) in centers.iter_mut().enumerate().filter(|(i, _)| i % 10 == 3) {
                c.u_px += 3.0 + (i % 7) as f64;
                c.v_px -= 5.0;
            }
            let found = fit_grid(&centers, kind, 13, 11).unwrap();
            prop_assert_eq!(found.lattice, truth.lattice);
            prop_assert!((found.pitch_px - truth.pitch_px).abs() < EXACT);
            prop_assert!((found.rotation_rad - truth.rotation_rad).abs() < EXACT);
            prop_assert!((found.center_px - truth.center_px).norm() < EXACT);
            prop_assert_eq!(found.outliers, (3..centers.len()).step_by(10).count());
        }
    }

    #[test]
    fn the_wrong_kind_is_an_error_that_names_the_right_one() {
        let truth = grid(LatticeKind::HexagonalColumns, Parity::Odd, 23.2, 0.01);
        let error = fit_grid(&centers_of(&truth), LatticeKind::HexagonalRows, 13, 11).unwrap_err();
        assert!(error.to_string().contains("'hexagonal-columns'"), "{error}");
    }

    #[test]
    fn a_single_place_one_row_or_too_few_centres_are_errors() {
        let one = MicroImageCenter { k: 3, l: 4, u_px: 10.0, v_px: 20.0 };
        assert!(fit_grid(&[one; 20], LatticeKind::HexagonalRows, 13, 11).is_err());
        assert!(fit_grid(&[one; 3], LatticeKind::HexagonalRows, 13, 11).is_err());
        let truth = grid(LatticeKind::HexagonalRows, Parity::Odd, 23.2, 0.01);
        let mut row = centers_of(&truth);
        row.retain(|c| c.l == 5);
        let error = fit_grid(&row, LatticeKind::HexagonalRows, 13, 11).unwrap_err();
        assert!(error.to_string().contains("one row"), "{error}");
    }
}
