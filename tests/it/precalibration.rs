//! From simulated white images to the internal parameters.

use plenocal::{Issue, Subject};
use std::collections::HashMap;
use std::sync::LazyLock;

use nalgebra::Vector2;
use plenocal::image::{RawImage, Samples};
use plenocal::model::{Configuration, Datasheet, LatticeKind, MicroImageCenter, optics};
use plenocal::precalibration::{
    ArrayMeasurement, Precalibration, PrecalibrationOptions, RadiusEstimator, White, fit_grid,
    precalibrate,
};
use plenocal::simulation::{DataSet, Settings, Shot};

use crate::support::{codes, preset};

/// Limits for the pre-calibration: centres, px RMS; pitch, relative; rotation, rad; m and q',
/// relative.
const CENTERS_PX: f64 = 0.05;
const PITCH: f64 = 1e-5;
const ROTATION: f64 = 1e-5;
const INTERNAL: f64 = 0.01;
/// Limit in Keplerian configuration. Rays meet the sensor at angles up to 20 degrees larger, and the
/// light lost at the edge looks like a smaller radius.
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

/// Errors of the measured centres, and of pitch and rotation against the grid of the true centres.
pub fn compare(settings: &Settings, array: &ArrayMeasurement) -> (f64, f64, f64) {
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
    // The standard deviation of a centre follows from the asymmetry about it; sampling by pixels and
    // residual vignetting add to the error.
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
    assert_eq!(codes(&result.findings), [""; 0]);
    assert_right("r12-a", &settings, &result);
}

/// With a reference and without, when the white image at the widest aperture is used.
fn assert_measured(name: &str, replaced: &[&str]) {
    let settings = preset(name, replaced);
    let (whites, reference) = taken(&settings);
    let result = precalibrate(&whites, Some(&reference), &options(&settings), &|| ()).unwrap();
    assert_right(&format!("{name} {replaced:?}"), &settings, &result);
    let result = precalibrate(&whites, None, &options(&settings), &|| ()).unwrap();
    assert!(compare(&settings, &result.array).0 < CENTERS_PX);
}

#[test]
fn a_camera_is_measured_from_noisy_white_images() {
    assert_measured("mini", &["white_images.gain=4"]);
}

#[test]
fn a_camera_is_measured_from_a_colour_mosaic() {
    assert_measured("mini", &["imaging.color=bayer-gbrg", "imaging.bits=16"]);
}

#[test]
fn a_camera_is_measured_from_dark_colour_images() {
    assert_measured("mini", &["imaging.color=rgb", "white_images.exposure=0.4"]);
}

#[test]
fn a_keplerian_camera_is_measured_from_its_white_images() {
    assert_measured("keplerian", &[]);
}

/// A small camera and its white images at f/4, f/8 and f/16.
struct Small {
    settings: Settings,
    whites: [White; 3],
}

static SMALL: LazyLock<Small> = LazyLock::new(|| {
    let settings = preset("mini", &["rays=8", "white_images.f_numbers=[4.0, 8.0, 16.0]"]);
    let whites = taken(&settings).0.try_into().expect("there are three");
    Small { settings, whites }
});

impl Small {
    /// The white images with other stated f-numbers.
    fn at(&self, f_numbers: [f64; 3]) -> [White; 3] {
        std::array::from_fn(|i| White { f_number: f_numbers[i], ..self.whites[i].clone() })
    }

    fn precalibrate(&self, whites: &[White]) -> plenocal::Result<Precalibration> {
        precalibrate(whites, None, &options(&self.settings), &|| ())
    }

    fn is_rejected(&self, whites: &[White], words: &str) {
        let error = self.precalibrate(whites).unwrap_err().to_string();
        assert!(error.contains(words), "{error}");
    }
}

