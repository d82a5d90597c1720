//! Tests of real pixels and boards: point spread, bent boards, moving boards.

use nalgebra::{Isometry3, Point3, Vector2, Vector3};

use super::data_set::DataSet;
use super::ray::Passage;
use super::scene::{PlacedTarget, Scene};
use super::settings::Settings;
use super::{Imperfections, Target, Tracer};
use crate::image::Image;

/// Returns a preset with one micro-lens and a small sensor.
fn one_micro_lens(name: &str) -> Settings {
    let mut settings = Settings::preset(name, &[]).unwrap();
    let camera = &mut settings.camera;
    camera.mla.rotation_rad.fill(0.0);
    camera.mla.offset_mm.fill(0.0);
    (camera.lattice.columns, camera.lattice.rows) = (1, 1);
    (camera.sensor.width_px, camera.sensor.height_px) = (60, 56);
    camera.mla.principal_point_px = camera.sensor.center_px();
    settings
}

/// Returns the total light of an image, its centroid, and its variances along u, along v and across both, px².
fn moments(image: &Image) -> (f64, Vector2<f64>, [f64; 3]) {
    let sum = |of: &dyn Fn(f64, f64) -> f64| -> f64 {
        let places = (0..image.height).flat_map(|v| (0..image.width).map(move |u| (u, v)));
        places.map(|(u, v)| f64::from(image.at(u, v)) * of(u as f64, v as f64)).sum()
    };
    let light = sum(&|_, _| 1.0);
    let (u0, v0) = (sum(&|u, _| u) / light, sum(&|_, v| v) / light);
    let square = [
        sum(&|u, _| (u - u0).powi(2)),
        sum(&|_, v| (v - v0).powi(2)),
        sum(&|u, v| (u - u0) * (v - v0)),
    ];
    (light, Vector2::new(u0, v0), square.map(|s| s / light))
}

/// A point spread adds the variance σ² along each axis to the spot of a white target behind a micro-lens, and keeps all of its
/// light.
#[test]
fn a_point_spread_widens_a_micro_image_by_its_variance() {
    // 8192 rays for each of a few hundred pixels. The cut at 4σ removes 0.1 % of σ².
    const NOISE_PX2: f64 = 4e-3;
    for name in ["mini", "keplerian", "mini-double-gauss"] {
        let settings = one_micro_lens(name);
        let image = |point_spread_px: f64| {
            let imperfections = Imperfections { point_spread_px, ..settings.imperfections };
            let lens = settings.prescription.as_ref();
            let tracer =
                Tracer::with_lens(&settings.camera, lens, 16.0, &imperfections, 0).unwrap();
            moments(&tracer.render(&Scene::White, 8192, 0, &|| ()).unwrap())
        };
        let (light, middle, variance) = image(0.0);
        for sigma in [0.3, 1.0_f64] {
            let (spread_light, spread_middle, spread) = image(sigma);
            assert!((spread_light / light - 1.0).abs() < 1e-3, "{name}: {spread_light} {light}");
            assert!((spread_middle - middle).norm() < 0.01, "{name}: {spread_middle} {middle}");
            for (axis, expected) in [sigma * sigma, sigma * sigma, 0.0].into_iter().enumerate() {
                let more = spread[axis] - variance[axis];
                let bound = NOISE_PX2 + 1.5e-3 * sigma * sigma;
                assert!((more - expected).abs() < bound, "{name}, {sigma}: {more}, {expected}");
            }
        }
    }
}

/// The spread changes nothing where all points that light is spread to have the same light.
#[test]
fn a_point_spread_leaves_the_middle_of_a_wide_micro_image() {
    let settings = one_micro_lens("mini");
    let middle = |point_spread_px: f64| {
        let imperfections =
            Imperfections { aperture_ratio: 0.3, point_spread_px, ..settings.imperfections };
        let tracer = Tracer::new(&settings.camera, 4.0, &imperfections, 0).unwrap();
        f64::from(tracer.render(&Scene::White, 256, 0, &|| ()).unwrap().at(30, 28))
    };
    // cos⁴ over 3 px of 60.
    assert!((middle(0.7) / middle(0.0) - 1.0).abs() < 3e-3, "{} {}", middle(0.7), middle(0.0));
    assert!(middle(5.0) / middle(0.0) < 0.9, "the micro-image has an end");
}

