//! Conversions between the types of the bridge and those of the other modules.

use nalgebra::{DMatrix, Isometry3, Matrix3, Point3, Translation3, UnitQuaternion, Vector3};

use super::ffi;
use crate::model::{
    BentBoard, BoardShape, Packing, Parity, PlenopticCamera, SHAPE, SHAPE_PARAMETERS,
};
use crate::solver::options::{Anchor, CostOptions, LossKind, SolverOptions};
use crate::solver::problem::{PointSensitivity, Problem, SolverCenter, SolverFeature};
use crate::solver::refinement::{Iteration, Termination};
use crate::solver::uncertainty::{CommonError, Uncertainty};

fn index(i: i32) -> usize {
    usize::try_from(i).unwrap_or(0)
}

pub(super) fn count(n: usize) -> i32 {
    i32::try_from(n).unwrap_or(i32::MAX)
}

impl Problem<'_> {
    pub(super) fn pose_blocks(&self) -> Vec<ffi::PoseBlock> {
        self.poses.iter().map(ffi::PoseBlock::from).collect()
    }

    pub(super) fn feature_rows(&self) -> Vec<ffi::FeatureRow> {
        let row = |f: &SolverFeature| ffi::FeatureRow {
            frame: count(f.pose),
            board_point_mm: f.board_point_mm.coords.into(),
            k: f.k,
            l: f.l,
            u_px: f.u_px,
            v_px: f.v_px,
            // NaN stands for no value in the core.
            rho_px: f.rho_px.unwrap_or(f64::NAN),
            std_dev_px: f.std_dev_px,
        };
        self.features.iter().map(row).collect()
    }

    pub(super) fn center_rows(&self) -> Vec<ffi::CenterRow> {
        let row = |c: &SolverCenter| ffi::CenterRow {
            k: c.k,
            l: c.l,
            u_px: c.u_px,
            v_px: c.v_px,
            std_dev_px: c.std_dev_px,
        };
        self.centers.iter().map(row).collect()
    }
}

impl From<&PlenopticCamera> for ffi::CameraParts {
    fn from(camera: &PlenopticCamera) -> Self {
        Self {
            packing: camera.lattice.packing.into(),
            columns: camera.lattice.columns,
            rows: camera.lattice.rows,
            pixel_size_mm: camera.sensor.pixel_size_mm,
            lens_types: count(camera.lens_types()),
            parameters: camera.intrinsics(),
        }
    }
}

impl From<&BentBoard> for ffi::BoardParts {
    fn from(bent: &BentBoard) -> Self {
        let middle = bent.board.middle_mm();
        let shape = SHAPE_PARAMETERS.each_ref().map(|parameter| parameter.value(&bent.shape));
        Self { half_mm: [middle.x, middle.y], shape }
    }
}

/// The shape with these parameters.
pub(super) fn shape(values: &[f64; SHAPE]) -> BoardShape {
    let mut shape = BoardShape::default();
    for (parameter, &value) in SHAPE_PARAMETERS.iter().zip(values) {
        parameter.set(&mut shape, value);
    }
    shape
}

impl From<Packing> for ffi::Packing {
    fn from(packing: Packing) -> Self {
        match packing {
            Packing::Orthogonal => Self::Orthogonal,
            Packing::HexagonalRows(Parity::Even) => Self::HexagonalRowsEven,
            Packing::HexagonalRows(Parity::Odd) => Self::HexagonalRowsOdd,
            Packing::HexagonalColumns(Parity::Even) => Self::HexagonalColumnsEven,
            Packing::HexagonalColumns(Parity::Odd) => Self::HexagonalColumnsOdd,
        }
    }
}

impl From<LossKind> for ffi::LossKind {
    fn from(kind: LossKind) -> Self {
        match kind {
            LossKind::None => Self::None,
            LossKind::Huber => Self::Huber,
            LossKind::Cauchy => Self::Cauchy,
        }
    }
}

impl From<ffi::Termination> for Termination {
    fn from(termination: ffi::Termination) -> Self {
        match termination {
            ffi::Termination::Converged => Self::Converged,
            ffi::Termination::IterationLimit => Self::IterationLimit,
            ffi::Termination::Stopped => Self::Stopped,
            // Shared enumerations are open: the only value left is `Failed`.
            _ => Self::Failed,
        }
    }
}

impl From<&Isometry3<f64>> for ffi::PoseBlock {
    fn from(pose: &Isometry3<f64>) -> Self {
        let (r, t) = (pose.rotation.scaled_axis(), pose.translation.vector);
        Self { block: [r.x, r.y, r.z, t.x, t.y, t.z] }
    }
}

impl From<&ffi::PoseBlock> for Isometry3<f64> {
    fn from(pose: &ffi::PoseBlock) -> Self {
        let [rx, ry, rz, tx, ty, tz] = pose.block;
        let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(rx, ry, rz));
        Isometry3::from_parts(Translation3::new(tx, ty, tz), rotation)
    }
}

impl From<&ffi::IterationRow> for Iteration {
    fn from(row: &ffi::IterationRow) -> Self {
        Self {
            number: row.number,
            cost: row.cost,
            gradient_max_norm: row.gradient_max_norm,
            step_norm: row.step_norm,
            trust_region_radius: row.trust_region_radius,
            time_s: row.time_s,
        }
    }
}

