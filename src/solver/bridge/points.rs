//! Points and boards in space: who sees them, and what they say of the camera.

use nalgebra::{DMatrix, Isometry3, Point3};

use super::{conversions, ffi, solver_error};
use crate::error::Result;
use crate::model::PlenopticCamera;
use crate::solver::options::CostOptions;
use crate::solver::problem::{PointSensitivity, Problem, SolverFeature};

/// The information of each pose's features on the free intrinsic parameters, with the pose unknown.
pub(crate) fn frame_information(
    problem: &Problem,
    cost: &CostOptions,
) -> Result<Vec<DMatrix<f64>>> {
    let values = ffi::frame_information(
        &problem.camera.into(),
        &problem.pose_blocks(),
        &problem.feature_rows(),
        &cost.into(),
    )
    .map_err(solver_error)?;
    let free = problem.camera.intrinsics().len() - cost.fixed.len();
    Ok(conversions::square_matrices(free, &values))
}

/// Features of board points through all micro-lenses that see them at least `margin_px` inside the
/// micro-image, without noise.
pub(crate) fn visible_features(
    camera: &PlenopticCamera,
    poses: &[Isometry3<f64>],
    board_points_mm: &[Point3<f64>],
    margin_px: f64,
) -> Result<Vec<SolverFeature>> {
    let poses: Vec<_> = poses.iter().map(ffi::PoseBlock::from).collect();
    let points: Vec<_> = board_points_mm.iter().map(ffi::PointRow::from).collect();
    let rows = ffi::visible_features(&camera.into(), &poses, &points, margin_px);
    Ok(rows.map_err(solver_error)?.iter().map(SolverFeature::from).collect())
}

/// How points of space, reconstructed from their features, depend on the camera and on noise.
pub(crate) fn point_sensitivities(
    camera: &PlenopticCamera,
    points_mm: &[Point3<f64>],
    std_dev_px: [f64; 3],
    margin_px: f64,
) -> Result<Vec<PointSensitivity>> {
    let points: Vec<_> = points_mm.iter().map(ffi::PointRow::from).collect();
    let rows = ffi::point_sensitivities(&camera.into(), &points, &std_dev_px, margin_px);
    Ok(rows.map_err(solver_error)?.iter().map(PointSensitivity::from).collect())
}
