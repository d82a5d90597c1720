//! COMPOTE's files: written cameras and poses, read back, give the same projections.

use nalgebra::Vector2;
use nalgebra::{Isometry3, Translation3, UnitQuaternion};
use plenocal::calibration::{Mode, Start};
use plenocal::io::{
    CameraSource, OutputFolder, camera_document, compote, read_camera, read_camera_source,
    read_poses,
};
use plenocal::model::{FramePose, Lattice, Packing, Parity, PlenopticCamera};
use plenocal::precalibration::MicroImageArray;
use plenocal::solver::synthesize;
use proptest::prelude::*;

use crate::support::{
    NO_NOISE, board, options, pairs, run, shipped_observations, true_camera, true_poses,
};

/// The files have the shortest decimal numbers that read back to the same bits; what remains is the
/// rounding error of a few rotations and products.
const SAME_PIXEL: f64 = 1e-9;

fn grid(camera: &PlenopticCamera) -> MicroImageArray {
    MicroImageArray {
        lattice: camera.lattice,
        pitch_px: 23.3,
        rotation_rad: 0.001,
        center_px: camera.sensor.center_px(),
        perspective_per_px: Vector2::zeros(),
        rms_px: 0.1,
        outliers: 0,
    }
}

fn round_trip(camera: &PlenopticCamera, poses: &[FramePose]) -> (PlenopticCamera, Vec<FramePose>) {
    let folder = tempfile::tempdir().unwrap();
    let mut output = OutputFolder::new(folder.path()).unwrap();
    let intrinsics = compote::intrinsics_document(camera, &grid(camera)).unwrap();
    output.stage_json("intrinsics.js", &intrinsics).unwrap();
    output.stage_json("poses.js", &compote::poses_document(poses)).unwrap();
    let paths = output.commit().unwrap();
    let CameraSource::Camera(back) = read_camera_source(&paths[0]).unwrap() else {
        panic!("intrinsics.js is a camera")
    };
    (*back, read_poses(&paths[1]).unwrap())
}

/// Largest difference between projected features or centres, px.
fn largest_difference(
    (camera, poses): (&PlenopticCamera, &[FramePose]),
    (other, other_poses): (&PlenopticCamera, &[FramePose]),
) -> f64 {
    let a = synthesize(camera, &board(), poses, &NO_NOISE, 0).unwrap();
    let b = synthesize(other, &board(), other_poses, &NO_NOISE, 0).unwrap();
    assert_eq!((a.features.len(), a.centers.len()), (b.features.len(), b.centers.len()));
    assert!(a.features.len() > 1000 && a.centers.len() > 1000);
    let features = a.features.iter().zip(&b.features).map(|(a, b)| {
        assert_eq!((a.frame, a.corner, a.k, a.l), (b.frame, b.corner, b.k, b.l));
        (a.u_px - b.u_px)
            .abs()
            .max((a.v_px - b.v_px).abs())
            .max((a.rho_px.unwrap() - b.rho_px.unwrap()).abs())
    });
    let centers = a.centers.iter().zip(&b.centers).map(|(a, b)| {
        assert_eq!((a.k, a.l), (b.k, b.l));
        (a.u_px - b.u_px).abs().max((a.v_px - b.v_px).abs())
    });
    features.chain(centers).fold(0.0, f64::max)
}

#[test]
fn cameras_and_poses_read_back_give_the_same_projections() {
    let mut camera = true_camera();
    camera.mla.pitch_ratio = 1.003;
    for (packing, columns, rows) in [
        (Packing::HexagonalRows(Parity::Even), 43, 36),
        (Packing::HexagonalColumns(Parity::Even), 42, 37),
        (Packing::Orthogonal, 43, 37),
    ] {
        camera.lattice = Lattice { packing, columns, rows };
        if packing == Packing::Orthogonal {
            camera.mla.focal_lengths_mm.truncate(1);
        }
        let (back, poses) = round_trip(&camera, &true_poses());
        let difference = largest_difference((&camera, &true_poses()), (&back, &poses));
        assert!(difference < SAME_PIXEL, "{packing:?}: {difference}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]
    #[test]
    fn any_camera_and_pose_survive_a_round_trip(
        tilt in prop::array::uniform3(-0.05..0.05_f64),
        offset in prop::array::uniform2(-2.0..2.0_f64),
        principal in prop::array::uniform2(-300.0..1300.0_f64),
        turn in prop::array::uniform3(-1.5..1.5_f64),
        shift in prop::array::uniform3(-50.0..50.0_f64),
    ) {
        let mut camera = true_camera();
        camera.lattice.rows = 36;
        camera.mla.rotation_rad = tilt.into();
        camera.mla.offset_mm = offset.into();
        camera.mla.principal_point_px = principal.into();
        let pose = Isometry3::from_parts(
            Translation3::new(shift[0], shift[1], 300.0 + shift[2]),
            UnitQuaternion::from_scaled_axis(turn.into()),
        );
        let poses = [FramePose { frame: 11, camera_from_board: pose }];
        let (back, poses_back) = round_trip(&camera, &poses);
        prop_assert_eq!(back.lattice, camera.lattice);
        for (name, a, b) in pairs(&camera, &back) {
            prop_assert!((a - b).abs() <= 1e-12 * a.abs().max(1.0), "{}: {} and {}", name, a, b);
        }
        prop_assert_eq!(poses_back[0].frame, 11);
        let difference = pose.inv_mul(&poses_back[0].camera_from_board);
        prop_assert!(difference.to_homogeneous().relative_eq(
            &nalgebra::Matrix4::identity(), 1e-11, 0.0));
    }
}

#[test]
fn an_array_that_compote_cannot_express_is_an_error() {
    let camera = true_camera();
    assert_eq!(camera.lattice.rows % 2, 1);
    let error = compote::intrinsics_document(&camera, &grid(&camera)).unwrap_err().to_string();
    assert!(error.contains("even number of rows"), "{error}");
}

#[test]
fn camera_json_reads_back_to_the_same_bits() {
    let calibration = run(&Start::Camera(true_camera()), &shipped_observations(), &options());
    let folder = tempfile::tempdir().unwrap();
    let mut output = OutputFolder::new(folder.path()).unwrap();
    let document = camera_document(&calibration.camera, Some(&calibration.uncertainty));
    output.stage_json("camera.json", &document).unwrap();
    let paths = output.commit().unwrap();
    assert_eq!(read_camera(&paths[0]).unwrap(), calibration.camera);
}

#[test]
fn poses_only_from_a_written_camera_finds_the_written_poses() {
    let mut camera = true_camera();
    camera.lattice.rows = 36;
    let observations = synthesize(&camera, &board(), &true_poses(), &NO_NOISE, 0).unwrap();
    let (back, poses) = round_trip(&camera, &true_poses());
    let mut options = options();
    options.mode = Mode::PosesOnly;
    let calibration = run(&Start::Camera(back), &observations, &options);
    for (found, written) in calibration.poses.iter().zip(poses) {
        let motion = found.camera_from_board.inv_mul(&written.camera_from_board);
        assert!(motion.rotation.angle() < 1e-8 && motion.translation.vector.norm() < 1e-6);
    }
}
