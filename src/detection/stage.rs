//! The detection as one stage: from images of boards to BAP features.

use std::borrow::Cow;

use rayon::prelude::*;
use tracing::debug;

use super::edge_width::{EdgeWidth, MOVED, MOVED_PX2, OfFrames};
use super::likeness::{Likeness, unlike};
use super::{Detection, FrameCounts, MicroImages, Rejection, Search, detect_frame};
use crate::error::{Error, Result};
use crate::image::{Grey, RawImage};
use crate::model::{BapFeature, Board, FillFactor, SampleLevels, Sensor, Subset};
use crate::numerics::median;

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
    /// How its light follows the white image.
    pub(super) likeness: Option<Likeness>,
}

impl DetectedFrame {
    fn new<'i>(
        image: &BoardImage,
        found: Result<Searched<'i>>,
    ) -> (Self, Option<Cow<'i, RawImage>>) {
        let (raw, result, counts, likeness) = match found {
            Ok((raw, (found, counts), likeness)) => {
                (Some(raw), found.map_err(NoFeatures::Rejected), counts, likeness)
            }
            Err(error) => (None, Err(NoFeatures::Unreadable(error)), FrameCounts::default(), None),
        };
        (Self { frame: image.frame, name: image.name.clone(), result, counts, likeness }, raw)
    }

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
    /// The fill factor of the micro-lenses by the edges of all frames, where these show it.
    pub fill_factor: Option<FillFactor>,
    /// That which corners were fitted with.
    pub fitted_with: f64,
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

/// The first frames with a board are searched so many times, until the fill factor that their edges show is that which
/// corners are fitted with.
const ROUNDS: usize = 8;
/// Fill factors that are the same for that, relative, or within so many standard deviations; and within so many that this may
/// be chance.
const SAME_FILL: f64 = 0.002;
const SAME: f64 = 0.1;
const CHANCE: f64 = 3.0;
/// Largest part of the fill factor that corners are fitted with which their edges show again.
const MOST_FOLLOWS: f64 = 0.75;

/// The variance of both axes together of an even motion is a twelfth of its square, that along an axis half of it.
const MOTION: f64 = 24.0;

/// Detects the board in a set of images. `white` is the white image in their light and at their
/// f-number.
///
/// `inspect` is called once for every image, from several threads, with the image if it could be
/// read. An error if the white image does not have the size of the sensor, or from `inspect`; a
/// frame without a board, or that cannot be read, is left out with a warning.
pub fn detect<'i>(
    images: &[BoardImage<'i>],
    white: &RawImage,
    search: &Search,
    subset: Subset,
    inspect: &(dyn Fn(&DetectedFrame, Option<&RawImage>) -> Result<()> + Sync),
) -> Result<DetectedBoards> {
    let _span = tracing::info_span!("detection").entered();
    search.board.validate()?;
    check_size(white, search.sensor)?;
    let levels = search.micro_images.levels.as_ref();
    let looking = Looking { search, white: white.grey_between(levels), levels };
    let mut micro_images = Cow::Borrowed(search.micro_images);
    let spread = micro_images.point_spread_px2();
    let (mut frames, mut fill_is_known) = (Vec::new(), micro_images.settled().is_some());
    // Reading takes one core, so that a few frames at once keep all of them busy.
    for some in images.chunks(AT_ONCE) {
        let read = |image: &BoardImage<'i>| looking.read(image, &micro_images);
        let mut found: Vec<Result<Searched>> = some.par_iter().map(read).collect();
        if !fill_is_known {
            micro_images = looking.settle(some, &mut found, micro_images);
        }
        let of_image = |(image, found): (&BoardImage, Result<Searched>)| {
            let (detected, raw) = DetectedFrame::new(image, found);
            inspect(&detected, raw.as_deref())?;
            Ok(detected)
        };
        let done = some.par_iter().zip(found).map(of_image);
        frames.extend(done.collect::<Result<Vec<DetectedFrame>>>()?);
        fill_is_known |= widths(detections(&frames), spread).is_some();
    }
    let fitted_with = micro_images.fill_factor();
    let fill_factor = widths(detections(&frames), spread).map(|widths| {
        let found = frames.iter_mut().filter_map(|frame| frame.result.as_mut().ok());
        let with_edges = found.filter(|found| found.edges.is_some());
        for (found, _) in with_edges.zip(widths.alike).filter(|(_, alike)| *alike) {
            found.take_width(widths.wider_px2);
        }
        widths.fill
    });
    let mut warnings = warnings(&frames, search.board, subset);
    warnings.extend(fill_factor.as_ref().and_then(|fill| fitted_otherwise(fill, &micro_images)));
    Ok(DetectedBoards { frames, fill_factor, fitted_with, warnings })
}

