//! Images of boards, and the results of the detection in them.

use std::borrow::Cow;
use std::collections::BTreeSet;

use nalgebra::Vector2;

use super::flat_field::Likeness;
use super::{Aberration, Detection, FrameCounts, MicroImages};
use crate::error::Result;
use crate::finding::{Finding, Issue};
use crate::image::RawImage;
use crate::model::{BapFeature, MicroImageCenter, Observations};
use crate::optics::aberration::AberrationEstimate;
use crate::quantity::Estimate;

/// Image of a board.
pub struct BoardImage<'a> {
    /// Number of the frame.
    pub frame: u32,
    /// Name of the image in messages.
    pub name: String,
    pub(super) read: Box<dyn Fn() -> Result<Cow<'a, RawImage>> + Sync + 'a>,
}

impl<'a> BoardImage<'a> {
    /// Creates an image in memory.
    pub fn new(frame: u32, name: impl Into<String>, image: &'a RawImage) -> Self {
        Self { frame, name: name.into(), read: Box::new(move || Ok(Cow::Borrowed(image))) }
    }

    /// Creates an image that is read when needed: a whole set need not fit into memory.
    pub fn read_by(
        frame: u32,
        name: impl Into<String>,
        read: impl Fn() -> Result<RawImage> + Sync + 'a,
    ) -> Self {
        Self { frame, name: name.into(), read: Box::new(move || read().map(Cow::Owned)) }
    }
}

/// Result of the detection in an image.
#[derive(Debug)]
pub struct DetectedFrame {
    /// Number of the frame.
    pub frame: u32,
    /// Name of the image in messages.
    pub name: String,
    /// The board, or the reason why the frame is left out.
    pub result: std::result::Result<Detection, Issue>,
    /// Counts of what was found and dropped.
    pub counts: FrameCounts,
    /// Comparison of its light with the white image.
    pub(super) likeness: Option<Likeness>,
    /// Number of levels that the samples of its image were rounded to, if they are few.
    pub(super) few_levels: Option<u32>,
}

impl DetectedFrame {
    /// Returns the number of its features; 0 if it is left out.
    #[must_use]
    pub fn features(&self) -> usize {
        self.result.as_ref().map_or(0, |detection| detection.features.len())
    }
}

/// Result of the detection in a set of images.
#[derive(Debug)]
pub struct DetectedBoards {
    /// Results, image by image.
    pub frames: Vec<DetectedFrame>,
    /// Aperture ratio of the micro-lenses from the edges of all frames, if they determine it.
    pub aperture_ratio: Option<Estimate>,
    /// Aperture ratio that the features are determined with.
    pub fitted_with: f64,
    /// Optical axis, px, if coma and astigmatism determine it better than the mount of a lens does.
    pub axis_px: Option<Vector2<f64>>,
    /// Aberrations of the main lens that the features are corrected for.
    pub(super) aberration: AberrationEstimate,
    /// Findings for the user, such as frames left out with the reason, or a doubtful board.
    pub findings: Vec<Finding>,
}

impl DetectedBoards {
    /// Returns the features of all frames.
    #[must_use]
    pub fn features(&self) -> Vec<BapFeature> {
        let found = self.frames.iter().filter_map(|frame| frame.result.as_ref().ok());
        found.flat_map(|detection| detection.features.iter().copied()).collect()
    }

    /// Returns the observations of a calibration: the features, with these centres of micro-images.
    #[must_use]
    pub fn observations(&self, centers: Vec<MicroImageCenter>) -> Observations {
        Observations {
            centers,
            features: self.features(),
            axis_px: self.axis_px,
            shifted_frames: self.shifted_frames(),
        }
    }

    /// Returns the frames in which the board fills the view, so that its corners are numbered up to a shift by whole squares and
    /// a quarter turn.
    #[must_use]
    pub fn shifted_frames(&self) -> BTreeSet<u32> {
        let is_shifted = |frame: &&DetectedFrame| {
            frame.result.as_ref().is_ok_and(|detection| detection.elsewhere.is_some())
        };
        self.frames.iter().filter(is_shifted).map(|frame| frame.frame).collect()
    }

    /// Returns these boards without the frames whose corners are numbered up to a shift, for poses.
    #[must_use]
    pub fn without_shifted_frames(mut self) -> Self {
        let shifted = self.shifted_frames();
        leave_out_shifted(&mut self.frames);
        self.findings.retain(|finding| !matches!(finding.issue, Issue::ShiftedNumbers { .. }));
        let left_out = self.frames.iter().filter(|frame| shifted.contains(&frame.frame));
        self.findings.extend(left_out.filter_map(|frame| {
            let why = frame.result.as_ref().err()?.clone();
            Some(Finding::left_out(frame.frame, Some(&frame.name), why))
        }));
        self
    }

    /// Returns the aberrations of the main lens that the features are corrected for, with the optical axis; `None` if they are
    /// not significant.
    #[must_use]
    pub fn aberration(&self) -> Option<Aberration> {
        let aberration = self.aberration.aberration;
        (aberration.coefficients_per_px2.amax() > 0.0).then_some(aberration)
    }

    /// Returns micro-images of this camera with the aperture ratio and the aberrations of the main lens that these boards show,
    /// for the search for other boards, which does not estimate them again.
    #[must_use]
    pub fn known_in(&self, micro_images: &MicroImages) -> MicroImages {
        let settled = match &self.aperture_ratio {
            Some(ratio) => micro_images.settled_at(ratio),
            None => micro_images.clone(),
        };
        settled.with_aberration(&self.aberration)
    }
}

/// Leaves out frames whose corners are numbered up to a shift: a camera does not depend on the shift, but poses do.
pub(super) fn leave_out_shifted(frames: &mut [DetectedFrame]) {
    for frame in frames {
        let Ok(Detection { corners, elsewhere: Some(elsewhere), .. }) = &frame.result else {
            continue;
        };
        let (corners, elsewhere) = (corners.len(), *elsewhere);
        frame.result = Err(Issue::SeveralPlaces { corners, elsewhere });
    }
}
