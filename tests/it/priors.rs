//! What is known of a camera beforehand.

use plenocal::Finding;
use std::fs;

use plenocal::calibration::{Calibration, CalibrationOptions, PriorSource, Priors, Start};
use plenocal::model::{Noise, Observations, Parameter, TiltGradient};
use plenocal::solver::{LossKind, Termination};
use predicates::str::contains;
use tempfile::TempDir;

use crate::support::{
    datasheet_start, defaults, drawn, no_priors, options, plenocal, run, shipped_observations,
    synthetic_folder, true_camera,
};

const NOISE: Noise = Noise { uv_px: 0.2, rho_px: 0.05, centers_px: 0.1 };

fn with_prior(quantity: &str, value: f64, std_dev: f64) -> CalibrationOptions {
    let mut options = options();
    options.priors.state(quantity, value, std_dev);
    options
}

fn named<'a>(
    calibration: &'a Calibration,
    quantity: &str,
) -> &'a plenocal::calibration::PriorResult {
    calibration.priors.iter().find(|a| a.prior.quantity == quantity).unwrap()
}

/// Observations that state their σ, and have it.
fn honest_observations() -> Observations {
    let mut observations = drawn(&true_camera(), &NOISE, 3);
    let mut of_corner = std::collections::BTreeMap::new();
    for f in &observations.features {
        *of_corner.entry((f.frame, f.corner)).or_insert(0.0_f64) += 1.0;
    }
    for f in &mut observations.features {
        f.std_dev_px = Some([NOISE.uv_px; 2]);
        // Here every ρ has an error of its own.
        f.rho_std_dev_px = Some(NOISE.rho_px / of_corner[&(f.frame, f.corner)].sqrt());
    }
    for c in &mut observations.centers {
        c.std_dev_px = Some(NOISE.centers_px);
    }
    observations
}

/// The value is that of the formula in Rust, the residual that of C++.
#[test]
fn the_tilt_gradient_is_held_as_it_is_computed() {
    let observations = shipped_observations();
    for (quantity, value) in [("tilt_u", -1.9e-3), ("tilt_v", -2.4e-3)] {
        let result = run(&datasheet_start(), &observations, &with_prior(quantity, value, 1e-9));
        let found = named(&result, quantity);
        assert!((found.result - value).abs() < 1e-8, "{quantity}: {}", found.result);
        assert_eq!(found.unit(), "mm^-1");
    }
}

/// White images say how the array is tilted, without what is assumed of the lens.
#[test]
fn the_tilt_gradient_of_white_images_counts_also_without_default_priors() {
    let Start::Datasheet(sheet, mut internal) = datasheet_start() else { unreachable!() };
    let tilt_gradient = TiltGradient {
        growth_per_px: [-9.8e-6, -1.3e-5],
        std_dev_per_px: [2e-7, 3e-7],
        shared_per_px: [-1e-7, -1e-7],
        by_aperture_ratio_per_px: [0.0; 2],
        by_aperture_ratio_squared_per_px: [0.0; 2],
    };
    internal.tilt_gradient = Some(tilt_gradient);
    let mut options = defaults();
    options.priors.default = false;
    let result = run(&Start::Datasheet(sheet, internal), &shipped_observations(), &options);
    for (axis, quantity) in ["tilt_u", "tilt_v"].into_iter().enumerate() {
        let found = named(&result, quantity);
        assert_eq!(found.source, PriorSource::WhiteImages);
        let per_px = found.prior.value * sheet.sensor.pixel_size_mm;
        assert!((per_px - tilt_gradient.growth_per_px[axis]).abs() < 1e-15);
        assert!(
            found.normalised_residual().abs() < 3.0,
            "{quantity}: {}",
            found.normalised_residual()
        );
    }
    assert!(result.priors.iter().all(|a| a.prior.quantity != "F"));
}

#[test]
fn a_prior_without_tolerance_holds_a_parameter() {
    let observations = shipped_observations();
    for (quantity, value) in [("F", 16.3), ("d", 0.33), ("u0", 500.0)] {
        let result = run(&datasheet_start(), &observations, &with_prior(quantity, value, 1e-7));
        let found = named(&result, quantity).result;
        assert!((found - value).abs() < 1e-5 * value, "{quantity}: {found}");
    }
    let result = run(&datasheet_start(), &observations, &with_prior("m", 0.144, 1e-9));
    assert!((named(&result, "m").result - 0.144).abs() < 1e-6);
}

