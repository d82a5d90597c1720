//! Every reader of files, with valid files of its kind.

use std::io::Write;
use std::path::Path;

use flate2::Compression;
use flate2::write::GzEncoder;
use plenocal::io::{
    self, CameraSource, Manifest, Project, VirtualDepths, read_board, read_board_shape,
    read_camera_source, read_centers, read_features, read_image, read_internal_parameters,
    read_point_cloud_distance, read_poses, read_problem, read_raytrix, read_std_devs,
    read_true_board, read_virtual_depths,
};
use plenocal::simulation::{Prescription, Settings};
use plenocal::{Error, Result};

use super::corpus;

/// A reader of files.
pub struct Target {
    /// What it reads.
    pub name: &'static str,
    /// Name of the file.
    pub file: &'static str,
    /// Valid files.
    pub seeds: fn() -> Vec<Vec<u8>>,
    /// Reads a file as the program does, checks included, and returns what was read as a debug output.
    pub read: fn(&Path) -> Result<String>,
}

/// Pixels of a map that are read at once.
const PIECE: usize = 10_000;

/// All readers.
pub const TARGETS: [Target; 20] = [
    Target {
        name: "project",
        file: "project.toml",
        seeds: corpus::projects,
        read: |path| {
            let project = Project::read(path)?;
            let sheet = project.datasheet().map_err(|e| e.in_file(path))?;
            Ok(format!("{project:?} {sheet:?} {:?}", project.calibration))
        },
    },
    Target {
        name: "camera",
        file: "camera.json",
        seeds: corpus::cameras,
        read: |path| match read_camera_source(path)? {
            CameraSource::Camera(camera) => Ok(format!("{camera:?}")),
            CameraSource::Datasheet(sheet) => Ok(format!("{sheet:?}")),
        },
    },
    Target {
        name: "standard deviations",
        file: "camera.json",
        seeds: corpus::cameras,
        read: |path| Ok(format!("{:?}", read_std_devs(path, 3)?)),
    },
    Target {
        name: "internal parameters",
        file: "precalibration.json",
        seeds: corpus::internal_parameters,
        read: |path| Ok(format!("{:?}", read_internal_parameters(path, Some(0.0055))?)),
    },
    Target {
        name: "board",
        file: "scene.js",
        seeds: corpus::boards,
        read: |path| Ok(format!("{:?}", read_board(path)?)),
    },
    Target {
        name: "poses",
        file: "poses.json",
        seeds: corpus::poses,
        read: |path| Ok(format!("{:?}", read_poses(path)?)),
    },
    Target {
        name: "board shape",
        file: "calibration.json",
        seeds: corpus::board_shapes,
        read: |path| Ok(format!("{:?}", read_board_shape(path, &corpus::BOARD)?)),
    },
    Target {
        name: "problem",
        file: "problem.json",
        seeds: corpus::problems,
        read: |path| {
            let folder = path.parent().unwrap_or(Path::new("."));
            corpus::complete_problem(folder);
            // Another board is found out by the features.
            let read = read_problem(folder).map_err(|error| {
                if error.to_string().contains("features.csv") {
                    Error::invalid(format!("{}: {error}", path.display()))
                } else {
                    error
                }
            })?;
            Ok(format!("{:?} {:?} {}", read.cost, read.board, read.minimum))
        },
    },
    Target {
        name: "true board",
        file: "board.toml",
        seeds: corpus::true_boards,
        read: |path| Ok(format!("{:?}", read_true_board(path)?)),
    },
    Target {
        name: "features",
        file: "features.csv",
        seeds: corpus::features,
        read: |path| {
            let with_rho = read_features(path, true).map(|read| format!("{read:?}"));
            let without = format!("{:?}", read_features(path, false)?);
            with_rho.map(|text| text + &without)
        },
    },
    Target {
        name: "virtual depths",
        file: "depths",
        seeds: corpus::virtual_depths,
        read: |path| {
            let read = read_virtual_depths(path, Some([0.0, 0.01]), [0.1, 0.1, 0.02])?;
            let VirtualDepths::Map(mut map) = read else { return Ok(format!("{read:?}")) };
            // In a map, NaN stands for none.
            let mut count = 0;
            loop {
                let depths = map.next(PIECE)?;
                if depths.is_empty() {
                    return Ok(format!("{} {} {count}", map.width, map.height));
                }
                count += depths.len();
            }
        },
    },
    Target {
        name: "centres",
        file: "centers.csv",
        seeds: corpus::centers,
        read: |path| Ok(format!("{:?}", read_centers(path)?)),
    },
    Target {
        name: "linked observations",
        file: "observations.bin",
        seeds: corpus::unpacked,
        read: |path| {
            pack(path)?;
            Ok(format!("{:?} {:?}", read_features(path, true)?, read_centers(path)?))
        },
    },
    Target {
        name: "point cloud",
        file: "cloud.xyz",
        seeds: corpus::clouds,
        read: |path| Ok(format!("{:?}", read_point_cloud_distance(path)?)),
    },
    Target {
        name: "raytrix",
        file: "calib.xml",
        seeds: corpus::raytrix,
        read: |path| {
            let calibration = read_raytrix(path)?;
            let centers = calibration.centers(400, 300).map_err(|e| e.in_file(path))?;
            let middle = calibration.lens_type(400, 300, nalgebra::Vector2::new(200.0, 150.0));
            Ok(format!("{calibration:?} {centers:?} {middle}"))
        },
    },
    Target {
        name: "manifest",
        file: "manifest.json",
        seeds: corpus::manifests,
        read: |path| {
            let folder = path.parent().unwrap_or(Path::new(""));
            Ok(format!("{:?}", Manifest::read(folder).map(|manifest| manifest.stages.len())))
        },
    },
    Target {
        name: "simulation",
        file: "simulation.toml",
        seeds: corpus::simulations,
        read: |path| {
            let read = |file: &str| io::read_text(Path::new(file));
            let text = io::read_text(path)?;
            let settings =
                Settings::from_toml_and_files(&text, &[], &read).map_err(|e| e.in_file(path))?;
            let again = settings.to_toml().map_err(|e| e.in_file(path))?;
            Settings::from_toml(&again, &[])
                .map_err(|e| panic!("what was written cannot be read: {e}\n{again}"))
                .map(|settings| format!("{settings:?}"))
        },
    },
    Target {
        name: "prescription",
        file: "lens.toml",
        seeds: corpus::prescriptions,
        read: |path| {
            let lens = Prescription::from_toml(&io::read_text(path)?);
            Ok(format!("{:?}", lens.map_err(|e| e.in_file(path))?))
        },
    },
    Target {
        name: "image",
        file: "image.png",
        seeds: corpus::images,
        read: |path| {
            let image = read_image(path, None);
            let folder = path.parent().unwrap_or(Path::new(""));
            // As `init` looks at it, which reads less of it.
            let format = io::sort_images(folder).and_then(|images| images.common_format());
            Ok(format!("{} {:?}", image?.width, format?))
        },
    },
    Target {
        name: "what images say of themselves",
        file: "image.tif",
        seeds: corpus::images_with_notes,
        read: |path| Ok(format!("{:?}", io::ImageReader::default().findings(&[path]))),
    },
];

/// Compresses a file.
fn pack(path: &Path) -> Result<()> {
    let write = |source| Error::Write { path: path.to_owned(), source };
    let bytes = std::fs::read(path).map_err(write)?;
    let mut packed = GzEncoder::new(Vec::new(), Compression::fast());
    packed.write_all(&bytes).map_err(write)?;
    std::fs::write(path, packed.finish().map_err(write)?).map_err(write)
}
