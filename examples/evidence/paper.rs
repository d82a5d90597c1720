//! The tables of the paper, for a simulated camera with the parameters of its optimised R12-A.

use std::fmt::Write;

use plenocal::Result;
use plenocal::assessment::{CandidateResult, Evaluation};
use plenocal::calibration::{
    Calibration, CalibrationOptions, ExitPupil, FieldCurvature, initial_from,
};
use plenocal::model::{Parameter, PlenopticCamera, optics};
use plenocal::quantity::fixed;

use crate::sets::{Extent, Set, set, step};
use crate::shoot::{Calibrated, error_of, estimate_of};
use crate::text::{Table, percent, signed};

const R12_A: [Set; 1] = [set("a simulated R12", "r12-a", &[])];
const SEED: u64 = 7101;
const FOLDS: usize = 5;

/// Row of Table 1: symbol, parameter, unit, factor to the unit, and the columns of the paper: initial values,
/// optimised values, and values of Noury et al.
type Row = (&'static str, &'static str, &'static str, f64, [&'static str; 3]);

const TABLE_1: [Row; 9] = [
    ("F", "F", "mm", 1.0, ["50", "49.720", "54.888"]),
    ("D", "D", "mm", 1.0, ["56.66", "56.696", "62.425"]),
    ("ΔC", "dC", "µm", 1e3, ["127.51", "127.45", "127.38"]),
    ("f₁", "f_1", "µm", 1e3, ["578.15", "577.97", "-"]),
    ("f₂", "f_2", "µm", 1e3, ["504.46", "505.21", "-"]),
    ("f₃", "f_3", "µm", 1e3, ["551.67", "551.79", "-"]),
    ("u₀", "u0", "px", 1.0, ["2039", "2042.55", "2289.83"]),
    ("v₀", "v0", "px", 1.0, ["1533", "1556.29", "1528.24"]),
    ("d", "d", "µm", 1e3, ["318.63", "325.24", "402.32"]),
];

/// Parameters that the paper does not give: symbol, parameter, unit, factor.
const OTHERS: [(&str, &str, &str, f64); 10] = [
    ("Q₁", "Q1", "mm⁻²", 1.0),
    ("Q₂", "Q2", "mm⁻⁴", 1.0),
    ("Q₃", "Q3", "mm⁻⁶", 1.0),
    ("P₁", "P1", "mm⁻¹", 1.0),
    ("P₂", "P2", "mm⁻¹", 1.0),
    ("θ_x", "theta_x", "mrad", 1e3),
    ("θ_y", "theta_y", "mrad", 1e3),
    ("θ_z", "theta_z", "mrad", 1e3),
    ("t_x", "t_x", "mm", 1.0),
    ("t_y", "t_y", "mm", 1.0),
];

/// Internal parameters of the paper, µm: those of R12-A, R12-B and R12-C.
const TABLE_2: [(&str, [&str; 3]); 5] = [
    ("Δc", ["128.222", "128.293", "128.333"]),
    ("\\|m\\|", ["140.596", "159.562", "155.975"]),
    ("q'₁", ["35.135", "36.489", "35.443"]),
    ("q'₂", ["40.268", "42.075", "41.278"]),
    ("q'₃", ["36.822", "38.807", "37.858"]),
];

/// Makes all tables.
pub fn tables(extent: &Extent) -> Result<Vec<String>> {
    let mut sets = extent.settings(&R12_A, SEED)?;
    let (set, settings) = sets.remove(0);
    step(set.name);
    let options = CalibrationOptions {
        exit_pupil: ExitPupil::At(0.0),
        field_curvature: FieldCurvature::Flat,
        ..CalibrationOptions::default()
    };
    let camera = Calibrated::of(settings, &options)?;
    let corners = camera.again(&options.of_corners_only())?;
    step("evaluation");
    let folds = extent.or_few(FOLDS, 2);
    let evaluation = camera.evaluation(&[&camera.calibration, &corners], folds)?;
    Ok(vec![
        parameters(&camera, &corners, &options)?,
        others(&camera)?,
        internal(&camera)?,
        displacements(&evaluation, camera.shoot.settings.translation.step_mm),
        reprojection(&evaluation, folds),
    ])
}

