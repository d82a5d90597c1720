//! Tests of real lenses against figures of other programs, rays computed by hand, and the thin lens.

use nalgebra::{Point3, Vector2, Vector3};

use super::main_lens::Lens;
use super::prescription::{Paraxial, Prescription};
use super::ray::Passage;
use super::ray::Ray;
use super::real_lens::RealLens;
use super::sampling::RaySets;
use super::scene::PlacedTarget;
use super::spread::Footprint;
use super::{Settings, Tracer};
use crate::model::{PlenopticCamera, optics};

const REAL: [&str; 9] = [
    "mini-double-gauss",
    "mini-telephoto",
    "mini-petzval",
    "mini-triplet",
    "mini-tessar",
    "mini-retrofocus",
    "mini-near-telecentric",
    "r12-double-gauss",
    "r12-telephoto",
];

fn prescription(text: &str) -> Prescription {
    Prescription::from_toml(text).unwrap()
}

fn settings(name: &str) -> Settings {
    Settings::preset(name, &[]).unwrap()
}

fn lens(settings: &Settings, f_number: f64) -> Lens {
    Lens::new(&settings.camera, settings.prescription.as_ref(), f_number).unwrap()
}

/// Figures of another program; positions are distances behind the first vertex. The last vertex is at 77.967402.
#[test]
fn the_double_gauss_has_its_published_figures() {
    let figures = Paraxial::of(&Prescription::named("double-gauss").unwrap()).unwrap();
    for (value, published) in [
        (figures.focal_length, 100.004),
        (figures.front_principal, 70.68),
        (figures.rear_principal, 39.45),
        (figures.entrance_pupil, 57.91),
        (77.967_402 - figures.exit_pupil, 53.16),
        (figures.z_mm(figures.exit_pupil, figures.focal_length), 14.64),
    ] {
        assert!((value - published).abs() < 5e-3, "{value} for {published}");
    }
    assert!((figures.pupil_magnification - 1.1464).abs() < 5e-5);
}

/// The pupils obey Newton's equation e_z = −F(1 − p), which the paraxial trace does not use.
#[test]
fn the_exit_pupil_obeys_newtons_equation() {
    for (name, sign) in [("double-gauss", 1.0), ("telephoto", -1.0)] {
        let figures = Paraxial::of(&Prescription::named(name).unwrap()).unwrap();
        let z = figures.z_mm(figures.exit_pupil, 50.0);
        assert!((z + 50.0 * (1.0 - figures.pupil_magnification)).abs() < 1e-9, "{name}: {z}");
        assert!(z * sign > 5.0, "{name}: {z}");
    }
}

/// Plano-convex lens of index 1.5, with R = 50 in front, 10 mm thick, its stop 5 mm in front of it: F = 100.
const PLANO_CONVEX: &str = "surfaces = [
    { stop = true, thickness_mm = 5.0, semi_diameter_mm = 20.0 },
    { radius_mm = 50.0, thickness_mm = 10.0, index = 1.5, semi_diameter_mm = 20.0 },
    { semi_diameter_mm = 20.0 },
]";

/// By hand: the ray comes from the sensor, parallel to the axis and 10 mm off it. The plane does not refract it.
/// On the sphere sin i = 10/50 within the glass, sin t = 1.5 · 0.2 = 0.3 in air, so that it turns towards
/// the axis by asin 0.3 − asin 0.2 = 0.304692654 − 0.201357921 = 0.103334733 (tan 0.103704). It leaves the glass at
/// 50 − √(50² − 10²) = 1.010205 behind the vertex. The front principal plane of a plano-convex lens is at
/// its vertex, so that z in the frame of the poses counts from there.
#[test]
fn a_ray_through_a_sphere_by_hand() {
    let lens = RealLens::new(&prescription(PLANO_CONVEX), 100.0, 4.0).unwrap();
    let ray = Ray { at_lens: Vector2::new(10.0, 0.0), slope: Vector2::zeros() };
    let outer = lens.object_ray(&ray).unwrap();
    let slope = -0.103_704;
    assert!((outer.slope - Vector2::new(slope, 0.0)).norm() < 1e-6, "{}", outer.slope);
    let at_vertex = 10.0 + slope * 1.010_205;
    assert!((outer.at_lens - Vector2::new(at_vertex, 0.0)).norm() < 1e-5, "{}", outer.at_lens);
    // At f/4 the stop has a radius of 12.5 mm, 5 mm in front of the vertex.
    let at_stop = |height: f64| {
        let ray = Ray { at_lens: Vector2::new(0.0, height), slope: Vector2::zeros() };
        lens.object_ray(&ray).map(|outer| outer.at(5.0).y)
    };
    assert!(at_stop(13.0).is_some_and(|y| y < 12.5) && at_stop(14.5).is_none());
}

