//! Boards that were not taken, or not exported, as their white image was.

use plenocal::{Estimate, Finding, Issue};
use std::sync::LazyLock;

use plenocal::detection::{
    BoardImage, DepthEstimator, DetectedBoards, MicroImages, Search, detect,
};
use plenocal::image::{RawImage, Samples};
use plenocal::model::taken::APERTURE_RATIO;
use plenocal::model::{BapFeature, Subset};
use plenocal::precalibration::{
    PrecalibrationOptions, White, array_findings, measure_array, precalibrate,
};
use plenocal::simulation::{DataSet, Settings};

use crate::support::{codes, preset};

/// A small camera with its micro-images, a white image, and boards at two f-numbers.
struct Shoot {
    settings: Settings,
    micro_images: MicroImages,
    white: RawImage,
    board: RawImage,
    at_another_f_number: RawImage,
}

static SHOOT: LazyLock<Shoot> = LazyLock::new(|| {
    let board_of =
        |settings: &Settings, plan: &DataSet| plan.subsets[0][0].1.take(settings, &|| ()).unwrap();
    let settings = preset("mini", &["seed=31"]);
    let plan = DataSet::plan(&settings, None).unwrap();
    let white = |shot: &plenocal::simulation::Shot| White {
        name: "white".to_owned(),
        f_number: shot.f_number,
        image: shot.take(&settings, &|| ()).unwrap(),
    };
    let whites: Vec<White> = plan.whites.iter().map(white).collect();
    let reference = white(&plan.devignetting);
    let sheet = settings.datasheet();
    let options = PrecalibrationOptions::of_datasheet(&sheet);
    let measured = precalibrate(&whites, Some(&reference), &options, &|| ()).unwrap();
    let other = preset("mini", &["seed=31", "camera.main_lens.f_number=4.3"]);
    Shoot {
        micro_images: MicroImages::of_precalibration(&measured, &sheet).unwrap(),
        white: reference.image,
        board: board_of(&settings, &plan),
        at_another_f_number: board_of(&other, &DataSet::plan(&other, None).unwrap()),
        settings,
    }
});

/// Findings about the light of a board.
fn said_of(image: &RawImage) -> Vec<Issue> {
    let found = found_in(image, &SHOOT.white);
    let of_light = |f: &Finding| f.code().starts_with("other-") || f.code() == "unlike-white";
    found.findings.into_iter().filter(of_light).map(|finding| finding.issue).collect()
}

fn found_in(image: &RawImage, white: &RawImage) -> DetectedBoards {
    found_with(&SHOOT.micro_images, image, white)
}

fn found_with(micro_images: &MicroImages, image: &RawImage, white: &RawImage) -> DetectedBoards {
    let settings = &SHOOT.settings;
    let (board, sheet) = (settings.target.board(), settings.datasheet());
    let estimator = DepthEstimator::Line;
    let search = Search { micro_images, board: &board, sensor: &sheet.sensor, estimator };
    let boards = [BoardImage::new(0, "board", image)];
    detect(&boards, white, &search, Subset::Evaluation, &|_, _| Ok(())).unwrap()
}

/// The board with other samples, from those of its pixel and of the one before.
fn changed(change: impl Fn(f64, f64) -> f64) -> RawImage {
    changed_from(&SHOOT.board, change)
}

fn changed_from(image: &RawImage, change: impl Fn(f64, f64) -> f64) -> RawImage {
    let Samples::Bits8(samples) = &image.samples else { panic!("mini has 8 bits") };
    let before = std::iter::once(&samples[0]).chain(samples);
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // clamped
    let samples = samples
        .iter()
        .zip(before)
        .map(|(&x, &before)| change(x.into(), before.into()).round().clamp(0.0, 255.0) as u8)
        .collect();
    RawImage { samples: Samples::Bits8(samples), ..image.clone() }
}

/// The one finding about the light of a board.
fn only_issue(image: &RawImage) -> Issue {
    let [issue] = &said_of(image)[..] else { panic!("{:?}", said_of(image)) };
    issue.clone()
}

#[test]
fn a_board_that_was_taken_as_the_white_image_is_like_it() {
    let said = said_of(&SHOOT.board);
    assert!(said.is_empty(), "{said:?}");
}

#[test]
fn another_black_level_is_named() {
    for (image, higher) in
        [(changed(|x, _| 16.0 + x * 239.0 / 255.0), true), (changed(|x, _| x - 12.0), false)]
    {
        let issue = only_issue(&image);
        let Issue::OtherBlackLevel { difference } = issue else { panic!("{issue}") };
        assert_eq!(difference > 0.0, higher, "{difference}");
    }
}

#[test]
fn a_gamma_is_named() {
    let power = |power: f64| changed(move |x, _| 255.0 * (x / 255.0).powf(power));
    for (stated, near) in [(1.25, 1.25), (0.83, 0.85)] {
        let issue = only_issue(&power(stated));
        let Issue::OtherToneCurve { power } = issue else { panic!("{issue}") };
        assert!((power - near).abs() < 0.05, "{power}");
    }
}

