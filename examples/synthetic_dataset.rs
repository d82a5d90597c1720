//! Writes the feature set of `data/synthetic`: features of a small multi-focus camera, drawn from the
//! camera model, with known truth.
//!
//!     cargo run --example synthetic_dataset -- data/synthetic

use std::collections::BTreeSet;
use std::path::Path;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector2, Vector3};
use plenocal::Result;
use plenocal::io::{OutputFolder, camera_document, poses_document, write_centers, write_features};
use plenocal::model::{
    BapFeature, Board, EdgeSpread, FramePose, Lattice, LensSetting, MainLens, MicroImageCenter,
    MicroLensArray, Noise, Observations, Packing, Parity, PlenopticCamera, Sensor,
};
use plenocal::solver::synthesize;

const SEED: u64 = 2020;

const BOARD: Board = Board { columns: 9, rows: 5, square_mm: 3.0 };

/// What a user would know of the camera: the nominal lens, and measurements of white images that are
/// off by about one per cent.
const PROJECT: &str = r#"# plenocal project: a small multi-focus camera, observations drawn from its own model.
# Made by `cargo run --example synthetic_dataset`; the truth is in truth/.

[sensor]
width_px = 1000
height_px = 750
pixel_size_mm = 0.0055

[main_lens]
focal_length_mm = 16.0        # as engraved on the lens
f_number = 2.8
focus_distance_mm = 120.0     # from the sensor; inf for infinity

[micro_lens_array]
configuration = "galilean"    # or "keplerian", "unfocused"
lattice = "hexagonal-rows"    # or "hexagonal-columns", "orthogonal"
columns = 43
rows = 37
lens_types = 3

[internal_parameters]         # measured on white images
m_mm = 0.1432
q_prime_mm = [0.0361, 0.0414, 0.0377]

[board]
columns = 9                   # inner corners
rows = 5
square_mm = 3.0

[observations]
centers = "centers.csv"
features = "features.csv"
"#;

fn camera() -> PlenopticCamera {
    PlenopticCamera {
        sensor: Sensor { width_px: 1000, height_px: 750, pixel_size_mm: 0.0055 },
        lattice: Lattice { packing: Packing::HexagonalRows(Parity::Even), columns: 43, rows: 37 },
        main_lens: MainLens {
            radial: [-2.0e-3, 1.0e-4, -4.0e-6],
            tangential: [-3.0e-4, 2.0e-4],
            setting: Some(LensSetting { f_number: 2.8, focus_distance_mm: 120.0 }),
            ..MainLens::thin(16.2)
        },
        mla: MicroLensArray {
            principal_point_px: Vector2::new(520.0, 362.0),
            mla_to_sensor_mm: 0.33,
            rotation_rad: Vector3::new(0.8e-3, -0.6e-3, 1.2e-3),
            offset_mm: Vector2::new(0.11, -0.07),
            lens_to_mla_mm: 18.5,
            pitch_mm: 0.126,
            pitch_ratio: 1.0,
            focal_lengths_mm: vec![0.578, 0.505, 0.552],
        },
        edge_spread: EdgeSpread::default(),
    }
}

/// Boards between 72 and 100 mm, turned about all axes by up to 40 degrees.
fn poses() -> Vec<FramePose> {
    let center = Translation3::new(-12.0, -6.0, 0.0);
    [
        ([0.0, 0.0, 0.0], [0.0, 0.0, 90.0]),
        ([35.0, 0.0, 5.0], [1.0, 0.5, 78.0]),
        ([-30.0, 10.0, -8.0], [-1.0, 1.0, 82.0]),
        ([5.0, 40.0, 20.0], [0.5, -1.0, 76.0]),
        ([-8.0, -35.0, 90.0], [2.0, 0.0, 92.0]),
        ([25.0, 25.0, -30.0], [-2.0, -1.5, 85.0]),
        ([-20.0, 30.0, 170.0], [1.5, 1.5, 98.0]),
        ([10.0, -20.0, 45.0], [0.0, 2.0, 100.0]),
    ]
    .into_iter()
    .zip(0..)
    .map(|((degrees, [x, y, z]), frame)| {
        let [roll, pitch, yaw] = degrees.map(f64::to_radians);
        let turn = UnitQuaternion::from_euler_angles(roll, pitch, yaw);
        let place = Isometry3::from_parts(Translation3::new(x, y, z), turn);
        FramePose { frame, camera_from_board: place * center }
    })
    .collect()
}

/// Rounds to 10⁻⁴ px, a two-thousandth of the noise, to keep the files small.
fn rounded(observations: Observations) -> Observations {
    let round = |x: f64| (x * 1e4).round() / 1e4;
    Observations {
        axis_px: None,
        shifted_frames: observations.shifted_frames,
        centers: observations
            .centers
            .into_iter()
            .map(|c| MicroImageCenter { u_px: round(c.u_px), v_px: round(c.v_px), ..c })
            .collect(),
        features: observations
            .features
            .into_iter()
            .map(|f| BapFeature {
                u_px: round(f.u_px),
                v_px: round(f.v_px),
                rho_px: f.rho_px.map(round),
                ..f
            })
            .collect(),
    }
}

fn main() -> Result<()> {
    let folder = std::env::args().nth(1).unwrap_or_else(|| "data/synthetic".to_owned());
    let (camera, poses) = (camera(), poses());
    let observations = rounded(synthesize(&camera, &BOARD, &poses, &Noise::default(), SEED)?);
    let mut output = OutputFolder::new(Path::new(&folder))?;
    output.stage("project.toml", |out| out.write_all(PROJECT.as_bytes()))?;
    output.stage("centers.csv", |out| write_centers(out, &observations.centers))?;
    output.stage("features.csv", |out| write_features(out, &observations.features))?;
    output.stage_json("truth/camera.json", &camera_document(&camera, None))?;
    output.stage_json("truth/poses.json", &poses_document(&poses, None, &BTreeSet::new()))?;
    output.commit()?;
    println!(
        "{} centres and {} features of {} frames in {folder}",
        observations.centers.len(),
        observations.features.len(),
        poses.len()
    );
    Ok(())
}
