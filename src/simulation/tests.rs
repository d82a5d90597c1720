//! Tests of the tracer against the closed form and against cases computed by hand.

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector2, Vector3};

use super::ray::Passage;
use super::sampling::RaySets;
use super::scene::PlacedTarget;
use super::spread::Footprint;
use super::{FallOffLaw, Imperfections, Scene, Settings, Target, Tracer};
use crate::model::{PlenopticCamera, optics};

fn settings(name: &str) -> Settings {
    Settings::preset(name, &[]).unwrap()
}

fn ideal(camera: &PlenopticCamera, f_number: f64) -> Tracer {
    Tracer::new(camera, f_number, &Imperfections::default(), 0).unwrap()
}

#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // within the image
fn pixel_at(place: &Vector2<f64>) -> (usize, usize) {
    (place.x as usize, place.y as usize)
}

fn pose(x: f64, y: f64, z: f64, turn: [f64; 3]) -> Isometry3<f64> {
    let turn = UnitQuaternion::from_scaled_axis(Vector3::from(turn));
    Isometry3::from_parts(Translation3::new(x, y, z), turn)
}

/// From the point where a ray from the sensor meets the board, light returns to the sensor
/// through the same point of the micro-lens. Rays are traced back with the distortion of their
/// bundle, so a small fraction of a pixel is lost. The second camera has a curved field and an exit
/// pupil off the axis, as a real lens has; the last board is bent.
#[test]
fn light_returns_along_the_rays() {
    const LOST_PX: f64 = 2e-3;
    for (name, board, curvature, exit_pupil, sag) in [
        ("mini", pose(-9.0, -7.0, 75.0, [0.6, -0.4, 0.3]), 0.0, [0.0; 3], 0.0),
        ("mini", pose(-9.0, -7.0, 75.0, [0.6, -0.4, 0.3]), 1e-2, [0.2, -0.1, -5.0], 0.0),
        ("r12-a", pose(-40.0, -25.0, 260.0, [-0.5, 0.5, 0.1]), 0.0, [0.0; 3], 0.0),
        ("keplerian", pose(-20.0, -15.0, 220.0, [0.5, 0.5, -0.4]), 0.0, [0.0; 3], 0.0),
        ("mini", pose(-9.0, -7.0, 75.0, [0.3, -0.2, 0.3]), 0.0, [0.0; 3], 1.0),
    ] {
        let mut settings = settings(name);
        settings.camera.main_lens.field_curvature_per_mm = curvature;
        settings.camera.main_lens.exit_pupil_mm = exit_pupil.into();
        let tracer = ideal(&settings.camera, 4.0);
        settings.target.sag_mm = [sag, -sag];
        let board = PlacedTarget::new(&settings.target, &board, tracer.focal_length).unwrap();
        let sets = RaySets::new(16, &Footprint::new(0.0));
        let mut looked_at = 0;
        for (i, lens) in tracer.array.lenses.iter().enumerate().step_by(97) {
            let center = tracer.outline(lens).0;
            if !tracer.sensor().contains(center.x, center.y) {
                continue;
            }
            let (u, v) = pixel_at(&center);
            let u = u + i % 3;
            let bundle = tracer.bundle(lens, u, v, Some(&board), None).unwrap();
            for ([right, down], disc) in sets.set(i as u64).points() {
                let pixel = bundle.pixel + bundle.right * right + bundle.down * down;
                let on_lens = Vector2::from(disc) * tracer.array.opening_radius;
                let ray = tracer.through(lens, on_lens, &pixel);
                let passage = tracer.lens.follow(&ray, bundle.aim.as_ref(), &board);
                let Passage::Seen(outer) = passage else { continue };
                // A bent board may turn away beyond its sheet.
                let Some(hit) = board.hit(&outer) else { continue };
                let image = tracer.lens.image_of(&hit).unwrap();
                let back = tracer.array.to_sensor(lens, on_lens, &image);
                let miss = (back.x - u as f64 - right).hypot(back.y - v as f64 - down);
                assert!(miss < LOST_PX, "{name} ({}, {}): {miss} px", lens.k, lens.l);
                looked_at += 1;
            }
        }
        assert!(looked_at > 200);
    }
}

