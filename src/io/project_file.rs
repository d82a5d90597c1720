//! Project file: camera, board, images and options, in TOML.

use std::path::{Path, PathBuf};

use serde::de::IgnoredAny;
use serde::{Deserialize, Deserializer};
use toml::{Table, Value};

use super::image_file::{ImageReader, Pages, RawLayout};
use super::project_draft::FILL_IN;
use super::read_text;
use super::spelling::plain;
use crate::calibration::CalibrationOptions;
use crate::error::{Error, Result};
use crate::image::Color;
use crate::model::{
    Board, Configuration, Datasheet, InternalParameters, LatticeKind, Opening, Sensor, optics,
};
use crate::quantity::counted;
use crate::table::{finite, replace};

/// Content of a project file. A table may be missing if a command gets its content in another way.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Project {
    /// Sensor.
    pub sensor: Option<Sensor>,
    /// Main lens as stated by its maker.
    pub main_lens: Option<MainLensSection>,
    /// Micro-lens array as stated by its maker.
    pub micro_lens_array: Option<ArraySection>,
    /// Internal parameters measured on white images.
    pub internal_parameters: Option<InternalParameters>,
    /// Board.
    pub board: Option<Board>,
    /// Paths of the raw images, relative to the project file.
    pub images: Option<ImagesSection>,
    /// Paths of the observations, relative to the project file.
    pub observations: Option<ObservationsSection>,
    /// Paths of the truth for comparison, relative to the project file.
    pub truth: Option<TruthSection>,
    /// Options of the calibration; `method` names the initial set.
    #[serde(default, deserialize_with = "deferred")]
    pub calibration: CalibrationOptions,
}

/// Leaves `[calibration]` to [`CalibrationOptions::from_table`], which handles methods.
fn deferred<'de, D: Deserializer<'de>>(
    from: D,
) -> std::result::Result<CalibrationOptions, D::Error> {
    IgnoredAny::deserialize(from).map(|_| CalibrationOptions::default())
}

/// Table `[truth]`.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TruthSection {
    /// Camera, `camera.json` or COMPOTE's `intrinsics.js`.
    pub camera: PathBuf,
    /// Shape of the board, the simulation's `board.toml`.
    pub board: Option<PathBuf>,
    /// Poses of the boards of `calibration`.
    pub calibration_poses: Option<PathBuf>,
    /// Poses of the boards of `evaluation`.
    pub evaluation_poses: Option<PathBuf>,
}

impl TruthSection {
    /// Returns all files of the truth.
    pub fn files(&self) -> impl Iterator<Item = &Path> {
        let optional = [&self.board, &self.calibration_poses, &self.evaluation_poses];
        let optional = optional.into_iter().filter_map(|path| path.as_deref());
        std::iter::once(self.camera.as_path()).chain(optional)
    }
}

/// Table `[main_lens]`.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MainLensSection {
    /// Focal length F, mm.
    pub focal_length_mm: f64,
    /// F-number N.
    pub f_number: f64,
    /// Focus distance h, mm, from the sensor; `inf` is allowed.
    pub focus_distance_mm: f64,
}

/// Table `[micro_lens_array]`.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ArraySection {
    /// Configuration, Galilean or Keplerian.
    pub configuration: Configuration,
    /// Packing.
    pub lattice: LatticeKind,
    /// Micro-lenses along a row; stated together with `rows`, or not at all.
    pub columns: Option<i32>,
    /// Micro-lenses along a column.
    pub rows: Option<i32>,
    /// Number I of lens types.
    pub lens_types: usize,
    /// Distance between neighbouring micro-image centres, px; measured if not stated.
    pub micro_image_pitch_px: Option<f64>,
    /// Shape of the openings of the micro-lenses; measured if not stated.
    pub opening: Option<Opening>,
}

impl ArraySection {
    /// Returns columns and rows if they are stated; an error if only one of them is.
    fn size(&self) -> Result<Option<(i32, i32)>> {
        match (self.columns, self.rows) {
            (None, None) => Ok(None),
            (Some(columns), Some(rows)) => Ok(Some((columns, rows))),
            _ => Err(Error::invalid(
                "[micro_lens_array] needs both columns and rows, or neither, to measure them in \
                 the white images",
            )),
        }
    }
}

