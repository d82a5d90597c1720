//! What white images show of simulated cameras.

use nalgebra::{DMatrix, DVector};
use plenocal::model::{Configuration, optics};
use plenocal::precalibration::RadiusMeasurement;
use plenocal::quantity::fixed;
use plenocal::simulation::{FallOffLaw, Settings};
use plenocal::{Error, Estimate, Issue, Result};

use crate::sets::{Extent, F25, Set, seeds, set, step};
use crate::shoot::Shoot;
use crate::text::{Table, over_sigma, percent, relative_error, signed, worst};

const CLIPPED: &str = "white_images.gain=4";
const NOT_CLIPPED: &str = "white_images.gain=1";
const NO_FALL_OFF: &str = "imperfections.fall_off=none";
const PIXELS: &str = "imperfections.fall_off={half_response_deg=25}";

const DISCS: [Set; 10] = [
    set("`mini`", "mini", &[]),
    set("`mini`, 1024 rays", "mini", &["rays=1024"]),
    set("`mini`, clipped (gain 4)", "mini", &[CLIPPED]),
    set("`keplerian`", "keplerian", &[]),
    set("`r12-a`, not clipped", "r12-a", &[NOT_CLIPPED]),
    set("`mini-double-gauss`", "mini-double-gauss", &[]),
    set("`mini-telephoto`", "mini-telephoto", &[]),
    set(
        "`keplerian` through a double Gauss",
        "keplerian",
        &[
            "prescription=double-gauss",
            "camera.main_lens.q1_per_mm2=0",
            "camera.main_lens.q2_per_mm4=0",
            "camera.main_lens.q3_per_mm6=0",
            "camera.main_lens.p1_per_mm=0",
            "camera.main_lens.p2_per_mm=0",
        ],
    ),
    set(
        "`mini`, f-numbers 2 % off",
        "mini",
        &["white_images.stop_errors=[0.025, -0.018, 0.021, -0.014, -0.02]"],
    ),
    set(
        "`mini`, two f-numbers, +3 % and −3 % off",
        "mini",
        &["white_images.f_numbers=[5.657, 11.314]", "white_images.stop_errors=[0.03, -0.03]"],
    ),
];
const SEED_OF_DISCS: u64 = 7501;

/// Compares discs with straight lines of the radius over 1/N.
pub fn discs(extent: &Extent) -> Result<Vec<String>> {
    let mut table = Table::new(&["set", "m, lines", "m", "q' in px, lines", "q' in px (over σ)"]);
    for (set, settings) in extent.settings(&DISCS, SEED_OF_DISCS)? {
        step(set.name);
        let shoot = Shoot::of(settings)?;
        let (lines_m_mm, lines_q_prime_mm) = lines(&shoot)?;
        let truth = shoot.truth()?;
        let pixel_mm = shoot.sheet.sensor.pixel_size_mm;
        let off = lines_q_prime_mm.iter().zip(&truth.q_prime_mm);
        let off: Vec<String> = off.map(|(q, truth)| signed((q - truth) / pixel_mm, 3)).collect();
        table.row([
            set.name.to_owned(),
            percent(lines_m_mm / truth.m_mm - 1.0, 2),
            relative_error(&shoot.m_mm(), truth.m_mm, 2),
            off.join(", "),
            q_prime_errors(&shoot)?,
        ]);
    }
    Ok(vec![table.with(&seeds(&DISCS, SEED_OF_DISCS))])
}

/// Fits straight lines ϱ = |m|/N + |qᵢ| with one slope. Returns |m| and q'ᵢ, mm.
fn lines(shoot: &Shoot) -> Result<(f64, Vec<f64>)> {
    let (radii, types) = (&shoot.measured.radii, shoot.measured.lens_types.types);
    let cell = |row: usize, column: usize| {
        let RadiusMeasurement { f_number, lens_type, .. } = radii[row];
        if column == 0 { 1.0 / f_number } else { f64::from(lens_type + 1 == column) }
    };
    let design = DMatrix::from_fn(radii.len(), types + 1, cell);
    let right = DVector::from_iterator(radii.len(), radii.iter().map(|r| r.radius_px));
    let solution = design.svd(true, true).solve(&right, 1e-12).map_err(Error::invalid)?;
    let pixel_mm = shoot.sheet.sensor.pixel_size_mm;
    let half_pitch = shoot.measured.array.grid.pitch_px / 2.0;
    let side = if shoot.sheet.configuration == Configuration::Keplerian { 1.0 } else { -1.0 };
    let q_prime = solution.iter().skip(1).map(|q| (half_pitch + side * q) * pixel_mm);
    Ok((solution[0] * pixel_mm, q_prime.collect()))
}

