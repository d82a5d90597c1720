//! Frame: the image of a board, its white image, and the search in it.

use nalgebra::{Matrix2, Vector2};

use super::corner::Corner;
use super::patch::{Pair, Patch, Room, Unusable};
use super::{Aberration, CornerObservation, DepthEstimator, MicroImages};
use crate::image::Grey;
use crate::model::{Board, Sensor};

/// Object and region of the search.
#[derive(Debug, Clone, Copy)]
pub struct Search<'a> {
    /// The micro-images.
    pub micro_images: &'a MicroImages,
    /// The board.
    pub board: &'a Board,
    /// The sensor.
    pub sensor: &'a Sensor,
    /// Estimator of 1/ν from the observations of a corner.
    pub estimator: DepthEstimator,
}

impl Search<'_> {
    /// Returns a main lens without aberrations, with its axis in the middle of the image.
    pub(super) fn ideal(&self) -> Aberration {
        Aberration::none(self.sensor.center_px(), self.micro_images.pupil_px())
    }
}

/// Counts of what was found and dropped in a frame: in the first pass, which searches every micro-image alone, and in the
/// second, which searches where the labelled board predicts its corners.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct FrameCounts {
    /// Micro-images searched in the first pass.
    pub looked_at: usize,
    /// Micro-images among them that are cut by the border, without light in the white image, or saturated.
    pub unusable: usize,
    /// Corners found in single micro-images.
    pub corners: usize,
    /// Clusters of these corners by DBSCAN.
    pub clusters: usize,
    /// Corners in no cluster.
    pub alone: usize,
    /// Corners off the line of their cluster.
    pub off_line: usize,
    /// Corners in clusters that are texture: large, with hardly any corners on a line.
    pub texture: usize,
    /// Corners on lines that belong to no corner of the board.
    pub off_board: usize,
    /// Board corners labelled in the first pass, but not found again in the second.
    pub lost: usize,
    /// Board corners found in the second pass.
    pub board_corners: usize,
    /// Micro-images in which a board corner is expected but was not found: they are unusable, or the corner has too little
    /// contrast or is too uncertain.
    pub unclear: usize,
    /// Micro-images with a board corner that was given up: its observations are on no line, or few of them look like a corner.
    pub given_up: usize,
    /// Micro-images in which a board corner was found off its line.
    pub misplaced: usize,
}

/// Border of the image that counts as out of view, in pitches.
pub(super) const MARGIN: f64 = 1.0;
/// Standard deviation of a position due to errors of the model of the light, px.
const MODEL_STD_DEV_PX: f64 = 0.01;

/// Image of a board, with its white image.
pub(super) struct Frame<'a> {
    pub frame: u32,
    pub image: &'a Grey<'a>,
    pub white: &'a Grey<'a>,
    pub search: &'a Search<'a>,
}

impl Frame<'_> {
    /// Returns true if a position is in the micro-images, so many pitches within the border.
    pub fn in_view(&self, place: &Vector2<f64>, pitches: f64) -> bool {
        let micro_images = self.search.micro_images;
        micro_images.show(place, self.search.sensor, pitches * micro_images.grid.pitch_px)
    }

    /// Reads the light of a micro-image into a patch, which can be reused; an error if it shows nothing.
    pub fn read(
        &self,
        (k, l): (i32, i32),
        patch: &mut Patch,
        room: &mut Room,
    ) -> Result<(), Unusable> {
        let micro_images = self.search.micro_images;
        let (center, reach) = (micro_images.center(k, l), micro_images.optics(k, l).reach_px());
        Pair { board: self.image, white: self.white }.read(&center, reach, patch, room)
    }

    /// Returns the micro-images whose centres are in the image.
    pub fn nodes(&self) -> Vec<(i32, i32)> {
        let micro_images = self.search.micro_images;
        let lattice = &micro_images.grid.lattice;
        let (width, height) = self.image.size();
        let inside = |&(k, l): &(i32, i32)| {
            let c = micro_images.center(k, l);
            (0.0..=width as f64 - 1.0).contains(&c.x) && (0.0..=height as f64 - 1.0).contains(&c.y)
        };
        let rows = lattice.rows;
        (0..rows).flat_map(|l| (0..lattice.columns).map(move |k| (k, l))).filter(inside).collect()
    }

    /// Returns the observation of a corner in a micro-image.
    pub fn observation(&self, (k, l): (i32, i32), corner: &Corner) -> CornerObservation {
        let center = self.search.micro_images.center(k, l);
        CornerObservation {
            k,
            l,
            center,
            position: center + corner.place,
            covariance: corner.covariance + Matrix2::identity() * MODEL_STD_DEV_PX.powi(2),
            squares: corner.squares(),
        }
    }
}
