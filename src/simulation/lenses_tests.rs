//! Tests of the lenses that come with plenocal, and of the presets that have them.

use nalgebra::{Point3, Vector2, Vector3};

use super::Settings;
use super::main_lens::Lens;
use super::prescription::{Paraxial, Prescription};
use super::ray::Ray;
use super::real_lens::RealLens;

/// Lenses with focal length and back focal length as the source states or implies them, and with pupil magnification and
/// e_z/F of another program.
const FIGURES: [(&str, f64, f64, f64, f64); 7] = [
    ("double-gauss", 100.004, 61.486, 1.1464, 0.1464),
    ("telephoto", 99.964, 51.761, 0.7394, -0.2606),
    ("petzval", 99.971, 56.496, 0.9616, -0.0384),
    ("triplet", 98.56, 81.433, 0.9232, -0.0768),
    ("tessar", 99.88, 80.55, 0.9376, -0.0624),
    ("retrofocus", 100.0, 137.35, 1.8560, 0.8560),
    ("near-telecentric", 100.13, 156.46, 4.2764, 3.2764),
];

#[test]
fn every_lens_has_the_figures_of_its_source() {
    for (name, focal_length, back, magnification, exit_pupil) in FIGURES {
        let lens = Prescription::named(name).unwrap();
        let figures = Paraxial::of(&lens).unwrap();
        let last: f64 = lens.surfaces.iter().rev().skip(1).map(|s| s.thickness_mm).sum();
        let behind = figures.rear_principal + figures.focal_length - last;
        assert!((figures.focal_length - focal_length).abs() < 0.05, "{name}: {figures:?}");
        assert!((behind - back).abs() < 0.05, "{name}: {behind}");
        assert!((figures.pupil_magnification - magnification).abs() < 1e-3, "{name}: {figures:?}");
        let z = figures.z_mm(figures.exit_pupil, 1.0);
        assert!((z - exit_pupil).abs() < 1e-3, "{name}: {z}");
    }
}

/// Largest RMS radius of the light of a point in the paraxial image plane, at f/4 and image heights up to 0.15 F, in F. All lenses
/// have less than 0.0008; a wrong digit in a radius raises it.
const SHARP: f64 = 1e-3;

#[test]
fn every_lens_forms_sharp_images() {
    for (name, ..) in FIGURES {
        let lens = RealLens::new(&Prescription::named(name).unwrap(), 1.0, 4.0).unwrap();
        let (image, object) = (1.146, 1.146 / 0.146);
        for height in [0.0, 0.15] {
            let from = Point3::new(height, 0.0, -image);
            let mut seen = Vec::new();
            for (ring, turn) in (1..=8).flat_map(|ring| (0..24).map(move |turn| (ring, turn))) {
                // Points of equal areas.
                let radius = ((f64::from(ring) - 0.5) / 8.0).sqrt() * lens.exit_pupil_radius;
                let (sin, cos) = (f64::from(turn) * std::f64::consts::TAU / 24.0).sin_cos();
                let aim = lens.exit_pupil + Vector3::new(cos, sin, 0.0) * radius;
                let way = aim - from;
                let ray = Ray::from(&from, way.xy() / way.z);
                seen.extend(lens.object_ray(&ray).map(|outer| outer.at(object) * image / object));
            }
            let middle = seen.iter().sum::<Vector2<f64>>() / seen.len() as f64;
            let square: f64 = seen.iter().map(|at| (at - middle).norm_squared()).sum();
            let spot = (square / seen.len() as f64).sqrt();
            assert!(seen.len() > 180, "{name}, {height}: {}", seen.len());
            assert!(spot < SHARP, "{name}, {height}: {spot}");
        }
    }
}

/// Lenses whose openings are wide enough for every micro-lens, with the axis up to 150 px from the middle of the sensor.
const WIDE: [&str; 5] = ["petzval", "triplet", "tessar", "retrofocus", "near-telecentric"];

#[test]
fn no_micro_image_is_cut_by_the_rim_of_a_lens() {
    for (camera, name) in ["mini", "r12"].iter().flat_map(|&c| WIDE.map(|name| (c, name))) {
        let set = ["axis_px=[150, 150]".to_owned()];
        let settings = Settings::preset(&format!("{camera}-{name}"), &set).unwrap();
        let prescription = settings.prescription.as_ref().unwrap();
        let mut wide = prescription.clone();
        for surface in wide.surfaces.iter_mut().filter(|surface| !surface.stop) {
            surface.semi_diameter_mm *= 1.05;
        }
        let f_number = settings.board_f_number();
        let [lens, wide] = [prescription, &wide]
            .map(|lens| Lens::new(&settings.camera, Some(lens), f_number).unwrap());
        let sensor = &settings.camera.sensor;
        let size = Vector2::new(f64::from(sensor.width_px), f64::from(sensor.height_px));
        let half = (size / 2.0).add_scalar(150.0) * sensor.pixel_size_mm;
        let from = Point3::new(half.x, half.y, -settings.camera.mla.lens_to_mla_mm);
        let mut passed = 0;
        for (x, y) in (-20..=20).flat_map(|x| (-20..=20).map(move |y| (x, y))) {
            let at = Vector3::new(f64::from(x), f64::from(y), 0.0) * (wide.drawn.radius / 20.0);
            let way = wide.drawn.center + at - from;
            let ray = Ray::from(&from, way.xy() / way.z);
            assert_eq!(lens.passes(&ray), wide.passes(&ray), "{camera}-{name}: {at:?}");
            passed += usize::from(lens.passes(&ray));
        }
        assert!(passed > 300, "{camera}-{name}: {passed}");
    }
}

