//! Micro-image array as a grid, fitted to observed centres (paper, "Features extraction": pitch δc, rotation ϑ_z and
//! offset τ).
//!
//! The grid of the paper is regular. If the array is tilted against the sensor, the pitch grows towards the side on
//! which the micro-lenses are nearer to the main lens. The centres are then a projection c = p / (1 − t · p) with
//! t = θ/(D + d) for a tilt of θ and the exit pupil in the lens. On an R12 with 1 mrad this is 0.4 px at the border, and
//! gives θ to a few per cent before any board is seen.

use nalgebra::{Matrix2, Matrix6, Rotation2, Vector1, Vector2, Vector6};
use rayon::prelude::*;

use crate::error::{Error, Result};
use crate::model::{Lattice, LatticeKind, MicroImageCenter, Packing};
use crate::numerics::{self, NormalEquations, Outliers, Reweighted, Scale, Weight};

/// Grid of micro-image centres: c(k, l) = center + p / (1 − t · p) with p = pitch · R(rotation) · node(k, l) and the
/// perspective t.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MicroImageArray {
    /// Indices, packing and shifted rows of the lattice.
    pub lattice: Lattice,
    /// Distance δc of neighbouring micro-image centres, px.
    pub pitch_px: f64,
    /// Rotation ϑ_z in the image, rad, from u towards v.
    pub rotation_rad: f64,
    /// Position of the middle of the lattice, px.
    pub center_px: Vector2<f64>,
    /// Perspective t, 1/px: the relative growth of the pitch is 2 t · p along t and t · p across it. 0 if the centres
    /// do not show any.
    pub perspective_per_px: Vector2<f64>,
    /// Root mean square distance of the centres that agree with the grid, px.
    pub rms_px: f64,
    /// Number of outliers: centres further than six robust standard deviations from the grid.
    pub outliers: usize,
}

impl MicroImageArray {
    /// Returns the position of the centre of micro-image (k, l), px.
    #[must_use]
    pub fn center_of(&self, k: i32, l: i32) -> Vector2<f64> {
        let turn = Rotation2::new(self.rotation_rad);
        let regular = self.pitch_px * (turn * self.lattice.node(k, l));
        self.center_px + regular / (1.0 - self.perspective_per_px.dot(&regular))
    }

    /// Returns the position, from the middle of the lattice, that a centre would have without perspective, px.
    pub(super) fn without_perspective(&self, center: &Vector2<f64>) -> Vector2<f64> {
        let from_middle = center - self.center_px;
        from_middle / (1.0 + self.perspective_per_px.dot(&from_middle))
    }

    /// Returns the centres of all nodes, row by row, px: the measured centre if there is one, otherwise the centre in
    /// the grid.
    pub(crate) fn all_centers(&self, measured: &[MicroImageCenter]) -> Vec<Vector2<f64>> {
        let lattice = &self.lattice;
        let nodes = (0..lattice.rows).flat_map(|l| (0..lattice.columns).map(move |k| (k, l)));
        let mut all: Vec<Vector2<f64>> = nodes.map(|(k, l)| self.center_of(k, l)).collect();
        for c in measured {
            if let Some(index) = lattice.index(c.k, c.l) {
                all[index] = Vector2::new(c.u_px, c.v_px);
            }
        }
        all
    }
}

/// Fewest centres for the four parameters of the grid with redundancy.
const MIN_CENTERS: usize = 7;
/// Outliers of a grid. Centres scatter by their noise and by the faults of single micro-lenses, so the limit is wide. A
/// perfect grid scatters only by rounding, which is below `least`, px.
const OUTLIERS: Outliers = Outliers {
    weight: Weight::Biweight,
    scale: Scale::PerAxis,
    scales: 6.0,
    least: 1e-9,
    slack: 0.0,
};
/// Largest number of rounds of the reweighted fit, and its relative tolerance. A few rounds are usually enough.
const ROUNDS: usize = 50;
const SETTLED: f64 = 1e-13;
/// Typical distance from a lattice, relative to the pitch, beyond which centres do not lie on it. A wrong parity alone
/// gives about half a pitch, the centroid noise of real cameras a hundredth.
const MAX_RELATIVE_SCALE: f64 = 0.15;
/// Least significance of a perspective, in standard deviations. Below it the perspective counts as none, since it would
/// only carry the noise of the centres outwards.
pub(super) const SIGNIFICANT: f64 = 5.0;

