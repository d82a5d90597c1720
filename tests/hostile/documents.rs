//! Valid files, as the program, COMPOTE, Raytrix and users write them.

use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use nalgebra::Vector2;
use plenocal::assessment::assess;
use plenocal::calibration::{CalibrationOptions, SolvedProblem, Start, calibrate};
use plenocal::io::{
    Manifest, OutputFolder, StageRecord, calibrated_camera_document, calibration_document, compote,
    poses_document, stage_problem, write_features,
};
use plenocal::model::{
    BapFeature, FramePose, InternalParameters, MeasuredBlur, Opening, PlenopticCamera, TAKEN,
};
use plenocal::precalibration::MicroImageArray;
use serde_json::{Value, json};

use super::corpus::{BOARD, datasheet, observations, true_camera, true_poses};

/// Lines of the shipped observations that go into a file of few.
pub const FEW: usize = 30;

/// A project with every table that there is.
pub const PROJECT: &str = r#"[sensor]
width_px = 1000
height_px = 750
pixel_size_mm = 0.0055
[main_lens]
focal_length_mm = 16.0
f_number = 2.8
focus_distance_mm = inf
[micro_lens_array]
configuration = "galilean"
lattice = "hexagonal-rows"
columns = 43
rows = 37
lens_types = 3
micro_image_pitch_px = 23.3
[internal_parameters]
m_mm = 0.1432
q_prime_mm = [0.0361, 0.0414, 0.0377]
micro_image_pitch_mm = 0.128
aperture_ratio = { value = 0.92, std_dev = 0.005 }
[board]
columns = 9
rows = 5
square_mm = 3.0
[images]
color = "grey"
black_level = 16
devignetting = "d.png"
calibration = ["c0.png", "c1.png"]
evaluation = ["e0.png"]
[[images.whites]]
image = "w4.png"
f_number = 4.0
[[images.whites]]
image = "w8.png"
stop = 8
[images.translation]
step_mm = -5.0
images = ["t0.png", "t1.png"]
clouds = ["t0.xyz", "t1.xyz"]
[observations]
centers = "centers.csv"
features = "features.csv"
[truth]
camera = "camera.json"
board = "board.toml"
calibration_poses = "poses.json"
evaluation_poses = "poses.json"
[calibration]
mode = "full"
pitches = "two"
exit_pupil = -3.5
field_curvature = "constant"
board = "bent"
blur = "features"
fix = ["Q3", "P1"]
exclude_frames = [3]
weights = "unit"
uv_std_dev_px = 0.1
rho_std_dev_px = 0.2
centers_std_dev_px = 0.3
loss = "huber"
loss_scale = 3.0
max_iterations = 50
threads = 1
[calibration.priors]
default = true
F = { value = 16.2, std_dev = 0.1 }
u0 = "none"
"#;

/// The shape of a board as simulations write it.
pub const BOARD_SHAPE: &str = "sag_mm = [0.1, -0.2]\ntwist_mm = 0.05\naspect = 0.001\n";

/// A scene of COMPOTE.
pub const SCENE: &str = r#"{"checkerboards": [{"lph": "3", "x_grid": "9", "y_grid": "5"}]}"#;

/// A pre-calibration.
pub fn precalibration() -> Value {
    json!({
        "format": "plenocal-precalibration",
        "version": 1,
        "micro_image_array": { "lattice": "hexagonal-rows", "columns": 43, "rows": 37 },
        "internal_parameters": {
            "m_mm": 0.1432,
            "q_prime_mm": [0.0361, 0.0414, 0.0377],
            "micro_image_pitch_mm": 0.128,
            "standard_deviations": { "m_mm": 1e-4, "q_prime_mm": [1e-5, 2e-5, 3e-5] },
            "pupil_growth": 0.01,
            "aperture_ratio": { "value": 0.92, "std_dev": 0.005 },
            "levels": { "bits": 8, "black_level": 16.0, "saturation_level": 255.0 },
            "rms_px": 0.02,
        },
    })
}

/// A Raytrix calibration.
pub fn raytrix() -> String {
    let xy = |x: f64, y: f64| format!("<x>{x}</x><y>{y}</y>");
    let lens_type =
        |i: f64| format!("<lens_type>\n<offset>{}</offset>\n</lens_type>\n", xy(i, 0.0));
    format!(
        "<?xml version=\"1.0\"?>\n<RayCalibData>\n<offset>{}</offset>\n<diameter>23.5</diameter>\n\
         <lens_base_x>{}</lens_base_x>\n<lens_base_y>{}</lens_base_y>\n{}</RayCalibData>\n",
        xy(3.5, -2.25),
        xy(1.0, 0.0),
        xy(0.5, 0.866_025_403_784_438_6),
        [0.0, 1.0, 2.0].map(lens_type).concat()
    )
}

/// Few features with every column.
pub fn full_features() -> Vec<u8> {
    let complete = |feature: &BapFeature| BapFeature {
        std_dev_px: Some([0.02, 0.03]),
        rho_std_dev_px: Some(0.05),
        correlation: 0.3,
        sensitivities_px: Some([[0.01, -0.02]; TAKEN]),
        blur: Some(MeasuredBlur {
            radius_px: -1.6,
            std_dev_px: 0.05,
            shared_px: 0.001,
            aperture_ratio: 0.92,
        }),
        ..*feature
    };
    let features: Vec<BapFeature> =
        observations().features.iter().take(FEW).map(complete).collect();
    let mut text = Vec::new();
    write_features(&mut text, &features).expect("memory can be written");
    text
}