/// Two independent measurements of F: their mean is weighted by the inverse squares of their σ, that of
/// the observations in proportion to what they are worth.
#[test]
fn observations_and_a_prior_are_weighted_by_their_variances() {
    let observations = honest_observations();
    let alone = run(&datasheet_start(), &observations, &options());
    let (f, s) = (
        alone.camera.main_lens.focal_length_mm,
        alone.uncertainty.independent_std_devs(3)[0].unwrap(),
    );
    let (known, tolerance) = (f + 3.0 * s, s);
    let both = run(&datasheet_start(), &observations, &with_prior("F", known, tolerance));
    let weight = both.cost.prior_weight;
    let expected = f + (known - f) * s * s / (s * s + tolerance * tolerance / weight);
    let found = both.camera.main_lens.focal_length_mm;
    // The problem is not quite linear over three σ.
    assert!(
        (found - expected).abs() < 0.05 * (known - f),
        "{found}, expected {expected}, w {weight}"
    );
    // Eight frames know their own scatter to a third.
    assert!((0.3..3.0).contains(&weight), "{weight}");
    let sigma = both.uncertainty.independent_std_devs(3)[0].unwrap();
    assert!(sigma < s && sigma > 0.5 * s, "{sigma} after {s}");
}

/// The way to the minimum begins without the loss: a result from there must not claim one.
#[test]
fn a_solve_that_ends_early_states_the_cost_that_it_used() {
    let observations = honest_observations();
    let mut options = defaults();
    let whole = run(&datasheet_start(), &observations, &options);
    assert_eq!(whole.cost.loss.kind, LossKind::Huber);
    options.max_iterations = 1;
    let early = run(&datasheet_start(), &observations, &options);
    assert_eq!(early.refinement.termination, Termination::IterationLimit);
    assert_eq!(early.cost.loss.kind, LossKind::None);
}

#[test]
fn the_proportion_does_not_depend_on_the_weights_of_observations() {
    let observations = shipped_observations();
    let mut options = defaults();
    options.priors.state("F", 16.5, 0.05);
    let one = run(&datasheet_start(), &observations, &options);
    for factor in [0.01, 100.0] {
        options.uv_std_dev_px = factor;
        options.centers_std_dev_px = factor;
        let other = run(&datasheet_start(), &observations, &options);
        let (a, b) = (one.camera.main_lens.focal_length_mm, other.camera.main_lens.focal_length_mm);
        // A fraction of the prior's σ: the weight is measured at a rough minimum.
        assert!((a - b).abs() < 0.1 * 0.05, "{factor}: {a} and {b}");
    }
}

#[test]
fn the_default_priors_are_what_the_project_states() {
    let of_the_paper = CalibrationOptions { priors: Priors::default(), ..options() };
    let result = run(&datasheet_start(), &shipped_observations(), &of_the_paper);
    let Start::Datasheet(sheet, internal) = datasheet_start() else { unreachable!() };
    let middle = sheet.sensor.center_px();
    let mount = 0.5 / sheet.sensor.pixel_size_mm;
    let expected = [
        ("F", sheet.focal_length_mm, 0.03 * sheet.focal_length_mm, PriorSource::Datasheet),
        ("m", internal.m_mm, 0.02 * internal.m_mm, PriorSource::WhiteImages),
        ("u0", middle.x, mount, PriorSource::SensorMiddle),
        ("v0", middle.y, mount, PriorSource::SensorMiddle),
    ];
    assert_eq!(result.priors.len(), expected.len());
    for (found, (quantity, value, std_dev, source)) in result.priors.iter().zip(expected) {
        assert_eq!((found.prior.quantity.as_str(), found.source), (quantity, source));
        assert!(
            (found.prior.value - value).abs() < 1e-9
                && (found.prior.std_dev - std_dev).abs() < 1e-9
        );
        assert!(
            found.normalised_residual().abs() < 3.0,
            "{quantity}: {}",
            found.normalised_residual()
        );
    }
    // On a good camera they change nothing that matters.
    let without = run(&datasheet_start(), &shipped_observations(), &options());
    let std_devs = without.uncertainty.intrinsic_std_devs(3);
    for (i, (a, b)) in
        result.camera.intrinsics().iter().zip(without.camera.intrinsics()).enumerate()
    {
        if let Some(s) = std_devs[i] {
            assert!((a - b).abs() < 0.5 * s, "parameter {i}: {a} and {b} ± {s}");
        }
    }
}

#[test]
fn priors_are_replaced_removed_and_left_out_where_a_parameter_is_fixed() {
    let observations = shipped_observations();
    let quantities = |options: &CalibrationOptions| -> Vec<String> {
        let result = run(&datasheet_start(), &observations, options);
        result.priors.into_iter().map(|a| a.prior.quantity).collect()
    };
    let mut options = defaults();
    options.priors.state("v0", 360.0, 4.0);
    options.priors.remove("m");
    options.fix.push(Parameter::FocalLength);
    assert_eq!(quantities(&options), ["v0", "u0", "omega_x", "omega_y", "q'_1", "q'_2", "q'_3"]);
    // Without them nothing would be said of the focal lengths.
    let none = CalibrationOptions { priors: no_priors(), ..defaults() };
    assert_eq!(quantities(&none), ["q'_1", "q'_2", "q'_3"]);
    options.priors.remove("q'_2");
    options.priors.state("q'_3", 0.0377, 1e-4);
    assert_eq!(quantities(&options), ["q'_3", "v0", "u0", "omega_x", "omega_y", "q'_1"]);
}