/// A search in several images.
struct Looking<'a> {
    search: &'a Search<'a>,
    white: Grey<'a>,
    levels: Option<&'a SampleLevels>,
}

impl Looking<'_> {
    fn found(&self, image: &BoardImage, raw: &RawImage, micro_images: &MicroImages) -> Found {
        let search = Search { micro_images, ..*self.search };
        detect_frame(image.frame, &raw.grey_between(self.levels), &self.white, &search)
    }

    /// Reads an image and searches it.
    fn read<'i>(&self, image: &BoardImage<'i>, micro_images: &MicroImages) -> Result<Searched<'i>> {
        let raw = (image.read)()?;
        let found = self.found(image, &raw, micro_images);
        let likeness = Likeness::of(&raw.grey_between(self.levels), &self.white, micro_images);
        Ok((raw, found, likeness))
    }

    /// Searches images again until the fill factor that their edges show is that which corners are fitted with.
    fn settle<'m>(
        &self,
        images: &[BoardImage],
        found: &mut [Result<Searched>],
        mut micro_images: Cow<'m, MicroImages>,
    ) -> Cow<'m, MicroImages> {
        let (spread, mut before) = (micro_images.point_spread_px2(), None);
        for _ in 1..ROUNDS {
            let searched = found.iter().filter_map(|found| found.as_ref().ok());
            let fitted_with = micro_images.fill_factor();
            let other = |fill: &FillFactor| differs(fill, fitted_with, SAME);
            let shown =
                widths(searched.filter_map(|(_, (found, _), _)| found.as_ref().ok()), spread);
            let Some(fill) = shown.map(|widths| widths.fill).filter(other) else { break };
            debug!("fill factor {:.4} ± {:.4}: searching again", fill.value, fill.std_dev);
            let step = [fitted_with, fill.value];
            micro_images = Cow::Owned(micro_images.with_fill_factor(following(before, step)));
            before = Some(step);
            images.par_iter().zip(&mut *found).for_each(|(image, found)| {
                if let Ok((raw, found, _)) = found {
                    *found = self.found(image, raw, &micro_images);
                }
            });
        }
        micro_images
    }
}

fn detections(frames: &[DetectedFrame]) -> impl Iterator<Item = &Detection> {
    frames.iter().filter_map(|frame| frame.result.as_ref().ok())
}

/// What was found in an image.
type Found = (std::result::Result<Detection, Rejection>, FrameCounts);
/// The image as well, and how its light follows the white image.
type Searched<'i> = (Cow<'i, RawImage>, Found, Option<Likeness>);

/// What the edges of frames say together, with this variance of the point spread, px²; `None` where they do not tell it.
fn widths<'a>(
    frames: impl Iterator<Item = &'a Detection>,
    point_spread_px2: f64,
) -> Option<OfFrames> {
    let of_frames: Vec<EdgeWidth> = frames.filter_map(|frame| Some(frame.edges?.corners)).collect();
    OfFrames::fit(&of_frames, point_spread_px2)
}

/// The fill factor to fit corners with after one step, from that which they were fitted with to that which their edges showed,
/// or two. Where the blur is not much wider than the point spread, edges show only a part of the change, and each step the
/// same part of what is left (Aitken).
fn following(before: Option<[f64; 2]>, [fitted_with, shown]: [f64; 2]) -> f64 {
    let follows = before.map_or(0.0, |before| (shown - before[1]) / (fitted_with - before[0]));
    fitted_with + (shown - fitted_with) / (1.0 - follows.clamp(0.0, MOST_FOLLOWS))
}

