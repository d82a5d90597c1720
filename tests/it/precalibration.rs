//! White images: from pixels to the array and the internal parameters, on simulated and on real ones.

use std::collections::HashMap;
use std::fs;
use std::path::Path;

use nalgebra::Vector2;
use plenocal::image::{Color, RawImage, Samples};
use plenocal::io::{read_image, read_raytrix};
use plenocal::model::{
    Configuration, Lattice, LatticeKind, MicroImageCenter, Packing, Parity, optics,
};
use plenocal::precalibration::{
    ArrayMeasurement, MicroImageArray, Precalibration, PrecalibrationOptions, RadiusEstimator,
    White, fit_grid, measure_array, precalibrate,
};
use plenocal::simulation::{DataSet, Settings, Shot};
use predicates::prelude::PredicateBooleanExt;
use predicates::str::contains;
use tempfile::TempDir;

use crate::support::{plenocal, preset};

/// The limits that the pre-calibration is held to: centres, px RMS; pitch, relative; rotation, rad;
/// m and q', relative.
const CENTERS_PX: f64 = 0.05;
const PITCH: f64 = 1e-5;
const ROTATION: f64 = 1e-5;
const INTERNAL: f64 = 0.01;
/// In Keplerian configuration rays meet the sensor at up to 20 degrees more, and the light that this
/// costs at the edge is taken for a smaller radius.
const INTERNAL_KEPLERIAN: f64 = 0.02;

fn white(settings: &Settings, shot: &Shot) -> White {
    White {
        name: format!("f/{:.2}", shot.f_number),
        f_number: shot.f_number,
        image: shot.take(settings, &|| ()).unwrap(),
    }
}

fn options(settings: &Settings) -> PrecalibrationOptions {
    PrecalibrationOptions::of_datasheet(&settings.datasheet())
}

fn taken(settings: &Settings) -> (Vec<White>, White) {
    let plan = DataSet::plan(settings, None).unwrap();
    let whites = plan.whites.iter().map(|shot| white(settings, shot)).collect();
    (whites, white(settings, &plan.devignetting))
}

/// Distances of measured centres to the true ones, and the grid of the true ones.
fn compare(settings: &Settings, array: &ArrayMeasurement) -> (f64, f64, f64) {
    let truth = settings.tracer(settings.board_f_number()).unwrap().centers();
    let truth: Vec<MicroImageCenter> = truth.iter().map(|t| t.center).collect();
    let by_index: HashMap<_, _> =
        truth.iter().map(|c| ((c.k, c.l), Vector2::new(c.u_px, c.v_px))).collect();
    let square = |c: &MicroImageCenter| {
        (by_index[&(c.k, c.l)] - Vector2::new(c.u_px, c.v_px)).norm_squared()
    };
    let rms = (array.centers.iter().map(square).sum::<f64>() / array.centers.len() as f64).sqrt();
    let lattice = &array.grid.lattice;
    let grid = fit_grid(&truth, lattice.kind(), lattice.columns, lattice.rows).unwrap();
    let pitch = array.grid.pitch_px / grid.pitch_px - 1.0;
    (rms, pitch, array.grid.rotation_rad - grid.rotation_rad)
}

