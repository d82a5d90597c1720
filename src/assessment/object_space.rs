//! The σ of points in space that are reconstructed with a calibrated camera.
//!
//! A point is seen without noise, and reconstructed from its features with a camera that is wrong by
//! its covariance. Its error is G δθ, with G from `point_sensitivity` of the core. A part of the error moves all
//! of space alike: the origin of the camera frame is a convention, and the boards of the calibration
//! move with it. So the rigid motion of the boards, whose poses follow the camera, is subtracted. The
//! rest is the error of a point against the boards (as in mrcal's projection uncertainty, which
//! carries camera and poses together).

use nalgebra::{
    DMatrix, Isometry3, Matrix3, Matrix3x6, Matrix6, Point3, Translation3, UnitQuaternion, Vector3,
};

use crate::calibration::Calibration;
use crate::error::Result;
use crate::model::{Board, PlenopticCamera};
use crate::solver::{self, Uncertainty};

/// Numbers of points over the width and the height of the image.
const GRID: (u32, u32) = (9, 7);
const DISTANCES: u32 = 7;
/// Number of distances in a summary.
const SPREAD: usize = 3;
/// Relative difference below which boards are at one distance.
const ALIKE: f64 = 0.01;
/// Extent of the distances beyond the boards, as a fraction of their distance.
const BEYOND: f64 = 0.15;
/// Least distance of a visible corner from the edge of its micro-image, as a fraction of the radius.
pub(super) const MARGIN: f64 = 0.2;

/// A point in space with its σ.
#[derive(Debug, Clone, PartialEq)]
pub struct PointTrust {
    /// Pixel that shows the point, px.
    pub pixel_px: [f64; 2],
    /// Position of the point, mm.
    pub point_mm: Point3<f64>,
    /// Number of micro-lenses that see it.
    pub micro_lenses: usize,
    /// Standard deviation due to the calibration, across the axis (the larger one) and along it, mm.
    pub std_dev_mm: [f64; 2],
    /// Standard deviation due to the noise of one observation of a corner, across the axis and along it, mm.
    pub noise_mm: [f64; 2],
    /// Derivative of the error of the point by the free intrinsic parameters: three rows.
    pub(super) by_intrinsics: DMatrix<f64>,
}

impl PointTrust {
    /// Returns σ of the position in all three directions due to the calibration, mm.
    #[must_use]
    pub fn total_mm(&self, covariance: &DMatrix<f64>) -> f64 {
        (&self.by_intrinsics * covariance).dot(&self.by_intrinsics).max(0.0).sqrt()
    }
}

/// The σ of points at one distance.
#[derive(Debug, Clone, PartialEq)]
pub struct Distance {
    /// Distance from the main lens along z, mm.
    pub distance_mm: f64,
    /// True if boards of the calibration were at such distances.
    pub within_boards: bool,
    /// Points over the image that at least two micro-lenses see.
    pub points: Vec<PointTrust>,
}

impl Distance {
    /// Returns median and largest σ over the image, across the axis and along it, mm: `[across, along]` of each.
    #[must_use]
    pub fn summary_mm(&self) -> [[f64; 2]; 2] {
        let of = |i: usize, noise: bool| {
            let value = |p: &PointTrust| if noise { p.noise_mm[i] } else { p.std_dev_mm[i] };
            let mut values: Vec<f64> = self.points.iter().map(value).collect();
            values.sort_by(f64::total_cmp);
            [values[values.len() / 2], values[values.len() - 1]]
        };
        let [across, along] = [of(0, false), of(1, false)];
        [[across[0], along[0]], [across[1], along[1]]]
    }

    /// Returns the median σ due to the noise of one observation, across the axis and along it, mm.
    #[must_use]
    pub fn noise_mm(&self) -> [f64; 2] {
        [0, 1].map(|i| {
            let mut values: Vec<f64> = self.points.iter().map(|p| p.noise_mm[i]).collect();
            values.sort_by(f64::total_cmp);
            values[values.len() / 2]
        })
    }
}

/// The σ of points over field and distance.
#[derive(Debug, Clone, PartialEq)]
pub struct ObjectSpace {
    /// Distances, the nearest first. Distances without visible points are left out.
    pub distances: Vec<Distance>,
}

impl ObjectSpace {
    /// Returns all points at the distances of the boards.
    pub(super) fn points_within_boards(&self) -> impl Iterator<Item = &PointTrust> {
        self.distances.iter().filter(|d| d.within_boards).flat_map(|d| &d.points)
    }

