//! Forward model: projection of points and boards, visibility, and sensitivities of reconstructed points.

use nalgebra::{Isometry3, Point3, Vector2};

use super::bridge::ffi::{self, PointSensitivity, Projected, SolverFeature};
use super::conversions::{found, rows};
use super::problem::Problem;
use crate::error::Result;
use crate::model::{BentBoard, PlenopticCamera};

/// Computes the displacement of ideal image points by distortion of the main lens, all in mm in the camera frame
/// (Brown-Conrady; paper, section 2.1), for points that the lens images onto the array: at the magnification 1 − D/F.
///
/// An error if the camera is not valid.
pub fn distortion_mm(
    camera: &PlenopticCamera,
    image_points_mm: &[Vector2<f64>],
) -> Result<Vec<Vector2<f64>>> {
    camera.validate()?;
    let shifts = ffi::distortion(&camera.into(), &rows(image_points_mm))?;
    Ok(shifts.iter().map(|shift| Vector2::new(shift.x, shift.y)).collect())
}

/// Projects every feature's board point through its micro-lens; `None` if the model is not defined.
pub(crate) fn project(problem: &Problem) -> Result<Vec<Option<Projected>>> {
    Ok(found(ffi::project(&problem.parts())?, |projected| projected.u_px))
}

impl Projected {
    /// Returns ρ, px; `None` for an array of pinholes, which has no blur.
    pub(crate) fn rho(&self) -> Option<f64> {
        (!self.rho_px.is_nan()).then_some(self.rho_px)
    }
}

/// Projects micro-lenses (k, l) to their micro-image centres (u, v) in px.
pub(crate) fn project_centers(
    camera: &PlenopticCamera,
    micro_lenses: impl Iterator<Item = (i32, i32)>,
) -> Result<Vec<[f64; 2]>> {
    let micro_lenses: Vec<_> = micro_lenses.map(|(k, l)| ffi::MicroLensIndex { k, l }).collect();
    let centers = ffi::project_centers(&camera.into(), &micro_lenses)?;
    Ok(centers.iter().map(|pixel| [pixel.x, pixel.y]).collect())
}

/// Computes the features of points of the flat grid of a board through all micro-lenses that see them at least `margin_px`
/// inside the micro-image, without noise.
pub(crate) fn visible_features(
    camera: &PlenopticCamera,
    board: &BentBoard,
    poses: &[Isometry3<f64>],
    board_points_mm: &[Point3<f64>],
    margin_px: f64,
) -> Result<Vec<SolverFeature>> {
    let (poses, points) = (rows(poses), rows(board_points_mm));
    Ok(ffi::visible_features(&camera.into(), &board.into(), &poses, &points, margin_px)?)
}

/// Computes the sensitivities of points of space, reconstructed from their features, to the camera and to noise.
pub(crate) fn point_sensitivities(
    camera: &PlenopticCamera,
    points_mm: &[Point3<f64>],
    std_dev_px: [f64; 3],
    margin_px: f64,
) -> Result<Vec<PointSensitivity>> {
    Ok(ffi::point_sensitivities(&camera.into(), &rows(points_mm), &std_dev_px, margin_px)?)
}

impl PointSensitivity {
    /// Returns true if enough micro-lenses see the point to determine it.
    pub(crate) fn is_known(&self) -> bool {
        let changes = &self.by_intrinsics.values;
        !changes.is_empty() && changes.iter().chain(&self.covariance_mm2).all(|v| v.is_finite())
    }
}