fn assert_right(name: &str, settings: &Settings, result: &Precalibration) {
    let (rms, pitch, rotation) = compare(settings, &result.array);
    println!("{name}: centres {rms:.4} px RMS, pitch {pitch:+.1e}, rotation {rotation:+.1e} rad");
    assert!(rms < CENTERS_PX, "{name}: {rms} px");
    // What is not symmetric about a centre tells how far off it may be; grids of pixels and what is
    // left of shading add to it.
    let std_devs = || result.array.centers.iter().filter_map(|c| c.std_dev_px);
    let square = std_devs().map(|s| s * s).sum::<f64>() / std_devs().count() as f64;
    let ratio = rms / (2.0 * square).sqrt();
    println!("{name}: error over standard deviation {ratio:.2}");
    assert!((0.5..2.0).contains(&ratio), "{name}: {ratio}");
    assert!(pitch.abs() < PITCH, "{name}: {pitch}");
    assert!(rotation.abs() < ROTATION, "{name}: {rotation}");
    let truth = optics::internal_parameters(&settings.camera);
    let internal = &result.internal.parameters;
    let m = internal.m_mm / truth.m_mm - 1.0;
    println!("{name}: m {:+.2} %", 100.0 * m);
    let keplerian = settings.camera.configuration() == Some(Configuration::Keplerian);
    let limit = if keplerian { INTERNAL_KEPLERIAN } else { INTERNAL };
    assert!(m.abs() < limit, "{name}: m {m}");
    assert_eq!(internal.q_prime_mm.len(), settings.camera.lens_types(), "{name}");
    for (q, truth) in internal.q_prime_mm.iter().zip(&truth.q_prime_mm) {
        println!("{name}: q' {:+.2} %", 100.0 * (q / truth - 1.0));
        assert!((q / truth - 1.0).abs() < INTERNAL, "{name}: q' {q} for {truth}");
    }
    if settings.camera.lens_types() == 3 {
        assert!(result.lens_types.agreement > Some(0.999), "{name}: {:?}", result.lens_types);
    }
}

/// 8 bits with noise, a tilted array, an axis off the middle, clipped white images.
#[test]
fn an_r12_is_measured_from_its_white_images() {
    let settings = preset("r12-a", &["rays=32"]);
    let (whites, reference) = taken(&settings);
    let result = precalibrate(&whites, Some(&reference), &options(&settings), &|| ()).unwrap();
    assert!(result.warnings.is_empty(), "{:?}", result.warnings);
    assert_right("r12-a", &settings, &result);
}

#[test]
fn small_cameras_are_measured_in_every_colour_exposure_and_configuration() {
    for (name, replaced) in [
        ("mini", vec!["white_images.gain=4"]),
        ("mini", vec!["imaging.color=bayer-gbrg", "imaging.bits=16"]),
        ("mini", vec!["imaging.color=rgb", "white_images.exposure=0.4"]),
        ("keplerian", vec![]),
    ] {
        let settings = preset(name, &replaced);
        let (whites, reference) = taken(&settings);
        let result = precalibrate(&whites, Some(&reference), &options(&settings), &|| ()).unwrap();
        assert_right(&format!("{name} {replaced:?}"), &settings, &result);
        // Without a reference the widest white image serves.
        let result = precalibrate(&whites, None, &options(&settings), &|| ()).unwrap();
        assert!(compare(&settings, &result.array).0 < CENTERS_PX);
    }
}

/// A small camera's white image at f/8.
fn small_white(replaced: &[&str]) -> (Settings, RawImage) {
    let settings = preset("mini", replaced);
    let shot = DataSet::plan(&settings, None).unwrap().devignetting;
    let image = Shot { f_number: 8.0, ..shot }.take(&settings, &|| ()).unwrap();
    (settings, image)
}

/// Centroids alone, without what other f-numbers tell of shading, which moves them by up to 0.1 px at
/// the border of these images.
const ALONE_PX: f64 = 0.12;

