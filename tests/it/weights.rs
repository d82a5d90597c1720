//! Standard deviations of single observations: from the columns of the files to the residuals.

use std::fmt::Write as _;
use std::fs;

use plenocal::calibration::Calibration;
use plenocal::io::{read_centers, read_features, write_centers, write_features};
use plenocal::model::{BapFeature, Observations, TAKEN, taken};
use plenocal::solver::LossKind;
use predicates::str::contains;
use tempfile::TempDir;

use crate::support::{
    codes, datasheet_start, defaults, options, pairs, plenocal, run, shipped_observations,
    synthetic_folder,
};

/// So large that an observation has practically no weight.
const LARGE_PX: f64 = 1e4;
/// Limit for the difference of estimates with and without the observations that have no weight, in σ.
const UNCHANGED: f64 = 1e-3;
/// Rounding error of a few operations.
const EXACT: f64 = 1e-9;

fn with_std_devs(mut observations: Observations, uv_px: f64, rho_px: f64) -> Observations {
    for f in &mut observations.features {
        f.std_dev_px = Some([uv_px; 2]);
        f.rho_std_dev_px = Some(rho_px);
    }
    for c in &mut observations.centers {
        c.std_dev_px = Some(uv_px);
    }
    observations
}

/// Moves every tenth observation far off and gives it a large standard deviation.
fn spoil(observations: &mut Observations) {
    for f in observations.features.iter_mut().step_by(10) {
        f.u_px += 5.0;
        f.rho_px = f.rho_px.map(|rho| rho + 3.0);
        f.std_dev_px = Some([LARGE_PX; 2]);
        f.rho_std_dev_px = Some(LARGE_PX);
    }
    for c in observations.centers.iter_mut().step_by(10) {
        c.v_px += 4.0;
        c.std_dev_px = Some(LARGE_PX);
    }
}

#[test]
fn files_keep_the_standard_deviations() {
    let folder = TempDir::new().unwrap();
    let (features, centers) = (folder.path().join("f.csv"), folder.path().join("c.csv"));
    let mut written = with_std_devs(shipped_observations(), 0.25, 0.0625);
    // Some features have none.
    written.features[3] =
        BapFeature { std_dev_px: None, rho_std_dev_px: None, ..written.features[3] };
    written.centers[5].std_dev_px = None;
    let mut text = Vec::new();
    write_features(&mut text, &written.features).unwrap();
    fs::write(&features, &text).unwrap();
    let mut text = Vec::new();
    write_centers(&mut text, &written.centers).unwrap();
    fs::write(&centers, &text).unwrap();
    assert_eq!(read_features(&features, true).unwrap().features, written.features);
    assert_eq!(read_centers(&centers).unwrap(), written.centers);
}

/// Files of older versions have no sensitivities to aberrations.
#[test]
fn files_keep_the_sensitivities() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("f.csv");
    let mut written = shipped_observations().features;
    written.truncate(3);
    for (i, f) in written.iter_mut().enumerate() {
        let of = |quantity: usize| [quantity as f64 + 0.25, -0.5 * (quantity + i) as f64];
        f.sensitivities_px = Some(std::array::from_fn(of));
    }
    let mut text = Vec::new();
    write_features(&mut text, &written).unwrap();
    let text = String::from_utf8(text).unwrap();
    let read_without = |columns: usize| {
        let shorter = text.lines().map(|line| {
            let cells: Vec<&str> = line.split(',').collect();
            cells[..cells.len() - columns].join(",") + "\n"
        });
        fs::write(&path, shorter.collect::<String>()).unwrap();
        read_features(&path, true).map(|read| read.features)
    };
    assert_eq!(read_without(0).unwrap(), written);
    let older = read_without(2 * taken::ABERRATION_COUNT).unwrap();
    for (old, new) in older.iter().zip(&written) {
        let [old, new] = [old, new].map(|f| f.sensitivities_px.unwrap());
        assert_eq!(old[..taken::ABERRATIONS], new[..taken::ABERRATIONS]);
        assert_eq!(old[taken::ABERRATIONS..], [[0.0; 2]; taken::ABERRATION_COUNT]);
    }
    assert!(read_without(2 * TAKEN).unwrap().iter().all(|f| f.sensitivities_px.is_none()));
    for some in [1, 2 * taken::ABERRATION_COUNT + 1] {
        let message = read_without(some).unwrap_err().to_string();
        assert!(message.contains("needed together"), "{message}");
    }
}

#[test]
fn observations_with_a_large_standard_deviation_have_no_weight() {
    let clean = with_std_devs(shipped_observations(), 0.2, 0.05);
    let mut spoiled = clean.clone();
    spoil(&mut spoiled);
    let mut without = clean;
    let mut index = 0..;
    without.features.retain(|_| index.next().unwrap() % 10 != 0);
    let mut index = 0..;
    without.centers.retain(|_| index.next().unwrap() % 10 != 0);
    // Their number does matter: the features of a corner share one measurement of ρ.
    for f in spoiled.features.iter_mut().chain(&mut without.features) {
        f.rho_std_dev_px = f.rho_std_dev_px.map(|_| LARGE_PX);
    }
    let (spoiled, without) = (
        run(&datasheet_start(), &spoiled, &options()),
        run(&datasheet_start(), &without, &options()),
    );
    assert!(spoiled.converged && without.converged);
    let std_devs = without.uncertainty.intrinsic_std_devs(3);
    for ((name, a, b), std_dev) in pairs(&spoiled.camera, &without.camera).iter().zip(std_devs) {
        // Focal lengths follow from ρ alone, which has no weight here.
        let Some(std_dev) = std_dev.filter(|_| !name.starts_with("f_")) else { continue };
        assert!((a - b).abs() < UNCHANGED * std_dev, "{name}: {a} and {b} ± {std_dev}");
    }
}

