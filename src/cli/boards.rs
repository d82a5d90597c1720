//! Boards in the images of a project: what `detect`, `extrinsics`, `evaluate` and `run` share.

use std::path::{Path, PathBuf};

use plenocal::detection::{
    DepthEstimator, DetectedFeature, Detection, FrameCounts, MicroImages, Search, check_board_size,
    detect_frame,
};
use plenocal::image::RawImage;
use plenocal::io::{self, ImagesSection, OutputFolder, Project};
use plenocal::model::{BapFeature, Board, Datasheet, Observations};
use plenocal::precalibration::{check_stated_pitch, fit_grid};
use plenocal::report::{self, Figure};
use plenocal::{Error, Result};
use rayon::prelude::*;
use serde_json::{Value, json};

use super::precalibrate::progress_bar;

/// Images of a project with boards.
#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Subset {
    Calibration,
    Evaluation,
    Translation,
}

impl Subset {
    pub fn name(self) -> &'static str {
        match self {
            Self::Calibration => "calibration",
            Self::Evaluation => "evaluation",
            Self::Translation => "translation",
        }
    }

    /// The images of it.
    pub fn images(self, images: &ImagesSection) -> &[PathBuf] {
        match self {
            Self::Calibration => &images.calibration,
            Self::Evaluation => &images.evaluation,
            Self::Translation => images.translation.as_ref().map_or(&[], |t| &t.images),
        }
    }
}

#[derive(Clone, Copy, clap::ValueEnum)]
pub enum Estimator {
    Line,
    Median,
}

impl From<Estimator> for DepthEstimator {
    fn from(estimator: Estimator) -> Self {
        match estimator {
            Estimator::Line => Self::Line,
            Estimator::Median => Self::Median,
        }
    }
}

/// What a project tells of a camera and its images.
pub struct Shoot {
    pub sheet: Datasheet,
    pub board: Board,
    pub images: ImagesSection,
}

impl Shoot {
    /// An error naming the table that is missing or wrong.
    pub fn of(path: &Path, project: &Project) -> Result<Self> {
        let missing = |what: &str| Error::Invalid(what.to_owned()).in_file(path);
        let sheet = project.datasheet()?.ok_or_else(|| {
            missing("there is no camera in it: add [sensor], [main_lens] and [micro_lens_array]")
        })?;
        let board = project.board.ok_or_else(|| missing("there is no board in it: add [board]"))?;
        let images = project
            .images
            .clone()
            .ok_or_else(|| missing("it lists no images: add [images] with calibration = [...]"))?;
        sheet
            .validate()
            .and_then(|()| board.validate())
            .and_then(|()| check_board_size(&board))
            .map_err(|e| e.in_file(path))?;
        Ok(Self { sheet, board, images })
    }

    /// The white image in the light of the boards, or the one at their f-number.
    pub fn white_image(&self) -> Result<PathBuf> {
        // f/11 is engraved for f/11.31, f/22 for f/22.63.
        const SAME_STOP: f64 = 0.04;
        if let Some(path) = &self.images.devignetting {
            return Ok(path.clone());
        }
        let mut nearest: Option<(f64, f64, &PathBuf)> = None;
        for white in &self.images.whites {
            let f_number = white.f_number()?;
            let off = (f_number / self.sheet.f_number - 1.0).abs();
            if nearest.is_none_or(|(least, ..)| off < least) {
                nearest = Some((off, f_number, &white.image));
            }
        }
        let at = match nearest {
            Some((off, _, image)) if off < SAME_STOP => return Ok(image.clone()),
            Some((_, f_number, image)) => {
                format!(" (the nearest is {}, at f/{f_number:.2})", name(image))
            }
            None => String::new(),
        };
        Err(Error::Invalid(format!(
            "there is no white image at f/{:.2}, the f-number of the boards{at}: add devignetting = \
             \"...\" to [images]",
            self.sheet.f_number
        )))
    }

    fn check_size(&self, raw: &RawImage) -> Result<()> {
        let sensor = &self.sheet.sensor;
        let (width, height) = (sensor.width_px as usize, sensor.height_px as usize);
        if (raw.width, raw.height) == (width, height) {
            return Ok(());
        }
        Err(Error::Invalid(format!(
            "an image has {} x {} px, but the sensor {width} x {height}: correct [sensor], or give the \
             image whole as the camera delivered it",
            raw.width, raw.height
        )))
    }