#[test]
fn any_lattice_pitch_and_rotation_is_found_unaided() {
    for (lattice, pixel_size, rotation, pitch) in [
        ("hexagonal-rows", 0.0183, 0.07, 7.0),
        ("hexagonal-columns", 0.0107, -0.05, 12.0),
        ("orthogonal", 0.0055, 0.1, 23.3),
        ("hexagonal-columns", 0.0040, 0.09, 32.1),
        ("hexagonal-rows", 0.0022, -0.08, 58.3),
    ] {
        let types = if lattice == "orthogonal" { "[0.55]" } else { "[0.578, 0.505, 0.552]" };
        let replaced = [
            "rays=16".to_owned(),
            format!("camera.micro_lens_array.lattice={lattice}"),
            format!("camera.micro_lens_array.rotation_rad=[0.0, 0.0, {rotation}]"),
            format!("camera.micro_lens_array.focal_lengths_mm={types}"),
            format!("camera.sensor.pixel_size_mm={pixel_size}"),
            "camera.micro_lens_array.columns=180".to_owned(),
            "camera.micro_lens_array.rows=180".to_owned(),
            "camera.micro_lens_array.offset_mm=[0.0, 0.0]".to_owned(),
            "camera.principal_point_px=[499.5, 374.5]".to_owned(),
            "camera.main_lens.q1_per_mm2=0".to_owned(),
            "camera.main_lens.q2_per_mm4=0".to_owned(),
            "camera.main_lens.q3_per_mm6=0".to_owned(),
            "boards.min_in_view=0".to_owned(),
        ];
        let replaced: Vec<&str> = replaced.iter().map(String::as_str).collect();
        let (settings, image) = small_white(&replaced);
        let array = measure_array(&image, None).unwrap();
        let grid = &array.grid;
        assert_eq!(grid.lattice.kind().name(), lattice);
        assert!((grid.pitch_px / settings.camera.micro_image_pitch_px() - 1.0).abs() < 1e-3);
        assert!((grid.pitch_px - pitch).abs() < 0.1, "{}", grid.pitch_px);
        assert!((grid.rotation_rad - rotation).abs() < 1e-4, "{}", grid.rotation_rad);
        // Each lies on a true one; indices count from another one.
        let truth = settings.tracer(8.0).unwrap().centers();
        let mut square = 0.0;
        for c in array.centers.iter().step_by(7) {
            let off = |t: &MicroImageCenter| (t.u_px - c.u_px).hypot(t.v_px - c.v_px);
            square += truth.iter().map(|t| off(&t.center)).fold(f64::MAX, f64::min).powi(2);
        }
        let rms = (square / array.centers.len().div_ceil(7) as f64).sqrt();
        println!("{lattice}, {pitch} px: {rms:.3} px RMS, {} centres", array.centers.len());
        assert!(rms < ALONE_PX, "{lattice} at {pitch} px: {rms} px");
        assert!(array.centers.len() * 10 > truth.len() * 7);
    }
}

#[test]
fn damage_is_left_out_by_reason_and_does_not_spoil_the_rest() {
    let (settings, mut image) = small_white(&["imperfections.dead_micro_lenses=40"]);
    // A black and a white patch, the black one where the pattern is looked for first.
    let Samples::Bits8(samples) = &mut image.samples else { panic!("an image of 8 bits") };
    for v in 250..500 {
        samples[v * image.width..][350..650].fill(0);
    }
    for v in 20..150 {
        samples[v * image.width..][20..150].fill(255);
    }
    let array = measure_array(&image, Some((43, 37))).unwrap();
    let (rms, pitch, _) = compare(&settings, &array);
    println!("{:?}, {rms:.3} px RMS, pitch {pitch:+.1e}", array.left_out);
    assert!(rms < ALONE_PX, "{rms} px");
    let all = settings.tracer(8.0).unwrap().centers();
    let out = &array.left_out;
    assert_eq!(array.centers.len() + out.cut + out.dark + out.saturated + out.misplaced, all.len());
    // Three rows and columns of 23 px are within half a pitch of the border.
    let at_border = |t: &plenocal::simulation::TrueCenter| {
        let (u, v) = (t.center.u_px, t.center.v_px);
        u.min(v).min(999.0 - u).min(749.0 - v) < 0.5 * array.grid.pitch_px
    };
    let at_border = all.iter().filter(|&t| at_border(t)).count();
    println!("{at_border} at the border");
    assert!((at_border..at_border + 40).contains(&out.cut), "{out:?}");
    // 300 x 250 px hold 160 micro-images, and cut more at the edge; 40 are dead.
    assert!((160..250).contains(&out.dark), "{out:?}");
    // 130 x 130 px hold some 30, of which some at the edge still show one.
    assert!((20..40).contains(&out.saturated), "{out:?}");
}

