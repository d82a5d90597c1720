//! Whole calibrations through traced lenses of several designs, with the optical axis at several places.

use plenocal::Result;
use plenocal::assessment::ParameterError;
use plenocal::calibration::CalibrationOptions;
use plenocal::quantity::fixed;
use plenocal::simulation::{LensFigures, Settings};

use crate::sets::{Extent, step};
use crate::shoot::{Calibrated, error_of};
use crate::text::{Table, over_sigma, percent, signed};

const LENSES: [&str; 7] =
    ["double-gauss", "telephoto", "retrofocus", "petzval", "triplet", "tessar", "near-telecentric"];
/// Places of the optical axis from the middle of the sensor, px.
const PLACES: [[f64; 2]; 4] = [[0.0, 0.0], [15.0, -20.0], [150.0, 0.0], [0.0, 150.0]];
/// Focal length of the prescriptions, mm.
const LENS_FOCAL_LENGTH_MM: f64 = 100.0;
const SEED: u64 = 9301;
/// Parameters that a traced lens has too, apart from the columns of the table.
const OTHERS: [&str; 9] = ["D", "P1", "P2", "e_z", "theta_x", "theta_y", "theta_z", "t_x", "t_y"];
const SHOWN: [&str; 7] = ["F", "d", "f_1", "f_2", "f_3", "u0", "v0"];

/// Calibrates the sets.
pub fn errors(extent: &Extent) -> Result<Vec<String>> {
    let mut table = Table::new(&[
        "lens",
        "axis, px",
        "F",
        "d",
        "fᵢ",
        "u₀, px",
        "v₀, px",
        "others, largest",
        "e_r, mm⁻¹ (traced)",
        "Q₁ₘ, 10⁻³ mm⁻² (traced)",
        "distances",
    ]);
    let mut over_sigmas = Vec::new();
    let lenses = LENSES.into_iter().take(extent.or_few(LENSES.len(), 1));
    let places = || PLACES.into_iter().take(extent.or_few(PLACES.len(), 1));
    let sets = lenses.flat_map(|lens| places().map(move |place| (lens, place)));
    let mut count = 0;
    for (seed, (lens, [u, v])) in (SEED..).zip(sets) {
        step(&format!("{lens}, axis at {u}, {v} px, seed {seed}"));
        let replaced =
            [format!("axis_px=[{u}, {v}]"), format!("seed={seed}"), "rays=16".to_owned()];
        let settings = Settings::preset(&format!("mini-{lens}"), &replaced)?;
        let traced = settings.lens_figures()?;
        let place = format!("{u}, {v}");
        let first = [lens.replace('-', " "), place].into_iter();
        count += 1;
        let camera = Calibrated::if_converged(settings, &CalibrationOptions::default())?;
        let Some(camera) = camera else {
            let others = std::iter::repeat_n("-".to_owned(), 8);
            table.row(first.chain(["not converged".to_owned()]).chain(others));
            continue;
        };
        let errors = camera.errors(&camera.calibration)?;
        let evaluation = camera.evaluation(&[&camera.calibration], 0)?;
        let reconstruction = evaluation.candidates[0].reconstruction.as_ref();
        let distances = reconstruction.map(|found| percent(found.too_long.value, 2));
        let last_cell = distances.unwrap_or("-".to_owned());
        let small = small_terms(&errors, traced.as_ref());
        table.row(first.chain(cells(&errors)).chain(small).chain([last_cell]));
        let of = |name: &&str| error_of(&errors, name).standardised().map(f64::abs);
        over_sigmas.extend(SHOWN.iter().chain(&OTHERS).filter_map(of));
    }
    let within = |limit: f64| over_sigmas.iter().filter(|x| **x <= limit).count();
    let coverage = format!(
        "Of the {} errors, {} are within 1 σ, {} within 2 σ and {} within 3 σ. Seeds {SEED} to {}, row by row.",
        over_sigmas.len(),
        within(1.0),
        within(2.0),
        within(3.0),
        SEED + count - 1
    );
    Ok(vec![table.with(&coverage)])
}

/// Decentre of the last element, mm, and the seed of the first decentred lens.
const DECENTRE_MM: f64 = 0.02;
const DECENTRED_SEED: u64 = SEED + 50;

