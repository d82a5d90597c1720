//! The ray tracer against the closed-form projection of the C++ core; they share no code.

use std::collections::HashMap;

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use plenocal::image::Image;
use plenocal::model::{BapFeature, Board, FramePose, PlenopticCamera, optics};
use plenocal::simulation::{Imperfections, Scene, Settings, Target, Tracer};
use plenocal::solver::synthesize;

use crate::support::{NO_NOISE, preset};

type Pose = Isometry3<f64>;

/// Without tilt both are the same geometry: what is left is rounding, 1e-16 of 60 mm seen through
/// pixels of 1.4 µm and a virtual depth up to 100.
const ROUNDING_PX: f64 = 1e-9;

/// The closed form takes every micro-lens as parallel to the sensor. A tilt θ moves the rim of a
/// micro-lens of radius r by θr along the axis and changes distances along oblique rays by θ times
/// their slope σ. To first order centre and radius of the spot change by no more than θ r/s times
/// the sum of σ δ/f, σ |ρ|s/r and r (1/f + 1/|a|), which is below 1 for the cameras here (σ < 0.3,
/// δ/f < 1.4, |ρ| < r, r/f < 0.3, r/|a| < 0.15).
fn bound_px(camera: &PlenopticCamera) -> f64 {
    let tilt = camera.mla.rotation_rad.xy().norm();
    tilt * camera.mla.pitch_mm / (2.0 * camera.sensor.pixel_size_mm) + ROUNDING_PX
}

/// A frontal board, a near and tilted one, and a far and rotated one.
fn poses(settings: &Settings) -> Vec<FramePose> {
    let [near, far] = settings.boards.depth_mm;
    let board = settings.target.board();
    let half = board.point_mm(board.corners() - 1).coords / 2.0;
    [([0.0, 0.0, 0.0], f64::midpoint(near, far)), ([0.5, 0.3, 0.1], near), ([-0.2, 0.6, 2.5], far)]
        .into_iter()
        .zip(0..)
        .map(|((turn, z), frame)| {
            let place = Isometry3::from_parts(
                Translation3::new(0.02 * z, -0.01 * z, z),
                UnitQuaternion::from_scaled_axis(Vector3::from(turn)),
            );
            FramePose { frame, camera_from_board: place * Translation3::from(-half) }
        })
        .collect()
}

/// The largest differences in centre and radius over all features that the model projects, and the
/// number of these features.
fn differences(camera: &PlenopticCamera, board: &Board, poses: &[FramePose]) -> (f64, f64, usize) {
    let observations = synthesize(camera, board, poses, &NO_NOISE, 0).unwrap();
    let f_number = camera.main_lens.setting.unwrap().f_number;
    let tracer = Tracer::new(camera, f_number, &Imperfections::default(), 0).unwrap();
    let (mut center, mut radius) = (0.0_f64, 0.0_f64);
    for f in &observations.features {
        let point = poses[f.frame as usize].camera_from_board * board.point_mm(f.corner);
        let spot = tracer.spot(&point, f.k, f.l).unwrap();
        center = center.max((spot.center_px.x - f.u_px).hypot(spot.center_px.y - f.v_px));
        radius = radius.max((spot.radius_px - f.rho_px.unwrap()).abs());
    }
    (center, radius, observations.features.len())
}

#[test]
fn traced_spots_lie_where_the_closed_form_projects_them() {
    for name in ["mini", "keplerian", "r12-a", "r12-b", "r12-c", "lytro-like"] {
        let settings = preset(name, &[]);
        let mut poses = poses(&settings);
        if name == "lytro-like" {
            poses.truncate(1); // every corner is seen by a thousand micro-lenses
        }
        for (tilt, pitch_ratio, curvature, lens_tilt) in [
            (0.0, 1.0, 0.0, 0.0),
            (0.0, 1.01, 3e-3, 0.01),
            (1.0, 1.0, 0.0, 0.0),
            (1.0, 1.0, 3e-3, 0.01),
            (10.0, 0.99, 0.0, 0.02),
        ] {
            let mut camera = settings.camera.clone();
            camera.main_lens.field_curvature_per_mm = curvature;
            camera.main_lens.exit_pupil_mm.z = -1e3 * curvature;
            camera.main_lens.rotation_rad = [lens_tilt, -0.7 * lens_tilt];
            camera.mla.rotation_rad.x *= tilt;
            camera.mla.rotation_rad.y *= tilt;
            camera.mla.pitch_ratio = pitch_ratio;
            let (center, radius, count) = differences(&camera, &settings.target.board(), &poses);
            let bound = bound_px(&camera);
            println!(
                "{name}, tilt {:.1} mrad: {count} features, centre {center:.1e} px, radius \
                 {radius:.1e} px, bound {bound:.1e} px",
                camera.mla.rotation_rad.xy().norm() * 1e3
            );
            assert!(count > 200, "{name} shows only {count} features");
            assert!(center < bound && radius < bound, "{name}: {center}, {radius} px");
        }
    }
}

