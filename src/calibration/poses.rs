//! Initial poses: PnP on the barycentres of the observations of each corner (paper, section 5.2).

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::{
    Isometry3, Matrix3, Point2, Point3, Rotation3, Translation3, UnitQuaternion, Vector3,
};
use opencv::calib3d;
use opencv::core::{Mat, Point2d, Point3d, Vector, no_array};
use opencv::prelude::*;

use crate::finding::Issue;
use crate::model::{BapFeature, Board, MIN_CORNERS, PlenopticCamera};

/// Ratio of the spread of corners across the best line to the spread along it below which they are collinear.
const COLLINEAR: f64 = 1e-3;

/// Returns the poses `camera_from_board` that explain the features of a frame, the best first.
///
/// The mean of all observations of a corner is nearly its projection by a pinhole camera of focal length (D + d)/s
/// about (u₀, v₀). Such a projection of a planar target allows two poses, mirrored in tilt. In a narrow field of view
/// both fit nearly equally well. Poses with a corner within the focal length are left out. The error is the reason why
/// there is no pose.
pub fn initial_poses(
    camera: &PlenopticCamera,
    board: &Board,
    features: &[BapFeature],
) -> Result<Vec<Isometry3<f64>>, Issue> {
    let mut candidates = poses_of_board(camera, board, features)?;
    let seen: BTreeSet<i32> = features.iter().map(|f| f.corner).collect();
    let points: Vec<Point3<f64>> = seen.into_iter().map(|corner| board.point_mm(corner)).collect();
    candidates
        .retain(|pose| points.iter().all(|p| (pose * p).z > camera.main_lens.focal_length_mm));
    if candidates.is_empty() {
        return Err(Issue::PoseBehindFocalPlane);
    }
    Ok(candidates)
}

/// Returns the poses like [`initial_poses`], wherever they put the board.
pub(super) fn poses_of_board(
    camera: &PlenopticCamera,
    board: &Board,
    features: &[BapFeature],
) -> Result<Vec<Isometry3<f64>>, Issue> {
    let mut sums: BTreeMap<i32, (Point2<f64>, f64)> = BTreeMap::new();
    for f in features {
        let (sum, count) = sums.entry(f.corner).or_insert((Point2::origin(), 0.0));
        sum.x += f.u_px;
        sum.y += f.v_px;
        *count += 1.0;
    }
    let points: Vec<Point3<f64>> = sums.keys().map(|&corner| board.point_mm(corner)).collect();
    let pixels: Vec<Point2<f64>> = sums.values().map(|(sum, count)| sum / *count).collect();
    if points.len() < MIN_CORNERS {
        return Err(Issue::PoseTooFewCorners { corners: points.len(), fewest: MIN_CORNERS });
    }
    if collinear(&points) {
        return Err(Issue::PoseCollinear);
    }
    let mut candidates = solve_pnp(camera, &points, &pixels)
        .map_err(|error| Issue::PoseNotFound { reason: error.message })?;
    candidates.sort_by(|a, b| a.1.total_cmp(&b.1));
    Ok(candidates.into_iter().map(|(pose, _)| pose).collect())
}

fn collinear(points: &[Point3<f64>]) -> bool {
    let mean = points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / points.len() as f64;
    let scatter: Matrix3<f64> =
        points.iter().map(|p| (p.coords - mean) * (p.coords - mean).transpose()).sum();
    let mut spread = scatter.symmetric_eigenvalues().as_slice().to_vec();
    spread.sort_by(f64::total_cmp);
    spread[1].max(0.0).sqrt() <= COLLINEAR * spread[2].max(0.0).sqrt()
}

/// Returns poses of a planar target with their reprojection errors, px.
fn solve_pnp(
    camera: &PlenopticCamera,
    points: &[Point3<f64>],
    pixels: &[Point2<f64>],
) -> opencv::Result<Vec<(Isometry3<f64>, f64)>> {
    let focal_px =
        (camera.mla.lens_to_mla_mm + camera.mla.mla_to_sensor_mm) / camera.sensor.pixel_size_mm;
    let principal = camera.mla.principal_point_px;
    let intrinsics = Mat::from_slice_2d(&[
        [focal_px, 0.0, principal.x],
        [0.0, focal_px, principal.y],
        [0.0, 0.0, 1.0],
    ])?;
    let object: Vector<Point3d> = points.iter().map(|p| Point3d::new(p.x, p.y, p.z)).collect();
    let image: Vector<Point2d> = pixels.iter().map(|p| Point2d::new(p.x, p.y)).collect();
    let (mut rotations, mut translations) = (Vector::<Mat>::new(), Vector::<Mat>::new());
    let mut errors = Vector::<f64>::new();
    calib3d::solve_pnp_generic(
        &object,
        &image,
        &intrinsics,
        &no_array(),
        &mut rotations,
        &mut translations,
        false,
        calib3d::SolvePnPMethod::SOLVEPNP_IPPE,
        &no_array(),
        &no_array(),
        &mut errors,
    )?;
    let vector = |mat: Mat| -> opencv::Result<Vector3<f64>> {
        Ok(Vector3::new(*mat.at::<f64>(0)?, *mat.at::<f64>(1)?, *mat.at::<f64>(2)?))
    };
    let mut poses = Vec::new();
    for ((rotation, translation), error) in rotations.into_iter().zip(translations).zip(errors) {
        let (r, t) = (vector(rotation)?, vector(translation)?);
        if r.iter().chain(t.iter()).all(|v| v.is_finite()) {
            let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::new(r));
            poses.push((Isometry3::from_parts(Translation3::from(t), rotation), error));
        }
    }
    Ok(poses)
}