/// An image of 1000 x 750 px of discs at the centres of a grid, with a little noise.
fn drawn(grid: &MicroImageArray, radius_px: f64) -> RawImage {
    let (width, height) = (1000, 750);
    let mut light = vec![0.0_f64; width * height];
    let Lattice { columns, rows, .. } = grid.lattice;
    for (k, l) in (0..rows).flat_map(|l| (0..columns).map(move |k| (k, l))) {
        let center = grid.center_of(k, l);
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // cut to the image
        let range = |x: f64, length: usize| {
            let end = (x + radius_px + 2.0).max(0.0) as usize;
            (x - radius_px - 1.0).max(0.0) as usize..end.min(length)
        };
        for v in range(center.y, height) {
            for u in range(center.x, width) {
                let distance = (u as f64 - center.x).hypot(v as f64 - center.y);
                light[v * width + u] += 150.0 * (radius_px + 0.5 - distance).clamp(0.0, 1.0);
            }
        }
    }
    // A hash for noise of up to 3 of 255.
    let noise = |i: usize| (i.wrapping_mul(2_654_435_761) >> 7) % 1009 % 4;
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // from 0 to 255
    let sample = |(i, &light): (usize, &f64)| (light + noise(i) as f64).clamp(0.0, 255.0) as u8;
    let samples = Samples::Bits8(light.iter().enumerate().map(sample).collect());
    RawImage { width, height, color: Color::Grey, samples }
}

#[test]
fn an_array_smaller_than_the_sensor_is_counted_by_what_shows() {
    use LatticeKind::{HexagonalColumns, HexagonalRows, Orthogonal};
    for (kind, columns, rows, center, rotation_rad) in [
        (HexagonalRows, 30, 22, (499.5, 374.5), 0.0),
        (HexagonalRows, 29, 21, (470.0, 300.0), 0.02),
        (HexagonalRows, 16, 12, (499.5, 374.5), 0.0),
        (HexagonalColumns, 20, 24, (560.0, 374.5), -0.03),
        (Orthogonal, 14, 12, (499.5, 374.5), 0.05),
        // Beyond the right border.
        (Orthogonal, 25, 20, (730.0, 400.0), 0.0),
    ] {
        let truth = MicroImageArray {
            lattice: Lattice { packing: Packing::new(kind, Parity::Odd), columns, rows },
            pitch_px: 23.3,
            rotation_rad,
            center_px: Vector2::new(center.0, center.1),
            perspective_per_px: Vector2::zeros(),
            rms_px: 0.0,
            outliers: 0,
        };
        let image = drawn(&truth, 9.0);
        let array = measure_array(&image, None).unwrap();
        let (grid, out) = (&array.grid, &array.left_out);
        println!("{kind:?}: {:?}, {out:?}", grid.lattice);
        let shown = (0..columns).filter(|&k| truth.center_of(k, 0).x < 999.0).count();
        assert_eq!(usize::try_from(grid.lattice.columns).unwrap(), shown);
        assert_eq!((grid.lattice.kind(), grid.lattice.rows), (kind, rows));
        assert!((grid.pitch_px - 23.3).abs() < 1e-3 && grid.rms_px < 0.1, "{grid:?}");
        assert_eq!((out.dark, out.saturated, out.misplaced), (0, 0, 0));
        for c in &array.centers {
            let place = truth.center_of(c.k, c.l);
            assert!((place - Vector2::new(c.u_px, c.v_px)).norm() < 0.2, "{c:?} at {place}");
        }
        // As it is, it may be stated; larger than it shows, not.
        let stated = measure_array(&image, Some((columns, rows))).unwrap();
        assert_eq!(stated.centers.len(), array.centers.len());
        let error = measure_array(&image, Some((columns + 6, rows))).unwrap_err().to_string();
        assert!(error.contains(&format!("{shown} x {rows}")), "{error}");
    }
}

#[test]
fn images_without_an_array_are_refused() {
    let size = (600, 500);
    let picture = |value: fn(usize, usize) -> usize| {
        let sample = |i: usize| u16::try_from(value(i % size.0, i / size.0)).unwrap();
        RawImage {
            width: size.0,
            height: size.1,
            color: Color::Grey,
            samples: Samples::Bits16((0..size.0 * size.1).map(sample).collect()),
        }
    };
    // A hash for noise.
    let noise = |u: usize, v: usize| (u * 7919 + v * 104_729) % 1009 * 60;
    for image in [
        picture(|_, _| 0),
        picture(|_, _| 65_535),
        picture(|_, _| 26_000),
        picture(|u, v| (u + v) * 50),
        picture(|u, _| if u / 20 % 2 == 0 { 0 } else { 65_535 }),
        picture(noise),
        RawImage { width: 3, height: 2, color: Color::Grey, samples: Samples::Bits8(vec![128; 6]) },
    ] {
        let error = measure_array(&image, None).unwrap_err().to_string();
        assert!(error.contains("no array of micro-images shows"), "{error}");
    }
}

