//! Tests from corners to the labelled board, on the real observations of the R12-A.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use nalgebra::{Matrix2, Vector2};

use super::board::{LabelledBoard, LatticePoint};
use super::dbscan::dbscan;
use super::grouping::{Group, LineSearch, groups_on_lines};
use super::line::median_inverse_virtual_depth;
use super::*;
use crate::model::{Board, Configuration, LatticeKind, MicroImageCenter, Sensor};
use crate::precalibration::{MicroImageArray, fit_grid};

const R12: Sensor = Sensor { width_px: 4080, height_px: 3068, pixel_size_mm: 0.0055 };

/// Published feature.
#[derive(serde::Deserialize)]
struct Published {
    k: i32,
    l: i32,
    u: f64,
    v: f64,
    rho: f64,
    #[serde(rename = "cluster")]
    corner: i32,
    frame: u32,
}

impl Published {
    fn observation(&self, grid: &MicroImageArray) -> CornerObservation {
        CornerObservation {
            k: self.k,
            l: self.l,
            center: grid.center_of(self.k, self.l),
            position: Vector2::new(self.u, self.v),
            covariance: Matrix2::identity() * 0.25,
            squares: Matrix2::zeros(),
        }
    }
}

fn r12a(name: &str) -> std::path::PathBuf {
    Path::new(&std::env::var_os("PLENOCAL_R12A").expect("PLENOCAL_R12A is set")).join(name)
}

fn rows<T: serde::de::DeserializeOwned>(name: &str) -> Vec<T> {
    csv::Reader::from_path(r12a(name)).unwrap().deserialize().collect::<Result<_, _>>().unwrap()
}

fn published() -> (MicroImageArray, Vec<Published>) {
    let center = |(k, l, u_px, v_px): (i32, i32, f64, f64)| MicroImageCenter {
        k,
        l,
        u_px,
        v_px,
        std_dev_px: None,
    };
    let centers: Vec<MicroImageCenter> = rows("center-R12-A.csv").into_iter().map(center).collect();
    let grid = fit_grid(&centers, LatticeKind::HexagonalRows, 176, 152).unwrap();
    (grid, rows("bap-R12-A.csv"))
}

#[test]
#[ignore = "needs PLENOCAL_R12A: make test"]
fn r12a_corners_are_clustered_and_labelled_as_published() {
    let (grid, features) = published();
    let board = Board { columns: 9, rows: 5, square_mm: 10.0 };
    let search = LineSearch {
        tolerance_px: 5.0,
        reach_px: grid.pitch_px / 2.0,
        micro_image_pitch_px: grid.pitch_px,
        configuration: Configuration::Galilean,
    };
    let frames: BTreeSet<u32> = features.iter().map(|f| f.frame).collect();
    assert_eq!(frames.len(), 16);
    for frame in frames {
        let of_frame: Vec<&Published> = features.iter().filter(|f| f.frame == frame).collect();
        let observations: Vec<CornerObservation> =
            of_frame.iter().map(|f| f.observation(&grid)).collect();
        let places: Vec<Vector2<f64>> = observations.iter().map(|o| o.position).collect();
        let clusters = dbscan(&places, 1.5 * grid.pitch_px, 2);
        let mut by_cluster: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
        for (i, cluster) in clusters.iter().enumerate() {
            if let Some(cluster) = cluster {
                by_cluster.entry(*cluster).or_default().push(i);
            }
        }
        let groups: Vec<Group> =
            by_cluster.values().flat_map(|c| groups_on_lines(&observations, c, &search)).collect();
        let points: Vec<LatticePoint> = groups
            .iter()
            .map(|g| LatticePoint { place: g.line.pinhole(), squares: Matrix2::zeros() })
            .collect();
        let in_view = |p: &Vector2<f64>| {
            R12.contains(p.x - 60.0, p.y - 60.0) && R12.contains(p.x + 60.0, p.y + 60.0)
        };
        let labelled = LabelledBoard::label(&points, &board, &in_view)
            .unwrap_or_else(|why| panic!("frame {frame}: {why}"));
        let (mut same, mut turned, mut all) = (0, 0, 0);
        for (group, corner) in groups.iter().zip(&labelled.corners) {
            let Some(corner) = corner else { continue };
            for &i in &group.members {
                all += 1;
                same += usize::from(of_frame[i].corner == *corner);
                turned += usize::from(of_frame[i].corner == board.corners() - 1 - corner);
            }
        }
        println!(
            "frame {frame}: {} observations, {all} labelled, {same} same, {turned} turned, {} \
             clusters",
            observations.len(),
            by_cluster.len()
        );
        assert!(same == all || turned == all, "frame {frame}");
        assert!(all * 100 >= 97 * observations.len(), "frame {frame}: {all}");
    }
}

/// Δc and q' of the published params.js.
const MICRO_IMAGE_PITCH_MM: f64 = 0.128_221_631_892_887_07;
const Q_PRIME_MM: [f64; 3] =
    [0.035_135_191_355_331_4, 0.040_268_205_527_647, 0.036_822_146_226_151_445];
/// Largest difference of ρ: the published λ is rounded, and the published grid is not known to the last digit.
const RHO_BOUND_PX: f64 = 0.006;

#[test]
#[ignore = "needs PLENOCAL_R12A: make test"]
fn r12a_median_of_pairs_gives_the_published_blur_radii() {
    let (grid, features) = published();
    let half_pitch = MICRO_IMAGE_PITCH_MM / 2.0 / R12.pixel_size_mm;
    let mut clusters: BTreeMap<(u32, i32), Vec<&Published>> = BTreeMap::new();
    for f in &features {
        clusters.entry((f.frame, f.corner)).or_default().push(f);
    }
    let mut worst: f64 = 0.0;
    for members in clusters.values().filter(|members| members.len() > 1) {
        let observations: Vec<CornerObservation> =
            members.iter().map(|f| f.observation(&grid)).collect();
        let inverse = median_inverse_virtual_depth(&observations).unwrap();
        for f in members {
            let lens_type = grid.lattice.lens_type(f.k, f.l, 3);
            let q = Q_PRIME_MM[lens_type] / R12.pixel_size_mm - half_pitch;
            worst = worst.max((half_pitch * inverse + q - f.rho).abs());
        }
    }
    println!("rho differs by up to {worst:.4} px");
    assert!(worst < RHO_BOUND_PX, "{worst} px");
}
