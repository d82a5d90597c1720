//! Tests with features of known blur.

use nalgebra::Vector2;

use super::*;
use crate::finding::Issue;
use crate::model::small_camera;
use crate::model::taken::APERTURE_RATIO;
use crate::model::{Configuration, Datasheet, LatticeKind, MeasuredBlur, TAKEN};
use crate::quantity::Estimate;

const TRUE_RATIO: f64 = 0.92;
/// Aperture ratio with which the features were found.
const FOUND_WITH: f64 = 0.95;
const PITCH_MM: f64 = 0.128;
const Q_PRIME_MM: [f64; 3] = [0.035, 0.041, 0.038];

/// Returns internal parameters as white images show them, for micro-lenses with the true aperture ratio.
fn start() -> Start {
    let camera = small_camera();
    let datasheet = Datasheet {
        sensor: camera.sensor,
        focal_length_mm: 16.0,
        focus_distance_mm: 120.0,
        f_number: 4.0,
        configuration: Configuration::Galilean,
        lattice_kind: LatticeKind::HexagonalRows,
        array_size: Some((camera.lattice.columns, camera.lattice.rows)),
        lens_types: 3,
        micro_image_pitch_px: None,
        opening: None,
    };
    let half_mm = PITCH_MM / 2.0;
    let internal = InternalParameters {
        q_prime_mm: Q_PRIME_MM.map(|q| half_mm + TRUE_RATIO * (q - half_mm)).to_vec(),
        q_prime_std_dev_mm: vec![1e-6; 3],
        micro_image_pitch_mm: Some(PITCH_MM),
        ..optics::internal_parameters(&camera)
    };
    Start::Datasheet(datasheet, internal)
}

fn grid() -> MicroImageArray {
    MicroImageArray {
        lattice: small_camera().lattice,
        pitch_px: 23.0,
        rotation_rad: 0.0,
        center_px: Vector2::new(500.0, 370.0),
        perspective_per_px: Vector2::zeros(),
        rms_px: 0.0,
        outliers: 0,
    }
}

/// Returns features of frames whose aperture ratios scatter by `scatter`, with one outlier per frame. Features of the
/// last lens type have the blur of an aperture ratio that is larger by `other`.
fn features(scatter: f64, other: f64) -> Vec<BapFeature> {
    let (half_pitch, pixel) = (PITCH_MM / 0.0055 / 2.0, 0.0055);
    let mut features = Vec::new();
    for frame in 0..8 {
        let of_frame = TRUE_RATIO + scatter * f64::from(frame % 2 * 2 - 1);
        for i in 0..60 {
            let (k, l) = (i % 10, i / 10);
            let lens_type = grid().lattice.lens_type(k, l, 3);
            let q = Q_PRIME_MM[lens_type] / pixel - half_pitch;
            let growth = 1.5 + 0.3 * f64::from(frame) + 0.1 * f64::from(i % 7);
            let ratio = of_frame + if lens_type == 2 { other } else { 0.0 };
            let noise = 0.05 * (f64::from(i * 7 % 11) / 5.0 - 1.0);
            let blur = TRUE_RATIO * q + ratio * growth + noise + f64::from(i / 59) * 9.0;
            let mut sensitivities_px = [[0.0; 2]; TAKEN];
            sensitivities_px[APERTURE_RATIO] = [2.0, -1.0];
            features.push(BapFeature {
                frame: frame.try_into().unwrap(),
                corner: i,
                k,
                l,
                u_px: 10.0,
                v_px: 20.0,
                rho_px: Some(q * TRUE_RATIO / FOUND_WITH + growth),
                std_dev_px: Some([0.03; 2]),
                rho_std_dev_px: Some(0.01),
                correlation: 0.0,
                sensitivities_px: Some(sensitivities_px),
                blur: Some(MeasuredBlur {
                    radius_px: blur,
                    std_dev_px: 0.04,
                    shared_px: 0.0,
                    aperture_ratio: FOUND_WITH,
                }),
            });
        }
    }
    features
}

fn measured(features: &[BapFeature]) -> BlurMeasurement {
    BlurMeasurement::of(&start(), Some(&grid()), features).unwrap().unwrap()
}

/// One σ of the excess edge variance changes all blur alike, and no scatter shows that.
#[test]
fn what_all_features_share_is_in_the_aperture_ratio() {
    let mut features = features(0.0, 0.0);
    let alone = measured(&features).aperture_ratio;
    // Equivalent to an aperture ratio that is larger by 0.01.
    for f in &mut features {
        let blur = f.blur.as_mut().unwrap();
        let growth = f.rho_px.unwrap() - Q_PRIME_MM[grid().lattice.lens_type(f.k, f.l, 3)] / 0.0055;
        blur.shared_px = 0.01 * (growth + PITCH_MM / 0.0055 / 2.0);
    }
    let shared = measured(&features).aperture_ratio;
    assert!((shared.value - alone.value).abs() < 1e-12);
    let added = (shared.std_dev.powi(2) - alone.std_dev.powi(2)).sqrt();
    assert!((added - 0.01).abs() < 2e-3, "{added}");
}