    /// Returns the nearest, a middle and the furthest distance of the boards.
    pub(crate) fn spread_distances(&self) -> Vec<&Distance> {
        let within: Vec<&Distance> = self.distances.iter().filter(|d| d.within_boards).collect();
        let count = within.len().min(SPREAD);
        (0..count).map(|i| within[i * (within.len() - 1) / (count - 1).max(1)]).collect()
    }
}

/// Computes the σ of points; `None` if no point is seen.
pub(super) fn object_space(
    calibration: &Calibration,
    board: &Board,
) -> Result<Option<ObjectSpace>> {
    let camera = &calibration.camera;
    let middle = board.middle_mm();
    let boards: Vec<f64> =
        calibration.poses.iter().map(|p| (p.camera_from_board * middle).z).collect();
    let near = boards.iter().copied().fold(f64::INFINITY, f64::min);
    let far = boards.iter().copied().fold(0.0, f64::max);
    let motion = motion_of_boards(calibration, board);
    let between = (0..DISTANCES)
        .map(|i| near * (far / near).powf(f64::from(i) / f64::from(DISTANCES - 1)))
        .take(if far > near * (1.0 + ALIKE) { DISTANCES as usize } else { 1 });
    let mut distances = Vec::new();
    for (within_boards, distance_mm) in [(false, near * (1.0 - BEYOND))]
        .into_iter()
        .chain(between.map(|distance| (true, distance)))
        .chain([(false, far * (1.0 + BEYOND))])
    {
        let points = points_at(calibration, camera, distance_mm, &motion)?;
        if !points.is_empty() {
            distances.push(Distance { distance_mm, within_boards, points });
        }
    }
    Ok((!distances.is_empty()).then_some(ObjectSpace { distances }))
}

fn points_at(
    calibration: &Calibration,
    camera: &PlenopticCamera,
    distance_mm: f64,
    motion: &DMatrix<f64>,
) -> Result<Vec<PointTrust>> {
    let (width, height) = (camera.sensor.width_px, camera.sensor.height_px);
    let pixels: Vec<[f64; 2]> = (0..GRID.1)
        .flat_map(|j| (0..GRID.0).map(move |i| (i, j)))
        .map(|(i, j)| {
            let part = |i: u32, n: u32, size: u32| {
                (f64::from(i) + 0.5) / f64::from(n) * f64::from(size) - 0.5
            };
            [part(i, GRID.0, width), part(j, GRID.1, height)]
        })
        .collect();
    let points: Vec<Point3<f64>> =
        pixels.iter().map(|pixel| point_seen_at(camera, *pixel, distance_mm)).collect();
    let noise = calibration.uncertainty.residual_std_dev_px;
    // A ρ without weight in the calibration does not determine points either.
    let of_rho = if calibration.options.has_rho() { noise[1] } else { f64::INFINITY };
    let std_dev = [noise[0], noise[0], of_rho].map(|s| if s > 0.0 { s } else { 1.0 });
    let margin = MARGIN * camera.micro_image_pitch_px() / 2.0;
    let free = &calibration.uncertainty.free_intrinsics;
    let covariance = camera_covariance(&calibration.uncertainty);
    let sensitivities = solver::point_sensitivities(camera, &points, std_dev, margin)?;
    let trust = |((pixel, point), s): ((&[f64; 2], &Point3<f64>), solver::PointSensitivity)| {
        if !s.is_known() {
            return None;
        }
        let all = &s.by_intrinsics;
        let of_space = rigid(&point.coords) * motion;
        // The image of a point does not depend on the shape of the board.
        let of_camera = DMatrix::from_fn(3, free.len(), |i, j| {
            if free[j] < all.columns { all[(i, free[j])] } else { 0.0 }
        });
        let by_intrinsics = of_camera - of_space;
        let spread = &by_intrinsics * &covariance * by_intrinsics.transpose();
        Some(PointTrust {
            pixel_px: *pixel,
            point_mm: *point,
            micro_lenses: s.micro_lenses,
            std_dev_mm: across_and_along(&spread.fixed_view::<3, 3>(0, 0).into_owned()),
            noise_mm: across_and_along(&Matrix3::from_row_slice(&s.covariance_mm2)),
            by_intrinsics,
        })
    };
    Ok(pixels.iter().zip(&points).zip(sensitivities).filter_map(trust).collect())
}

/// Returns the covariance of the free intrinsic parameters.
pub(super) fn camera_covariance(uncertainty: &Uncertainty) -> DMatrix<f64> {
    let n = uncertainty.free_intrinsics.len();
    DMatrix::from_fn(n, n, |i, j| uncertainty.covariance[(i, j)])
}

