//! Arrays unlike those of usual plenoptic cameras: in strong perspective, small, of few large micro-images, with holes.

use nalgebra::Vector2;
use plenocal::image::{Color, RawImage, Samples};
use plenocal::precalibration::{ArrayMeasurement, array_findings, measure_array};

use crate::support::codes;

/// Drawn micro-images: discs whose edge is this wide, px.
const EDGE: f64 = 2.0;

/// Returns the nodes of a lattice about (0, 0), in pitches, up to `reach` rows and columns away.
fn nodes(hexagonal: bool, reach: i32) -> Vec<Vector2<f64>> {
    let node = |i: i32, j: i32| {
        let (i, j) = (f64::from(i), f64::from(j));
        if hexagonal {
            Vector2::new(i + 0.5 * j.rem_euclid(2.0), 0.75_f64.sqrt() * j)
        } else {
            Vector2::new(i, j)
        }
    };
    (-reach..=reach).flat_map(|j| (-reach..=reach).map(move |i| node(i, j))).collect()
}

/// Draws a white image with discs of these centres and radii, px.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // cut to the image
fn drawn((width, height): (usize, usize), discs: &[(Vector2<f64>, f64)]) -> RawImage {
    let mut light = vec![0.0_f64; width * height];
    for (center, radius) in discs {
        let reach = radius + EDGE;
        let range = |x: f64, length: usize| {
            (x - reach).max(0.0) as usize..((x + reach + 1.0).max(0.0) as usize).min(length)
        };
        for v in range(center.y, height) {
            for u in range(center.x, width) {
                let r = (Vector2::new(u as f64, v as f64) - center).norm();
                let here = ((radius - r) / EDGE + 0.5).clamp(0.0, 1.0);
                light[v * width + u] = light[v * width + u].max(here);
            }
        }
    }
    let samples = light.iter().map(|light| (200.0 * light).round() as u8 + 8).collect();
    RawImage { width, height, color: Color::Grey, samples: Samples::Bits8(samples) }
}

/// Returns the centres whose window lies in the image, and its pixels all in the light.
fn whole(size: (usize, usize), pitch: f64, centers: &[Vector2<f64>]) -> Vec<Vector2<f64>> {
    let margin = 0.7 * pitch + 2.0;
    let inside = |c: &&Vector2<f64>| {
        c.min() > margin && c.x < size.0 as f64 - margin && c.y < size.1 as f64 - margin
    };
    centers.iter().filter(inside).copied().collect()
}

/// Returns the largest distance of these centres from the nearest in the grid and, if `measured`, from the nearest that was
/// measured, px.
fn furthest(array: &ArrayMeasurement, centers: &[Vector2<f64>]) -> (f64, f64) {
    let lattice = &array.grid.lattice;
    let grid: Vec<Vector2<f64>> = (0..lattice.rows)
        .flat_map(|l| (0..lattice.columns).map(move |k| (k, l)))
        .map(|(k, l)| array.grid.center_of(k, l))
        .collect();
    let measured: Vec<Vector2<f64>> =
        array.centers.iter().map(|c| Vector2::new(c.u_px, c.v_px)).collect();
    let off = |places: &[Vector2<f64>], c: &Vector2<f64>| {
        places.iter().map(|place| (place - c).norm()).fold(f64::INFINITY, f64::min)
    };
    let largest =
        |places: &[Vector2<f64>]| centers.iter().map(|c| off(places, c)).fold(0.0, f64::max);
    (largest(&grid), largest(&measured))
}

/// The pitch changes by `change` along the wider side of the image.
fn in_perspective(change: f64) -> (RawImage, Vec<Vector2<f64>>) {
    let (size, pitch) = ((800, 500), 8.0);
    let middle = Vector2::new(size.0 as f64, size.1 as f64) / 2.0;
    let along = Vector2::new(1.0, 0.4).normalize() * change / 2.0 / size.0 as f64;
    let discs: Vec<(Vector2<f64>, f64)> = nodes(true, 60)
        .iter()
        .map(|node| {
            let p = node * pitch;
            let nearer = 1.0 - along.dot(&p);
            (middle + p / nearer, 0.45 * pitch / nearer)
        })
        .collect();
    let centers: Vec<Vector2<f64>> = discs.iter().map(|disc| disc.0).collect();
    (drawn(size, &discs), whole(size, pitch, &centers))
}

#[test]
fn all_micro_images_of_an_array_in_strong_perspective_are_used() {
    for change in [0.0, 0.025, 0.05, 0.08] {
        let (image, centers) = in_perspective(change);
        let array = measure_array(&image, None).unwrap();
        let (of_grid, of_measured) = furthest(&array, &centers);
        println!("{change}: grid {of_grid:.3} px, measured {of_measured:.3} px");
        assert!(of_measured < 0.1 && of_grid < 0.1, "{change}: {of_measured} {of_grid}");
        assert_eq!(codes(&array_findings(&array, &image)), [""; 0], "{change}");
    }
}

/// A square lattice of `count` by `count` micro-images whose pitch is larger along u.
fn stretched(count: i32, pitch: f64, stretch: f64) -> RawImage {
    let edge = f64::from(count) * pitch + 8.0;
    let across = Vector2::new(1.0 + stretch, 1.0);
    let discs: Vec<(Vector2<f64>, f64)> = nodes(false, count / 2)
        .iter()
        .map(|node| ((node * pitch).component_mul(&across).add_scalar(edge / 2.0), 0.45 * pitch))
        .collect();
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // some hundred pixels
    let edge = edge as usize;
    drawn((edge, edge), &discs)
}

