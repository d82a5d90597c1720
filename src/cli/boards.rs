//! Detection of boards in the images of a project, shared by `detect`, `extrinsics`, `evaluate` and `run`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use plenocal::detection::{
    AT_ONCE, BoardImage, DepthEstimator, DetectedBoards, DetectedFrame, MicroImages, Search,
    check_board_size, check_configuration, detect,
};
use plenocal::image::RawImage;
use plenocal::io::{self, ImageReader, ImagesSection, OutputFolder, Project};
use plenocal::model::{Board, Datasheet, InternalParameters, Subset};
use plenocal::report::{Figure, Photograph};
use plenocal::{Error, Finding, Issue, Result, report};

use super::messages::announce_memory;
use super::progress;

/// Memory of the search per pixel, without the images, bytes: 5 were measured on images of 12.5 MP.
const WORK_BYTES: f64 = 6.0;

/// Camera, board and images of a project.
pub struct Shoot {
    pub sheet: Datasheet,
    pub board: Board,
    pub images: ImagesSection,
    pub reader: ImageReader,
}

/// Returns the images of a subset.
pub fn images_of(subset: Subset, images: &ImagesSection) -> &[PathBuf] {
    match subset {
        Subset::Calibration => &images.calibration,
        Subset::Evaluation => &images.evaluation,
        Subset::Translation => images.translation.as_ref().map_or(&[], |t| &t.images),
    }
}

impl Shoot {
    /// Creates it from a project; an error names the table that is missing or wrong.
    pub fn of(path: &Path, project: &Project) -> Result<Self> {
        let sheet = camera_of(path, project)?;
        let board = project
            .board
            .ok_or_else(|| Error::invalid("it has no board: add [board]").in_file(path))?;
        check_configuration(&sheet).map_err(|e| e.in_file(path))?;
        let images = listed_images(path, project, "calibration = [...]")?;
        board.validate().and_then(|()| check_board_size(&board)).map_err(|e| e.in_file(path))?;
        let reader = images.reader(&sheet.sensor)?;
        Ok(Self { sheet, board, images, reader })
    }

    /// Returns for each image of a subset the name of an earlier identical image, if there is one. Images of the evaluation are
    /// also compared with images of the calibration.
    pub fn repeated(&self, subset: Subset) -> Vec<Option<String>> {
        let before: &[PathBuf] =
            if subset == Subset::Evaluation { &self.images.calibration } else { &[] };
        io::repeated(before, images_of(subset, &self.images))
    }

    /// Returns the devignetting image or, without one, the white image at the f-number of the boards.
    pub fn white_image(&self) -> Result<PathBuf> {
        // The engraved f-numbers are rounded: f/11 is f/11.31, f/22 is f/22.63.
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
                format!(" (the nearest is {}, at f/{f_number:.2})", file_name(image))
            }
            None => String::new(),
        };
        Err(Error::invalid(format!(
            "there is no white image at f/{:.2}, the f-number of the boards{at}: add devignetting = \
             \"...\" to [images]",
            self.sheet.f_number
        )))
    }

    /// Reads the micro-images and internal parameters from a folder written by `precalibrate`. An error if they belong to
    /// another camera, or if the project states another black level.
    pub fn read_precalibration(&self, folder: &Path) -> Result<(MicroImages, InternalParameters)> {
        const STAGE: &str = "precalibration";
        let (internal, centers) = (folder.join("precalibration.json"), folder.join("centers.csv"));
        let of_run = folder.join(STAGE);
        if !internal.exists() && of_run.is_dir() {
            return Err(Error::invalid(format!(
                "this is the folder of a run: give its {STAGE}, {}",
                of_run.display()
            ))
            .in_file(folder));
        }
        let array_size = io::read_array_size(&internal)?;
        let sheet = Datasheet { array_size: self.sheet.array_size.or(array_size), ..self.sheet };
        let internal = io::read_internal_parameters(&internal, Some(sheet.sensor.pixel_size_mm))?;
        self.check_black_level(&internal).map_err(|e| e.in_file(folder))?;
        let measured = io::read_centers(&centers)?;
        let micro_images = MicroImages::of_measurements(&measured, &internal, &sheet)
            .map_err(|e| e.in_file(folder))?;
        Ok((micro_images, internal))
    }

    fn check_black_level(&self, internal: &InternalParameters) -> Result<()> {
        const SAME: f64 = 1e-9;
        let Some(stated) = self.reader.black_level() else { return Ok(()) };
        let subtracted = internal.levels.map_or(0.0, |levels| levels.black_level);
        if (subtracted - stated).abs() < SAME {
            return Ok(());
        }
        let given = match &self.images.dark {
            Some(dark) => format!("the dark image {} gives {stated}", dark.display()),
            None => format!("[images] says black_level = {stated}"),
        };
        Err(Error::invalid(format!(
            "it was measured with a black level of {subtracted}, but {given}: run `plenocal \
             precalibrate` again"
        )))
    }
}

/// Returns the camera of a project; an error names what is missing or wrong.
pub fn camera_of(path: &Path, project: &Project) -> Result<Datasheet> {
    let sheet = project.datasheet().map_err(|e| e.in_file(path))?.ok_or_else(|| {
        Error::invalid("it has no camera: add [sensor], [main_lens] and [micro_lens_array]")
            .in_file(path)
    })?;
    sheet.validate().map_err(|e| e.in_file(path))?;
    Ok(sheet)
}

/// Returns the images that a project lists; if it lists none, an error says what to add.
pub fn listed_images(path: &Path, project: &Project, add: &str) -> Result<ImagesSection> {
    project.images.clone().ok_or_else(|| {
        Error::invalid(format!("it lists no images: add [images] with {add}")).in_file(path)
    })
}

