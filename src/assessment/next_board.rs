//! The further board that would lower the largest σ in space most.
//!
//! Boards are tried at several distances, tilts and positions. Let M be the covariance of the camera, and S
//! the information on it from a board with an unknown pose. With the board, the covariance is
//! (M⁻¹ + S)⁻¹. S is divided by the mean ratio of M to the covariance of independent errors, since a
//! further board will have shared errors too.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, Isometry3, Translation3, UnitQuaternion, Vector3};
use rayon::prelude::*;

use super::object_space::{MARGIN, ObjectSpace, camera_covariance, largest_mm, point_seen_at};
use crate::calibration::Calibration;
use crate::error::Result;
use crate::model::Board;
use crate::solver::{self, CostOptions, Problem, SolverFeature};

/// Distances to try: factors on the nearest and on the farthest distance of the boards.
const NEARER: f64 = 0.9;
const FARTHER: f64 = 1.1;
/// Tilts to try, about x or y.
const TILT_DEG: f64 = 30.0;
/// Positions of the middle of the board, as fractions of the image.
const PLACES: [([f64; 2], &str); 5] = [
    ([0.5, 0.5], "in the middle of the image"),
    ([0.25, 0.25], "in the upper left of the image"),
    ([0.75, 0.25], "in the upper right of the image"),
    ([0.25, 0.75], "in the lower left of the image"),
    ([0.75, 0.75], "in the lower right of the image"),
];
/// Largest number of corners of a board that are used, along each side.
const SIDE: i32 = 6;
/// Ratio of the largest σ with and without a board, below which the board is worth taking.
const WORTH: f64 = 0.98;

/// A further board that would help.
#[derive(Debug, Clone, PartialEq)]
pub struct NextBoard {
    /// Pose of the board.
    pub pose: Isometry3<f64>,
    /// Distance of the middle of the board, mm.
    pub distance_mm: f64,
    /// Rotation about the x and the y axis of the camera, degrees.
    pub tilt_deg: [f64; 2],
    /// Pixel that shows the middle of the board, px.
    pub pixel_px: [f64; 2],
    /// Position in the image in words.
    pub place: &'static str,
    /// Largest σ in space within the distances of the boards, before and after, mm.
    pub largest_mm: [f64; 2],
}

/// Returns the best of the boards tried; `None` if none helps.
pub(super) fn next_board(
    calibration: &Calibration,
    board: &Board,
    space: &ObjectSpace,
) -> Result<Option<NextBoard>> {
    let candidates = candidates(calibration, board);
    let information = information(calibration, board, &candidates)?;
    let free = calibration.uncertainty.free_intrinsics.len();
    let uncertainty = &calibration.uncertainty;
    let covariance = camera_covariance(uncertainty);
    // A further board will have as large shared errors as the boards so far.
    let ratio = |i: usize| covariance[(i, i)] / uncertainty.independent_covariance[(i, i)];
    let dispersion = (0..free).map(ratio).sum::<f64>() / free.max(1) as f64;
    let largest = |covariance: &DMatrix<f64>| largest_mm(space.points_within_boards(), covariance);
    let before = largest(&covariance);
    let with_board =
        |information: &DMatrix<f64>| largest(&with(&covariance, &(information / dispersion)));
    let all: Vec<f64> = information.par_iter().map(with_board).collect();
    let mut best: Option<NextBoard> = None;
    for (candidate, after) in candidates.into_iter().zip(all) {
        if after < best.as_ref().map_or(WORTH * before, |b| b.largest_mm[1]) {
            best = Some(NextBoard { largest_mm: [before, after], ..candidate });
        }
    }
    Ok(best)
}

fn candidates(calibration: &Calibration, board: &Board) -> Vec<NextBoard> {
    let camera = &calibration.camera;
    let middle = board.middle_mm();
    let distances = calibration.poses.iter().map(|p| (p.camera_from_board * middle).z);
    let near = NEARER * distances.clone().fold(f64::INFINITY, f64::min);
    let far = FARTHER * distances.fold(0.0, f64::max);
    let size = [camera.sensor.width_px, camera.sensor.height_px].map(f64::from);
    let tilts = [[0.0, 0.0], [TILT_DEG, 0.0], [-TILT_DEG, 0.0], [0.0, TILT_DEG], [0.0, -TILT_DEG]];
    let mut candidates = Vec::new();
    for distance_mm in [near, (near * far).sqrt(), far] {
        for tilt_deg in tilts {
            for (part, place) in PLACES {
                let pixel_px = [part[0] * size[0], part[1] * size[1]];
                let at = point_seen_at(camera, pixel_px, distance_mm);
                let [x, y] = tilt_deg.map(f64::to_radians);
                let turn = UnitQuaternion::from_scaled_axis(Vector3::new(x, y, 0.0));
                let pose = Translation3::from(at.coords - turn * middle.coords) * turn;
                let board = NextBoard {
                    pose,
                    distance_mm,
                    tilt_deg,
                    pixel_px,
                    place,
                    largest_mm: [0.0; 2],
                };
                candidates.push(board);
            }
        }
    }
    candidates
}

