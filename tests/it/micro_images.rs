//! The array of micro-images in a single white image, simulated, drawn and real.

use nalgebra::Vector2;
use plenocal::image::{Color, RawImage, Samples};
use plenocal::model::{Lattice, LatticeKind, MicroImageCenter, Packing, Parity};
use plenocal::precalibration::{MicroImageArray, measure_array};
use plenocal::simulation::{DataSet, Settings, Shot};

use crate::precalibration::compare;
use crate::support::preset;

/// A small camera's white image at f/8.
fn small_white(replaced: &[&str]) -> (Settings, RawImage) {
    let settings = preset("mini", replaced);
    let shot = DataSet::plan(&settings, None).unwrap().devignetting;
    let image = Shot { f_number: 8.0, ..shot }.take(&settings, &|| ()).unwrap();
    (settings, image)
}

/// Limit for centroids alone. Without other f-numbers vignetting is not corrected; it moves centroids
/// by up to 0.1 px at the border of these images.
const ALONE_PX: f64 = 0.12;

#[test]
fn any_lattice_pitch_and_rotation_is_found_without_hints() {
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
        // Each lies on a true centre; indices have another origin.
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
fn damaged_micro_images_are_left_out_by_reason_and_do_not_spoil_the_rest() {
    let (settings, mut image) = small_white(&["imperfections.dead_micro_lenses=40"]);
    // A black and a white patch, the black one where the pattern is searched for first.
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
    // 300 x 250 px contain 160 micro-images, and cut more at the edge; 40 are dead.
    assert!((160..250).contains(&out.dark), "{out:?}");
    // 130 x 130 px contain about 30, some of which are still found at the edge.
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
fn the_size_of_an_array_smaller_than_the_sensor_is_that_of_its_visible_part() {
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
        // The true size may be stated, a size smaller than what is visible may not.
        let stated = measure_array(&image, Some((columns, rows))).unwrap();
        assert_eq!(stated.centers.len(), array.centers.len());
        let error = measure_array(&image, Some((grid.lattice.columns - 1, rows)));
        let error = error.unwrap_err().to_string();
        assert!(error.contains(&format!("{shown} x {rows}")), "{error}");
    }
}

#[test]
fn images_without_an_array_are_rejected() {
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
        assert!(error.contains("no array of micro-images was found"), "{error}");
    }
}
