//! The aperture ratio of the micro-lenses: from boards, and in whole calibrations.

use plenocal::assessment::ParameterError;
use plenocal::calibration::CalibrationOptions;
use plenocal::detection::DetectedBoards;
use plenocal::model::{Opening, optics};
use plenocal::{Error, Estimate, Result};

use crate::sets::{Extent, Set, seeds, set, step};
use crate::shoot::{Calibrated, Shoot, error_of, estimate_of};
use crate::text::{Table, over_sigma, percent, relative_error};

const DETECTED: [Set; 9] = [
    set("`mini`", "mini", &[]),
    set("`keplerian`", "keplerian", &[]),
    set("`mini-double-gauss`", "mini-double-gauss", &[]),
    set("`mini`", "mini", &["imperfections.aperture_ratio=0.92"]),
    set(
        "`mini`",
        "mini",
        &["imperfections.aperture_ratio=0.85", "imperfections.point_spread_px=0.5"],
    ),
    set(
        "`keplerian`",
        "keplerian",
        &["imperfections.aperture_ratio=0.9", "imperfections.point_spread_px=0.5"],
    ),
    set("`mini`", "mini", &["imperfections.point_spread_px=1"]),
    set("`keplerian`", "keplerian", &["imperfections.point_spread_px=1"]),
    set("`mini`", "mini", &["imperfections.point_spread_px=0.3"]),
];
const SEED_OF_DETECTED: u64 = 7601;

/// Finds aperture ratio and point spread in the boards.
pub fn by_detection(extent: &Extent) -> Result<Vec<String>> {
    let mut table =
        Table::new(&["set", "aperture ratio", "found", "point spread²", "found in boards"]);
    for (set, settings) in extent.settings(&DETECTED, SEED_OF_DETECTED)? {
        step(set.name);
        let shoot = Shoot::of(settings)?;
        let found = shoot.boards()?;
        let imperfections = &shoot.settings.imperfections;
        table.row([
            set.name.to_owned(),
            imperfections.aperture_ratio.to_string(),
            ratio(&found)?.to_string(),
            format!("{:.2} px²", imperfections.point_spread_px.powi(2)),
            spread(&found).map_or("-".to_owned(), |spread| format!("{spread} px²")),
        ]);
    }
    Ok(vec![table.with(&seeds(&DETECTED, SEED_OF_DETECTED))])
}

fn ratio(found: &DetectedBoards) -> Result<Estimate> {
    found.aperture_ratio.ok_or_else(|| Error::invalid("the boards do not show the aperture ratio"))
}

/// Returns the weighted mean of the point spread over the frames; `None` if no frame shows it.
fn spread(found: &DetectedBoards) -> Option<Estimate> {
    let of_frames = found.frames.iter().filter_map(|frame| frame.result.as_ref().ok()?.edges);
    let (mut weights, mut sum) = (0.0, 0.0);
    for edges in of_frames {
        let weight = edges.spread_px2.std_dev.powi(-2);
        weights += weight;
        sum += weight * edges.spread_px2.value;
    }
    (weights > 0.0).then(|| Estimate::new(sum / weights, f64::powf(weights, -0.5)))
}

macro_rules! imperfect {
    ($preset:literal, $ratio:literal, $spread:literal, $black:literal $(, $more:literal)*) => {
        set(
            concat!("`", $preset, "`"),
            $preset,
            &[
                concat!("imperfections.aperture_ratio=", $ratio),
                concat!("imperfections.point_spread_px=", $spread),
                concat!("imaging.black_level=", $black),
                $($more),*
            ],
        )
    };
}

// Black levels are fractions of full scale: 0, 4, 8 and 16 of 255.
const CAMERAS: [Set; 20] = [
    imperfect!("mini", 1, 0, 0.0627450980),
    imperfect!("mini", 0.95, 0.3, 0.0313725490),
    imperfect!("mini", 0.9, 0.5, 0.0627450980),
    imperfect!("mini", 0.85, 1, 0),
    imperfect!("mini", 0.85, 0.3, 0.0627450980),
    imperfect!("mini", 0.95, 1, 0.0313725490),
    imperfect!("mini", 1, 0.5, 0.0156862745),
    imperfect!("mini", 0.9, 0, 0),
    imperfect!("keplerian", 1, 0, 0.0627450980),
    imperfect!("keplerian", 0.95, 0.3, 0.0313725490),
    imperfect!("keplerian", 0.9, 0.5, 0.0627450980),
    imperfect!("keplerian", 0.85, 1, 0),
    imperfect!("keplerian", 0.85, 0.3, 0.0627450980),
    imperfect!("keplerian", 0.95, 1, 0.0313725490),
    imperfect!("keplerian", 1, 0.5, 0.0156862745),
    imperfect!("keplerian", 0.9, 0, 0),
    imperfect!("r12-a", 0.92, 0.5, 0.0627450980, "boards.calibration=8"),
    imperfect!("r12-a", 0.85, 1, 0, "boards.calibration=8"),
    imperfect!("r12-a", 1, 0.3, 0.0313725490, "boards.calibration=8"),
    set(
        "`r12-a`, not clipped",
        "r12-a",
        &[
            "imperfections.aperture_ratio=0.85",
            "imperfections.point_spread_px=1",
            "boards.calibration=8",
            "white_images.gain=1",
        ],
    ),
];
const SEED_OF_CAMERAS: u64 = 7621;