#[test]
fn a_shift_is_named_with_its_size() {
    // One board alone has few micro-images that a single square fills, and some have too few to say anything.
    let Shoot { settings, micro_images, white, .. } = &*SHOOT;
    let plan = DataSet::plan(settings, None).unwrap();
    let mut shifts: Vec<f64> = plan.subsets[0]
        .iter()
        .filter_map(|(_, shot)| {
            let board = shot.take(settings, &|| ()).unwrap();
            let image = changed_from(&board, |x, before| 0.7 * x + 0.3 * before);
            let found = found_with(micro_images, &image, white).findings;
            found.iter().find_map(|finding| match finding.issue {
                Issue::OtherOrigin { shift_px } => Some(shift_px[0]),
                _ => None,
            })
        })
        .collect();
    shifts.sort_by(f64::total_cmp);
    let median = shifts[shifts.len() / 2];
    assert!(shifts.len() > 5 && (median - 0.30).abs() < 0.01, "{shifts:?}");
}

/// 4.3/4 = 1.075.
#[test]
fn another_f_number_is_named() {
    let issue = only_issue(&SHOOT.at_another_f_number);
    let Issue::OtherAperture { ratio } = issue else { panic!("{issue}") };
    assert!((ratio - 1.075).abs() < 0.01, "{ratio}");
}

/// Another black level is not reported of a white image among the boards.
#[test]
fn a_white_image_is_no_board() {
    let Samples::Bits8(samples) = &SHOOT.white.samples else { panic!("mini has 8 bits") };
    let samples = Samples::Bits8(samples.iter().map(|x| x / 2 + 20).collect());
    let found = found_in(&RawImage { samples, ..SHOOT.white.clone() }, &SHOOT.white);
    assert_eq!(codes(&found.findings), ["uniform"]);
}

/// Features are moved to the aperture ratio of all boards by their derivatives, over changes of up to 2.5 %: to a tenth of
/// their noise.
#[test]
fn positions_follow_the_aperture_ratio_by_their_derivatives() {
    const CHANGE: f64 = 0.025;
    let features = |change: f64| {
        let ratio = Estimate::new(0.95 * change.exp(), 1e-3);
        let found = found_with(&SHOOT.micro_images.settled_at(&ratio), &SHOOT.board, &SHOOT.white);
        found.frames.into_iter().next().unwrap().result.unwrap().features
    };
    let (before, after) = (features(0.0), features(CHANGE));
    let (mut moved, mut left, mut count) = (0.0, 0.0, 0.0);
    for a in &before {
        let same = |b: &&BapFeature| (b.corner, b.k, b.l) == (a.corner, a.k, a.l);
        let Some(b) = after.iter().find(same) else { continue };
        let derivatives = a.sensitivities_px.unwrap()[APERTURE_RATIO];
        let change = [b.u_px - a.u_px, b.v_px - a.v_px];
        for axis in 0..2 {
            moved += change[axis].powi(2);
            left += (change[axis] - derivatives[axis] * CHANGE).powi(2);
            count += 1.0;
        }
    }
    let [moved, left] = [moved, left].map(|squares: f64| (squares / count).sqrt());
    assert!(moved > 0.01 && left < 0.007, "{left} px of {moved} px are left");
}

#[test]
fn a_board_is_no_white_image() {
    let doubts = |image: &RawImage| array_findings(&measure_array(image, None).unwrap(), image);
    assert_eq!(doubts(&SHOOT.white), []);
    assert_eq!(codes(&doubts(&SHOOT.board))[..2], ["not-white", "irregular-array"]);
}

/// Every hundredth column left out: pixels that are 1 % wider than high.
#[test]
fn pixels_that_are_not_square_are_named() {
    let white = &SHOOT.white;
    let Samples::Bits8(samples) = &white.samples else { panic!("mini has 8 bits") };
    let kept = |&(i, _): &(usize, &u8)| i % white.width % 100 != 50;
    let samples: Vec<u8> = samples.iter().enumerate().filter(kept).map(|(_, &x)| x).collect();
    let narrow = RawImage {
        width: samples.len() / white.height,
        samples: Samples::Bits8(samples),
        ..white.clone()
    };
    let doubts = array_findings(&measure_array(&narrow, None).unwrap(), &narrow);
    assert!(codes(&doubts).contains(&"stretched-array"), "{doubts:?}");
}

/// Relative to the white image the covered part is many times as bright as the rest of the board.
#[test]
fn a_covered_part_of_the_white_image_does_not_hide_the_board() {
    let white = &SHOOT.white;
    let Samples::Bits8(samples) = &white.samples else { panic!("mini has 8 bits") };
    let mut samples = samples.clone();
    for row in samples.chunks_mut(white.width).take(200) {
        row[..250].fill(3);
    }
    let covered = RawImage { samples: Samples::Bits8(samples), ..white.clone() };
    let features = |white: &RawImage| found_in(&SHOOT.board, white).features().len();
    let (of_covered, of_all) = (features(&covered), features(white));
    assert!(of_covered as f64 > 0.8 * of_all as f64, "{of_covered} of {of_all} features");
}
