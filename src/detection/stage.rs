//! The detection as one stage: from images of boards to BAP features.

use std::borrow::Cow;

use rayon::prelude::*;
use tracing::debug;

use super::board_images::{BoardImage, DetectedBoards, DetectedFrame};
use super::detect_frame::{detect_again, detect_frame};
use super::edge_width::{EdgeWidth, OfFrames};
use super::findings::{findings, fitted_otherwise};
use super::flat_field::Likeness;
use super::{Detection, FrameCounts, MicroImages, Search};
use crate::checks::boards::ratio_differs;
use crate::error::{Error, Result};
use crate::finding::Issue;
use crate::image::{Grey, RawImage};
use crate::model::{SampleLevels, Sensor, Subset};
use crate::quantity::Estimate;

/// Number of frames that [`detect`] has in memory at once.
pub const AT_ONCE: usize = 4;

/// The first frames with a board are searched so many times, until the aperture ratio that their edges show is that which
/// corners are fitted with.
const ROUNDS: usize = 8;
/// Aperture ratios are the same for that if they differ by less than so many standard deviations.
const SAME: f64 = 1.0;
/// Largest part of the aperture ratio that corners are fitted with which their edges show again.
const MOST_FOLLOWS: f64 = 0.75;

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
    let (mut frames, mut ratio_is_known) = (Vec::new(), micro_images.settled().is_some());
    let mut follows = 0.0;
    // Reading takes one core, so that a few frames at once keep all of them busy.
    for some in images.chunks(AT_ONCE) {
        let read = |image: &BoardImage<'i>| looking.read(image, &micro_images);
        let mut found: Vec<Result<Searched>> = some.par_iter().map(read).collect();
        if !ratio_is_known {
            (micro_images, follows) = looking.settle(some, &mut found, micro_images);
        }
        let of_image = |(image, found): (&BoardImage, Result<Searched>)| {
            let (detected, raw) = detected_frame(image, found);
            inspect(&detected, raw.as_deref())?;
            Ok(detected)
        };
        let done = some.par_iter().zip(found).map(of_image);
        frames.extend(done.collect::<Result<Vec<DetectedFrame>>>()?);
        ratio_is_known |= widths(detections(&frames), spread).is_some();
    }
    let fitted_with = micro_images.aperture_ratio();
    let aperture_ratio = widths(detections(&frames), spread).map(|widths| {
        let found = frames.iter_mut().filter_map(|frame| frame.result.as_mut().ok());
        let with_edges = found.filter(|found| found.edges.is_some());
        for (found, _) in with_edges.zip(widths.alike).filter(|(_, alike)| *alike) {
            found.take_width(widths.wider_px2);
        }
        in_the_end(&widths.ratio, fitted_with, follows)
    });
    let mut findings = findings(&frames, search.board, subset);
    findings
        .extend(aperture_ratio.as_ref().and_then(|ratio| fitted_otherwise(ratio, &micro_images)));
    Ok(DetectedBoards { frames, aperture_ratio, fitted_with, findings })
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

    /// The same of an image that was searched with other micro-images: where it showed a board, only that is searched for.
    fn found_again(
        &self,
        image: &BoardImage,
        raw: &RawImage,
        micro_images: &MicroImages,
        (before, counts): &Found,
    ) -> Found {
        let search = Search { micro_images, ..*self.search };
        let grey = raw.grey_between(self.levels);
        let again =
            |before| detect_again(image.frame, &grey, &self.white, &search, (before, *counts));
        match before.as_ref().ok().and_then(again) {
            Some((found, counts)) => (Ok(found), counts),
            None => self.found(image, raw, micro_images),
        }
    }

    /// Reads an image and searches it.
    fn read<'i>(&self, image: &BoardImage<'i>, micro_images: &MicroImages) -> Result<Searched<'i>> {
        let raw = (image.read)()?;
        let found = self.found(image, &raw, micro_images);
        let likeness = Likeness::of(&raw.grey_between(self.levels), &self.white, micro_images);
        Ok((raw, found, likeness))
    }

    /// Searches images again until the aperture ratio that their edges show is that which corners are fitted with. Also the part of
    /// that which their edges show again.
    fn settle<'m>(
        &self,
        images: &[BoardImage],
        found: &mut [Result<Searched>],
        mut micro_images: Cow<'m, MicroImages>,
    ) -> (Cow<'m, MicroImages>, f64) {
        let (spread, mut before) = (micro_images.point_spread_px2(), None);
        let mut follows = 0.0;
        for _ in 1..ROUNDS {
            let searched = found.iter().filter_map(|found| found.as_ref().ok());
            let fitted_with = micro_images.aperture_ratio();
            let shown =
                widths(searched.filter_map(|(_, (found, _), _)| found.as_ref().ok()), spread);
            let Some(ratio) = shown.map(|widths| widths.ratio) else { break };
            let step = [fitted_with, ratio.value];
            follows = before.map_or(0.0, |before| part_that_follows(before, step));
            if !ratio_differs(&ratio, fitted_with, SAME) {
                break;
            }
            debug!("aperture ratio {:.4} ± {:.4}: searching again", ratio.value, ratio.std_dev);
            micro_images = Cow::Owned(micro_images.with_aperture_ratio(following(follows, step)));
            before = Some(step);
            images.par_iter().zip(&mut *found).for_each(|(image, found)| {
                if let Ok((raw, found, _)) = found {
                    *found = self.found_again(image, raw, &micro_images, found);
                }
            });
        }
        (micro_images, follows)
    }
}

