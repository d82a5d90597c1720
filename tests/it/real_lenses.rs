//! What real main lenses have and the paper's does not: an exit pupil off the lens, a curved field, light that
//! falls off by a law of its own.

use nalgebra::{Vector2, Vector3};
use plenocal::Estimate;
use plenocal::calibration::{
    CalibrationOptions, ExitPupil, LensTilt, Start, calibrate, initial_from,
};
use plenocal::io::{camera_document, read_camera};
use plenocal::model::{MainLens, Noise, Observations, Parameter, PlenopticCamera, optics};
use plenocal::precalibration::{PrecalibrationOptions, White, precalibrate};
use plenocal::simulation::{DataSet, simulate};
use plenocal::solver::LossKind;
use predicates::str::contains;
use tempfile::TempDir;

use crate::support::{
    NO_NOISE, board, datasheet_start, defaults, drawn, no_priors, options, pairs, plenocal, preset,
    run, synthetic_folder, true_camera,
};

/// As in the recovery tests.
const NOISE_FREE: f64 = 1e-8;
const FOUR_SIGMA: f64 = 4.0;

fn real_camera(exit_pupil_mm: f64) -> PlenopticCamera {
    let mut camera = true_camera();
    camera.main_lens.exit_pupil_mm = Vector3::new(0.0, 0.0, exit_pupil_mm);
    camera.main_lens.field_curvature_per_mm = 0.006;
    camera.main_lens.field_curvature_growth_per_mm = 0.01;
    camera.main_lens.pupil_aberration_per_mm = 0.02;
    camera.main_lens.rotation_rad = [0.007, -0.004];
    camera.main_lens.q1_growth_per_mm2 = 0.003;
    camera
}

fn start(camera: &PlenopticCamera) -> Start {
    let Start::Datasheet(sheet, _) = datasheet_start() else { unreachable!() };
    Start::Datasheet(sheet, optics::internal_parameters(camera))
}

/// Exit pupil and field curvature free, without priors and loss.
fn free() -> CalibrationOptions {
    CalibrationOptions { priors: no_priors(), loss: Some(LossKind::None), ..defaults() }
}

#[test]
fn without_noise_exit_pupil_and_field_curvature_are_recovered() {
    for exit_pupil_mm in [-5.0, 4.0] {
        let truth = real_camera(exit_pupil_mm);
        let calibration = run(&start(&truth), &drawn(&truth, &NO_NOISE, 0), &free());
        assert!(calibration.converged);
        for (name, value, truth) in pairs(&calibration.camera, &truth) {
            assert!(
                (value - truth).abs() <= NOISE_FREE * truth.abs(),
                "{name}: {value} for {truth}"
            );
        }
    }
}

#[test]
fn a_tilted_lens_is_found_unless_it_is_ruled_out() {
    let truth = PlenopticCamera {
        main_lens: MainLens { rotation_rad: [0.007, -0.004], ..true_camera().main_lens },
        ..true_camera()
    };
    let noise = Noise { uv_px: 0.1, rho_px: 0.02, centers_px: 0.05 };
    let observations = drawn(&truth, &noise, 9);
    let found = run(&start(&truth), &observations, &defaults());
    let std_devs = found.uncertainty.intrinsic_std_devs(3);
    for ((name, value, truth), std_dev) in pairs(&found.camera, &truth).iter().zip(std_devs) {
        let off = (value - truth) / std_dev.unwrap_or(f64::INFINITY);
        assert!(off.abs() < FOUR_SIGMA, "{name}: {value} for {truth}, {off:.1} σ");
    }
    // A camera to start from may have a tilt.
    let none = CalibrationOptions { lens_tilt: LensTilt::None, ..defaults() };
    for start in [start(&truth), Start::Camera(truth.clone())] {
        let without = run(&start, &observations, &none);
        assert!(without.camera.main_lens.rotation_rad.iter().all(|angle| *angle == 0.0));
        let costs = [&without, &found].map(|calibration| calibration.refinement.cost);
        assert!(costs[0] > costs[1], "{costs:?}");
    }
}

/// The centroids of clipped micro-images are not the images of the pupil's centre.
#[test]
fn small_terms_are_held_if_the_lens_vignettes() {
    let truth = true_camera();
    let observations = drawn(&truth, &Noise { uv_px: 0.1, rho_px: 0.02, centers_px: 0.05 }, 5);
    let small = |options: &CalibrationOptions, narrower: f64| {
        let Start::Datasheet(sheet, mut internal) = start(&truth) else { unreachable!() };
        internal.vignetting = Some(Estimate { value: narrower, std_dev: 1e-3 });
        let lens = run(&Start::Datasheet(sheet, internal), &observations, options).camera.main_lens;
        [lens.q1_growth_per_mm2, lens.pupil_aberration_per_mm].map(|term| term != 0.0)
    };
    assert_eq!(small(&defaults(), 0.01), [true, true]);
    assert_eq!(small(&defaults(), 0.05), [false, false]);
    let mut stated = defaults();
    stated.priors.state("e_r", 0.0, 0.01);
    assert_eq!(small(&stated, 0.05), [false, true]);
}