/// Returns the information of each board on the free intrinsic parameters; zero for boards with too few features.
fn information(
    calibration: &Calibration,
    board: &Board,
    candidates: &[NextBoard],
) -> Result<Vec<DMatrix<f64>>> {
    let (camera, bent) = (&calibration.camera, calibration.board.bent);
    let column = |i: i32| i * (board.columns - 1) / (board.columns.min(SIDE) - 1);
    let row = |j: i32| j * (board.rows - 1) / (board.rows.min(SIDE) - 1);
    let corners: Vec<i32> = (0..board.rows.min(SIDE))
        .flat_map(|j| (0..board.columns.min(SIDE)).map(move |i| (i, j)))
        .map(|(i, j)| row(j) * board.columns + column(i))
        .collect();
    let points: Vec<_> = corners.iter().map(|&corner| board.point_mm(corner)).collect();
    let margin = MARGIN * camera.micro_image_pitch_px() / 2.0;
    let noise = calibration.uncertainty.residual_std_dev_px;
    let all: Vec<Isometry3<f64>> = candidates.iter().map(|c| c.pose).collect();
    let mut features = solver::visible_features(camera, &bent, &all, &points, margin)?;
    let sensor = &camera.sensor;
    features.retain(|f| {
        let inside = |x: f64, size: u32| x >= 0.0 && x < f64::from(size);
        inside(f.u_px, sensor.width_px) && inside(f.v_px, sensor.height_px)
    });
    // Poses without enough features are left out.
    let seen: Vec<usize> = (0..all.len())
        .filter(|&i| features.iter().filter(|f| f.pose == i).count() >= corners.len())
        .collect();
    features.retain(|f| seen.contains(&f.pose));
    let place =
        |f: &SolverFeature| (f.pose, f.board_point_mm[0].to_bits(), f.board_point_mm[1].to_bits());
    let mut of_corner: BTreeMap<_, f64> = BTreeMap::new();
    for feature in &features {
        *of_corner.entry(place(feature)).or_default() += 1.0;
    }
    for feature in &mut features {
        // All ρ of a corner come from one virtual depth.
        let shared = of_corner[&place(feature)].sqrt();
        feature.pose = seen.iter().position(|&i| i == feature.pose).unwrap_or(0);
        feature.std_dev_px =
            [noise[0], noise[0], shared * noise[1]].map(|s| if s > 0.0 { s } else { 1.0 });
    }
    let free = calibration.uncertainty.free_intrinsics.len();
    let mut result = vec![DMatrix::zeros(free, free); all.len()];
    if seen.is_empty() {
        return Ok(result);
    }
    let poses: Vec<_> = seen.iter().map(|&i| all[i]).collect();
    let problem = Problem { camera, board: bent, poses: &poses, features: &features, centers: &[] };
    let cost = CostOptions { fixed: calibration.cost.fixed.clone(), ..CostOptions::default() };
    let found = solver::frame_information(&problem, &cost, calibration.options.threads)?;
    for (i, information) in seen.into_iter().zip(found) {
        result[i] = information;
    }
    Ok(result)
}

/// Returns (M⁻¹ + S)⁻¹ = M − M R (1 + R'M R)⁻¹ R'M with S = R R', which needs no inverse of M.
fn with(covariance: &DMatrix<f64>, information: &DMatrix<f64>) -> DMatrix<f64> {
    let eigen = information.clone().symmetric_eigen();
    let root = &eigen.eigenvectors
        * DMatrix::from_diagonal(&eigen.eigenvalues.map(|value| value.max(0.0).sqrt()));
    let moved = covariance * &root;
    let inner = DMatrix::identity(root.ncols(), root.ncols()) + root.tr_mul(&moved);
    match inner.cholesky() {
        Some(inner) => covariance - &moved * inner.solve(&moved.transpose()),
        None => covariance.clone(),
    }
}