fn bent(target: &Target) -> Target {
    Target { sag_mm: [3.0, -2.0], twist_mm: 1.5, aspect: 0.05, ..*target }
}

fn pose() -> Isometry3<f64> {
    Isometry3::new(Vector3::new(-9.0, -7.0, 78.0), Vector3::new(0.3, -0.2, 0.1))
}

/// The ray from a true feature through the middle of the micro-lens ends in the corner of the bent board.
#[test]
fn rays_from_true_features_end_in_the_corners_of_a_bent_board() {
    // A hundredth of a pixel is a thousandth of a millimetre on the board.
    const MISSED_MM: f64 = 1e-3;
    for (name, exact) in [("mini", MISSED_MM), ("mini-double-gauss", MISSED_MM)] {
        let mut settings = Settings::preset(name, &[]).unwrap();
        settings.camera.mla.rotation_rad.fill(0.0);
        let tracer = settings.tracer(4.0).unwrap();
        let (target, pose) = (bent(&settings.target), pose());
        let board = PlacedTarget::new(&target, &pose, tracer.focal_length).unwrap();
        let features = tracer.features(0, &target, &pose);
        let (mut seen, mut furthest) = (0, 0.0_f64);
        for feature in features.iter().filter(|f| f.visible > 0.99).map(|f| f.feature) {
            let lens = tracer.micro_lens(feature.k, feature.l).unwrap();
            let local = |u, v| tracer.array.local(lens, &tracer.array.on_sensor(u, v));
            let pixel = local(feature.u_px, feature.v_px);
            let ray = tracer.through(lens, Vector2::zeros(), &pixel);
            let aim = tracer.lens.aim(&ray, &board, None);
            let Passage::Seen(outer) = tracer.lens.follow(&ray, aim.as_ref(), &board) else {
                continue;
            };
            let hit = board.hit(&outer).unwrap();
            let corner = pose * target.corner_mm(feature.corner);
            let miss = (hit - corner).norm();
            assert!(miss < exact, "{name}, corner {}: {miss} mm", feature.corner);
            let flat = pose * target.board().point_mm(feature.corner);
            furthest = furthest.max((corner - flat).norm());
            seen += 1;
        }
        assert!(seen > 50 && furthest > 2.0, "{name}: {seen}, {furthest} mm");
    }
}

/// The print of a bent board has its edges at the corners, with black and white by turns, and the brightness of its
/// illumination.
#[test]
fn a_bent_board_has_its_print_about_its_corners() {
    let settings = Settings::preset("mini", &[]).unwrap();
    let target = Target { uneven_light: [0.3, -0.2], ..bent(&settings.target) };
    let board = PlacedTarget::new(&target, &pose(), 16.2).unwrap();
    let [half_x, half_y] = [(target.columns - 1), (target.rows - 1)].map(|n| f64::from(n) / 2.0);
    for corner in 0..target.board().corners() {
        let (column, row) = (corner % target.columns, corner / target.columns);
        for (x, y) in [(-1, -1), (1, -1), (-1, 1), (1, 1)] {
            let [dx, dy] = [x, y].map(|side| 0.02 * f64::from(side) * target.square_mm);
            let at = target.corner_mm(corner).coords.xy() + Vector2::new(dx, dy);
            let height = target.surface().unwrap().height(&at);
            let point = pose() * Point3::from(at.push(height));
            let ray = super::ray::Ray::from(&point, point.xy().coords / point.z);
            let black = (column + row) % 2 == i32::from(x != y);
            let xi = (f64::from(column) + dx / target.square_mm) / half_x - 1.0;
            let eta = (f64::from(row) + dy / target.square_mm) / half_y - 1.0;
            let light = 1.0 + 0.3 * xi - 0.2 * eta;
            let expected = if black { target.black } else { target.white } * light;
            // The aspect stretches the print by 5 % of a fiftieth of a square.
            let radiance = board.radiance(&ray);
            assert!((radiance / expected - 1.0).abs() < 1e-2, "{corner}: {radiance}, {expected}");
        }
    }
}