/// Calibrates cameras with imperfect micro-lenses and pixels.
pub fn cameras(extent: &Extent) -> Result<Vec<String>> {
    let mut table =
        Table::new(&["set", "φ", "point spread", "black level", "φ found", "F", "d", "f", "m"]);
    let mut over_sigmas = Vec::new();
    for (set, settings) in extent.settings(&CAMERAS, SEED_OF_CAMERAS)? {
        step(&format!("{}, seed {}", set.name, settings.seed));
        let camera = Calibrated::of(settings, &CalibrationOptions::default())?;
        let Calibrated { shoot, boards, calibration, .. } = &camera;
        let errors = camera.errors(calibration)?;
        let m = (shoot.m_mm(), shoot.truth()?.m_mm);
        let of = |name: &str| {
            let error = error_of(&errors, name);
            (estimate_of(error), error.truth)
        };
        let size = |(found, truth): &(Estimate, f64)| (found.value / truth - 1.0).abs();
        let types = ["f_1", "f_2", "f_3"].map(of);
        let worst = types.into_iter().max_by(|a, b| size(a).total_cmp(&size(b)));
        let shown = [of("F"), of("d"), worst.unwrap_or(m), m];
        over_sigmas.extend(shown.map(|(found, truth)| (found.value - truth).abs() / found.std_dev));
        let (imperfections, imaging) = (&shoot.settings.imperfections, &shoot.settings.imaging);
        let first = [
            set.name.to_owned(),
            imperfections.aperture_ratio.to_string(),
            format!("{} px", imperfections.point_spread_px),
            format!("{:.0}", 255.0 * imaging.black_level),
            ratio(boards)?.to_string(),
        ];
        table.row(
            first.into_iter().chain(shown.map(|(found, truth)| relative_error(&found, truth, 1))),
        );
    }
    let within = |limit: f64| over_sigmas.iter().filter(|x| **x <= limit).count();
    let largest = over_sigmas.iter().copied().fold(0.0, f64::max);
    let coverage = format!(
        "Of the {} errors, {} are within 1 σ and {} within 2 σ; the largest is {largest:.1} σ. {}",
        over_sigmas.len(),
        within(1.0),
        within(2.0),
        seeds(&CAMERAS, SEED_OF_CAMERAS)
    );
    Ok(vec![table.with(&coverage)])
}

const OPENINGS: [Set; 7] = [
    set("`mini`", "mini", &["imperfections.opening=hexagon"]),
    set(
        "`mini`",
        "mini",
        &[
            "imperfections.opening=hexagon",
            "imperfections.aperture_ratio=0.92",
            "imperfections.point_spread_px=0.4",
        ],
    ),
    set("`keplerian`", "keplerian", &["imperfections.opening=hexagon"]),
    set("`mini-double-gauss`", "mini-double-gauss", &["imperfections.opening=hexagon"]),
    set(
        "`mini`, square lattice, one type",
        "mini",
        &[
            "imperfections.opening=square",
            "camera.micro_lens_array.lattice=orthogonal",
            "camera.micro_lens_array.focal_lengths_mm=[0.54]",
        ],
    ),
    set(
        "`mini`, square lattice, one type",
        "mini",
        &[
            "imperfections.opening=square",
            "imperfections.aperture_ratio=0.92",
            "imperfections.point_spread_px=0.4",
            "camera.micro_lens_array.lattice=orthogonal",
            "camera.micro_lens_array.focal_lengths_mm=[0.54]",
        ],
    ),
    set("`real-c`", "real-c", &[]),
];
const SEED_OF_OPENINGS: u64 = 9911;