/// If pixels are reported to see one radiance through a micro-lens, every ray from them sees it. This holds also for a board
/// that is near and tilted, a lens with distortion, a curved field and a pupil off the axis, and a point spread.
#[test]
fn pixels_that_see_one_radiance_see_no_other() {
    let (mut plain, mut mixed, mut looked_at) = (0, 0, 0);
    for (name, board, curvature, point_spread_px, aperture_ratio) in [
        ("mini", pose(-9.0, -7.0, 75.0, [0.6, -0.4, 0.3]), 0.0, 0.0, 1.0),
        ("mini", pose(-9.0, -7.0, 65.0, [-0.6, 0.4, 0.3]), 1e-2, 0.5, 0.8),
        ("keplerian", pose(-20.0, -15.0, 220.0, [0.5, 0.5, -0.4]), 0.0, 0.0, 1.0),
    ] {
        let mut settings = settings(name);
        settings.camera.main_lens.field_curvature_per_mm = curvature;
        settings.camera.main_lens.exit_pupil_mm = [0.3 * point_spread_px, 0.0, 0.0].into();
        let imperfections =
            Imperfections { aperture_ratio, point_spread_px, ..Imperfections::default() };
        let tracer = Tracer::new(&settings.camera, 4.0, &imperfections, 0).unwrap();
        let board = PlacedTarget::new(&settings.target, &board, tracer.focal_length).unwrap();
        let sets = RaySets::new(32, &Footprint::new(point_spread_px));
        for (i, lens) in tracer.array.lenses.iter().enumerate().step_by(7) {
            let (center, radius) = tracer.outline(lens);
            let up = [-0.9, -0.4, 0.0, 0.5, 0.9][i % 5] * radius;
            let (first, v) = pixel_at(&(center + Vector2::new(-0.8 * radius, up)));
            let middle = Vector2::new(first as f64 + 2.0, v as f64);
            let in_the_middle = tracer.between(lens, middle, Vector2::zeros());
            let Some(aim) = tracer.lens.aim(&in_the_middle, &board, None) else { continue };
            let Some(radiance) = tracer.plain(lens, (middle, 5), &aim, &board) else {
                mixed += 1;
                continue;
            };
            plain += 1;
            for u in first..first + 5 {
                let Some(bundle) = tracer.bundle(lens, u, v, Some(&board), None) else { continue };
                for ([right, down], disc) in sets.set((i * 31 + u) as u64).points() {
                    let pixel = bundle.pixel + bundle.right * right + bundle.down * down;
                    let on_lens = Vector2::from(disc) * tracer.array.opening_radius;
                    let ray = tracer.through(lens, on_lens, &pixel);
                    let seen = match tracer.lens.follow(&ray, bundle.aim.as_ref(), &board) {
                        Passage::Blocked => continue,
                        Passage::Away => board.texture.background,
                        Passage::Seen(outer) => board.radiance(&outer),
                    };
                    assert!((seen - radiance).abs() < 1e-12, "{name} ({u}, {v}): {seen}");
                    looked_at += 1;
                }
            }
        }
    }
    assert!(plain > 100 && mixed > 100 && looked_at > 2000, "{plain} {mixed} {looked_at}");
}

/// Returns the mean of a function of the squared distance between two points, over all pairs of points of two discs.
fn mean_over_discs(one: f64, other: f64, of: &dyn Fn(f64) -> f64) -> f64 {
    let points = |radius: f64| {
        (0..256).map(move |i| {
            // Fibonacci's lattice: the golden angle, equal areas.
            let (angle, part) = (2.399_963_2 * f64::from(i), (f64::from(i) + 0.5) / 256.0);
            Vector2::new(angle.cos(), angle.sin()) * (radius * part.sqrt())
        })
    };
    let pairs = points(one).flat_map(|a| points(other).map(move |b| (a - b).norm_squared()));
    pairs.map(of).sum::<f64>() / 65_536.0
}