#[test]
fn white_images_that_do_not_belong_together_are_refused_in_words() {
    let settings = preset("mini", &["rays=8", "white_images.f_numbers=[4.0, 8.0, 16.0]"]);
    let (whites, _) = taken(&settings);
    let options = options(&settings);
    let fails = |whites: &[White], options: &PrecalibrationOptions, words: &str| {
        let error = precalibrate(whites, None, options, &|| ()).unwrap_err().to_string();
        assert!(error.contains(words), "{error}");
    };
    fails(&[], &options, "0 f-number(s)");
    fails(&whites[..1], &options, "1 f-number(s)");
    let twice = [whites[0].clone(), White { f_number: 4.0, ..whites[1].clone() }];
    fails(&twice, &options, "1 f-number(s)");
    let nonsense = [whites[0].clone(), White { f_number: -8.0, ..whites[1].clone() }];
    fails(&nonsense, &options, "the f-number of f/8.00 is -8");
    let swapped = [
        White { f_number: 16.0, ..whites[0].clone() },
        White { f_number: 4.0, ..whites[2].clone() },
    ];
    fails(&swapped, &options, "micro-images do not grow as the f-number falls");
    let small = RawImage {
        width: 10,
        height: 10,
        samples: Samples::Bits8(vec![0; 100]),
        ..whites[1].image.clone()
    };
    let other = [whites[0].clone(), White { image: small, ..whites[1].clone() }];
    fails(&other, &options, "all white images have to be of one camera");
    let pitch = preset("mini", &["rays=8", "camera.micro_lens_array.pitch_mm=0.12"]);
    let shot = DataSet::plan(&pitch, None).unwrap().whites[2];
    fails(&[whites[0].clone(), white(&pitch, &shot)], &options, "they are of different cameras");
    let black = White {
        image: RawImage { samples: Samples::Bits8(vec![0; 750_000]), ..whites[1].image.clone() },
        ..whites[1].clone()
    };
    fails(&[whites[0].clone(), black], &options, "f/8.00: no micro-images show where f/4.00");
    let stated = PrecalibrationOptions { array_size: Some((60, 37)), ..options };
    fails(&whites, &stated, "said to have 60 x 37 micro-lenses");

    // One wrong f-number among three is told.
    let wrong =
        [whites[0].clone(), White { f_number: 5.66, ..whites[1].clone() }, whites[2].clone()];
    let result = precalibrate(&wrong, None, &options, &|| ()).unwrap();
    assert_eq!(result.warnings.len(), 1, "{:?}", result.warnings);
    assert!(result.warnings[0].contains("check its f-number"), "{:?}", result.warnings);

    // What is stated of the camera is held against the images.
    let result = precalibrate(&whites, None, &options, &|| ()).unwrap();
    let mut sheet = settings.datasheet();
    result.check_stated(&sheet).unwrap();
    sheet.lattice_kind = LatticeKind::Orthogonal;
    assert!(result.check_stated(&sheet).unwrap_err().to_string().contains("'orthogonal'"));
    let sheet =
        plenocal::model::Datasheet { micro_image_pitch_px: Some(23.5), ..settings.datasheet() };
    assert!(result.check_stated(&sheet).unwrap_err().to_string().contains("23.5000 px"));
    for (types, fits) in [(0, true), (1, false), (3, true)] {
        let sheet = plenocal::model::Datasheet { lens_types: types, ..settings.datasheet() };
        assert_eq!(result.check_stated(&sheet).is_ok(), fits, "{types} lens types stated");
    }
}