/// The places of the micro-lenses of a small array are not regular enough to show whether pixels are square.
#[test]
fn a_slight_stretch_counts_in_large_arrays_alone() {
    for (count, pitch, stretch, counts) in
        [(28, 15.4, 0.0015, false), (28, 15.4, 0.01, true), (90, 8.0, 0.0015, true)]
    {
        let image = stretched(count, pitch, stretch);
        let array = measure_array(&image, None).unwrap();
        let found = array_findings(&array, &image);
        assert_eq!(codes(&found).contains(&"stretched-array"), counts, "{count}: {found:?}");
    }
}

/// As in Fourier light-field microscopes, which may show seven micro-images in the dark.
#[test]
fn few_large_micro_images_are_found() {
    for (hexagonal, pitch, edge, field) in [
        (true, 100.0, 620, f64::INFINITY),
        (false, 100.0, 620, f64::INFINITY),
        (true, 150.0, 900, 380.0),
        (false, 250.0, 1500, 620.0),
        (true, 220.0, 1700, 750.0),
        (true, 300.0, 1500, f64::INFINITY),
        (true, 130.0, 512, 210.0),
    ] {
        let middle = Vector2::repeat(f64::from(edge) / 2.0);
        let turned = nalgebra::Rotation2::new(0.02);
        let places = nodes(hexagonal, 8).into_iter().map(|node| turned * node * pitch);
        let centers: Vec<Vector2<f64>> =
            places.filter(|p| p.norm() < field - pitch / 2.0).map(|p| middle + p).collect();
        let discs: Vec<(Vector2<f64>, f64)> = centers.iter().map(|&c| (c, 0.45 * pitch)).collect();
        let size = (usize::try_from(edge).unwrap(), usize::try_from(edge).unwrap());
        let array = measure_array(&drawn(size, &discs), None).unwrap();
        let centers = whole(size, pitch, &centers);
        let (of_grid, of_measured) = furthest(&array, &centers);
        println!("{pitch} {field}: {} centres, {of_grid:.3} px", array.centers.len());
        assert!(of_grid < 0.1 && of_measured < 0.1, "{pitch} {field}: {of_grid} {of_measured}");
    }
}

/// Dark discs that hide a part of the image, and uneven light.
#[test]
fn an_array_is_found_between_holes() {
    let (size, pitch) = ((600, 500), 14.0);
    let middle = Vector2::new(size.0 as f64, size.1 as f64) / 2.0;
    let centers: Vec<Vector2<f64>> =
        nodes(true, 30).iter().map(|node| middle + node * pitch).collect();
    let discs: Vec<(Vector2<f64>, f64)> = centers.iter().map(|&c| (c, 6.0)).collect();
    let mut image = drawn(size, &discs);
    let Samples::Bits8(samples) = &mut image.samples else { panic!("drawn with 8 bits") };
    let mut seed = 1_u32;
    let mut random = |most: f64| {
        seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        most * f64::from(seed >> 8) / f64::from(1 << 24)
    };
    let holes: Vec<(Vector2<f64>, f64)> = (0..250)
        .map(|_| (Vector2::new(random(size.0 as f64), random(size.1 as f64)), 6.0 + random(12.0)))
        .collect();
    for (i, sample) in samples.iter_mut().enumerate() {
        let place = Vector2::new((i % size.0) as f64, (i / size.0) as f64);
        if holes.iter().any(|(hole, radius)| (place - hole).norm() < *radius) {
            *sample = 0;
        } else {
            let fading = 1.0 - 0.8 * place.x / size.0 as f64;
            #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // from 0 to 255
            let light = (60.0 + 0.5 * f64::from(*sample) * fading) as u8;
            *sample = light;
        }
    }
    let array = measure_array(&image, None).unwrap();
    let (of_grid, _) = furthest(&array, &whole(size, pitch, &centers));
    assert!(of_grid < 0.3, "{of_grid}");
    assert!(codes(&array_findings(&array, &image)).contains(&"micro-images-left-out"));
}

/// An array of two lens types, in rows or as a chessboard.
#[test]
fn micro_images_that_alternate_in_size_are_of_two_types() {
    let pitch = 14.0;
    for (hexagonal, chessboard) in [(true, false), (false, false), (false, true)] {
        for wider in [0.0, 0.04] {
            let discs: Vec<(Vector2<f64>, f64)> = nodes(hexagonal, 14)
                .iter()
                .map(|node| {
                    let row = if hexagonal { node.y / 0.75_f64.sqrt() } else { node.y };
                    let index = row.round() + if chessboard { node.x } else { 0.0 };
                    let is_odd = (index / 2.0).fract().abs() > 0.25;
                    let radius = 0.4 * pitch * if is_odd { 1.0 + wider } else { 1.0 };
                    ((node * pitch).add_scalar(200.0), radius)
                })
                .collect();
            let image = drawn((400, 400), &discs);
            let array = measure_array(&image, None).unwrap();
            let expected: &[&str] = if wider > 0.0 { &["alternating-sizes"] } else { &[] };
            assert_eq!(
                codes(&array_findings(&array, &image)),
                expected,
                "{hexagonal} {chessboard}"
            );
        }
    }
}
