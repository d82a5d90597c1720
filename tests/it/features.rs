//! Features: from corners to the board on the real observations, and from images to features on
//! simulated ones.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use nalgebra::{Matrix2, Vector2};
use plenocal::camera::{Board, Configuration, Sensor};
use plenocal::features::{
    LatticePoint, Sight, TiedBoard, dbscan, groups_on_lines, median_inverse_virtual_depth,
};
use plenocal::io::{read_centers, read_features, read_internal_parameters};
use plenocal::lattice::LatticeKind;
use plenocal::observations::BapFeature;
use plenocal::precalibration::{MicroImageArray, fit_grid};

const R12: Sensor = Sensor { width_px: 4080, height_px: 3068, pixel_size_mm: 0.0055 };

fn r12a(name: &str) -> std::path::PathBuf {
    Path::new(&std::env::var_os("PLENOCAL_R12A").expect("PLENOCAL_R12A is set")).join(name)
}

fn observed() -> (MicroImageArray, Vec<BapFeature>) {
    let centers = read_centers(&r12a("center-R12-A.csv")).unwrap();
    let grid = fit_grid(&centers, LatticeKind::HexagonalRows, 176, 152).unwrap();
    (grid, read_features(&r12a("bap-R12-A.csv"), true).unwrap().features)
}

fn sight(grid: &MicroImageArray, f: &BapFeature) -> Sight {
    Sight {
        k: f.k,
        l: f.l,
        center: grid.center_of(f.k, f.l),
        position: Vector2::new(f.u_px, f.v_px),
        std_dev_px: 0.5,
        squares: Matrix2::zeros(),
    }
}

#[test]
#[cfg_attr(not(plenocal_r12a), ignore = "set PLENOCAL_R12A to the folder of the real data set")]
fn real_corners_are_clustered_and_tied_as_published() {
    let (grid, features) = observed();
    let board = Board { columns: 9, rows: 5, square_mm: 10.0 };
    let frames: BTreeSet<u32> = features.iter().map(|f| f.frame).collect();
    assert_eq!(frames.len(), 16);
    for frame in frames {
        let of_frame: Vec<&BapFeature> = features.iter().filter(|f| f.frame == frame).collect();
        let sights: Vec<Sight> = of_frame.iter().map(|f| sight(&grid, f)).collect();
        let places: Vec<Vector2<f64>> = sights.iter().map(|s| s.position).collect();
        let clusters = dbscan(&places, 1.5 * grid.pitch_px, 2);
        let mut by_cluster: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
        for (i, cluster) in clusters.iter().enumerate() {
            if let Some(cluster) = cluster {
                by_cluster.entry(*cluster).or_default().push(i);
            }
        }
        let groups: Vec<_> = by_cluster
            .values()
            .flat_map(|c| groups_on_lines(&sights, c, 5.0, 2, Configuration::Galilean))
            .collect();
        let points: Vec<LatticePoint> = groups
            .iter()
            .map(|g| LatticePoint { place: g.line.pinhole(), squares: Matrix2::zeros() })
            .collect();
        let tied = TiedBoard::tie(&points, &board, &R12, 60.0)
            .unwrap_or_else(|why| panic!("frame {frame}: {why}"));
        let mut same = 0;
        let mut turned = 0;
        let mut all = 0;
        for (group, corner) in groups.iter().zip(&tied.corners) {
            let Some(corner) = corner else { continue };
            for &i in &group.members {
                all += 1;
                same += usize::from(of_frame[i].corner == *corner);
                turned += usize::from(of_frame[i].corner == board.corners() - 1 - corner);
            }
        }
        println!(
            "frame {frame}: {} sights, {all} tied, {same} same, {turned} turned, {} clusters",
            sights.len(),
            by_cluster.len()
        );
        assert!(same == all || turned == all, "frame {frame}");
        assert!(all * 100 >= 97 * sights.len(), "frame {frame}: {all} of {}", sights.len());
    }
}

/// The constants of their file are rounded, and their grid is not known to the last digit.
const RHO_BOUND_PX: f64 = 0.006;

#[test]
#[cfg_attr(not(plenocal_r12a), ignore = "set PLENOCAL_R12A to the folder of the real data set")]
fn the_median_of_pairs_gives_the_published_blur_radii() {
    let (grid, features) = observed();
    let internal = read_internal_parameters(&r12a("params.js"), None).unwrap();
    let half_pitch = internal.micro_image_pitch_mm.unwrap() / 2.0 / R12.pixel_size_mm;
    let mut clusters: BTreeMap<(u32, i32), Vec<&BapFeature>> = BTreeMap::new();
    for f in &features {
        clusters.entry((f.frame, f.corner)).or_default().push(f);
    }
    let mut worst: f64 = 0.0;
    for members in clusters.values().filter(|members| members.len() > 1) {
        let sights: Vec<Sight> = members.iter().map(|f| sight(&grid, f)).collect();
        let inverse = median_inverse_virtual_depth(&sights).unwrap();
        for f in members {
            let lens_type = grid.lattice.lens_type(f.k, f.l, 3);
            let q = internal.q_prime_mm[lens_type] / R12.pixel_size_mm - half_pitch;
            worst = worst.max((half_pitch * inverse + q - f.rho_px).abs());
        }
    }
    println!("rho differs by up to {worst:.4} px");
    assert!(worst < RHO_BOUND_PX, "{worst} px");
}