/// The paper's estimator, as it is known to be: short on linear images.
#[test]
fn the_papers_estimator_is_there_by_name() {
    let settings = preset("mini", &["rays=16", "white_images.f_numbers=[4.0, 8.0, 16.0]"]);
    let (whites, _) = taken(&settings);
    let moments =
        PrecalibrationOptions { estimator: RadiusEstimator::Moments, ..options(&settings) };
    let result = precalibrate(&whites, None, &moments, &|| ()).unwrap();
    let truth = optics::internal_parameters(&settings.camera);
    let part = result.internal.parameters.m_mm / truth.m_mm;
    assert!((0.7..0.8).contains(&part), "second moments of linear images give {part} of m");
}

fn simulate(folder: &Path, more: &[&str]) {
    let mut command = plenocal();
    command.args(["simulate", "--set", "rays=8", "--set", "boards.calibration=0"]);
    command.args(["--set", "boards.evaluation=0", "--set", "translation.images=0"]);
    command.args(["--set", "white_images.f_numbers=[4.0, 8.0, 16.0]"]);
    command.args(more).arg("--out").arg(folder).assert().success();
}

fn run(input: &Path, out: &Path) -> assert_cmd::assert::Assert {
    plenocal().arg("precalibrate").arg(input).arg("--out").arg(out).assert()
}

#[test]
fn a_project_is_precalibrated_and_its_files_serve_the_calibration() {
    let folder = TempDir::new().unwrap();
    let (set, out) = (folder.path().join("set"), folder.path().join("results"));
    simulate(&set, &[]);
    run(&set.join("project.toml"), &out)
        .success()
        .stdout(contains("Lattice hexagonal-rows, 43 x 37").and(contains("q'_3")))
        .stderr("");
    let truth = optics::internal_parameters(&preset("mini", &[]).camera);
    for file in ["precalibration.json", "params.js"] {
        let internal =
            plenocal::io::read_internal_parameters(&out.join(file), Some(0.0055)).unwrap();
        assert!((internal.m_mm / truth.m_mm - 1.0).abs() < INTERNAL, "{file}");
    }
    let plenocal::io::CameraSource::Datasheet(sheet) =
        plenocal::io::read_camera_source(&out.join("camera.js")).unwrap()
    else {
        panic!("camera.js is a datasheet");
    };
    assert_eq!((sheet.columns, sheet.rows, sheet.lens_types), (43, 37, 3));
    assert_eq!(sheet.configuration, Configuration::Galilean);
    for figure in ["radii.svg", "micro-images.svg"] {
        let text = fs::read_to_string(out.join(figure)).unwrap();
        assert!(text.contains("</svg>") && text.contains("<circle"), "{figure}");
    }
    let centers = plenocal::io::read_centers(&out.join("centers.csv")).unwrap();
    assert!(centers.len() > 1400);

    // A single image gives its array alone.
    run(&set.join("devignetting.png"), &folder.path().join("single"))
        .success()
        .stdout(contains("Lattice hexagonal-rows"));
    let single = folder.path().join("single/precalibration.json");
    let error = plenocal::io::read_internal_parameters(&single, None).unwrap_err().to_string();
    assert!(error.contains("has no internal parameters"), "{error}");
}