impl From<&Anchor> for ffi::AnchorRow {
    fn from(anchor: &Anchor) -> Self {
        let Anchor { quantity, value, std_dev } = anchor;
        Self { quantity: quantity.clone(), value: *value, std_dev: *std_dev }
    }
}

impl From<&CostOptions> for ffi::CostParts {
    fn from(cost: &CostOptions) -> Self {
        Self {
            uv_std_dev_px: cost.uv_std_dev_px,
            rho_std_dev_px: cost.rho_std_dev_px,
            centers_std_dev_px: cost.centers_std_dev_px,
            rho: cost.rho,
            loss_kind: cost.loss.kind.into(),
            loss_scale: cost.loss.scale,
            fixed: cost.fixed.clone(),
            anchors: cost.anchors.iter().map(ffi::AnchorRow::from).collect(),
            anchor_weight: cost.anchor_weight,
        }
    }
}

impl From<&SolverOptions> for ffi::SolverParts {
    fn from(solver: &SolverOptions) -> Self {
        Self {
            max_iterations: count(solver.max_iterations),
            threads: count(solver.threads),
            function_tolerance: solver.function_tolerance,
            initial_trust_region_radius: solver.initial_trust_region_radius,
            extrapolate: solver.extrapolate,
        }
    }
}

impl From<&Point3<f64>> for ffi::PointRow {
    fn from(point: &Point3<f64>) -> Self {
        Self { point_mm: point.coords.into() }
    }
}

impl From<&ffi::FeatureRow> for SolverFeature {
    fn from(row: &ffi::FeatureRow) -> Self {
        Self {
            pose: index(row.frame),
            board_point_mm: row.board_point_mm.into(),
            k: row.k,
            l: row.l,
            u_px: row.u_px,
            v_px: row.v_px,
            // NaN stands for no value in the core.
            rho_px: (!row.rho_px.is_nan()).then_some(row.rho_px),
            std_dev_px: row.std_dev_px,
        }
    }
}

impl From<&ffi::SensitivityRow> for PointSensitivity {
    fn from(row: &ffi::SensitivityRow) -> Self {
        let known = |values: &[f64]| !values.is_empty() && values.iter().all(|v| v.is_finite());
        let columns = row.by_intrinsics.len() / 3;
        Self {
            micro_lenses: index(row.micro_lenses),
            by_intrinsics: known(&row.by_intrinsics)
                .then(|| DMatrix::from_row_slice(3, columns, &row.by_intrinsics)),
            covariance: known(&row.covariance_mm2)
                .then(|| Matrix3::from_row_slice(&row.covariance_mm2)),
        }
    }
}

impl From<&CommonError> for ffi::CommonErrorParts {
    fn from(error: &CommonError) -> Self {
        Self {
            features_px: error.features_px.as_flattened().to_vec(),
            centers_px: error.centers_px.as_flattened().to_vec(),
            anchors: error.anchors.clone(),
            in_anchors: error.in_anchors,
        }
    }
}

/// The result for so many frames and these common errors.
impl From<(&ffi::UncertaintyParts, usize, &[CommonError])> for Uncertainty {
    fn from((parts, frames, common): (&ffi::UncertaintyParts, usize, &[CommonError])) -> Self {
        let (size, free) = (index(parts.size), parts.free_intrinsics.len());
        let matrix = |rows: usize, columns: usize, values: &[f64]| {
            DMatrix::from_row_slice(rows, columns, values)
        };
        Self {
            free_intrinsics: parts.free_intrinsics.iter().map(|&i| index(i)).collect(),
            rank: index(parts.rank),
            shared: parts.shared,
            covariance: matrix(size, size, &parts.covariance),
            independent_covariance: matrix(size, size, &parts.independent_covariance),
            freedom: parts.freedom.clone(),
            left_out_changes: matrix(frames, free, &parts.left_out_changes),
            frame_shares: matrix(frames, free, &parts.frame_shares),
            common_changes: common
                .iter()
                .zip(parts.common_changes.chunks(free.max(1)))
                .map(|(error, changes)| (error.source.clone(), changes.to_vec()))
                .collect(),
            poses_by_intrinsics: matrix(size - free, free, &parts.poses_by_intrinsics),
            dispersion: parts.dispersion,
            contradiction: usize::try_from(parts.contradicted)
                .ok()
                .map(|row| (index(parts.free_intrinsics[row]), parts.contradiction)),
            information: parts.information.clone(),
            weakest: parts.weakest.chunks_exact(size.max(1)).map(<[f64]>::to_vec).collect(),
            determined: parts.determined.clone(),
            residual_std_dev_px: parts.residual_std_dev_px,
            std_dev_factors: parts.std_dev_factors,
            expected_decrease: parts.expected_decrease,
            next_step: parts.next_step.clone(),
            gradient: parts.gradient.clone(),
        }
    }
}

pub(super) fn square_matrices(size: usize, values: &[f64]) -> Vec<DMatrix<f64>> {
    let matrix = |part: &[f64]| DMatrix::from_row_slice(size, size, part);
    values.chunks_exact((size * size).max(1)).map(matrix).collect()
}
