//! Comparison of points and rays with the forward model.

#![allow(clippy::cast_sign_loss, clippy::ref_option)] // indices; options as they are given

use nalgebra::{Isometry3, Point3, Vector2, Vector3};

use crate::model::{BapFeature, BentBoard, Board, BoardShape, PlenopticCamera, small_camera};
use crate::solver::{
    Corners, Loss, LossKind, MetricPoint, MicroPixel, SeenPoint, Sighting, SolverFeature,
    VirtualPoint, corners, metric_points, micro_images_at, object_rays, triangulate,
    virtual_depths, visible_features,
};

const BOARD: Board = Board { columns: 6, rows: 4, square_mm: 3.0 };
const NEAR_MM: f64 = 1e-7;

/// Creates a simulated camera, corners of a tilted board, and all their sightings, without noise.
fn scene() -> (PlenopticCamera, Vec<Point3<f64>>, Vec<SeenPoint>) {
    let camera = small_camera();
    let pose = Isometry3::new(Vector3::new(-8.0, -5.0, 90.0), Vector3::new(0.3, -0.4, 0.1));
    let board = BentBoard { board: BOARD, shape: BoardShape::default() };
    let corners: Vec<Point3<f64>> = (0..BOARD.corners()).map(|i| BOARD.point_mm(i)).collect();
    let sightings = corners.iter().map(|corner| {
        let seen = visible_features(&camera, &board, &[pose], &[*corner], 1.0).unwrap();
        let sighting = |f: &SolverFeature| Sighting {
            at: MicroPixel { k: f.k, l: f.l, u_px: f.u_px, v_px: f.v_px },
            rho_px: f.rho_px,
            std_dev_px: [0.1, 0.1, 0.2],
            correlation: 0.2,
        };
        SeenPoint { sightings: seen.iter().map(sighting).collect(), rho_std_dev_px: 0.0 }
    });
    let sightings = sightings.collect();
    (camera, corners.iter().map(|corner| pose * corner).collect(), sightings)
}

/// An outlier hardly moves a corner, and σ follows the scatter: without noise it is nearly 0.
#[test]
fn false_sightings_are_withstood_and_scatter_scales_sigma() {
    let (camera, points, mut seen) = scene();
    let exact = corners(&camera, &features(&seen, None)).unwrap();
    assert!(exact.scatter < 1e-6, "{}", exact.scatter);
    let i = seen.iter().position(|seen| seen.sightings.len() > 8).unwrap();
    seen[i].sightings[3].at.u_px += 3.0;
    let found = corners(&camera, &features(&seen, None)).unwrap();
    let plain = Loss { kind: LossKind::None, scale: 1.0 };
    let least_squares = triangulate(&camera, &seen, plain).unwrap();
    let of = |corners: &Corners| {
        let at = corners.labels.iter().position(|label| label.1 as usize == i).unwrap();
        off(&corners.points[at].unwrap(), &points[i])
    };
    assert!(of(&exact) < NEAR_MM);
    assert!(of(&found) < 0.3 * off(&least_squares[i].unwrap(), &points[i]), "{}", of(&found));
    assert!(found.scatter > 1e-6, "{}", found.scatter);
}

/// σ along the axis follows from σ of ρ, independently of the sightings; the point stays.
#[test]
fn what_sightings_share_is_in_the_depth() {
    const RHO_STD_DEV_PX: f64 = 0.5;
    let (camera, _, seen) = scene();
    let alone = corners(&camera, &features(&seen, None)).unwrap();
    let shared = corners(&camera, &features(&seen, Some(RHO_STD_DEV_PX))).unwrap();
    for ((label, alone), shared) in alone.labels.iter().zip(&alone.points).zip(&shared.points) {
        let (Some(alone), Some(shared)) = (alone, shared) else { continue };
        let at = seen[label.1 as usize].sightings[0].at;
        // Derivative of rho by z, from two virtual depths: rho = q' - dC/2s/nu.
        let step = Vector3::new(0.0, 0.0, 0.01);
        let depths = virtual_depths(
            &camera,
            &[-step, step].map(|s| (at, Point3::from(shared.point_mm) + s)),
        );
        let [near, far] = depths.unwrap()[..] else { panic!("two depths") };
        let half_px = camera.mla.pitch_mm / 2.0 / camera.sensor.pixel_size_mm;
        let slope = half_px * (1.0 / far.unwrap() - 1.0 / near.unwrap()) / (2.0 * step.z);
        let expected = RHO_STD_DEV_PX / slope.abs();
        let std_dev = shared.std_devs_mm()[2];
        assert!((std_dev / expected - 1.0).abs() < 1e-2, "{std_dev} mm for {expected}");
        assert!(off(alone, &shared.point_mm.into()) < NEAR_MM);
    }
    let negative = SeenPoint { rho_std_dev_px: -1.0, ..seen[0].clone() };
    let plain = Loss { kind: LossKind::None, scale: 1.0 };
    assert!(triangulate(&camera, &[negative], plain).is_err());
}

