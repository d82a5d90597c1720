//! Images of boards, and what was found in them.

use std::borrow::Cow;

use super::flat_field::Likeness;
use super::{Detection, FrameCounts};
use crate::error::Result;
use crate::finding::{Finding, Issue};
use crate::image::RawImage;
use crate::model::BapFeature;
use crate::quantity::Estimate;

/// An image of a board.
pub struct BoardImage<'a> {
    /// Number of the frame.
    pub frame: u32,
    /// What messages call the image.
    pub name: String,
    pub(super) read: Box<dyn Fn() -> Result<Cow<'a, RawImage>> + Sync + 'a>,
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

/// What was found in an image.
#[derive(Debug)]
pub struct DetectedFrame {
    /// Number of the frame.
    pub frame: u32,
    /// What messages call the image.
    pub name: String,
    /// The board, or why it is left out.
    pub result: std::result::Result<Detection, Issue>,
    /// What was done with the micro-images.
    pub counts: FrameCounts,
    /// How its light follows the white image.
    pub(super) likeness: Option<Likeness>,
    /// How many levels the samples of its image were rounded to, if these are few.
    pub(super) few_levels: Option<u32>,
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
    /// The aperture ratio of the micro-lenses by the edges of all frames, where these show it.
    pub aperture_ratio: Option<Estimate>,
    /// That which corners were fitted with.
    pub fitted_with: f64,
    /// What the user should know: frames left out and why, a doubtful board.
    pub findings: Vec<Finding>,
}

impl DetectedBoards {
    /// The features of all frames.
    #[must_use]
    pub fn features(&self) -> Vec<BapFeature> {
        let found = self.frames.iter().filter_map(|frame| frame.result.as_ref().ok());
        found.flat_map(|detection| detection.features.iter().copied()).collect()
    }
}