/// About a thousand rays hit a tiny board through a micro-lens, spread over a disc of 2 to 5 px: the
/// middle is known to 2/√1000, and the light that oblique rays lose shifts it by a hundredth of the
/// radius.
const RENDERED_PX: f64 = 0.1;
/// Limits for averages over the micro-images of all boards.
const RENDERED_MEAN_PX: f64 = 0.03;

/// A tiny board in one micro-image, by the closed form or by the traced truth.
struct Spot {
    lens: (i32, i32),
    u_px: f64,
    v_px: f64,
    rho_px: f64,
    /// Spread of the board's own pattern along one axis, px².
    pattern_px2: f64,
}

/// The tiny board in the micro-images that receive all its light.
fn whole_spots(corners: &[BapFeature], tracer: &Tracer, target: &Target, pose: &Pose) -> Vec<Spot> {
    let mut by_micro_image: HashMap<(i32, i32), Vec<_>> = HashMap::new();
    for f in corners {
        by_micro_image.entry((f.k, f.l)).or_default().push(f);
    }
    let half = target.square_mm / 2.0;
    let is_whole =
        |(k, l)| tracer.spot(&(pose * Point3::new(half, half, 0.0)), k, l).unwrap().visible > 0.999;
    by_micro_image
        .into_iter()
        .filter(|(lens, corners)| corners.len() == 4 && is_whole(*lens))
        .map(|(lens, corners)| {
            let mean = |f: fn(&BapFeature) -> f64| corners.iter().map(|c| f(c)).sum::<f64>() / 4.0;
            // Four white squares beside the middle one: ½ + 1/12 of a square's edge squared along
            // each axis, here in the mean of both.
            let edge = |a: usize, b: usize| {
                (corners[a].u_px - corners[b].u_px).powi(2)
                    + (corners[a].v_px - corners[b].v_px).powi(2)
            };
            let pattern_px2 = (0.5 + 1.0 / 12.0) * (edge(0, 1) + edge(0, 2)) / 2.0 / 2.0;
            let (u_px, v_px) = (mean(|c| c.u_px), mean(|c| c.v_px));
            Spot { lens, u_px, v_px, rho_px: mean(|c| c.rho_px.unwrap()), pattern_px2 }
        })
        .collect()
}

/// Distance of the middle of the light from the closed form, and the radius that the disc would
/// have without pattern and pixels.
fn rendered(image: &Image, spot: &Spot) -> ([f64; 2], f64) {
    let reach = spot.rho_px.abs() + 2.0;
    let (mut sum, mut moment, mut spread) = (0.0, [0.0; 2], 0.0);
    for (y, x) in (0..image.height).flat_map(|y| (0..image.width).map(move |x| (y, x))) {
        let (dx, dy) = (x as f64 - spot.u_px, y as f64 - spot.v_px);
        if dx.hypot(dy) <= reach {
            let light = f64::from(image.at(x, y));
            sum += light;
            moment = [moment[0] + light * dx, moment[1] + light * dy];
            spread += light * (dx * dx + dy * dy);
        }
    }
    let [du, dv] = moment.map(|m| m / sum);
    let variance = (spread / sum - du * du - dv * dv) / 2.0;
    ([du, dv], 2.0 * (variance - spot.pattern_px2 - 1.0 / 12.0).max(0.0).sqrt())
}

/// A board of one square, tilted, of the same size in the image at any distance.
fn tiny_board(z: f64, (x, y): (f64, f64)) -> (Target, Pose) {
    let target = Target {
        columns: 2,
        rows: 2,
        square_mm: 0.05 * z / 70.0,
        border_mm: 0.0,
        white: 1.0,
        black: 0.0,
        background: 0.0,
        sag_mm: [0.0; 2],
        twist_mm: 0.0,
        aspect: 0.0,
        uneven_light: [0.0; 2],
    };
    let turn = UnitQuaternion::from_euler_angles(0.4, -0.3, 0.2);
    (target, Isometry3::from_parts(Translation3::new(x * z, y * z, z), turn))
}