/// Fits the grid robustly, with perspective. Tries both choices of the shifted rows (columns).
///
/// Returns an error if there are too few centres, if they do not span the plane, or if they do not lie on a lattice of
/// this kind. The error then names the kinds on which they do.
pub fn fit_grid(
    centers: &[MicroImageCenter],
    kind: LatticeKind,
    columns: i32,
    rows: i32,
) -> Result<MicroImageArray> {
    if centers.len() < MIN_CENTERS {
        return Err(Error::invalid(format!(
            "{} micro-image centres are too few for a grid, which needs at least {MIN_CENTERS}",
            centers.len()
        )));
    }
    let all_fits = |kind: LatticeKind| -> Vec<Fit> {
        Packing::of_kind(kind)
            .par_iter()
            .filter_map(|&packing| fit_lattice(centers, Lattice { packing, columns, rows }))
            .collect()
    };
    let best_of =
        |fits: Vec<Fit>| fits.into_iter().min_by(|a, b| a.scale_px.total_cmp(&b.scale_px));
    let fits = all_fits(kind);
    if fits.len() > 1 && fits.iter().all(Fit::fits) {
        return Err(Error::invalid(
            "the micro-image centres lie in one row, or are too few to decide which rows are \
             shifted: give centres over the whole image",
        ));
    }
    let Some(best) = best_of(fits) else {
        return Err(Error::invalid(
            "the micro-image centres do not span a grid: they lie in one row or at one point",
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
        "and not on another lattice; check their indices".to_owned()
    } else {
        format!(
            "but on the lattice '{}'; state this lattice in the file of the camera",
            others.join("' and '")
        )
    };
    Err(Error::invalid(format!(
        "the micro-image centres do not lie on a '{}' lattice: their typical distance from it \
         is {:.2} px at a pitch of {:.2} px, {remedy}",
        kind.name(),
        best.scale_px,
        best.grid.pitch_px
    )))
}

struct Fit {
    grid: MicroImageArray,
    /// Robust standard deviation per axis, px.
    scale_px: f64,
    /// Significance of the perspective, in standard deviations.
    deviations: f64,
}

impl Fit {
    fn fits(&self) -> bool {
        self.scale_px < MAX_RELATIVE_SCALE * self.grid.pitch_px
    }
}

/// Parameters of the fit: center, a and b with a + ib = pitch · exp(i rotation), and the perspective s by node. The
/// centre of node g is c = center + A g / (1 − s · g), with A the rotation times the pitch.
#[derive(Clone, Copy)]
struct Form(Vector6<f64>);

impl Form {
    fn turn(&self) -> Matrix2<f64> {
        Matrix2::new(self.0[2], -self.0[3], self.0[3], self.0[2])
    }

    /// Returns the position of a node from that of the middle.
    fn offset(&self, g: &Vector2<f64>) -> Vector2<f64> {
        self.turn() * g / (1.0 - self.0[4] * g.x - self.0[5] * g.y)
    }

    fn place(&self, g: &Vector2<f64>) -> Vector2<f64> {
        self.0.xy() + self.offset(g)
    }
}

/// Fits a grid, with perspective if it is significant. Returns `None` if it is not determined.
fn fit_lattice(centers: &[MicroImageCenter], lattice: Lattice) -> Option<Fit> {
    let regular = fit(centers, lattice, false)?;
    let projected = fit(centers, lattice, true).filter(|fit| fit.deviations > SIGNIFICANT);
    Some(projected.unwrap_or(regular))
}

/// Fits a grid, with or without perspective. Returns `None` if it is not determined.
fn fit(centers: &[MicroImageCenter], lattice: Lattice, perspective: bool) -> Option<Fit> {
    let centers = Centers {
        nodes: centers.iter().map(|c| lattice.node(c.k, c.l)).collect(),
        observed: centers.iter().map(|c| Vector2::new(c.u_px, c.v_px)).collect(),
        perspective,
    };
    let fitted = numerics::fit(&centers, None, ROUNDS, &OUTLIERS)?;
    let (form, normal) = fitted.model;
    let squares: Vec<f64> = fitted
        .lengths
        .iter()
        .zip(&fitted.weights)
        .filter(|&(_, &weight)| weight > 0.0)
        .map(|(length, _)| length * length)
        .collect();
    let by_node = Vector2::new(form.0[4], form.0[5]);
    let inverse = normal.cholesky()?.inverse().fixed_view::<2, 2>(4, 4).try_inverse()?;
    let turn = form.turn();
    Some(Fit {
        grid: MicroImageArray {
            lattice,
            pitch_px: turn.determinant().sqrt(),
            rotation_rad: form.0[3].atan2(form.0[2]),
            center_px: form.0.xy(),
            perspective_per_px: turn * by_node / turn.determinant(),
            rms_px: (squares.iter().sum::<f64>() / squares.len() as f64).sqrt(),
            outliers: fitted.lengths.len() - squares.len(),
        },
        scale_px: fitted.typical,
        deviations: by_node.dot(&(inverse * by_node)).sqrt() / fitted.typical,
    })
}

/// Observed centres by node.
struct Centers {
    nodes: Vec<Vector2<f64>>,
    observed: Vec<Vector2<f64>>,
    perspective: bool,
}

impl Reweighted for Centers {
    /// Grid with its normal matrix.
    type Model = (Form, Matrix6<f64>);

    fn count(&self) -> usize {
        self.nodes.len()
    }

    /// Solves for the grid. The equations are linear if the perspective s is multiplied by the positions of the round
    /// before. The first round has none, and leaves s at 0.
    fn solve(&self, weights: &[f64], last: Option<&Self::Model>) -> Option<Self::Model> {
        let last = last.filter(|_| self.perspective).map(|(form, _)| form);
        let mut equations = NormalEquations::<f64, 6, 1>::new();
        for ((g, c), &weight) in self.nodes.iter().zip(&self.observed).zip(weights) {
            let p = last.map_or_else(Vector2::zeros, |form| form.offset(g));
            let along_u = Vector6::new(1.0, 0.0, g.x, -g.y, g.x * p.x, g.y * p.x);
            let along_v = Vector6::new(0.0, 1.0, g.y, g.x, g.x * p.y, g.y * p.y);
            equations.add(&along_u, &Vector1::new(c.x), weight);
            equations.add(&along_v, &Vector1::new(c.y), weight);
        }
        if last.is_none() {
            for i in [4, 5] {
                let only = Vector6::from_fn(|j, _| f64::from(u8::from(i == j)));
                equations.add(&only, &Vector1::new(0.0), 1.0);
            }
        }
        let normal = equations.normal();
        // Nodes that are all in one place do not determine pitch and rotation.
        let spread =
            normal[(2, 2)] * normal[(0, 0)] - normal[(0, 2)].powi(2) - normal[(0, 3)].powi(2);
        if spread <= 1e-9 * normal[(0, 0)].powi(2) {
            return None;
        }
        let solution = equations.solve()?;
        solution.iter().all(|v| v.is_finite()).then_some((Form(solution), normal))
    }

    fn length(&self, (form, _): &Self::Model, datum: usize) -> f64 {
        (self.observed[datum] - form.place(&self.nodes[datum])).norm()
    }

    fn settled(&self, (last, _): &Self::Model, (next, _): &Self::Model) -> bool {
        (next.0 - last.0).norm() <= SETTLED * next.0.norm()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::{Noise, NoiseSource, Parity};
    use proptest::prelude::*;

    /// Tolerance for linear least squares on perfect data: rounding only.
    const EXACT: f64 = 1e-9;

    fn centers_of(grid: &MicroImageArray) -> Vec<MicroImageCenter> {
        let Lattice { columns, rows, .. } = grid.lattice;
        let indices = (0..rows).flat_map(|l| (0..columns).map(move |k| (k, l)));
        indices
            .map(|(k, l)| {
                let c = grid.center_of(k, l);
                MicroImageCenter { k, l, u_px: c.x, v_px: c.y, std_dev_px: None }
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
            lattice: Lattice { packing: Packing::new(kind, shifted), columns: 13, rows: 11 },
            pitch_px,
            rotation_rad,
            center_px: Vector2::new(160.25, 140.5),
            perspective_per_px: Vector2::zeros(),
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
            let shifted = if odd { Parity::Odd } else { Parity::Even };
            let truth = grid(kind, shifted, pitch, rotation);
            let mut centers = centers_of(&truth);
            // One centre in ten is misplaced.
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

        #[test]
        fn any_perspective_is_found_again(
            rotation in -3.0..3.0,
            along in 0.0..3.0,
            strength in 1e-7..1e-5,
        ) {
            let mut truth = grid(LatticeKind::HexagonalRows, Parity::Odd, 23.3, rotation);
            truth.perspective_per_px = Rotation2::new(along) * Vector2::new(strength, 0.0);
            let found = fit_grid(&centers_of(&truth), LatticeKind::HexagonalRows, 13, 11).unwrap();
            let off = (found.perspective_per_px - truth.perspective_per_px).norm();
            prop_assert!(off < 1e-6 * strength, "{off}");
            prop_assert!((found.pitch_px - truth.pitch_px).abs() < EXACT);
        }
    }

    /// Noise is not carried beyond the centres.
    #[test]
    fn a_perspective_within_the_noise_is_none() {
        let mut truth = grid(LatticeKind::HexagonalRows, Parity::Odd, 23.3, 0.01);
        let mut noisy = |perspective: f64| {
            truth.perspective_per_px = Vector2::new(0.0, perspective);
            let mut centers = centers_of(&truth);
            let noise = Noise { uv_px: 0.0, rho_px: 0.0, centers_px: 0.05 };
            let mut source = NoiseSource::new(&noise, 7).unwrap();
            for c in &mut centers {
                *c = source.center(c);
            }
            fit_grid(&centers, LatticeKind::HexagonalRows, 13, 11).unwrap().perspective_per_px
        };
        assert_eq!(noisy(0.0), Vector2::zeros());
        assert!((noisy(1e-5).y - 1e-5).abs() < 1e-6);
    }

    #[test]
    fn the_wrong_kind_is_an_error_that_names_the_right_one() {
        let truth = grid(LatticeKind::HexagonalColumns, Parity::Odd, 23.2, 0.01);
        let error = fit_grid(&centers_of(&truth), LatticeKind::HexagonalRows, 13, 11).unwrap_err();
        assert!(error.to_string().contains("'hexagonal-columns'"), "{error}");
    }

    #[test]
    fn a_single_place_one_row_or_too_few_centres_are_errors() {
        let one = MicroImageCenter { k: 3, l: 4, u_px: 10.0, v_px: 20.0, std_dev_px: None };
        assert!(fit_grid(&[one; 20], LatticeKind::HexagonalRows, 13, 11).is_err());
        assert!(fit_grid(&[one; 3], LatticeKind::HexagonalRows, 13, 11).is_err());
        let truth = grid(LatticeKind::HexagonalRows, Parity::Odd, 23.2, 0.01);
        let mut row = centers_of(&truth);
        row.retain(|c| c.l == 5);
        let error = fit_grid(&row, LatticeKind::HexagonalRows, 13, 11).unwrap_err();
        assert!(error.to_string().contains("one row"), "{error}");
    }
}