/// By hand: the image-side principal plane lies 10/1.5 mm in front of the plane surface, at z = 0. A tilted glass plate only
/// shifts a ray. A ray through the plane surface at 10 mm with the slope 0.2 has sin 0.196116/1.5 = 0.130744 within the
/// glass.
#[test]
fn a_ray_through_a_plane_by_hand() {
    let lens = RealLens::new(&prescription(PLANO_CONVEX), 100.0, 4.0).unwrap();
    assert!((lens.last_vertex_z() + 10.0 / 1.5).abs() < 1e-12);
    // The ray aims at the vertex of the sphere and leaves with its first slope: the axis is normal to both surfaces.
    let slope_inside = 0.130_744 / (1.0_f64 - 0.130_744 * 0.130_744).sqrt();
    let at_plane = -10.0 * slope_inside;
    let ray = Ray::from(&Point3::new(at_plane, 0.0, -10.0 / 1.5), Vector2::new(0.2, 0.0));
    let outer = lens.object_ray(&ray).unwrap();
    assert!((outer.at_lens.x).abs() < 1e-4 && (outer.slope.x - 0.2).abs() < 1e-5, "{outer:?}");
}

/// At F = 25.4 mm and an image distance of 29.2 mm, 3 mm off the axis, an independent trace from the object's side gives
/// 0.058 mm in the plane of the axis and 0.049 mm across it.
#[test]
fn the_double_gauss_has_a_curved_field() {
    let lens = RealLens::new(&Prescription::named("double-gauss").unwrap(), 25.4, 4.0).unwrap();
    let object = 1.0 / (1.0 / 25.4 - 1.0 / 29.2);
    let image =
        |height: f64| lens.image_of(&Point3::new(-height * object / 29.2, 0.0, object)).unwrap();
    let axis = image(0.0);
    assert!((axis.z + 29.2).abs() < 1e-4, "{axis}");
    let off = image(3.0);
    assert!((off.z - axis.z - 0.0535).abs() < 1e-3, "{off}");
    assert!((off.x - 2.9865).abs() < 1e-3, "{off}");
    let figures = lens.figures(object, 29.2).unwrap();
    assert!((figures.field_curvature_per_mm - 0.0060).abs() < 1e-4, "{figures:?}");
    assert!((figures.exit_pupil_mm - 25.4 * 0.1464).abs() < 1e-3, "{figures:?}");
}

/// Figures for all light approach the paraxial ones with the square of the aperture.
#[test]
fn all_light_of_a_small_aperture_is_paraxial() {
    for name in ["double-gauss", "retrofocus", "tessar"] {
        let of = |f_number: f64| {
            let lens = RealLens::new(&Prescription::named(name).unwrap(), 25.4, f_number).unwrap();
            let figures = lens.figures(120.0, 29.2).unwrap();
            let all = figures.all_light;
            let off = |value: f64, paraxial: f64| (value - paraxial).abs();
            // Other aberrations of the pupil do not depend on the aperture.
            let seen = -29.2 - all.exit_pupil_mm;
            [off(all.focal_length_mm, 25.4), off(all.lens_to_mla_mm, 29.2), seen]
        };
        let [wide, middle, small] = [8.0, 16.0, 64.0].map(of);
        assert!(small[0] < 2e-4 * 25.4 && small[1] < 2e-4 * 29.2, "{name}: {small:?}");
        assert!((wide[0] / middle[0] - 4.0).abs() < 0.6, "{name}: {wide:?} {middle:?}");
        let pupil = (wide[2] - small[2]) / (middle[2] - small[2]);
        assert!((pupil - 4.0).abs() < 0.6, "{name}: {pupil}");
    }
}