/// All light that enters through pupil and micro-lens arrives, whatever the focal length of the micro-lens:
/// π² R² r²/D² for a white target seen through two distant discs, less the loss of oblique rays by the
/// law of the fall-off.
#[test]
fn light_is_conserved_for_every_lens_type() {
    // The noise of 1024 rays through a few hundred pixels.
    const NOISE: f64 = 2e-3;
    let (natural, pixel) = (FallOffLaw::Cos4, FallOffLaw::HalfResponseDeg(25.0));
    let half = 25_f64.to_radians().tan().powi(2);
    for (name, f_number, pupil_z, fall_off) in [
        ("mini", 4.0, 0.0, natural),
        ("mini", 16.0, 0.0, natural),
        ("keplerian", 5.66, 0.0, natural),
        ("mini", 5.66, -5.0, natural),
        ("mini", 4.0, 0.0, FallOffLaw::None),
        ("mini", 4.0, 3.0, pixel),
    ] {
        let mut camera = settings(name).camera;
        camera.main_lens.exit_pupil_mm.z = pupil_z;
        camera.mla.rotation_rad.fill(0.0);
        camera.mla.offset_mm.fill(0.0);
        // All neighbours of the micro-lens under test are dead.
        (camera.lattice.columns, camera.lattice.rows) = (3, 1);
        (camera.sensor.width_px, camera.sensor.height_px) = (90, 40);
        camera.mla.principal_point_px = camera.sensor.center_px();
        for alive in 0..3 {
            let imperfections = Imperfections { fall_off, ..Imperfections::default() };
            let mut tracer = Tracer::new(&camera, f_number, &imperfections, 0).unwrap();
            for (i, lens) in tracer.array.lenses.iter_mut().enumerate() {
                lens.alive = i == alive;
            }
            let image = tracer.render(&Scene::White, 1024, 0, &|| ()).unwrap();
            let sum: f64 = image.pixels.iter().map(|&p| f64::from(p)).sum();
            let flux = sum * tracer.reference_irradiance() * tracer.array.pixel_size.powi(2);
            let (pupil, stop) = (tracer.lens.pupil.radius, tracer.array.opening_radius);
            let distance = camera.pupil_to_mla_mm();
            let all = (std::f64::consts::PI * pupil * stop / distance).powi(2);
            // The slope at the sensor is the slope towards the pupil plus the one that the micro-lens adds.
            let added = stop * (tracer.array.lenses[alive].power - 1.0 / distance);
            let weight = mean_over_discs(pupil / distance, added, &|tan2| match fall_off {
                FallOffLaw::None => 1.0,
                FallOffLaw::Cos4 => (1.0 + tan2).powi(-2),
                FallOffLaw::HalfResponseDeg(_) => (1.0 + tan2).powi(-2) * (-tan2 / half).exp2(),
            });
            let part = flux / all / weight;
            assert!((part - 1.0).abs() < NOISE, "{name} f/{f_number} {fall_off:?}: {part}");
        }
    }
}

#[test]
fn white_images_show_the_internal_parameters_of_the_model() {
    let pupils = [[0.0; 3], [0.0, 0.0, -5.0], [0.3, -0.2, 7.0]];
    let names = ["mini", "keplerian", "r12-c", "lytro-like"];
    for (name, pupil) in names.into_iter().flat_map(|name| pupils.map(|pupil| (name, pupil))) {
        let mut camera = settings(name).camera;
        camera.main_lens.exit_pupil_mm = pupil.into();
        let (shown, paper) =
            (ideal(&camera, 8.0).internal_parameters(), optics::internal_parameters(&camera));
        assert!((shown.m_mm / paper.m_mm - 1.0).abs() < 1e-12, "{name}");
        for (shown, paper) in shown.q_prime_mm.iter().zip(&paper.q_prime_mm) {
            assert!((shown / paper - 1.0).abs() < 1e-12, "{name}");
        }
        let pitches = [shown, paper].map(|p| p.micro_image_pitch_mm.unwrap());
        assert!((pitches[0] / pitches[1] - 1.0).abs() < 1e-12, "{name}");
    }
}