/// Calibrates cameras whose openings are hexagons or squares, and again as if they were discs.
pub fn openings(extent: &Extent) -> Result<Vec<String>> {
    let mut table = Table::new(&[
        "set",
        "opening",
        "cell share",
        "φ",
        "φ found",
        "F",
        "d",
        "f",
        "distances",
        "as discs: F",
        "f",
    ]);
    for (set, settings) in extent.settings(&OPENINGS, SEED_OF_OPENINGS)? {
        step(&format!("{}, seed {}", set.name, settings.seed));
        let camera = Calibrated::of(settings, &CalibrationOptions::default())?;
        let shoot = &camera.shoot;
        let round = Shoot::stated(shoot.settings.clone(), Some(Opening::Disc))?;
        let as_discs = Calibrated::of_shoot(round, &CalibrationOptions::default())?;
        let evaluation = camera.evaluation(&[&camera.calibration], 0)?;
        let distances = evaluation.candidates[0].reconstruction.as_ref();
        let relative = |errors: &[ParameterError], name: &str| {
            let error = error_of(errors, name);
            relative_error(&estimate_of(error), error.truth, 2)
        };
        let worst_type = |errors: &[ParameterError]| {
            let of = |name: &str| errors.iter().find(|error| error.name == name);
            let types = ["f_1", "f_2", "f_3"].into_iter().filter_map(of);
            let size = |error: &&ParameterError| (error.error() / error.truth).abs();
            let worst = types.max_by(|a, b| size(a).total_cmp(&size(b)));
            worst.map_or("-".to_owned(), |error| relative(errors, &error.name))
        };
        let (errors, of_discs) =
            (camera.errors(&camera.calibration)?, as_discs.errors(&as_discs.calibration)?);
        let internal = &shoot.measured.internal.parameters;
        table.row([
            set.name.to_owned(),
            internal.opening.name().to_owned(),
            shoot.measured.cell_share.map_or("-".to_owned(), |share| share.to_string()),
            shoot.settings.imperfections.aperture_ratio.to_string(),
            ratio(&camera.boards)?.to_string(),
            relative(&errors, "F"),
            relative(&errors, "d"),
            worst_type(&errors),
            distances.map_or("-".to_owned(), |found| percent(found.too_long.value, 3)),
            relative(&of_discs, "F"),
            worst_type(&of_discs),
        ]);
    }
    Ok(vec![table.with(&seeds(&OPENINGS, SEED_OF_OPENINGS))])
}

const TILTED: [Set; 6] = [
    set("`mini`", "mini", &["imperfections.aperture_ratio=0.85"]),
    set("`mini`", "mini", &["imperfections.aperture_ratio=0.92"]),
    set("`keplerian`", "keplerian", &["imperfections.aperture_ratio=0.9"]),
    set("`mini`", "mini", &["imperfections.aperture_ratio=0.7"]),
    set("`mini`", "mini", &["imperfections.aperture_ratio=0.7"]),
    set("`mini`", "mini", &["imperfections.aperture_ratio=0.7"]),
];
const SEED_OF_TILTED: u64 = 7651;

/// Measures the tilt gradient from white images, with the aperture ratio of the boards.
pub fn tilt_gradient(extent: &Extent) -> Result<Vec<String>> {
    let mut table =
        Table::new(&["set", "φ", "error without φ", "error with φ (over σ)", "error of F"]);
    for (set, settings) in extent.settings(&TILTED, SEED_OF_TILTED)? {
        step(set.name);
        let camera = Calibrated::of(settings, &CalibrationOptions::default())?;
        let errors = camera.errors(&camera.calibration)?;
        let focal_length = error_of(&errors, "F");
        let [without, with] = tilt_gradient_errors(&camera.shoot, &ratio(&camera.boards)?)?;
        table.row([
            set.name.to_owned(),
            camera.shoot.settings.imperfections.aperture_ratio.to_string(),
            without,
            with,
            relative_error(&estimate_of(focal_length), focal_length.truth, 1),
        ]);
    }
    Ok(vec![table.with(&seeds(&TILTED, SEED_OF_TILTED))])
}

/// Formats the errors of the tilt gradient along u and v without the aperture ratio, and with it over σ.
fn tilt_gradient_errors(shoot: &Shoot, ratio: &Estimate) -> Result<[String; 2]> {
    let internal = &shoot.measured.internal.parameters;
    let pixel_mm = shoot.sheet.sensor.pixel_size_mm;
    let pitch_mm = shoot.measured.array.grid.pitch_px * pixel_mm;
    let truth = optics::tilt_gradient_per_mm(&shoot.settings.camera) * pixel_mm;
    let known = internal.with_aperture_ratio(*ratio, pitch_mm);
    let (Some(shown), Some(known)) = (internal.tilt_gradient, known.tilt_gradient) else {
        return Err(Error::invalid("the tilt gradient was not measured"));
    };
    let error = |growth_per_px: [f64; 2], i: usize| growth_per_px[i] / truth[i] - 1.0;
    let without = [0, 1].map(|i| percent(error(shown.growth_per_px, i), 1));
    let with = [0, 1].map(|i| {
        let error = error(known.growth_per_px, i);
        over_sigma(&percent(error, 1), error, known.std_dev_per_px[i] / truth[i])
    });
    Ok([without.join(", "), with.join(", ")])
}
