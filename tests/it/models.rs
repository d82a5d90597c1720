//! Whether a group of parameters is said to be worth what it is.

use nalgebra::Vector3;
use plenocal::assessment::{Group, ModelComparison, WithoutGroup, Worth, compare_models};
use plenocal::calibration::{Calibration, CalibrationOptions, Refit, Start};
use plenocal::model::{Noise, Observations, Parameter, PlenopticCamera, optics};
use plenocal::report::model_figures;
use plenocal::solver::synthesize;
use predicates::prelude::PredicateBooleanExt;
use predicates::str::contains;
use serde_json::Value;
use tempfile::TempDir;

use crate::support::{
    board, datasheet_start, defaults, no_priors, pairs, plenocal, run, shipped_observations,
    synthetic_folder, true_camera,
};
use crate::uncertainty::sixteen_poses;

const FOLDS: usize = 5;
const NOISE: Noise = Noise { uv_px: 0.02, rho_px: 0.005, centers_px: 0.005 };

fn compared(calibration: &Calibration) -> ModelComparison {
    let result = compare_models(calibration, &board(), FOLDS, &|| ()).unwrap();
    assert_eq!(result.findings, []);
    for without in &result.groups {
        println!(
            "{}: {:?}, {:?}",
            without.group,
            without.mean_growth(),
            without.focal_length_change
        );
    }
    result
}

fn of(comparison: &ModelComparison, group: Group) -> &WithoutGroup {
    comparison.groups.iter().find(|without| without.group == group).unwrap()
}

/// A camera with an exit pupil off the lens, a curved field, and no distortion.
fn real_camera() -> PlenopticCamera {
    let mut camera = true_camera();
    let lens = &mut camera.main_lens;
    lens.exit_pupil_mm = Vector3::new(0.0, 0.0, -5.0);
    (lens.field_curvature_per_mm, lens.field_curvature_growth_per_mm) = (0.004, 0.01);
    (lens.radial, lens.tangential) = ([0.0; 3], [0.0; 2]);
    camera
}

fn start(camera: &PlenopticCamera) -> Start {
    let Start::Datasheet(sheet, _) = datasheet_start() else { unreachable!() };
    Start::Datasheet(sheet, optics::internal_parameters(camera))
}

fn observed(camera: &PlenopticCamera, seed: u64) -> Observations {
    let mut observations = synthesize(camera, &board(), &sixteen_poses(), &NOISE, seed).unwrap();
    for feature in &mut observations.features {
        feature.std_dev_px = Some([NOISE.uv_px; 2]);
        feature.rho_std_dev_px = Some(NOISE.rho_px);
    }
    for center in &mut observations.centers {
        center.std_dev_px = Some(NOISE.centers_px);
    }
    observations
}

/// The shipped camera has distortion, its pupil in the lens, and a flat field.
#[test]
fn groups_that_the_camera_has_are_needed() {
    let calibration = run(&datasheet_start(), &shipped_observations(), &defaults());
    let comparison = compared(&calibration);
    for group in [Group::ExitPupil, Group::FieldCurvature] {
        let without = of(&comparison, group);
        assert_eq!(without.worth(), Worth::NoDifference, "{group}");
        assert!(!without.moves_unasked(), "{group}");
        assert!(without.cost_growth.iter().sum::<f64>().abs() < 4.0, "{:?}", without.cost_growth);
    }
    for group in [Group::RadialDistortion, Group::TangentialDistortion] {
        let without = of(&comparison, group);
        assert_eq!(without.worth(), Worth::Needed, "{group}");
        assert!(without.cost_growth.iter().sum::<f64>() > 20.0, "{:?}", without.cost_growth);
    }
    // Without it something else has to explain the distortion.
    let (longer_mm, std_devs) = of(&comparison, Group::RadialDistortion).focal_length_change;
    assert!(longer_mm.abs() > 1.0 && std_devs.unwrap().abs() > 5.0, "{longer_mm}");
}

#[test]
fn exit_pupil_and_field_curvature_of_a_real_lens_earn_their_keep() {
    for seed in [1, 2] {
        let truth = real_camera();
        let calibration = run(&start(&truth), &observed(&truth, seed), &defaults());
        let comparison = compared(&calibration);
        for group in [Group::ExitPupil, Group::FieldCurvature] {
            assert_eq!(of(&comparison, group).worth(), Worth::Needed, "{group}");
        }
        for group in [Group::RadialDistortion, Group::TangentialDistortion] {
            assert_eq!(of(&comparison, group).worth(), Worth::NoDifference, "{group}");
        }
        // u and v.
        assert!((1.8..2.2).contains(&comparison.mean_error()), "{}", comparison.mean_error());
    }
}

