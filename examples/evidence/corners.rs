//! Detected corners of simulated boards against their truth.

use plenocal::Result;
use plenocal::assessment::DetectionScore;
use plenocal::assessment::bias::{Bias, by_offset, by_place, of_rho, outwards, worst};
use plenocal::detection::DepthEstimator;

use crate::sets::{Extent, Set, seeds, set, step};
use crate::text::{Table, signed};

const SETS: [Set; 11] = [
    set("`mini`", "mini", &[]),
    set("`mini`, 16 bit", "mini", &["imaging.bits=16"]),
    set("`mini`, noise of 2 grey levels", "mini", &["imaging.read_noise_electrons=102"]),
    set("`mini`, noise of 4 grey levels", "mini", &["imaging.read_noise_electrons=204"]),
    set("`mini`, tilt up to 45 degrees", "mini", &["boards.max_tilt_deg=45"]),
    set("`mini`, a third out of view", "mini", &["boards.min_in_view=0.65"]),
    set("`mini`, Bayer mosaic", "mini", &["imaging.color=bayer-rggb"]),
    set(
        "`mini`, square array, one lens type",
        "mini",
        &[
            "camera.micro_lens_array.lattice=orthogonal",
            "camera.micro_lens_array.rows=32",
            "camera.micro_lens_array.focal_lengths_mm=[0.552]",
        ],
    ),
    set("`keplerian`", "keplerian", &[]),
    set("`r12-a`", "r12-a", &[]),
    // A gain of 4 would raise the noise of the white images to 16 grey levels.
    set(
        "`r12-a`, noise of 4 grey levels, white images not clipped",
        "r12-a",
        &["imaging.read_noise_electrons=204", "white_images.gain=1"],
    ),
];
const SEED: u64 = 7301;

const BIASED: [Set; 8] = [
    set("`mini`", "mini", &[]),
    set("`mini`, pupil at −5 mm", "mini", &["camera.main_lens.exit_pupil_mm=[0, 0, -5]"]),
    set("`mini`, pupil at 5 mm", "mini", &["camera.main_lens.exit_pupil_mm=[0, 0, 5]"]),
    set("`mini`, no fall-off", "mini", &["imperfections.fall_off=none"]),
    set("`mini`, half response at 25°", "mini", &["imperfections.fall_off={half_response_deg=25}"]),
    set("`keplerian`", "keplerian", &[]),
    set("`r12-a`, not clipped", "r12-a", &["white_images.gain=1"]),
    set(
        "`r12-a`, not clipped, no fall-off",
        "r12-a",
        &["white_images.gain=1", "imperfections.fall_off=none"],
    ),
];
const SEED_OF_BIASED: u64 = 7351;
/// Most boards of a set.
const FRAMES: usize = 10;

/// Measures how many corners are found, and how well.
pub fn errors(extent: &Extent) -> Result<Vec<String>> {
    let mut table = Table::new(&[
        "boards",
        "labelled",
        "found",
        "true",
        "position, blur up to 3 px",
        "position, all",
        "ρ",
        "1/ν, line",
        "1/ν, median",
    ]);
    for (set, settings) in extent.settings(&SETS, SEED)? {
        step(set.name);
        let frames = extent.or_few(FRAMES, 2);
        let score = DetectionScore::of_simulation(&settings, frames, DepthEstimator::Line)?;
        table.row([
            set.name.to_owned(),
            format!("{} of {}", score.labelled, score.frames),
            format!("{:.1} %", 100.0 * score.recall()),
            format!("{:.2} %", 100.0 * score.precision()),
            format!("{:.3} px", score.small_rms_px()),
            format!("{:.3} px", score.rms_px()),
            format!("{:.3} px", score.rho_rms_px()),
            format!("{:.2} %", 100.0 * score.depth_rms()),
            format!("{:.2} %", 100.0 * score.median_depth_rms()),
        ]);
    }
    Ok(vec![table.with(&seeds(&SETS, SEED))])
}

/// Measures the systematic errors of corners, by class: the largest of each kind.
pub fn bias(extent: &Extent) -> Result<Vec<String>> {
    let mut table = Table::new(&[
        "boards",
        "features",
        "position by place",
        "by distance from the centre, by type",
        "outwards",
        "ρ by place",
    ]);
    for (set, settings) in extent.settings(&BIASED, SEED_OF_BIASED)? {
        step(set.name);
        let frames = extent.or_few(FRAMES, 2);
        let score = DetectionScore::of_simulation(&settings, frames, DepthEstimator::Line)?;
        let errors = &score.errors;
        let of_types: Vec<String> = (0..settings.camera.lens_types())
            .map(|lens_type| largest(&by_offset(errors, lens_type)))
            .collect();
        let (mean, std_dev) = outwards(errors);
        table.row([
            set.name.to_owned(),
            errors.len().to_string(),
            largest(&by_place(errors)),
            of_types.join(", "),
            format!("{} ± {:.2} %", signed(100.0 * mean, 2), 100.0 * std_dev),
            largest(&of_rho(errors)),
        ]);
    }
    Ok(vec![table.with(&seeds(&BIASED, SEED_OF_BIASED))])
}

fn largest(classes: &[Bias]) -> String {
    worst(classes)
        .map_or("none".to_owned(), |b| format!("{} ± {:.4} px", signed(b.mean_px, 4), b.std_dev_px))
}
