//! Comparison of the bridge with the Rust side of the model.

mod absurd;

use std::panic::{AssertUnwindSafe, catch_unwind};

use nalgebra::{Isometry3, Vector2, Vector3};

use super::bridge::ffi::{self, NodeRow};
use super::*;
use crate::model::{
    BentBoard, Board, BoardShape, EdgeSpread, Lattice, LatticeKind, MainLens, MicroLensArray,
    Packing, Parameter, Parity, PlenopticCamera, Sensor,
};

fn camera(packing: Packing, columns: i32, rows: i32) -> PlenopticCamera {
    let types = if packing == Packing::Orthogonal { 1 } else { 3 };
    PlenopticCamera {
        sensor: Sensor { width_px: 100, height_px: 80, pixel_size_mm: 0.0055 },
        lattice: Lattice { packing, columns, rows },
        main_lens: MainLens {
            radial: [1.0, 2.0, 3.0],
            tangential: [4.0, 5.0],
            ..MainLens::thin(50.0)
        },
        mla: MicroLensArray {
            principal_point_px: Vector2::new(6.0, 7.0),
            mla_to_sensor_mm: 0.3,
            rotation_rad: Vector3::new(0.1, 0.2, 0.3),
            offset_mm: Vector2::new(8.0, 9.0),
            lens_to_mla_mm: 56.0,
            pitch_mm: 0.127,
            pitch_ratio: 1.01,
            focal_lengths_mm: vec![0.5; types],
        },
        edge_spread: EdgeSpread::default(),
    }
}

fn flat_board() -> BentBoard {
    Board { columns: 5, rows: 4, square_mm: 3.0 }.into()
}

#[test]
fn both_sides_name_the_same_parameters() {
    for (packing, types) in [
        (Packing::Orthogonal, 0),
        (Packing::Orthogonal, 1),
        (Packing::HexagonalRows(Parity::Odd), 3),
    ] {
        let mut camera = camera(packing, 5, 4);
        camera.mla.focal_lengths_mm.truncate(types);
        let table = Parameter::intrinsic(types);
        let distinct: Vec<f64> = (0..table.len()).map(|i| 1.5 + i as f64).collect();
        let camera = camera.with_intrinsics(&distinct);
        let shape = BoardShape { sag_x_mm: 0.1, sag_y_mm: 0.2, twist_mm: 0.3, aspect: 0.04 };
        let of_camera = table.iter().map(|&p| (p.name().to_owned(), camera.value(p)));
        let of_board = Parameter::SHAPE.map(|p| (p.name().to_owned(), shape.value(p)));
        let ours: Vec<(String, f64)> = of_camera.chain(of_board).collect();
        let names: Vec<&str> = Parameter::shared(types).iter().map(|p| p.name()).collect();
        assert!(ours.iter().map(|(name, _)| name).eq(&names));
        let bent = BentBoard { shape, ..flat_board() };
        let theirs: Vec<(String, f64)> = ffi::parameters(&(&camera).into(), &(&bent).into())
            .into_iter()
            .map(|parameter| (parameter.name, parameter.value))
            .collect();
        assert_eq!(ours, theirs);
    }
}

#[test]
fn distortion_is_the_formula_of_the_model() {
    // The formula is x (Q1 r² + Q2 r⁴ + Q3 r⁶) + P1 (r² + 2x²) + 2 P2 x y, likewise along y, with r² = 2.25 + 4.
    let camera = camera(Packing::Orthogonal, 5, 4);
    let r2: f64 = 6.25;
    let radial = r2 + 2.0 * r2.powi(2) + 3.0 * r2.powi(3);
    let expected = Vector2::new(
        1.5 * radial + 4.0 * (r2 + 4.5) + 5.0 * 2.0 * 1.5 * -2.0,
        -2.0 * radial + 5.0 * (r2 + 8.0) + 4.0 * 2.0 * 1.5 * -2.0,
    );
    let shifts = distortion_mm(&camera, &[Vector2::zeros(), Vector2::new(1.5, -2.0)]).unwrap();
    assert_eq!(shifts[0], Vector2::zeros());
    assert!((shifts[1] - expected).norm() < 1e-10 * expected.norm(), "{shifts:?}");
}

#[test]
fn a_pinhole_array_has_no_blur() {
    let mut camera = camera(Packing::Orthogonal, 5, 4);
    let pose = [Isometry3::translation(0.0, 0.0, 300.0)];
    let feature = |z| SolverFeature {
        pose: 0,
        board_point_mm: [0.0, 0.0, z],
        k: 2,
        l: 2,
        u_px: 0.0,
        v_px: 0.0,
        rho_px: 0.0,
        std_dev_px: [1.0; 3],
    };
    let features = [feature(0.0), feature(-280.0)];
    let seen = |camera: &PlenopticCamera| {
        let board = flat_board();
        project(&Problem { camera, board, poses: &pose, features: &features, centers: &[] })
            .unwrap()
    };
    let blurred = seen(&camera);
    assert!(blurred[0].unwrap().rho().is_some_and(f64::is_finite));
    assert_eq!(blurred[1], None, "within the focal length");
    camera.mla.focal_lengths_mm.clear();
    assert_eq!(seen(&camera)[0].unwrap().rho(), None);
}

#[test]
fn both_sides_number_the_lattice_in_the_same_way() {
    for kind in [LatticeKind::Orthogonal, LatticeKind::HexagonalRows, LatticeKind::HexagonalColumns]
    {
        for &packing in Packing::of_kind(kind) {
            for (columns, rows) in [(5, 4), (4, 5), (1, 3), (3, 1)] {
                let camera = camera(packing, columns, rows);
                let mut theirs = ffi::lattice(&(&camera).into()).into_iter();
                for l in 0..rows {
                    for k in 0..columns {
                        let NodeRow { x, y, lens_type } = theirs.next().unwrap();
                        let ours = camera.lattice.node(k, l);
                        assert!((ours - Vector2::new(x, y)).norm() < 1e-12);
                        assert_eq!(i32::try_from(camera.lens_type(k, l)), Ok(lens_type));
                    }
                }
            }
        }
    }
}

#[test]
fn a_panic_in_the_progress_function_comes_back_as_a_panic() {
    let camera = camera(Packing::HexagonalRows(Parity::Even), 8, 8);
    let pose = Isometry3::translation(0.0, 0.0, 300.0);
    let feature = |k, l, u_px| SolverFeature {
        pose: 0,
        board_point_mm: [0.0; 3],
        k,
        l,
        u_px,
        v_px: 40.0,
        rho_px: 0.0,
        std_dev_px: [1.0; 3],
    };
    let features: Vec<_> = (0..8).map(|i| feature(i, 7 - i, 10.0 * f64::from(i))).collect();
    let problem = Problem {
        camera: &camera,
        board: flat_board(),
        poses: &[pose],
        features: &features,
        centers: &[],
    };
    let outcome = catch_unwind(AssertUnwindSafe(|| {
        refine(&problem, &CostOptions::default(), &SolverOptions::default(), &mut |_| {
            panic!("from the caller")
        })
    }));
    let message = outcome.unwrap_err();
    assert_eq!(message.downcast_ref::<&str>(), Some(&"from the caller"));
}

#[test]
fn what_the_core_rejects_arrives_as_an_error() {
    let mut camera = camera(Packing::HexagonalRows(Parity::Even), 8, 8);
    camera.mla.mla_to_sensor_mm = f64::NAN;
    let error = project_centers(&camera, std::iter::empty()).unwrap_err().to_string();
    assert!(error.contains("d (mm)"), "{error}");
}
