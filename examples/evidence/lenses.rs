//! Whole calibrations through traced lenses of several designs, with the optical axis at several places.

use plenocal::Result;
use plenocal::assessment::ParameterError;
use plenocal::calibration::{CalibrationOptions, LensTilt};
use plenocal::quantity::fixed;
use plenocal::simulation::{LensFigures, Settings};

use crate::sets::{Extent, step};
use crate::shoot::{Calibrated, error_of};
use crate::text::{Table, over_sigma, percent, signed, worst};

const LENSES: [&str; 7] =
    ["double-gauss", "telephoto", "retrofocus", "petzval", "triplet", "tessar", "near-telecentric"];
/// Places of the optical axis from the middle of the sensor, px.
const PLACES: [[f64; 2]; 3] = [[0.0, 0.0], [15.0, -20.0], [-90.0, 120.0]];
/// Focal length of the prescriptions, mm.
const LENS_FOCAL_LENGTH_MM: f64 = 100.0;
const SEED: u64 = 10_001;
/// Cameras for each lens and place.
const SETS: usize = 3;
/// Parameters that a traced lens has too, apart from the columns of the table.
const OTHERS: [&str; 9] = ["D", "P1", "P2", "e_z", "theta_x", "theta_y", "theta_z", "t_x", "t_y"];
const ROTATION: [&str; 2] = ["omega_x", "omega_y"];
const SHOWN: [&str; 7] = ["F", "d", "f_1", "f_2", "f_3", "u0", "v0"];

/// Calibrates three sets for each lens and place of the axis.
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
    let (mut seed, mut not_converged) = (SEED, 0);
    for (lens, [u, v]) in sets {
        let (mut cameras, mut traced) = (Vec::new(), None);
        for _ in 0..extent.or_few(SETS, 1) {
            step(&format!("{lens}, axis at {u}, {v} px, seed {seed}"));
            let replaced = [
                format!("axis_px=[{u}, {v}]"),
                format!("seed={seed}"),
                "rays=16".to_owned(),
                "translation.images=2".to_owned(),
            ];
            let settings = Settings::preset(&format!("mini-{lens}"), &replaced)?;
            traced = settings.lens_figures()?;
            seed += 1;
            match Calibrated::if_converged(settings, &CalibrationOptions::default())? {
                Some(camera) => cameras.push(Found::of(&camera)?),
                None => not_converged += 1,
            }
        }
        let first = [lens.replace('-', " "), format!("{u}, {v}")];
        table.row(first.into_iter().chain(cells(&cameras, traced.as_ref())));
        over_sigmas.extend(cameras.iter().flat_map(|camera| {
            let of = |name: &&str| camera.of_name(name).standardised().map(f64::abs);
            SHOWN.iter().chain(&OTHERS).chain(&ROTATION).filter_map(of).collect::<Vec<_>>()
        }));
    }
    let within = |limit: f64| over_sigmas.iter().filter(|x| **x <= limit).count();
    let coverage = format!(
        "Three cameras each: RMS of the errors, in brackets the largest over σ; mean of e_r and of Q₁ₘ. Of {} cameras, {not_converged} did not converge. Of the {} errors, {} are within 1 σ, {} within 2 σ and {} within 3 σ. Seeds {SEED} to {}, row by row.",
        seed - SEED,
        over_sigmas.len(),
        within(1.0),
        within(2.0),
        within(3.0),
        seed - 1
    );
    Ok(vec![table.with(&coverage)])
}

/// Presets of tilted lenses, with ωx and ωy, mrad.
const TILTED: [(&str, [f64; 2]); 6] = [
    ("mini", [7.0, 4.0]),
    ("mini", [-3.0, 6.0]),
    ("mini", [0.0, 0.0]),
    ("keplerian", [7.0, 4.0]),
    ("mini-double-gauss", [7.0, 4.0]),
    ("mini-retrofocus", [-3.0, 6.0]),
];
const TILTED_SEED: u64 = 9851;