/// Two weak surfaces close together, with the stop between them, are a thin lens up to the third order of
/// heights and slopes.
#[test]
fn a_very_thin_lens_is_the_thin_lens() {
    let text = "surfaces = [
        { radius_mm = 100.0, thickness_mm = 1e-6, index = 1.5, semi_diameter_mm = 30.0 },
        { stop = true, thickness_mm = 1e-6, index = 1.5, semi_diameter_mm = 30.0 },
        { radius_mm = -100.0, semi_diameter_mm = 30.0 },
    ]";
    let lens = RealLens::new(&prescription(text), 50.0, 4.0).unwrap();
    assert!(lens.exit_pupil.coords.norm() < 1e-6 && (lens.exit_pupil_radius - 6.25).abs() < 1e-6);
    let miss = |size: f64| {
        let ray = Ray { at_lens: Vector2::new(3.0, 2.0), slope: Vector2::new(-0.1, 0.04) };
        let ray = Ray { at_lens: ray.at_lens * size, slope: ray.slope * size };
        let outer = lens.object_ray(&ray).unwrap();
        let slope = ray.slope - ray.at_lens / 50.0;
        (outer.slope - slope).norm() + (outer.at_lens - ray.at_lens).norm() / 50.0
    };
    let (one, tenth) = (miss(0.1), miss(0.01));
    assert!(one < 1e-5 && tenth < 1e-8, "{one}, {tenth}");
    let point = Point3::new(0.3, -0.2, 300.0);
    let image = lens.image_of(&point).unwrap();
    let thin = point.coords * (50.0 / (50.0 - 300.0));
    assert!((image.coords - thin).norm() < 1e-3, "{image} for {thin}");
}

/// No ray from anywhere on the array that passes the lens comes from outside the disc that rays are drawn from.
#[test]
fn no_ray_that_passes_is_left_out() {
    for name in REAL {
        let settings = settings(name);
        for f_number in [4.0, 8.0, 16.0] {
            let lens = lens(&settings, f_number);
            let mut passed = 0;
            let z = -settings.camera.mla.lens_to_mla_mm;
            let half = corner_mm(&settings.camera);
            for (place, disc) in RaySets::new(2048, &Footprint::new(0.0)).set(0).points() {
                // Every direction at every point; a third of the points are at the border.
                let place = Vector2::from(place) * 2.0;
                let place = place / place.amax().max(2.0 / 3.0);
                let from = Point3::new(place.x * half.x, place.y * half.y, z);
                for part in [0.5, 0.9, 1.001, 1.02, 1.1, 1.3, 1.8] {
                    let at = Vector2::from(disc).normalize() * part * lens.drawn.radius;
                    let way = lens.drawn.center + at.push(0.0) - from;
                    let passes = lens.passes(&Ray::from(&from, way.xy() / way.z));
                    assert!(!passes || part < 1.0, "{name} f/{f_number}: {from}, {part}");
                    passed += usize::from(passes);
                }
            }
            assert!(passed > 1000, "{name} f/{f_number}: {passed}");
        }
    }
}

/// Bound on the difference of the blur radii from their mean, px: with an astigmatic main lens, the blur of a point is an
/// ellipse.
const ASTIGMATISM_PX: f64 = 0.5;

/// Returns the distance of the corner of the sensor from the axis, mm.
fn corner_mm(camera: &PlenopticCamera) -> Vector2<f64> {
    let size = Vector2::new(f64::from(camera.sensor.width_px), f64::from(camera.sensor.height_px));
    size * (camera.sensor.pixel_size_mm / 2.0)
}