/// Whether a fill factor is another one than that which corners were fitted with, by so many standard deviations.
fn differs(found: &FillFactor, fitted_with: f64, std_devs: f64) -> bool {
    let change = (found.value - fitted_with).abs();
    change > SAME_FILL * found.value && change > std_devs * found.std_dev
}

/// A warning if corners were fitted with another fill factor than all frames show.
fn fitted_otherwise(found: &FillFactor, micro_images: &MicroImages) -> Option<String> {
    let fitted_with = micro_images.fill_factor();
    let (shown_by, std_dev, remedy) = match micro_images.settled() {
        Some(std_dev) => (
            "the boards for calibration show",
            std_dev,
            "take all images with the same camera at the same settings",
        ),
        None => (
            "the first frames show",
            0.0,
            "if the first frames are blurred or moved, leave them out; or else state the fill factor that all frames \
             show in the project",
        ),
    };
    let of_both = FillFactor { std_dev: found.std_dev.hypot(std_dev), ..*found };
    if !differs(&of_both, fitted_with, CHANCE) {
        return None;
    }
    Some(format!(
        "corners were fitted with the fill factor {fitted_with:.4}, as {shown_by} it, but all frames show {:.4} ± \
         {:.4}: {remedy}",
        found.value, found.std_dev
    ))
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
    // Other light may be why frames are left out.
    let mut warnings = unlike(frames);
    warnings.extend(frames.iter().filter_map(left_out));
    let found = frames.iter().filter(|frame| frame.result.is_ok()).count();
    if found == 0 {
        return warnings;
    }
    if found < FEW_FRAMES && subset == Subset::Calibration {
        warnings.push(format!(
            "{found} frame(s) are few for a calibration: take ten or more, at several distances and tilts"
        ));
    }
    warnings.extend(blurred(frames));
    if !shows_all_sides(frames, board) {
        warnings.push(format!(
            "no frame shows the board from its first to its last row and column: check that it has {} x \
             {} inner corners",
            board.columns, board.rows
        ));
    }
    warnings
}

/// Warnings about frames whose edges are wider than those of the others.
fn blurred(frames: &[DetectedFrame]) -> Vec<String> {
    let edges: Vec<(&DetectedFrame, [f64; 2])> = frames
        .iter()
        .filter_map(|frame| Some((frame, frame.result.as_ref().ok()?.edges?.spread_px2)))
        .collect();
    let Some(usual) = median(edges.iter().map(|(_, [spread, _])| *spread)) else {
        return Vec::new();
    };
    let wider = |(_, [spread, std_dev]): &&(&DetectedFrame, [f64; 2])| {
        edges.len() >= FEW_FRAMES && spread - usual > MOVED_PX2.max(MOVED * std_dev)
    };
    let words = |(frame, [spread, _]): &(&DetectedFrame, [f64; 2])| {
        format!(
            "the edges in frame {} ({}) are wider than those of the others, as if something had moved by {:.1} px in its micro-images: hold \
             board and camera still, or leave the frame out if it does not fit",
            frame.frame,
            frame.name,
            (MOTION * (spread - usual)).sqrt()
        )
    };
    edges.iter().filter(wider).map(words).collect()
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Edges that show 60 % of a wrong fill factor again.
    #[test]
    fn two_steps_find_the_fill_factor_where_edges_show_a_part_of_it() {
        let shown = |fitted_with: f64| 0.9 + 0.6 * (fitted_with - 0.9);
        let first = [1.0, shown(1.0)];
        let second = following(None, first);
        assert!((second - first[1]).abs() < 1e-12, "{second}");
        let third = following(Some(first), [second, shown(second)]);
        assert!((third - 0.9).abs() < 1e-12, "{third}");
    }

    #[test]
    fn chance_makes_no_step_backwards_or_more_than_four_times_as_long() {
        let step = [0.98, 0.97];
        // What was shown before: as if all that corners are fitted with showed again, and as if its contrary did.
        for (before, expected) in [([1.0, 0.99], 0.98 - 4.0 * 0.01), ([1.0, 0.96], 0.97)] {
            let found = following(Some(before), step);
            assert!((found - expected).abs() < 1e-12, "{found} for {expected}");
        }
    }
}