/// A double Gauss obeys Abbe's sine condition: straight lines in 1/N are wrong by 0.9 % in m and by
/// 0.023 px in q'.
#[test]
fn a_traced_lens_is_measured_from_its_white_images() {
    let replaced =
        ["rays=24", "white_images.f_numbers=[4.0, 5.657, 8.0, 11.314]"].map(str::to_owned);
    let settings = Settings::preset("mini-double-gauss", &replaced).unwrap();
    let plan = DataSet::plan(&settings, None).unwrap();
    let whites: Vec<White> = plan.whites.iter().map(|shot| white(&settings, shot)).collect();
    let found = precalibrate(&whites, None, &options(&settings), &|| ()).unwrap();
    let (found, truth) = (found.internal.parameters, optics::internal_parameters(&settings.camera));
    let of_m = found.m_mm / truth.m_mm - 1.0;
    println!("m {of_m:+.2e}");
    assert!(of_m.abs() < 4e-3, "{of_m}");
    let errors = found.q_prime_mm.iter().zip(&truth.q_prime_mm).zip(&found.q_prime_std_dev_mm);
    for ((q, truth), std_dev) in errors {
        let error_px = (q - truth) / settings.camera.sensor.pixel_size_mm;
        println!("q' {error_px:+.4} px, {:+.1} sigma", (q - truth) / std_dev);
        assert!(error_px.abs() < 0.008 && (q - truth).abs() < 3.0 * std_dev, "{error_px} px");
    }
    // With the pupil taken for in the lens the perspective is 12 % off.
    let (tilt_gradient, truth_per_mm) =
        (found.tilt_gradient.unwrap(), optics::tilt_gradient_per_mm(&settings.camera));
    for axis in 0..2 {
        let truth = truth_per_mm[axis] * settings.camera.sensor.pixel_size_mm;
        let error = tilt_gradient.growth_per_px[axis] - truth;
        println!(
            "tilt gradient {:+.2} %, {:+.1} sigma",
            100.0 * error / truth,
            error / tilt_gradient.std_dev_per_px[axis]
        );
        assert!(error.abs() < 0.08 * truth.abs(), "{tilt_gradient:?}, {truth}");
        assert!(
            error.abs() < 3.0 * tilt_gradient.std_dev_per_px[axis],
            "{tilt_gradient:?}, {truth}"
        );
    }
    // Boards are seen through the pupil as it is, 0.057 px larger at f/4 (by an independent trace).
    let pupil = found.pupil_radius_mm(4.0) / (truth.m_mm / 4.0) - 1.0;
    assert!((pupil - 0.0085).abs() < 3e-3, "{pupil}");
}

/// The pupil is a cat's eye towards the border.
#[test]
fn a_second_stop_gives_a_warning() {
    let stop = "imperfections.second_stop={z_mm=-9, diameter_mm=4}";
    let settings = preset("mini", &["rays=8", "white_images.f_numbers=[4.0, 8.0, 16.0]", stop]);
    let found = precalibrate(&taken(&settings).0, None, &options(&settings), &|| ()).unwrap();
    let told = |found: &Precalibration| codes(&found.findings).contains(&"oblique-pupil");
    assert!(told(&found), "{:?}", found.findings);
    let small = &*SMALL;
    assert!(!told(&small.precalibrate(&small.whites).unwrap()));
}

#[test]
fn fewer_than_two_f_numbers_are_rejected() {
    let small = &*SMALL;
    small.is_rejected(&[], "0 f-numbers");
    small.is_rejected(&small.whites[..1], "1 f-number,");
    small.is_rejected(&small.at([4.0, 4.0, 16.0])[..2], "1 f-number,");
}

#[test]
fn f_numbers_that_are_wrong_are_rejected() {
    let small = &*SMALL;
    small.is_rejected(&small.at([4.0, -8.0, 16.0])[..2], "the f-number of f/8.00 is -8");
    let [first, _, last] = small.at([16.0, 8.0, 4.0]);
    small.is_rejected(
        &[first, last],
        "the radii of micro-images do not increase with decreasing f-number",
    );
}

#[test]
fn white_images_of_another_camera_are_rejected() {
    let small = &*SMALL;
    let [first, second, _] = small.whites.clone();
    let image = RawImage {
        width: 10,
        height: 10,
        samples: Samples::Bits8(vec![0; 100]),
        ..second.image.clone()
    };
    let tiny = White { image, ..second };
    small.is_rejected(&[first.clone(), tiny], "give white images of one camera");
    let other = preset("mini", &["rays=8", "camera.micro_lens_array.pitch_mm=0.12"]);
    let shot = DataSet::plan(&other, None).unwrap().whites[2];
    small.is_rejected(&[first, white(&other, &shot)], "they are of different cameras");
}

#[test]
fn a_white_image_that_is_black_is_rejected() {
    let small = &*SMALL;
    let [first, second, _] = small.whites.clone();
    let samples = Samples::Bits8(vec![0; 750_000]);
    let black = White { image: RawImage { samples, ..second.image.clone() }, ..second };
    small.is_rejected(
        &[first, black],
        "f/8.00: no micro-images were found at the positions known from f/4.00",
    );
}