/// COMPOTE's binary observations, before they are compressed.
pub fn linked() -> Vec<u8> {
    let observations = observations();
    let (centers, features) = (&observations.centers[..FEW], &observations.features[..FEW]);
    let mut bytes = Vec::new();
    bytes.extend((centers.len() as u64).to_le_bytes());
    for c in centers {
        bytes.extend([c.k, c.l].into_iter().flat_map(i32::to_le_bytes));
        bytes.extend([c.u_px, c.v_px].into_iter().flat_map(f64::to_le_bytes));
    }
    bytes.extend(0_u64.to_le_bytes());
    bytes.extend((features.len() as u64).to_le_bytes());
    for f in features {
        let rho = f.rho_px.unwrap_or_default();
        bytes.extend([f.k, f.l].into_iter().flat_map(i32::to_le_bytes));
        bytes.extend([f.u_px, f.v_px, rho].into_iter().flat_map(f64::to_le_bytes));
        bytes.extend([f.corner, 0].into_iter().flat_map(i32::to_le_bytes));
    }
    bytes
}

/// A manifest with one stage.
pub fn manifest() -> Manifest {
    let mut manifest = Manifest::of(Path::new("project.toml"), Vec::new(), std::iter::empty());
    manifest.inputs.insert("a.png".into(), "11".to_owned());
    let files = vec!["centers.csv".to_owned()];
    manifest.stages.push(StageRecord { name: "precalibration".to_owned(), time_s: 1.5, files });
    manifest
}

/// Documents of COMPOTE: intrinsics, camera, parameters and poses.
pub fn compote_documents() -> [Value; 4] {
    let mut camera: PlenopticCamera = true_camera();
    camera.lattice.rows = 36;
    let grid = MicroImageArray {
        lattice: camera.lattice,
        pitch_px: 23.3,
        rotation_rad: 0.001,
        center_px: camera.sensor.center_px(),
        perspective_per_px: Vector2::zeros(),
        rms_px: 0.1,
        outliers: 0,
    };
    let internal = InternalParameters {
        m_mm: 0.1432,
        q_prime_mm: vec![0.0361, 0.0414, 0.0377],
        micro_image_pitch_mm: Some(0.128),
        m_std_dev_mm: None,
        q_prime_std_dev_mm: Vec::new(),
        pupil_growth: 0.0,
        fall_off: None,
        tilt_gradient: None,
        vignetting: None,
        point_spread_px2: None,
        aperture_ratio: None,
        opening: Opening::Disc,
        levels: None,
    };
    let poses: Vec<FramePose> = true_poses().into_iter().take(3).collect();
    [
        compote::intrinsics_document(&camera, &grid).expect("the rows are even"),
        compote::camera_document(&datasheet(), &grid, 3),
        compote::parameters_document(&internal, &datasheet()),
        compote::poses_document(&poses),
    ]
}

/// What is read of a calibration, and little else: it is long.
fn few_fields(mut document: Value) -> Value {
    if let Some(fields) = document.as_object_mut() {
        fields.retain(|name, _| {
            ["format", "version", "converged", "board_shape"].contains(&name.as_str())
        });
    }
    document
}

/// What a calibration writes: camera, poses and the calibration itself.
pub static CALIBRATED: LazyLock<[Value; 3]> = LazyLock::new(|| {
    let options = CalibrationOptions { threads: 1, ..CalibrationOptions::default() };
    let start = Start::Camera(true_camera());
    let result = calibrate(&start, &BOARD, &observations(), &options, &mut |_| true)
        .expect("the shipped observations are good");
    let assessment = assess(&result, &BOARD).expect("the shipped observations are good");
    let poses: Vec<FramePose> = result.poses.iter().take(3).copied().collect();
    [
        calibrated_camera_document(&result, &assessment),
        poses_document(&poses, None, &std::collections::BTreeSet::new()),
        few_fields(calibration_document(&result, &assessment, 1.0)),
    ]
});

/// The files of a problem with few observations, by their names; problem.json is the first.
pub static PROBLEM: LazyLock<Vec<(String, Vec<u8>)>> = LazyLock::new(|| {
    let options = CalibrationOptions { threads: 1, ..CalibrationOptions::default() };
    let start = Start::Camera(true_camera());
    let result = calibrate(&start, &BOARD, &observations(), &options, &mut |_| true)
        .expect("the shipped observations are good");
    let mut problem = SolvedProblem::of(&result, &BOARD);
    problem.features.truncate(FEW);
    problem.centers.truncate(FEW);
    let folder = tempfile::tempdir().expect("a folder is made");
    let mut output = OutputFolder::new(folder.path()).expect("it can be written");
    stage_problem(&mut output, &problem).expect("it can be written");
    let files = output.commit().expect("it can be written");
    let read = |path: PathBuf| {
        let name = path.file_name().expect("a file").to_string_lossy().into_owned();
        (name, std::fs::read(&path).expect("it was written"))
    };
    let mut files: Vec<(String, Vec<u8>)> = files.into_iter().map(read).collect();
    files.sort_by_key(|(name, _)| name != "problem.json");
    files
});

/// Presets, prescriptions and other simulation files below a folder of `data`.
pub fn toml_files(folder: &str) -> Vec<PathBuf> {
    let folder = super::corpus::data(folder);
    let entries = std::fs::read_dir(folder).expect("the folder is there");
    let mut files: Vec<PathBuf> = entries.map(|entry| entry.expect("an entry").path()).collect();
    files.sort();
    files
}