/// The light of a tiny board, rendered: its middle lies where the closed form projects it, and its
/// spread is that of a disc of radius |ρ|, of the board's own pattern and of a pixel.
#[test]
fn rendered_spots_have_the_centre_and_radius_of_the_closed_form() {
    let mut compared = 0;
    for (name, depths) in [("mini", [68.0, 80.0]), ("keplerian", [190.0, 300.0])] {
        let mut camera = preset(name, &[]).camera;
        // A small part of the array about the axis, which is not the middle of the array.
        (camera.lattice.columns, camera.lattice.rows) = (7, 6);
        (camera.sensor.width_px, camera.sensor.height_px) = (120, 90);
        camera.mla.principal_point_px = camera.sensor.center_px().add_scalar(7.0);
        let tracer = Tracer::new(&camera, 4.0, &Imperfections::default(), 0).unwrap();
        let mut errors = Vec::new();
        let places = [(0.01, -0.005), (-0.006, 0.004)];
        for (z, place) in depths.into_iter().flat_map(|z| places.map(|place| (z, place))) {
            let (target, pose) = tiny_board(z, place);
            let image = tracer.render(&Scene::Board(target, pose), 8192, 1, &|| ()).unwrap();
            let frame = FramePose { frame: 0, camera_from_board: pose };
            let corners = synthesize(&camera, &target.board(), &[frame], &NO_NOISE, 0).unwrap();
            for spot in whole_spots(&corners.features, &tracer, &target, &pose) {
                let ([du, dv], radius) = rendered(&image, &spot);
                let (rho, (k, l)) = (spot.rho_px, spot.lens);
                println!(
                    "{name}, {z} mm, ({k}, {l}): off by {du:+.3}, {dv:+.3} px; radius {radius:.3} \
                     px for {rho:+.3} px"
                );
                assert!(du.abs() < RENDERED_PX && dv.abs() < RENDERED_PX, "{name} ({k}, {l})");
                // A spot as small as the pattern has no meaningful radius.
                if rho.abs() > 1.5 {
                    let off = radius - rho.abs();
                    assert!(off.abs() < RENDERED_PX, "{name} ({k}, {l}): {radius}");
                }
                errors.push([du, dv]);
            }
        }
        let mean = |i: usize| errors.iter().map(|e| e[i]).sum::<f64>() / errors.len() as f64;
        assert!(mean(0).abs() < RENDERED_MEAN_PX && mean(1).abs() < RENDERED_MEAN_PX);
        compared += errors.len();
    }
    assert!(compared >= 12, "only {compared} spots are whole");
}

/// The light of a tiny board through a real lens, off the axis: its middle lies where the truth says, which
/// follows rays through the middles of the micro-lenses only. (cos⁴ would draw it 0.03 px inwards.)
#[test]
#[ignore = "slow: simulates large images; run by `make test-slow`"]
fn rendered_spots_of_real_lenses_have_the_true_centre() {
    for name in ["mini-double-gauss", "mini-telephoto"] {
        let mut settings = preset(name, &["imperfections.fall_off=none"]);
        let camera = &mut settings.camera;
        // A small part of the array, 2 mm from the axis.
        (camera.lattice.columns, camera.lattice.rows) = (7, 6);
        (camera.sensor.width_px, camera.sensor.height_px) = (120, 90);
        let off_px = nalgebra::Vector2::new(300.0, 220.0);
        camera.mla.principal_point_px = camera.sensor.center_px() + off_px;
        let to_pupil = camera.pupil_to_mla_mm();
        let shrink = to_pupil / (to_pupil + camera.mla.mla_to_sensor_mm);
        camera.mla.offset_mm = off_px * (camera.sensor.pixel_size_mm * shrink);
        let direction = -camera.mla.offset_mm / camera.mla.lens_to_mla_mm;
        let tracer = settings.tracer(4.0).unwrap();
        let (mut compared, mut sum) = (0, [0.0; 2]);
        for z in [68.0, 80.0] {
            let (target, pose) = tiny_board(z, (direction.x, direction.y));
            let image = tracer.render(&Scene::Board(target, pose), 8192, 1, &|| ()).unwrap();
            let truth = tracer.features(0, &target, &pose);
            let corners: Vec<BapFeature> = truth.iter().map(|t| t.feature).collect();
            for spot in whole_spots(&corners, &tracer, &target, &pose) {
                let ([du, dv], radius) = rendered(&image, &spot);
                let (rho, (k, l)) = (spot.rho_px, spot.lens);
                println!(
                    "{name}, {z} mm, ({k}, {l}): off by {du:+.3}, {dv:+.3} px; radius {radius:.3} \
                     px for {rho:+.3} px"
                );
                assert!(du.abs() < RENDERED_PX && dv.abs() < RENDERED_PX, "{name} ({k}, {l})");
                // The disc is an ellipse, and as large in the mean.
                assert!(rho.abs() < 1.5 || (radius - rho.abs()).abs() < 2.0 * RENDERED_PX);
                sum = [sum[0] + du, sum[1] + dv];
                compared += 1;
            }
        }
        assert!(compared >= 4, "{name}: only {compared} spots are whole");
        assert!(sum.iter().all(|s| (s / f64::from(compared)).abs() < RENDERED_MEAN_PX), "{sum:?}");
    }
}

