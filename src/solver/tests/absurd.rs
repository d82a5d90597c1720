//! Extreme values across the bridge: they give errors or results. A CHECK in Ceres or glog would end the process.

use nalgebra::{Point3, Quaternion, UnitQuaternion};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};

use super::*;
use crate::model::small_camera;

const CASES: u64 = 1_000;
const VALUES: [f64; 20] = [
    0.0,
    -0.0,
    1.0,
    -1.0,
    0.5,
    1e-12,
    -1e-12,
    1e3,
    -1e3,
    1e6,
    1e12,
    -1e12,
    1e100,
    1e154,
    1e308,
    -1e308,
    5e-324,
    f64::INFINITY,
    f64::NEG_INFINITY,
    f64::NAN,
];
const NUMBERS: [i32; 8] = [0, 1, -1, 2, 36, 500, i32::MAX, i32::MIN];

/// Problem with owned values.
struct Parts {
    camera: PlenopticCamera,
    board: BentBoard,
    poses: Vec<Isometry3<f64>>,
    features: Vec<SolverFeature>,
    centers: Vec<SolverCenter>,
    cost: CostOptions,
}

fn parts() -> Parts {
    let camera = small_camera();
    let board: BentBoard = Board { columns: 4, rows: 3, square_mm: 3.0 }.into();
    let place = |x, turn| {
        let turn = UnitQuaternion::from_euler_angles(turn, 0.1, 0.0);
        Isometry3::from_parts(nalgebra::Translation3::new(x, -3.0, 80.0), turn)
    };
    let poses = vec![place(-5.0, 0.2), place(-4.0, -0.3)];
    let points: Vec<_> = (0..12).map(|corner| board.board.point_mm(corner)).collect();
    let features = visible_features(&camera, &board, &poses, &points, 3.0).unwrap();
    let features: Vec<_> = features.into_iter().step_by(5).collect();
    assert!(features.len() > 20, "the board is seen");
    let nodes = (5..35).step_by(5).flat_map(|l| (5..40).step_by(7).map(move |k| (k, l)));
    let places = project_centers(&camera, nodes.clone()).unwrap();
    let center = |((k, l), [u_px, v_px]): ((i32, i32), [f64; 2])| SolverCenter {
        k,
        l,
        u_px,
        v_px,
        std_dev_px: 1.0,
    };
    let centers = nodes.zip(places).map(center).collect();
    let prior =
        |quantity: &str, value| Prior { quantity: quantity.to_owned(), value, std_dev: 0.1 };
    let priors = vec![prior("F", 16.2), prior("m", 0.14), prior("q'_1", 0.036)];
    let loss = Loss { kind: LossKind::Huber, scale: 4.0 };
    Parts {
        camera,
        board,
        poses,
        features,
        centers,
        cost: CostOptions { loss, priors, ..CostOptions::default() },
    }
}

fn any<T: Copy>(items: &[T], random: &mut StdRng) -> T {
    items[random.random_range(0..items.len())]
}

/// Makes one value absurd.
fn spoil(parts: &mut Parts, random: &mut StdRng) {
    let (value, number) = (any(&VALUES, random), any(&NUMBERS, random));
    let at = random.random_range(0..parts.features.len());
    let axis = random.random_range(0..3);
    match random.random_range(0..14) {
        0..=2 => {
            let mut values = parts.camera.intrinsics();
            let place = random.random_range(0..values.len());
            values[place] = value;
            parts.camera = parts.camera.with_intrinsics(&values);
        }
        3 => parts.camera.lattice.columns = number,
        4 => parts.camera.sensor.pixel_size_mm = value,
        5 => parts.poses[at % 2].translation.vector[axis] = value,
        6 => {
            let turned = Quaternion::new(value, 0.5, value, 0.1);
            parts.poses[at % 2].rotation = UnitQuaternion::new_unchecked(turned);
        }
        7 => parts.features[at].board_point_mm[axis] = value,
        8 => (parts.features[at].k, parts.features[at].pose) = (number, at),
        9 => {
            let feature = &mut parts.features[at];
            (feature.u_px, feature.rho_px) = (value, if axis > 0 { value } else { f64::NAN });
            feature.std_dev_px[axis] = any(&VALUES, random);
        }
        10 => {
            let center = at % parts.centers.len();
            let center = &mut parts.centers[center];
            (center.u_px, center.l) = (value, number);
        }
        11 => parts.cost.priors[axis].value = value,
        12 => {
            let cost = &mut parts.cost;
            *any_mut(
                [&mut cost.uv_std_dev_px, &mut cost.loss.scale, &mut cost.prior_weight],
                axis,
            ) = value;
        }
        _ => (parts.board.shape.sag_x_mm, parts.board.board.columns) = (value, number),
    }
}

fn any_mut<T, const N: usize>(items: [&mut T; N], i: usize) -> &mut T {
    items.into_iter().nth(i % N).unwrap()
}

#[test]
fn absurd_values_come_back_as_errors_or_results() {
    // Ceres logs values that are not finite at length.
    silence_log();
    let (mut errors, mut results) = (0, 0);
    for case in 0..CASES {
        let mut random = StdRng::seed_from_u64(case);
        let mut parts = parts_of_case(&mut random);
        let solver = SolverOptions { threads: 1, max_iterations: 2, ..SolverOptions::default() };
        let Parts { camera, board, poses, features, centers, cost } = &mut parts;
        let problem = Problem { camera, board: *board, poses, features, centers };
        match refine(&problem, cost, &solver, &mut |_| true) {
            Ok(refinement) => {
                results += 1;
                let values = refinement.camera.intrinsics();
                assert!(values.iter().all(|x| x.is_finite()), "{case}: {values:?}");
            }
            Err(_) => errors += 1,
        }
        let _ = project(&problem);
        let _ = uncertainty(&problem, cost, &[], 1);
        let _ = frame_information(&problem, cost, 1);
        let points = [Point3::from(problem.features[0].board_point_mm)];
        let _ = visible_features(problem.camera, &problem.board, problem.poses, &points, 3.0);
        let _ = point_sensitivities(problem.camera, &points, [1.0; 3], 3.0);
    }
    assert!(errors > 100 && results > 100, "{errors} errors, {results} results");
}

/// Creates a problem with one or two absurd values.
fn parts_of_case(random: &mut StdRng) -> Parts {
    let mut parts = parts();
    for _ in 0..random.random_range(1..=2) {
        spoil(&mut parts, random);
    }
    parts
}