#[test]
fn a_stated_size_that_is_not_visible_is_rejected() {
    let Small { settings, whites } = &*SMALL;
    let stated = PrecalibrationOptions { array_size: Some((40, 37)), ..options(settings) };
    let error = precalibrate(whites, None, &stated, &|| ()).unwrap_err().to_string();
    assert!(error.contains("stated to have 40 x 37 micro-lenses"), "{error}");
}

#[test]
fn an_array_may_go_on_beyond_the_sensor_or_be_of_unknown_size() {
    let Small { settings, whites } = &*SMALL;
    let measured = |array_size| {
        let options = PrecalibrationOptions { array_size, ..options(settings) };
        precalibrate(whites, None, &options, &|| ()).unwrap()
    };
    let (larger, unknown) = (measured(Some((60, 51))), measured(None));
    let lattice = |p: &Precalibration| (p.array.grid.lattice.columns, p.array.grid.lattice.rows);
    assert_eq!((lattice(&larger), lattice(&unknown)), ((60, 51), (43, 37)));
    let (a, b) = (&larger.internal.parameters, &unknown.internal.parameters);
    assert!((a.m_mm / b.m_mm - 1.0).abs() < 1e-6, "{} {}", a.m_mm, b.m_mm);
    // The middle of the larger array is where that of the visible one is, to half a micro-image.
    let apart = larger.array.grid.center_px - unknown.array.grid.center_px;
    assert!(apart.norm() < 0.75 * unknown.array.grid.pitch_px, "{apart}");
}

/// The result is that of the other four.
#[test]
fn a_white_image_at_another_f_number_than_stated_is_left_out() {
    let settings = preset("mini", &["rays=8"]);
    let (mut whites, _) = taken(&settings);
    whites.iter_mut().zip(1..).for_each(|(white, i)| white.name = format!("white {i}"));
    let of = |whites: &[White]| precalibrate(whites, None, &options(&settings), &|| ()).unwrap();
    let mut others = whites.clone();
    others.remove(2);
    whites[2].f_number = 11.31;
    let (found, expected) = (of(&whites), of(&others));
    assert_eq!(found.findings[0].subject, Subject::Image("white 3".to_owned()));
    let Issue::FNumberLeftOut { looks_like, .. } = found.findings[0].issue else {
        panic!("{}", found.findings[0])
    };
    assert!((looks_like - 8.0).abs() < 0.1, "{looks_like}");
    assert_eq!(found.internal, expected.internal);
    assert_eq!(found.images, ["white 1", "white 2", "white 4", "white 5"]);
}

/// Micro-images of `mini` overlap by 15 % at f/3.2. Such a white image is distinguished from one with a wrong f-number. It is used
/// neither for m and q' nor as the reference for the array and the angular response.
#[test]
fn overlapping_micro_images_are_no_wrong_f_number() {
    let settings = preset("mini", &["rays=8", "white_images.f_numbers=[3.2, 4.5, 6.4, 9.0, 12.8]"]);
    let (mut whites, _) = taken(&settings);
    whites.iter_mut().zip(1..).for_each(|(white, i)| white.name = format!("white {i}"));
    let of = |whites: &[White], reference: Option<&White>| {
        precalibrate(whites, reference, &options(&settings), &|| ()).unwrap()
    };
    let (others, widest) = (&whites[1..], &whites[0]);
    let (found, expected) = (of(&whites, None), of(others, None));
    assert_eq!(codes(&found.findings), ["overlapping-white-image", "micro-images-overlap"]);
    let of_reference = of(others, Some(widest));
    assert_eq!(codes(&of_reference.findings), ["micro-images-overlap"]);
    for found in [&found, &of_reference] {
        let Issue::MicroImagesOverlap { apart, part, .. } = found.findings.last().unwrap().issue
        else {
            panic!("{}", found.findings[0])
        };
        assert!((apart - 3.87).abs() < 0.05 && (part - 0.15).abs() < 0.03, "{apart} {part}");
        assert_eq!((&found.internal, &found.array), (&expected.internal, &expected.array));
    }
    // Two that overlap.
    let stated = ["rays=8", "white_images.f_numbers=[3.1, 3.4, 4.5, 6.4, 9.0, 12.8]"];
    let (two, _) = taken(&preset("mini", &stated));
    let found = precalibrate(&two, None, &options(&settings), &|| ()).unwrap();
    let expected = ["overlapping-white-image", "overlapping-white-image", "micro-images-overlap"];
    assert_eq!(codes(&found.findings), expected);
    // All overlap.
    let stated = ["rays=8", "white_images.f_numbers=[2.8, 3.0, 3.2]"];
    let (all, _) = taken(&preset("mini", &stated));
    let error = precalibrate(&all, None, &options(&settings), &|| ()).unwrap_err().to_string();
    assert!(error.contains("that micro-images do not overlap"), "{error}");
    // Taken at f/4.5 and not at the stated f/3.2.
    let mut wrong = whites[1].clone();
    wrong.f_number = 3.2;
    wrong.name = "wrong".to_owned();
    assert_eq!(codes(&of(others, Some(&wrong)).findings), ["aperture-contradicted"]);
}