#[test]
fn traced_centres_lie_where_the_closed_form_projects_them() {
    let pupils = [[0.0; 3], [0.0, 0.0, -5.0], [0.3, -0.2, 7.0]];
    let names = ["mini", "keplerian", "r12-b", "lytro-like"];
    for (name, pupil) in names.into_iter().flat_map(|name| pupils.map(|pupil| (name, pupil))) {
        let mut settings = preset(name, &[]);
        settings.camera.main_lens.exit_pupil_mm = pupil.into();
        settings.camera.main_lens.rotation_rad = [3e-3 * pupil[2], 0.02 - 1e-3 * pupil[2]];
        let camera = &settings.camera;
        let f_number = settings.board_f_number();
        let tracer = Tracer::new(camera, f_number, &Imperfections::default(), 0).unwrap();
        let traced = tracer.centers();
        let projected =
            synthesize(camera, &settings.target.board(), &[], &NO_NOISE, 0).unwrap().centers;
        let traced: HashMap<_, _> = traced.iter().map(|t| ((t.center.k, t.center.l), t)).collect();
        for c in &projected {
            let t = traced[&(c.k, c.l)];
            let miss = (t.center.u_px - c.u_px).hypot(t.center.v_px - c.v_px);
            assert!(miss < ROUNDING_PX, "{name} ({}, {}): {miss} px", c.k, c.l);
            assert_eq!(t.lens_type, camera.lens_type(c.k, c.l));
        }
    }
}

/// The outer edge of a micro-image of white is where the outermost ray arrives; the radius of the paper,
/// |m/N + qᵢ|, has m negative in Galilean configuration. Light fades out towards the edge with the
/// power 3/2 of the distance, so that the outermost lit pixel lies up to two (fine) pixels inside.
#[test]
fn micro_images_of_white_have_the_radius_of_the_paper() {
    const FINE: f64 = 8.0;
    const EDGE_PX: f64 = 2.0 / FINE;
    for (name, side) in [("mini", -1.0), ("keplerian", 1.0)] {
        let settings = preset(name, &[]);
        let mut camera = settings.camera.clone();
        camera.mla.rotation_rad.fill(0.0);
        camera.mla.offset_mm.fill(0.0);
        // A few micro-lenses of each type about the axis, on pixels an eighth the size.
        (camera.lattice.columns, camera.lattice.rows) = (3, 2);
        camera.sensor.pixel_size_mm /= FINE;
        (camera.sensor.width_px, camera.sensor.height_px) = (700, 500);
        camera.mla.principal_point_px = camera.sensor.center_px();
        let internal = optics::internal_parameters(&camera);
        let half_pitch = internal.micro_image_pitch_mm.unwrap() / 2.0;
        for &f_number in &settings.white_images.f_numbers {
            let tracer = Tracer::new(&camera, f_number, &Imperfections::default(), 0).unwrap();
            let white = tracer.render(&Scene::White, 256, 1, &|| ()).unwrap();
            for center in tracer.centers() {
                let (k, l) = (center.center.k, center.center.l);
                let q = internal.q_prime_mm[center.lens_type] - half_pitch;
                let expected = (side * internal.m_mm / f_number + q).abs()
                    / camera.sensor.pixel_size_mm
                    / FINE;
                // Search away from the neighbours, whose micro-images may touch.
                let outwards = [f64::from(k - 1), f64::from(2 * l - 1)];
                let lit = (0..white.height)
                    .flat_map(|v| (0..white.width).map(move |u| (u, v)))
                    .filter(|&(u, v)| white.at(u, v) > 0.0)
                    .map(|(u, v)| (u as f64 - center.center.u_px, v as f64 - center.center.v_px))
                    .filter(|(u, v)| u * outwards[0] + v * outwards[1] > 0.9 * u.hypot(*v))
                    .map(|(u, v)| u.hypot(v) / FINE)
                    .fold(0.0, f64::max);
                println!("{name} f/{f_number:.2} type {}: {lit:.2} px", center.lens_type + 1);
                assert!(
                    lit < expected + 1.0 / FINE && lit > expected - EDGE_PX,
                    "{name} f/{f_number:.2}, ({k}, {l}): {lit} px for {expected} px"
                );
            }
        }
    }
}
