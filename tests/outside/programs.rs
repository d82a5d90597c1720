//! Programs of users: the examples in C++, and problems that are exported for programs of their own.

use std::fmt::Write as _;
use std::path::Path;
use std::process::{Command, Output};

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use plenocal::calibration::{SolvedProblem, Start};
use plenocal::io::{OutputFolder, read_camera, read_poses, stage_problem};
use plenocal::model::{FramePose, Noise};
use plenocal::solver::{MicroPixel, VirtualPoint, metric_points};
use tempfile::TempDir;

use crate::needs::EXAMPLES;
use crate::support::{board, drawn, options, run, synthetic_folder, true_camera, true_poses};

fn program(name: &str) -> Command {
    Command::new(EXAMPLES.folder().join(name))
}

fn text(output: &Output) -> String {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout.clone()).unwrap()
}

/// The C++ of a page of the documentation: its blocks, one after the other.
fn documented(page: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs").join(page);
    let text = std::fs::read_to_string(path).unwrap();
    let blocks = text.split("```cpp\n").skip(1).map(|rest| rest.split("```").next().unwrap());
    blocks.collect()
}

fn drawn_at(poses: &[FramePose], noise: &Noise, seed: u64) -> plenocal::model::Observations {
    plenocal::solver::synthesize(&true_camera(), &board(), poses, noise, seed).unwrap()
}

/// The C++ stack finds the points that the Rust library finds.
pub fn a_stack_turns_virtual_depths_into_metric_points() {
    let folder = TempDir::new().unwrap();
    let camera = true_camera();
    let mut csv = "k,l,u,v,nu\n".to_owned();
    let mut seen = Vec::new();
    for (i, (k, l)) in [(10, 8), (21, 18), (30, 25)].into_iter().enumerate() {
        let (u_px, v_px, nu) = (23.2 * f64::from(k), 20.1 * f64::from(l), 2.4 + 0.3 * i as f64);
        writeln!(csv, "{k},{l},{u_px},{v_px},{nu}").unwrap();
        let at = MicroPixel { k, l, u_px, v_px };
        seen.push(VirtualPoint { at, virtual_depth: nu, std_dev: [0.0; 3] });
    }
    let depths = folder.path().join("depths.csv");
    std::fs::write(&depths, csv).unwrap();
    let file = synthetic_folder().join("truth/camera.json");
    let found = text(&program("metric_points").arg(&file).arg(&depths).output().unwrap());
    let expected = metric_points(&camera, &seen).unwrap();
    assert_eq!(found.lines().count(), 4);
    for (line, expected) in found.lines().skip(1).zip(expected) {
        let numbers: Vec<f64> = line.split(',').map(|n| n.parse().unwrap()).collect();
        let apart = (Vector3::from_column_slice(&numbers)
            - Vector3::from(expected.unwrap().point_mm))
        .norm();
        assert!(apart < 1e-6 * numbers[2], "{line}");
    }
    // The same program in Rust.
    let mut cargo = Command::new(env!("CARGO"));
    cargo.args(["run", "--release", "--quiet", "--example", "metric_points", "--"]);
    let in_rust = text(&cargo.arg(&file).arg(&depths).output().unwrap());
    let numbers = |text: &str| -> Vec<f64> {
        text.split([',', '\n']).filter_map(|n| n.parse().ok()).collect()
    };
    let (in_rust, in_cpp) = (numbers(&in_rust), numbers(&found));
    assert!(in_rust.len() == 9 && in_rust.iter().zip(&in_cpp).all(|(a, b)| (a - b).abs() < 2e-6));
    let wrong = program("metric_points").arg(&depths).arg(&depths).output().unwrap();
    assert!(!wrong.status.success());
    assert!(String::from_utf8_lossy(&wrong.stderr).contains("depths.csv"));
}

/// The program of the documentation finds the poses of an exported problem, which plenocal reads.
pub fn own_ceres_finds_poses_of_an_exported_problem() {
    let folder = TempDir::new().unwrap();
    let problem = folder.path().join("problem");
    let noise = Noise { uv_px: 0.05, rho_px: 0.02, centers_px: 0.02 };
    let observations = drawn(&true_camera(), &noise, 5);
    let calibration = run(&Start::Camera(true_camera()), &observations, &options());
    let mut output = OutputFolder::new(&problem).unwrap();
    stage_problem(&mut output, &SolvedProblem::of(&calibration, &board())).unwrap();
    output.commit().unwrap();
    let run = program("own_ceres").arg(&problem).arg(folder.path()).output().unwrap();
    assert!(text(&run).contains("CONVERGENCE"));
    let found = read_poses(&folder.path().join("poses.json")).unwrap();
    // The camera of the problem's start is the true one, and so are the poses, to the noise.
    for (found, truth) in found.iter().zip(true_poses()) {
        let [found, truth] = [found, &truth].map(|p| p.camera_from_board.translation.vector);
        assert!((found - truth).norm() < 0.1, "{found} for {truth}");
    }
    let none = program("own_ceres").arg(folder.path()).arg(folder.path()).output().unwrap();
    assert_eq!(none.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&none.stderr).contains("problem.json"));
}