#[test]
fn a_contradiction_is_a_warning_that_says_what_it_may_mean() {
    let result = run(&datasheet_start(), &shipped_observations(), &with_prior("F", 17.5, 0.2));
    let contradicted: Vec<&Finding> =
        result.findings.iter().filter(|f| f.code() == "prior-contradicted").collect();
    assert_eq!(contradicted.len(), 1);
    let words = contradicted[0].to_string();
    assert!(words.contains("F is 16.") && words.contains("squares"), "{words}");
}

fn calibrate(arguments: &[&str], table: &str) -> assert_cmd::assert::Assert {
    let folder = TempDir::new().unwrap();
    for name in ["centers.csv", "features.csv"] {
        fs::copy(synthetic_folder().join(name), folder.path().join(name)).unwrap();
    }
    let project = fs::read_to_string(synthetic_folder().join("project.toml")).unwrap();
    let project = project.split("\n[truth]").next().unwrap().to_owned() + table;
    fs::write(folder.path().join("project.toml"), project).unwrap();
    plenocal()
        .arg("calibrate")
        .arg(folder.path().join("project.toml"))
        .arg("--out")
        .arg(folder.path().join("out"))
        .args(arguments)
        .assert()
}

#[test]
fn bad_priors_are_errors_that_name_them() {
    for (argument, words) in [
        ("Fokus=50:1", "'Fokus'"),
        ("F=16:0", "F has σ = 0"),
        ("F=16:-1", "F has σ = -1"),
        ("F=nan:1", "F has the value NaN"),
        ("F=16:nan", "F has σ = NaN"),
        ("F=inf:1", "F has the value inf"),
        ("F=16", "NAME=VALUE:SIGMA"),
        ("F", "NAME=VALUE:SIGMA"),
        ("F=16:x", "NAME=VALUE:SIGMA"),
        ("dC_ratio=1:0.1", "dC_ratio has a prior, but is fixed"),
        ("F=16:1,F=17:1", "second prior"),
    ] {
        calibrate(&["--prior", argument], "").code(1).stderr(contains(words));
    }
    calibrate(&["--prior", "F=16:1", "--fix", "F"], "").code(1).stderr(contains("F has a prior"));
    for (table, words) in [
        ("\n[calibration.priors]\nF = { value = 16.0, std_dev = 0.0 }\n", "F has σ = 0"),
        ("\n[calibration.priors]\nF = { value = nan, std_dev = 0.1 }\n", "value is NaN"),
        ("\n[calibration.priors]\nF = 16.0\n", "std_dev"),
        ("\n[calibration.priors]\nFF = \"none\"\n", "'FF'"),
        ("\n[calibration.priors]\nF = { value = 16.0 }\n", "std_dev"),
    ] {
        calibrate(&[], table).code(1).stderr(contains(words));
    }
}

#[test]
fn priors_of_the_project_and_of_the_command_line_are_combined() {
    let table = "\n[calibration.priors]\nm = \"none\"\nF = { value = 16.2, std_dev = 0.1 }\n";
    let priors = |arguments: &[&str]| -> Vec<(String, f64)> {
        let arguments: Vec<&str> = arguments.iter().copied().chain(["--json"]).collect();
        let output = calibrate(&arguments, table).success().get_output().stdout.clone();
        let document: serde_json::Value = serde_json::from_slice(&output).unwrap();
        let priors = document["priors"]["priors"].as_array().unwrap();
        let of = |a: &serde_json::Value| {
            (a["quantity"].as_str().unwrap().to_owned(), a["std_dev"].as_f64().unwrap())
        };
        priors.iter().map(of).collect()
    };
    let names = |found: &[(String, f64)]| -> Vec<String> {
        found.iter().map(|(name, _)| name.clone()).collect()
    };
    let found = priors(&[]);
    assert_eq!(names(&found), ["F", "u0", "v0", "omega_x", "omega_y", "q'_1", "q'_2", "q'_3"]);
    assert!((found[0].1 - 0.1).abs() < 1e-12);
    // The command line comes first; a relative σ.
    let found = priors(&["--prior", "F=16.2:1%,v0=none"]);
    assert_eq!(names(&found[..2]), ["F", "u0"]);
    assert_eq!(found.len(), 7);
    assert!((found[0].1 - 0.162).abs() < 1e-12);
    assert!(priors(&["--priors", "none", "--blur", "features"]).is_empty());
    let found = priors(&["--priors", "none", "--prior", "D=18.5:1"]);
    assert_eq!(names(&found), ["D", "q'_1", "q'_2", "q'_3"]);
}
