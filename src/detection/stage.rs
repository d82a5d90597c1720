//! Detection as one stage: from images of boards to BAP features.

use std::borrow::Cow;

use super::aberration_fit::AberrationInformation;
use super::board_images::{BoardImage, DetectedBoards, DetectedFrame, leave_out_shifted};
use super::detect_frame::detect_frame;
use super::edge_width::{EdgeWidth, OfFrames};
use super::findings::{findings, of_other_boards};
use super::flat_field::Likeness;
use super::{Detection, FrameCounts, Search};
use crate::error::{Error, Result};
use crate::finding::Issue;
use crate::image::{Grey, RawImage};
use crate::model::{MIN_CORNERS, SampleLevels, Sensor, Subset};
use rayon::prelude::*;

/// Largest standard deviation of a known optical axis, over the tolerance of mounts.
const SURE_AXIS: f64 = 0.25;
/// Number of frames that [`detect`] has in memory at once.
pub const AT_ONCE: usize = 4;

/// Detects the board in a set of images. `white` is the white image in their light and at their
/// f-number.
///
/// `inspect` is called once for every image, from several threads, with the image if it could be read. Returns an error if the
/// white image does not have the size of the sensor, or if `inspect` fails. A frame without a board, or that cannot be read, is
/// left out with a warning. The board may fill the view, so that its corners are numbered up to a shift
/// ([`DetectedBoards::shifted_frames`]); such frames of a translation are left out, since its steps depend on the shift.
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
    let white = &white.grey_between(levels);
    let find = |image: &BoardImage<'i>| {
        let (detected, raw) = detected_frame(image, searched(image, white, levels, search));
        inspect(&detected, raw.as_deref())?;
        Ok(detected)
    };
    let mut frames = Vec::new();
    // Reading takes one core, so a few frames at once keep all cores busy.
    for some in images.chunks(AT_ONCE) {
        frames.extend(some.par_iter().map(find).collect::<Result<Vec<DetectedFrame>>>()?);
    }
    let micro_images = search.micro_images;
    let edges = frames.iter().filter_map(|frame| frame.result.as_ref().ok()?.edges);
    let of_frames: Vec<EdgeWidth> = edges.map(|edges| edges.corners).collect();
    let widths = OfFrames::fit(&of_frames, micro_images.point_spread_px2());
    let known = micro_images.aperture_ratio();
    let found_ratio = widths.as_ref().map(|widths| widths.ratio);
    let fitted_with = match micro_images.settled() {
        Some(_) => known,
        None => found_ratio.map_or(known, |ratio| ratio.value),
    };
    let settled = micro_images.with_aperture_ratio(fitted_with);
    let mut information = AberrationInformation::none();
    for detection in frames.iter().filter_map(|frame| frame.result.as_ref().ok()) {
        information.add(detection.about_aberration());
    }
    let fitted = || information.fit(fitted_with.ln(), &search.ideal(), search.sensor.mount_px());
    let aberration = micro_images.aberration().unwrap_or_else(fitted);
    let mut alike = widths.iter().flat_map(|widths| &widths.alike);
    for frame in &mut frames {
        let Ok(detection) = &mut frame.result else { continue };
        let alike = detection.edges.is_some() && alike.next().is_some_and(|alike| *alike);
        let wider_px2 = widths.as_ref().filter(|_| alike).map(|widths| widths.wider_px2);
        let (before, given_up) =
            (detection.corners.len(), detection.settle(&settled, &aberration, wider_px2));
        let corners = detection.corners.len();
        frame.counts.given_up += given_up;
        frame.counts.lost += before - corners;
        frame.counts.board_corners = corners;
        if corners < MIN_CORNERS {
            frame.result = Err(Issue::TooFewForPose { corners, fewest: MIN_CORNERS });
        }
    }
    if subset == Subset::Translation {
        leave_out_shifted(&mut frames);
    }
    let mut findings = findings(&frames, search.board, subset);
    findings.extend(found_ratio.as_ref().and_then(|ratio| of_other_boards(ratio, micro_images)));
    let axis_px = aberration.axis_within(SURE_AXIS * search.sensor.mount_px());
    let aperture_ratio = found_ratio;
    Ok(DetectedBoards { frames, aperture_ratio, fitted_with, axis_px, aberration, findings })
}

/// Reads an image and searches it.
fn searched<'i>(
    image: &BoardImage<'i>,
    white: &Grey,
    levels: Option<&SampleLevels>,
    search: &Search,
) -> Result<Searched<'i>> {
    let raw = (image.read)()?;
    let grey = raw.grey_between(levels);
    let found = detect_frame(image.frame, &grey, white, search);
    let likeness = Likeness::of(&grey, white, search.micro_images);
    Ok((raw, found, likeness))
}

/// Returns the result of the detection in an image, and the image if it could be read.
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

/// Result of the search in an image.
type Found = (std::result::Result<Detection, Issue>, FrameCounts);
/// Image, with the result of the search and the comparison of its light with the white image.
type Searched<'i> = (Cow<'i, RawImage>, Found, Option<Likeness>);

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
