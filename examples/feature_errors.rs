//! Writes a table of the errors of detected features: simulated boards against their truth.
//!
//!     cargo run --release --example feature_errors [PART OF A NAME [SEED]]

use plenocal::Result;
use plenocal::assessment::DetectionScore;
use plenocal::detection::DepthEstimator;
use plenocal::simulation::Settings;

/// Name, preset, replaced settings, and number of frames.
const SETS: [(&str, &str, &[&str], usize); 11] = [
    ("mini", "mini", &[], 10),
    ("mini, 16 bit", "mini", &["imaging.bits=16"], 10),
    ("mini, noise of 2 grey levels", "mini", &["imaging.read_noise_electrons=102"], 10),
    ("mini, noise of 4 grey levels", "mini", &["imaging.read_noise_electrons=204"], 10),
    ("mini, tilt up to 45 degrees", "mini", &["boards.max_tilt_deg=45"], 10),
    ("mini, a third out of view", "mini", &["boards.min_in_view=0.65"], 10),
    ("mini, Bayer mosaic", "mini", &["imaging.color=bayer-rggb"], 10),
    (
        "mini, square array, one lens type",
        "mini",
        &[
            "camera.micro_lens_array.lattice=orthogonal",
            "camera.micro_lens_array.rows=32",
            "camera.micro_lens_array.focal_lengths_mm=[0.552]",
        ],
        10,
    ),
    ("keplerian", "keplerian", &[], 8),
    ("r12-a", "r12-a", &[], 6),
    ("r12-a, noise of 4 grey levels", "r12-a", &["imaging.read_noise_electrons=204"], 4),
];

fn main() -> Result<()> {
    println!(
        "| boards | labelled | found | true | position, blur up to 3 px | position, all | ρ | 1/ν, line | \
         1/ν, median |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    let wanted = std::env::args().nth(1).unwrap_or_default();
    let seed = std::env::args().nth(2);
    for (name, preset, replaced, frames) in SETS {
        if !name.contains(&wanted) {
            continue;
        }
        let seed = seed.as_ref().map(|seed| format!("seed={seed}"));
        let replaced: Vec<String> = replaced.iter().map(ToString::to_string).chain(seed).collect();
        let settings = Settings::preset(preset, &replaced)?;
        let score = DetectionScore::of_simulation(&settings, frames, DepthEstimator::Line)?;
        println!(
            "| {name} | {} of {} | {:.1} % | {:.2} % | {:.3} px | {:.3} px | {:.3} px | {:.2} % | {:.2} % |",
            score.labelled,
            score.frames,
            100.0 * score.recall(),
            100.0 * score.precision(),
            score.small_rms_px(),
            score.rms_px(),
            score.rho_rms_px(),
            100.0 * score.depth_rms(),
            100.0 * score.median_depth_rms(),
        );
    }
    Ok(())
}
