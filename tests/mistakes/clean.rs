//! Clean sets, which may not warn: other cameras, boards and exposures.

use crate::Expected::Clean;
use crate::set::Set;
use crate::{Mistake, mistake};

/// Settings of clean sets, each with seeds of its own.
const SETS: [&[&str]; 12] = [
    &[],
    &["boards.calibration=14"],
    &["imaging.bits=16"],
    &["imaging.color=bayer-rggb"],
    &["imaging.exposure=0.5"],
    &["target.columns=9", "target.rows=6", "target.square_mm=2.5"],
    &["target.columns=6", "target.rows=5", "target.square_mm=4"],
    &["camera.main_lens.exit_pupil_mm=[0,0,-5]"],
    &["imperfections.aperture_ratio=0.92", "imperfections.point_spread_px=0.3"],
    &["white_images.gain=3"],
    &["imaging.black_level=0.03"],
    &["camera.micro_lens_array.rotation_rad=[-0.0012,0.0009,0.004]"],
];
/// Seeds of each.
const SEEDS: std::ops::Range<u32> = 9201..9208;
/// Settings of the Keplerian camera: boards that it sees whole and sharp enough. And its seeds.
const KEPLERIAN: [&str; 3] =
    ["boards.min_in_view=1", "boards.depth_mm=[200,400]", "translation.images=0"];
const KEPLERIAN_SEEDS: std::ops::Range<u32> = 9301..9317;

pub fn sets() -> Vec<Mistake> {
    let mut all = Vec::new();
    for settings in SETS {
        for seed in SEEDS {
            let name = format!("clean: mini {} seed {seed}", settings.join(" "));
            all.push(mistake(name, Clean, move || of("mini", settings, seed)));
        }
    }
    for seed in KEPLERIAN_SEEDS {
        all.push(mistake(format!("clean: keplerian seed {seed}"), Clean, move || {
            of("keplerian", &KEPLERIAN, seed)
        }));
    }
    all
}

fn of(preset: &str, settings: &[&str], seed: u32) -> Set {
    let seed = format!("seed={seed}");
    let mut arguments = vec!["--preset", preset, "--set", &seed];
    arguments.extend(settings.iter().flat_map(|s| ["--set", *s]));
    let set = Set::of(&arguments);
    if preset == "mini" { set } else { set.without_step() }
}