/// The ray from a pixel through the middle of a micro-lens ends in a point of the board, and the truth
/// for that point is the pixel. Rays through the rim of the micro-lens end nearby: the light of the
/// point is spread there as the truth states, except for aberrations within the micro-lens.
#[test]
fn the_truth_of_a_point_is_where_its_rays_come_from() {
    for name in REAL {
        let settings = settings(name);
        let tracer = settings.tracer(settings.board_f_number()).unwrap();
        let z = f64::midpoint(settings.boards.depth_mm[0], settings.boards.depth_mm[1]);
        let pose =
            nalgebra::Isometry3::new(Vector3::new(-1.0, -2.0, z), Vector3::new(0.2, -0.3, 0.1));
        let board = PlacedTarget::new(&settings.target, &pose, tracer.focal_length).unwrap();
        let (mut seen, mut largest) = (0, 0.0_f64);
        let step = tracer.array.lenses.len() / 150;
        for lens in tracer.array.lenses.iter().step_by(step) {
            let direction = tracer.lens.chief_direction(&lens.center).unwrap();
            let center = tracer.array.to_pixel(&lens.center, &direction);
            if !tracer.sensor().contains(center.x, center.y) {
                continue;
            }
            let pixel = center + Vector2::new(4.0, -3.0);
            let local = |p: &nalgebra::Point2<f64>| {
                tracer.array.local(lens, &tracer.array.on_sensor(p.x, p.y))
            };
            let ray = tracer.through(lens, Vector2::zeros(), &local(&pixel));
            let Passage::Seen(outer) = tracer.lens.follow(&ray, None, &board) else { continue };
            let depth = board.depth(&outer);
            let point = Point3::from(outer.at(depth).push(depth));
            let spot = tracer.spot(&point, lens.k, lens.l).unwrap();
            // The tilt of the array moves the mean of the rays through the rim slightly.
            let miss = (spot.center_px - pixel).norm();
            assert!(miss < 5e-3, "{name} ({}, {}): {miss} px", lens.k, lens.l);
            assert!(spot.visible > 0.0);
            let near = tracer.lens.image_of(&point).unwrap();
            let image = tracer.lens.image_from(&point, &near, &lens.center).unwrap();
            for rim in [Vector2::x(), -Vector2::x(), Vector2::y(), -Vector2::y()] {
                let on_lens = rim * tracer.array.opening_radius;
                let pixel = tracer.array.to_sensor(lens, on_lens, &image);
                let ray = tracer.through(lens, on_lens, &local(&pixel));
                let Passage::Seen(outer) = tracer.lens.follow(&ray, None, &board) else { continue };
                // Miss of the ray at the point, projected onto the sensor.
                let off = outer.at(point.z) - point.xy().coords;
                let by_main_lens = image.z / point.z;
                let by_micro_lens = tracer.mla_to_sensor / (image.z - lens.center.z);
                let seen = off.norm() * (by_main_lens * by_micro_lens).abs();
                largest = largest.max(seen / tracer.array.pixel_size);
            }
            seen += 1;
        }
        assert!(seen > 60, "{name}: {seen}");
        assert!(largest < ASTIGMATISM_PX, "{name}: {largest}");
    }
}

/// Traced centres agree with the model with the aberration of the pupil to the third order. At the border, it moves them by a
/// fraction of a pixel.
#[test]
fn micro_images_of_a_real_lens_have_their_centres_by_its_pupil() {
    for name in REAL {
        let mut settings = settings(name);
        let mla = &mut settings.camera.mla;
        mla.rotation_rad.fill(0.0);
        let tracer = settings.tracer(8.0).unwrap();
        let camera = &settings.camera;
        let aberration = settings.lens_figures().unwrap().unwrap().pupil_aberration_per_mm;
        let mut near = 0;
        for center in tracer.centers() {
            let c = &center.center;
            let lens = tracer.micro_lens(c.k, c.l).unwrap().center;
            let off = |aberration: f64| {
                let seen = aberration * lens.xy().coords.norm_squared();
                let to_lens = camera.pupil_to_mla_mm() + seen;
                let scale = 1.0 + camera.mla.mla_to_sensor_mm / to_lens;
                let shift = lens.xy().coords * scale / camera.sensor.pixel_size_mm;
                let model = camera.mla.principal_point_px - shift;
                (c.u_px - model.x).hypot(c.v_px - model.y)
            };
            let height = lens.xy().coords.norm() / camera.main_lens.focal_length_mm;
            let [third, fifth] = [0.0, aberration].map(off);
            assert!(third < 40.0 * height.powi(3) + 1e-6, "{name}, {height}: {third} px");
            assert!(fifth < 40.0 * height.powi(5) + 1e-6, "{name}, {height}: {fifth} px");
            near += usize::from(height < 0.02);
        }
        assert!(near > 10, "{name}");
        let (shown, model) = (tracer.internal_parameters(), optics::internal_parameters(camera));
        assert!((shown.m_mm / model.m_mm - 1.0).abs() < 1e-9, "{name}");
    }
}

/// A lens of which all surfaces are decentred alike is a lens in another place.
#[test]
fn decentred_surfaces_move_the_lens() {
    let named = Prescription::named("double-gauss").unwrap();
    let traced = |moved: usize, factor: f64, offset: Vector2<f64>| {
        let mut prescription = named.clone();
        for surface in prescription.surfaces.iter_mut().rev().take(moved) {
            surface.decentre_mm = [0.1 * factor, -0.06 * factor];
        }
        let lens = RealLens::new(&prescription, 100.0, 4.0).unwrap();
        let slope = Vector2::new(-0.05, 0.02);
        let ray = Ray { at_lens: Vector2::new(3.0, 2.0) + offset, slope };
        lens.object_ray(&ray).unwrap()
    };
    let offset = Vector2::new(0.1, -0.06) * (100.0 / 100.004);
    let (before, after) =
        (traced(0, 0.0, Vector2::zeros()), traced(named.surfaces.len(), 1.0, offset));
    assert!((after.slope - before.slope).norm() < 1e-7);
    assert!((after.at_lens - before.at_lens - offset).norm() < 1e-5);
    // The last element alone deviates the ray in proportion to its decentre.
    let [once, twice] =
        [1.0, 2.0].map(|factor| traced(2, factor, Vector2::zeros()).slope - before.slope);
    assert!(once.norm() > 2e-4 && (twice - once * 2.0).norm() < 0.02 * once.norm(), "{once}");
}