/// Micro-images touch at the f-number of the boards: the light of a micro-lens spreads over 97 to 102 % of the pitch, with the
/// triplet over 93 %.
#[test]
fn micro_images_of_real_lenses_fit() {
    for (camera, name) in ["mini", "r12"].iter().flat_map(|&c| FIGURES.map(|of| (c, of.0))) {
        let settings = Settings::preset(&format!("{camera}-{name}"), &[]).unwrap();
        let mla = &settings.camera.mla;
        let lens =
            Lens::new(&settings.camera, settings.prescription.as_ref(), settings.board_f_number())
                .unwrap();
        let to_pupil = lens.pupil.center.z + mla.lens_to_mla_mm;
        let pupil = lens.pupil.radius * mla.mla_to_sensor_mm / to_pupil;
        let blur = |&f: &f64| {
            let by_lens = 1.0 - mla.mla_to_sensor_mm * (1.0 / f - 1.0 / to_pupil);
            by_lens.abs() * mla.pitch_mm / 2.0
        };
        let largest = mla.focal_lengths_mm.iter().map(blur).fold(0.0, f64::max);
        let pitch = mla.pitch_mm * (1.0 + mla.mla_to_sensor_mm / to_pupil);
        let part = 2.0 * (pupil + largest) / pitch;
        assert!((0.92..1.03).contains(&part), "{camera}-{name}: {part}");
    }
}

/// F, the distances of focus and of the array, and the f-number: values that results in the documents rest on.
#[test]
fn presets_of_the_first_real_lenses_keep_their_settings() {
    for (name, lens, focal_length, focus, to_array) in [
        ("mini-double-gauss", "double-gauss", 16.32, 120.0, 18.64),
        ("mini-telephoto", "telephoto", 15.68, 123.0, 17.75),
        ("r12-double-gauss", "double-gauss", 51.0, 415.0, 58.45),
        ("r12-telephoto", "telephoto", 49.0, 428.0, 55.73),
    ] {
        let settings = Settings::preset(name, &[]).unwrap();
        let camera = settings.camera.main_lens;
        assert_eq!(settings.prescription, Some(Prescription::named(lens).unwrap()), "{name}");
        let values = (camera.focal_length_mm, settings.camera.mla.lens_to_mla_mm);
        assert_eq!(values, (focal_length, to_array), "{name}");
        let stated = camera.setting.map(|s| [s.focus_distance_mm, s.f_number]);
        assert_eq!(stated, Some([focus, 4.0]), "{name}");
        assert_eq!(settings.white_images.f_numbers.first(), Some(&4.0), "{name}");
        // Everything else is as with a double Gauss.
        let camera_name = name.split('-').next().unwrap_or_default();
        let mut other = Settings::preset(&format!("{camera_name}-double-gauss"), &[]).unwrap();
        other.prescription.clone_from(&settings.prescription);
        other.camera.main_lens = camera;
        other.camera.mla.lens_to_mla_mm = to_array;
        assert_eq!(other, settings, "{name}");
    }
}

#[test]
fn the_axis_moves_and_the_array_stays() {
    let preset = |set: &[&str]| {
        let set: Vec<String> = set.iter().map(|&pair| pair.to_owned()).collect();
        Settings::preset("mini-tessar", &set)
    };
    let middle = preset(&["axis_px=[0, 0]"]).unwrap();
    let sensor = middle.camera.sensor;
    assert_eq!(middle.camera.mla.principal_point_px, sensor.center_px());
    let off = preset(&["axis_px=[150, -25.0]"]).unwrap();
    let moved = off.camera.mla.principal_point_px - sensor.center_px();
    assert_eq!(moved, Vector2::new(150.0, -25.0));
    // The middle of a micro-lens, projected along the axis, stays at its pixel.
    let place = |settings: &Settings| {
        let tracer = settings.tracer(8.0).unwrap();
        let lens = &tracer.array.lenses[tracer.array.lenses.len() / 2];
        tracer.array.to_pixel(&lens.center, &Vector3::z())
    };
    assert!((place(&off) - place(&middle)).norm() < 1e-3);
    let mut same = off.clone();
    same.camera.mla = middle.camera.mla.clone();
    assert_eq!(same, middle);
    let wrong = preset(&["axis_px=25"]).unwrap_err().to_string();
    assert!(wrong.contains("axis_px, the place of the optical axis"), "{wrong}");
    let file = format!("axis_px = [3, 4]\n{}", middle.to_toml().unwrap());
    let read = Settings::from_toml(&file, &[]).unwrap();
    assert_eq!(read.camera.mla.principal_point_px, sensor.center_px() + Vector2::new(3.0, 4.0));
}