    /// What a folder that `precalibrate` has written says of the micro-images; an error if it is of
    /// another camera.
    pub fn read_precalibration(&self, folder: &Path) -> Result<MicroImages> {
        let (internal, centers) = (folder.join("precalibration.json"), folder.join("centers.csv"));
        let (sheet, pixel) = (&self.sheet, Some(self.sheet.sensor.pixel_size_mm));
        let internal = io::read_internal_parameters(&internal, pixel)?;
        let measured = io::read_centers(&centers)?;
        let grid = fit_grid(&measured, sheet.lattice_kind, sheet.columns, sheet.rows)
            .map_err(|e| e.in_file(&centers))?;
        Observations { centers: measured.clone(), features: Vec::new() }
            .validate(&sheet.sensor, (sheet.columns, sheet.rows), &self.board, false)
            .map_err(|e| e.in_file(&centers))?;
        internal
            .validate(sheet.lens_types)
            .and_then(|()| check_stated_pitch(sheet, &internal, &grid))
            .map_err(|e| e.in_file(folder))?;
        MicroImages::new(&grid, &measured, &internal, sheet).map_err(|e| e.in_file(folder))
    }
}

/// How boards are looked for.
#[derive(Clone, Copy)]
pub struct Look {
    pub subset: Subset,
    pub estimator: Estimator,
    pub pictures: bool,
    /// No progress bar.
    pub quiet: bool,
}

/// What came of an image.
pub struct Frame {
    pub number: u32,
    pub path: PathBuf,
    pub result: std::result::Result<Detection, String>,
    pub counts: FrameCounts,
}

/// What came of a subset.
pub struct Found {
    pub frames: Vec<Frame>,
    pub features: Vec<DetectedFeature>,
    /// detection.json.
    pub document: Value,
    pub warnings: Vec<String>,
}

impl Found {
    pub fn bap_features(&self) -> Vec<BapFeature> {
        self.features.iter().map(|f| f.feature).collect()
    }

    /// The pictures that were written, by name.
    pub fn figures(&self, pictures: bool) -> Vec<Figure> {
        let tied = self.frames.iter().filter(|frame| pictures && frame.result.is_ok());
        let figure = |frame: &Frame| Figure {
            name: picture(frame.number),
            caption: format!(
                "Frame {} ({}): features with their blur circles, coloured by corner, and the lattice of \
                 the board.",
                frame.number,
                name(&frame.path)
            ),
            svg: String::new(),
        };
        tied.map(figure).collect()
    }

    pub fn rows(&self) -> Vec<report::FrameRow> {
        rows(&self.frames)
    }
}

fn picture(frame: u32) -> String {
    format!("frame-{frame:02}.svg")
}

fn rows(frames: &[Frame]) -> Vec<report::FrameRow> {
    let row = |frame: &Frame| report::FrameRow {
        frame: frame.number,
        image: name(&frame.path),
        counts: frame.counts,
        features: frame.result.as_ref().map_or(0, |detection| detection.features.len()),
    };
    frames.iter().map(row).collect()
}

fn name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// Boards in fewer positions say little of a camera.
const FEW_FRAMES: usize = 4;

/// Detects the features of a subset and stages features.csv, detection.json and the pictures. Frames that
/// are left out are in the warnings; an error if all are, with what was found and dropped in them.
pub fn detect(
    path: &Path,
    shoot: &Shoot,
    micro_images: &MicroImages,
    look: Look,
    output: &mut OutputFolder,
) -> Result<Found> {
    let images = look.subset.images(&shoot.images);
    if images.is_empty() {
        return Err(Error::Invalid(format!("[images] lists no boards of {}", look.subset.name()))
            .in_file(path));
    }
    let white = shoot.white_image().map_err(|e| e.in_file(path))?;
    let white = io::read_image(&white, Some(shoot.images.color))?;
    shoot.check_size(&white).map_err(|e| e.in_file(path))?;
    let search = Search {
        micro_images,
        board: &shoot.board,
        sensor: &shoot.sheet.sensor,
        estimator: look.estimator.into(),
    };
    let frames = detect_all(shoot, images, &white, &search, look, output)?;
    let mut warnings = rejected(&frames);
    if frames.iter().all(|frame| frame.result.is_err()) {
        return Err(Error::Invalid(format!(
            "no frame shows the board: check [board], the images, the f-number of their white image, \
             and the configuration of the array\n  {}\n{}",
            warnings.join("\n  "),
            report::detection_text(&rows(&frames))
        )));
    }
    warnings.extend(too_few(&frames, look.subset));
    warnings.extend(unseen_size(&frames, &shoot.board));
    let features: Vec<DetectedFeature> = frames
        .iter()
        .filter_map(|frame| frame.result.as_ref().ok())
        .flat_map(|detection| detection.features.iter().copied())
        .collect();
    output.stage("features.csv", |out| io::write_detected_features(out, &features))?;
    let document = document(&frames, &shoot.board);
    output.stage_json("detection.json", &document)?;
    Ok(Found { frames, features, document, warnings })
}