#[test]
fn impossible_lenses_are_rejected_by_name() {
    let change = |from: &str, to: &str| {
        assert!(PLANO_CONVEX.contains(from));
        Prescription::from_toml(&PLANO_CONVEX.replace(from, to)).unwrap_err().to_string()
    };
    for (error, words) in [
        (
            change("radius_mm = 50.0", "radius_mm = 10.0"),
            "a sphere of radius 10 mm cannot have a semi-diameter",
        ),
        (
            change("radius_mm = 50.0", "radius_mm = nan"),
            "surface 2 of the lens: a sphere of radius NaN",
        ),
        (
            change("radius_mm = 50.0", "radius_mm = -50.0"),
            "focal length of the lens is not positive",
        ),
        (change("thickness_mm = 5.0", "thickness_mm = -5.0"), "the next surface is -5 mm"),
        (change("index = 1.5", "index = 0.5"), "a refractive index of 0.5"),
        (change("stop = true", "stop = false"), "the lens has 0 stops"),
        (
            change("stop = true", "stop = true, index = 1.5"),
            "the stop has to be a plane within one medium",
        ),
        (change("stop = true", "stoop = true"), "unknown field `stoop`"),
        (change("thickness_mm = 5.0", "thickness_mm = 200.0"), "upside down"),
        (change("    { semi_diameter_mm = 20.0 },\n", ""), "does not end in air"),
        (
            Prescription::named("planar").unwrap_err().to_string(),
            "give one of double-gauss, telephoto",
        ),
    ] {
        assert!(error.contains(words), "{error}");
    }
    let wide = RealLens::new(&prescription(PLANO_CONVEX), 100.0, 2.0).unwrap_err().to_string();
    assert!(wide.contains("the lens opens to f/2.50, but f/2"), "{wide}");
}

#[test]
fn a_camera_cannot_contradict_its_lens() {
    let rejected = |set: &str| {
        let settings = Settings::preset("mini-double-gauss", &[set.to_owned()]);
        let tracer = settings.and_then(|settings| settings.tracer(settings.board_f_number()));
        tracer.unwrap_err().to_string()
    };
    for (set, words) in [
        ("camera.main_lens.q1_per_mm2=1e-4", "follow from its surfaces"),
        ("camera.main_lens.exit_pupil_mm=[0, 0, 3]", "but its lens has it at z = 2.389"),
        ("camera.main_lens.f_number=2", "the lens opens to f/2.99"),
        ("camera.micro_lens_array.lens_to_mla_mm=6", "does not lie behind the main lens"),
        ("prescription=planar", "there is no lens 'planar'"),
        ("prescription=lens.toml", "read it, or give its surfaces"),
    ] {
        assert!(rejected(set).contains(words), "{set}: {}", rejected(set));
    }
}

/// Settings written to a file hold the surfaces, and are the same when read again.
#[test]
fn written_settings_hold_their_lens() {
    let settings = settings("mini-telephoto");
    let text = settings.to_toml().unwrap();
    assert!(text.contains("[[prescription.surfaces]]"));
    assert_eq!(Settings::from_toml(&text, &[]).unwrap(), settings);
    let file = "surfaces = [{ radius_mm = 50.0, thickness_mm = 1.0, index = 1.5, semi_diameter_mm = 9.0 }, \
                { semi_diameter_mm = 9.0, thickness_mm = 0.1 }, { stop = true, semi_diameter_mm = 9.0 }]";
    let set = ["prescription=a.toml".to_owned(), "camera.main_lens.f_number=8".to_owned()];
    let read = |name: &str| {
        assert_eq!(name, "a.toml");
        Ok(file.to_owned())
    };
    let other = Settings::preset_and_files("mini-double-gauss", &set, &read).unwrap();
    assert_eq!(other.prescription, Some(prescription(file)));
    assert!(other.camera.main_lens.exit_pupil_mm.z.abs() < 1.0);
    let _: Tracer = other.tracer(8.0).unwrap();
}