/// Calibrates cameras whose main lens is tilted against the sensor, with and without the tilt as parameters.
pub fn tilted(extent: &Extent) -> Result<Vec<String>> {
    let mut table = Table::new(&[
        "camera",
        "ωx, ωy, mrad",
        "error, mrad",
        "F",
        "d",
        "u₀, px",
        "v₀, px",
        "others, largest",
        "held-out boards, px",
        "without ω: F",
        "u₀, v₀, px",
        "held-out boards, px",
    ]);
    let cameras = TILTED.into_iter().take(extent.or_few(TILTED.len(), 1));
    for (seed, (preset, tilt)) in (TILTED_SEED..).zip(cameras) {
        step(&format!("{preset}, {tilt:?} mrad, seed {seed}"));
        let rotation = tilt.map(|mrad| mrad * 1e-3);
        let replaced = [
            format!("camera.main_lens.rotation_rad={rotation:?}"),
            format!("seed={seed}"),
            "rays=16".to_owned(),
        ];
        let camera =
            Calibrated::of(Settings::preset(preset, &replaced)?, &CalibrationOptions::default())?;
        let untilted = CalibrationOptions { lens_tilt: LensTilt::None, ..Default::default() };
        let without = camera.again(&untilted)?;
        let evaluation = camera.evaluation(&[&camera.calibration, &without], 0)?;
        let held_out = |i: usize| {
            let found = evaluation.candidates[i].evaluation.as_ref();
            found.map_or("-".to_owned(), |found| fixed(found.reprojection.rmse().uv_px, 4))
        };
        let [with, without] = [&camera.calibration, &without].map(|c| camera.errors(c));
        let (with, without) = (with?, without?);
        let std_dev = |error: &ParameterError| error.std_dev.unwrap_or(f64::NAN);
        let relative = |errors: &[ParameterError], name: &str| {
            let error = error_of(errors, name);
            over_sigma(&percent(error.error() / error.truth, 2), error.error(), std_dev(error))
        };
        let scaled = |errors: &[ParameterError], name: &str, factor: f64, decimals: usize| {
            let error = error_of(errors, name);
            let text = signed(error.error() * factor, decimals);
            over_sigma(&text, error.error(), std_dev(error))
        };
        let mrad = |name: &str| scaled(&with, name, 1e3, 2);
        let px = |errors: &[ParameterError], name: &str| scaled(errors, name, 1.0, 1);
        let size = |name: &&str| error_of(&with, name).standardised().unwrap_or(0.0).abs();
        let other = OTHERS.into_iter().max_by(|a, b| size(a).total_cmp(&size(b)));
        table.row([
            format!("`{preset}`"),
            format!("{}, {}", signed(tilt[0], 0), signed(tilt[1], 0)),
            format!("{}, {}", mrad("omega_x"), mrad("omega_y")),
            relative(&with, "F"),
            relative(&with, "d"),
            px(&with, "u0"),
            px(&with, "v0"),
            other.map_or("-".to_owned(), |name| format!("{name} {}", fixed(size(&name), 1))),
            held_out(0),
            relative(&without, "F"),
            format!("{}, {}", px(&without, "u0"), px(&without, "v0")),
            held_out(1),
        ]);
    }
    let paragraph = format!("Seeds {TILTED_SEED} and following, row by row.");
    Ok(vec![table.with(&paragraph)])
}

/// Errors of a camera.
struct Found {
    errors: Vec<ParameterError>,
    /// Relative error of the distances between reconstructed corners of held-out boards.
    distances: Option<f64>,
}

impl Found {
    fn of(camera: &Calibrated) -> Result<Self> {
        let errors = camera.errors(&camera.calibration)?;
        let evaluation = camera.evaluation(&[&camera.calibration], 0)?;
        let reconstruction = evaluation.candidates[0].reconstruction.as_ref();
        Ok(Self { errors, distances: reconstruction.map(|found| found.too_long.value) })
    }

    fn of_name(&self, name: &str) -> &ParameterError {
        error_of(&self.errors, name)
    }
}

/// Formats the columns after lens and place.
fn cells(cameras: &[Found], traced: Option<&LensFigures>) -> [String; 9] {
    let root_mean_square = |values: &[f64]| {
        let count = f64::from(u32::try_from(values.len()).unwrap_or(u32::MAX));
        (values.iter().map(|x| x * x).sum::<f64>() / count).sqrt()
    };
    let of = |names: &[&str]| {
        let each = cameras.iter().flat_map(|camera| names.iter().map(|name| camera.of_name(name)));
        each.collect::<Vec<_>>()
    };
    let largest = |errors: &[&ParameterError]| {
        let standardised = errors.iter().filter_map(|error| error.standardised());
        fixed(worst(standardised).abs(), 1)
    };
    let relative = |names: &[&str]| {
        let errors = of(names);
        let each: Vec<f64> = errors.iter().map(|error| error.error() / error.truth).collect();
        format!("{} % ({})", fixed(100.0 * root_mean_square(&each), 2), largest(&errors))
    };
    let in_px = |name: &str| {
        let errors = of(&[name]);
        let each: Vec<f64> = errors.iter().map(|error| error.error()).collect();
        format!("{} ({})", fixed(root_mean_square(&each), 1), largest(&errors))
    };
    let size = |error: &ParameterError| error.standardised().unwrap_or(0.0).abs();
    let others = OTHERS.iter().chain(&ROTATION).flat_map(|name| of(&[name]));
    let other = others.max_by(|a, b| size(a).total_cmp(&size(b)));
    let mean = |name: &str, factor: f64, decimals: usize, traced: Option<f64>| {
        let errors = of(&[name]);
        let values: Vec<f64> = errors.iter().map(|error| error.estimate).collect();
        let count = f64::from(u32::try_from(values.len()).unwrap_or(u32::MAX));
        let in_unit = |x: f64| signed(x * factor, decimals);
        let traced = traced.map_or("-".to_owned(), in_unit);
        format!("{} ({traced})", in_unit(values.iter().sum::<f64>() / count))
    };
    let distances: Vec<f64> = cameras.iter().filter_map(|camera| camera.distances).collect();
    [
        relative(&["F"]),
        relative(&["d"]),
        relative(&["f_1", "f_2", "f_3"]),
        in_px("u0"),
        in_px("v0"),
        other.map_or("-".to_owned(), |error| format!("{} {}", error.name, fixed(size(error), 1))),
        mean("e_r", 1.0, 4, traced.map(|lens| lens.pupil_aberration_per_mm)),
        mean("Q1_m", 1e3, 2, traced.map(|lens| lens.q1_growth_per_mm2)),
        format!("{} %", fixed(100.0 * root_mean_square(&distances), 2)),
    ]
}

/// Decentre of the last element, mm, and the seed of the first decentred lens.
const DECENTRE_MM: f64 = 0.02;
const DECENTRED_SEED: u64 = 9351;

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