/// Calibrates cameras with a decentred element, along x.
pub fn decentred(extent: &Extent) -> Result<Vec<String>> {
    let mut table = Table::new(&["lens", "P₁, 10⁻³ mm⁻¹", "P₂, 10⁻³ mm⁻¹", "F", "d", "distances"]);
    let lenses = LENSES.into_iter().take(extent.or_few(LENSES.len(), 1));
    for (seed, lens) in (DECENTRED_SEED..).zip(lenses) {
        step(&format!("{lens}, decentred, seed {seed}"));
        let replaced = [format!("seed={seed}"), "rays=16".to_owned()];
        let mut settings = Settings::preset(&format!("mini-{lens}"), &replaced)?;
        let in_prescription =
            DECENTRE_MM * LENS_FOCAL_LENGTH_MM / settings.camera.main_lens.focal_length_mm;
        for surface in
            settings.prescription.iter_mut().flat_map(|lens| lens.surfaces.iter_mut().rev().take(2))
        {
            surface.decentre_mm = [in_prescription, 0.0];
        }
        let camera = Calibrated::of(settings, &CalibrationOptions::default())?;
        let errors = camera.errors(&camera.calibration)?;
        let evaluation = camera.evaluation(&[&camera.calibration], 0)?;
        let reconstruction = evaluation.candidates[0].reconstruction.as_ref();
        let of = |name: &str| {
            let error = error_of(&errors, name);
            let std_dev = error.std_dev.unwrap_or(f64::NAN);
            format!("{} ± {}", signed(error.estimate * 1e3, 3), fixed(std_dev * 1e3, 3))
        };
        let relative = |name: &str| {
            let error = error_of(&errors, name);
            over_sigma(
                &percent(error.error() / error.truth, 2),
                error.error(),
                error.std_dev.unwrap_or(f64::NAN),
            )
        };
        table.row([
            lens.replace('-', " "),
            of("P1"),
            of("P2"),
            relative("F"),
            relative("d"),
            reconstruction.map_or("-".to_owned(), |found| percent(found.too_long.value, 2)),
        ]);
    }
    let paragraph = format!("Seeds {DECENTRED_SEED} and following, row by row.");
    Ok(vec![table.with(&paragraph)])
}

/// Formats `e_r` and Q₁ₘ with σ, and with their paraxial values.
fn small_terms(errors: &[ParameterError], traced: Option<&LensFigures>) -> [String; 2] {
    let cell = |name: &str, factor: f64, decimals: usize, traced: Option<f64>| {
        let error = error_of(errors, name);
        let in_unit = |x: f64| signed(x * factor, decimals);
        let std_dev = error.std_dev.unwrap_or(f64::NAN) * factor;
        let std_dev = fixed(std_dev, decimals);
        let traced = traced.map_or("-".to_owned(), in_unit);
        format!("{} ± {std_dev} ({traced})", in_unit(error.estimate))
    };
    [
        cell("e_r", 1.0, 4, traced.map(|lens| lens.pupil_aberration_per_mm)),
        cell("Q1_m", 1e3, 2, traced.map(|lens| lens.q1_growth_per_mm2)),
    ]
}

fn cells(errors: &[ParameterError]) -> Vec<String> {
    let std_dev = |error: &ParameterError| error.std_dev.unwrap_or(f64::NAN);
    let relative = |name: &str| {
        let error = error_of(errors, name);
        over_sigma(&percent(error.error() / error.truth, 2), error.error(), std_dev(error))
    };
    let in_px = |name: &str| {
        let error = error_of(errors, name);
        over_sigma(&signed(error.error(), 1), error.error(), std_dev(error))
    };
    let size = |name: &&str| (error_of(errors, name).error() / error_of(errors, name).truth).abs();
    let worst_type = ["f_1", "f_2", "f_3"].into_iter().max_by(|a, b| size(a).total_cmp(&size(b)));
    let standardised = |name: &&str| error_of(errors, name).standardised().unwrap_or(0.0).abs();
    let other = OTHERS.into_iter().max_by(|a, b| standardised(a).total_cmp(&standardised(b)));
    let other = other.map(|name| format!("{name} {} σ", fixed(standardised(&name), 1)));
    vec![
        relative("F"),
        relative("d"),
        worst_type.map(relative).unwrap_or_default(),
        in_px("u0"),
        in_px("v0"),
        other.unwrap_or_default(),
    ]
}