/// Returns the largest σ across the axis, and σ along it.
fn across_and_along(covariance: &Matrix3<f64>) -> [f64; 2] {
    let across = covariance.fixed_view::<2, 2>(0, 0).into_owned().symmetric_eigenvalues().max();
    [across.max(0.0).sqrt(), covariance[(2, 2)].max(0.0).sqrt()]
}

/// Returns the point at this distance whose chief ray meets the sensor at a pixel, without distortion.
pub(super) fn point_seen_at(
    camera: &PlenopticCamera,
    [u, v]: [f64; 2],
    distance_mm: f64,
) -> Point3<f64> {
    let mla = &camera.mla;
    let pixel = camera.sensor.pixel_size_mm;
    let to_sensor = mla.lens_to_mla_mm + mla.mla_to_sensor_mm;
    let on_sensor = |seen: f64, axis: f64| (axis - seen) * pixel;
    let scale = -distance_mm / to_sensor;
    Point3::new(
        scale * on_sensor(u, mla.principal_point_px.x),
        scale * on_sensor(v, mla.principal_point_px.y),
        distance_mm,
    )
}

/// Returns the derivative of a point by a small rotation and translation of space.
fn rigid(point: &Vector3<f64>) -> DMatrix<f64> {
    let mut matrix = DMatrix::zeros(3, 6);
    matrix.view_mut((0, 0), (3, 3)).copy_from(&(-point.cross_matrix()));
    matrix.view_mut((0, 3), (3, 3)).copy_from(&Matrix3::identity());
    matrix
}

/// Fits the rigid motion of all boards together that follows a change of the intrinsic parameters: six
/// rows, by least squares over the outer corners of all boards.
fn motion_of_boards(calibration: &Calibration, board: &Board) -> DMatrix<f64> {
    let uncertainty = &calibration.uncertainty;
    let follow = DMatrix::from(&uncertainty.poses_by_intrinsics);
    // The shape of the board moves its corners too, by this mean.
    let mut by_shape = DMatrix::zeros(3, follow.ncols());
    let rows = uncertainty.shape_rows(calibration.camera.lens_types());
    for (row, motion) in rows.into_iter().zip(calibration.board.bent.mean_motion_mm()) {
        if let Some(row) = row {
            by_shape.set_column(row, &motion);
        }
    }
    let mut normal = Matrix6::zeros();
    let mut right = DMatrix::zeros(6, follow.ncols());
    for (i, pose) in calibration.poses.iter().enumerate() {
        let of_pose = follow.rows(6 * i, 6);
        let of_shape = pose.camera_from_board.rotation.to_rotation_matrix().matrix() * &by_shape;
        for corner in board.outer_corners_mm() {
            let place = pose.camera_from_board * corner;
            let space = rigid(&place.coords);
            let moved = by_pose(&pose.camera_from_board, &corner) * of_pose + &of_shape;
            normal += space.tr_mul(&space).fixed_view::<6, 6>(0, 0);
            right += space.tr_mul(&moved);
        }
    }
    let inverse = normal.try_inverse().unwrap_or_else(Matrix6::zeros);
    DMatrix::from_column_slice(6, 6, inverse.as_slice()) * right
}

/// Returns the derivative of a point of the board by the rotation vector and the translation of its pose.
fn by_pose(pose: &Isometry3<f64>, point: &Point3<f64>) -> Matrix3x6<f64> {
    /// Step in rad: small against a radian, large against rounding errors.
    const STEP: f64 = 1e-6;
    let mut matrix = Matrix3x6::zeros();
    let rotation = pose.rotation.scaled_axis();
    for i in 0..3 {
        let turned = |sign: f64| {
            let axis = rotation + sign * STEP * Vector3::ith(i, 1.0);
            let rotation = UnitQuaternion::from_scaled_axis(axis);
            Isometry3::from_parts(Translation3::identity(), rotation) * point
        };
        matrix.set_column(i, &((turned(1.0) - turned(-1.0)) / (2.0 * STEP)));
        matrix.set_column(3 + i, &Vector3::ith(i, 1.0));
    }
    matrix
}

/// Returns the largest σ over the points, for a given covariance of the camera.
pub(super) fn largest_mm<'a>(
    points: impl Iterator<Item = &'a PointTrust>,
    covariance: &DMatrix<f64>,
) -> f64 {
    points.map(|point| point.total_mm(covariance)).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests;
