//! Detection in one frame.

use std::time::Instant;

use nalgebra::{Matrix2, Vector2};
use tracing::{debug, info, trace};

use super::board::{LabelledBoard, LatticePoint};
use super::corner::Corner;
use super::first_pass::FirstPass;
use super::grouping::Group;
use super::patch::Pair;
use super::{CornerObservation, DepthEstimator, Detection, MicroImages, Rejection};
use crate::image::Grey;
use crate::model::{Board, MIN_CORNERS, Sensor};

/// What is searched for, and where.
#[derive(Debug, Clone, Copy)]
pub struct Search<'a> {
    /// The micro-images.
    pub micro_images: &'a MicroImages,
    /// The board.
    pub board: &'a Board,
    /// The sensor.
    pub sensor: &'a Sensor,
    /// How 1/ν is estimated from the observations of a corner.
    pub estimator: DepthEstimator,
}

/// What was found and dropped in a frame: in the first pass, which searches every micro-image alone, and
/// in the second, which searches where the labelled board expects its corners.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct FrameCounts {
    /// Micro-images searched in the first pass.
    pub looked_at: usize,
    /// Those of them that are cut by the border, without light in the white image, or saturated.
    pub unusable: usize,
    /// Corners found in single micro-images.
    pub corners: usize,
    /// Clusters of these by DBSCAN.
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
    /// Micro-images in which a board corner should be but none was found: they are unusable, or the corner
    /// has too little contrast or is too uncertain.
    pub unclear: usize,
    /// Those in which one was found, but of a board corner that was given up: its observations are on no
    /// line, or few of them look like a corner.
    pub given_up: usize,
    /// Those in which it was found, but off its line.
    pub misplaced: usize,
}

/// Border of the image that counts as out of view, in pitches.
pub(super) const MARGIN: f64 = 1.0;
/// A side of the board with so many corners surely in view has to show one of them; surely is this
/// many pitches from the border.
const SIDE: usize = 3;
const SURE_MARGIN: f64 = 2.5;
/// Labels are sure where no larger part of the corners does not belong to the board, and this part of those in view is found:
/// with labels of other squares, corners are left over on one side of the board and missing on the other.
const OFF_BOARD: f64 = 0.05;
const FOUND: f64 = 0.9;
/// Labels are wrong where the second pass loses so many labelled corners, and so large a part of them: of boards in their
/// place it lost two at most and less than a tenth in simulated frames, of a lattice with other rows than the board's half.
const MANY_LOST: usize = 4;
const LOST: f64 = 0.25;
/// σ of a position because the model of the light is not exact, px.
const MODEL_STD_DEV_PX: f64 = 0.01;

/// Detects the features of a frame, with the counts of what was found and dropped in it; the reason if
/// it does not show the board.
pub fn detect_frame(
    frame: u32,
    image: &Grey,
    white: &Grey,
    search: &Search,
) -> (Result<Detection, Rejection>, FrameCounts) {
    let mut counts = FrameCounts::default();
    let begun = Instant::now();
    let result = Frame { frame, image, white, search }.detect(&mut counts);
    match &result {
        Ok(detection) => info!(
            "frame {frame}: {} features of {} board corners in {:.3} s",
            detection.features.len(),
            counts.board_corners,
            begun.elapsed().as_secs_f64()
        ),
        Err(why) => info!("frame {frame}: left out, {why}"),
    }
    debug!("frame {frame}: {counts:?}");
    (result, counts)
}

/// The board of a detection once more, with other micro-images, where it is known to be; `None` if it hardly shows there.
pub(super) fn detect_again(
    frame: u32,
    image: &Grey,
    white: &Grey,
    search: &Search,
    (before, mut counts): (&Detection, FrameCounts),
) -> Option<(Detection, FrameCounts)> {
    let frame = Frame { frame, image, white, search };
    let labelled = LabelledBoard { homography: before.homography, corners: Vec::new() };
    let passed = frame.second_pass_again(before, &labelled, &mut counts);
    let enough = passed.corners.len() >= MIN_CORNERS;
    enough.then(|| (frame.detection(&passed, labelled.homography), counts))
}

pub(super) struct Frame<'a> {
    pub frame: u32,
    pub image: &'a Grey<'a>,
    pub white: &'a Grey<'a>,
    pub search: &'a Search<'a>,
}