#[test]
fn a_board_bent_away_from_the_camera_is_rejected() {
    let settings = Settings::preset("mini", &[]).unwrap();
    let target = Target { sag_mm: [2.0, -2.0], ..settings.target };
    let steep = Isometry3::new(Vector3::new(-9.0, -7.0, 75.0), Vector3::new(0.6, -0.4, 0.3));
    let error = PlacedTarget::new(&target, &steep, 16.2).unwrap_err().to_string();
    assert!(error.contains("sees the back of a part of the bent board"), "{error}");
    let target = Target { sag_mm: [1.0, 1.0], ..settings.target };
    let near = Isometry3::new(Vector3::new(-10.5, -6.0, 17.0), Vector3::zeros());
    assert!(PlacedTarget::new(&target, &near, 16.2).is_ok());
    // The ends of the board bend towards the camera, into the focal length.
    let target = Target { sag_mm: [-1.0, -1.0], ..settings.target };
    let error = PlacedTarget::new(&target, &near, 16.2).unwrap_err().to_string();
    assert!(error.contains("within the focal length"), "{error}");
}

/// The truth of a board holds in the middle of its motion. Its light is spread evenly along its way, with the variance of a
/// twelfth of the squared way, less a 64th for eight moments.
#[test]
fn a_board_that_moves_is_blurred_along_its_way() {
    let mut settings = one_micro_lens("mini");
    settings.rays = 4096;
    // Small openings show all of the pupil over several pixels.
    settings.imperfections.aperture_ratio = 0.3;
    // The target is a white spot.
    let (columns, rows, square_mm) = (2, 2, 0.3);
    let (border_mm, white, black, background) = (0.0, 1.0, 0.0, 0.0);
    settings.target =
        Target { columns, rows, square_mm, border_mm, white, black, background, ..settings.target };
    settings.boards.motion_px = 10.0;
    settings.boards.min_in_view = 0.0;
    let pose = Isometry3::new(Vector3::new(0.0, 0.0, 78.0), Vector3::zeros());
    let poses = vec![crate::model::FramePose { frame: 3, camera_from_board: pose }];
    let data_set = DataSet::plan(&settings, Some(poses)).unwrap();
    let (_, shot) = data_set.subsets[0][0];
    let distance_px = shot.motion_mm.norm() / 78.0 * (18.5 + 0.33) / 0.0055;
    assert!((distance_px - 10.0).abs() < 1e-9, "{distance_px}");
    assert!(data_set.subsets[2].iter().all(|(_, shot)| shot.motion_mm == Vector2::zeros()));

    let tracer = settings.tracer(4.0).unwrap();
    let spot = |way: Vector2<f64>| {
        let point = Point3::from(way.push(78.0));
        tracer.spot(&point, 0, 0).unwrap().center_px
    };
    let way = spot(shot.motion_mm / 2.0) - spot(-shot.motion_mm / 2.0);
    let image = |shot: &super::Shot| moments(&shot.irradiance(&settings, 1, &|| ()).unwrap());
    let (still_light, still_middle, still) =
        image(&super::Shot { motion_mm: Vector2::zeros(), ..shot });
    let (light, middle, moved) = image(&shot);
    assert!((light / still_light - 1.0).abs() < 0.02, "{light} {still_light}");
    assert!((middle - still_middle).norm() < 0.05, "{middle} {still_middle}");
    let even = (1.0 - 1.0 / 64.0) / 12.0;
    for (axis, square) in [way.x * way.x, way.y * way.y, way.x * way.y].into_iter().enumerate() {
        let (more, expected) = (moved[axis] - still[axis], even * square);
        assert!((more - expected).abs() < 0.04 * even * way.norm_squared(), "{more} {expected}");
    }
}