fn value_of(camera: &PlenopticCamera, name: &str) -> f64 {
    let all = Parameter::intrinsic(camera.lens_types()).iter().zip(camera.intrinsics());
    all.filter(|(p, _)| p.name() == name).map(|(_, value)| value).sum()
}

fn parameters(
    camera: &Calibrated,
    corners: &Calibration,
    options: &CalibrationOptions,
) -> Result<String> {
    let initial = initial_from(&camera.start, &camera.shoot.board, &camera.observations, options)?;
    let (both, alone) = (camera.errors(&camera.calibration)?, camera.errors(corners)?);
    let mut table = Table::new(&[
        "",
        "unit",
        "paper: initial",
        "paper: optimised",
        "paper: Noury et al.",
        "simulated: initial",
        "truth",
        "blur aware ± σ",
        "corners only ± σ",
    ]);
    for (symbol, name, unit, factor, paper) in TABLE_1 {
        let found = error_of(&both, name);
        let alone = alone.iter().find(|error| error.name == name);
        let alone = alone.map_or("-".to_owned(), |e| estimate_of(e).scaled(factor).to_string());
        let digits = |value: f64| plenocal::Estimate::exact(value * factor).to_string();
        let start = digits(value_of(&initial, name));
        let [first, optimised, noury] = paper.map(str::to_owned);
        let found_text = estimate_of(found).scaled(factor).to_string();
        let cells = [symbol.to_owned(), unit.to_owned(), first, optimised, noury, start];
        table.row(cells.into_iter().chain([digits(found.truth), found_text, alone]));
    }
    Ok(table.with(&format!("Seed {SEED}.")))
}

fn others(camera: &Calibrated) -> Result<String> {
    let errors = camera.errors(&camera.calibration)?;
    let mut table = Table::new(&["", "unit", "truth", "blur aware ± σ", "error/σ"]);
    for (symbol, name, unit, factor) in OTHERS {
        let error = error_of(&errors, name);
        let over_sigma = error.standardised().map_or(String::new(), |x| signed(x, 1));
        table.row([
            symbol.to_owned(),
            unit.to_owned(),
            plenocal::Estimate::exact(error.truth * factor).to_string(),
            estimate_of(error).scaled(factor).to_string(),
            over_sigma,
        ]);
    }
    Ok(table.text())
}

fn internal(camera: &Calibrated) -> Result<String> {
    const MICROMETRES: f64 = 1e3;
    let (truth, shoot) = (camera.shoot.truth()?, &camera.shoot);
    let pixel_mm = shoot.sheet.sensor.pixel_size_mm;
    let pitch = plenocal::Estimate::exact(shoot.measured.array.grid.pitch_px * pixel_mm);
    let found = [pitch, shoot.m_mm()].into_iter().chain(shoot.q_prime_mm());
    let truths = [truth.micro_image_pitch_mm.unwrap_or(f64::NAN), truth.m_mm];
    let truths = truths.into_iter().chain(truth.q_prime_mm.iter().copied());
    let mut table = Table::new(&[
        "µm",
        "paper: R12-A",
        "R12-B",
        "R12-C",
        "simulated: truth",
        "measured ± σ",
        "error",
    ]);
    for (((symbol, paper), found), truth) in TABLE_2.into_iter().zip(found).zip(truths) {
        let decimals = if found.std_dev > 0.0 { 2 } else { 3 };
        let measured = match found.std_dev {
            0.0 => fixed(found.value * MICROMETRES, 4),
            _ => found.scaled(MICROMETRES).to_string(),
        };
        let simulated =
            [fixed(truth * MICROMETRES, 3), measured, percent(found.value / truth - 1.0, decimals)];
        let paper = [symbol].into_iter().chain(paper).map(str::to_owned);
        table.row(paper.chain(simulated));
    }
    let of_camera = optics::internal_parameters(&camera.calibration.camera).m_mm;
    let m_star = fixed(of_camera * MICROMETRES, 3);
    let true_m = fixed(truth.m_mm * MICROMETRES, 3);
    table.row(["\\|m\\|\\*", "142.611", "161.428", "158.292", &true_m, &m_star, ""]);
    let error = camera.calibration.m_error().unwrap_or(f64::NAN);
    let error = format!("{} %", fixed(100.0 * error, 2));
    table.row(["ε_m", "1.41 %", "1.16 %", "1.52 %", "", &error, ""]);
    Ok(table.text())
}