/// By hand, with F = 16.2 mm at f/4 and a pupil 5 mm behind the lens: p = 1 − 5/16.2, and the entrance pupil has
/// the diameter 16.2/4.
#[test]
fn the_exit_pupil_is_the_image_of_the_entrance_pupil() {
    let mut camera = settings("mini").camera;
    camera.main_lens.exit_pupil_mm = Vector3::new(0.1, 0.2, -5.0);
    let pupil = ideal(&camera, 4.0).lens.pupil;
    assert!((pupil.radius - (16.2 - 5.0) / 8.0).abs() < 1e-12);
    assert_eq!(pupil.center, Point3::new(0.1, 0.2, -5.0));
}

#[test]
fn the_middle_of_the_brightest_micro_image_has_irradiance_one() {
    let mut camera = settings("mini").camera;
    camera.mla.rotation_rad.fill(0.0);
    for f_number in [4.0, 8.0, 16.0] {
        let image = ideal(&camera, f_number).render(&Scene::White, 64, 0, &|| ()).unwrap();
        let brightest = image.pixels.iter().copied().fold(0.0, f32::max);
        // A pixel is not a point, and rays through the rim of a micro-lens lose 4 %.
        assert!((0.95..1.01).contains(&brightest), "f/{f_number}: {brightest}");
    }
}

#[test]
fn images_do_not_depend_on_threads() {
    let settings = settings("mini");
    let tracer = ideal(&settings.camera, 4.0);
    let scene = Scene::Board(settings.target, pose(-9.0, -7.0, 75.0, [0.3, 0.0, 0.0]));
    let render = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| tracer.render(&scene, 8, 5, &|| ()).unwrap())
    };
    let one = render(1);
    assert!(one == render(3));
    assert!(
        one != tracer.render(&scene, 8, 6, &|| ()).unwrap(),
        "another seed gives another image"
    );
}

/// Corner 0 is at the top left of the board and of the image, and the square before it is black.
#[test]
fn the_image_is_upright() {
    is_upright([0.0, 0.0]);
}

/// The tilt of the lens does not move chief rays.
#[test]
fn the_image_of_a_tilted_lens_has_the_same_places() {
    is_upright([0.02, -0.01]);
}

fn is_upright(lens_rotation_rad: [f64; 2]) {
    let mut settings = settings("mini");
    settings.camera.main_lens.rotation_rad = lens_rotation_rad;
    let tracer = ideal(&settings.camera, 4.0);
    let Target { columns, rows, square_mm, .. } = settings.target;
    let (z, sensor) = (80.0, &settings.camera.sensor);
    let board = pose(-1.5 * f64::from(columns), -1.5 * f64::from(rows), z, [0.0; 3]);
    let image = tracer.render(&Scene::Board(settings.target, board), 8, 0, &|| ()).unwrap();
    let brightness = |column: i32, row: i32| {
        let center = (f64::from(column) - 0.5, f64::from(row) - 0.5);
        let p = board * Point3::new(center.0 * square_mm, center.1 * square_mm, 0.0);
        let mla = &settings.camera.mla;
        let to_sensor = mla.lens_to_mla_mm + mla.mla_to_sensor_mm;
        let scale = to_sensor / z / sensor.pixel_size_mm;
        let place = settings.camera.mla.principal_point_px + p.coords.xy() * scale;
        let (u, v) = pixel_at(&place);
        let near = (v - 20..v + 20).flat_map(|v| (u - 20..u + 20).map(move |u| (u, v)));
        near.map(|(u, v)| image.at(u, v)).sum::<f32>()
    };
    for row in 1..rows {
        for column in 1..columns {
            let (here, next) = (brightness(column, row), brightness(column + 1, row));
            let black = (column + row) % 2 == 0;
            assert!(if black { 3.0 * here < next } else { here > 3.0 * next });
        }
    }
}