#[test]
fn bad_projects_and_images_are_refused_in_words() {
    let folder = TempDir::new().unwrap();
    let (set, out) = (folder.path().join("set"), folder.path().join("results"));
    simulate(&set, &["--set", "imaging.color=bayer-rggb"]);
    let project = set.join("project.toml");
    let text = fs::read_to_string(&project).unwrap();
    let with = |from: &str, to: &str| {
        assert!(text.contains(from), "{from}");
        let path = set.join("other.toml");
        fs::write(&path, text.replace(from, to)).unwrap();
        run(&path, &out)
    };
    with("bayer-rggb", "bayer-gbrg").stderr(contains("another mosaic is in it"));
    with("\"bayer-rggb\"", "\"grey\"").stderr(contains("alternate in brightness"));
    // A stop as it is engraved stands for its f-number.
    with("f_number = 8\n", "stop = 8\n").success().stderr("");
    with("f_number = 8\n", "stop = 5.6\n").success().stderr(contains("check its f-number"));
    with("f_number = 8\n", "f_number = 9\n").success().stderr(contains("check its f-number"));
    fs::remove_dir_all(&out).unwrap();
    with("\"bayer-rggb\"", "\"rgb\"").code(1).stderr(contains("has 1 channel(s)"));
    with("width_px = 1000", "width_px = 1001")
        .code(1)
        .stderr(contains("but the sensor 1001 x 750"));
    with("columns = 43", "columns = 50").code(1).stderr(contains("50 x 37 micro-lenses"));
    with("hexagonal-rows", "hexagonal-columns").code(1).stderr(contains("'hexagonal-columns'"));
    with("f_number = 8\n", "f_number = 8\nstop = 8\n").code(1).stderr(contains("and not both"));
    with("f_number = 8\n", "stop = -8\n").code(1).stderr(contains("a stop of -8"));
    with("[images]", "[pictures]").code(1).stderr(contains("other.toml"));
    with("devignetting.png", "gone.png").code(1).stderr(contains("gone.png"));
    let bytes = fs::read(set.join("devignetting.png")).unwrap();
    fs::write(set.join("devignetting.png"), &bytes[..bytes.len() / 2]).unwrap();
    run(&project, &out).code(1).stderr(contains("devignetting.png: this image cannot be read"));
    fs::write(set.join("devignetting.png"), "no image").unwrap();
    run(&set.join("devignetting.png"), &out).code(1).stderr(contains("cannot be read"));
    assert!(!out.exists());
}

#[test]
fn images_that_are_empty_or_of_other_samples_are_refused_by_name() {
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("results");
    for (name, text) in [("w0.pgm", "P5\n0 5\n255\n"), ("h0.pgm", "P5\n5 0\n255\n")] {
        fs::write(folder.path().join(name), text).unwrap();
        run(&folder.path().join(name), &out).code(1).stderr(contains(name));
    }
    let float = folder.path().join("float.tif");
    image::Rgb32FImage::new(8, 8).save(&float).unwrap();
    run(&float, &out)
        .code(1)
        .stderr(contains("float.tif").and(contains("whole numbers of 8 or 16 bits")));
    assert!(!out.exists());
}

#[test]
fn a_makers_calibration_gives_the_same_columns_with_nothing_measured() {
    let folder = TempDir::new().unwrap();
    let (xml, out) = (folder.path().join("maker.xml"), folder.path().join("results"));
    let types = ["0", "1", "-1"]
        .map(|x| format!("<lens_type><offset><x>{x}</x><y>0</y></offset></lens_type>"))
        .concat();
    let text = format!(
        "<RayCalibData><offset><x>0</x><y>0</y></offset><diameter>20</diameter>\
         <lens_base_x><x>1</x><y>0</y></lens_base_x>\
         <lens_base_y><x>-0.5</x><y>0.8660254</y></lens_base_y>{types}</RayCalibData>"
    );
    fs::write(&xml, text).unwrap();
    let sized = |size: &str| {
        let mut command = plenocal();
        command.arg("precalibrate").arg(&xml).args(["--size", size]).arg("--out").arg(&out).assert()
    };
    for size in ["4000000000x4000000000", "65536x100", "0x100", "100"] {
        sized(size).code(2).stderr(contains("each edge from 1 to 65535 px"));
    }
    sized("30x25").code(1).stderr(contains("maker.xml").and(contains("check --size")));
    sized("1x1").code(1).stderr(contains("maker.xml"));
    assert!(!out.exists());
    sized("600x500").success().stdout(contains("3 lens type(s)"));
    let centers = fs::read_to_string(out.join("centers.csv")).unwrap();
    assert!(centers.starts_with("k,l,u,v,std_dev,type\n"));
    assert!(centers.lines().skip(1).all(|line| line.contains(",,")), "{centers}");
    assert!(plenocal::io::read_centers(&out.join("centers.csv")).unwrap().len() > 800);
    let text = fs::read_to_string(out.join("precalibration.json")).unwrap();
    let document: serde_json::Value = serde_json::from_str(&text).unwrap();
    let types = serde_json::json!({ "count": 3, "separation": null, "agreement": null });
    assert_eq!(document["lens_types"], types);
}