/// Options of the search for boards.
#[derive(Clone, Copy)]
pub struct Options {
    pub subset: Subset,
    pub estimator: DepthEstimator,
    pub pictures: bool,
    /// True if no progress bar is shown.
    pub quiet: bool,
    /// True if frames whose corners are numbered up to a shift are left out, since poses depend on the shift.
    pub for_poses: bool,
}

/// Photographs by frame.
pub type Photographs = BTreeMap<u32, Photograph>;

/// Creates the figure of a frame.
fn picture(frame: &DetectedFrame, svg: String) -> Figure {
    let DetectedFrame { frame, name, .. } = frame;
    Figure {
        name: format!("frame-{frame:02}.svg"),
        caption: format!(
            "Frame {frame} ({name}): features with their blur circles, coloured by corner, and the grid of the board."
        ),
        svg,
    }
}

fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// Detects the features of a subset, stages features.csv, detection.json and the pictures, and returns features and the
/// photographs of all frames that could be read.
/// An error if no frame shows the board.
pub fn detect_subset(
    path: &Path,
    shoot: &Shoot,
    micro_images: &MicroImages,
    options: Options,
    output: &mut OutputFolder,
) -> Result<(DetectedBoards, Photographs)> {
    let images = images_of(options.subset, &shoot.images);
    if images.is_empty() {
        let subset = options.subset.name();
        return Err(Error::invalid(format!("[images] lists no boards for {subset}")).in_file(path));
    }
    let repeated = shoot.repeated(options.subset);
    if let Some(Some(first)) = repeated.first().filter(|_| repeated.iter().all(Option::is_some)) {
        let subset = options.subset.name();
        return Err(Error::invalid(format!(
            "the images for {subset} are also images of the calibration ({} is the same image as \
             {first}): give other images, or leave {subset} out of [images]",
            file_name(&images[0])
        ))
        .in_file(path));
    }
    let white = shoot.white_image().map_err(|e| e.in_file(path))?;
    let at_once = images.len().min(AT_ONCE) as f64 + 1.0;
    let bytes = shoot.reader.bytes(&white)? as f64;
    announce_memory(
        &format!("searching for boards in images of the size of {}", white.display()),
        bytes * at_once + WORK_BYTES * shoot.sheet.sensor.pixels() as f64,
    );
    let white = shoot.reader.read(&white)?;
    let search = Search {
        micro_images,
        board: &shoot.board,
        sensor: &shoot.sheet.sensor,
        estimator: options.estimator,
    };
    let boards: Vec<BoardImage> = (0..)
        .zip(images)
        .zip(repeated)
        .map(|((frame, path), same)| {
            BoardImage::read_by(frame, file_name(path), move || match &same {
                Some(before) => Err(Error::invalid(format!("it is the same image as {before}"))),
                None => shoot.reader.read(path),
            })
        })
        .collect();
    let bar = progress::steps(options.quiet, images.len(), "searching for boards");
    // An image stays in memory only until its frame is done.
    let pictures: Mutex<BTreeMap<u32, (Photograph, Option<Figure>)>> = Mutex::default();
    let draw = |frame: &DetectedFrame, image: Option<&RawImage>| {
        if let (true, Some(image)) = (options.pictures, image) {
            let photograph = Photograph::of(image);
            let svg = frame
                .result
                .as_ref()
                .ok()
                .map(|detection| report::features_figure(&photograph, detection, &shoot.board));
            let figure = svg.transpose()?.map(|svg| picture(frame, svg));
            pictures
                .lock()
                .unwrap_or_else(std::sync::PoisonError::into_inner)
                .insert(frame.frame, (photograph.small(), figure));
        }
        bar.inc();
        Ok(())
    };
    let found = detect(&boards, &white, &search, options.subset, &draw);
    bar.finish();
    let mut found = found.map_err(|e| e.in_file(path))?;
    if options.for_poses {
        found = found.without_shifted_frames();
    }
    let features = found.features();
    if features.is_empty() {
        return Err(Error::invalid(format!(
            "{}\n  {}\n{}",
            no_board(&found),
            found.findings.iter().map(Finding::to_string).collect::<Vec<_>>().join("\n  "),
            report::detection_section(options.subset.name(), &found).to_text()
        )));
    }
    let pictures = pictures.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner);
    let mut photographs = Photographs::new();
    for (frame, (photograph, figure)) in pictures {
        photographs.insert(frame, photograph);
        let Some(figure) = figure else { continue };
        output.stage(&figure.name, |out| out.write_all(figure.svg.as_bytes()))?;
    }
    output.stage("features.csv", |out| io::write_features(out, &features))?;
    output.stage_json("detection.json", &io::detection_document(&found, &shoot.board))?;
    Ok((found, photographs))
}

/// Returns the reason why no frame shows the board, if all frames have the same one; otherwise what to check.
fn no_board(found: &DetectedBoards) -> String {
    let reasons = || found.frames.iter().filter_map(|frame| frame.result.as_ref().err());
    let Some(first) =
        reasons().next().filter(|first| reasons().all(|of| of.code() == first.code()))
    else {
        return "no frame shows the board: check [board], the images, the configuration of the \
                array, and that the white images are of the same camera and f-number, and not \
                rotated, cropped or resized"
            .to_owned();
    };
    match (first, first.remedy()) {
        (Issue::Unreadable { .. }, _) => format!("no image could be read: {first}"),
        (_, remedy) if remedy.is_empty() => format!("no frame shows the board: {first}"),
        (_, remedy) => format!("no frame shows the board: {first}: {remedy}"),
    }
}