/// Formats the errors of q'ᵢ in px, with the largest over its σ.
///
/// White images show the blur radius φ|qᵢ|, so that they are compared with the q'ᵢ that goes with it.
fn q_prime_errors(shoot: &Shoot) -> Result<String> {
    let truth = shoot.truth()?;
    let pixel_mm = shoot.sheet.sensor.pixel_size_mm;
    let half_pitch_mm = truth.micro_image_pitch_mm.unwrap_or(f64::NAN) / 2.0;
    let ratio = truth.aperture_ratio();
    let seen = truth.q_prime_mm.iter().map(|q| half_pitch_mm + ratio * (q - half_pitch_mm));
    let found = shoot.q_prime_mm();
    let errors: Vec<(f64, f64)> =
        found.iter().zip(seen).map(|(q, truth)| (q.value - truth, q.std_dev)).collect();
    let texts: Vec<String> = errors.iter().map(|(off, _)| signed(off / pixel_mm, 3)).collect();
    let over = worst(errors.iter().map(|(off, std_dev)| off / std_dev));
    Ok(over_sigma(&texts.join(", "), over, 1.0))
}

const SPREAD: [Set; 9] = [
    set("`mini`", "mini", &["imperfections.point_spread_px=0.3"]),
    set("`mini`", "mini", &["imperfections.point_spread_px=1"]),
    set(
        "`mini`, aperture ratio 0.85",
        "mini",
        &["imperfections.aperture_ratio=0.85", "imperfections.point_spread_px=0.5"],
    ),
    set(
        "`mini`, aperture ratio 0.85, black level 16",
        "mini",
        &[
            "imperfections.aperture_ratio=0.85",
            "imperfections.point_spread_px=0.3",
            "imaging.black_level=0.06274509803921569",
        ],
    ),
    set(
        "`keplerian`, aperture ratio 0.9",
        "keplerian",
        &["imperfections.aperture_ratio=0.9", "imperfections.point_spread_px=0.5"],
    ),
    set("`keplerian`", "keplerian", &["imperfections.point_spread_px=1"]),
    set(
        "`r12-a`, clipped, aperture ratio 0.92, black level 16",
        "r12-a",
        &[
            "imperfections.aperture_ratio=0.92",
            "imperfections.point_spread_px=0.5",
            "imaging.black_level=0.06274509803921569",
        ],
    ),
    set(
        "`r12-a`, clipped, aperture ratio 0.85",
        "r12-a",
        &["imperfections.aperture_ratio=0.85", "imperfections.point_spread_px=1"],
    ),
    set(
        "`r12-a`, clipped, black level 8",
        "r12-a",
        &["imperfections.point_spread_px=0.3", "imaging.black_level=0.03137254901960784"],
    ),
];
const SEED_OF_SPREAD: u64 = 7531;

/// Measures the point spread, and m and q' with it.
pub fn point_spread(extent: &Extent) -> Result<Vec<String>> {
    let mut table = Table::new(&["set", "point spread", "found", "m", "q' in px (over σ)"]);
    for (set, settings) in extent.settings(&SPREAD, SEED_OF_SPREAD)? {
        step(set.name);
        let shoot = Shoot::of(settings)?;
        let found = shoot.measured.internal.parameters.point_spread_px2;
        let found = found.map_or("-".to_owned(), |s| format!("{} px", s.square_root()));
        table.row([
            set.name.to_owned(),
            format!("{} px", shoot.settings.imperfections.point_spread_px),
            found,
            relative_error(&shoot.m_mm(), shoot.truth()?.m_mm, 1),
            q_prime_errors(&shoot)?,
        ]);
    }
    Ok(vec![table.with(&seeds(&SPREAD, SEED_OF_SPREAD))])
}

const TONES: [Set; 8] = [
    set("`mini`, linear", "mini", &[]),
    set("`mini`, JPEG of quality 90", "mini", &["imaging.jpeg_quality=90"]),
    set("`mini`, gamma 1.05", "mini", &["imaging.gamma=1.05"]),
    set("`mini`, gamma 1.1", "mini", &["imaging.gamma=1.1"]),
    set("`mini`, gamma 1.2", "mini", &["imaging.gamma=1.2"]),
    set("`mini`, gamma 1/1.2", "mini", &["imaging.gamma=0.8333333333333334"]),
    set("`keplerian`, gamma 1.2", "keplerian", &["imaging.gamma=1.2"]),
    set("`mini`, gamma 2.2", "mini", &["imaging.gamma=2.2"]),
];
const SEED_OF_TONES: u64 = 7551;