/// From the minimum with the parameters the way leads to the minimum that the datasheet leads to.
#[test]
fn without_a_group_the_minimum_is_that_of_a_calibration_without_it() {
    let truth = real_camera();
    let observations = observed(&truth, 3);
    let mut options = CalibrationOptions { priors: no_priors(), ..defaults() };
    let calibration = run(&start(&truth), &observations, &options);
    let board = board();
    let refit = Refit::new(&calibration, &board);
    let held = [
        Parameter::PupilZ,
        Parameter::PupilAberration,
        Parameter::FieldCurvature,
        Parameter::FieldCurvatureGrowth,
    ];
    options.fix.extend(held);
    let expected = run(&start(&truth), &observations, &options);
    let found = refit.without(&held).unwrap();
    assert!(expected.converged && found.converged);
    let cost: f64 = found.cost_parts.iter().sum();
    assert!((cost / expected.refinement.cost - 1.0).abs() < 1e-9, "{cost}");
    assert!(cost > 1.5 * calibration.refinement.cost, "{cost}");
    let std_devs = expected.uncertainty.intrinsic_std_devs(3);
    for ((name, a, b), std_dev) in pairs(&found.camera, &expected.camera).iter().zip(std_devs) {
        assert!((a - b).abs() <= 1e-3 * std_dev.unwrap_or(0.0), "{name}: {a} and {b}");
    }
}

/// The same frames, all with the same errors: the parts of the cost are those of the calibration.
#[test]
fn the_parts_of_the_cost_are_those_of_the_calibration() {
    let calibration = run(&datasheet_start(), &shipped_observations(), &defaults());
    let board = board();
    let minimum = Refit::new(&calibration, &board).minimum();
    let [_, centers, priors] = minimum.cost_parts;
    let squares: f64 = calibration.priors.iter().map(|a| a.normalised_residual().powi(2)).sum();
    assert!((priors - calibration.cost.prior_weight / 2.0 * squares).abs() < 1e-12);
    let of_centers: f64 = calibration
        .reprojection
        .centers
        .iter()
        .map(|c| (c.du_px.powi(2) + c.dv_px.powi(2)) / c.center.std_dev_px.unwrap_or(1.0).powi(2))
        .sum();
    assert!((2.0 * centers / of_centers - 1.0).abs() < 1e-6, "{centers} and {of_centers}");
}

#[test]
fn what_cannot_be_compared_is_an_error_with_the_reason() {
    let error = |calibration: &Calibration, folds: usize| {
        compare_models(calibration, &board(), folds, &|| ()).unwrap_err().to_string()
    };
    let mut options = defaults();
    options.fix.extend([
        Parameter::PupilZ,
        Parameter::PupilAberration,
        Parameter::FieldCurvature,
        Parameter::FieldCurvatureGrowth,
        Parameter::Radial1,
        Parameter::Radial2,
        Parameter::Radial3,
        Parameter::Radial1Growth,
        Parameter::LensRotationX,
        Parameter::LensRotationY,
        Parameter::Tangential1,
    ]);
    let calibration = run(&datasheet_start(), &shipped_observations(), &options);
    assert!(error(&calibration, 1).contains("8 frames cannot be divided into 1 folds"));
    let only: Vec<Vec<Parameter>> =
        compared(&calibration).groups.into_iter().map(|without| without.parameters).collect();
    assert_eq!(only, [[Parameter::Tangential2]]);
    options.fix.push(Parameter::Tangential2);
    let calibration = run(&datasheet_start(), &shipped_observations(), &options);
    assert!(error(&calibration, 5).contains("free one of them to compare models"));
    options = defaults();
    options.exclude_frames = vec![0, 1, 2];
    let few = run(&datasheet_start(), &shipped_observations(), &options);
    assert!(error(&few, 5).contains("not 5"));
    options.max_iterations = 2;
    let stopped = run(&datasheet_start(), &shipped_observations(), &options);
    assert!(error(&stopped, 5).contains("not converged"));
}

#[test]
fn the_figures_show_both_cameras() {
    let calibration = run(&datasheet_start(), &shipped_observations(), &defaults());
    let figures = model_figures(&calibration, &compared(&calibration));
    assert_eq!(figures.len(), 6);
    for figure in figures.iter().flatten() {
        crate::report::check(figure);
        assert!(figure.svg.contains(">With the ") && figure.svg.contains(">Without the "));
    }
}

fn on_command_line(options: &[&str]) -> (TempDir, assert_cmd::assert::Assert) {
    let out = TempDir::new().unwrap();
    let mut command = plenocal();
    command.arg("calibrate").arg(synthetic_folder().join("project.toml"));
    let result = command.args(["--compare-models", "--out"]).arg(out.path()).args(options).assert();
    (out, result)
}

#[test]
fn the_command_prints_the_comparison_and_has_it_in_its_document() {
    let (_out, result) = on_command_line(&[]);
    result.success().stdout(contains("no difference").and(contains("needed")));
    let (_out, result) = on_command_line(&["--json"]);
    let document: Value = serde_json::from_slice(&result.success().get_output().stdout).unwrap();
    let groups = document["models"]["groups"].as_array().unwrap();
    let verdicts: Vec<&str> = groups.iter().filter_map(|g| g["verdict"].as_str()).collect();
    let (keep, no) = ("needed", "no difference");
    assert_eq!(verdicts, [no, no, no, no, keep, keep]);
    assert_eq!(groups[0]["error_growth"]["frames"].as_array().unwrap().len(), 8);
    // What was asked for and cannot be done is said; the calibration stands.
    let (out, result) = on_command_line(&["--exclude", "0,1,2"]);
    result.success().stderr(contains("at least 6 frames"));
    assert!(out.path().join("camera.json").is_file());
}