/// Without σ there is no loss until the residuals show that it is needed, and how large it has to be.
#[test]
fn one_wrong_feature_is_withstood_without_standard_deviations() {
    let clean = shipped_observations();
    let mut spoiled = clean.clone();
    let corner = &mut spoiled.features[1000].corner;
    *corner = (*corner + 17) % 40;
    let by_clean = run(&datasheet_start(), &clean, &defaults());
    let by_spoiled = run(&datasheet_start(), &spoiled, &defaults());
    let warned = |c: &Calibration| codes(&c.findings).contains(&"outlying-unweighted");
    assert!(!warned(&by_clean), "{:?}", by_clean.findings);
    assert!(warned(&by_spoiled), "{:?}", by_spoiled.findings);
    assert_eq!(by_clean.cost.loss.kind, LossKind::None);
    assert!(by_spoiled.converged && by_spoiled.outlying_features()[0].std_devs > 100.0);
    let std_devs = by_clean.uncertainty.intrinsic_std_devs(3);
    for ((name, a, b), std_dev) in pairs(&by_spoiled.camera, &by_clean.camera).iter().zip(std_devs)
    {
        let Some(std_dev) = std_dev else { continue };
        assert!((a - b).abs() < std_dev, "{name}: {a} and {b} ± {std_dev}");
    }
    let mut paper = defaults();
    paper.loss = Some(LossKind::None);
    assert!(!warned(&run(&datasheet_start(), &spoiled, &paper)));
}

/// The options are factors: a file that states the σ and one that leaves it to the option agree.
#[test]
fn the_options_multiply_the_standard_deviations() {
    let mut plain = options();
    plain.uv_std_dev_px = 0.4;
    plain.centers_std_dev_px = 0.4;
    let by_option = run(&datasheet_start(), &shipped_observations(), &plain);
    let mut stated = with_std_devs(shipped_observations(), 0.2, 1.0);
    stated.features.iter_mut().for_each(|f| f.rho_std_dev_px = None);
    let mut doubled = options();
    doubled.uv_std_dev_px = 2.0;
    doubled.centers_std_dev_px = 2.0;
    let by_file = run(&datasheet_start(), &stated, &doubled);
    let (a, b) = (by_option.refinement.cost, by_file.refinement.cost);
    assert!((a / b - 1.0).abs() < EXACT, "{a} and {b}");
}

/// The cost of n features of a corner whose ρ has its own σ is that of one measurement.
#[test]
fn features_of_a_corner_share_one_measurement_of_the_blur_radius() {
    let mut observations = shipped_observations();
    observations.features.iter_mut().for_each(|f| f.rho_std_dev_px = Some(0.1));
    let mut shared = options();
    // Nothing else has weight.
    shared.uv_std_dev_px = LARGE_PX;
    shared.centers_std_dev_px = LARGE_PX;
    shared.max_iterations = 1;
    let calibration = run(&datasheet_start(), &observations, &shared);
    let features = &observations.features;
    let count = |f: &BapFeature| {
        features.iter().filter(|g| (g.frame, g.corner) == (f.frame, f.corner)).count() as f64
    };
    let weighted: f64 = calibration
        .reprojection
        .features
        .iter()
        .map(|r| (r.drho_px.unwrap() / 0.1).powi(2) / count(&r.feature) / 2.0)
        .sum();
    let cost = calibration.refinement.cost;
    assert!((cost / weighted - 1.0).abs() < 1e-3, "{cost} for {weighted}");
}

#[test]
fn an_impossible_standard_deviation_is_an_error_with_its_line() {
    let folder = TempDir::new().unwrap();
    let features = fs::read_to_string(synthetic_folder().join("features.csv")).unwrap();
    for (value, words) in [
        ("0", "std_rho is 0, but a standard deviation has to be positive"),
        ("-0.1", "std_rho is -0.1"),
        ("wide", "std_rho is 'wide', not a number"),
    ] {
        let mut text = String::new();
        for (i, line) in features.lines().enumerate() {
            let cell = match i {
                0 => "std_rho",
                7 => value,
                _ => "0.05",
            };
            writeln!(text, "{line},{cell}").unwrap();
        }
        let file = folder.path().join("features.csv");
        fs::write(&file, text).unwrap();
        let mut command = plenocal();
        command.arg("calibrate").arg(synthetic_folder().join("project.toml"));
        command.arg("--features").arg(&file).arg("--out").arg(folder.path().join("out"));
        command.assert().code(1).stderr(contains(words)).stderr(contains("line 8"));
    }
}