/// What was found in an image, and the image if it could be read.
fn detected_frame<'i>(
    image: &BoardImage,
    found: Result<Searched<'i>>,
) -> (DetectedFrame, Option<Cow<'i, RawImage>>) {
    let (raw, result, counts, likeness) = match found {
        Ok((raw, (found, counts), likeness)) => (Some(raw), found, counts, likeness),
        Err(error) => (
            None,
            Err(Issue::Unreadable { reason: error.to_string() }),
            FrameCounts::default(),
            None,
        ),
    };
    let few_levels = raw.as_ref().and_then(|raw| raw.rounded_to_levels());
    let name = image.name.clone();
    (DetectedFrame { frame: image.frame, name, result, counts, likeness, few_levels }, raw)
}

fn detections(frames: &[DetectedFrame]) -> impl Iterator<Item = &Detection> {
    frames.iter().filter_map(|frame| frame.result.as_ref().ok())
}

/// What was found in an image.
type Found = (std::result::Result<Detection, Issue>, FrameCounts);
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

/// The part of the aperture ratio that corners are fitted with which their edges show again, from two steps: from that which they
/// were fitted with to that which their edges showed. It is large where the blur is not much wider than the point spread.
fn part_that_follows(before: [f64; 2], [fitted_with, shown]: [f64; 2]) -> f64 {
    ((shown - before[1]) / (fitted_with - before[0])).clamp(0.0, MOST_FOLLOWS)
}

/// The aperture ratio to fit corners with after a step: of what is left, each step shows the same part (Aitken).
fn following(follows: f64, [fitted_with, shown]: [f64; 2]) -> f64 {
    fitted_with + (shown - fitted_with) / (1.0 - follows)
}

/// The aperture ratio that edges would show if they had been fitted with it, from what they show. Where they follow what they were
/// fitted with, its σ is larger as well.
fn in_the_end(shown: &Estimate, fitted_with: f64, follows: f64) -> Estimate {
    let value = following(follows, [fitted_with, shown.value]);
    Estimate { value, std_dev: shown.std_dev / (1.0 - follows) }
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Edges that show 60 % of a wrong aperture ratio again.
    #[test]
    fn two_steps_find_the_aperture_ratio_where_edges_show_a_part_of_it() {
        let shown = |fitted_with: f64| 0.9 + 0.6 * (fitted_with - 0.9);
        let first = [1.0, shown(1.0)];
        let second = following(0.0, first);
        assert!((second - first[1]).abs() < 1e-12, "{second}");
        let next = [second, shown(second)];
        let follows = part_that_follows(first, next);
        let third = following(follows, next);
        assert!((follows - 0.6).abs() < 1e-12 && (third - 0.9).abs() < 1e-12, "{third}");
        // Errors of what edges show move the end of these steps further, and so does σ say.
        for (error, moved) in [(0.0, 0.0), (0.01, 0.025)] {
            let ratio = Estimate { value: shown(0.95) + error, std_dev: 0.01 };
            let end = in_the_end(&ratio, 0.95, follows);
            assert!((end.value - 0.9 - moved).abs() < 1e-12, "{end:?}");
            assert!((end.std_dev - 0.025).abs() < 1e-12, "{end:?}");
        }
    }

    #[test]
    fn chance_makes_no_step_backwards_or_more_than_four_times_as_long() {
        let step = [0.98, 0.97];
        // What was shown before: as if all that corners are fitted with showed again, and as if its contrary did.
        for (before, expected) in [([1.0, 0.99], 0.98 - 4.0 * 0.01), ([1.0, 0.96], 0.97)] {
            let found = following(part_that_follows(before, step), step);
            assert!((found - expected).abs() < 1e-12, "{found} for {expected}");
        }
    }
}