/// Shows what tone curves do to q', and whether they are noticed.
pub fn linear_light(extent: &Extent) -> Result<Vec<String>> {
    let mut table = Table::new(&["set", "power in the warning", "q'"]);
    for (set, settings) in extent.settings(&TONES, SEED_OF_TONES)? {
        step(set.name);
        let cells = match Shoot::of(settings) {
            Ok(shoot) => toned(&shoot)?,
            // That samples are far from linear is an error.
            Err(error) if error.to_string().contains("not linear") => {
                ["error".to_owned(), "-".to_owned()]
            }
            Err(error) => return Err(error),
        };
        table.row([set.name.to_owned()].into_iter().chain(cells));
    }
    Ok(vec![table.with(&seeds(&TONES, SEED_OF_TONES))])
}

/// Returns the power of a warning, and the largest relative error of q'ᵢ.
fn toned(shoot: &Shoot) -> Result<[String; 2]> {
    let power = shoot.measured.findings.iter().find_map(|finding| match finding.issue {
        Issue::NotLinear { power } => Some(fixed(power, 2)),
        _ => None,
    });
    let truth = shoot.truth()?.q_prime_mm;
    let found = shoot.q_prime_mm();
    let off = worst(found.iter().zip(&truth).map(|(q, truth)| q.value / truth - 1.0));
    Ok([power.unwrap_or("no warning".to_owned()), percent(off, 1)])
}

const TILTED: [Set; 11] = [
    set("`mini`", "mini", &[NO_FALL_OFF]),
    set("`mini`", "mini", &[PIXELS, "camera.main_lens.exit_pupil_mm=[0, 0, -5]"]),
    set("`mini`", "mini", &[NO_FALL_OFF, "camera.main_lens.exit_pupil_mm=[0, 0, 5]"]),
    set("`keplerian`", "keplerian", &[]),
    set("`keplerian`", "keplerian", &[NO_FALL_OFF, "camera.main_lens.exit_pupil_mm=[0, 0, -4]"]),
    set("`keplerian`", "keplerian", &[PIXELS]),
    set("25.4 mm, 1600 × 1200 px", F25, &[]),
    set("the same", F25, &[NO_FALL_OFF, "camera.main_lens.exit_pupil_mm=[0, 0, 6]"]),
    set("`r12-a`, clipped", "r12-a", &[]),
    set("`mini-double-gauss`", "mini-double-gauss", &[]),
    set("`mini-telephoto`", "mini-telephoto", &[]),
];
const SEED_OF_TILTED: u64 = 7571;

/// Measures the tilt gradient along u and v.
pub fn tilt_gradient(extent: &Extent) -> Result<Vec<String>> {
    let mut table =
        Table::new(&["set", "fall-off", "exit pupil, mm", "tilt gradient, error", "in σ"]);
    for (set, settings) in extent.settings(&TILTED, SEED_OF_TILTED)? {
        step(set.name);
        let shoot = Shoot::of(settings)?;
        let errors = tilt_gradient_errors(&shoot)?;
        let texts = |of: &dyn Fn(&(f64, f64)) -> String| {
            errors.iter().map(of).collect::<Vec<_>>().join(", ")
        };
        let settings = &shoot.settings;
        table.row([
            set.name.to_owned(),
            fall_off(settings),
            signed(settings.camera.main_lens.exit_pupil_mm.z, 1),
            texts(&|(error, _)| percent(*error, 1)),
            texts(&|(error, std_dev)| fixed((error / std_dev).abs(), 1)),
        ]);
    }
    Ok(vec![table.with(&seeds(&TILTED, SEED_OF_TILTED))])
}

fn fall_off(settings: &Settings) -> String {
    match settings.imperfections.fall_off {
        FallOffLaw::Cos4 => "cos⁴".to_owned(),
        FallOffLaw::None => "none".to_owned(),
        FallOffLaw::HalfResponseDeg(angle) => format!("pixels, ½ at {angle}°"),
    }
}

/// Returns the relative errors of the tilt gradient along u and v, with their σ.
fn tilt_gradient_errors(shoot: &Shoot) -> Result<[(f64, f64); 2]> {
    let found = shoot.measured.internal.parameters.tilt_gradient;
    let found = found.ok_or_else(|| Error::invalid("the tilt gradient was not measured"))?;
    let pixel_mm = shoot.sheet.sensor.pixel_size_mm;
    let truth = optics::tilt_gradient_per_mm(&shoot.settings.camera) * pixel_mm;
    let of = |i: usize| {
        let found = Estimate::new(found.growth_per_px[i], found.std_dev_per_px[i]);
        (found.value / truth[i] - 1.0, found.std_dev / truth[i])
    };
    Ok([of(0), of(1)])
}
