//! Projection, and points and boards in space: who sees them, and what they say of the camera.

use std::collections::BTreeSet;

use nalgebra::{DMatrix, Isometry3, Point3, Vector2};

use super::{conversions, ffi, solver_error};
use crate::error::Result;
use crate::model::{BentBoard, PlenopticCamera, shared_parameters};
use crate::solver::options::CostOptions;
use crate::solver::problem::{PointSensitivity, Problem, Projected, SolverFeature};

/// How far distortion of the main lens moves ideal image points, all in mm in the camera frame
/// (Brown-Conrady; paper, section 2.1).
///
/// An error if the camera is not valid.
pub fn distortion_mm(
    camera: &PlenopticCamera,
    image_points_mm: &[Vector2<f64>],
) -> Result<Vec<Vector2<f64>>> {
    camera.validate()?;
    let points: Vec<_> = image_points_mm.iter().map(|p| ffi::PairRow { x: p.x, y: p.y }).collect();
    let shifts = ffi::distortion(&camera.into(), &points).map_err(solver_error)?;
    Ok(shifts.iter().map(|shift| Vector2::new(shift.x, shift.y)).collect())
}

/// Projects every feature's board point through its micro-lens; `None` where the model is not
/// defined.
pub(crate) fn project(problem: &Problem) -> Result<Vec<Option<Projected>>> {
    let rows = ffi::project(
        &problem.camera.into(),
        &(&problem.board).into(),
        &problem.pose_blocks(),
        &problem.feature_rows(),
    )
    .map_err(solver_error)?;
    let has_blur = problem.camera.lens_types() > 0;
    let projected = |row: &ffi::ProjectionRow| {
        row.defined.then_some(Projected {
            u_px: row.u_px,
            v_px: row.v_px,
            rho_px: has_blur.then_some(row.rho_px),
        })
    };
    Ok(rows.iter().map(projected).collect())
}

/// Projects micro-lenses (k, l) to their micro-image centres (u, v) in px.
pub(crate) fn project_centers(
    camera: &PlenopticCamera,
    micro_lenses: impl Iterator<Item = (i32, i32)>,
) -> Result<Vec<[f64; 2]>> {
    let micro_lenses: Vec<_> = micro_lenses.map(|(k, l)| ffi::MicroLensIndex { k, l }).collect();
    let rows = ffi::project_centers(&camera.into(), &micro_lenses).map_err(solver_error)?;
    Ok(rows.iter().map(|pixel| [pixel.x, pixel.y]).collect())
}

/// The information of each pose's features on the free parameters of camera and board, with the pose unknown.
pub(crate) fn frame_information(
    problem: &Problem,
    cost: &CostOptions,
    threads: usize,
) -> Result<Vec<DMatrix<f64>>> {
    let values = ffi::frame_information(
        &problem.camera.into(),
        &(&problem.board).into(),
        &problem.pose_blocks(),
        &problem.feature_rows(),
        &cost.into(),
        conversions::count(threads),
    )
    .map_err(solver_error)?;
    let fixed: BTreeSet<&String> = cost.fixed.iter().collect();
    let free = shared_parameters(problem.camera.lens_types()).len() - fixed.len();
    Ok(conversions::square_matrices(free, &values))
}

/// Features of points of the flat grid of a board through all micro-lenses that see them at least `margin_px` inside the
/// micro-image, without noise.
pub(crate) fn visible_features(
    camera: &PlenopticCamera,
    board: &BentBoard,
    poses: &[Isometry3<f64>],
    board_points_mm: &[Point3<f64>],
    margin_px: f64,
) -> Result<Vec<SolverFeature>> {
    let poses: Vec<_> = poses.iter().map(ffi::PoseBlock::from).collect();
    let points: Vec<_> = board_points_mm.iter().map(ffi::PointRow::from).collect();
    let rows = ffi::visible_features(&camera.into(), &board.into(), &poses, &points, margin_px);
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