#[test]
fn swapped_f_numbers_are_named() {
    let small = &*SMALL;
    small.is_rejected(&small.at([8.0, 4.0, 16.0]), "f/4.00 f/4.00 and not f/8.00");
    let settings = preset("mini", &["rays=8"]);
    let (mut whites, _) = taken(&settings);
    let stated: Vec<f64> = whites.iter().map(|white| white.f_number).collect();
    whites.iter_mut().zip(stated.iter().rev()).for_each(|(white, n)| white.f_number = *n);
    let error = precalibrate(&whites, None, &options(&settings), &|| ()).unwrap_err().to_string();
    assert!(error.contains("are swapped") && error.contains("f/16.00 and not f/4.00"), "{error}");
}

#[test]
fn one_wrong_f_number_among_three_gives_a_warning() {
    let small = &*SMALL;
    let result = small.precalibrate(&small.at([4.0, 5.66, 16.0])).unwrap();
    assert_eq!(codes(&result.findings), ["f-number-contradicted"]);
}

#[test]
fn a_datasheet_that_contradicts_the_images_is_rejected() {
    let small = &*SMALL;
    let result = small.precalibrate(&small.whites).unwrap();
    let sheet = || small.settings.datasheet();
    result.check_stated(&sheet()).unwrap();
    let rejected = |sheet: &Datasheet| result.check_stated(sheet).unwrap_err().to_string();
    let orthogonal = Datasheet { lattice_kind: LatticeKind::Orthogonal, ..sheet() };
    assert!(rejected(&orthogonal).contains("'orthogonal'"));
    let pitch = Datasheet { micro_image_pitch_px: Some(23.5), ..sheet() };
    assert!(rejected(&pitch).contains("23.5000 px"));
    for (types, fits) in [(0, true), (1, false), (3, true)] {
        let sheet = Datasheet { lens_types: types, ..sheet() };
        assert_eq!(result.check_stated(&sheet).is_ok(), fits, "{types} lens types stated");
    }
}

/// The paper's estimator is known to give too small values on linear images.
#[test]
fn the_second_moments_of_the_paper_are_too_small_on_linear_images() {
    let settings = preset("mini", &["rays=16", "white_images.f_numbers=[4.0, 8.0, 16.0]"]);
    let (whites, _) = taken(&settings);
    let moments =
        PrecalibrationOptions { estimator: RadiusEstimator::Moments, ..options(&settings) };
    let result = precalibrate(&whites, None, &moments, &|| ()).unwrap();
    let truth = optics::internal_parameters(&settings.camera);
    let part = result.internal.parameters.m_mm / truth.m_mm;
    assert!((0.7..0.8).contains(&part), "second moments of linear images give {part} of m");
}

/// Discs that no f-numbers have are not believed: here the f-numbers are wrong. Straight lines are left, whose σ holds that.
#[test]
fn straight_lines_are_left_where_discs_are_not_believed() {
    let settings = preset("mini", &["rays=32", "seed=43"]);
    let (mut whites, reference) = taken(&settings);
    let of = |whites: &[White]| {
        let options = PrecalibrationOptions { stated: None, ..options(&settings) };
        precalibrate(whites, Some(&reference), &options, &|| ()).unwrap().internal.parameters
    };
    let by_discs = of(&whites);
    for (white, part) in whites.iter_mut().zip([1.1, 0.9, 1.1, 0.9, 1.1]) {
        white.f_number *= part;
    }
    let by_lines = of(&whites);
    assert!(by_discs.point_spread_px2.is_some() && by_lines.point_spread_px2.is_none());
    let truth = optics::internal_parameters(&settings.camera).q_prime_mm;
    for (i, truth) in truth.iter().enumerate() {
        let [q, std_dev] = [by_lines.q_prime_mm[i], by_lines.q_prime_std_dev_mm[i]];
        assert!(
            std_dev > 0.02 * q && (q - truth).abs() < 3.0 * std_dev,
            "{q} ± {std_dev}, {truth}"
        );
    }
}
