//! Tests of the motion of the boards that is subtracted from the error of a point.

use super::*;
use crate::calibration::{BoardModel, CalibrationOptions, Mode, Priors, Start, calibrate};
use crate::model::small_camera as camera;
use crate::model::{BentBoard, BoardShape, FramePose, Noise, Observations, Parameter};
use crate::solver::synthesize;

const BOARD: Board = Board { columns: 9, rows: 5, square_mm: 3.0 };
const EXACT: Noise = Noise { uv_px: 0.0, rho_px: 0.0, centers_px: 0.0 };

/// Returns poses of boards with different tilts.
fn poses() -> Vec<FramePose> {
    [([0.4, 0.1, 0.0], 90.0), ([-0.3, 0.4, 0.1], 105.0), ([0.1, -0.5, 0.2], 120.0)]
        .into_iter()
        .zip(0..)
        .map(|((turn, distance), frame)| {
            let rotation = UnitQuaternion::from_scaled_axis(Vector3::from(turn));
            let middle = (rotation * BOARD.middle_mm()).coords;
            let place = Vector3::new(0.0, 0.0, distance) - middle;
            FramePose { frame, camera_from_board: Translation3::from(place) * rotation }
        })
        .collect()
}

fn calibrated(camera: PlenopticCamera, observations: &Observations, mode: Mode) -> Calibration {
    let paper = CalibrationOptions::paper();
    let options =
        if mode == Mode::PosesOnly { paper.of_poses_only(BoardShape::default()) } else { paper };
    calibrate(&Start::Camera(camera), &BOARD, observations, &options, &mut |_| true).unwrap()
}

fn outer_corners(calibration: &Calibration) -> Vec<Vector3<f64>> {
    let of_pose = |p: &FramePose| {
        BOARD.outer_corners_mm().map(|corner| (p.camera_from_board * corner).coords)
    };
    calibration.poses.iter().flat_map(of_pose).collect()
}

/// Fits the rotation and translation that take points to others best, by singular values (Kabsch).
fn rigid_motion(from: &[Vector3<f64>], to: &[Vector3<f64>]) -> (Matrix3<f64>, Vector3<f64>) {
    let middle =
        |points: &[Vector3<f64>]| points.iter().sum::<Vector3<f64>>() / points.len() as f64;
    let (a, b) = (middle(from), middle(to));
    let both: Matrix3<f64> = from.iter().zip(to).map(|(p, q)| (q - b) * (p - a).transpose()).sum();
    let svd = both.svd(true, true);
    let rotation = svd.u.unwrap() * svd.v_t.unwrap();
    (rotation, b - rotation * a)
}

/// Returns the corners of boards of this shape.
fn bent_corners(calibration: &Calibration, shape: &BoardShape) -> Vec<Vector3<f64>> {
    let bent = BentBoard { board: BOARD, shape: *shape };
    let of_pose = |p: &FramePose| {
        let place = p.camera_from_board;
        (0..BOARD.corners()).map(move |i| (place * bent.point_mm(i)).coords)
    };
    calibration.poses.iter().flat_map(of_pose).collect()
}

/// A change of the shape of a board moves its frame, but hardly its corners, which are observed.
#[test]
fn the_motion_taken_off_is_that_of_corners_not_of_the_frame_of_a_board() {
    const CHANGES: [f64; 4] = [1e-3, 1e-3, 1e-3, 1e-4];
    let observations = synthesize(&camera(), &BOARD, &poses(), &EXACT, 1).unwrap();
    let options = CalibrationOptions { board: BoardModel::Bent, ..CalibrationOptions::paper() };
    let options = CalibrationOptions { priors: Priors::default(), ..options };
    let calibrate_with = |options: &CalibrationOptions| {
        calibrate(&Start::Camera(camera()), &BOARD, &observations, options, &mut |_| true).unwrap()
    };
    let bent = calibrate_with(&options);
    let motion = motion_of_boards(&bent, &BOARD);
    let before = bent_corners(&bent, &BoardShape::default());
    let rows = bent.uncertainty.shape_rows(3);
    for ((parameter, change), row) in Parameter::SHAPE.iter().zip(CHANGES).zip(rows) {
        let mut shape = BoardShape::default();
        shape.set(*parameter, change);
        let posed = calibrate_with(&options.of_poses_only(shape));
        let (rotation, translation) = rigid_motion(&before, &bent_corners(&posed, &shape));
        // Largest motion of the frames of the boards.
        let frames = outer_corners(&posed).into_iter().zip(outer_corners(&bent));
        let apart = frames.map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
        for corner in &before {
            let found = rotation * corner + translation - corner;
            let expected = rigid(corner) * motion.column(row.unwrap()) * change;
            let off = (found - expected).norm();
            assert!(off < 0.15 * apart, "{}: {off} of {apart}", parameter.name());
        }
    }
}

/// With another camera, the boards have other poses. The motion that they share is subtracted from the error of a point.
#[test]
fn the_motion_taken_off_is_that_of_boards_posed_with_another_camera() {
    /// Norm of the change of all residuals, px: so small that the motion is proportional to it.
    const CHANGE: f64 = 1e-3;
    const TOLERANCE: f64 = 1e-3;
    let observations = synthesize(&camera(), &BOARD, &poses(), &EXACT, 1).unwrap();
    let calibration = calibrated(camera(), &observations, Mode::Full);
    let motion = motion_of_boards(&calibration, &BOARD);
    let before = outer_corners(&calibration);
    let uncertainty = &calibration.uncertainty;
    for (column, &index) in uncertainty.free_intrinsics.iter().enumerate() {
        let parameter = &Parameter::intrinsic(3)[index];
        let change = CHANGE / uncertainty.information[column].sqrt();
        let mut other = calibration.camera.clone();
        other.set(*parameter, calibration.camera.value(*parameter) + change);
        let posed = calibrated(other, &observations, Mode::PosesOnly);
        let (rotation, translation) = rigid_motion(&before, &outer_corners(&posed));
        let mut largest: f64 = 0.0;
        let mut off: f64 = 0.0;
        for point in [[0.0, 0.0, 80.0], [20.0, -10.0, 100.0], [-15.0, 15.0, 130.0]] {
            let point = Vector3::from(point);
            let found = rotation * point + translation - point;
            let expected = rigid(&point) * motion.column(column) * change;
            largest = largest.max(found.norm());
            off = off.max((found - &expected).norm());
        }
        assert!(off < TOLERANCE * largest, "{}: {off} of {largest}", parameter.name());
    }
}