impl Frame<'_> {
    fn detect(&self, counts: &mut FrameCounts) -> Result<Detection, Rejection> {
        let (image, white) = (self.image.size(), self.white.size());
        if image != white {
            return Err(Rejection::Size { image, white });
        }
        let nodes = self.nodes();
        let contrast = self.contrast(&nodes).inspect_err(|_| {
            counts.looked_at = nodes.len();
            counts.unusable = self.count_unusable(&nodes);
        })?;
        let mut first = FirstPass::new(self, &nodes, contrast);
        first.search_some();
        let found = self.of_board(&first, counts);
        if let Ok((detection, true)) = found {
            return Ok(detection);
        }
        first.search_rest();
        self.of_board(&first, counts).map(|(detection, _)| detection)
    }

    /// The board that shows in micro-images of which some, or all, were searched; and whether it surely is where its labels put
    /// it: few corners do not belong to it, and most of its own are found.
    fn of_board(
        &self,
        first: &FirstPass,
        counts: &mut FrameCounts,
    ) -> Result<(Detection, bool), Rejection> {
        let FirstPass { observations, contrast, .. } = first;
        *counts = FrameCounts {
            looked_at: first.looked_at,
            unusable: first.unusable,
            corners: observations.len(),
            ..FrameCounts::default()
        };
        let groups = self.groups(observations, counts);
        trace!("frame {}: contrast {contrast:.3}, {} lines", self.frame, groups.len());
        let labelled = self.labelled(observations, &groups, counts)?;
        let passed = self.second_pass(&groups, &labelled, *contrast, counts);
        let corners = &passed.corners;
        self.check_sides(&labelled, |corner| corners.iter().any(|c| c.corner == corner))?;
        if corners.len() < MIN_CORNERS {
            return Err(Rejection::TooFewForPose { corners: corners.len(), fewest: MIN_CORNERS });
        }
        check_lost(counts.lost, labelled.corners.iter().flatten().count())?;
        let in_view =
            |corner: &i32| self.in_view(&labelled.pinhole(self.search.board, *corner), SURE_MARGIN);
        let in_view = (0..self.search.board.corners()).filter(in_view).count();
        let is_sure = counts.off_board as f64 <= OFF_BOARD * counts.corners as f64
            && corners.len() as f64 >= FOUND * in_view as f64;
        Ok((self.detection(&passed, labelled.homography), is_sure))
    }

    /// The board that the pinhole images of groups show.
    fn labelled(
        &self,
        observations: &[CornerObservation],
        groups: &[Group],
        counts: &mut FrameCounts,
    ) -> Result<LabelledBoard, Rejection> {
        let points: Vec<LatticePoint> = groups
            .iter()
            .map(|group| LatticePoint {
                place: group.line.pinhole(),
                squares: group.members.iter().map(|&i| observations[i].squares).sum(),
            })
            .collect();
        let in_view = |place: &Vector2<f64>| self.in_view(place, MARGIN);
        let labelled = LabelledBoard::label(&points, self.search.board, &in_view);
        let labelled = labelled.map_err(|reason| match counts.texture {
            0 => reason,
            corners => Rejection::Texture { reason: Box::new(reason), corners },
        })?;
        let off_board = groups.iter().zip(&labelled.corners).filter(|(_, c)| c.is_none());
        counts.off_board = off_board.map(|(group, _)| group.members.len()).sum();
        Ok(labelled)
    }

    /// Whether a place is in the micro-images, so many pitches within the border.
    pub fn in_view(&self, place: &Vector2<f64>, pitches: f64) -> bool {
        let micro_images = self.search.micro_images;
        micro_images.show(place, self.search.sensor, pitches * micro_images.grid.pitch_px)
    }

    /// The board and its white image.
    pub fn pair(&self) -> Pair<'_> {
        Pair { board: self.image, white: self.white }
    }

    /// The micro-images whose centres are in the image.
    fn nodes(&self) -> Vec<(i32, i32)> {
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

    /// The reason if none of the corners along a side of the board was found, though it is in view.
    fn check_sides(
        &self,
        labelled: &LabelledBoard,
        found: impl Fn(i32) -> bool,
    ) -> Result<(), Rejection> {
        let board = self.search.board;
        let in_view = |corner: &i32| self.in_view(&labelled.pinhole(board, *corner), SURE_MARGIN);
        let (columns, rows) = (board.columns, board.rows);
        let column = |c: i32| (0..rows).map(move |r| r * columns + c).collect::<Vec<i32>>();
        let row = |r: i32| (0..columns).map(move |c| r * columns + c).collect::<Vec<i32>>();
        let sides = [
            ("first column", column(0)),
            ("last column", column(columns - 1)),
            ("first row", row(0)),
            ("last row", row(rows - 1)),
        ];
        for (side, corners) in sides {
            let seen: Vec<i32> = corners.into_iter().filter(in_view).collect();
            if seen.len() >= SIDE && !seen.iter().any(|&corner| found(corner)) {
                return Err(Rejection::SideMissing { side, columns, rows });
            }
        }
        Ok(())
    }
}

/// The reason if so many labelled corners were lost that their labels are wrong.
fn check_lost(lost: usize, labelled: usize) -> Result<(), Rejection> {
    if lost >= MANY_LOST && lost as f64 > LOST * labelled as f64 {
        return Err(Rejection::Lost { lost, labelled });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_are_wrong_where_many_corners_are_lost() {
        for (lost, labelled) in [(2, 28), (3, 6), (4, 16)] {
            assert_eq!(check_lost(lost, labelled), Ok(()));
        }
        for (lost, labelled) in [(4, 8), (4, 15), (14, 28)] {
            assert_eq!(check_lost(lost, labelled), Err(Rejection::Lost { lost, labelled }));
        }
    }
}
