//! Whole calibrations of simulated cameras with the default model, and what its parameters are worth.

use plenocal::Result;
use plenocal::assessment::{Group, ModelComparison, ParameterError, Worth, compare_models};
use plenocal::calibration::CalibrationOptions;
use plenocal::quantity::fixed;
use plenocal::simulation::FallOffLaw;

use crate::sets::{Extent, F25, Set, seeds, set, step};
use crate::shoot::{Calibrated, error_of, estimate_of};
use crate::text::{Table, percent, relative_error, signed, worst};

const NO_FALL_OFF: &str = "imperfections.fall_off=none";
const PIXELS: &str = "imperfections.fall_off={half_response_deg=25}";

const SETS: [Set; 14] = [
    set("`mini`", "mini", &[]),
    set("`mini`", "mini", &[NO_FALL_OFF]),
    set("`mini`, pupil at −5 mm", "mini", &[PIXELS, "camera.main_lens.exit_pupil_mm=[0, 0, -5]"]),
    set(
        "`mini`, pupil at 5 mm",
        "mini",
        &[NO_FALL_OFF, "camera.main_lens.exit_pupil_mm=[0, 0, 5]"],
    ),
    set(
        "`mini`, a second stop",
        "mini",
        &["imperfections.second_stop.z_mm=8", "imperfections.second_stop.diameter_mm=7"],
    ),
    set("`keplerian`", "keplerian", &[]),
    set(
        "`keplerian`, pupil at −4 mm",
        "keplerian",
        &[NO_FALL_OFF, "camera.main_lens.exit_pupil_mm=[0, 0, -4]"],
    ),
    set("`keplerian`", "keplerian", &[PIXELS]),
    set("25.4 mm", F25, &[]),
    set("`r12-a`, clipped", "r12-a", &[]),
    set("`mini-double-gauss`", "mini-double-gauss", &[]),
    set("`mini-double-gauss`", "mini-double-gauss", &[]),
    set("`mini-telephoto`", "mini-telephoto", &[]),
    set("`mini-telephoto`", "mini-telephoto", &[]),
];
const SEED: u64 = 7601;
/// Sets in which the models are compared, by seed.
const COMPARED: [u64; 4] = [SEED, SEED + 8, SEED + 11, SEED + 13];
const FOLDS: usize = 5;

/// Parameters that a traced lens does not have.
const OF_THIN_LENSES: [&str; 9] = ["Q1", "Q2", "Q3", "Q1_m", "P1", "P2", "kappa", "kappa_m", "e_r"];

/// Calibrates all sets.
pub fn tables(extent: &Extent) -> Result<Vec<String>> {
    let mut errors = Table::new(&[
        "camera",
        "fall-off",
        "F",
        "d",
        "fᵢ",
        "tilt",
        "e_z, mm (truth)",
        "above 3 σ",
        "displacement",
        "distances",
    ]);
    let mut compared = Vec::new();
    for (set, settings) in extent.settings(&SETS, SEED)? {
        let name = format!("{}, seed {}", set.name, settings.seed);
        step(&name);
        let is_compared = extent.quick || COMPARED.contains(&settings.seed);
        let camera = Calibrated::of(settings, &CalibrationOptions::default())?;
        errors.row(row(set.name, &camera)?);
        if is_compared {
            let folds = extent.or_few(FOLDS, 2);
            let board = &camera.shoot.board;
            let models = compare_models(&camera.calibration, board, folds, &|| ())?;
            compared.push((name, models));
        }
    }
    Ok(vec![errors.with(&seeds(&SETS, SEED)), models(&compared)])
}

fn row(name: &str, camera: &Calibrated) -> Result<Vec<String>> {
    let settings = &camera.shoot.settings;
    let errors = camera.errors(&camera.calibration)?;
    let relative = |name: &str| error_of(&errors, name).error() / error_of(&errors, name).truth;
    let of = |name: &str| {
        let error = error_of(&errors, name);
        relative_error(&estimate_of(error), error.truth, 2)
    };
    let focal_lengths = worst(["f_1", "f_2", "f_3"].map(relative)).abs();
    let tilt = ["theta_x", "theta_y"].map(|name| error_of(&errors, name));
    let length = |of: fn(&ParameterError) -> f64| of(tilt[0]).hypot(of(tilt[1]));
    let tilt = length(ParameterError::error) / length(|error| error.truth);
    let pupil = error_of(&errors, "e_z");
    let e_z = format!("{} ({})", estimate_of(pupil), signed(pupil.truth, 1));
    let evaluation = camera.evaluation(&[&camera.calibration], 0)?;
    let result = &evaluation.candidates[0];
    let moved = result.translation.as_ref().map(|found| found.whole.relative_error());
    let distances = result.reconstruction.as_ref().map(|found| found.too_long.value);
    let fall_off = match settings.imperfections.fall_off {
        FallOffLaw::Cos4 => "cos⁴",
        FallOffLaw::None => "none",
        FallOffLaw::HalfResponseDeg(_) => "pixels",
    };
    let in_percent = |part: Option<f64>| part.map_or("-".to_owned(), |part| percent(part, 2));
    Ok(vec![
        name.to_owned(),
        fall_off.to_owned(),
        of("F"),
        of("d"),
        format!("≤ {} %", fixed(100.0 * focal_lengths, 2)),
        format!("{} %", fixed(100.0 * tilt, 1)),
        e_z,
        far_off(&errors, settings.prescription.is_some()),
        in_percent(moved.map(f64::abs)).trim_start_matches('+').to_owned(),
        in_percent(distances),
    ])
}

/// Names the parameters that are more than 3 σ off.
fn far_off(errors: &[ParameterError], is_traced: bool) -> String {
    let has_truth =
        |error: &&ParameterError| !is_traced || !OF_THIN_LENSES.contains(&error.name.as_str());
    let far = errors.iter().filter(has_truth).filter_map(|error| {
        let off = error.standardised().filter(|off| off.abs() > 3.0)?;
        Some(format!("{} {}", error.name, fixed(off.abs(), 1)))
    });
    far.collect::<Vec<_>>().join(", ")
}

/// Tabulates the growth of the error of left-out frames without each group of parameters, and the change of F.
fn models(compared: &[(String, ModelComparison)]) -> String {
    let names = compared.iter().map(|(name, _)| name.as_str());
    let mut table = Table::new(&["without"].into_iter().chain(names).collect::<Vec<_>>());
    for group in Group::ALL {
        let of_set = |(_, models): &(String, ModelComparison)| {
            let without = models.groups.iter().find(|without| without.group == group)?;
            let (mean, std_error) = without.mean_growth();
            let growth = format!("{} ± {}", signed(100.0 * mean, 1), fixed(100.0 * std_error, 1));
            let growth = match without.worth() {
                Worth::Needed => format!("**{growth}**"),
                _ => growth,
            };
            let moved = without.focal_length_change.1?;
            Some(format!("{growth}; {} σ", signed(moved, 1)))
        };
        let cells: Vec<Option<String>> = compared.iter().map(of_set).collect();
        // The shape of a flat board is not free.
        if cells.iter().any(Option::is_some) {
            let cells = cells.into_iter().map(|cell| cell.unwrap_or("-".to_owned()));
            table.row([group.to_string()].into_iter().chain(cells));
        }
    }
    table.text()
}