/// What the documentation says in C++ compiles, and does not throw.
pub fn the_documentation_speaks_cpp() {
    const GIVEN: &str = "
        Eigen::MatrixXd lens = Eigen::MatrixXd::Zero(1, plenocal::kMainLensParameters);
        lens(0, 0) = 1.0;
        Eigen::VectorXd value = Eigen::VectorXd::Constant(plenocal::kMainLensParameters, 16.0);
        auto* my_prior = new ceres::NormalPrior(lens, value);
        const plenocal::Pose second_from_first{};";
    let folder = TempDir::new().unwrap();
    let noise = Noise { uv_px: 0.05, rho_px: 0.02, centers_px: 0.02 };
    let calibration =
        run(&Start::Camera(true_camera()), &drawn(&true_camera(), &noise, 6), &options());
    for name in ["problem", "other"] {
        let mut output = OutputFolder::new(&folder.path().join(name)).unwrap();
        stage_problem(&mut output, &SolvedProblem::of(&calibration, &board())).unwrap();
        output.commit().unwrap();
    }
    for name in ["camera.json", "poses.json"] {
        std::fs::copy(folder.path().join("problem").join(name), folder.path().join(name)).unwrap();
    }
    let mut source = "#include <ceres/ceres.h>\n#include <ceres/normal_prior.h>\n".to_owned();
    let mut body = String::new();
    for (page, given) in [("use.md", ""), ("own-programs.md", GIVEN)] {
        let (includes, rest): (Vec<String>, Vec<String>) = documented(page)
            .lines()
            .map(|line| line.to_owned() + "\n")
            .partition(|line| line.starts_with("#include"));
        source += &includes.concat();
        writeln!(body, "{{ {given}\n{} }}", rest.concat()).unwrap();
    }
    writeln!(source, "int main() {{ {body} }}").unwrap();
    let file = folder.path().join("documented.cpp");
    std::fs::write(&file, source).unwrap();
    let examples = EXAMPLES.folder();
    let built = examples.parent().unwrap();
    let mut compiler = Command::new("g++");
    compiler.args(["-std=c++17", "-w", "-I", "/usr/include/eigen3", "-I"]);
    compiler.arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("cpp/include")).arg(&file);
    compiler.arg(built.join("libplenocal_io.a")).arg(built.join("libplenocal.a"));
    compiler.args(["-lceres", "-lglog", "-o"]).arg(folder.path().join("documented"));
    text(&compiler.output().unwrap());
    let mut program = Command::new(folder.path().join("documented"));
    text(&program.current_dir(folder.path()).output().unwrap());
}

/// Two cameras see the same boards: `rig` finds where the second is, and both cameras.
pub fn a_rig_of_two_cameras_is_refined_from_two_exported_problems() {
    let noise = Noise { uv_px: 0.05, rho_px: 0.02, centers_px: 0.02 };
    let second_from_first = Isometry3::from_parts(
        Translation3::new(-4.0, 1.0, 0.5),
        UnitQuaternion::from_scaled_axis(Vector3::new(0.01, -0.03, 0.02)),
    );
    let camera = true_camera();
    let folder = TempDir::new().unwrap();
    let export = |name: &str, poses: &[FramePose], seed: u64| {
        let observations = drawn_at(poses, &noise, seed);
        let start = Start::Camera(camera.clone());
        let calibration = run(&start, &observations, &options());
        let mut output = OutputFolder::new(&folder.path().join(name)).unwrap();
        stage_problem(&mut output, &SolvedProblem::of(&calibration, &board())).unwrap();
        output.commit().unwrap();
    };
    let poses = true_poses();
    let in_second: Vec<FramePose> = poses
        .iter()
        .map(|p| FramePose { camera_from_board: second_from_first * p.camera_from_board, ..*p })
        .collect();
    export("first", &poses, 1);
    export("second", &in_second, 2);
    let said = text(
        &program("rig").current_dir(folder.path()).args(["first", "second", "."]).output().unwrap(),
    );
    let numbers: Vec<f64> = said
        .lines()
        .find(|line| line.starts_with("second from first"))
        .unwrap()
        .split_whitespace()
        .filter_map(|word| word.trim_end_matches(',').parse().ok())
        .collect();
    let rotation = second_from_first.rotation.scaled_axis();
    let translation = second_from_first.translation.vector;
    let [rx, ry, rz, tx, ty, tz] = numbers[..] else { panic!("{said}") };
    assert!((Vector3::new(rx, ry, rz) - rotation).norm() < 5e-4, "{said}");
    assert!((Vector3::new(tx, ty, tz) - translation).norm() < 0.1, "{said}");
    for name in ["first.json", "second.json"] {
        let found = read_camera(&folder.path().join(name)).unwrap();
        let (f, truth) = (found.main_lens.focal_length_mm, camera.main_lens.focal_length_mm);
        assert!((f / truth - 1.0).abs() < 5e-3, "{name}: {f} for {truth}");
    }
}
