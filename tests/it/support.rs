//! The shipped feature set, its truth, and how results are compared.

use std::path::{Path, PathBuf};

use assert_cmd::Command;
use plenocal::calibration::{Blur, Calibration, CalibrationOptions, Priors, Start, calibrate};
use plenocal::io::{Project, read_camera, read_centers, read_features, read_poses};
use plenocal::model::{Board, FramePose, Noise, Observations, Parameter, PlenopticCamera};
use plenocal::simulation::Settings;
use plenocal::solver::{LossKind, synthesize};

pub const NO_NOISE: Noise = Noise { uv_px: 0.0, rho_px: 0.0, centers_px: 0.0 };

/// The codes of findings.
pub fn codes(findings: &[plenocal::Finding]) -> Vec<&'static str> {
    findings.iter().map(plenocal::Finding::code).collect()
}

/// Folder of the shipped feature set.
pub fn synthetic_folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("data/synthetic")
}

/// The program.
pub fn plenocal() -> Command {
    Command::cargo_bin("plenocal").expect("the binary is built")
}

pub fn project() -> Project {
    Project::read(&synthetic_folder().join("project.toml")).unwrap()
}

pub fn board() -> Board {
    project().board.unwrap()
}

pub fn true_camera() -> PlenopticCamera {
    read_camera(&synthetic_folder().join("truth/camera.json")).unwrap()
}

pub fn true_poses() -> Vec<FramePose> {
    read_poses(&synthetic_folder().join("truth/poses.json")).unwrap()
}

/// The start that the shipped project gives: datasheet and internal parameters.
pub fn datasheet_start() -> Start {
    let project = project();
    Start::Datasheet(project.datasheet().unwrap().unwrap(), project.internal_parameters.unwrap())
}

pub fn shipped_observations() -> Observations {
    let folder = synthetic_folder();
    let mut observations = read_features(&folder.join("features.csv"), true).unwrap();
    observations.centers = read_centers(&folder.join("centers.csv")).unwrap();
    observations
}

/// The settings of a preset, with some of them replaced.
pub fn preset(name: &str, replaced: &[&str]) -> Settings {
    let replaced: Vec<String> = replaced.iter().map(ToString::to_string).collect();
    Settings::preset(name, &replaced).expect("presets are valid")
}

/// Observations of a camera at the shipped poses, with the given noise.
pub fn drawn(camera: &PlenopticCamera, noise: &Noise, seed: u64) -> Observations {
    synthesize(camera, &board(), &true_poses(), noise, seed).unwrap()
}

/// One thread: the result does not depend on the machine. No priors and no loss: the observations
/// alone, and of the parameters those of the paper.
pub fn options() -> CalibrationOptions {
    let mut fix = vec![
        Parameter::Radial1Growth,
        Parameter::FieldCurvature,
        Parameter::FieldCurvatureGrowth,
        Parameter::LensRotationX,
        Parameter::LensRotationY,
        Parameter::PupilZ,
        Parameter::PupilAberration,
    ];
    fix.extend(Parameter::SHAPE);
    CalibrationOptions {
        blur: Blur::Features,
        fix,
        priors: no_priors(),
        loss: Some(LossKind::None),
        ..defaults()
    }
}

/// No priors, not even default ones.
pub fn no_priors() -> Priors {
    Priors { default: false, ..Priors::default() }
}

/// The defaults, with one thread.
pub fn defaults() -> CalibrationOptions {
    CalibrationOptions { threads: 1, ..CalibrationOptions::default() }
}

pub fn run(
    start: &Start,
    observations: &Observations,
    options: &CalibrationOptions,
) -> Calibration {
    calibrate(start, &board(), observations, options, &mut |_| true).unwrap()
}

/// Every intrinsic parameter by name, with two values.
pub fn pairs(a: &PlenopticCamera, b: &PlenopticCamera) -> Vec<(&'static str, f64, f64)> {
    let names = Parameter::intrinsic(a.lens_types()).iter().map(|p| p.name());
    let values = a.intrinsics().into_iter().zip(b.intrinsics());
    names.zip(values).map(|(name, (a, b))| (name, a, b)).collect()
}
