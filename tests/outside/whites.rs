//! Arrays in white images of real cameras.

use std::path::PathBuf;

use nalgebra::Vector2;
use plenocal::io::{read_image, read_raytrix};
use plenocal::model::{LatticeKind, MicroImageCenter};
use plenocal::precalibration::{ArrayMeasurement, measure_array};
use predicates::prelude::PredicateBooleanExt;
use predicates::str::contains;
use tempfile::TempDir;

use crate::needs::WHITES;
use crate::support::plenocal;

fn real(name: &str) -> PathBuf {
    WHITES.folder().join(name)
}

fn measured(name: &str) -> ArrayMeasurement {
    let raw = read_image(&real(name), None).unwrap();
    measure_array(&raw, None).unwrap()
}

pub fn real_square_arrays_are_found() {
    let array = measured("thorlabs-square-white.png");
    assert_eq!(array.grid.lattice.kind(), LatticeKind::Orthogonal);
    assert!((array.grid.pitch_px - 48.0).abs() < 0.5, "{}", array.grid.pitch_px);
    assert!(array.grid.rms_px < 0.2 && array.centers.len() > 400);
    let array = measured("square-white2500.bmp");
    assert_eq!(array.grid.lattice.kind(), LatticeKind::Orthogonal);
    assert!(array.grid.rms_px < 0.5 && array.centers.len() > 1400);
}

/// The image contains traces of the scene, which scatter single centres by a pixel.
pub fn a_real_array_agrees_with_its_maker() {
    let maker = read_raytrix(&real("origami.calib.xml")).unwrap();
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

    // The three types differ in the size of their micro-images, and agree with the maker's.
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
}

pub fn a_real_calibration_of_a_maker_needs_the_size_of_its_images() {
    let out = TempDir::new().unwrap();
    let precalibrate = |size: &[&str]| {
        let mut command = plenocal();
        command.arg("precalibrate").arg(real("origami.calib.xml")).args(size);
        command.arg("--out").arg(out.path()).assert()
    };
    precalibrate(&[]).code(1).stderr(contains("give --size"));
    precalibrate(&["--size", "2048x2048"])
        .success()
        .stdout(contains("hexagonal-columns").and(contains("pitch 23.202")));
}