fn off(found: &MetricPoint, truth: &Point3<f64>) -> f64 {
    (Point3::from(found.point_mm) - truth).norm()
}

/// Returns the features that a detection would state.
fn features(seen: &[SeenPoint], rho_std_dev_px: Option<f64>) -> Vec<BapFeature> {
    let of = |(corner, point): (usize, &SeenPoint)| {
        let feature = move |s: &Sighting| BapFeature {
            frame: 0,
            corner: i32::try_from(corner).unwrap(),
            k: s.at.k,
            l: s.at.l,
            u_px: s.at.u_px,
            v_px: s.at.v_px,
            rho_px: None,
            std_dev_px: Some([s.std_dev_px[0], s.std_dev_px[1]]),
            correlation: s.correlation,
            rho_std_dev_px,
            sensitivities_px: None,
            blur: None,
        };
        point.sightings.iter().map(feature).collect::<Vec<_>>()
    };
    seen.iter().enumerate().flat_map(of).collect()
}

#[test]
fn corners_are_triangulated_and_lie_on_their_rays() {
    let (camera, points, sightings) = scene();
    let found =
        triangulate(&camera, &sightings, Loss { kind: LossKind::None, scale: 1.0 }).unwrap();
    let mut rays = 0;
    for ((point, sightings), found) in points.iter().zip(&sightings).zip(found) {
        let sightings = &sightings.sightings;
        if sightings.len() < 2 {
            assert!(found.is_none());
            continue;
        }
        let found = found.unwrap();
        assert!(off(&found, point) < NEAR_MM, "{found:?} for {point}");
        let [x, _, z] = found.std_devs_mm();
        assert!(z > x && z < 10.0, "{x} {z}");
        let pixels: Vec<MicroPixel> = sightings.iter().map(|s| s.at).collect();
        for ray in object_rays(&camera, &pixels, point.z).unwrap() {
            assert!((Point3::from(ray.unwrap().origin_mm) - point).norm() < NEAR_MM);
            rays += 1;
        }
        let places: Vec<Vector2<f64>> =
            pixels.iter().map(|p| Vector2::new(p.u_px, p.v_px)).collect();
        let expected: Vec<_> = pixels.iter().map(|p| Some((p.k, p.l))).collect();
        assert_eq!(micro_images_at(&camera, &places).unwrap(), expected);
    }
    assert!(rays > 50, "{rays}");
}

#[test]
fn what_is_not_seen_is_none_and_what_is_impossible_an_error() {
    let (camera, ..) = scene();
    let at = MicroPixel { k: 20, l: 18, u_px: 480.0, v_px: 370.0 };
    let outside = MicroPixel { k: -1, l: -1, ..at };
    let rays = object_rays(&camera, &[at, outside], 100.0).unwrap();
    assert!(rays[0].is_some() && rays[1].is_none());
    for z_mm in [0.0, camera.main_lens.focal_length_mm, f64::NAN, f64::INFINITY] {
        assert!(
            object_rays(&camera, &[at], z_mm).unwrap_err().to_string().contains("focal length")
        );
    }
    let seen = |virtual_depth: f64| VirtualPoint { at, virtual_depth, std_dev: [0.1, 0.1, 0.01] };
    let points = metric_points(&camera, &[seen(3.0), seen(f64::NAN)]).unwrap();
    assert!(points[0].is_some() && points[1].is_none());
    let negative = VirtualPoint { std_dev: [-1.0, 0.0, 0.0], ..seen(3.0) };
    assert!(metric_points(&camera, &[negative]).unwrap_err().to_string().contains("deviation"));
    assert_eq!(micro_images_at(&camera, &[Vector2::new(-1e6, 0.0)]).unwrap(), [None]);
}