#[test]
fn blur_tells_the_aperture_ratio_and_that_tells_the_true_intercepts() {
    let measured = measured(&features(0.0, 0.0));
    let Estimate { value, std_dev } = measured.aperture_ratio;
    assert!((value - TRUE_RATIO).abs() < 2.0 * std_dev, "{measured:?}");
    assert!((0.0018..0.003).contains(&std_dev), "{measured:?}");
    assert!(measured.contradiction().is_none());
    for of_type in measured.types.iter().flatten() {
        let Estimate { value: excess, std_dev } = of_type.excess_px;
        assert!(excess.abs() < 3.0 * std_dev, "{of_type:?}");
    }
    let counts = measured.types.iter().flatten().map(|of_type| of_type.features);
    assert_eq!(counts.sum::<usize>(), 480);
    let Start::Datasheet(_, internal) =
        with_aperture_ratio(start(), Some(&grid()), Some(&measured))
    else {
        unreachable!()
    };
    for (found, truth) in internal.q_prime_mm.iter().zip(Q_PRIME_MM) {
        assert!((found / truth - 1.0).abs() < 2e-3, "{found} for {truth}");
    }
}

/// Openings end where their neighbours begin.
#[test]
fn no_more_than_full_openings_are_taken() {
    for (value, taken) in [(0.92, 0.92), (1.0, 1.0), (1.01, 1.0)] {
        let aperture_ratio = Estimate { value, std_dev: 0.006 };
        let measured = BlurMeasurement { aperture_ratio, types: Vec::new() };
        assert_eq!(
            at_most_full(&measured.aperture_ratio),
            Estimate { value: taken, std_dev: 0.006 }
        );
    }
}

#[test]
fn the_scatter_of_frames_is_in_its_uncertainty() {
    let [alike, scattered] = [0.0, 0.02].map(|s| measured(&features(s, 0.0)).aperture_ratio);
    // Eight frames are at ± 0.02.
    assert!((scattered.std_dev - 0.02 / 7.0_f64.sqrt()).abs() < 1e-3, "{scattered:?}");
    assert!(scattered.std_dev > 2.5 * alike.std_dev, "{alike:?}");
}

#[test]
fn uncertain_white_images_are_in_its_uncertainty() {
    let Start::Datasheet(sheet, mut internal) = start() else { unreachable!() };
    internal.q_prime_std_dev_mm = vec![1e-3; 3];
    let start = Start::Datasheet(sheet, internal);
    let features = features(0.0, 0.0);
    let found = BlurMeasurement::of(&start, Some(&grid()), &features).unwrap().unwrap();
    // 0.18 px over 2 to 4 px, for three types.
    assert!((0.02..0.06).contains(&found.aperture_ratio.std_dev), "{found:?}");
}

#[test]
fn lens_types_that_disagree_are_named() {
    assert!(measured(&features(0.0, 0.004)).contradiction().is_none());
    let finding = measured(&features(0.0, 0.05)).contradiction().unwrap();
    let Issue::ApertureRatiosDiffer { lens_types: [larger, _], estimated: [a, b] } = finding.issue
    else {
        panic!("{finding}")
    };
    assert_eq!(larger, 3);
    assert!((a.value - b.value - 0.05).abs() < 0.01, "{a:?} {b:?}");
}

#[test]
fn features_go_with_the_aperture_ratio_of_the_start() {
    let ratio = BlurMeasurement {
        aperture_ratio: Estimate { value: TRUE_RATIO, std_dev: 0.002 },
        types: Vec::new(),
    };
    let start = with_aperture_ratio(start(), Some(&grid()), Some(&ratio));
    let lattice = grid().lattice;
    let found = features(0.0, 0.0);
    let restated = with_that_of_start(found.clone(), &start, &lattice);
    let change = (TRUE_RATIO / FOUND_WITH).ln();
    for (of, was) in restated.iter().zip(&found) {
        let lens_type = lattice.lens_type(of.k, of.l, 3);
        let q = (Q_PRIME_MM[lens_type] - PITCH_MM / 2.0) / 0.0055;
        let growth = was.rho_px.unwrap() - q * TRUE_RATIO / FOUND_WITH;
        assert!((of.rho_px.unwrap() - q - growth).abs() < 1e-9, "{of:?}");
        assert!((of.u_px - was.u_px - 2.0 * change).abs() < 1e-12);
        assert!((of.v_px - was.v_px + change).abs() < 1e-12);
    }
    // A second conversion changes nothing.
    assert_eq!(with_that_of_start(restated.clone(), &start, &lattice), restated);
}

#[test]
fn without_measured_blur_nothing_is_said() {
    let mut features = features(0.0, 0.0);
    for feature in &mut features {
        feature.blur = None;
    }
    assert_eq!(BlurMeasurement::of(&start(), Some(&grid()), &features).unwrap(), None);
}

#[test]
fn blur_of_another_camera_is_an_error() {
    let mut features = features(0.0, 0.0);
    for feature in &mut features {
        feature.blur.as_mut().unwrap().radius_px += 5.0;
    }
    let error = BlurMeasurement::of(&start(), Some(&grid()), &features).unwrap_err();
    assert!(error.to_string().contains("std_blur"), "{error}");
}