#[test]
fn a_calibration_starts_with_the_axis_of_the_detection() {
    let (start, observations) = (start(&true_camera()), drawn(&true_camera(), &NO_NOISE, 0));
    let initial = |axis_px: Option<Vector2<f64>>| {
        let observations = Observations { axis_px, ..observations.clone() };
        initial_from(&start, &board(), &observations, &free()).unwrap()
    };
    let axis_px = Vector2::new(620.0, 300.0);
    let (middle, axis) = (initial(None), initial(Some(axis_px)));
    assert_eq!(axis.mla.principal_point_px, axis_px);
    // The micro-images do not move.
    let shift = axis.mla.offset_mm - middle.mla.offset_mm;
    let of_axis = (axis_px - middle.mla.principal_point_px) * axis.sensor.pixel_size_mm;
    assert!((shift - of_axis).norm() < 0.03 * of_axis.norm(), "{shift} for {of_axis}");
    let far = Observations { axis_px: Some(Vector2::new(1e5, 0.0)), ..observations };
    let error = calibrate(&start, &board(), &far, &free(), &mut |_| true).unwrap_err();
    assert!(error.to_string().contains("detection.json) is at (100000, 0) px"), "{error}");
}

#[test]
fn with_noise_they_lie_within_their_uncertainty_and_the_paper_is_wrong() {
    let truth = real_camera(-5.0);
    let noise = Noise { uv_px: 0.04, rho_px: 0.01, centers_px: 0.01 };
    let observations = drawn(&truth, &noise, 3);
    let calibration = run(&start(&truth), &observations, &free());
    assert!(calibration.converged);
    let std_devs = calibration.uncertainty.intrinsic_std_devs(3);
    for ((name, value, truth), std_dev) in pairs(&calibration.camera, &truth).iter().zip(std_devs) {
        let Some(s) = std_dev else { continue };
        assert!((value - truth).abs() < FOUR_SIGMA * s, "{name}: {value} ± {s} for {truth}");
    }
    let of_the_paper = run(&start(&truth), &observations, &options());
    let std_dev = of_the_paper.uncertainty.intrinsic_std_devs(3)[0].unwrap();
    let off = of_the_paper.camera.main_lens.focal_length_mm - truth.main_lens.focal_length_mm;
    assert!(off.abs() > 10.0 * std_dev, "{off} ± {std_dev}");
}

#[test]
fn the_exit_pupil_stays_where_it_is_put() {
    let truth = real_camera(-5.0);
    let mut at = free();
    at.exit_pupil = ExitPupil::At(-5.0);
    let calibration = run(&start(&truth), &drawn(&truth, &NO_NOISE, 0), &at);
    assert!((calibration.camera.main_lens.exit_pupil_mm.z + 5.0).abs() < 1e-12);
    assert!((calibration.camera.main_lens.focal_length_mm - 16.2).abs() < 1e-6);
}

fn calibrated(place: &str) -> (TempDir, assert_cmd::assert::Assert) {
    let out = TempDir::new().unwrap();
    let mut command = plenocal();
    command.arg("calibrate").arg(synthetic_folder().join("project.toml"));
    let result = command.args(["--exit-pupil", place, "--out"]).arg(out.path()).assert();
    (out, result)
}

#[test]
fn the_place_of_the_exit_pupil_is_an_option() {
    for (place, e_z) in [("at-lens", 0.0), ("-2.5", -2.5)] {
        let (out, result) = calibrated(place);
        result.success();
        let camera = read_camera(&out.path().join("camera.json")).unwrap();
        assert!((camera.main_lens.exit_pupil_mm.z - e_z).abs() < 1e-12);
    }
    let (out, result) = calibrated("estimated");
    result.success();
    let camera = read_camera(&out.path().join("camera.json")).unwrap();
    assert!(camera.main_lens.exit_pupil_mm.z != 0.0);
    calibrated("in-the-lens").1.failure().stderr(contains("negative towards the array"));
    calibrated("-40").1.failure().stderr(contains("exit pupil"));
}

