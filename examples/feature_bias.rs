//! Writes a table of the systematic errors of detected features: simulated boards against their truth, for
//! several cameras and laws of fall-off. Settings are those of `plenocal simulate --set`, such as `rays=200`, which
//! takes away most of the noise of the simulation. `FRAMES=3` takes so many boards of each camera; `CLASSES=1` also writes
//! the errors of every class.
//!
//!     cargo run --release --example feature_bias [PART OF A NAME [SETTING…]]

use plenocal::Result;
use plenocal::assessment::DetectionScore;
use plenocal::assessment::bias::{Bias, by_offset, by_place, of_rho, outwards, worst};
use plenocal::detection::DepthEstimator;
use plenocal::simulation::Settings;

/// Name, preset, replaced settings, and number of frames.
const SETS: [(&str, &str, &[&str], usize); 8] = [
    ("mini", "mini", &[], 10),
    ("mini, pupil at -5 mm", "mini", &["camera.main_lens.exit_pupil_mm=[0,0,-5]"], 10),
    ("mini, pupil at +5 mm", "mini", &["camera.main_lens.exit_pupil_mm=[0,0,5]"], 10),
    ("mini, no fall-off", "mini", &["imperfections.fall_off=none"], 10),
    (
        "mini, half response at 25 degrees",
        "mini",
        &["imperfections.fall_off={half_response_deg=25}"],
        10,
    ),
    ("keplerian", "keplerian", &[], 8),
    ("r12-a", "r12-a", &[], 4),
    ("r12-a, no fall-off", "r12-a", &["imperfections.fall_off=none"], 4),
];

fn main() -> Result<()> {
    println!(
        "| boards | features | position by place | by distance from the centre, by type | outwards | ρ by place |"
    );
    println!("|---|---|---|---|---|---|");
    let mut arguments = std::env::args().skip(1);
    let wanted = arguments.next().unwrap_or_default();
    let own: Vec<String> = arguments.collect();
    for (name, preset, replaced, frames) in SETS {
        if !name.contains(&wanted) {
            continue;
        }
        let mut replaced: Vec<String> = replaced.iter().map(ToString::to_string).collect();
        replaced.extend(own.iter().cloned());
        let settings = Settings::preset(preset, &replaced)?;
        let frames = std::env::var("FRAMES").ok().and_then(|n| n.parse().ok()).unwrap_or(frames);
        let score = DetectionScore::of_simulation(&settings, frames, DepthEstimator::Line)?;
        let errors = &score.errors;
        let of_types: Vec<String> = (0..settings.camera.lens_types())
            .map(|lens_type| text(&by_offset(errors, lens_type)))
            .collect();
        println!(
            "| {name} | {} | {} | {} | {:+.2} ± {:.2} % | {} |",
            errors.len(),
            text(&by_place(errors)),
            of_types.join(", "),
            100.0 * outwards(errors).0,
            100.0 * outwards(errors).1,
            text(&of_rho(errors)),
        );
        if std::env::var_os("CLASSES").is_some() {
            for (what, classes) in [("place", by_place(errors)), ("rho", of_rho(errors))] {
                eprintln!("{what}: {}", all(&classes));
            }
            for lens_type in 0..settings.camera.lens_types() {
                eprintln!("type {}: {}", lens_type + 1, all(&by_offset(errors, lens_type)));
            }
        }
    }
    Ok(())
}

fn text(classes: &[Bias]) -> String {
    worst(classes)
        .map_or("none".to_owned(), |b| format!("{:+.4} ± {:.4} px", b.mean_px, b.std_dev_px))
}

fn all(classes: &[Bias]) -> String {
    let one = |b: &Bias| format!("{:.0}: {:+.4} ± {:.4}", b.distance_px, b.mean_px, b.std_dev_px);
    classes.iter().map(one).collect::<Vec<_>>().join("; ")
}