/// Frames that are in memory at once.
const AT_ONCE: usize = 4;

/// A few frames at once: reading and drawing take one core, so that several keep all of them busy.
fn detect_all(
    shoot: &Shoot,
    paths: &[PathBuf],
    white: &RawImage,
    search: &Search,
    look: Look,
    output: &mut OutputFolder,
) -> Result<Vec<Frame>> {
    let bar = progress_bar(look.quiet, paths.len(), "looking at boards");
    let white = white.grey();
    let of_image = |&(number, path): &(u32, &PathBuf)| {
        let mut drawn = None;
        let (result, counts) = match io::read_image(path, Some(shoot.images.color)) {
            Ok(image) => {
                let found = detect_frame(number, &image.grey(), &white, search);
                if let (Ok(detection), true) = (&found.0, look.pictures) {
                    drawn = Some(report::features_figure(&image, detection, search.board)?);
                }
                (found.0.map_err(|why| why.to_string()), found.1)
            }
            // A damaged image among good ones is reported like any frame that is left out.
            Err(error) => (Err(error.to_string()), FrameCounts::default()),
        };
        bar.inc(1);
        Ok((Frame { number, path: path.clone(), result, counts }, drawn))
    };
    let numbered: Vec<(u32, &PathBuf)> = (0..).zip(paths).collect();
    let mut frames = Vec::new();
    for some in numbered.chunks(rayon::current_num_threads().min(AT_ONCE)) {
        let done: Vec<(Frame, Option<String>)> =
            some.par_iter().map(of_image).collect::<Result<_>>()?;
        for (frame, drawn) in done {
            if let Some(drawn) = drawn {
                output.stage(picture(frame.number), |out| out.write_all(drawn.as_bytes()))?;
            }
            frames.push(frame);
        }
    }
    bar.finish_and_clear();
    Ok(frames)
}

/// Which frames are left out and why.
fn rejected(frames: &[Frame]) -> Vec<String> {
    let left_out = |frame: &Frame| {
        let why = frame.result.as_ref().err()?;
        Some(format!("frame {} ({}) is left out: {why}", frame.number, name(&frame.path)))
    };
    frames.iter().filter_map(left_out).collect()
}

fn too_few(frames: &[Frame], subset: Subset) -> Option<String> {
    let good = frames.iter().filter(|frame| frame.result.is_ok()).count();
    (good < FEW_FRAMES && subset == Subset::Calibration).then(|| {
        format!(
            "{good} frame(s) are few for a calibration: take ten or more, at several distances and tilts"
        )
    })
}

/// A board that is stated too large fits as well where its other sides are out of view.
fn unseen_size(frames: &[Frame], board: &Board) -> Option<String> {
    let spans = |of: fn(i32, i32) -> i32, last: i32| {
        let all = |detection: &Detection| {
            let seen: Vec<i32> =
                detection.corners.iter().map(|c| of(c.corner, board.columns)).collect();
            seen.contains(&0) && seen.contains(&last)
        };
        frames.iter().filter_map(|frame| frame.result.as_ref().ok()).any(all)
    };
    let whole = spans(|corner, columns| corner % columns, board.columns - 1)
        && spans(|corner, columns| corner / columns, board.rows - 1);
    (!whole).then(|| {
        format!(
            "no frame shows the board from its first to its last row and column: check that it has {} x \
             {} inner corners",
            board.columns, board.rows
        )
    })
}

fn document(frames: &[Frame], board: &Board) -> Value {
    let of_frame = |frame: &Frame| {
        let c = &frame.counts;
        json!({
            "frame": frame.number,
            "image": frame.path.display().to_string(),
            "rejected": frame.result.as_ref().err(),
            "features": frame.result.as_ref().map_or(0, |d| d.features.len()),
            "board_corners": c.board_corners,
            "micro_images": { "looked_at": c.looked_at, "unusable": c.unusable },
            "corners": c.corners,
            "clusters": c.clusters,
            "dropped": {
                "alone": c.alone,
                "off_line": c.off_line,
                "texture": c.texture,
                "off_board": c.off_board,
                "lost_board_corners": c.lost,
                "unclear": c.unclear,
                "misplaced": c.misplaced,
                "given_up": c.given_up,
            },
        })
    };
    json!({
        "format": "plenocal-detection",
        "version": 1,
        "board": { "columns": board.columns, "rows": board.rows, "square_mm": board.square_mm },
        "frames": frames.iter().map(of_frame).collect::<Vec<_>>(),
    })
}