/// A start from a calibrated camera does not overrule what is asked for.
#[test]
fn the_camera_of_the_paper_can_start_from_a_real_one() {
    let folder = TempDir::new().unwrap();
    let real = folder.path().join("camera.json");
    std::fs::write(&real, camera_document(&real_camera(-5.0), None).to_string()).unwrap();
    let calibrated = |options: &[&str]| {
        let mut command = plenocal();
        command.arg("calibrate").arg(synthetic_folder().join("project.toml"));
        command
            .arg("--camera")
            .arg(&real)
            .args(options)
            .arg("--out")
            .arg(folder.path().join("out"));
        command.assert()
    };
    calibrated(&[
        "--exit-pupil",
        "at-lens",
        "--field-curvature",
        "flat",
        "--distortion",
        "constant",
    ])
    .success();
    let lens = read_camera(&folder.path().join("out/camera.json")).unwrap().main_lens;
    assert_eq!(lens.exit_pupil_mm, Vector3::zeros());
    assert!(!lens.has_curved_field() && lens.q1_growth_per_mm2 == 0.0);
    calibrated(&["--fix", "e_z,kappa,kappa_m"]).success();
    let lens = read_camera(&folder.path().join("out/camera.json")).unwrap().main_lens;
    assert!((lens.exit_pupil_mm.z + 5.0).abs() < 1e-12);
    assert!((lens.field_curvature_per_mm - 0.006).abs() < 1e-12);
    calibrated(&["--mode", "poses-only", "--exit-pupil", "-2"])
        .failure()
        .stderr(contains("exit pupil"));
}

/// A pupil beside the axis is a parameter if something is known of it.
#[test]
fn a_prior_frees_the_place_of_the_pupil_across_the_axis() {
    let out = TempDir::new().unwrap();
    let mut command = plenocal();
    command.arg("calibrate").arg(synthetic_folder().join("project.toml"));
    command.args(["--prior", "e_x=0:0.1", "--out"]).arg(out.path()).assert().success();
    let lens = read_camera(&out.path().join("camera.json")).unwrap().main_lens;
    assert!(lens.exit_pupil_mm.x != 0.0 && lens.exit_pupil_mm.y == 0.0, "{:?}", lens.exit_pupil_mm);
}

/// Noise of 0.2 px and no prior: F and D run away together with the pupil.
#[test]
fn a_camera_that_runs_away_has_not_converged() {
    let settings = preset("keplerian", &["rays=1"]);
    let few = simulate(&settings, None, &(), &mut |_, _, _| Ok(())).unwrap();
    let start = Start::Datasheet(settings.datasheet(), few.truth.internal);
    let board = settings.target.board();
    let mut constant = free();
    constant.fix.push(Parameter::FieldCurvatureGrowth);
    let result = calibrate(&start, &board, &few.observed, &constant, &mut |_| true);
    assert!(!result.unwrap().converged);
    let result = calibrate(&start, &board, &few.observed, &defaults(), &mut |_| true);
    assert!(result.unwrap().converged);
}

/// The shipped files are of version 1: without exit pupil and field curvature.
#[test]
fn cameras_of_version_1_are_read_and_version_2_has_everything() {
    let old = true_camera();
    assert_eq!(old.main_lens.exit_pupil_mm, Vector3::zeros());
    assert!(old.main_lens.field_curvature_per_mm == 0.0);
    let camera = real_camera(-5.0);
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("camera.json");
    let document = camera_document(&camera, None);
    assert_eq!(document["version"], 2);
    std::fs::write(&path, document.to_string()).unwrap();
    assert_eq!(read_camera(&path).unwrap(), camera);
}

/// n of the law cosⁿ that has the same gradient on the axis: 4, 0, and 4 + 2 ln 2/tan² 25°.
#[test]
fn the_fall_off_is_that_of_the_sensor() {
    for (law, n) in [("cos4", 4.0), ("none", 0.0), ("{half_response_deg=25}", 10.375)] {
        let law = format!("imperfections.fall_off={law}");
        let settings = preset("mini", &[&law, "camera.main_lens.exit_pupil_mm=[0,0,-3]"]);
        let plan = DataSet::plan(&settings, None).unwrap();
        let white = |shot: &plenocal::simulation::Shot| White {
            name: format!("f/{:.2}", shot.f_number),
            f_number: shot.f_number,
            image: shot.take(&settings, &|| ()).unwrap(),
        };
        let whites: Vec<White> = plan.whites.iter().map(white).collect();
        let reference = white(&plan.devignetting);
        let options = PrecalibrationOptions::of_datasheet(&settings.datasheet());
        let measured = precalibrate(&whites, Some(&reference), &options, &|| ()).unwrap();
        let fall_off = measured.internal.parameters.fall_off.unwrap();
        let (s, d) = (settings.camera.sensor.pixel_size_mm, settings.camera.mla.mla_to_sensor_mm);
        let unit = s * s / (d * (settings.camera.pupil_to_mla_mm() + d));
        // A tenth of cos⁴ moves corners at the border by less than 0.01 px.
        let found = fall_off.growth_per_px2 / unit;
        println!("{law}: {found:.2} for {n:.2}");
        assert!((found - n).abs() < 0.1 * n.max(4.0), "{law}: {found} for {n}");
    }
}