#[test]
fn options_for_another_kind_of_input_are_refused() {
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("results");
    for (input, option, value) in [
        ("project.toml", "--size", "100x100"),
        ("white.png", "--size", "100x100"),
        ("white.png", "--estimator", "moments"),
        ("maker.xml", "--estimator", "profile"),
        ("maker.xml", "--color", "grey"),
        ("project.toml", "--color", "grey"),
    ] {
        let mut command = plenocal();
        command.args(["precalibrate", input, option, value, "--out"]).arg(&out);
        command.assert().code(1).stderr(contains(input).and(contains(option)));
    }
    assert!(!out.exists());
}

fn measured(name: &str) -> ArrayMeasurement {
    let folder = std::env::var_os("PLENOCAL_WHITES").expect("PLENOCAL_WHITES is set");
    let raw = read_image(&Path::new(&folder).join(name), None).unwrap();
    measure_array(&raw, None).unwrap()
}

#[test]
#[cfg_attr(not(plenocal_whites), ignore = "set PLENOCAL_WHITES to the folder of real white images")]
fn square_arrays_are_found() {
    let array = measured("thorlabs-square-white.png");
    assert_eq!(array.grid.lattice.kind(), LatticeKind::Orthogonal);
    assert!((array.grid.pitch_px - 48.0).abs() < 0.5, "{}", array.grid.pitch_px);
    assert!(array.grid.rms_px < 0.2 && array.centers.len() > 400);
    let array = measured("square-white2500.bmp");
    assert_eq!(array.grid.lattice.kind(), LatticeKind::Orthogonal);
    assert!(array.grid.rms_px < 0.5 && array.centers.len() > 1400);
}

/// The image has traces of the scene, which scatter single centres by a pixel.
#[test]
#[cfg_attr(not(plenocal_whites), ignore = "set PLENOCAL_WHITES to the folder of real white images")]
fn origami_agrees_with_its_maker() {
    let folder = std::env::var_os("PLENOCAL_WHITES").expect("PLENOCAL_WHITES is set");
    let maker = read_raytrix(&Path::new(&folder).join("origami.calib.xml")).unwrap();
    let array = measured("origami-pseudo-white.png");
    assert_eq!(array.grid.lattice.kind(), LatticeKind::HexagonalColumns);
    assert_eq!(maker.kind, LatticeKind::HexagonalColumns);
    assert_eq!(maker.lens_types, 3);
    let off = array.grid.pitch_px - maker.pitch_px;
    assert!(off.abs() < 0.02, "the pitch differs by {off} px");
    assert!((array.grid.rotation_rad - maker.rotation_rad).abs() < 5e-4);
    // Every centre lies near one of the maker's.
    let makers = maker.centers(2048, 2048).unwrap();
    let mut square = 0.0;
    for c in &array.centers {
        let off = |m: &MicroImageCenter| (m.u_px - c.u_px).hypot(m.v_px - c.v_px);
        square += makers.iter().map(off).fold(f64::MAX, f64::min).powi(2);
    }
    let rms = (square / array.centers.len() as f64).sqrt();
    assert!(rms < 1.5, "{rms} px");

    // The three types show in the sizes of the micro-images, and are the maker's.
    println!("{:?}", array.lens_types);
    assert_eq!(array.lens_types.types, 3);
    let mut counts = [[0; 3]; 3];
    for c in &array.centers {
        let ours = array.grid.lattice.lens_type(c.k, c.l, 3);
        let makers = maker.lens_type(2048, 2048, Vector2::new(c.u_px, c.v_px));
        counts[ours][makers] += 1;
    }
    for row in counts {
        let all: usize = row.iter().sum();
        assert!(row.iter().any(|&n| n * 100 > all * 98), "{counts:?}");
    }

    let folder_out = TempDir::new().unwrap();
    let xml = Path::new(&folder).join("origami.calib.xml");
    run(&xml, folder_out.path()).code(1).stderr(contains("give --size"));
    plenocal()
        .arg("precalibrate")
        .arg(&xml)
        .args(["--size", "2048x2048", "--out"])
        .arg(folder_out.path())
        .assert()
        .success()
        .stdout(contains("hexagonal-columns").and(contains("pitch 23.202")));
}