const METHODS: [&str; 2] = ["blur aware", "corners only"];

fn displacements(evaluation: &Evaluation, step_mm: f64) -> String {
    let mut table = Table::new(&["", "R12-A", "R12-B", "R12-C", "all"]);
    for row in [
        ["paper, blur aware", "3.73 ± 1.48", "3.32 ± 1.17", "2.95 ± 1.35", "3.33"],
        ["paper, Noury et al.", "6.83 ± 1.17", "1.16 ± 1.06", "2.70 ± 0.86", "3.56"],
        ["paper, RxLive", "4.63 ± 2.51", "4.26 ± 5.79", "11.52 ± 3.22", "6.80"],
    ] {
        table.row(row);
    }
    let mut absolute = String::new();
    for (method, result) in METHODS.iter().zip(&evaluation.candidates) {
        let Some(found) = &result.translation else { continue };
        let relative = found.relative();
        let spread = |mean: f64, std_dev: Option<f64>, decimals: usize| {
            let std_dev = std_dev.map(|s| format!(" ± {}", fixed(s, decimals)));
            fixed(mean, decimals) + &std_dev.unwrap_or_default()
        };
        let percents = spread(100.0 * relative.mean, relative.std_dev.map(|s| 100.0 * s), 3);
        table.row([
            format!("plenocal, simulated, {method}"),
            percents,
            String::new(),
            String::new(),
            String::new(),
        ]);
        if absolute.is_empty() {
            let [mm, whole] = [found.absolute_mm().mean, 100.0 * found.whole.relative_error()];
            let std_dev = found.absolute_mm().std_dev;
            absolute = format!(
                "In mm, blur aware: {} for steps of {step_mm} mm (paper: 0.37 ± 0.15); {} % over the total {} mm.",
                spread(mm, std_dev, 4),
                fixed(whole, 3),
                fixed(found.whole.true_mm.abs(), 0)
            );
        }
    }
    table.with(&absolute)
}

fn reprojection(evaluation: &Evaluation, folds: usize) -> String {
    let mut table = Table::new(&["", "features", "Σ all², px²", "RMSE all, px", "(u, v)", "ρ"]);
    for row in [
        ["paper, R12-A", "11424", "8972.91", "0.886", "0.883", "0.075"],
        ["paper, R12-B", "3200", "1444.98", "0.672", "0.648", "0.177"],
        ["paper, R12-C", "9568", "5065.33", "0.728", "0.726", "0.044"],
    ] {
        table.row(row);
    }
    for (method, CandidateResult { evaluation, .. }) in METHODS.iter().zip(&evaluation.candidates) {
        let Some(posed) = evaluation else { continue };
        let rmse = posed.reprojection.rmse();
        table.row([
            format!("plenocal, simulated R12-A, {method}"),
            rmse.count.to_string(),
            fixed(rmse.all_px.powi(2) * rmse.count as f64, 1),
            fixed(rmse.all_px, 4),
            fixed(rmse.uv_px, 4),
            rmse.rho_px.map_or("-".to_owned(), |rho| fixed(rho, 4)),
        ]);
    }
    let mut text = String::new();
    if let Some(found) = &evaluation.folds {
        let rmse = &found.rmse;
        let _ = write!(
            text,
            "Cross-validation over the calibration boards ({folds} folds, {} features) gives {} px. ",
            rmse.count,
            fixed(rmse.all_px, 4)
        );
    }
    let errors = evaluation.poses.iter().map(|(subset, errors)| {
        let mrad = 1e3 * errors.rotation_rad;
        let [across, along] = [errors.across_mm, errors.along_mm].map(|mm| fixed(mm, 3));
        format!(
            "{across} mm across the axis, {along} mm along it and {} mrad ({subset})",
            fixed(mrad, 2)
        )
    });
    let errors: Vec<String> = errors.collect();
    let _ = write!(text, "RMS pose errors: {}.", errors.join("; "));
    table.with(&text)
}
