//! The detection as one stage: from images of boards to BAP features.

use std::borrow::Cow;

use rayon::prelude::*;

use super::{Detection, FrameCounts, Rejection, Search, detect_frame};
use crate::error::{Error, Result};
use crate::image::RawImage;
use crate::model::{BapFeature, Board, Sensor, Subset};

/// An image of a board.
pub struct BoardImage<'a> {
    /// Number of the frame.
    pub frame: u32,
    /// What messages call the image.
    pub name: String,
    read: Box<dyn Fn() -> Result<Cow<'a, RawImage>> + Sync + 'a>,
}

impl<'a> BoardImage<'a> {
    /// An image in memory.
    pub fn new(frame: u32, name: impl Into<String>, image: &'a RawImage) -> Self {
        Self { frame, name: name.into(), read: Box::new(move || Ok(Cow::Borrowed(image))) }
    }

    /// An image that is read when its turn comes: a whole set need not fit into memory.
    pub fn read_by(
        frame: u32,
        name: impl Into<String>,
        read: impl Fn() -> Result<RawImage> + Sync + 'a,
    ) -> Self {
        Self { frame, name: name.into(), read: Box::new(move || read().map(Cow::Owned)) }
    }
}

/// Why an image has no features.
#[derive(Debug)]
pub enum NoFeatures {
    /// It cannot be read.
    Unreadable(Error),
    /// The board was not found in it.
    Rejected(Rejection),
}

impl std::fmt::Display for NoFeatures {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Unreadable(error) => error.fmt(f),
            Self::Rejected(rejection) => rejection.fmt(f),
        }
    }
}

/// What was found in an image.
#[derive(Debug)]
pub struct DetectedFrame {
    /// Number of the frame.
    pub frame: u32,
    /// What messages call the image.
    pub name: String,
    /// The board, or why it is left out.
    pub result: std::result::Result<Detection, NoFeatures>,
    /// What was done with the micro-images.
    pub counts: FrameCounts,
}

impl DetectedFrame {
    /// Number of its features; 0 where it is left out.
    #[must_use]
    pub fn features(&self) -> usize {
        self.result.as_ref().map_or(0, |detection| detection.features.len())
    }
}

/// What was found in a set of images.
#[derive(Debug)]
pub struct DetectedBoards {
    /// Image by image.
    pub frames: Vec<DetectedFrame>,
    /// What the user should know, in words: frames left out and why, a doubtful board.
    pub warnings: Vec<String>,
}

impl DetectedBoards {
    /// The features of all frames.
    #[must_use]
    pub fn features(&self) -> Vec<BapFeature> {
        let found = self.frames.iter().filter_map(|frame| frame.result.as_ref().ok());
        found.flat_map(|detection| detection.features.iter().copied()).collect()
    }
}

/// Boards in fewer positions say little about a camera.
const FEW_FRAMES: usize = 4;
/// Frames that are in memory at once.
const AT_ONCE: usize = 4;

/// Detects the board in a set of images. `white` is the white image in their light and at their
/// f-number.
///
/// `inspect` is called once for every image, from several threads, with the image if it could be
/// read. An error if the white image does not have the size of the sensor, or from `inspect`; a
/// frame without a board, or that cannot be read, is left out with a warning.
pub fn detect(
    images: &[BoardImage],
    white: &RawImage,
    search: &Search,
    subset: Subset,
    inspect: &(dyn Fn(&DetectedFrame, Option<&RawImage>) -> Result<()> + Sync),
) -> Result<DetectedBoards> {
    let _span = tracing::info_span!("detection").entered();
    search.board.validate()?;
    check_size(white, search.sensor)?;
    let white = white.grey();
    let of_image = |image: &BoardImage| {
        let (frame, name) = (image.frame, image.name.clone());
        match (image.read)() {
            Ok(raw) => {
                let (found, counts) = detect_frame(frame, &raw.grey(), &white, search);
                let result = found.map_err(NoFeatures::Rejected);
                let detected = DetectedFrame { frame, name, result, counts };
                inspect(&detected, Some(&raw))?;
                Ok(detected)
            }
            Err(error) => {
                let result = Err(NoFeatures::Unreadable(error));
                let detected =
                    DetectedFrame { frame, name, result, counts: FrameCounts::default() };
                inspect(&detected, None)?;
                Ok(detected)
            }
        }
    };
    let mut frames = Vec::new();
    // Reading takes one core, so that a few frames at once keep all of them busy.
    for some in images.chunks(rayon::current_num_threads().min(AT_ONCE)) {
        let done: Vec<DetectedFrame> = some.par_iter().map(of_image).collect::<Result<_>>()?;
        frames.extend(done);
    }
    let warnings = warnings(&frames, search.board, subset);
    Ok(DetectedBoards { frames, warnings })
}

fn check_size(white: &RawImage, sensor: &Sensor) -> Result<()> {
    let (width, height) = (sensor.width_px as usize, sensor.height_px as usize);
    if (white.width, white.height) == (width, height) {
        return Ok(());
    }
    Err(Error::invalid(format!(
        "the white image has {} x {} px, but the sensor {width} x {height}: correct [sensor], or give \
         the image uncropped as the camera delivered it",
        white.width, white.height
    )))
}

fn warnings(frames: &[DetectedFrame], board: &Board, subset: Subset) -> Vec<String> {
    let left_out = |frame: &DetectedFrame| {
        let why = frame.result.as_ref().err()?;
        Some(format!("frame {} ({}) is left out: {why}", frame.frame, frame.name))
    };
    let mut warnings: Vec<String> = frames.iter().filter_map(left_out).collect();
    let found = frames.iter().filter(|frame| frame.result.is_ok()).count();
    if found == 0 {
        return warnings;
    }
    if found < FEW_FRAMES && subset == Subset::Calibration {
        warnings.push(format!(
            "{found} frame(s) are few for a calibration: take ten or more, at several distances and tilts"
        ));
    }
    if !shows_all_sides(frames, board) {
        warnings.push(format!(
            "no frame shows the board from its first to its last row and column: check that it has {} x \
             {} inner corners",
            board.columns, board.rows
        ));
    }
    warnings
}

/// A board that is stated too large fits as well where its other sides are out of view.
fn shows_all_sides(frames: &[DetectedFrame], board: &Board) -> bool {
    let spans = |of: fn(i32, i32) -> i32, last: i32| {
        let all = |detection: &Detection| {
            let seen: Vec<i32> =
                detection.corners.iter().map(|c| of(c.corner, board.columns)).collect();
            seen.contains(&0) && seen.contains(&last)
        };
        frames.iter().filter_map(|frame| frame.result.as_ref().ok()).any(all)
    };
    spans(|corner, columns| corner % columns, board.columns - 1)
        && spans(|corner, columns| corner / columns, board.rows - 1)
}