/// Table `[images]`.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ImagesSection {
    /// Meaning of the samples of all images.
    pub color: Color,
    /// Mean sample of a pixel without light, grey levels of the files; measured if not stated.
    pub black_level: Option<f64>,
    /// Pages of TIFF files that are read.
    #[serde(default)]
    pub pages: Pages,
    /// Image without light, which is subtracted from all others; its pages are averaged.
    pub dark: Option<PathBuf>,
    /// Layout of `.raw` and `.bin` files, which have no header. They have the size of the sensor.
    pub raw: Option<RawLayout>,
    /// White images for the pre-calibration.
    #[serde(default)]
    pub whites: Vec<WhiteImage>,
    /// White image in the light and at the f-number of the boards.
    pub devignetting: Option<PathBuf>,
    /// Boards of the calibration; frames count from 0.
    #[serde(default)]
    pub calibration: Vec<PathBuf>,
    /// Boards of the evaluation.
    #[serde(default)]
    pub evaluation: Vec<PathBuf>,
    /// Images of a board moved along the optical axis.
    pub translation: Option<TranslationImages>,
}

impl ImagesSection {
    /// Returns all image files.
    pub fn files(&self) -> impl Iterator<Item = &Path> {
        let whites = self.whites.iter().map(|white| &white.image);
        let whites = whites.chain(&self.devignetting).chain(&self.dark);
        let moved = self.translation.iter().flat_map(|t| &t.images);
        let boards = self.calibration.iter().chain(&self.evaluation).chain(moved);
        whites.chain(boards).map(PathBuf::as_path)
    }

    /// Returns the reader of the images of this sensor, and reads their dark image.
    pub fn reader(&self, sensor: &Sensor) -> Result<ImageReader> {
        let reader = ImageReader::of_color(Some(self.color)).with_pages(self.pages);
        let reader = reader.with_raw(self.raw, (sensor.width_px, sensor.height_px));
        let reader = reader.with_black_level(self.black_level);
        match (&self.dark, self.files().find(|path| Some(*path) != self.dark.as_deref())) {
            (Some(dark), Some(first)) => reader.with_dark(dark, first),
            _ => Ok(reader),
        }
    }

    fn paths(&mut self) -> impl Iterator<Item = &mut PathBuf> {
        let whites = self.whites.iter_mut().map(|white| &mut white.image);
        let moved =
            self.translation.iter_mut().flat_map(|t| t.images.iter_mut().chain(&mut t.clouds));
        let boards = self.calibration.iter_mut().chain(&mut self.evaluation).chain(moved);
        whites.chain(&mut self.devignetting).chain(&mut self.dark).chain(boards)
    }
}

/// Table `[[images.whites]]`.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WhiteImage {
    /// Path of the image.
    pub image: PathBuf,
    /// True f-number of the image.
    pub f_number: Option<f64>,
    /// Stop as engraved, instead of the f-number: 5.6 stands for 5.657.
    pub stop: Option<f64>,
}

impl WhiteImage {
    /// Returns the f-number; an error unless either it or the stop is given.
    pub fn f_number(&self) -> Result<f64> {
        match (self.f_number, self.stop) {
            (Some(n), None) => Ok(n),
            (None, Some(stop)) if stop > 0.0 => Ok(optics::f_number_of_stop(stop)),
            (None, Some(stop)) => Err(Error::invalid(format!(
                "a stop of {stop} is not possible: it \
                                                              has to be positive"
            ))),
            _ => Err(Error::invalid(format!(
                "the white image {} needs either f_number or stop (as engraved), but not both",
                self.image.display()
            ))),
        }
    }
}

/// Table `[images.translation]`.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TranslationImages {
    /// Motion from image to image, mm; negative towards the camera.
    pub step_mm: f64,
    /// Paths of the images, in order.
    pub images: Vec<PathBuf>,
    /// Point clouds (`.xyz`) of the same frames from other software, for comparison.
    #[serde(default)]
    pub clouds: Vec<PathBuf>,
}

/// Table `[observations]`.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObservationsSection {
    /// CSV file of the centres; omitted if the features file contains them.
    pub centers: Option<PathBuf>,
    /// CSV file of the features, or COMPOTE's binary form.
    pub features: PathBuf,
}

impl Project {
    /// Reads a project file; paths in it become relative to the working folder.
    pub fn read(path: &Path) -> Result<Self> {
        Self::read_and_set(path, &[])
    }

    /// Creates a project without a file from values such as `calibration.loss=huber`.
    pub fn of_values(set: &[String]) -> Result<Self> {
        Self::parsed("", set)
    }

    /// Reads a project file and replaces values in it, such as `calibration.loss=huber`.
    pub fn read_and_set(path: &Path, set: &[String]) -> Result<Self> {
        let text = read_text(path)?;
        let parsed = Self::parsed(&text, set).map_err(|error| {
            if set.is_empty() || Self::parsed(&text, &[]).is_err() {
                return error;
            }
            // The file is right, but not with the replaced values.
            Error::invalid(format!("with {}: {error}", set.join(", ")))
        });
        let mut project = parsed.map_err(|e| e.in_file(path))?;
        let folder = path.parent().unwrap_or(Path::new(""));
        if let Some(observations) = &mut project.observations {
            observations.features = folder.join(&observations.features);
            observations.centers = observations.centers.take().map(|file| folder.join(file));
        }
        if let Some(truth) = &mut project.truth {
            let poses = truth.calibration_poses.iter_mut().chain(&mut truth.evaluation_poses);
            for file in poses.chain(&mut truth.board).chain([&mut truth.camera]) {
                *file = folder.join(&file);
            }
        }
        for image in project.images.iter_mut().flat_map(ImagesSection::paths) {
            *image = folder.join(&image);
        }
        Ok(project)
    }

    fn parsed(text: &str, set: &[String]) -> Result<Self> {
        let wrong = |e: toml::de::Error| {
            let waiting = text.lines().filter(|line| line.contains(FILL_IN)).count();
            let hint = if waiting > 0 && e.message().starts_with("missing field") {
                format!("\nstate the values marked {FILL_IN} first ({})", counted(waiting, "line"))
            } else {
                String::new()
            };
            Error::invalid(format!("not a valid project file: {}{hint}", plain(&e.to_string())))
        };
        let mut table: Table = text.parse().map_err(wrong)?;
        set.iter().try_for_each(|pair| replace(&mut table, pair))?;
        // Only errors in the original text can name the line.
        let parsed = if set.is_empty() { toml::from_str(text) } else { table.clone().try_into() };
        let mut project: Self = parsed.map_err(wrong)?;
        project.check_step()?;
        project.check_black()?;
        finite(&table)?;
        project.calibration = match table.remove("calibration") {
            Some(Value::Table(stated)) => CalibrationOptions::from_table(stated).map_err(|e| {
                Error::invalid(format!("in [calibration]: {}", plain(&e.to_string())))
            })?,
            Some(other) => {
                return Err(Error::invalid(format!(
                    "calibration is {other}: write its options below [calibration]"
                )));
            }
            None => CalibrationOptions::default(),
        };
        let numbers = project.calibration.check_numbers();
        numbers.map_err(|e| Error::invalid(format!("in [calibration]: {e}")))?;
        Ok(project)
    }

    fn check_step(&self) -> Result<()> {
        let translation = self.images.as_ref().and_then(|images| images.translation.as_ref());
        match translation.map(|translation| translation.step_mm) {
            Some(step) if !step.is_finite() || step == 0.0 => Err(Error::invalid(format!(
                "step_mm is {step} mm: state the motion of the board from image to image, negative \
                 towards the camera, or leave [images.translation] out"
            ))),
            _ => Ok(()),
        }
    }

    fn check_black(&self) -> Result<()> {
        match self.images.as_ref().and_then(|images| images.dark.as_ref().zip(images.black_level)) {
            Some(_) => Err(Error::invalid(
                "[images] states both dark and black_level: the dark image gives the black level, so \
                 leave black_level out",
            )),
            None => Ok(()),
        }
    }

    /// Returns the datasheet if its three tables exist; an error if only some do.
    pub fn datasheet(&self) -> Result<Option<Datasheet>> {
        match (self.sensor, self.main_lens, self.micro_lens_array) {
            (None, None, None) => Ok(None),
            (Some(sensor), Some(lens), Some(array)) => Ok(Some(Datasheet {
                sensor,
                focal_length_mm: lens.focal_length_mm,
                focus_distance_mm: lens.focus_distance_mm,
                f_number: lens.f_number,
                configuration: array.configuration,
                lattice_kind: array.lattice,
                array_size: array.size()?,
                lens_types: array.lens_types,
                micro_image_pitch_px: array.micro_image_pitch_px,
                opening: array.opening,
            })),
            _ => Err(Error::invalid(
                "a camera needs the tables [sensor], [main_lens] and [micro_lens_array]",
            )),
        }
    }
}
